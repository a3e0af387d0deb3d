"""Solves convex quadratic programs by `solve`: external solvers, and a run on the LCP; tested on the program itself.

Points of external solvers: scaled, cleaned and polished, and tested on the unscaled program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ...core.algorithm import Step
from ...core.checks import Vector, vector_option
from ...core.deadline import Clock, is_over, seconds_left, time_limit
from ...core.errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem, UnsupportedModel
from ...core.settings import DEFAULTS, OF_SOLVE, Settings, Status
from ...engines import ENGINES, engine_class, has_piqp, installed_engine, is_installed, scaling
from ...engines.engine import Engine, EngineAnswer, EngineStatus, ProgramData, SolverLimits
from ...engines.polish import ROUNDS, polish_steps
from ...engines.solvers import DAQP, point_of_daqp
from ...judges.program import PROGRAM_TOLERANCE, SHARP, KKTErrors
from ...methods.interior_point import InteriorPoint
from ...solving.dispatch import parse_call
from ...solving.lcp_solver import solve_lcp
from ...solving.result import Sample, StageRecord
from ...solving.run import Named, Progress, Run, Stage, say
from .conversion import optimality_conditions
from .no_minimum import NoMinimum, QPUnboundedness, known_proof, numbers, proof_of_contradiction
from .program import QuadraticProgram, refuse_nonconvex
from .program_matrices import ProgramMatrices
from .regression import Outward, regression_of, solutions
from .result import ADVICE, QuadraticProgramResult
from .solution import QPSolution

NO_MINIMUM = (EngineStatus.INFEASIBLE, EngineStatus.UNBOUNDED)
Scaled = Iterable[scaling.ScaledProgram]


def unscaled(data: ProgramData, matrices: ProgramMatrices) -> Scaled:
    """Return the program in the user's scaling."""
    return [scaling.ScaledProgram(data, np.ones(1), np.ones(1), 1.0).with_modest_costs()]


def fitted(data: ProgramData, matrices: ProgramMatrices) -> Scaled:
    """Return the program in the scaling fitted to its matrices."""
    return _without_far_limits(data, matrices.engine_units)


def sides_about_one(data: ProgramData, matrices: ProgramMatrices) -> Scaled:
    """Return the program in a scaling in which limits and costs are about 1."""
    return map(scaling.with_sides_about_one, _without_far_limits(data, matrices.largest_units))


def _without_far_limits(data: ProgramData, scales: Any) -> Scaled:
    """Return the scaled program; first without very large limits, if it has some."""
    one = scaling.ScaledProgram.from_units(data, *scales).with_modest_costs()
    near = scaling.without_far_limits(one.statement)
    return [one] if near is one.statement else [one._replace(statement=near), one]


Scaling = Callable[[ProgramData, ProgramMatrices], Scaled]
# PIQP's points for 29 published programs fail the test more often at 1e-11 than at 1e-12, and 1e-13 takes 1.5 times the
# steps for some of them. Dense kernel matrices of 1 000 rows reach neither, after all 150 steps.
# A run of PIQP that converges takes 10 to 45 steps. On an assignment of 60 × 60, whose point is optimal after 15 steps,
# it does not reach 1e-12 in 250 steps. A chain of second differences of 2 400 points passes only in `sides_about_one`.
ATTEMPTS: tuple[tuple[str, float | None, int | None, Scaling], ...] = (
    # engine, tolerance of its own, limit of steps in auto if not the engine's default, scaling
    ("daqp", None, None, unscaled),
    ("piqp", 1e-12, 60, fitted),
    ("piqp", 1e-13, None, fitted),
    ("piqp", 1e-12, None, sides_about_one),
    ("highs", None, None, fitted),
    ("clarabel", 1e-12, None, unscaled),
    ("clarabel", 1e-9, None, sides_about_one),
)
# With much fill, a step of PIQP takes up to 10 s, and nothing interrupts it. HiGHS pivots; Clarabel's factorization is
# up to 20 times as fast then.
WITH_FILL = "highs", "clarabel", "daqp", "piqp"
# steps of an external solver: a polish, of two factorizations, takes a tenth of its time
POLISH_FROM = 20
TOLERANCES = MappingProxyType(
    {
        "piqp": ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
        "clarabel": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    }
)


class ProgramPoint(NamedTuple):
    """Measured point of a run, as :class:`~lcp_plugin.judges.lcp.Measured`.

    Attributes
    ----------
    solution : QPSolution
        Of an engine the best of its points: original, cleaned or polished.
    errors : KKTErrors
        Two measures of the solution.
    passes : bool
        Whether the measures meet the tolerance.
    says : EngineStatus
        Status that the engine reports for its last point.
    name : str
    iterations : int
    is_limited : bool
        False: a later engine may have a better point.
    """

    solution: QPSolution
    errors: KKTErrors
    passes: bool
    says: EngineStatus = EngineStatus.GAVE_UP
    name: str = ""
    iterations: int = 0
    is_limited: bool = False

    @classmethod
    def of(
        cls, solution: QPSolution, tolerance: float, name: str, iterations: int = 0
    ) -> ProgramPoint:
        """Return the measured point of a solution."""
        errors = solution.errors_for(tolerance)
        return cls(solution, errors, bool(errors.meet(tolerance)), name=name, iterations=iterations)

    @property
    def residual(self) -> float:
        """The larger of both measures."""
        return float(self.errors.largest)


def attempts(program: QuadraticProgram, engine: Any = None) -> Iterator[tuple[Engine, Scaling]]:
    """Yield the engines that may solve a program, with the scaling for each.

    Parameters
    ----------
    engine : Engine, optional
        If given, only this engine runs; its options override the options of an attempt.

    Examples
    --------
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> [engine.name for engine, scale in attempts(program)]
    ['daqp', 'piqp', 'piqp', 'piqp', 'clarabel', 'clarabel']
    """
    matrices, ladder = program.matrices, ATTEMPTS
    if engine is None and program.folded.reduced.matrices.fills_in:
        ladder = tuple(sorted(ATTEMPTS, key=lambda one: WITH_FILL.index(one[0])))
    for name, tolerance, steps, scale in ladder:
        length = matrices.entries[0] / max(program.n, 1) if name == "piqp" else 0.0
        # Longer sums have larger rounding errors, below which PIQP takes all its steps
        factor = max(1.0, length / 64.0)  # 16 for a dense kernel matrix of 1 000 rows
        options = dict.fromkeys(TOLERANCES[name], tolerance * factor) if tolerance else {}
        if engine is not None:
            if name == engine.name:
                yield type(engine)(**{**options, **engine.options}), scale
        elif not is_installed(name):
            continue
        elif name == "daqp":
            # Its proximal steps drift away if nothing bends: linear programs in units of 1e9 ended at x = 1e21
            if matrices.is_small and matrices.has_curvature:
                yield engine_class(name)(), scale
        elif name != "highs" or not matrices.has_curvature:
            limit = {} if steps is None else {"max_iter": steps}
            yield engine_class(name)(**options, **limit), scale


def run_engine(
    program: QuadraticProgram,
    engine: Engine,
    tolerance: float,
    scale: Scaling,
    *,
    is_verbose: bool = False,
) -> ProgramPoint:
    """Return the best of the measured points of an engine: its own, without noise, and polished where that is cheap.

    Raises
    ------
    UnsuitableProblem
        If the engine accepts only linear programs and P has nonzeros.
    """
    if engine.is_for_linear_alone and program.matrices.has_curvature:
        raise UnsuitableProblem(
            f'{engine.name} solves {engine.solves}, but P has nonzeros; take "piqp", or give P = None'
        )
    reduced = program.folded.reduced
    best, iterations, says = None, 0, EngineStatus.GAVE_UP
    errors, passes = KKTErrors(np.inf, np.inf), False
    for scaled in _statements(reduced, scale):
        try:
            point = engine.answer(scaled.statement, SolverLimits(seconds_left(), is_verbose))
        except Exception:  # an external solver may raise any error for an option
            _check_options(engine)
            raise
        iterations, says = iterations + point.iterations, point.says
        rounds = 0 if says in NO_MINIMUM else ROUNDS
        is_small, sharp = reduced.matrices.is_small, SHARP * sum(reduced.matrices.stacked[1].shape)
        is_cheap = is_small or point.iterations >= POLISH_FROM
        for near, is_polished in candidates(scaled.statement, point, rounds):
            back = scaled.outward(near)
            x, y = np.minimum(np.maximum(back.x, reduced.lower), reduced.upper), back.y
            found = KKTErrors.of(reduced.judged, x, y, tolerance)
            is_good = bool(found.meet(tolerance))
            if (is_good, -found.largest) > (passes, -errors.largest):
                best, errors, passes = (x, y), found, is_good
            enough = sharp / 64.0 if is_polished and is_small else sharp
            is_best = not is_cheap or (is_polished and not is_small) or errors.gap <= enough
            if is_over() or (passes and is_best):
                break
        if passes or is_over():
            break
    solution = QPSolution.from_reduced(program, *(best or nearest(program)))
    return ProgramPoint(solution, errors, passes, says, engine.name, iterations)


def nearest(program: QuadraticProgram) -> tuple[Vector, Vector]:
    """Return x nearest to 0 within the bounds, without multipliers; in a linear program, x moved by its costs."""
    reduced = program.folded.reduced
    x = np.clip(0.0, reduced.lower, reduced.upper)
    rows = reduced.h.size + reduced.b.size
    if not rows and not reduced.matrices.has_curvature:
        end = np.where(reduced.c > 0.0, reduced.lower, reduced.upper)
        x = np.where((reduced.c != 0.0) & np.isfinite(end), end, x)
    return x, np.zeros(rows)


def candidates(
    statement: ProgramData, point: EngineAnswer, rounds: int
) -> Iterator[tuple[EngineAnswer, bool]]:
    """Yield points that may be the solution near a point, and whether they are polished.

    The point itself and its polished ones are each followed by the same with noise set to 0.
    """
    for one in chain([point], polish_steps(statement, point, rounds)):
        yield one, one is not point
        clean = one._replace(x=_without_noise(one.x), y=_without_noise(one.y))
        if not (np.array_equal(clean.x, one.x) and np.array_equal(clean.y, one.y)):
            yield clean, one is not point


def _without_noise(values: Vector) -> Vector:
    """Return the values with 0 at rounding level of the largest."""
    sizes = np.abs(values)
    # An interior point reaches 0 only to this
    return np.where(sizes <= 2.0**-40 * sizes.max(initial=0.0), 0.0, values)


def _statements(reduced: QuadraticProgram, scale: Scaling) -> Iterator[scaling.ScaledProgram]:
    """Yield the program as scaled for an attempt; first without very large right-hand sides, if it has some."""
    (P, G, A), one = reduced.matrices.arrays, reduced
    given = ProgramData(P, one.c, G, one.h, A, one.b, one.lower, one.upper)
    allowed = scaling.without_forbidden(given)
    for data in (given,) if allowed is given else (allowed, given):
        yield from scale(data, one.matrices)


def _check_options(engine: Engine) -> None:
    """Raise InvalidOption if the engine does not solve a program of one unknown with its options."""
    none = np.zeros((0, 1)), np.zeros(0)
    one = ProgramData(np.zeros((1, 1)), np.ones(1), *none, *none, np.zeros(1), np.ones(1))
    try:
        engine.answer(one, SolverLimits())
    except Exception as error:
        own = TOLERANCES.get(engine.name, ())
        asked = {name: value for name, value in engine.options.items() if name not in own}
        given = ", ".join(f"{name}={value!r}" for name, value in (asked or engine.options).items())
        # The first sentence, or the head of a binding's list of signatures
        why = str(error).splitlines()[0].removeprefix("(): ").partition(". The following")[0]
        raise InvalidOption(f"{engine.name} does not take {given}: {why}") from error


SHORT_SEARCH = 5000  # variables and rows: larger programs need a report of a solver
FAR = 1e6  # times the largest limit: an x out there may be on its way to infinity


@np.errstate(all="ignore")
def solve_program(
    program: QuadraticProgram,
    algorithm: Any = "auto",
    *,
    tolerance: float = PROGRAM_TOLERANCE,
    **options: Any,
) -> QuadraticProgramResult:
    """Return the first point that passes the test, a proof of infeasibility or unboundedness, or the best point.

    Parameters
    ----------
    program : QuadraticProgram
        Convex program, including merely convex and linear programs.
    algorithm : str or Algorithm or Engine
        "auto" solves a least squares problem if the program states one (`regression_of`). Then it uses external solvers
        (`ATTEMPTS`), and runs on the complementarity problem if all constraints are bounds, or if the program is small
        and no other point passes. If you name a solver, only this solver runs; "interior_point" is "piqp" here.
    tolerance : float
        Tolerance of the duality gap; rows are tested to 1e-9 at every tolerance.
    **options
        Options of :func:`lcp_plugin.solve`. Pass the z of an earlier result as `z0` to start a run on the
        complementarity problem; external solvers ignore it. The run calls `callback` before an external solver
        begins, with the start, and after it ends, with its point. With ``prove_infeasibility=False``, the run ends
        STALLED if two solvers report infeasible or unbounded.

    Raises
    ------
    UnsupportedModel
        If the program is not convex, or if the named algorithm cannot run on a merely convex program. A program with
        constraints that are proved inconsistent is INFEASIBLE for any objective.
    UnknownAlgorithm, InvalidOption
        Same conditions as for `solve`.
    """
    clock = Clock()
    is_auto = isinstance(algorithm, str) and algorithm == "auto" and not options
    is_plain = is_auto and type(tolerance) is float and 0.0 < tolerance < 1.0
    if is_plain and (found := _by_daqp(program, tolerance, clock)) is not None:
        return found
    wishes = {name: options.pop(name) for name in OF_SOLVE if name in options}
    for name in ("absolute_tolerance", "polish"):
        if name in wishes and wishes.pop(name) not in (None, DEFAULTS[name]):
            raise InvalidOption(
                f"solve takes no {name} for a QuadraticProgram; leave it out, or pass it with LCP.from_qp(P, c, …)"
            )
    wishes = {name: wish for name, wish in wishes.items() if wish is not None}
    callback, start = wishes.pop("callback", None), wishes.pop("z0", None)
    if start is not None:
        start = vector_option(start, "z0", None)
    is_point = isinstance(algorithm, InteriorPoint)
    if is_point or (isinstance(algorithm, str) and algorithm == InteriorPoint.name):
        algorithm = "piqp"
    engine = _engine(algorithm, options)
    settings = parse_call(
        "auto" if engine else algorithm,
        {**({} if engine else options), "tolerance": tolerance, **wishes},
    )[1]
    name = algorithm if isinstance(algorithm, str) else algorithm.name
    run = ProgramRun(program, name, settings, wishes, callback, clock, start)
    if engine is not None:
        plan = run.engine_stages(engine)
    elif name == "auto":
        plan = run.all_stages()
    else:
        plan = iter([run.lcp_stage(algorithm, options)])
    try:
        with time_limit(settings.max_seconds):
            refuse_nonconvex(program)
    except UnsupportedModel:
        if not settings.prove_infeasibility or program.is_convex is not False:
            raise
        run.proof = proof_of_contradiction(program)
        if run.proof is None:
            raise
        return run.result(Status.NO_SOLUTION)
    return run.solve(run.with_proof(plan))


def _by_daqp(
    program: QuadraticProgram, tolerance: float, clock: Clock
) -> QuadraticProgramResult | None:
    """Return daqp's point of a small program if a run of auto would end with this point; None for any other program."""
    if not program.matrices.is_small:
        return None
    reduced = program.folded.reduced
    if (layout := reduced.matrices.of_daqp) is None:
        return None
    c, judged, lower, upper = reduced.c, reduced.judged, reduced.lower, reduced.upper
    is_modest = 1e-12 < c @ c + np.vdot(layout[0], layout[0]) < 1e18  # `with_modest_costs` keeps it
    if not is_modest or (reduced.b.size and regression_of(reduced) is not None):
        return None
    x, y, steps = point_of_daqp(*layout, c, judged.d, reduced.h.size, lower, upper)
    found = KKTErrors.of(judged, x, y, tolerance)
    is_sharp = found.meet(tolerance) and found.gap <= SHARP * (x.size + y.size)
    if not is_sharp or is_in_doubt(program, found, x):
        return None
    # Multipliers of a point that passes overflow only if coefficients divide them
    make = QPSolution.on_access if reduced is program else QPSolution.from_reduced
    own = {"algorithm": "auto: daqp", "iterations": steps, "tolerance": tolerance}
    stages = (StageRecord(DAQP.name, DAQP.solves, steps, 2.0),)  # of two points
    own |= {"seconds": clock.read(), "stages": stages, "status": Status.SOLVED}
    return QuadraticProgramResult.of_known(None, **own, solution=make(program, x, y))


def is_in_doubt(program: QuadraticProgram, errors: KKTErrors, x: Vector) -> bool:
    """Return whether a program may be infeasible or unbounded although x, which violates rows or is far, passes."""
    if errors.primal > 1e-10 or (size := np.abs(x).max(initial=0.0)) <= FAR:
        return bool(errors.primal > 1e-10)
    limits = np.abs(program.constraints.limit)
    return bool(size > FAR * limits[np.isfinite(limits)].max(initial=1.0))


def _engine(algorithm: object, options: dict[str, Any]) -> Engine | None:
    """Return the engine of that name with its options, or the passed engine; None for another algorithm."""
    if isinstance(algorithm, str):
        return installed_engine(algorithm)(**options) if algorithm in ENGINES else None
    if not isinstance(algorithm, Engine):
        return None
    if options:
        raise InvalidOption(
            f"give {min(options)} to {type(algorithm).__name__}(…), or name the engine: "
            f"solve(program, {algorithm.name!r}, …)"
        )
    return algorithm


class ProgramProgress(Progress):
    """Progress of a run whose limit of iterations holds for each external solver."""

    def limit(self) -> Status | None:
        """Return the limit that the call, or a run on the complementarity problem, has reached."""
        if self.end is None and is_over():
            self.end = Status.MAX_SECONDS
        return self.end


class ProgramRun(Run):
    """Run of a program: points of external solvers and of a run on its complementarity problem, and a proof.

    It is one class because it specializes the methods of `Run` for one problem class.

    Attributes
    ----------
    best : ProgramPoint or None
    doubtful : QPInfeasibility or QPUnboundedness or None
        A proof that excludes no solution.
    """

    best: ProgramPoint | None

    def __init__(
        self,
        program: QuadraticProgram,
        name: str,
        settings: Settings,
        wishes: dict[str, Any],
        callback: Any,
        clock: Clock,
        start: Vector | None,
    ) -> None:
        super().__init__(ProgramProgress(program, settings, callback, clock))
        self.program, self.name, self.wishes, self.start = program, name, wishes, start
        self.doubtful: NoMinimum | None = None

    # --- The plan ----------------------------------------------------------------------------------------------------

    def all_stages(self) -> Iterator[Stage]:
        """Yield the stages of auto; a program with bounds only is a complementarity problem of n unknowns."""
        reduced = self.program.folded.reduced
        rows, matrices = reduced.h.size + reduced.b.size, reduced.matrices
        if not rows and not matrices.has_curvature:
            solution = QPSolution.from_reduced(self.program, *nearest(self.program))
            found = ProgramPoint.of(solution, self.settings.tolerance, "costs")
            if not found.passes:
                found = found._replace(says=EngineStatus.UNBOUNDED)
            vertex = Step(solution.x, iterations=0, measured=found)
            yield Stage(Named("costs"), "boxes", steps=[vertex])
        is_lcp_first = not rows and matrices.has_curvature and not matrices.is_small
        if is_lcp_first:
            # Pivots on thousands of rows take minutes; external solvers are next.
            yield self.lcp_stage("auto", {}, "lemke")
        if (form := regression_of(reduced)) is not None:
            because = "sums of squares with a penalty"
            yield Stage(Named("least squares"), because, steps=self._regression_steps(*form))
        yield from self.engine_stages(None)
        # The LCP of a small program is tried if no external solver has a solution
        if not is_lcp_first and (reduced.n + rows <= 300 or not has_piqp()):
            yield self.lcp_stage("auto", {})

    def with_proof(self, plan: Iterator[Stage]) -> Iterator[Stage]:
        """Yield the stages of a plan, then search for a proof.

        Without proofs, the plan ends if two solvers report infeasible, or unbounded.
        """
        is_wanted, before = self.settings.prove_infeasibility, None
        for stage in plan:
            yield stage
            says = None if self.latest is None else self.latest.says
            if not is_wanted and says in NO_MINIMUM and says is before:
                return
            before = says
        if is_wanted and self._is_short:
            self._search_proof()

    def engine_stages(self, engine: Engine | None) -> Iterator[Stage]:
        """Yield a stage for each attempt of an external solver."""
        for asked, scale in attempts(self.program, engine):
            options = dict(asked.options)
            if "max_iterations" in self.wishes:  # an engine counts in 32 bits
                options[asked.steps] = min(self.wishes["max_iterations"], 2**31 - 1)
            one = type(asked)(**options)
            yield Stage(one, one.solves, steps=self._engine_steps(one, scale))

    def _engine_steps(self, engine: Engine, scale: Scaling) -> Iterator[Step]:
        """Yield the start and the point of an external solver."""
        yield Step(nearest(self.program)[0], iterations=0)
        found = run_engine(
            self.program, engine, self.settings.tolerance, scale, is_verbose=self.settings.verbose
        )
        yield Step(found.solution.x, iterations=found.iterations, measured=found)

    def _regression_steps(self, problem: Any, outward: Outward) -> Iterator[Step]:
        """Yield the start and the points of the least squares problem."""
        yield Step(nearest(self.program)[0], iterations=0)
        names = self.wishes.keys() & {"max_iterations"}
        wishes = {"tolerance": self.settings.tolerance} | {key: self.wishes[key] for key in names}
        for z, by in solutions(problem, wishes):
            solution = QPSolution.from_reduced(self.program, *outward(z))
            found = ProgramPoint.of(solution, self.settings.tolerance, by.algorithm, by.iterations)
            yield Step(solution.x, iterations=by.iterations, measured=found)

    def lcp_stage(self, *run: Any) -> Stage:
        """Return a stage with a run on the complementarity problem of the program; see `_lcp_steps`."""
        steps = self._lcp_steps(*run)
        return Stage(Named("lcp"), "complementarity problems", steps=steps, is_reported=True)

    def _lcp_steps(
        self, algorithm: Any, options: dict[str, Any], ends_before: str = ""
    ) -> Iterator[Step]:
        """Yield the point of a run on the complementarity problem, which shows its own steps, up to an algorithm."""
        progress, n, left = self.progress, self.program.n, seconds_left()
        tolerance = self.settings.tolerance
        problem = optimality_conditions(self.program)
        wishes = {**options, **self.wishes, "max_seconds": None if left == math.inf else left}
        if self.start is not None and self.start.size == problem.n:
            wishes["z0"] = self.start
        passing: Vector | None = None

        def ends_run(sample: Sample, z: Vector) -> bool:
            """Return whether the run ends: x passes the test, or the callback stops it."""
            nonlocal passing
            if progress.callback is not None and progress.callback(sample, z):
                progress.end = Status.INTERRUPTED
                return True
            if sample.label == ends_before:
                return True
            # x is tested below that residual of the LCP
            if sample.residual is not None and sample.residual <= 1e-4:
                solution = QPSolution.from_reduced(self.program, z[:n], z[n:])
                if solution.errors_for(tolerance).meet(tolerance):
                    passing = z.copy()
            return passing is not None

        try:
            # So small a tolerance that x nearly always passes the program's own test
            result = solve_lcp(problem, algorithm, tolerance=1e-12, callback=ends_run, **wishes)
        except (UnsuitableMatrix, UnsuitableProblem) as refusal:
            stated = "a program's conditions of optimality, whose M has a zero on the diagonal for each of its rows"
            raise UnsupportedModel(f"{refusal} (M is that of {stated})") from refusal
        progress.samples += result.history
        z = result.z if passing is None else passing
        solution = QPSolution.from_reduced(self.program, z[:n], z[n:])
        found = ProgramPoint.of(solution, tolerance, result.algorithm, result.iterations)
        if result.status is Status.MAX_ITERATIONS and "max_iterations" in self.wishes:
            progress.end = progress.end or Status.MAX_ITERATIONS
        elif result.status is Status.MAX_SECONDS:
            progress.end = progress.end or Status.MAX_SECONDS
        yield Step(solution.x, iterations=result.iterations, measured=found, label=result.algorithm)

    # --- Selection of the result -------------------------------------------------------------------------------------

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Return the reason, or NO_SOLUTION if a proof is found; some points start a search."""
        found = self.latest
        if found is None or not self.settings.prove_infeasibility:
            return end
        # If rows are violated, a proof of infeasibility is searched first
        may_fail = is_in_doubt(self.program, found.errors, found.solution.x)
        if (found.passes and may_fail and self._is_short) or found.says in NO_MINIMUM:
            self._search_proof()
        return end if self.proof is None else Status.NO_SOLUTION

    @property
    def _is_short(self) -> bool:
        """True if the program is small enough for a search without the report of a solver."""
        return self.program.n + self.program.constraints.rows <= SHORT_SEARCH

    def _search_proof(self) -> None:
        """Keep the proof that the program has no solution, or the one that shows this except for rounding."""
        latest, y = self.latest, None
        if latest is not None and latest.says is EngineStatus.INFEASIBLE and not self._is_short:
            y = np.concatenate([latest.solution.inequality, latest.solution.equality])
        found = known_proof(self.program, y)
        if found is not None and found.excludes(self.settings.tolerance):
            self.proof = found
        elif found is not None and found.doubt:
            self.doubtful = found

    def status(self, end: Status) -> Status:
        """Return the status: of the proof, SOLVED, of a limit, or for the accuracy of the best point."""
        if self.proof is not None:
            return self.proof.status
        status = super().status(end)
        if status is not Status.STALLED:
            return status
        is_short = self.latest is not None and self.latest.says is EngineStatus.STOPPED
        if is_short and "max_iterations" in self.wishes:
            return Status.MAX_ITERATIONS
        is_near = self._is_nearly_optimal or self.doubtful is not None
        return Status.PRECISION_LIMIT if is_near else Status.STALLED

    @property
    def _is_nearly_optimal(self) -> bool:
        """True if the measures of the best point are small, but above the tolerance."""
        return self.best is not None and self.best.errors.nearly_meet(self.settings.tolerance)

    def result(self, end: Status) -> QuadraticProgramResult:
        """Return the result."""
        program, status, best = self.program, self.status(end), self.best
        is_rounding = status is Status.PRECISION_LIMIT and not self._is_nearly_optimal
        if best is None or (is_rounding and self.doubtful is not None):
            solution = QPSolution.from_reduced(program, *nearest(program))
            begun = [stage.algorithm.name for stage in self.progress.stages]
            name = begun[-1] if begun else ""
            best = ProgramPoint(solution, KKTErrors(np.inf, np.inf), passes=False, name=name)
        proof, solution, x = self.proof or self.doubtful, best.solution, best.solution.x
        if isinstance(proof, QPUnboundedness) and (proof is self.proof or is_rounding):
            x = np.clip(numbers(proof.point), program.lower, program.upper)
            solution = QPSolution.from_reduced(program, x, nearest(program)[1])
        if self.proof is not None:
            solution = QPSolution.without_multipliers(program, x)
        if self.settings.verbose:
            say(
                f"{status.name}: {ADVICE.get(status, status.value) if self.proof is None else self.proof}"
            )
        by = self.name
        if by == "auto" and best.name:
            by = f"auto: {best.name.removeprefix('auto: ')}"
        fields = {**self.common_fields(status), "iterations": best.iterations, "algorithm": by}
        return QuadraticProgramResult(solution, self.proof, doubtful=self.doubtful, **fields)
