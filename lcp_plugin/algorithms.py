"""The algorithms by the names of their classes; ``lcp_plugin.core.algorithms`` says what one is and how it is added.

>>> from lcp_plugin import LCP, solve
>>> from lcp_plugin.algorithms import NPSOR
>>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
>>> solve(problem, NPSOR(relaxation=1.5)).iterations == solve(problem, "npsor", relaxation=1.5).iterations
True
"""

from __future__ import annotations

from typing import Any

from .core import algorithms as _algorithms
from .core.algorithms import (
    ENTRY_POINT_GROUP,
    REGISTRY,
    Algorithm,
    FusedSolve,
    Step,
    algorithm_class,
    create,
    from_other_packages,
    module_of,
)

__all__ = [
    "ENTRY_POINT_GROUP", "REGISTRY", "Algorithm", "FusedSolve", "Step", "algorithm_class", "create",
    "from_other_packages", "module_of",
]


def __getattr__(name: str) -> Any:
    return getattr(_algorithms, name)
