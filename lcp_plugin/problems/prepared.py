"""`prepare`: a solver of one problem after another, of which only some data change, as in the loop of a controller.

A small dense problem takes a short way: a kernel or an external solver, and one compiled sufficient test, which implies
the criterion. If the test does not decide, or if options watch or limit the run, the full solver runs, as by `solve`.
"""

from __future__ import annotations

import math
from copy import copy
from functools import partial
from time import perf_counter
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ..core.checks import AnyMatrix, Vector, checked_bounds, read_only
from ..core.errors import InvalidOption
from ..core.kernels.threads import threads_for
from ..core.lcp import LCP
from ..core.matrix import has_positive_diagonal, inverse_residual_scale, row_splits
from ..core.problem_classes import class_of, refusal
from ..core.settings import Settings, Status, checked_threads
from ..engines import is_installed
from ..engines.solvers import DAQP, EQUATION, call_daqp
from ..judges.program import PROGRAM_TOLERANCE, dense_errors, is_one_dense_component
from ..methods.banded import banded_passes
from ..methods.lemke import Lemke
from ..methods.multigrid import Multigrid
from ..methods.small import (
    LOOP_UP_TO,
    arrays_of_one,
    follow_one,
    has_free_unknowns,
    has_numba,
    is_small,
    tilts,
)
from ..solving.dispatch import parse_call, solver_with
from ..solving.lcp_solver import is_bare
from ..solving.result import BaseResult, Result, StageRecord
from ..systems.factors import bands
from ..systems.hierarchy.levels import hierarchy_of
from .cones.frictional_contact import FrictionalContact
from .cones.solving import ConeResult
from .least_squares.data import BoundedLeastSquares
from .least_squares.solving import LeastSquaresResult
from .nonlinear.data import NonlinearProblem
from .programs.program import QuadraticProgram, refuse_nonconvex
from .programs.result import QuadraticProgramResult
from .programs.solution import QPSolution

P = TypeVar("P")
R = TypeVar("R", bound=BaseResult)
FAR = 1e6  # a larger x may be on its way to infinity
NO_LIMIT = 1e20  # a limit of a row that is none
CERTAIN_ROWS = 1e-10  # a larger violation starts a search for a proof of infeasibility


class PreparedProblem(Generic[P, R]):
    """Solver of a prepared problem and of others that differ from it in some data; threads may share it.

    Attributes
    ----------
    problem : the problem class
    last : result of the latest call, or None
    """

    def __init__(self, problem: P, algorithm: Any, options: dict[str, Any]) -> None:
        self.problem, self.last = problem, None
        self._solve_fully = solver_with(problem, algorithm, dict(options), "prepare")

    last: R | None

    def _result_of(self, problem: P, warm: bool, **start: ArrayLike | None) -> R:
        """Return the result of the full solver, from a start, or with `warm` from the last result."""
        ((name, value),) = start.items()
        if value is None and warm and self.last is not None:
            value = self.last.x
        self.last = self._solve_fully(problem, **({} if value is None else {name: value}))
        return self.last


class PreparedLCP(PreparedProblem[LCP, Result]):
    """Solver of LCPs that differ from a prepared one in q, M or bounds."""

    def __init__(self, problem: LCP, algorithm: Any, options: dict[str, Any]) -> None:
        super().__init__(problem, algorithm, options)
        wishes = {name: one for name, one in options.items() if name != "z0"}
        self._method, self._settings = parse_call(algorithm, wishes)
        is_path = self._method is None or self._method == Lemke()
        is_short = (
            is_path and "z0" not in options and is_bare(self._settings, options.get("callback"))
        )
        self._arrays: Any = None
        self._has_free = has_free_unknowns(problem.lower, problem.upper)
        if is_short and is_small(problem) and problem.n <= LOOP_UP_TO and has_numba():
            self._arrays = arrays_of_one(problem)
        elif not is_small(problem):
            _compute_facts(problem, checked_threads(options.get("threads")))

    def solve(
        self,
        *,
        q: ArrayLike | None = None,
        M: AnyMatrix = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        z0: ArrayLike | None = None,
        warm: bool = False,
    ) -> Result:
        """Return the result of the problem with these data; data that are not passed are the prepared problem's.

        Parameters
        ----------
        q, lower, upper, z0 : arrays, shape (n,)
        M : array or sparse array, shape (n, n)
        warm : bool
            Start from the last result, if there is one.

        Raises
        ------
        InvalidProblem, InvalidOption
            As :class:`lcp_plugin.LCP` and :func:`lcp_plugin.solve`.
        """
        if self._arrays is not None and z0 is None and not warm:
            found = self._solve_quickly(q, M, lower, upper)
            if found is not None:
                self.last = found
                return found
        return self._result_of(self._problem_with(q, M, lower, upper), warm, z0=z0)

    def _problem_with(self, q: Any, M: Any, lower: Any, upper: Any) -> LCP:
        one = self.problem
        q = one.q if q is None else q
        if M is None:
            return one.with_q(q, lower=lower, upper=upper)
        lower, upper = one.lower if lower is None else lower, one.upper if upper is None else upper
        return LCP(M, q, lower=lower, upper=upper, names=one.names)

    def _solve_quickly(self, q: Any, M: Any, lower: Any, upper: Any) -> Result | None:
        """Return the end of Lemke's path if the sufficient test accepts it; NaN and infinities do not pass."""
        began, (A, b, low, high, start) = perf_counter(), self._arrays
        b, A = _copy_of(q, b), _copy_of(M, A)
        if b is None or A is None:
            return None
        if lower is not None or upper is not None:
            given = low[0] if lower is None else lower, high[0] if upper is None else upper
            low, high = (one[np.newaxis] for one in checked_bounds(*given, self.problem.n))
            start = read_only(np.minimum(np.maximum(0.0, low), high))
            if has_free_unknowns(low, high):
                return None
        elif self._has_free:
            return None
        z, bound = np.empty(b.shape), np.empty(1)
        follow_one(A, b, low, high, start, tilts(b.size), self._settings.tolerance, z, bound)
        if not bound[0] < math.inf:
            return None
        z = read_only(z[0])
        found = object.__new__(Result)
        data = b[0], None if M is None else A[0], low[0], high[0]
        make = partial(self._record, data, z, perf_counter() - began)
        vars(found).update(z=z, status=Status.SOLVED, _asked=self._method, _make=make)
        return found

    def _record(self, data: Any, z: Vector, seconds: float) -> dict[str, Any]:
        """Return the fields of the result of the short way."""
        problem = self._problem_with(*data)
        work = 0.0 if (z == problem.nearest_to_zero).all() else float(problem.n)
        stage = StageRecord("lemke", "prepared", int(work > 0.0), work)
        return vars(Result.at(problem, z, stage, self._settings, seconds, chosen=self._method))


def _compute_facts(problem: LCP, threads: int) -> None:
    """Compute the properties of M that methods for larger problems need."""
    with threads_for(threads), np.errstate(all="ignore"):
        inverse_residual_scale(problem.matrix)
        if banded_passes(problem.matrix) < math.inf:
            bands(problem.matrix)
        for backward in (False, True):
            row_splits(problem.matrix, backward)
        if has_positive_diagonal(problem.matrix).all():
            hierarchy_of(problem.matrix, Multigrid.coarsest)


def _copy_of(values: Any, prepared: Vector) -> Any:
    """Return a read-only copy of doubles of the prepared shape, the prepared ones for None; None for other values."""
    if values is None:
        return prepared
    if type(values) is not np.ndarray or values.dtype != np.float64:
        return None
    if values.shape != prepared.shape[-values.ndim :] or values.size != prepared.size:
        return None
    made = np.array(values, order="C").reshape(prepared.shape)
    made.flags.writeable = False
    return made


class PreparedProgram(PreparedProblem[QuadraticProgram, QuadraticProgramResult]):
    """Solver of programs that differ from a prepared one in vectors."""

    def __init__(self, problem: QuadraticProgram, algorithm: Any, options: dict[str, Any]) -> None:
        super().__init__(problem, algorithm, options)
        refuse_nonconvex(problem)
        self._settings = Settings(tolerance=options.get("tolerance", PROGRAM_TOLERANCE))
        self._arrays: Any = None
        is_auto = isinstance(algorithm, str) and algorithm in ("auto", "daqp")
        one = problem.matrices
        if is_auto and not options.keys() - {"tolerance"} and one.is_small and one.has_curvature:
            is_full = one.is_semidefinite and bool((one.counts > 1).all())
            if (
                is_full
                and is_one_dense_component(one.terms)
                and is_installed("daqp")
                and has_numba()
            ):
                m, p, n, _ = one.sizes
                vectors = problem.c, problem.h, problem.b, problem.lower, problem.upper
                sense = np.zeros(n + m + p, np.intc)
                sense[n + m :] = EQUATION
                matrices = [np.array(each, order="C") for each in one.stacked]
                self._arrays = matrices, vectors, sense

    def solve(
        self,
        *,
        c: ArrayLike | None = None,
        h: ArrayLike | None = None,
        b: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        z0: ArrayLike | None = None,
        warm: bool = False,
    ) -> QuadraticProgramResult:
        """Return the result of the program with these vectors; vectors that are not passed are the prepared program's.

        Parameters
        ----------
        c, h, b, lower, upper : arrays
            As for :meth:`lcp_plugin.QuadraticProgram.with_vectors`.
        z0, warm
            A start, or whether the last result is one; external solvers ignore it.

        Raises
        ------
        InvalidProblem, InvalidOption
            As :class:`lcp_plugin.QuadraticProgram` and :func:`lcp_plugin.solve`.
        """
        data = c, h, b, lower, upper
        if self._arrays is not None and z0 is None and not warm:
            found = self._solve_quickly(data)
            if found is not None:
                self.last = found
                return found
        return self._result_of(self.problem.with_vectors(*data), warm, z0=z0)

    def _solve_quickly(self, data: Any) -> QuadraticProgramResult | None:
        """Return daqp's point if the compiled test accepts it, and nothing hints at a program without a minimum."""
        began, ((P, C), own, sense) = perf_counter(), self._arrays
        data = [_copy_of(one, prepared) for one, prepared in zip(data, own, strict=True)]
        if any(one is None for one in data):
            return None
        (c, h, b, lower, upper), n, m = data, own[0].size, own[1].size
        d = np.concatenate((h, b))
        if not (c @ c < NO_LIMIT**2 and d @ d < NO_LIMIT**2 and (lower <= upper).all()):
            return None
        above, below = np.concatenate((upper, d)), np.concatenate((lower, d))
        below[n : n + m] = -math.inf
        x, y, *_ = call_daqp(P, c.copy(), C, above, below, sense, DAQP.defaults)
        x, y = np.minimum(np.maximum(x, lower), upper), y[n:]
        primal, gap = dense_errors(P, c, C, d, m, lower, upper, x, y)
        is_certain = primal <= CERTAIN_ROWS and np.abs(x).max() <= FAR
        if not (is_certain and gap <= 0.5 * self._settings.tolerance):
            return None
        solution, found = object.__new__(QPSolution), object.__new__(QuadraticProgramResult)
        vars(solution).update(x=read_only(x), _make=partial(self._solution, data, x, y))
        make = partial(self._record, perf_counter() - began)
        vars(found).update(solution=solution, status=Status.SOLVED, _make=make)
        return found

    def _solution(self, data: Any, x: Vector, y: Vector) -> dict[str, Any]:
        """Return the fields of the solution of the short way."""
        return vars(QPSolution.from_reduced(self.problem.with_vectors(*data), x, y))

    def _record(self, seconds: float) -> dict[str, Any]:
        """Return the fields of the result of the short way."""
        stage = StageRecord("daqp", "prepared", 1, 0.0)
        how = {"algorithm": "auto: daqp", "iterations": 1, "seconds": seconds, "stages": (stage,)}
        return how | {"tolerance": self._settings.tolerance}


class PreparedContact(PreparedProblem[FrictionalContact, ConeResult]):
    """Solver of contact problems that differ from a prepared one in b or W."""

    def solve(
        self,
        *,
        b: ArrayLike | None = None,
        W: AnyMatrix = None,
        z0: ArrayLike | None = None,
        warm: bool = False,
    ) -> ConeResult:
        """Return the result of the problem with these data; data that are not passed are the prepared problem's.

        Parameters
        ----------
        b, W, z0
            As for :class:`lcp_plugin.FrictionalContact` and :func:`lcp_plugin.solve`.
        warm : bool
            Start from the last result, if there is one.
        """
        one = self.problem
        if W is not None:
            how = {"dimension": one.dimension, "equations": one.equations}
            one = FrictionalContact(W, one.b if b is None else b, one.friction, **how)
        elif b is not None:
            one = copy(one)
            one.rows = one.rows.with_q(np.ravel(b))
        return self._result_of(one, warm, z0=z0)


class PreparedNonlinear(PreparedProblem[NonlinearProblem, Result]):
    """Solver of a prepared nonlinear problem from one start after another; F may read data that you change."""

    def solve(self, *, x0: ArrayLike | None = None, warm: bool = False) -> Result:
        """Return the result from a start, or with `warm` from the last result."""
        return self._result_of(self.problem, warm, x0=x0)


class PreparedLeastSquares(PreparedProblem[BoundedLeastSquares, LeastSquaresResult]):
    """Solver of least squares problems that differ from a prepared one in vectors."""

    def solve(
        self,
        *,
        b: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        x0: ArrayLike | None = None,
        warm: bool = False,
    ) -> LeastSquaresResult:
        """Return the result of the problem with these vectors, which are as of its `with_vectors`, and a start."""
        one = self.problem
        if any(vector is not None for vector in (b, lower, upper)):
            one = one.with_vectors(b, lower, upper)
        return self._result_of(one, warm, x0=x0)


PREPARED: dict[str, Any] = {
    "LCP": PreparedLCP,
    "QuadraticProgram": PreparedProgram,
    "FrictionalContact": PreparedContact,
    "NonlinearProblem": PreparedNonlinear,
    "BoundedLeastSquares": PreparedLeastSquares,
}


@overload
def prepare(problem: LCP, algorithm: Any = "auto", **options: Any) -> PreparedLCP: ...
@overload
def prepare(
    problem: QuadraticProgram, algorithm: Any = "auto", **options: Any
) -> PreparedProgram: ...
@overload
def prepare(
    problem: FrictionalContact, algorithm: Any = "auto", **options: Any
) -> PreparedContact: ...
@overload
def prepare(
    problem: NonlinearProblem, algorithm: Any = "auto", **options: Any
) -> PreparedNonlinear: ...
@overload
def prepare(
    problem: BoundedLeastSquares, algorithm: Any = "auto", **options: Any
) -> PreparedLeastSquares: ...
@np.errstate(all="ignore")
def prepare(problem: Any, algorithm: Any = "auto", **options: Any) -> Any:
    """Return a solver for a loop: of the problem, and of others that differ from it in some data.

    The solver checks, lays out and factorizes once what does not change. ``step.problem`` is the prepared problem;
    :func:`lcp_plugin.solve_batch` takes the solver in its place. Data that a call does not pass are the prepared
    problem's, not the last call's. Each result has the status of :func:`lcp_plugin.solve`.

    Parameters
    ----------
    problem : LCP, QuadraticProgram, FrictionalContact, NonlinearProblem or BoundedLeastSquares
    algorithm, **options
        As for :func:`lcp_plugin.solve`.

    Returns
    -------
    PreparedLCP
        With ``solve(q=, M=, lower=, upper=, z0=)``; of a program ``solve(c=, h=, b=, lower=, upper=)``, of a contact
        problem ``solve(b=, W=, z0=)``, of a nonlinear problem ``solve(x0=)``, of least squares ``solve(b=, lower=,
        upper=, x0=)``. With ``warm=True``, a solve starts from the last result.

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        For other problem classes, and as :func:`lcp_plugin.solve`.
    UnsupportedModel
        If a program is not convex.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> step = prepare(LCP([[2, -1], [-1, 2]], [-1, 0]))
    >>> [float(step.solve(q=np.array([-1.0, q])).z[0].round(6)) for q in (0.0, 1.0)]
    [0.666667, 0.5]
    """
    for kind, one in PREPARED.items():
        if class_of(problem) == kind:
            return one(problem, algorithm, options)
    raise InvalidOption(refusal("prepare", problem))
