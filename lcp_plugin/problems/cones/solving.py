"""Solution of a problem over cones: the sequence of algorithms of auto, the run, the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, checked_start
from ...core.deadline import Clock, time_limit
from ...core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ...core.kernels.threads import threads_for
from ...core.representation import format_count
from ...core.settings import Settings, Status, checked_callback
from ...core.solving.result import Result, Sample, StageRecord, stage_lines
from ..contact import ContactMotion, motion_of
from .certificate import ConeCertificate, Measures, measure_points
from .data import Blocks
from .frictional_contact import FrictionalContact
from .infeasibility import ContactInfeasibility, infeasibility_proof
from .methods import (
    METHODS,
    NEWTON_STEPS,
    PATIENCE,
    STOP,
    SWEEPS_A_STEP,
    ConeAlgorithm,
    FixedPoint,
    move_at_random,
    newton_points,
    path_points,
)
from .newton import EXACT, newton_steps, polish_points
from .stack import ConeStack
from .sweeps import sweeps

Callback = Callable[[Sample, FloatVector], Any]

CLOSER = 0.9  # of the tolerance: the goal of the methods, whose residuals exclude rounding errors
SCHEDULE = ((10, 20), (50, 40), (200, 40))  # sweeps, then steps of Newton's method
SHARES = (0.01, 0.1, 0.001)  # of the largest velocity: distance of a path's start from a point
ROUNDS, LONG, TRIED_AFTER = 8, 2500, (0, 3, 7)  # for sweeps until nothing changes
ROUNDING = 2.0**-44  # of the largest entry of W: tolerated difference from its transpose
STARTS = 17  # of Newton's method, moved at random
GROWTH, VERBOSE_GROWTH = 1.05, 1.5  # of the iterations from one sample, or line, to the next
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
NOT_ASKED = "; not proved infeasible, because prove_infeasibility=False"
NOTHING_TO_DO = "the residual of the start is within the tolerance already"
SWEPT = "cheap sweeps over the blocks find most of the active set"
FOLLOWS = "Newton's steps solve for the active set that the sweeps found"
MIDDLE = "from the middle of the impulses that make the same motion Newton converges"
NEARBY = "from a point nearby"


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
        "npgs", "newton", "interior_point", "fixed_point" or "auto"; or an object of a class in
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
    with np.errstate(all="ignore"):
        stack = ConeStack.of(problem)
        z = None if z0 is None else stack.snap(stack.pattern.wide(checked_start(problem, z0)[None]))
        run = ConeRun(problem, stack, log, z)
        with threads_for(settings.threads), time_limit(settings.max_seconds - log.clock.read()):
            run.solve(chosen)
    result = _result(problem, run, log, chosen)
    if settings.verbose:
        print(f"{result.status.name}: {result.advice}", flush=True)
    return result


def solve_cone_stack(
    stack: ConeStack, start: Any, tolerance: float, has_time: Callable[[], bool], *, is_warm: bool
) -> tuple[Any, Any, Any, Any]:
    """Solve all problems of a stack by sweeps and Newton's steps, as `solve` does for each.

    Returns
    -------
    z, residual, iterations, is_solved : array, shapes (B, k, m) and (B,)
        Measured points of the cones, their relative residuals, and which are SOLVED.
    """
    with np.errstate(all="ignore"):
        z, swept, iterations = start.copy(), start.copy(), np.zeros(stack.B, np.int64)
        found = measure_points(stack, z, tolerance)
        residual = found.worst()
        is_solved = found.pass_at(tolerance) & (is_warm | stack.is_answered.all(1))
        z[is_solved] = found.z[is_solved]
        for count, steps in SCHEDULE:
            left = np.flatnonzero(~is_solved)
            if not left.size or not has_time():
                break
            here = stack.take(~is_solved)
            for at in sweeps(here, swept[left], count, STOP * tolerance):
                swept[left] = at
            iterations[left] += count // SWEEPS_A_STEP
            best, least = swept[left], np.full(left.size, np.inf)
            goal = CLOSER * tolerance
            for number, step in enumerate(newton_steps(here, best.copy(), steps, goal)):
                open_ones, at, sizes, _ = step
                is_better = sizes < least[open_ones]
                best[open_ones[is_better]] = at[is_better]
                least[open_ones[is_better]] = sizes[is_better]
                iterations[left[open_ones]] += number > 0
                if not has_time():
                    break
            done = least <= goal
            best[done] = polish_points(here.take(done), best[done])[0] if done.any() else best[done]
            found = measure_points(here, here.snap(best), tolerance)
            passes, worst = found.pass_at(tolerance), found.worst()
            is_better = passes | (worst < residual[left])
            z[left[is_better]], residual[left[is_better]] = found.z[is_better], worst[is_better]
            is_solved[left[passes]] = True
    return z, residual, iterations, is_solved


class Ended(Exception):
    """Raised if a run ends before its methods do."""

    def __init__(self, status: Status) -> None:
        self.status = status


class Log:
    """Record of a run over all components: counts, samples, callback, printed lines."""

    def __init__(
        self, problem: Blocks, settings: Settings, callback: Callback | None, clock: Clock
    ) -> None:
        self.settings, self.callback, self.clock = settings, callback, clock
        self.iterations, self.work, self.nonzeros = 0, 0.0, max(problem.nonzeros, 1)
        self.stages: dict[tuple[str, str], StageRecord] = {}  # by name and reason
        self.stage = "", ""
        self.samples: list[Sample] = []
        self.is_watched = settings.record or settings.verbose or callback is not None
        self._next = self._next_line = 0
        if settings.verbose:
            print(problem, flush=True)
            print(
                f"{'iteration':>12} {'work':>10} {'relative residual':>19} {'seconds':>9}",
                flush=True,
            )

    def begin(self, name: str, because: str) -> None:
        """Begin a stage, unless it is the current one."""
        if self.stage == (name, because):
            return
        self.stage, self._next_line = (name, because), self.iterations
        self.stages.setdefault(self.stage, StageRecord(name, because, 0, 0.0))
        if self.settings.verbose:
            print(f"{name}: {because}" if because else name, flush=True)

    def count(self, work: float, iterations: int) -> None:
        """Add a step to the last stage."""
        self.iterations, self.work = self.iterations + iterations, self.work + work
        _, _, before, spent, _ = self.stages[self.stage]
        self.stages[self.stage] = StageRecord(*self.stage, before + iterations, spent + work)

    def show(self, residual: float | None, z: Callable[[], FloatVector]) -> None:
        """Record, print and call back with the clock stopped; a true return value raises Ended."""
        with self.clock.pause():
            seconds, name = self.clock.read(), self.stage[0]
            sample = Sample(self.iterations, self.work, seconds, residual, name)
            wants_to_stop = self.callback is not None and bool(self.callback(sample, z()))
            is_due = residual is not None and (self.iterations >= self._next or wants_to_stop)
            if self.settings.record and is_due:
                self._next = max(self.iterations + 1, int(self.iterations * GROWTH))
                self.samples.append(sample)
            is_due = residual is not None and self.iterations >= self._next_line
            if self.settings.verbose and is_due:
                self._next_line = max(self.iterations + 1, int(self.iterations * VERBOSE_GROWTH))
                print(
                    f"{self.iterations:>12} {self.work:>10.1f} {residual:>19.2e} {seconds:>9.3f}",
                    flush=True,
                )
        if wants_to_stop:
            raise Ended(Status.INTERRUPTED)

    def require_room(self) -> None:
        """Raise Ended if a limit is reached."""
        if self.iterations >= self.settings.max_iterations:
            raise Ended(Status.MAX_ITERATIONS)
        self.clock.read()
        if self.clock.elapsed >= self.settings.max_seconds:
            raise Ended(Status.MAX_SECONDS)


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
        z: Any,
        embed: Callable[[FloatVector], FloatVector] = lambda z: z,
    ) -> None:
        self.problem, self.stack, self.log, self.embed = problem, stack, log, embed
        self.share = problem.nonzeros / log.nonzeros  # of the work of the entire problem
        settings = log.settings
        self.tolerance, self.absolute = settings.tolerance, settings.absolute_tolerance
        if self.absolute:
            least = self.absolute / max(self.tolerance, 2.0**-200)
            stack.weight = np.where(
                stack.is_answered, 0.0, 1.0 / np.maximum(stack.reference, least)
            )
        self.goal = CLOSER * (self.tolerance or (2.0**-200 if self.absolute else 0.0))
        self.is_warm = z is not None and bool((z != stack.origin).any())
        self.start = stack.origin if z is None else z
        self.best, self.residual = self.start, np.inf
        self.status, self.swept = Status.STALLED, self.start
        self.proof: ContactInfeasibility | None = None
        self.measures: Measures | None = None

    def solve(self, chosen: str | ConeAlgorithm) -> None:
        """Find a point that passes, or the reason why no point passes."""
        try:
            if isinstance(chosen, ConeAlgorithm):
                points = chosen.points(self.problem, self.stack, self.start, self.goal)
                self.take(chosen.name, "", points, judges=False)
                self._polish()
            else:
                self._chain()
        except Ended as end:
            self.status = end.status
        except KeyboardInterrupt:
            self.status = Status.INTERRUPTED
        if self.measures is None:
            self.measures = self.measure(self.best)
        if self.measures.pass_at(self.tolerance, self.absolute)[0]:
            self.status = Status.SOLVED
        if self.status is Status.STALLED and self.measures.are_limited(self.tolerance)[0]:
            self.status = Status.PRECISION_LIMIT

    def _chain(self) -> None:
        """Run the algorithms of auto, on the entire problem, then on each unsolved component."""
        stack, has_friction = self.stack, self.problem.has_friction
        self.log.begin("npgs", SWEPT)
        if self.is_warm or stack.is_answered.all():
            self.residual = float(stack.measure(self.start)[2][0])
            if self.residual <= self.tolerance:
                self.judge(self.start)
        self._sweep_and_solve(*SCHEDULE[0])
        if stack.pattern.labels is not None:
            self._solve_components()
        if self.is_warm:
            for share in (SHARES[0], None) if has_friction else ():
                self._follow(share)
            self.swept = stack.origin
            self._sweep_and_solve(*SCHEDULE[0])
        for count, steps in SCHEDULE[1:]:
            self._sweep_and_solve(count, steps)
        if not has_friction:
            because = "for a symmetric M a convex program has the same solution"
            points = FixedPoint().points(self.problem, stack, stack.origin, self.goal)
            self.take("fixed_point", because, points)
        elif not self.is_warm:
            self._follow(None)
        self._prove()
        for share in SHARES if has_friction else ():
            self._follow(share)
        self._to_the_end()

    def _prove(self) -> None:
        """Search for a proof of infeasibility, and raise Ended if it excludes all points."""
        if self.log.settings.prove_infeasibility:
            self.log.require_room()
            self.proof = infeasibility_proof(self.problem)
            if self.proof is not None and self.proof.excludes(self.tolerance, self.absolute):
                raise Ended(Status.INFEASIBLE)

    def _to_the_end(self) -> None:
        """Take sweeps until nothing changes, then Newton's method from points nearby."""
        self.swept = self.stack.origin
        start, options = self.stack.snap(self.best), {"patience": PATIENCE}
        points = newton_points(self.stack, start, NEWTON_STEPS, self.goal, **options)
        self.take("newton", "from the best point so far", points)
        for number in range(ROUNDS):
            steps = NEWTON_STEPS if number in TRIED_AFTER else 0
            self._sweep_and_solve(LONG, steps, "until nothing changes", PATIENCE)
        is_near = self.stack.measure(self.swept)[2][0] < 1.0
        z = self.swept if is_near else self.stack.snap(self.best)
        for seed in range(STARTS):
            start = move_at_random(self.stack, z, seed)
            points = newton_points(self.stack, start, NEWTON_STEPS, self.goal, **options)
            self.take("newton", NEARBY, points)

    def _sweep_and_solve(
        self, count: int, steps: int, because: str = SWEPT, patience: int = 15
    ) -> None:
        """Continue the sweeps from their last point, then take Newton's steps."""
        log = self.log
        log.begin("npgs", because)
        count = min(count, SWEEPS_A_STEP * (log.settings.max_iterations - log.iterations))
        for number, at in enumerate(sweeps(self.stack, self.swept, count, STOP * self.tolerance)):
            if not np.isfinite(at).all():
                break
            self.swept = at
            if number and log.callback is not None:
                log.show(None, lambda: self._shown(at))  # noqa: B023 - called at once
            log.require_room()
        log.count((count + 1.0) * self.share, count // SWEEPS_A_STEP)
        points = newton_points(self.stack, self.swept, steps, self.goal, patience=patience)
        self.take("newton", FOLLOWS, points)

    def _follow(self, share: float | None) -> None:
        """Follow the central path from a cold start, or from near the best point."""
        z = self.stack.origin if share is None else self.stack.snap(self.best)
        self.take("interior_point", MIDDLE, path_points(self.stack, z, share or 1.0, self.goal))

    def take(self, name: str, because: str, points: Iterator[Any], *, judges: bool = True) -> None:
        """Run one method, keep its best point, and measure this point at the end."""
        log = self.log
        for number, (z, residual, work) in enumerate(points):
            is_there = not number and residual <= EXACT and name == "newton" and judges
            if not is_there:
                if not number:
                    log.begin(name, because)
                log.count(work * self.share, int(number > 0))
            self.offer(z, residual)
            if log.is_watched:
                log.show(residual, lambda: self._shown(z))  # noqa: B023 - called at once
            if is_there:
                break
            if judges or not residual <= self.goal:
                log.require_room()
        if judges:
            self.judge(self.best)

    def offer(self, z: Any, residual: float) -> None:
        """Store the point if it is the best; below EXACT, differences are rounding errors."""
        if (residual < self.residual and self.residual > EXACT) or self.residual == np.inf:
            self.best, self.residual = z, residual
            self.measures = None

    def _shown(self, z: Any) -> FloatVector:
        found: FloatVector = self.embed(self.stack.pattern.flat(self.stack.snap(z))[0].copy())
        found.flags.writeable = False
        return found

    def measure(self, z: Any) -> Measures:
        """Return the measures of the nearest point of the cones."""
        return measure_points(self.stack, self.stack.snap(z), self.tolerance, self.absolute)

    def judge(self, z: Any) -> None:
        """Raise Ended if the point passes, or fails only because of rounding error."""
        if EXACT < self.residual <= self.goal:
            self._polish()
            z = self.best
        self.measures = self.measure(z)
        if self.measures.pass_at(self.tolerance, self.absolute)[0]:
            raise Ended(Status.SOLVED)
        if self.measures.are_limited(self.tolerance)[0]:
            raise Ended(Status.PRECISION_LIMIT)

    def _polish(self) -> None:
        """Solve the linear system of the active set of the best point."""
        self.best, residual = polish_points(self.stack, self.best)
        self.residual, self.measures = float(residual[0]), None

    def _solve_components(self) -> None:
        """Solve each component that does not pass, and combine the points."""
        pattern: Any = self.stack.pattern
        whole = self.stack.snap(self.best)
        flat = pattern.flat(whole)[0].copy()
        labels, measures = pattern.labels[0], self.measures
        assert measures is not None
        is_open = ~((measures.relative <= self.tolerance) & (measures.terms <= self.tolerance))[0]
        statuses = [Status.SOLVED]
        for label in np.unique(labels[is_open]).tolist():
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
            assert run.measures is not None
            flat[rows] = stack.pattern.flat(run.measures.z)[0]
            statuses.append(run.status)
            if run.proof is not None and (self.proof is None or run.status is Status.INFEASIBLE):
                y = np.zeros(pattern.n)
                y[rows] = run.proof.y
                self.proof = ContactInfeasibility(self.problem, y)
            if run.status in (Status.INTERRUPTED, Status.MAX_SECONDS, Status.MAX_ITERATIONS):
                break
        self.measures = measure_points(
            self.stack, pattern.wide(flat[None]), self.tolerance, self.absolute
        )
        raise Ended(max(statuses, key=WORST.index))


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


def _result(problem: Blocks, run: ConeRun, log: Log, chosen: str | ConeAlgorithm) -> ConeResult:
    """Return the result of a run."""
    settings, measures = log.settings, run.measures
    assert measures is not None
    certificate = ConeCertificate(problem, measures)
    words = dict(WORDS)
    if not settings.prove_infeasibility:
        words[Status.STALLED] += NOT_ASKED
    every = tuple(log.stages.values())
    stages = tuple(stage for stage in every if stage.work) or every[:1]
    if run.status is Status.SOLVED and not log.iterations:
        stages = tuple(stage._replace(because=NOTHING_TO_DO) for stage in stages)
    name = ", ".join(dict.fromkeys(stage.name for stage in stages))
    held: Any = certificate
    return ConeResult(
        z=certificate.z,
        w=certificate.w,
        status=run.status,
        certificate=held,
        algorithm=f"auto: {name}" if chosen == "auto" else chosen.name,  # type: ignore[union-attr]
        iterations=log.iterations,
        work=log.work,
        seconds=log.clock.read(),
        setup_seconds=0.0,
        tolerance=settings.tolerance,
        absolute_tolerance=settings.absolute_tolerance,
        history=tuple(log.samples),
        stages=stages,
        infeasibility=run.proof,
        _advice=words,
        problem=problem,
    )


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
