"""Solution of a problem over cones: the sequence of algorithms of auto, the run, the result."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.algorithm import Step
from ...core.checks import FloatVector, checked_start
from ...core.deadline import Clock, time_limit
from ...core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ...core.kernels.threads import threads_for
from ...core.representation import format_count
from ...core.settings import Settings, Status, checked_callback
from ...core.solving.advice import NOTHING_TO_DO
from ...core.solving.result import Result, Sample, stage_lines
from ...core.solving.run_log import RunLog, say
from ...core.solving.stage import Stage
from ..contact import ContactMotion, motion_of
from .certificate import ConeCertificate, Measures
from .data import Blocks
from .frictional_contact import FrictionalContact
from .infeasibility import ContactInfeasibility, infeasibility_proof
from .methods import (
    METHODS,
    NEWTON_STEPS,
    PATIENCE,
    STOP,
    SWEEPS_PER_STEP,
    ConeAlgorithm,
    ConeInteriorPoint,
    ConeNewton,
    ConeNSGS,
    FixedPoint,
    Points,
    move_at_random,
    newton_points,
    path_points,
    sweep_points,
)
from .newton import EXACT, newton_steps, polish_points
from .stack import Array, ConeStack
from .sweeps import sweep_blocks

Callback = Callable[[Sample, FloatVector], Any]

CLOSER = 0.9  # of the tolerance: the goal of the methods, whose residuals exclude rounding errors
SCHEDULE = ((10, 20), (50, 40), (200, 40))  # sweeps, then steps of Newton's method
LONG_SCHEDULE = tuple((count, NEWTON_STEPS) for count in (2500, 7500, 10000))
SHARES = (0.01, 0.1, 0.001)  # of the largest velocity: distance of a path's start from a point
ROUNDING = 2.0**-44  # of the largest entry of W: tolerated difference from its transpose
WORST = (
    Status.SOLVED,
    Status.PRECISION_LIMIT,
    Status.STALLED,
    Status.MAX_ITERATIONS,
    Status.MAX_SECONDS,
    Status.INFEASIBLE,
    Status.INTERRUPTED,
)  # the last of these statuses that a component has is the status of the problem
WORDS = {
    Status.STALLED: (
        "no method reduces the residual further; next: try another start z0, or less friction: with much friction or "
        "a singular W, a contact problem need not have a solution"
    ),
    Status.INFEASIBLE: (
        "no z in the cones has an M z + q in their duals (no impulses keep every contact from closing further), even "
        "with errors as large as the tolerance; next: check the data; result.proof proves it"
    ),
}
SWEPT = "cheap sweeps over the blocks find most of the active set"
FOLLOWS = "Newton's steps solve for the active set that the sweeps found"
MIDDLE = "from the middle of the impulses that make the same motion Newton converges"
NEARBY = "from a point nearby"
StagePlan = tuple[Any, str, Points]  # method, reason of its choice, points


def solve_cones(
    problem: Blocks,
    algorithm: str | ConeAlgorithm = "auto",
    *,
    z0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    record: bool = False,
    callback: Callback | None = None,
    prove_infeasibility: bool = True,
    threads: int | None = None,
    verbose: bool = False,
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
    max_iterations, max_seconds, absolute_tolerance, record, callback, prove_infeasibility, threads, verbose
        As for :func:`lcp_plugin.solve`.

    Returns
    -------
    ConeResult

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        For a wrong option.
    """
    settings = Settings(
        tolerance=tolerance,
        max_iterations=max_iterations,
        max_seconds=max_seconds,
        absolute_tolerance=absolute_tolerance,
        record=record,
        threads=threads,
        verbose=verbose,
        prove_infeasibility=prove_infeasibility,
    )
    chosen = _checked_algorithm(algorithm)
    log = Log(problem, settings, checked_callback(callback), Clock())
    with (
        np.errstate(all="ignore"),
        threads_for(settings.threads),
        time_limit(settings.max_seconds - log.clock.read()),
    ):
        stack = ConeStack.of(problem)
        z = None if z0 is None else stack.snap(stack.pattern.wide(checked_start(problem, z0)[None]))
        run = ConeRun(problem, stack, log, z)
        run.solve(chosen)
    certificate: Any = ConeCertificate(problem, run.measures)
    words = dict(WORDS)
    if not prove_infeasibility:
        words[Status.STALLED] += "; not proved infeasible, because prove_infeasibility=False"
    stages = tuple(record for stage in log.stages.values() for record in stage.records())
    if run.status is Status.SOLVED and not log.iterations:
        stages = tuple(stage._replace(because=NOTHING_TO_DO) for stage in stages)
    name = ", ".join(dict.fromkeys(stage.name for stage in stages))
    result = ConeResult(
        z=certificate.z,
        w=certificate.w,
        status=run.status,
        certificate=certificate,
        algorithm=chosen.name if isinstance(chosen, ConeAlgorithm) else f"auto: {name}",
        iterations=log.iterations,
        work=log.work,
        seconds=log.clock.read(),
        setup_seconds=0.0,
        tolerance=tolerance,
        absolute_tolerance=absolute_tolerance,
        history=tuple(log.samples),
        stages=stages,
        infeasibility=run.proof,
        _advice=words,
        problem=problem,
    )
    if verbose:
        say(f"{result.status.name}: {result.advice}")
    return result


def _checked_algorithm(algorithm: Any) -> str | ConeAlgorithm:
    """Return "auto" or the object of a method."""
    if isinstance(algorithm, ConeAlgorithm):
        return algorithm
    name = str(algorithm)
    if name != "auto" and name not in METHODS:
        raise UnknownAlgorithm(
            f"no algorithm for cones is called {algorithm!r}{did_you_mean(name, {'auto', *METHODS})}; use one of "
            f"{', '.join(METHODS)}, or an object of lcp_plugin.problems.cones.methods"
        )
    return name if name == "auto" else METHODS[name]()


def solve_cone_stack(
    stack: ConeStack, start: Array, tolerance: float, has_time: Callable[[], bool], *, is_warm: bool
) -> tuple[Array, Array, Array, Array]:
    """Solve all problems of a stack by sweeps and Newton's steps, as `solve` does for each.

    Returns
    -------
    z, residual, iterations, is_solved : array, shapes (B, k, m) and (B,)
        Measured points of the cones, their relative residuals, and which are SOLVED.
    """
    with np.errstate(all="ignore"):
        z, swept, iterations = start.copy(), start.copy(), np.zeros(stack.B, np.int64)
        residual, is_solved = np.full(stack.B, np.inf), np.zeros(stack.B, np.bool_)
        for count, steps in ((0, 0), *SCHEDULE) if is_warm else SCHEDULE:
            left = np.flatnonzero(~is_solved)
            if not left.size or not has_time():
                break
            here = stack.take(~is_solved)
            swept[left] = sweep_blocks(here, swept[left], count, STOP * tolerance)
            iterations[left] += count // SWEEPS_PER_STEP
            best, least = swept[left], np.full(left.size, np.inf)
            goal = CLOSER * tolerance
            for number, step in enumerate(newton_steps(here, best, steps, goal)):
                open_ones, at, sizes, _ = step
                is_better = sizes < least[open_ones]
                best[open_ones[is_better]] = at[is_better]
                least[open_ones[is_better]] = sizes[is_better]
                iterations[left[open_ones]] += number > 0
                if not has_time():
                    break
            done = least <= goal
            best[done] = polish_points(here.take(done), best[done])[0]
            found = Measures(here, here.snap(best), tolerance)
            worst = found.worst()
            is_better = found.is_solved | (worst < residual[left])
            z[left[is_better]], residual[left[is_better]] = found.z[is_better], worst[is_better]
            is_solved[left[found.is_solved]] = True
    return z, residual, iterations, is_solved


class Ended(Exception):
    """Raised if a limit or the callback ends a run."""

    def __init__(self, status: Status) -> None:
        self.status = status


class Log:
    """Record of a run over all components: stages, samples, callback, printed lines, limits."""

    def __init__(
        self, problem: Blocks, settings: Settings, callback: Callback | None, clock: Clock
    ) -> None:
        self.settings, self.callback, self.clock = settings, callback, clock
        self.iterations, self.work, self.nonzeros = 0, 0.0, max(problem.nonzeros, 1)
        self.stages: dict[tuple[str, str], Stage] = {}  # by name and reason
        self.samples: list[Sample] = []
        self._next = 0
        self._printed = RunLog(problem) if settings.verbose else None

    def begin(self, algorithm: Any, because: str) -> Stage:
        """Return a stage, a new one or an earlier one of this name and reason; raise Ended if a limit is reached."""
        stage = self.stages.setdefault((algorithm.name, because), Stage(algorithm, because))
        if self._printed is not None:
            self._printed.begin(stage)
        self._require_room()
        return stage

    def _require_room(self) -> None:
        if self.iterations >= self.settings.max_iterations:
            raise Ended(Status.MAX_ITERATIONS)
        self.clock.read()
        if self.clock.elapsed >= self.settings.max_seconds:
            raise Ended(Status.MAX_SECONDS)

    def step(self, stage: Stage, z: Any, residual: float, work: float) -> None:
        """Count, record and print a step, and call back with z; raise Ended if the run ends with it."""
        stage.count(Step(z, work=work))
        self.iterations, self.work = self.iterations + 1, self.work + work
        wants_to_stop = False
        with self.clock.pause():
            seconds, name = self.clock.read(), stage.algorithm.name
            sample = Sample(self.iterations, self.work, seconds, residual, name)
            if self.callback is not None:
                wants_to_stop = bool(self.callback(sample, z))
            if self.settings.record and (self.iterations >= self._next or wants_to_stop):
                self._next = max(self.iterations + 1, int(self.iterations * 1.05))
                self.samples.append(sample)
            if self._printed is not None and self._printed.is_due(stage):
                self._printed.step(stage, sample)
        if wants_to_stop:
            raise Ended(Status.INTERRUPTED)
        self._require_room()


class ConeRun:
    """Run on a problem or component: methods yield points, the best is stored and measured.

    Parameters
    ----------
    problem : Blocks
    stack : ConeStack
        Stack of this problem only.
    log : Log
    z : array, shape (1, k, m), or None
        Start passed by the user.
    embed : callable
        Function that embeds a point of the component, shape (n,), into a point of the entire problem.
    """

    def __init__(
        self,
        problem: Blocks,
        stack: ConeStack,
        log: Log,
        z: Array,
        embed: Callable[[FloatVector], FloatVector] = lambda z: z,
    ) -> None:
        self.problem, self.stack, self.log, self.embed = problem, stack, log, embed
        self.share = problem.nonzeros / log.nonzeros  # of the work of the entire problem
        self.tolerance, self.absolute = log.settings.tolerance, log.settings.absolute_tolerance
        reached = self.tolerance
        if self.absolute:
            reached = max(self.tolerance, 2.0**-200)
            least = np.maximum(stack.reference, self.absolute / reached)
            stack.weight = np.where(stack.is_answered, 0.0, 1.0 / least)
        self.goal = CLOSER * reached
        self.is_warm = z is not None and bool((z != stack.origin).any())
        self.start = stack.origin if z is None else z
        self.best, self.residual, self.last = self.start, np.inf, self.start
        self.status = Status.STALLED
        self.proof: ContactInfeasibility | None = None
        self.measures: Any = None

    def solve(self, chosen: str | ConeAlgorithm) -> None:
        """Take the steps of all stages until a point passes, or rounding error explains why none passes."""
        try:
            for algorithm, because, points in self._stages(chosen):
                stage = self.log.begin(algorithm, because)
                for z, residual, work in points:
                    self.last = z
                    # below EXACT, differences are rounding errors
                    if residual < self.residual and self.residual > EXACT:
                        self.best, self.residual, self.measures = z, residual, None
                    shown = None if self.log.callback is None else self._shown(z)
                    self.log.step(stage, shown, residual, work * self.share)
                if algorithm is not ConeNSGS or not self.goal < self.residual < np.inf:
                    self._measure_best()
                    if self.measures.is_solved[0] or self.measures.are_limited()[0]:
                        break
        except Ended as end:
            self.status = end.status
        except KeyboardInterrupt:
            self.status = Status.INTERRUPTED
        self._measure_best()
        if self.measures.is_solved[0]:
            self.status = Status.SOLVED
        if self.status is Status.STALLED and self.measures.are_limited()[0]:
            self.status = Status.PRECISION_LIMIT

    def _shown(self, z: Array) -> FloatVector:
        found = self.embed(self.stack.pattern.flat(self.stack.snap(z))[0].copy())
        found.flags.writeable = False
        return found

    def _measure_best(self) -> None:
        """Measure the best point, after the linear system of its active set if it may pass."""
        if self.measures is not None:
            return
        if EXACT < self.residual <= self.goal:
            self.best, residual = polish_points(self.stack, self.best)
            self.residual = float(residual[0])
        z = self.stack.snap(self.best)
        self.measures = Measures(self.stack, z, self.tolerance, self.absolute)

    def _stages(self, chosen: str | ConeAlgorithm) -> Iterator[StagePlan]:
        """Yield the stages: the chosen method, or auto on the entire problem, then on each component."""
        stack, problem, goal = self.stack, self.problem, self.goal
        has_friction = problem.has_friction
        if isinstance(chosen, ConeAlgorithm):
            yield chosen, "", chosen.points(problem, stack, self.start, goal)
            return
        if self.is_warm or stack.is_answered.all():
            residual = stack.relative_residual(self.start)
            if residual <= self.tolerance:
                yield ConeNSGS, SWEPT, iter(())
            self.residual = residual
        z = yield from self._sweeps_and_newton(self.start, SCHEDULE[:1])
        if self._solve_components():
            return
        if self.is_warm:
            for share in (SHARES[0], None) if has_friction else ():
                yield self._path(share)
            z = yield from self._sweeps_and_newton(stack.origin, SCHEDULE[:1])
        yield from self._sweeps_and_newton(z, SCHEDULE[1:])
        if not has_friction:
            because = "for a symmetric M a convex program has the same solution"
            yield FixedPoint, because, FixedPoint().points(problem, stack, stack.origin, goal)
        elif not self.is_warm:
            yield self._path(None)
        if self.log.settings.prove_infeasibility:
            self.proof = infeasibility_proof(problem)
            if self.proof is not None and self.proof.excludes(self.tolerance, self.absolute):
                self.status = Status.INFEASIBLE
                return
        for share in SHARES if has_friction else ():
            yield self._path(share)
        yield from self._late_stages()

    def _sweeps_and_newton(
        self, z: Array, schedule: Any, because: str = SWEPT, **options: Any
    ) -> Generator[StagePlan, None, Array]:
        """Yield stages of sweeps, each from the end of the last, and of Newton's steps; return the last swept point."""
        for count, steps in schedule:
            self.last = z
            yield ConeNSGS, because, sweep_points(self.stack, z, count, self.goal)
            z = self.last
            yield ConeNewton, FOLLOWS, newton_points(self.stack, z, steps, self.goal, **options)
        return z

    def _path(self, share: float | None) -> StagePlan:
        """Return the central path from a cold start, or from near the best point."""
        z = self.stack.origin if share is None else self.stack.snap(self.best)
        return ConeInteriorPoint, MIDDLE, path_points(self.stack, z, share or 1.0, self.goal)

    def _late_stages(self) -> Iterator[StagePlan]:
        """Yield sweeps until nothing changes, then Newton's method from points nearby."""

        def newton(z: Array, because: str) -> StagePlan:
            points = newton_points(self.stack, z, NEWTON_STEPS, self.goal, patience=PATIENCE)
            return ConeNewton, because, points

        stack = self.stack
        yield newton(stack.snap(self.best), "from the best point so far")
        z = yield from self._sweeps_and_newton(
            stack.origin, LONG_SCHEDULE, "until nothing changes", patience=PATIENCE
        )
        is_near = stack.relative_residual(z) < 1.0
        z = z if is_near else stack.snap(self.best)
        for seed in range(17):
            yield newton(move_at_random(stack, z, seed), NEARBY)

    def _solve_components(self) -> bool:
        """Return whether there are several components; solve each that does not pass, and combine the points."""
        pattern: Any = self.stack.pattern
        if pattern.labels is None:
            return False
        flat = pattern.flat(self.stack.snap(self.best))[0].copy()
        labels = pattern.labels[0]
        statuses = [Status.SOLVED]
        for label in np.unique(labels[~self.measures.do_pass[0]]).tolist():
            blocks = labels == label
            rows = blocks[pattern.of_row]

            def embed(z: FloatVector, rows: Any = rows) -> FloatVector:
                found = flat.copy()
                found[rows] = z
                return self.embed(found)

            part = self.problem.part(blocks)
            stack = ConeStack.of(part)
            start = stack.pattern.wide(pattern.flat(self.start)[:, rows]) if self.is_warm else None
            run = ConeRun(part, stack, self.log, start, embed)
            run.solve("auto")
            flat[rows] = stack.pattern.flat(run.measures.z)[0]
            statuses.append(run.status)
            if run.proof is not None and (self.proof is None or run.status is Status.INFEASIBLE):
                y = np.zeros(pattern.n)
                y[rows] = run.proof.y
                self.proof = ContactInfeasibility(self.problem, y)
            if run.status in (Status.INTERRUPTED, Status.MAX_SECONDS, Status.MAX_ITERATIONS):
                break
        self.status = max(statuses, key=WORST.index)
        z = pattern.wide(flat[None])
        self.measures = Measures(self.stack, z, self.tolerance, self.absolute)
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

    @cached_property
    def motion(self) -> ContactMotion:
        """Impulses and velocities per contact, and masks of contacts that press and stick."""
        problem = self.problem
        if not isinstance(problem, FrictionalContact):
            raise InvalidOption(
                f"motion is of a FrictionalContact, got {type(problem).__name__}; read z and w"
            )
        r, u = self.z.reshape(-1, problem.dimension), self.w.reshape(-1, problem.dimension)
        bodies, after = problem.bodies, None
        if bodies is not None and bodies.velocities is not None:
            after = bodies.velocities + bodies.by_impulse @ self.z
        return motion_of(r, u, problem.q, after)

    def _effort(self) -> str:
        return (
            f"{self.algorithm}: {format_count(self.iterations, 'iteration')}, {self.seconds:.3g} s, the work of "
            f"{self.work:.1f} products of M with a vector"
        )

    def explain(self) -> str:
        """Return status, reliability and advice, a line each; then reason and stages."""
        lines = [*self._verdict(), *self._course(), *stage_lines(self.stages)]
        if self.infeasibility is not None:
            lines.append(str(self.infeasibility))
        if isinstance(self.problem, FrictionalContact):
            lines += self._contacts_in_words()
        return "\n".join(lines)

    @np.errstate(over="ignore", under="ignore")
    def _contacts_in_words(self) -> list[str]:
        motion, problem = self.motion, self.problem
        slides = motion.touches & ~motion.sticks
        lines = [
            f"{format_count(problem.slope.size, 'contact')}: {int((~motion.touches).sum())} open, "
            f"{int(motion.sticks.sum())} stick, {int(slides.sum())} slide; friction and impact take "
            f"{self.certificate.lost_energy + 0.0:.4g} J in SI units"  # type: ignore[attr-defined]
        ]
        asymmetry = float(abs(problem.W - problem.W.T).max()) if problem.n else 0.0
        if asymmetry > ROUNDING * float(abs(problem.W).max() if problem.n else 0.0):
            lines.append(
                f"W is not symmetric: entries differ by up to {asymmetry:.1e}; it was used as it is given"
            )
        return lines

    def _numbers(self) -> dict[str, float]:
        residuals = ("relative_residual", "natural_residual", "term_residual")
        own = ("work", "setup_seconds", "tolerance", "absolute_tolerance")
        numbers = {name: getattr(self.certificate, name) for name in residuals}
        numbers |= {
            name: getattr(self, name) for name in own[: 4 if self.absolute_tolerance else 3]
        }
        return {"n": self.problem.n, **numbers}
