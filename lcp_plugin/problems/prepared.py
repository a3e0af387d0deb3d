"""`prepare`: a solver of many problems that differ in some data, as in the loop of a controller.

A small dense LCP or program takes a short way: a kernel or an external solver, and one sufficient test, which
implies the criterion. If the test does not decide, or if options watch or limit the run, the solver of `solve` runs.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np

from ..core.checks import (
    INFINITE_LIMIT,
    Array,
    Vector,
    checked_bounds,
    checked_start,
    checked_vector,
    is_plain,
    read_only,
)
from ..core.deadline import Clock
from ..core.entries import clip
from ..core.errors import InvalidOption, did_you_mean
from ..core.lcp import LCP
from ..core.problem import check_labels
from ..core.problem_classes import class_of
from ..core.settings import DEFAULTS, Status, flag
from ..engines.engine import EngineStatus
from ..engines.solvers import DAQP, ends_of_rows
from ..judges.lcp import Measured, row_data
from ..judges.program import NO_POLISH, JudgedProgram, KKTErrors, sharp_errors
from ..methods.lemke import Lemke
from ..methods.small import LOOP_UP_TO, arrays_of_one, bounded_ends, has_numba, is_small
from ..solving.dispatch import parse_call, solver_with
from ..solving.result import NOTHING_TO_DO, Result, StageRecord
from ..solving.run import with_samples
from .programs.program import QuadraticProgram, refuse_nonconvex
from .programs.solution import QPSolution
from .programs.solving import (
    CERTAIN_ROWS,
    FAR,
    checked_start_of_program,
    infeasible_result,
    parsed,
    result_of_daqp,
)

P = TypeVar("P")


class PreparedProblem(Generic[P]):
    """Solver of a prepared problem and of others that differ from it in some data; threads may share it.

    Attributes
    ----------
    problem : the problem class
    last : result of the latest call, or None
    """

    def __init__(self, problem: P, algorithm: Any, options: dict[str, Any]) -> None:
        self.problem = problem
        self.last: Any = None
        self._solve_fully = solver_with(problem, algorithm, dict(options), "prepare")
        stated: Any = problem
        self._known = [stated.start_name, *stated.vector_names, *stated.matrix_names]

    def solve(self, *values: Any, warm: bool = False, **data: Any) -> Any:
        """Return the result of the problem with these data; data that are not passed are the prepared problem's.

        Parameters
        ----------
        warm : bool
            Start from the last result, if there is one.
        **data
            Data and starts, by the names that :func:`prepare` lists.

        Raises
        ------
        InvalidProblem, InvalidOption
            As the constructor of the problem and :func:`lcp_plugin.solve`.
        """
        if values:
            raise InvalidOption(f"data have names: write step.solve({self._known[1]}=…)")
        if unknown := data.keys() - self._known:
            name, known = min(unknown), [*self._known, "warm"]
            hint = "; the linear term is called c" if name == "q" and "c" in known else ""
            hint = hint or f"{did_you_mean(name, known)}; options of a run belong to prepare"
            raise InvalidOption(f"step.solve takes no {name}{hint}")
        problem: Any = self.problem
        check_labels(problem, data)
        start = data.pop(problem.start_name, None)
        if flag(warm, "warm") and start is None and not getattr(self.last, "has_no_solution", True):
            start = self.last.x
        result = self._solve_quickly(start, **data)
        if result is None:
            how = {} if start is None else {problem.start_name: start}
            changed = problem.with_data(**data) if data else problem
            result = self._solve_fully(changed, **how)
        self.last = result
        return result

    def _solve_quickly(self, start: Any, **data: Any) -> Any:
        """Return the result of the short way, or None."""


class PreparedLCP(PreparedProblem[LCP]):
    """Solver of LCPs that differ from the prepared problem in q, M or bounds."""

    def __init__(self, problem: LCP, algorithm: Any, options: dict[str, Any]) -> None:
        super().__init__(problem, algorithm, options)
        self._method, self._settings = parse_call(algorithm, dict(options))
        settings, is_free = self._settings, options.keys().isdisjoint({"z0", "callback"})
        is_path = is_free and self._method in (None, Lemke()) and has_numba()
        is_short = is_path and settings.has_steps and is_small(problem) and problem.n <= LOOP_UP_TO
        self._arrays: Any = arrays_of_one(problem) if is_short else None

    def _solve_quickly(self, start: Any, **data: Any) -> Any:
        """Return the start or the end of Lemke's path if the quick test accepts it; NaN and infinities do not pass."""
        if self._arrays is None:
            return None
        clock, settings, n = Clock(), self._settings, self.problem.n
        A, b, low, high, nearest = self._arrays
        q, M, lower, upper = map(data.get, ("q", "M", "lower", "upper"))
        if q is not None:
            b = copied(q, "q", n)[np.newaxis]
        if M is not None:
            M = M if is_plain(M, n, n) else self.problem.with_data(q=q, M=M).matrix.toarray()
            A = copied(M, "M", n, n)[np.newaxis]
        if lower is not None or upper is not None:
            bounds = low[0] if lower is None else lower, high[0] if upper is None else upper
            low, high = (row[np.newaxis] for row in checked_bounds(*bounds, n))
            nearest = read_only(clip(0.0, low, high))
        if start is not None:
            is_right = is_plain(start, n) and np.isfinite(start).all()
            start = start.copy() if is_right else checked_start(self.problem, start)
        arrays = A, b, low, high, nearest
        begin = math.nan if start is None else start
        points, residuals = bounded_ends(arrays, settings.tolerance, begin)
        z, bound = points[0], residuals.item(0)
        if not bound < math.inf:
            return None
        near = nearest[0] if start is None else start
        make = partial(self._record, arrays, near, z, clock.read())
        fixed = {"status": Status.SOLVED, "absolute_tolerance": settings.absolute_tolerance}
        result = Result.of_known(make, z=read_only(z), **fixed, _asked=self._method)
        if not settings.is_watched:
            return result
        problem = result.certificate.problem
        with np.errstate(all="ignore"):
            begun = near, 1.0 if start is None else row_data(problem).estimate(near)
        return with_samples(problem, result, settings, None, begun, bound)

    def _record(self, arrays: Array, start: Vector, z: Vector, seconds: float) -> Result:
        """Return the result of the short way with all fields."""
        parts = zip(("M", *LCP.vector_names), arrays, self._arrays, strict=False)
        changed = {name: one[0] for name, one, before in parts if one is not before}
        problem = self.problem.with_data(**changed) if changed else self.problem
        is_start = (z == start).all()
        work, because = (0.0, NOTHING_TO_DO) if is_start else (float(problem.n), "prepared")
        stage, point = StageRecord("lemke", because, int(work > 0.0), work), Measured(z, 0.0, True)
        return Result.of(problem, point, [stage], self._settings, seconds, self._method)


def copied(values: object, name: str, *shape: int) -> Vector:
    """Return a read-only copy; other values than doubles of this shape are checked and converted to a vector.

    NaN and infinities in doubles stay, and do not pass the test of the short way.
    """
    return (
        read_only(np.array(values, order="C"))
        if is_plain(values, *shape)
        else checked_vector(values, name, *shape)
    )


class PreparedProgram(PreparedProblem[QuadraticProgram]):
    """Solver of programs that differ from the prepared problem in vectors or matrices."""

    def __init__(self, problem: QuadraticProgram, algorithm: Any, options: dict[str, Any]) -> None:
        super().__init__(problem, algorithm, options)
        refuse_nonconvex(problem)
        settings = self._settings = parsed(algorithm, **options)[2]
        self._arrays: Any = None
        base, least = problem.matrices, DAQP.defaults["iter_limit"]
        has_time = settings.max_iterations >= least and settings.max_seconds > 0.0
        is_bare = options.keys() <= DEFAULTS.keys() and algorithm in ("auto", "daqp")
        is_dense = (base.terms.counts > 1).all() and base.terms.is_dense
        if has_time and is_bare and is_dense and base.of_daqp and not settings.is_watched:
            vectors = {name: getattr(problem, name) for name in problem.vector_names}
            self._arrays = base.of_daqp, vectors

    @np.errstate(all="ignore")  # of a point that is not finite
    def _solve_quickly(self, start: Any, **data: Any) -> Any:
        """Return daqp's point if plain sums accept it, and nothing hints at a program without a minimum."""
        if self._arrays is None or not data.keys().isdisjoint(self.problem.matrix_names):
            return None
        clock, (layout, vectors) = Clock(), self._arrays
        if start is not None:
            checked_start_of_program(self.problem, start)
        items = data.items()
        copies = {k: one.copy() for k, one in items if is_plain(one, *vectors[k].shape)}
        if len(copies) < len(data):  # the constructor converts and checks other data
            changed = self.problem.with_vectors(**data)
            copies = {name: getattr(changed, name) for name in data}
        c, h, b, lower, upper = every = [*(vectors | copies).values()]
        d, m = np.concatenate((h, b)) if b.size else h, h.size
        # NaN in other data does not pass the test; the constructor checks bounds that cross
        has_bounds = "lower" in data or "upper" in data
        if not d.dot(d) < INFINITE_LIMIT**2 or (has_bounds and not (lower <= upper).all()):
            return None
        ends = ends_of_rows(d, m, lower, upper)
        end = DAQP.end_of(m, *layout, c.copy(), *ends, DAQP.defaults)
        if end.reported is EngineStatus.INFEASIBLE:
            changed = self.problem.with_vectors(*every)
            return infeasible_result(changed, end, self._settings, clock.read())
        x, y = clip(end.x, lower, upper), end.y
        judged = JudgedProgram(self.problem.matrices.terms, c, d, lower, upper)
        errors, most = sharp_errors(judged, x, y), 0.5 * self._settings.tolerance
        if not errors.gap <= most:  # multipliers of active bounds count; then by the rule of solve
            errors, x = KKTErrors.with_point(judged, x, y, self._settings.tolerance)
            most = min(most, NO_POLISH * (x.size + y.size))
        is_certain = errors.primal <= CERTAIN_ROWS and x.dot(x) <= FAR**2
        if not (is_certain and errors.gap <= most):
            return None
        solution = QPSolution.of_known(partial(self._solution, every, x, y), x=read_only(x))
        known = {"status": Status.SOLVED, "solution": solution}
        return result_of_daqp(end, "prepared", self._settings, clock.read(), **known)

    def _solution(self, data: list[Any], x: Vector, y: Vector) -> QPSolution:
        return QPSolution.from_reduced(self.problem.with_vectors(*data), x, y)


PREPARED: dict[str | None, type[PreparedProblem[Any]]] = {
    "LCP": PreparedLCP,
    "QuadraticProgram": PreparedProgram,
}


@np.errstate(all="ignore")
def prepare(problem: Any, algorithm: Any = "auto", **options: Any) -> PreparedProblem[Any]:
    """Return a solver for a loop: of the problem, and of others that differ from it in some data.

    The solver checks and lays out once what does not change; properties of a matrix, such as a factorization, are
    computed by the first solve that needs them. ``step.problem`` is the prepared problem;
    :func:`lcp_plugin.solve_batch` takes the solver in its place. Data that a call does not pass are the prepared
    problem's, not the last call's. Each result has the status of :func:`lcp_plugin.solve`.

    Parameters
    ----------
    problem : LCP, QuadraticProgram, FrictionalContact, NonlinearProblem or BoundedLeastSquares
    algorithm, **options
        As for :func:`lcp_plugin.solve`.

    Returns
    -------
    PreparedProblem
        Of an LCP with ``solve(q=, lower=, upper=, M=, z0=)``; of a program with ``solve(c=, h=, b=, lower=, upper=,
        P=, G=, A=, z0=)``; of a contact problem with ``solve(b=, W=, z0=)``; of least squares with ``solve(b=, l1=,
        lower=, upper=, A=, weights=, ridge=, x0=)``; of a nonlinear problem, of which F may read data that you
        change, with ``solve(q=, lower=, upper=, x0=)``, q added to F. With ``warm=True``, a solve starts from the
        last result.

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
    return PREPARED.get(class_of(problem), PreparedProblem)(problem, algorithm, options)
