"""Programs answered by engines of others: reduced, prepared, answered, polished, and judged by the program's criterion.

An engine is given the program without empty rows and rows that are bounds, where it is large, its rows of one size
(:mod:`lcp_plugin.engines.statement`). Its point, and the same after one step to the linear system of its case
(:mod:`lcp_plugin.engines.polish`), are judged on the program as it was given. Where neither is right, limits far beyond
all others are left out and the engine is asked again; those that its answer breaks are put back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from ...core.checks import are_finite, are_no_limits
from ...core.deadline import is_over, seconds_left
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.kernels.floats import NEGLIGIBLE
from ...core.matrix.matrix import largest_in_rows
from ...core.solving.result import StageRecord
from ...engines import Engine, Hint, Limits, Multipliers, Point, Statement, engine_class
from ...engines.polish import polished
from ...engines.statement import Prepared, far_limits
from .convexity import refuse_nonconvex
from .criterion import Errors, program_goal
from .no_minimum import QPInfeasibility, QPUnboundedness
from .program import QuadraticProgram
from .program_matrices import as_csr
from .reductions import FoldedRows, Reduction
from .solution import QPSolution

SHARPEST = 4  # points: as it came, and polished, each with its noise and without
NOISE = 2.0**-44
CALLS = 4  # of an engine for one program
DENSE_AT_LAST = 1500  # unknowns and rows: an active set sees through numbers that steps between the bounds do not
PROXIMAL = {
    "eps_prox": 1e-6,
    "eta_prox": 1e-12,
}  # of daqp, where P is nothing beside its prox: until x stands still

Answered = tuple[Iterator[QPSolution], Point]


class EngineRun(NamedTuple):
    """What an engine came to.

    Attributes
    ----------
    solution : QPSolution
        The best of its points, polished or not, by the program's own measures.
    says : Hint
        What the engine says of its last one.
    stage : StageRecord
    meets_goal : bool
        Whether that solution meets the goal.
    contradicts : bool
        Whether the constraints are seen to contradict, which has ended the run; nothing is proved.
    is_sure : bool
        Whether it is known already that no exact proof may beat the solution.
    """

    solution: QPSolution
    says: Hint
    stage: StageRecord
    meets_goal: bool
    contradicts: bool
    is_sure: bool = False

    def proof(self, goal: float) -> QPInfeasibility | QPUnboundedness | None:
        """Return a proof that beats the solution, looked for where it is not sure that there is none.

        Of a contradiction only where the solution is not optimal, or the engine has called the program infeasible.
        """
        solution, facts = self.solution, self.solution.program.facts
        is_met = self.meets_goal and (
            self.says is not Hint.INFEASIBLE or solution.holds_surely(goal)
        )
        if self.is_sure or solution.is_sure(goal) or (is_met and solution.balances_surely(goal)):
            return None
        return facts.accepted_proof(goal, is_met=is_met)


def engines_for(program: QuadraticProgram) -> Iterator[Engine]:
    """Yield the engines that auto asks, the quickest first; none where bounds are all that holds x.

    Under a limit of seconds a large program is left to those that keep it.

    Examples
    --------
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> [engine.name for engine in engines_for(program)]
    ['daqp', 'piqp', 'clarabel', 'daqp']
    """
    m, p, n, _ = program.matrices.sizes
    if m + p == 0 and program.matrices.has_curvature:
        return  # a complementarity problem with M = P: what this package is for
    if program.matrices.is_small:
        yield engine_class("daqp")()
    if program.matrices.is_small or seconds_left() == np.inf:
        yield engine_class("piqp")()
    if not program.matrices.has_curvature:
        yield engine_class("highs")()
    yield engine_class("clarabel")()
    if n + m + p <= DENSE_AT_LAST:
        yield engine_class("daqp")(**PROXIMAL)


def solved_as_given(program: QuadraticProgram, goal: float) -> EngineRun | Point | None:
    """Return the answer of an active set to a small program as it stands, if it is surely right; else its point.

    Most small programs end here, in half the time that others take to begin. None where it is not asked.
    """
    is_asked = program.matrices.is_small and program.matrices.is_judged_by_sums
    engine = next(engines_for(program), None) if is_asked else None
    if engine is None or not engine.ends_with_a_case or program.matrices.negative_curvature:
        return None
    with np.errstate(all="ignore"):
        point = engine.answer(_statement(program, is_dense=True), Limits(seconds_left()))
        has_limits = not are_no_limits(program.lower, program.upper)
        for measure, near in _ways_to_judge(point):
            x, y = near.x, np.concatenate(near.multipliers)
            if has_limits:
                x = np.clip(x, program.lower, program.upper)
            if not (are_finite(x) and are_finite(y)):
                break
            errors = measure(program, x, y)
            if errors.decide(goal) and errors.are_sure(goal):
                stage = StageRecord(engine.name, engine.solves, point.iterations, 0.0)
                return EngineRun(
                    QPSolution.of_rows(program, x, y), point.says, stage, True, False, True
                )
    return point


def _ways_to_judge(point: Point) -> Iterator[tuple[Callable[..., Errors], Point]]:
    """Yield what measures a point, and the point, or the same without noise; the quickest first."""
    yield Errors.above, point
    others = list(without_noise(point))
    yield from ((Errors.above, other) for other in others)
    yield from ((Errors.beside_own_terms, other) for other in (point, *others))


def solved_at_once(
    program: QuadraticProgram, tolerance: float, *, is_sharp: bool = False
) -> EngineRun | None:
    """Return the answer of the quickest engine, polished where it is to be sharp; None where it has none."""
    engine = next(engines_for(program), None)
    if engine is None:
        return None
    goal = program_goal(tolerance)
    run = run_engine(program, engine, 0.0 if is_sharp else goal, points=SHARPEST)
    return run if run.solution.is_minimal(goal) else None


def run_engine(
    program: QuadraticProgram,
    engine: Engine,
    goal: float,
    *,
    is_verbose: bool = False,
    points: int | None = None,
    begun: Point | None = None,
) -> EngineRun:
    """Return the best answer of an engine, which ends with the first that meets the goal, or after some points.

    Where it has begun with the program as it stands, with what it has come to.

    Raises
    ------
    UnsupportedModel
        Where the program is not convex.
    UnsuitableProblem
        Where the engine takes linear programs alone, and it is none.
    """
    if engine.is_for_linear_alone and program.matrices.has_curvature:
        raise UnsuitableProblem(
            f'{engine.name} solves {engine.solves}, but P has nonzeros; take "piqp", or give P = None'
        )
    iterations, says, meets_goal, contradicts = 0, Hint.GAVE_UP, False, False
    best: QPSolution | None = None
    with np.errstate(all="ignore"):  # what is beyond the range of doubles is no answer
        for near, point in islice(
            _answers(program, engine, is_verbose, begun), 1 if points else None
        ):
            iterations, says = iterations + point.iterations, point.says
            solution, meets_goal = _best(islice(near, points), goal, in_order=points is not None)
            if solution is not None and (meets_goal or best is None or solution.error < best.error):
                best = solution
            if meets_goal or is_over():
                break
            if says is Hint.INFEASIBLE and (
                contradicts := program.facts.sees_contradiction(goal, point.multipliers)
            ):
                break
    if best is None:
        nearest, nothing = (
            np.clip(0.0, program.lower, program.upper),
            np.zeros(sum(program.matrices.sizes)),
        )
        best = QPSolution.of_rows(program, nearest, nothing)
        meets_goal = not contradicts and best.is_minimal(goal)
    stage = StageRecord(engine.name, engine.solves, iterations, 0.0)
    return EngineRun(best, says, stage, meets_goal, contradicts)


def _best(
    near: Iterable[QPSolution], goal: float, *, in_order: bool
) -> tuple[QPSolution | None, bool]:
    """Return the first of some points that meets the goal, beside own terms if one does, or the best; and whether.

    In order where proofs rest on the multipliers as they came: what is rounding may be what a bound needs.
    """
    judged = list[QPSolution]()
    for solution in near:
        if solution.is_minimal(goal, is_beside_own=not in_order):
            return solution, True
        judged.append(solution)
    for solution in sorted(
        judged, key=lambda one: sum(one.own_errors)
    ):  # what acts takes as long as an engine
        if solution.is_minimal(goal):
            return solution, True
    return min(judged, key=lambda one: one.error, default=None), False


def _answers(
    program: QuadraticProgram, engine: Engine, is_verbose: bool, begun: Point | None
) -> Iterator[Answered]:
    """Yield the points of an engine, polished and as they came, of one statement of the program after the other."""
    refuse_nonconvex(program)
    reduction = Reduction(program)
    if not program.matrices.is_small:
        reduction = reduction.then(FoldedRows.of)
    given = _statement(reduction.reduced)
    prepared = Prepared.of(given)
    point = _asked(engine, prepared, is_verbose) if begun is None else prepared.inward(begun)
    yield from _points(reduction, prepared, point)
    is_far = far_limits(given)
    units = reduction.reduced.facts.fitted_units
    if (units != 1.0).any():
        prepared = Prepared.of(given, None, units)
        yield from _points(reduction, prepared, _asked(engine, prepared, is_verbose))
    for _ in range(CALLS if is_far.any() else 0):
        prepared = Prepared.of(given, is_far, units)
        point = _asked(engine, prepared, is_verbose)
        yield from _points(reduction, prepared, point)
        x = point.x * units
        if not np.isfinite(x).all():
            return
        broken = np.concatenate([given.G @ x - given.h, given.lower - x, x - given.upper]) > 0.0
        if not (is_far & broken).any():
            return
        is_far = is_far & ~broken


def _asked(engine: Engine, prepared: Prepared, is_verbose: bool) -> Point:
    """Return the point of an engine; where no unknown is left, all that is to say is whether the rows hold."""
    statement = prepared.statement
    if not statement.c.size:
        empty, of_rows = np.zeros(0), (np.zeros(statement.h.size), np.zeros(statement.b.size))
        return Point(empty, Multipliers(*of_rows, empty, empty), 0, Hint.GAVE_UP)
    try:
        return engine.answer(statement, Limits(seconds_left(), is_verbose))
    except Exception as error:  # whatever another package raises of an option's value
        if not engine.options:
            raise
        given = ", ".join(f"{name}={value!r}" for name, value in engine.options.items())
        raise InvalidOption(f"{engine.name} does not take {given}: {_in_short(error)}") from error


def _points(reduction: Reduction, prepared: Prepared, point: Point) -> Iterator[Answered]:
    """Yield what becomes of an engine's point, and that: polished and as it came, then at 0 and at rest.

    Where the engine has only a word and no point, no solution either.
    """
    told = point
    if point.says is Hint.INFEASIBLE:
        told = point._replace(multipliers=_contradiction(reduction, prepared, point))
        yield iter(()), told
        told = told._replace(iterations=0)
    if not np.isfinite(np.concatenate([point.x, *point.multipliers])).all():
        yield iter(()), told
        return
    statement, polishes = prepared.statement, list[Point]()

    def polish() -> Iterator[Point]:
        for one in () if is_over() else polished(statement, point):
            polishes.append(one)
            yield one

    def solutions(*points: Iterable[Point]) -> Iterator[QPSolution]:
        for one in chain(*points):
            for near in chain([one], without_noise(one)):
                if (solution := _solution(reduction, prepared, near)) is not None:
                    yield solution

    has_limits = (
        statement.h.size or np.isfinite(statement.lower).any() or np.isfinite(statement.upper).any()
    )
    yield solutions(polish(), [point]) if has_limits else solutions([point], polish()), told
    # Where the answer is 0, all of x is noise, and nothing tells it from an answer but the judge.
    first = (polishes or [point])[0]
    at_zero = first._replace(x=np.zeros(first.x.size))
    yield solutions([at_zero], at_rest(statement, first)), told._replace(iterations=0)


def without_noise(point: Point) -> Iterator[Point]:
    """Yield the point with 0 in place of x and multipliers that are rounding beside the largest, if any."""
    x, y = point.x, np.concatenate(point.multipliers)
    of_x, of_y = np.abs(x), np.abs(y)
    in_x, in_y = of_x <= NOISE * of_x.max(initial=0.0), of_y <= NOISE * of_y.max(initial=0.0)
    if x[in_x].any() or y[in_y].any():
        kept = np.split(
            np.where(in_y, 0.0, y), np.cumsum([part.size for part in point.multipliers[:-1]])
        )
        yield point._replace(x=np.where(in_x, 0.0, x), multipliers=Multipliers(*kept))


def _in_short(error: Exception) -> str:
    """Return the first sentence that another package has for an error; of a binding's list of signatures its head."""
    return str(error).splitlines()[0].removeprefix("(): ").partition(". The following")[0]


def at_rest(statement: Statement, point: Point) -> Iterator[Point]:
    """Yield a point without what is rounding beside its equations, where no force is left: no multiplier is, either.

    Of residuals that an equation defines, as cvxpy's t = A x − b where t = 0, nothing else is known.
    """
    A, b, x = as_csr(statement.A), statement.b, point.x
    terms = np.maximum(np.abs(b), largest_in_rows(A, np.abs(A.data * x[A.indices])))
    noise = np.zeros(x.size)
    with np.errstate(all="ignore"):
        np.maximum.at(
            noise, A.indices, NEGLIGIBLE * np.repeat(terms, np.diff(A.indptr)) / np.abs(A.data)
        )
    x = np.where(np.abs(x) <= noise, 0.0, x)
    if not (statement.P @ x + statement.c).any():
        yield point._replace(
            x=x, multipliers=Multipliers(*(np.zeros_like(one) for one in point.multipliers))
        )


def _solution(reduction: Reduction, prepared: Prepared, point: Point) -> QPSolution | None:
    """Return what a point of a prepared statement is in the program; None where that is not finite."""
    back, reduced = prepared.outward(point), reduction.reduced
    x = np.minimum(np.maximum(back.x, reduced.lower), reduced.upper)
    whole = reduction.outward(x, np.concatenate(back.multipliers))
    return (
        QPSolution.of_rows(reduction.program, *whole)
        if np.isfinite(np.concatenate(whole)).all()
        else None
    )


def _contradiction(reduction: Reduction, prepared: Prepared, point: Point) -> Multipliers:
    """Return the multipliers of an engine that calls a program infeasible, as some of the program's constraints."""
    whole = np.concatenate(prepared.outward(point).multipliers)
    for step in reversed(reduction.steps):
        whole = step.multipliers(whole, None)
    ends = np.cumsum(reduction.program.matrices.sizes)[:-1]
    return Multipliers(*np.split(whole, ends))


def _statement(program: QuadraticProgram, *, is_dense: bool = False) -> Statement:
    """Return a program as engines take it: all matrices dense, or all sparse."""
    matrices, (m, _, n, _) = program.matrices, program.matrices.sizes
    if matrices.is_judged_by_sums and (is_dense or matrices.is_dense):
        P, G, A = matrices.stacked[:n], matrices.stacked[n : n + m], matrices.stacked[n + m :]
    elif matrices.is_dense:
        P, G, A = (
            one if isinstance(one, np.ndarray) else one.toarray()
            for one in (program.P, program.G, program.A)
        )
    else:
        P, G, A = matrices.sparse_P, as_csr(program.G), as_csr(program.A)
    return Statement(P, program.c, G, program.h, A, program.b, program.lower, program.upper)


__all__ = ["EngineRun", "engines_for", "run_engine", "solved_at_once"]
