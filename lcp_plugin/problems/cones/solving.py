"""Solution of a problem over cones: the sequence of algorithms of auto, the run, the result."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...core.algorithm import Step
from ...core.checks import Array, Vector, checked_start, derived_property, read_only
from ...core.cone_stack import ConeStack
from ...core.deadline import Clock
from ...core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ...core.kernels.floats import DATA_ROUNDING
from ...core.kernels.threads import threads_for
from ...core.names import format_count
from ...core.settings import DEFAULT, Settings, Status
from ...judges.cones import ConeRows
from ...judges.lcp import Measured
from ...judges.worst_rows import WorstRows
from ...methods.search import ExhaustiveSearch, is_searchable
from ...solving.result import NOTHING_TO_DO, Callback, Result, StageRecord, end_at_once
from ...solving.run import FAILED, Budget, Progress, Run, Stage, with_samples
from ..contact import ContactMotion, motion_of
from . import methods, newton
from .certificate import ConeCertificate, ContactInfeasibility, infeasibility_proof
from .data import Blocks
from .factors import FEW, cone_stack_of
from .frictional_contact import FrictionalContact
from .methods import CONE_METHODS, ConeAlgorithm
from .sweeps import SWEEPS_PER_STEP, sweep_blocks, sweep_contacts

LEAST_GOAL = 1e-8  # of a run with an absolute tolerance: far above the rounding level EXACT
CLOSER = 0.9  # of the tolerance: the goal of the methods, whose residuals exclude rounding errors
SCHEDULE = ((10, 20), (50, 40), (200, 40))  # sweeps, then steps of Newton's method
# A problem that a stack leaves takes a hundred times as long
STACK_SCHEDULE = (*SCHEDULE, (1000, 100))
LONG_SCHEDULE = tuple((count, methods.NEWTON_STEPS) for count in (2500, 7500, 10000))
SHARES = (0.01, 0.1, 0.001)  # of the largest velocity: distance of a path's start from a point
ADVICE = {
    Status.STALLED: (
        "no method reduces the residual further; next: another start z0, or less friction: contact with much friction "
        "or a singular W need not have a solution"
    ),
    Status.INFEASIBLE: "no z in the cones has an M z + q in their duals; next: check the data (result.proof)",
}
MIDDLE = "from the middle of the impulses that make the same motion Newton converges"
CONVEX = "for a symmetric M a convex program has the same solution"
SWEPT = "cheap sweeps over the blocks find most of the active set"


@np.errstate(all="ignore")
def solve_cones(
    problem: Blocks,
    algorithm: str | ConeAlgorithm = "auto",
    *,
    z0: ArrayLike | None = None,
    callback: Callback | None = None,
    **options: Any,
) -> ConeResult:
    """Solve a :class:`ConeProblem` or :class:`FrictionalContact`, and certify the result.

    Parameters
    ----------
    problem : ConeProblem or FrictionalContact
    algorithm : str or object
        "nsgs", "newton", "interior_point", "fixed_point" or "auto"; or an object of a class in
        :mod:`lcp_plugin.problems.cones.methods`, with options.
    z0 : array, shape (n,), optional
        Warm start, projected onto the cones.
    tolerance : float
        SOLVED means that the measured residual of the returned z is at most this: see
        :mod:`lcp_plugin.problems.cones.certificate`.
    callback, **options
        Also max_iterations, max_seconds, absolute_tolerance, record, prove_infeasibility, threads, verbose: as for
        :func:`lcp_plugin.solve`.

    Returns
    -------
    ConeResult

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        For a wrong option.
    """
    settings, chosen = Settings(**options) if options else DEFAULT, _checked_algorithm(algorithm)
    clock, start, swept = Clock(settings.max_seconds), None, None
    if z0 is not None:
        start = projected_on_cones(problem, checked_start(problem, z0))
    if chosen == "auto" and settings.has_steps:
        swept = first_sweeps(problem, start, settings.tolerance)
        if swept is not None and swept.is_solved(settings):
            make = partial(swept.record, problem, settings, clock.read())
            known = ConeResult.of_known(make, z=swept.z, status=Status.SOLVED, problem=problem)
            begun = np.zeros(problem.n) if start is None else start, None
            result = with_samples(problem, known, settings, callback, begun, swept.bound)
            if result is not None:
                return result
            callback = end_at_once
    progress = Progress(problem, settings, callback, clock)
    with threads_for(settings.threads):
        run = ConeRun(problem, progress, start, chosen, swept=swept)
        return run.solve(run.plan())


class Swept(NamedTuple):
    """Point of a small contact problem after sweeps, their number and the bound of its residual, ∞ if in doubt."""

    z: Vector
    sweeps: int
    bound: float

    @property
    def iterations(self) -> int:
        """The number of iterations."""
        return -(-self.sweeps // SWEEPS_PER_STEP)

    def is_solved(self, settings: Settings) -> bool:
        """Return whether the quick test accepts the point, within the limit of iterations."""
        return self.bound < np.inf and self.iterations <= settings.max_iterations

    def record(self, problem: Blocks, settings: Settings, seconds: float) -> ConeResult:
        """Return the result with all fields."""
        tolerance, work = settings.tolerance, self.sweeps + 1.0
        because = SWEPT if self.sweeps else NOTHING_TO_DO
        fields = {"certificate": ConeCertificate(problem, self.z, tolerance), "work": work}
        fields |= {"iterations": self.iterations, "tolerance": tolerance, "seconds": seconds}
        fields |= {"algorithm": "auto: nsgs", "setup_seconds": 0.0}
        fields |= {"absolute_tolerance": settings.absolute_tolerance}
        fields["stages"] = (StageRecord("nsgs", because, self.iterations, work),)
        return ConeResult.of_known(None, **fields)


def first_sweeps(problem: Blocks, start: Vector | None, tolerance: float) -> Swept | None:
    """Return the end of quick sweeps from a start in the cones; None for other problems than small contact problems."""
    if not (problem.has_friction and 0 < problem.n <= FEW):
        return None
    start = np.zeros(problem.n) if start is None else start
    z, count, bound = sweep_contacts(problem, start, tolerance)
    return Swept(read_only(z), count, bound)


def projected_on_cones(problem: Blocks, z: Vector) -> Vector:
    """Return the nearest point of the cones; most starts are in the cones already."""
    if z.size:
        first, squares = problem.starts[:-1], z * z
        squares[first] = 0.0
        tangents = np.sqrt(np.add.reduceat(squares, first))
        is_inside = tangents <= problem.slope * z[first] * (1.0 + 2.0**-50)
        if np.logical_and.reduce(is_inside | (problem.sizes == 1)):
            return z
    stack = cone_stack_of(problem)
    return read_only(stack.pattern.flat(stack.project(stack.pattern.wide(z[None])))[0])


def _checked_algorithm(algorithm: object) -> str | ConeAlgorithm:
    """Return "auto" or the object of a method."""
    if isinstance(algorithm, ConeAlgorithm):
        return algorithm
    name = str(algorithm)
    if name != "auto" and name not in CONE_METHODS:
        raise UnknownAlgorithm(
            f"no algorithm for cones is called {algorithm!r}{did_you_mean(name, {'auto', *CONE_METHODS})}; use one of "
            f"{', '.join(CONE_METHODS)}, or an object of lcp_plugin.problems.cones.methods"
        )
    return name if name == "auto" else CONE_METHODS[name]()


def solve_cone_stack(
    stack: ConeStack, start: Array, tolerance: float, has_time: Callable[[], bool], *, is_warm: bool
) -> tuple[Array, Array, Array, Array]:
    """Solve all problems of a stack by sweeps and Newton's steps, as `solve` does for each.

    Returns
    -------
    z, residual, iterations, is_solved : array, shapes (B, k, m) and (B,)
        Measured points of the cones, their relative residuals, and which are SOLVED.
    """
    z, swept, iterations = start.copy(), start.copy(), np.zeros(stack.B, np.int64)
    residual, is_solved = np.full(stack.B, np.inf), np.zeros(stack.B, np.bool_)
    for count, steps in ((0, 0), *STACK_SCHEDULE)[not is_warm :]:
        left = np.flatnonzero(~is_solved)
        if not left.size or not has_time():
            break
        open_stack = stack.take(~is_solved)
        swept[left], _ = sweep_blocks(open_stack, swept[left], count, methods.STOP * tolerance)
        iterations[left] += count // SWEEPS_PER_STEP
        best, least = swept[left], np.full(left.size, np.inf)
        goal = CLOSER * tolerance
        steps_of_newton = newton.newton_steps(open_stack, best, steps, goal)
        for number, (instances, points, sizes, _) in enumerate(steps_of_newton):
            is_better = sizes < least[instances]
            best[instances[is_better]] = points[is_better]
            least[instances[is_better]] = sizes[is_better]
            iterations[left[instances]] += number > 0
            if not has_time():
                break
        done = least <= goal
        best[done] = newton.polish_points(open_stack.take(done), best[done])[0]
        measured = ConeRows(open_stack).measure_blocks(open_stack.snap(best), tolerance)
        is_better = measured.passes | (measured.residual < residual[left])
        z[left[is_better]] = measured.z[is_better]
        residual[left[is_better]] = measured.residual[is_better]
        is_solved[left[measured.passes]] = True
    return z, residual, iterations, is_solved


def planned(problem: Blocks) -> tuple[str, Any, list[Stage]]:
    """Return the matrix and the stages of a problem over cones for `analyze`."""
    sweeps, steps = (", ".join(map(str, counts)) for counts in zip(*SCHEDULE, strict=True))
    third = (methods.FixedPoint(), CONVEX), (methods.ConeInteriorPoint(), MIDDLE)
    return "M", problem.rows.matrix, [
        Stage(methods.ConeNSGS(), SWEPT, Budget(f"{sweeps} sweeps")),
        Stage(methods.ConeNewton(), "after each of these sweeps", Budget(f"{steps} steps")),
        Stage(*third[problem.has_friction]),
        Stage(methods.ConeNSGS(), "long sweeps, then Newton's steps from points nearby"),
    ]  # fmt: skip


class ConeRun(Run):
    """Run on a problem or component: the best point of the methods is measured at the ends of stages.

    It is one class because it specializes the methods of `Run` for two problem classes.

    Parameters
    ----------
    problem : Blocks
    progress : Progress
        Of the entire problem.
    z : array, shape (n,), or None
        Start passed by the user.
    chosen : str or ConeAlgorithm
        "auto" or a method.
    place : tuple, optional
        Point of the entire problem, the rows of the component and its share of the entries, if `problem` is one.
    swept : Swept, optional
        The first sweeps, if they ended without a solution.

    Attributes
    ----------
    best : Measured
        The point of the smallest residual, as its method computed it until the point is measured.
    unseen : float
        Sweeps that led to no solution; they count with the next step.
    """

    def __init__(
        self,
        problem: Blocks,
        progress: Progress,
        z: Vector | None,
        chosen: Any,
        place: tuple[Any, Any, float] | None = None,
        swept: Swept | None = None,
    ) -> None:
        super().__init__(progress)
        self.swept = swept
        self.problem, self.chosen, self.stack = problem, chosen, cone_stack_of(problem)
        stack = self.stack
        of_whole: tuple[Any, Any, float] = np.empty(problem.n), slice(None), 1.0
        self.whole, self.part_rows, self.share = place or of_whole
        self.tolerance, self.absolute = self.settings.tolerance, self.settings.absolute_tolerance
        self.reached = max(self.tolerance, LEAST_GOAL) if self.absolute else self.tolerance
        if self.absolute:
            least = np.maximum(self.tolerance * stack.reference, self.absolute) / self.reached
            stack.weight = np.where(stack.is_answered, 0.0, 1.0 / least)
        self.goal = CLOSER * self.reached
        self.start = stack.origin if z is None else stack.snap(stack.pattern.wide(z[None]))
        self.is_warm = z is not None and bool((self.start != stack.origin).any())
        self.best = Measured(self.start, np.inf, passes=False)
        self.unseen = 0.0

    @derived_property
    def rows(self) -> ConeRows:
        """The data of the criterion."""
        return ConeRows(self.stack)

    def measure(self, stage: Stage, step: Step) -> Measured | None:
        """Return a point with the residual of its method; None if the best point is at rounding level."""
        if step.measured is not None:
            return step.measured
        if step.residual is None or self.residual <= newton.EXACT:
            return None
        return Measured(step.z, step.residual, passes=False)

    def shown(self, step: Step) -> Vector:
        """Return the point of the entire problem."""
        self.whole[self.part_rows] = self.stack.pattern.flat(self.stack.snap(step.z))[0]
        return read_only(self.whole.copy())

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Measure the best point, except after sweeps that leave a residual."""
        is_swept = isinstance(stage.algorithm, methods.ConeNSGS) and end in FAILED
        if is_swept and self.goal < self.residual < np.inf:
            return end
        self.measure_best()
        return super().end_of_stage(stage, end)

    def measure_best(self) -> None:
        """Measure the best point, after the linear system of its active set if it may pass."""
        z = self.best.z
        if self.best.rows is None and not self.best.passes:
            if newton.EXACT < self.residual <= self.goal:
                z, residual = newton.polish_points(self.stack, z)
                self.residual = float(residual[0])
            z = self.stack.snap(z)
            self.best = self.rows.measure_blocks(z, self.tolerance, self.absolute)

    def status(self, end: Status) -> Status:
        """Return the status; a proof of a component, or of the entire problem, excludes a solution."""
        is_excluded = end in FAILED and self._is_excluded()
        return super().status(Status.NO_SOLUTION if is_excluded else end)

    def _is_excluded(self) -> bool:
        return self.proof is not None and self.proof.excludes(self.tolerance, self.absolute)

    def result(self, end: Status) -> Result:
        """Return the result."""
        self.measure_best()
        name = ", ".join(dict.fromkeys(stage.name for stage in self.progress.records()))
        name = f"auto: {name}" if isinstance(self.chosen, str) else self.chosen.name
        fields = {"algorithm": name, "infeasibility": self.proof, "problem": self.problem}
        z = read_only(self.stack.pattern.flat(self.best.z)[0].copy())
        measured = None if self.best.rows is None else self.best
        certificate = ConeCertificate(self.problem, z, self.tolerance, measured)
        return self.result_at(certificate, self.status(end), ConeResult, _advice=ADVICE, **fields)

    # --- the plan -----------------------------------------------------------------------------------------

    def steps_of(self, stage: Stage) -> Iterator[Step]:
        """Yield the start of the run, then the points of the stage."""
        if self.progress.iteration < 0:
            yield Step(self.start, work=0.0, iterations=0)
        for step in stage.steps:
            if step.z.ndim == 1:  # of an LCP
                step.z = self.stack.pattern.wide(step.z[None])
                step.residual = self.stack.relative_residual(step.z)
            step.work = (step.work + self.unseen) * self.share
            self.unseen = 0.0
            yield step

    def plan(self) -> Iterator[Stage]:
        """Yield the stages: the chosen method, or auto on the entire problem, then on each component."""
        stack, problem, goal = self.stack, self.problem, self.goal
        has_friction = problem.has_friction
        if isinstance(self.chosen, ConeAlgorithm):
            yield Stage(self.chosen, steps=self.chosen.points(problem, stack, self.start, goal))
            return
        yield from self._first_points()
        z = yield from self._sweeps_and_newton(self.start, SCHEDULE[:1])
        if self._solve_components():
            return
        if self.is_warm:
            for share in (SHARES[0], None) if has_friction else ():
                yield self._path(share)
            z = yield from self._sweeps_and_newton(stack.origin, SCHEDULE[:1])
        yield from self._sweeps_and_newton(z, SCHEDULE[1:])
        if not has_friction:
            points = methods.FixedPoint().points(problem, stack, stack.origin, goal)
            yield Stage(methods.FixedPoint(), CONVEX, steps=points)
        elif not self.is_warm:
            yield self._path(None)
        if self.settings.prove_infeasibility:
            self.proof = infeasibility_proof(problem)
            if self._is_excluded():
                return
        if stack.m == 1 and is_searchable(problem.rows):
            search = ExhaustiveSearch()
            points = search.iterates(problem.rows, problem.nearest_to_zero)
            because = "without cones it is an LCP: every choice of bounds"
            yield Stage(search, because, steps=points)
            return
        for share in SHARES if has_friction else ():
            yield self._path(share)
        yield from self._late_stages()

    def _first_points(self) -> Iterator[Stage]:
        """Yield the point of a small contact problem after quick sweeps if it passes, or the start if that passes."""
        stack, most = self.stack, self.settings.max_iterations
        start = stack.pattern.flat(self.start)[0]
        swept = self.swept or first_sweeps(self.problem, start, self.tolerance)
        if swept is not None:
            iterations, bound = swept.iterations, swept.bound
            if bound < np.inf and iterations <= most - max(self.progress.iteration, 0):
                points = stack.pattern.wide(swept.z[np.newaxis])
                point = Measured(points, bound, passes=True)
                step = Step(points, measured=point, work=swept.sweeps + 1.0, iterations=iterations)
                yield Stage(methods.ConeNSGS(), SWEPT, steps=(step,))
            self.unseen = float(swept.sweeps)
        if self.is_warm or stack.is_answered.all():
            residual = stack.relative_residual(self.start)
            if residual <= self.reached:
                yield Stage(methods.ConeNSGS(), SWEPT)
            self.residual = residual

    def _late_stages(self) -> Iterator[Stage]:
        """Yield sweeps until nothing changes, then Newton's method from points nearby."""
        stack = self.stack
        yield self._newton(stack.snap(self.best.z), "from the best point so far")
        z = yield from self._sweeps_and_newton(stack.origin, LONG_SCHEDULE, "until nothing changes")
        is_near = stack.relative_residual(z) < 1.0
        z = z if is_near else stack.snap(self.best.z)
        for seed in range(17):
            yield self._newton(methods.move_at_random(stack, z, seed), "from a point nearby")

    def _sweeps_and_newton(
        self, z: Array, schedule: Any, because: str = SWEPT
    ) -> Generator[Stage, None, Array]:
        """Yield stages of sweeps, each from the end of the last, and of Newton's steps; return the last swept point."""
        for count, steps in schedule:
            points = methods.sweep_points(self.stack, z, count, self.goal)
            yield (sweeps := Stage(methods.ConeNSGS(), because, steps=points))
            z = z if sweeps.z is None else sweeps.z
            yield self._newton(z, "Newton's steps solve for the active set of the sweeps", steps)
        return z

    def _newton(self, z: Array, because: str, steps: int = methods.NEWTON_STEPS) -> Stage:
        points = methods.newton_points(self.stack, z, steps, self.goal)
        return Stage(methods.ConeNewton(), because, steps=points)

    def _path(self, share: float | None) -> Stage:
        """Return the central path from a cold start, or from near the best point."""
        z = self.stack.origin if share is None else self.stack.snap(self.best.z)
        points = methods.path_points(self.stack, z, share or 1.0, self.goal)
        return Stage(methods.ConeInteriorPoint(), MIDDLE, steps=points)

    def _solve_components(self) -> bool:
        """Return whether there are several components; solve each that does not pass, and combine the points."""
        pattern: Any = self.stack.pattern
        if pattern.labels is None:
            return False
        self.measure_best()
        whole, labels = self.whole, pattern.labels[0]
        whole[:] = pattern.flat(self.best.z)[0]
        is_open = self.rows.of_blocks(self.best.by_row.fails(self.tolerance))[0]
        for label in np.unique(labels[is_open]).tolist():
            blocks = labels == label
            rows = blocks[pattern.of_row]
            start = pattern.flat(self.start)[0, rows] if self.is_warm else None
            part = self.problem.part(blocks)
            place = whole, rows, part.nonzeros / max(self.problem.nonzeros, 1)
            run = ConeRun(part, self.progress, start, "auto", place)
            try:
                run.follow_all(run.plan())
            except KeyboardInterrupt:
                self.progress.end = Status.INTERRUPTED
            run.measure_best()
            whole[rows] = run.stack.pattern.flat(run.best.z)[0]
            if run.proof is not None and not self._is_excluded():
                y = np.zeros(pattern.n)
                y[rows] = run.proof.y
                self.proof = ContactInfeasibility(self.problem, y)
            if self.progress.end is not None:
                break
        z = pattern.wide(whole[None])
        self.best = self.rows.measure_blocks(z, self.tolerance, self.absolute)
        return True


@dataclass(frozen=True, eq=False, repr=False)
class ConeResult(Result):
    """The result of a problem over cones; attributes as in :class:`Result`, and the following.

    Attributes
    ----------
    problem : ConeProblem or FrictionalContact
        The solved problem.
    z, w : ndarray, shape (n,)
        The point and its slack; impulses r and velocities u of contacts.
    certificate : ConeCertificate
        All residuals, by blocks.
    status, algorithm, iterations, work, seconds, setup_seconds, tolerance, absolute_tolerance, begun
        See :class:`Result`; work is counted in products with M.
    history, stages, infeasibility
        See :class:`Result`.
    """

    problem: Any = None

    @property
    def guarantee(self) -> None:  # type: ignore[override]
        """None: no convergence theorem of this package covers cones."""

    @derived_property
    def motion(self) -> ContactMotion:
        """Impulses and velocities per contact, and masks of contacts that press and stick."""
        problem = self.problem
        if not isinstance(problem, FrictionalContact):
            raise InvalidOption(f"motion is of a FrictionalContact, got {type(problem).__name__}")
        after = None if problem.bodies is None else problem.bodies.velocities_after(self.z)
        shape = problem.dimension, problem.equations
        return motion_of(self.z, self.w, problem.q, *shape, after)

    def _worst(self, count: int) -> WorstRows:
        return self.certificate.worst(self.tolerance, count)  # type: ignore[attr-defined]

    def _remarks(self) -> list[str]:
        lines = [str(self.infeasibility)] if self.infeasibility is not None else []
        problem = self.problem
        if self.has_no_solution or not isinstance(problem, FrictionalContact):
            return lines
        motion = self.motion
        slides = motion.touches & ~motion.sticks
        lines.append(
            f"{format_count(problem.friction.size, 'contact')}: {int((~motion.touches).sum())} open, "
            f"{int(motion.sticks.sum())} stick, {int(slides.sum())} slide; friction and impact take "
            f"{self.certificate.lost_energy + 0.0:.4g} J in SI units"  # type: ignore[attr-defined]
        )
        asymmetry = float(abs(problem.W - problem.W.T).max()) if problem.n else 0.0
        # Rounded data: W may differ from its transpose by this part of its largest entry
        if asymmetry > DATA_ROUNDING * float(abs(problem.W).max() if problem.n else 0.0):
            lines.append(f"W is not symmetric, by up to {asymmetry:.1e}; it was used unchanged")
        return lines
