"""The algorithms by the names of their classes; ``lcp_plugin.core.algorithms`` says what one is and how it is added.

>>> from lcp_plugin import LCP, solve
>>> from lcp_plugin.algorithms import NPSOR
>>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
>>> solve(problem, NPSOR(relaxation=1.5)).iterations == solve(problem, "npsor", relaxation=1.5).iterations
True
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .core.algorithms import REGISTRY, Algorithm, FusedSolve, Step, algorithm_class, create, module_of
from .core.registry import ask

if TYPE_CHECKING:
    from .doors.packages import ENTRY_POINT_GROUP, from_other_packages

__all__ = [
    "ENTRY_POINT_GROUP", "REGISTRY", "Algorithm", "FusedSolve", "Step", "algorithm_class", "create",
    "from_other_packages", "module_of",
]
_OF_OTHER_PACKAGES = {"ENTRY_POINT_GROUP": "group", "from_other_packages": "all"}


def __getattr__(name: str) -> Any:
    if name in _OF_OTHER_PACKAGES:
        return ask("algorithm of another package", _OF_OTHER_PACKAGES[name])
    for word, place in REGISTRY.items():
        if place.endswith(f":{name}"):
            return algorithm_class(word)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
