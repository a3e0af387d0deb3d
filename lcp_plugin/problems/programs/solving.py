"""The solver for convex quadratic programs: external solvers, a run on the LCP, and a proof; one test of all points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...core import deadline
from ...core.algorithm import Step
from ...core.checks import Vector, vector_option
from ...core.entries import clip, max_norm
from ...core.errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem, UnsupportedModel
from ...core.settings import DEFAULT, DEFAULTS, OF_SOLVE, Settings, Status
from ...core.tuning import LINEAR_PROGRAM_UP_TO
from ...engines import ENGINES, has_piqp, installed_engine
from ...engines.engine import Engine, EnginePoint, EngineStatus
from ...engines.solvers import DAQP, ends_of_rows
from ...judges.program import NO_POLISH, PROGRAM_TOLERANCE, SHARP, KKTErrors
from ...methods.interior_point import InteriorPoint
from ...methods.small import LOOP_UP_TO
from ...solving.dispatch import parse_call
from ...solving.lcp_solver import solve_lcp
from ...solving.result import Sample, StageRecord, end_at_once
from ...solving.run import Named, Progress, Run, Stage, say, with_samples
from ..least_squares.solving import solve_least_squares
from .conversion import optimality_conditions
from .engine_points import (
    NO_MINIMUM,
    ProgramPoint,
    Scaling,
    attempts,
    nearest,
    run_engine,
    without_noise,
)
from .no_minimum import (
    NoMinimum,
    QPUnboundedness,
    as_doubles,
    known_proof,
    proof_of_contradiction,
    shown_proof,
)
from .program import QuadraticProgram, refuse_nonconvex
from .regression import Outward, points_near, regression_of
from .result import ADVICE, QuadraticProgramResult
from .solution import QPSolution

PROGRAM_DEFAULT = Settings(tolerance=PROGRAM_TOLERANCE)  # of a call without options
CERTAIN_ROWS = 1e-10  # a larger violation starts a search for a proof of infeasibility
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
        Options of :func:`lcp_plugin.solve`. Pass x, or the z of an earlier result, as `z0` to start a run on the
        complementarity problem; external solvers ignore it. The run calls `callback` before an external solver
        begins, with the start, and after it ends, with its point. With ``prove_infeasibility=False``, the run ends
        STALLED if two solvers report infeasible or unbounded, or if daqp does and its multipliers show it.

    Raises
    ------
    UnsupportedModel
        If the program is not convex, or if the named algorithm cannot run on a merely convex program. A program with
        constraints that are proved inconsistent is INFEASIBLE for any objective.
    UnknownAlgorithm, InvalidOption
        Same conditions as for `solve`.
    """
    call = parsed(algorithm, tolerance=tolerance, **options)
    algorithm, engine, settings, options, solve_options = call
    clock = deadline.Clock(settings.max_seconds)
    callback, start = solve_options.pop("callback", None), solve_options.pop("z0", None)
    start = None if start is None else checked_start_of_program(program, start)
    name = algorithm if isinstance(algorithm, str) else algorithm.name
    end = None
    if name == "auto" and settings.has_steps and not settings.verbose:
        end, first, errors = first_point(program, settings, clock)
        if first is not None and not settings.record and callback is None:
            return first
        if first is not None and first.is_solved:
            ends = (nearest(program)[0], None), float(errors.largest)
            if (result := with_samples(program, first, settings, callback, *ends)) is not None:
                return result
            callback = end_at_once
    run = ProgramRun(program, name, settings, solve_options, callback, clock, start, end)
    if engine is not None:
        plan = run.engine_stages(engine)
    elif name == "auto":
        plan = run.all_stages()
    else:
        plan = iter([run.lcp_stage(algorithm, options)])
    try:
        with deadline.limit(settings.max_seconds):
            refuse_nonconvex(program)
    except UnsupportedModel:
        if not settings.prove_infeasibility or program.is_convex is not False:
            raise
        run.proof = proof_of_contradiction(program)
        if run.proof is None:
            raise
        return run.result(Status.NO_SOLUTION)
    return run.solve(run.with_proof(plan))


def parsed(
    algorithm: Any, *, tolerance: float = PROGRAM_TOLERANCE, **options: Any
) -> tuple[Any, Engine | None, Settings, dict[str, Any], dict[str, Any]]:
    """Return the algorithm, its engine, the settings, options of the algorithm and of `solve`."""
    of_solve = {name: options[name] for name in OF_SOLVE if options.get(name) is not None}
    options = {name: value for name, value in options.items() if name not in OF_SOLVE}
    for name in ("absolute_tolerance", "polish"):
        if of_solve.pop(name, DEFAULTS[name]) != DEFAULTS[name]:
            raise InvalidOption(
                f"solve takes no {name} for a QuadraticProgram; leave it out, or pass it with LCP.from_qp(P, c, …)"
            )
    if isinstance(algorithm, InteriorPoint) or algorithm == InteriorPoint.name:
        algorithm = "piqp"
    engine = _engine(algorithm, options)
    call = {**({} if engine else options), **of_solve}
    if call or type(tolerance) is not float or tolerance != PROGRAM_TOLERANCE:
        call["tolerance"] = tolerance
    settings = parse_call("auto" if engine else algorithm, call, PROGRAM_DEFAULT)[1]
    return algorithm, engine, settings, options, of_solve


def checked_start_of_program(program: QuadraticProgram, z0: object) -> Vector:
    """Return a start: x, or x with the multipliers of the rows that are not bounds; raise InvalidOption for others."""
    start, n = vector_option(z0, "z0", None), program.n
    if start.size != n and start.size != (size := n + program.reduced.constraints.rows):
        also = f", or z of an earlier result, of length {size}" if size > n else ""
        raise InvalidOption(f"z0 must be x, of length {n}{also}, got length {start.size}")
    return start


def first_point(
    program: QuadraticProgram, settings: Settings, clock: deadline.Clock
) -> tuple[EnginePoint | None, QuadraticProgramResult | None, Any]:
    """Return daqp's end on a small program, the result if a run of auto would end with this point, and its errors.

    A run takes the end as that of its first stage.
    """
    matrices = program.matrices
    if not matrices.is_small or sum(matrices.sizes[:3]) > LOOP_UP_TO:  # a run costs less than daqp
        return None, None, None
    reduced = program.reduced
    if (layout := reduced.matrices.of_daqp) is None:
        return None, None, None
    c, judged, lower, upper = reduced.c, reduced.judged, reduced.lower, reduced.upper
    squares = c.dot(c) + np.vdot(layout[0], layout[0])
    is_modest = 1e-12 < squares < 1e18  # `with_modest_costs` keeps it
    if not is_modest or (reduced.b.size and regression_of(reduced) is not None):
        return None, None, None
    options = DAQP.defaults
    if settings.max_iterations < options["iter_limit"]:
        options = {**options, "iter_limit": settings.max_iterations}
    m, tolerance = reduced.h.size, settings.tolerance
    end = DAQP.end_of(m, *layout, c.copy(), *ends_of_rows(judged.d, m, lower, upper), options)
    if end.reported is EngineStatus.INFEASIBLE:
        return end, infeasible_result(program, end, settings, clock.read()), None
    x, y = clip(without_noise(end.x), lower, upper), without_noise(end.y)  # as a run begins
    errors, x = KKTErrors.with_point(judged, x, y, tolerance)
    is_sharp = errors.meet(tolerance) and errors.gap <= NO_POLISH * (x.size + y.size)
    if not is_sharp or is_in_doubt(program, errors, x):
        return end, None, None
    # Multipliers of a point that passes overflow only if coefficients divide them
    make = QPSolution.on_access if reduced is program else QPSolution.from_reduced
    known = {"status": Status.SOLVED, "solution": make(program, x, y)}
    return end, result_of_daqp(end, DAQP.solves, settings, clock.read(), **known), errors


def infeasible_result(
    program: QuadraticProgram, end: EnginePoint, settings: Settings, seconds: float
) -> QuadraticProgramResult | None:
    """Return the result of a program that daqp reports as infeasible if multipliers show that it is; else None.

    A result without proofs is STALLED, at a point with small violations.
    """
    if (shown := shown_proof(program)) is None:
        return None
    (x, proof), run = shown, (end, f"it reports {end.reported.value}", settings, seconds)
    if settings.prove_infeasibility:
        none = QPSolution.none(program)
        return result_of_daqp(*run, status=proof.status, solution=none, proof=proof)
    solution = QPSolution.on_access(program, x, np.zeros(program.folded.left.size))
    return result_of_daqp(*run, status=Status.STALLED, solution=solution)


def result_of_daqp(
    end: EnginePoint, because: str, settings: Settings, seconds: float, **others: Any
) -> QuadraticProgramResult:
    """Return the result of a solve whose only stage is daqp; `others` are its status, its solution and a proof."""
    stages = (StageRecord(DAQP.name, because, end.iterations, 0.0),)
    known = {"algorithm": "auto: daqp", "iterations": end.iterations, "stages": stages}
    return QuadraticProgramResult.of_known(
        None, seconds=seconds, tolerance=settings.tolerance, **known, **others
    )


def is_in_doubt(program: QuadraticProgram, errors: KKTErrors, x: Vector) -> bool:
    """Return whether a program may be infeasible or unbounded although x, which violates rows or is far, passes."""
    size, is_violated = max_norm(x), bool(errors.primal > CERTAIN_ROWS)
    if is_violated or size <= FAR:
        return is_violated
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


def planned(program: QuadraticProgram) -> tuple[str, Any, Iterator[Stage]]:
    """Return the matrix and the stages of a program for `analyze`; none if it is not convex."""
    run = ProgramRun(program, "auto", DEFAULT, {}, None, deadline.Clock(), None)
    return "P", program.P, iter(()) if program.is_convex is False else run.all_stages()


class ProgramProgress(Progress):
    """Progress of a run whose limit of iterations holds for each external solver."""

    def limit(self) -> Status | None:
        """Return the limit that the call, or a run on the complementarity problem, has reached."""
        if self.end is None and deadline.is_over():
            self.end = Status.MAX_SECONDS
        elif self.end is None and not self.settings.max_iterations:
            self.end = Status.MAX_ITERATIONS
        return self.end


class ProgramRun(Run):
    """Run of a program: points of external solvers and of a run on its complementarity problem, and a proof.

    It is one class because it specializes the methods of `Run` for one problem class.

    Attributes
    ----------
    best : ProgramPoint or None
    end_of_daqp : EnginePoint or None
        The end of daqp's run on the reduced program, if it ran already.
    doubtful : QPInfeasibility or QPUnboundedness or None
        A proof that excludes no solution.
    """

    best: ProgramPoint | None

    def __init__(
        self,
        program: QuadraticProgram,
        name: str,
        settings: Settings,
        options: dict[str, Any],
        callback: Any,
        clock: deadline.Clock,
        start: Vector | None,
        end: EnginePoint | None = None,
    ) -> None:
        super().__init__(ProgramProgress(program, settings, callback, clock))
        self.end_of_daqp = end
        self.program, self.name, self.options, self.start = program, name, options, start
        self.doubtful: NoMinimum | None = None

    # --- The plan ----------------------------------------------------------------------------------------------------

    def all_stages(self) -> Iterator[Stage]:
        """Yield the stages of auto; a program with bounds only is a complementarity problem of n unknowns."""
        reduced = self.program.reduced
        rows, matrices = reduced.h.size + reduced.b.size, reduced.matrices
        if not rows and not matrices.has_curvature:
            solution = QPSolution.from_reduced(self.program, *nearest(self.program))
            point = ProgramPoint.of(solution, self.settings.tolerance, "costs")
            if not point.passes:
                point = point._replace(reported=EngineStatus.UNBOUNDED)
            vertex = Step(solution.x, iterations=0, measured=point, work=0.0)
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
            reported = None if self.latest is None else self.latest.reported
            if not is_wanted and reported in NO_MINIMUM and reported is before:
                return
            before = reported
        if is_wanted and self._is_short:
            self._search_proof()

    def engine_stages(self, engine: Engine | None) -> Iterator[Stage]:
        """Yield a stage for each attempt of an external solver.

        A point at rounding level is not computed again in its scaling, by a smaller tolerance of the same solver.
        """
        before = None
        for asked, scale in attempts(self.program, engine):
            is_same, before = before == (asked.name, scale), (asked.name, scale)
            if is_same and self.latest is not None and self.latest.errors.largest <= SHARP / 64.0:
                continue
            options = dict(asked.options)
            if "max_iterations" in self.options:  # an engine counts in 32 bits
                options[asked.steps] = min(self.options["max_iterations"], 2**31 - 1)
            limited = type(asked)(**options)
            yield Stage(limited, limited.solves, steps=self._engine_steps(limited, scale))

    def _engine_steps(self, engine: Engine, scale: Scaling) -> Iterator[Step]:
        """Yield the start and the point of an external solver."""
        yield Step(nearest(self.program)[0], iterations=0, work=0.0)
        point = run_engine(
            self.program,
            engine,
            self.settings.tolerance,
            scale,
            is_verbose=self.settings.verbose,
            end=self.end_of_daqp if engine.name == DAQP.name else None,
        )
        yield Step(point.solution.x, iterations=point.iterations, measured=point, work=0.0)

    def _regression_steps(self, problem: Any, outward: Outward) -> Iterator[Step]:
        """Yield the start, the solution of the least squares problem, and the minimum on its face."""
        yield Step(nearest(self.program)[0], iterations=0, work=0.0)
        tolerance = self.settings.tolerance
        options: dict[str, Any] = {"max_iterations": self.options.get("max_iterations")}
        options["max_seconds"] = deadline.left()
        result = solve_least_squares(problem, tolerance=tolerance, **options)
        if result.status is Status.INTERRUPTED:  # it also ends the run around this one
            raise KeyboardInterrupt
        for x in points_near(problem, result.x):
            solution = QPSolution.from_reduced(self.program, *outward(x))
            point = ProgramPoint.of(solution, tolerance, result.algorithm, result.iterations)
            yield Step(solution.x, iterations=result.iterations, measured=point, work=0.0)

    def lcp_stage(self, *run: Any) -> Stage:
        """Return a stage with a run on the complementarity problem of the program; see `_lcp_steps`."""
        steps = self._lcp_steps(*run)
        return Stage(Named("lcp"), "complementarity problems", steps=steps, is_reported=True)

    def _lcp_steps(
        self, algorithm: Any, options: dict[str, Any], ends_before: str = ""
    ) -> Iterator[Step]:
        """Yield the point of a run on the complementarity problem, which shows its own steps, up to an algorithm."""
        progress, n = self.progress, self.program.n
        tolerance = self.settings.tolerance
        problem = optimality_conditions(self.program)
        lcp_options = {**options, **self.options, "max_seconds": deadline.left()}
        if self.start is not None:
            lcp_options["z0"] = np.append(self.start, np.zeros(problem.n - self.start.size))
        passing: list[Vector] = []

        def ends_run(sample: Sample, z: Vector) -> bool:
            """Return whether the run ends: x passes the test, or the callback stops it."""
            if progress.callback is not None and progress.callback(sample, z):
                progress.end = Status.INTERRUPTED
                return True
            if sample.label == ends_before:
                return True
            # x is tested below that residual of the LCP
            if sample.residual is not None and sample.residual <= 1e-4:
                solution = QPSolution.from_reduced(self.program, z[:n], z[n:])
                if solution.errors_for(tolerance).meet(tolerance):
                    passing.append(z.copy())
            return bool(passing)

        try:
            # So small a tolerance that x nearly always passes the test of programs
            result = solve_lcp(
                problem, algorithm, tolerance=1e-12, callback=ends_run, **lcp_options
            )
        except (UnsuitableMatrix, UnsuitableProblem) as refusal:
            stated = "a program's conditions of optimality, whose M has a zero on the diagonal for each of its rows"
            raise UnsupportedModel(f"{refusal} (M is that of {stated})") from refusal
        progress.samples += result.history
        found = result.certificate.z if result.has_no_solution else result.z
        z = passing[0] if passing else found
        solution = QPSolution.from_reduced(self.program, z[:n], z[n:])
        point = ProgramPoint.of(solution, tolerance, result.algorithm, result.iterations)
        if result.status is Status.MAX_ITERATIONS and "max_iterations" in self.options:
            progress.end = progress.end or Status.MAX_ITERATIONS
        elif result.status is Status.MAX_SECONDS:
            progress.end = progress.end or Status.MAX_SECONDS
        steps, name = result.iterations, result.algorithm
        yield Step(solution.x, iterations=steps, measured=point, work=0.0, label=name)

    # --- Selection of the result -------------------------------------------------------------------------------------

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Return the reason, or NO_SOLUTION if a proof exists; some points start a search."""
        point = self.latest
        if point is not None and point.scaling and not point.passes:
            stage.because = point.describe()
        if point is None or not self.settings.prove_infeasibility:
            return end
        # If rows are violated, a proof of infeasibility is searched first
        may_fail = is_in_doubt(self.program, point.errors, point.solution.x)
        if (point.passes and may_fail and self._is_short) or point.reported in NO_MINIMUM:
            self._search_proof()
        return end if self.proof is None else Status.NO_SOLUTION

    @property
    def _is_short(self) -> bool:
        """True if the program is small enough for a search without the report of a solver."""
        return self.program.n + self.program.constraints.rows <= LINEAR_PROGRAM_UP_TO

    def _search_proof(self) -> None:
        """Keep the proof that the program has no solution, or the proof that shows this except for rounding."""
        reported, y = None if self.latest is None else self.latest.reported, None
        if reported in NO_MINIMUM and (shown := shown_proof(self.program)) is not None:
            self.proof = shown[1]
            return
        if reported is EngineStatus.INFEASIBLE and not self._is_short:
            y = np.concatenate([self.latest.solution.inequality, self.latest.solution.equality])
        proof = known_proof(self.program, y)
        if proof is not None and proof.excludes(self.settings.tolerance):
            self.proof = proof
        elif proof is not None and proof.doubt:
            self.doubtful = proof

    def status(self, end: Status) -> Status:
        """Return the status: of the proof, SOLVED, of a limit, or for the accuracy of the best point."""
        if self.proof is not None:
            return self.proof.status
        status = super().status(end)
        if status is not Status.STALLED:
            return status
        is_short = self.latest is not None and self.latest.reported is EngineStatus.STOPPED
        if is_short and "max_iterations" in self.options:
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
        solution = best.solution
        if self.proof is not None:
            solution = QPSolution.none(program)
        elif isinstance(self.doubtful, QPUnboundedness) and is_rounding:
            x = np.clip(as_doubles(self.doubtful.point), program.lower, program.upper)
            solution = QPSolution.from_reduced(program, x, nearest(program)[1])
        if self.settings.verbose:
            say(
                f"{status.name}: {ADVICE.get(status, status.value) if self.proof is None else self.proof}"
            )
        by = self.name
        if by == "auto" and best.name:
            by = f"auto: {best.name.removeprefix('auto: ')}"
        fields = {**self.common_fields(status), "iterations": best.iterations, "algorithm": by}
        return QuadraticProgramResult(solution, self.proof, doubtful=self.doubtful, **fields)
