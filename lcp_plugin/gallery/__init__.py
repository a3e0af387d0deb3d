"""Named test problems with parameters, each with what is known about its solution.

``build("obstacle_2d", size=200)``, ``obstacle_2d(size=200)`` and ``parse("obstacle_2d:size=200")`` give the
same :class:`Scene`; ``describe()`` lists them all. A new scene is one function with ``scene_builder`` in a file of
this folder, and nothing else.
"""

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from .economics import binomial_put
from .scene import (
    Description,
    Scene,
    build,
    builder_of,
    describe,
    names,
    parse,
    scene_builder,
)

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = [
    "Description",
    "Scene",
    "binomial_put",
    "build",
    "describe",
    "names",
    "parse",
    "scene_builder",
]
__all__.extend(names())
globals().update(
    {name: builder_of(name) for name in names()}
)  # also where a scene has the name of its file

if TYPE_CHECKING:

    def __getattr__(name: str) -> Callable[..., Scene]: ...
