"""A function or an attribute of the package replaced wherever it was imported to, and put back."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import _lru_cache_wrapper, cached_property
from importlib import import_module
from inspect import getattr_static
from typing import Any, NamedTuple

PACKAGE = "lcp_plugin."
MAKES_IDENTITIES = {"lcp_plugin.expressions.functions"}


class Modules:
    """The package's modules that were loaded since the last look."""

    def __init__(self) -> None:
        self._seen: set[str] = set()

    def new(self) -> list[Any]:
        names = [
            name for name in sys.modules if name.startswith(PACKAGE) and name not in self._seen
        ]
        self._seen.update(names)
        return [sys.modules[name] for name in names]


_modules = Modules()


def each_call(old: Any, note: Callable[[], None]) -> Any:
    """The same, which takes note of each call."""

    def noted(*given: Any, **named: Any) -> Any:
        note()
        return old(*given, **named)

    return noted


class Instead(NamedTuple):
    """Replacement of a definition.

    Attributes
    ----------
    off : callable, old -> new
    watch : callable, (old, note) -> new
        Acts as the old definition, and calls ``note()`` if the new one would act differently.
    """

    off: Callable[[Any], Any]
    watch: Callable[[Any, Callable[[], None]], Any] = each_call


@dataclass
class Patch:
    """Patch of one definition, ``module:name`` or ``module:Class.name`` in the package.

    Attributes
    ----------
    place : str
    instead : Instead
    times : int
        Number of calls in which the new definition would have acted differently.
    """

    place: str
    instead: Instead
    times: int = 0
    _old: Any = field(default=None, repr=False)
    _new: Any = field(default=None, repr=False)
    _spots: list[tuple[Any, str]] = field(default_factory=list, repr=False)
    _modules: Modules = field(default_factory=Modules, repr=False)

    def find(self) -> tuple[Any, str, Any]:
        """Return the owner, the name and the definition; fail if it does not exist."""
        module, path = self.place.split(":")
        *owners, name = path.split(".")
        owner: Any = import_module(f"{PACKAGE}{module}")
        for one in owners:
            owner = getattr(owner, one)
        return (
            owner,
            name,
            vars(owner)[name] if isinstance(owner, type) else getattr_static(owner, name),
        )

    def make(self, *, watched: bool) -> None:
        """Find the old definition, and build the new one."""
        _, _, self._old = self.find()
        old, kind = self._old, type(self._old)
        if kind in (staticmethod, classmethod):
            old = old.__func__
        elif kind in (property, cached_property):
            old = old.fget if kind is property else old.func
        new = self.instead.watch(old, self._note) if watched else self.instead.off(old)
        for own in ("is_known", "keep"):  # of a fact about a matrix
            if hasattr(old, own):
                setattr(new, own, getattr(old, own))
        if kind in (staticmethod, classmethod):
            new = kind(new)
        elif kind in (property, cached_property):
            new = property(new)
        self._new = new

    def _note(self) -> None:
        self.times += 1

    def put(self, *, on: bool) -> None:
        """Install the old or the new definition, also in modules that import it."""
        now, then = (self._new, self._old) if on else (self._old, self._new)
        owner, name, _ = self.find()
        if callable(self._old):
            self._spots += [
                (module, own)
                for module in self._modules.new()
                if module is not owner
                for own, value in vars(module).items()
                if value is now
            ]
        for one, own in [(owner, name), *self._spots]:
            setattr(one, own, then)


@contextmanager
def replaced(patches: list[Patch], *, watched: bool = False) -> Iterator[None]:
    """Install all patches inside a ``with`` statement, with empty caches of the package."""
    for one in patches:
        one.make(watched=watched)
        one.put(on=False)
    forget()
    try:
        yield
    finally:
        for one in reversed(patches):
            one.put(on=True)
        forget()


_caches: list[Any] = []


def forget() -> None:
    """Empty the caches of the package's functions, but those that make what is compared by identity (x² is SQUARE)."""
    _caches.extend(
        value
        for module in _modules.new()
        for value in vars(module).values()
        if isinstance(value, _lru_cache_wrapper) and value.__module__ not in MAKES_IDENTITIES
    )
    for one in _caches:
        one.cache_clear()
