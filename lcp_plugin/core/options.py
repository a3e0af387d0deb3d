"""Options of `solve` and `solve_batch` for each problem class; editors complete them, and mypy checks them.

:func:`lcp_plugin.solve` describes the options. Options of a named algorithm, for example ``relaxation``, are in
`AlgorithmOptions`. An engine, as ``piqp``, takes its own options in addition.

>>> sorted(Limits.__annotations__)
['max_seconds', 'tolerance']
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypedDict

from numpy.typing import ArrayLike

EngineName = Literal["piqp", "daqp", "clarabel", "highs"]


class Limits(TypedDict, total=False):
    """Tolerance and limits, which all problem classes have."""

    tolerance: float
    max_seconds: float | None


class Watching(Limits, total=False):
    """Options of a run with iterations that can be watched."""

    max_iterations: int | None
    record: bool
    callback: Callable[[Any, Any], Any] | None
    threads: int | None
    verbose: bool


class Residuals(Watching, total=False):
    """Options of a run that compares residuals in the unit of z."""

    absolute_tolerance: float


class AlgorithmOptions(TypedDict, total=False):
    """Options of the named algorithms for an LCP."""

    relaxation: float | str
    acceleration: float
    sweep: str
    scaling: str | None
    scaling_factor: float
    splitting: Any
    omega: float | ArrayLike
    max_pivots: int | None
    restarts: int | None
    smoother: str
    nested: bool
    coarsest: int
    hands_over: bool


class LCPOptions(Residuals, AlgorithmOptions, total=False):
    """Options for an LCP, and for a QuadraticProgram without an engine's own."""

    z0: ArrayLike | None
    error_bound: bool
    prove_infeasibility: bool


class BatchOptions(Limits, total=False):
    """Options of `solve_batch` for each problem, and of the batch."""

    max_iterations: int | None
    absolute_tolerance: float
    prove_infeasibility: bool
    threads: int | None


class NonlinearOptions(Residuals, total=False):
    """Options for a NonlinearProblem."""

    x0: ArrayLike | None
    z0: ArrayLike | None
    check_jacobian: bool


class ConeOptions(Residuals, total=False):
    """Options for a ConeProblem and a FrictionalContact."""

    z0: ArrayLike | None
    prove_infeasibility: bool


class LeastSquaresOptions(Watching, total=False):
    """Options for a BoundedLeastSquares."""

    x0: ArrayLike | None
    z0: ArrayLike | None


class EquilibriumOptions(Limits, total=False):
    """Options for an EquilibriumProgram."""

    x0: ArrayLike | None
    z0: ArrayLike | None
    max_nodes: int | None
    callback: Callable[[Any], Any] | None
    verbose: bool
    prove: bool


#: Classes whose solvers pass these options on to Settings.
OF_CLASS: dict[str, Any] = {
    "NonlinearProblem": NonlinearOptions,
    "BoundedLeastSquares": LeastSquaresOptions,
    "ConeProblem": ConeOptions,
    "FrictionalContact": ConeOptions,
}
