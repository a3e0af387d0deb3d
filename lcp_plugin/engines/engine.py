"""What an engine is given and what it gives back."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..core.checks import FloatVector


class ProgramData(NamedTuple):
    """Minimize ½ xᵀP x + cᵀx subject to G x ≤ h, A x = b, lower ≤ x ≤ upper.

    Attributes
    ----------
    P, G, A : array or csr_array, shapes (n, n), (m, n), (p, n)
        All dense or all sparse; P is symmetric.
    c, h, b, lower, upper : array, shapes (n,), (m,), (p,), (n,), (n,)
        h, −lower and upper may be ∞.
    """

    P: Any
    c: FloatVector
    G: Any
    h: FloatVector
    A: Any
    b: FloatVector
    lower: FloatVector
    upper: FloatVector


class Multipliers(NamedTuple):
    """At a solution P x + c + Gᵀ inequality + Aᵀ equality − lower + upper = 0, and all but `equality` are ≥ 0."""

    inequality: FloatVector
    equality: FloatVector
    lower: FloatVector
    upper: FloatVector


class Limits(NamedTuple):
    """What a caller allows and wants: an engine obeys what it can, as its `obeys` says.

    Attributes
    ----------
    seconds : float
        ∞ for no limit.
    is_verbose : bool
        Whether the engine prints its own log.
    """

    seconds: float = math.inf
    is_verbose: bool = False


class EngineStatus(Enum):
    """What an engine says of its point: it is not believed, but shows where to look."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    STOPPED = "stopped by its limit of steps or seconds"
    GAVE_UP = "gave up"


class EngineAnswer(NamedTuple):
    """A point x with multipliers, how many steps led there, and what the engine says of it."""

    x: FloatVector
    multipliers: Multipliers
    iterations: int
    says: EngineStatus


class Engine(ABC):
    """An engine with its options, by the names that it has given them: ``PIQP(max_iter=50)``.

    Attributes
    ----------
    name : str
    solves : str
        Which programs.
    cost, reference : str
        As of an :class:`~lcp_plugin.algorithms.Algorithm`.
    obeys : str
        Which of `max_seconds`, `verbose` and Ctrl-C it heeds while it runs, and what it does of the others.
    defaults : mapping
        The options that differ from the engine's own defaults.
    steps : str
        Its option for the largest number of steps.
    ends_with_a_case : bool
        Whether its point solves the linear system of a case: an active set method.
    is_for_linear_alone : bool
        Whether it takes no P.
    """

    name: ClassVar[str]
    solves: ClassVar[str]
    cost: ClassVar[str]
    reference: ClassVar[str]
    obeys: ClassVar[str]
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    steps: ClassVar[str] = "max_iter"
    ends_with_a_case: ClassVar[bool] = False
    is_for_linear_alone: ClassVar[bool] = False

    def __init__(self, **options: Any) -> None:
        self.options = options

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self.options.items())})"

    @property
    def settings(self) -> dict[str, Any]:
        """All options that are not the engine's own defaults."""
        return {**self.defaults, **self.options}

    @abstractmethod
    def answer(self, program: ProgramData, limits: Limits) -> EngineAnswer:
        """Return the point that the engine ends at."""


def split_bound_multipliers(
    slack: FloatVector, lower: FloatVector, upper: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return the multipliers of lower and upper bounds that signed ones mean, 0 where a bound is infinite.

    Examples
    --------
    >>> split_bound_multipliers(np.array([-2.0, 3.0]), np.zeros(2), np.array([np.inf, 1.0]))
    (array([2., 0.]), array([0., 3.]))
    """
    return np.maximum(-slack, 0.0) * np.isfinite(lower), np.maximum(slack, 0.0) * np.isfinite(upper)
