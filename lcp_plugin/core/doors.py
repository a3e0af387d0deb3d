"""Functions of higher floors that a class or a function of a lower floor offers, looked up by name in one table.

``lcp_plugin/__init__.py`` is above all floors and fills the table, so no file names a file of a higher floor.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from operator import attrgetter
from types import MethodType
from typing import Any

DOORS: dict[
    str, str
] = {}  # "Class.name" or "function package" → "module:function", from the package on


class Door:
    """Method of a class, or function if `is_static`, that is loaded on first access.

    Parameters
    ----------
    is_static : bool
    """

    def __init__(self, *, is_static: bool = False) -> None:
        self.is_static = is_static

    def __set_name__(self, owner: type, name: str) -> None:
        """Note the name under which the table has the function."""
        self.name = f"{owner.__name__}.{name}"

    def __get__(self, instance: Any, owner: type) -> Any:
        """Return the function, bound to the instance unless it is static."""
        function = _function(self.name)
        return function if self.is_static or instance is None else MethodType(function, instance)


def foreign_function(name: str, model: Any) -> Callable[..., Any] | None:
    """Return the function of that name for a model of another package; None for any other object.

    Examples
    --------
    >>> foreign_function("certify", 1.0) is None
    True
    """
    for kind in type(model).__mro__:
        package = kind.__module__.partition(".")[0]
        for owner in (package, ".".join(kind.__module__.split(".")[:2])):
            if f"{name} {owner}" in DOORS:
                return _function(f"{name} {owner}")
    return None


def _function(name: str) -> Callable[..., Any]:
    module, _, path = DOORS[name].partition(":")
    found: Callable[..., Any] = attrgetter(path)(import_module(f"lcp_plugin.{module}"))
    return found
