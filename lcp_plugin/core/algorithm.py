"""The interface of algorithms: frozen options and an iterator; no clock, no tolerance, no status."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from .checks import Vector, is_number
from .errors import InvalidOption, UnsuitableMatrix, did_you_mean
from .lcp import LCP
from .sweep_data import has_positive_diagonal

PROJECTED_TYPE = "projected type"
PROJECTED_SPLITTING = "projected splitting"
PROJECTED_RELAXATION = "projected relaxation"
MODULUS = "modulus"


@dataclass(frozen=True, eq=False)
class IterationFacts:
    """The family and the parameters of an iteration, for convergence theorems.

    Attributes
    ----------
    family : str
        "projected type", "projected splitting", "projected relaxation" or "modulus".
    relaxation : float or None
        α (ω of a projected relaxation); None if it is determined during the run.
    acceleration : float or None
        β.
    sweep : {"forward", "backward", "symmetric"}
    scaling : array, shape (n,), or None
        The diagonal of S of the projected-type families.
    omega : array, shape (n,), or None
        The diagonal of Ω of the modulus family.
    splitting : sparse array, shape (n, n), or None
        𝓜 of a projected splitting; `is_part_of_matrix` if each entry is 0 or the entry of M, with the full diagonal.
    has_momentum : bool
        Whether the iterates are extrapolated.
    """

    family: str
    relaxation: float | None = 1.0
    acceleration: float | None = 1.0
    sweep: str = "forward"
    scaling: Vector | None = field(default=None, repr=False)
    omega: Vector | None = field(default=None, repr=False)
    splitting: Any = field(default=None, repr=False)
    is_part_of_matrix: bool = False
    has_momentum: bool = False


#: The `backward` flag of each pass of one iteration.
SWEEPS = {"forward": (False,), "backward": (True,), "symmetric": (False, True)}


@dataclass(slots=True)
class Step:
    """Iterate of an algorithm.

    Attributes
    ----------
    z : ndarray, shape (n,)
        Borrowed: the algorithm may overwrite it when it computes the next step.
    residual : float or None
        Exactly the numerator of the relative residual of this z, where the algorithm has it for free.
    increment : float or None
        ‖z − previous z‖∞; the driver uses it to decide when to measure a residual.
    work : float
        Matrix entries touched since the last step, divided by the nonzeros of M.
    is_settling : bool
        The algorithm has just changed one of its parameters: a residual that does not fall now does not count as a
        stall.
    proof : object, optional
        A proof from `proofs` that the problem has no solution. The driver accepts it only after ``verify()``.
    remark : str
        A clause for the advice of a run that does not solve the problem: the undecided question, and the next step.
    label : str
        The name of the part at work, where an algorithm has several; the result shows them as its stages.
    iterations : int or None
        Number of iterations that this step counts as; None means 1, or 0 for the first step of a method, the start.
    measured : Measured, optional
        The measure of this z, if the proposal contains it already; of a nonlinear problem its linearization there.
    note : str
        Words about this step for the log, which then has a line for it.
    """

    z: Vector
    residual: float | None = None
    increment: float | None = None
    work: float = 1.0
    is_settling: bool = False
    proof: Any = None
    remark: str = ""
    label: str = ""
    iterations: int | None = None
    measured: Any = None
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Algorithm(ABC):
    """An algorithm: a frozen dataclass of its options, with a generator of iterates.

    Class attributes describe the method to readers: `name` (registry name), `needs`, `solves` (matrix classes with a
    proof), `cost` (of one iteration), `reference`; "–" if the class does not set them. For the methods of this package,
    `needs` and `solves` are tested. If `needs` begins with "positive diagonal", the method calls
    `require_positive_diagonal`. If `solves` contains a class of matrices ("H₊", "SPD", "PSD"), `theorem` proves
    convergence on such matrices for the default options. Set `is_monotone` = False if the residual may rise and the
    iterator ends by itself when it cannot continue. Set `is_watched` if the driver must nevertheless end a run whose
    best residual no longer falls.

    Define a `name` and `iterates(problem, z0)` in your own method; clock, tolerance and status belong to `solve`. The
    method may use these attributes of the problem, and must not change them:

    - ``M``, as stored, dense or CSR, and ``csr``, ``csc``, canonical, shape (n, n), ``is_dense``, ``diagonal``,
      shape (n,), and ``matrix``, M with facts about M;
    - ``q``, ``lower``, ``upper``, shape (n,), bounds perhaps infinite, ``n`` and ``nonzeros``;
    - ``slack(z)``, w = M z + q, ``nearest_to_zero``, z°, and ``residual_scale``, the d_i of the residual;
    - ``np.clip(z, problem.lower, problem.upper)`` for the projection, and `require_positive_diagonal` of this module.

    Run your method by ``solve(problem, Mine())``; compare it with other methods by ``study`` and
    ``error_against_time``. The command line accepts only registered names.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from lcp_plugin import LCP, solve
    >>> @dataclass(frozen=True, kw_only=True)
    ... class DampedJacobi(Algorithm):
    ...     name = "damped_jacobi"
    ...     damping: float = 0.8
    ...
    ...     def iterates(self, problem, z0):
    ...         z = z0.copy()
    ...         while True:
    ...             yield Step(z)
    ...             step = self.damping * problem.slack(z) / problem.diagonal
    ...             z = np.clip(z - step, problem.lower, problem.upper)
    >>> result = solve(LCP([[4, -1], [-1, 4]], [-3, 5]), DampedJacobi(damping=0.9))
    >>> result.status.name, result.z.round(6)
    ('SOLVED', array([0.75, 0.  ]))
    """

    name: ClassVar[str]
    needs: ClassVar[str] = "–"
    solves: ClassVar[str] = "–"
    cost: ClassVar[str] = "–"
    reference: ClassVar[str] = "–"
    is_monotone: ClassVar[bool] = True
    ends_on_active_set: ClassVar[bool] = False  # where it is True, a run adds no last linear system
    is_watched: ClassVar[bool] = False

    @abstractmethod
    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start and then one step per iteration, without limit.

        Parameters
        ----------
        problem : LCP
        z0 : ndarray, shape (n,)
            A start within the bounds; the algorithm may overwrite it.

        Raises
        ------
        UnsuitableMatrix, UnsuitableProblem
            Before the first step; the message names the unsuitable row.
        """

    def first_points(self, problem: LCP, z0: Vector, tolerance: float) -> Iterator[Step] | None:
        """Return the points of a first attempt that is complete by itself, before `iterates`; None without one.

        A run takes them if the caller chose this algorithm, or if "auto" begins with it.
        """
        return None

    def finish(self, problem: LCP, z: Vector) -> Vector:
        """Return z after a last clean-up; the driver keeps it only if its certificate is no worse."""
        return z

    def facts(self, problem: LCP) -> IterationFacts | None:
        """Return the facts of the iteration that convergence theorems require, or None if no theorem covers it.

        Raises
        ------
        UnsuitableMatrix, UnsuitableProblem
            Where it cannot run at all.
        """
        return None

    def theorem(self, problem: LCP, report: object) -> str | None:
        """Return the theorem by which a method without `facts` finds a solution for every q, or None.

        Parameters
        ----------
        problem : LCP
        report : MatrixReport
            Report on the matrix of the problem.

        Raises
        ------
        UnsuitableMatrix, UnsuitableProblem
            Where it cannot run at all.
        """
        return None

    def __str__(self) -> str:
        return self.name


def check_positive(algorithm: Algorithm, option: str, *, below: float = math.inf) -> None:
    """Raise unless the option is a number in (0, below)."""
    value = getattr(algorithm, option)
    if not is_number(value) or not 0.0 < value < below:
        limit = "" if below == math.inf else f" below {below:g}"
        raise InvalidOption(
            f"{algorithm.name}: {option} must be a positive finite number{limit}, got {value!r}"
        )


def check_flag(algorithm: Algorithm, option: str) -> None:
    """Raise unless the option is True or False."""
    value = getattr(algorithm, option)
    if not isinstance(value, bool):
        raise InvalidOption(f"{algorithm.name}: {option} must be True or False, got {value!r}")


def check_number(algorithm: Algorithm, option: str) -> None:
    """Raise unless the option is a finite number."""
    value = getattr(algorithm, option)
    if not is_number(value) or not math.isfinite(value):
        raise InvalidOption(f"{algorithm.name}: {option} must be a finite number, got {value!r}")


def check_choice(algorithm: Algorithm, option: str, choices: Sequence[str | None]) -> None:
    """Raise unless the option is one of the choices."""
    value = getattr(algorithm, option)
    if not (value is None or isinstance(value, str)) or value not in choices:
        raise InvalidOption(
            f"{algorithm.name}: {option}={value!r} is not offered{did_you_mean(value, choices)}"
        )


def count_driven_sweeps(problem: LCP, passes: float) -> float:
    """Return the number of sweeps, with the calls around each, that take as long as `passes` compiled passes over M."""
    entries = problem.matrix.nonzeros
    return passes * entries / (entries + 10_000.0)


def require_positive_diagonal(problem: LCP, name: str) -> Vector:
    """Return the diagonal, or raise naming the first entry that is not positive (or too small to invert)."""
    diagonal, usable = problem.matrix.diagonal, has_positive_diagonal(problem.matrix)

    if not usable.all():
        i = int(np.flatnonzero(~usable)[0])
        raise UnsuitableMatrix(
            f'{name} needs a positive diagonal, but M[{i}, {i}] = {diagonal[i]}; try algorithm="auto"'
        )
    return diagonal
