"""External solvers of convex programs: each takes the data of a program and returns a point with multipliers.

An engine is a class in `solvers` and a line of `ENGINES`. Its point is polished on its active set
(:mod:`lcp_plugin.engines.polish`) and then tested by the criterion of programs
(:mod:`lcp_plugin.judges.program`), because the tolerances of engines differ. An engine that reports
infeasible or unbounded only starts the search for a proof.
"""

from __future__ import annotations

import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec

from ..core.errors import UnsuitableProblem
from .engine import Engine

# name: class; in the order in which `lcp-plugin list` shows them
ENGINES = {"daqp": "DAQP", "piqp": "PIQP", "clarabel": "Clarabel", "highs": "HiGHS"}


@cache
def engine_class(name: str) -> type[Engine]:
    """Return the class of the engine of that name; the call imports the adapters.

    Examples
    --------
    >>> engine_class("piqp").__name__
    'PIQP'
    """
    return getattr(import_module(".solvers", __name__), ENGINES[name])


@cache
def is_installed(name: str) -> bool:
    """Return whether the package of an engine is there; HiGHS is a part of scipy."""
    return name == "highs" or find_spec(name) is not None


@cache
def has_piqp() -> bool:
    """Return whether PIQP is installed; warn once if it is not, because methods without it are slower."""
    if not is_installed("piqp"):
        warnings.warn(
            "piqp is not installed: convex programs are solved by slower methods; pip install piqp",
            RuntimeWarning,
            stacklevel=3,
        )
    return is_installed("piqp")


def installed_engine(name: str) -> type[Engine]:
    """Return the class of the engine of that name.

    Raises
    ------
    UnsuitableProblem
        If its package is not installed.
    """
    if not is_installed(name):
        raise UnsuitableProblem(
            f'{name} is not installed; install it with: pip install {name}, or use algorithm="auto"'
        )
    return engine_class(name)
