"""Interface of external solvers: the program, limits and options in, a point with multipliers and a status out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

from ..core.checks import AnyMatrix, Vector


class ProgramData(NamedTuple):
    """Minimize ½ xᵀP x + cᵀx subject to G x ≤ h, A x = b, lower ≤ x ≤ upper.

    Attributes
    ----------
    P, G, A : array or csr_array, shapes (n, n), (m, n), (p, n)
        All dense or all sparse; P is symmetric.
    c, h, b, lower, upper : array, shapes (n,), (m,), (p,), (n,), (n,)
        h, −lower and upper may be ∞.
    """

    P: AnyMatrix
    c: Vector
    G: AnyMatrix
    h: Vector
    A: AnyMatrix
    b: Vector
    lower: Vector
    upper: Vector


class SolverLimits(NamedTuple):
    """Time limit and verbosity of a run; `Engine.obeys` lists the limits that an engine supports.

    Attributes
    ----------
    seconds : float
        ∞ if the time is not limited.
    is_verbose : bool
        Whether the engine prints its own log.
    """

    seconds: float = math.inf
    is_verbose: bool = False


class EngineStatus(Enum):
    """Status that an engine reports: a hint for the search of a proof, never a proof."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    STOPPED = "stopped by its limit of steps or seconds"
    GAVE_UP = "gave up"


class EnginePoint(NamedTuple):
    """Final point x of an engine, multipliers y of the rows of G and A, the number of steps, and the reported status.

    P x + c + [Gᵀ Aᵀ] y is 0, except for unknowns at a bound; multipliers of G are ≥ 0.
    """

    x: Vector
    y: Vector
    iterations: int
    reported: EngineStatus


class Engine(ABC):
    """External solver with its options, under the solver's names of options: ``PIQP(max_iter=50)``.

    Attributes
    ----------
    name : str
    solves : str
        Programs that the engine accepts.
    cost, reference : str
        Same meaning as the fields of an :class:`~lcp_plugin.algorithms.Algorithm`.
    obeys : str
        Effect of `max_seconds`, `verbose` and Ctrl-C during a run.
    defaults : mapping
        The options that differ from the engine's own defaults.
    steps : str
        Name of the engine's option for the largest number of steps.
    is_for_linear_alone : bool
        True if the engine accepts linear programs only (no P).
    """

    name: ClassVar[str]
    solves: ClassVar[str]
    cost: ClassVar[str]
    reference: ClassVar[str]
    obeys: ClassVar[str]
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    steps: ClassVar[str] = "max_iter"
    is_for_linear_alone: ClassVar[bool] = False

    def __init__(self, **options: Any) -> None:
        self.options = options

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self.options.items())})"

    @property
    def settings(self) -> dict[str, Any]:
        """Options that differ from the defaults of the external solver."""
        return {**self.defaults, **self.options}

    @abstractmethod
    def solve(self, program: ProgramData, limits: SolverLimits) -> EnginePoint:
        """Return the final point of the engine."""
