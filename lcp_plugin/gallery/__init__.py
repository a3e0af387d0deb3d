"""Named test problems with parameters, each with what is known about its solution.

``build("obstacle_2d", size=200)``, ``obstacle_2d(size=200)`` and ``parse("obstacle_2d:size=200")`` give the
same :class:`Scene`; ``describe()`` lists them all. A new test problem is one function with ``scene_builder`` in a file
of this folder, and nothing else.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

from . import problems  # noqa: F401 - the test problems are registered
from .problems import binomial_put
from .scene import Description, Scene, build, builder_of, describe, names, parse, scene_builder

__all__ = ["Description", "Scene", "binomial_put", "build", "describe", "names", "parse"]
__all__ += ["scene_builder", *names()]  # noqa: PLE0604 - strings
globals().update({name: builder_of(name) for name in names()})

if TYPE_CHECKING:

    def __getattr__(name: str) -> Callable[..., Scene]: ...
