"""Other people's solvers of convex programs: a statement in, a point with multipliers out.

An engine is a file here and a line of `ENGINES`. It knows nothing of tolerances, statuses and kinds of problems: what
its point is worth the judge of programs says (:mod:`lcp_plugin.problems.programs.criterion`), after one step to the
linear system of the case that the point names (:mod:`lcp_plugin.engines.polish`). That an engine calls a program
infeasible or unbounded is a hint where to look for a proof.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module

from .engine import Engine, EngineAnswer, EngineStatus, Limits, Multipliers, ProgramData

ENGINES = {  # name: file and class; in the order in which `lcp-plugin list` shows them
    "daqp": "DAQP",
    "piqp": "PIQP",
    "clarabel": "Clarabel",
    "highs": "HiGHS",
}


__all__ = [
    "ENGINES",
    "Engine",
    "EngineAnswer",
    "EngineStatus",
    "Limits",
    "Multipliers",
    "ProgramData",
    "engine_class",
]


@cache
def engine_class(name: str) -> type[Engine]:
    """Return the class of the engine of that name; its file, and what it wraps, are loaded now.

    Examples
    --------
    >>> engine_class("piqp").__name__
    'PIQP'
    """
    found: type[Engine] = getattr(import_module(f".{name}", __name__), ENGINES[name])
    return found
