"""Solving a problem over cones: what auto tries in turn, the judge, the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...auto import Single
from ...core.algorithm import Algorithm
from ...core.certificates.criterion import CommonScaling, within
from ...core.certificates.residuals import Certificate
from ...core.certificates.row_residuals import over
from ...core.checks import FloatVector, checked_vector, read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem, UnknownAlgorithm, did_you_mean
from ...core.kernels.threads import threads_for
from ...core.matrix.structure import Components, connected_components
from ...core.matrix.symmetry import is_symmetric_to_rounding
from ...core.policy.policy import Policy
from ...core.policy.stages import Choice, Stage
from ...core.representation import in_words
from ...core.settings import Settings, Status, checked_callback
from ...core.solving.advice import NOTHING_TO_DO
from ...core.solving.judge import End, Judge
from ...core.solving.result import Result, StageRecord, stage_lines
from ...core.solving.run import Callback, Run
from ...systems.factors import sizes_of_factor
from ..contact import ContactMotion, motion_of
from .certificate import ConeCertificate, criterion_of, relative_residual
from .data import Blocks
from .frictional_contact import FrictionalContact
from .infeasibility import InfeasibilityCheck, NoImpulse
from .methods import (
    EXACT,
    METHODS,
    NPGS,
    SWEEPS_A_STEP,
    ConeAlgorithm,
    FixedPoint,
    InteriorPoint,
    Newton,
    NewtonSystem,
)
from .small import LARGEST, LoopAnswers, has_few_bodies, solve_contacts, solve_small

TRIAL = 2  # steps of npgs before its rate is believed
NEWTON_STEPS = 15  # that an answer is predicted to take
STEP_OPERATIONS = 5e5  # that the calls of one of its steps take as long as
BEFORE_THE_PATH = (
    40  # steps of Newton before an interior point, which costs about as much as so many
)
SHARED = 10  # steps of sweeps that components share, before each gets its own run
LAST_STEPS = 2  # the linear system of the cases that were found, and of those that it finds
STARTS = 17  # of Newton's method, moved at random but for the first
LONG, LONG_STEPS = 500, 40  # sweeps a step, and steps, of those that no prediction cuts short
WORST = (
    Status.SOLVED,
    Status.PRECISION_LIMIT,
    Status.STALLED,
    Status.DIVERGED,
    Status.MAX_ITERATIONS,
    Status.MAX_SECONDS,
    Status.INFEASIBLE,
    Status.INTERRUPTED,
)  # the last of these that a component has is that of all
NEARBY = "from a point nearby"
FOLLOWS = "sweeps have found most cases, Newton's steps solve for them"
MIDDLE = "from the middle of the impulses that make the same motion Newton converges"
SWEEPS = "cheap sweeps over the blocks come first; how fast they are decides what follows"


def solve_cones(
    problem: Blocks,
    algorithm: str | Algorithm = "auto",
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
    """Return the answer to a :class:`ConeProblem` or :class:`FrictionalContact`, judged on its own data.

    Parameters
    ----------
    problem : ConeProblem or FrictionalContact
    algorithm : str or object
        "npgs", "newton", "interior_point", "fixed_point" or "auto"; or an object of their classes in
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
        tolerance,
        "residual",
        max_iterations,
        max_seconds,
        absolute_tolerance,
        record,
        False,
        threads,
        verbose,
        prove_infeasibility,
    )
    checked_callback(callback)
    clock = Clock()
    result = _solved(
        problem, algorithm, settings, callback, clock, None if z0 is None else _start(problem, z0)
    )
    is_cut_short = (
        result.status is Status.MAX_ITERATIONS and result.iterations < settings.max_iterations
    )
    is_open = is_cut_short or result.status in (
        Status.STALLED,
        Status.PRECISION_LIMIT,
        Status.DIVERGED,
    )
    several = connected_components(problem.block_norms.matrix) if is_open else None
    return (
        result
        if several is None
        else _solved_apart(result, several, algorithm, settings, clock, z0)
    )


def _solved(
    problem: Blocks,
    algorithm: str | Algorithm,
    settings: Settings,
    callback: Callback | None,
    clock: Clock,
    z0: FloatVector | None,
) -> ConeResult:
    """Return the answer where all components share a run; by auto sweeps only, where there are several."""
    start = problem.nearest_to_zero if z0 is None else z0
    was_tried = is_ended = False
    is_step = z0 is not None and has_few_bodies(
        problem
    )  # one alone does not pay for what is compiled for many
    if (
        algorithm == "auto"
        and callback is None
        and _is_for_the_loop(problem, settings, clock, is_step=is_step)
    ):
        try:
            found = solve_contacts(problem, settings, start=start) if is_step else None
            if found is None or not (found.is_proved[0] or problem.n > LARGEST):
                found = solve_small([problem], settings, start=None if is_step else z0)
            known = (
                None if found.is_proved[0] else _at_rounding_level(problem, found.z[0], settings)
            )
            was_tried = not found.is_proved[0] and known is None
            if not was_tried:
                result = result_of(problem, found, 0, settings, clock.read(), known)
                if result.iterations <= settings.max_iterations:
                    return result
        except KeyboardInterrupt:
            is_ended = True
    with np.errstate(), threads_for(settings.threads):
        policy = _policy(problem, algorithm, settings, is_warm=z0 is not None, was_tried=was_tried)
        if algorithm == "auto" and connected_components(problem.block_norms.matrix) is not None:
            settings = _within(settings, settings.max_seconds, min(settings.max_iterations, SHARED))
        judge = ConeJudge(problem, settings)
        run = Run(judge.scaling, policy, settings, callback, clock, judge)
        judge.products = lambda: run.state.work
        try:
            reason = End.INTERRUPTED if is_ended else run.drive(start, policy.first(problem))  # type: ignore[arg-type]
        except KeyboardInterrupt:
            reason = End.INTERRUPTED
        return ConeResult.of(problem, run.judged(start, reason))


def _solved_apart(
    together: ConeResult,
    several: Components,
    algorithm: str | Algorithm,
    settings: Settings,
    clock: Clock,
    z0: ArrayLike | None,
) -> ConeResult:
    """Return the answer with each component solved alone that the common run has left open."""
    problem, z = together.problem, together.z.copy()
    statuses, proofs, advice = [Status.SOLVED], [], together._advice
    stages, iterations, work = list(together.stages), 0, together.work
    for blocks in _open_components(together.certificate, several, settings.tolerance):
        left = settings.max_seconds - clock.read()
        if not left > 0.0:
            statuses.append(Status.MAX_SECONDS)
            break
        part, rows = problem.part(blocks), blocks[problem.block_of_row]
        steps = settings.max_iterations - together.iterations
        plain = _within(settings, left, steps, record=False, verbose=False)
        found = _solved(
            part, algorithm, plain, None, Clock(), None if z0 is None else _start(problem, z0)[rows]
        )
        z[rows], share = found.z, part.nonzeros / max(problem.nonzeros, 1)
        stages += [stage._replace(work=stage.work * share) for stage in found.stages]
        iterations, work = max(iterations, found.iterations), work + found.work * share
        if found.infeasibility is not None:
            y = np.zeros(problem.n)
            y[rows] = found.infeasibility.y
            proofs.append(NoImpulse(problem, y))
        statuses.append(found.status)
        advice = found._advice if found.status is max(statuses, key=WORST.index) else advice
    certificate = ConeCertificate.at(problem, z)
    names = ", ".join(dict.fromkeys(stage.name for stage in stages))
    return replace(
        together,
        z=certificate.point,
        w=certificate.velocity,
        certificate=certificate,
        stages=_merged(stages),
        status=max(statuses, key=WORST.index),
        infeasibility=next(iter(proofs), None),
        _advice=advice,
        work=work,
        iterations=together.iterations + iterations,
        seconds=clock.read(),
        algorithm=f"auto: {names}" if algorithm == "auto" else together.algorithm,
    )


def _within(settings: Settings, seconds: float, iterations: int, **others: bool) -> Settings:
    """Return the settings with other limits."""
    limit = None if seconds == np.inf else seconds
    return replace(settings, max_seconds=limit, max_iterations=iterations, **others)


def _open_components(
    certificate: Certificate, several: Components, tolerance: float
) -> Iterator[NDArray[np.bool_]]:
    """Yield the blocks of each component that is not SOLVED, as an array of bool, shape (k,)."""
    relative = over(*certificate.residuals_of_components)
    for label in np.flatnonzero(
        ~within(relative, several.largest(certificate.term_residuals), tolerance)
    ):
        yield several.labels == label


def _merged(stages: Sequence[StageRecord]) -> tuple[StageRecord, ...]:
    """Return the stages with those of one name and reason as one."""
    merged: dict[tuple[str, str], StageRecord] = {}
    for stage in stages:
        known = merged.get(key := stage[:2])
        merged[key] = (
            stage
            if known is None
            else known._replace(
                iterations=known.iterations + stage.iterations, work=known.work + stage.work
            )
        )
    return tuple(merged.values())


def _is_for_the_loop(problem: Blocks, settings: Settings, clock: Clock, *, is_step: bool) -> bool:
    """Return whether the problem is small, and nobody wants to see the steps or a measure that the loop lacks."""
    is_plain = (
        settings.is_unobserved and settings.max_iterations > 0 and not settings.absolute_tolerance
    )
    is_small = 0 < problem.n <= LARGEST
    return (is_small or is_step) and is_plain and clock.read() < settings.max_seconds


def _at_rounding_level(
    problem: Blocks, z: FloatVector, settings: Settings
) -> tuple[ConeCertificate, Status] | None:
    """Return what the judge says of a z whose residual is no larger than rounding explains; None of another."""
    judge = ConeJudge(problem, settings)
    if not judge.is_at_floor(z):
        return None
    certificate: Any = judge.final(z, End.AT_FLOOR, None)
    return certificate, judge.verdict(certificate, End.AT_FLOOR, is_chain=False)


def result_of(
    problem: Blocks,
    found: LoopAnswers,
    k: int,
    settings: Settings,
    seconds: float,
    known: tuple[ConeCertificate, Status] | None = None,
) -> ConeResult:
    """Return the result of a problem, the k-th of those that the compiled loop has run, after these seconds."""
    sweeps, newton, *path = found.made[k].tolist()
    stages = []
    if sweeps or not newton:
        rounds = sweeps // SWEEPS_A_STEP
        stages.append(
            StageRecord("npgs", SWEEPS if sweeps else NOTHING_TO_DO, rounds, sweeps + rounds + 1.0)
        )
    if newton or path:
        unknowns = (
            problem.n if problem.bodies is None else min(problem.n, problem.bodies.mass.shape[-1])
        )
        passes = unknowns**3 / (3.0 * max(problem.nonzeros, 1)) + 2.0
        stages += [
            StageRecord("interior_point", MIDDLE, steps, steps * passes) for steps in path if steps
        ]
        stages += [StageRecord("newton", FOLLOWS, newton, newton * passes)] * (newton > 0)
    proved = ConeCertificate.proved(problem, found.z[k], float(found.residual[k])), Status.SOLVED
    certificate, status = known or proved
    return ConeResult(
        z=certificate.point,
        w=read_only(problem.slack(certificate.point)),
        status=status,
        certificate=certificate,
        tolerance=settings.tolerance,
        algorithm=f"auto: {', '.join(stage.name for stage in stages)}",
        iterations=sum(stage.iterations for stage in stages),
        work=sum(stage.work for stage in stages),
        seconds=seconds,
        setup_seconds=0.0,
        stages=tuple(stages),
        problem=problem,
    )


def _start(problem: Blocks, z0: ArrayLike | None) -> FloatVector:
    if z0 is None:
        return problem.nearest_to_zero
    try:
        return problem.projected(checked_vector(z0, "z0", problem.n, may_be_number=problem.n == 1))
    except InvalidProblem as error:
        raise InvalidOption(str(error)) from error


def _policy(problem: Blocks, algorithm: Any, settings: Settings, **known: bool) -> Policy:
    if isinstance(algorithm, ConeAlgorithm):
        return Single(algorithm, prove_infeasibility=False)
    if isinstance(algorithm, Algorithm) or not isinstance(algorithm, str):
        raise UnknownAlgorithm(
            f"algorithm must be one of {', '.join(METHODS)} or an object of "
            f"lcp_plugin.problems.cones.methods, got {algorithm!r}"
        )
    if algorithm == "auto":
        return ConeAuto(problem, prove_infeasibility=settings.prove_infeasibility, **known)
    if algorithm not in METHODS:
        raise UnknownAlgorithm(
            f"no algorithm for cones is called {algorithm!r}{did_you_mean(algorithm, {'auto', *METHODS})}"
        )
    return Single(METHODS[algorithm](), prove_infeasibility=False)


def newton_operations(problem: Blocks, z: FloatVector) -> float:
    """Return about how many multiplications a step of Newton takes at z, the blocks at rest left out."""
    rows = float(problem.sizes[np.unique(problem.block_of_row[z != 0.0])].sum())
    sparse = (problem.n / problem.slope.size) ** 3 * sizes_of_factor(problem.block_norms.matrix)[1]
    return float(min(rows**3 / 3.0, sparse) + 2.0 * problem.nonzeros)


class ConeAuto(Policy):
    """Sweeps, as long as nothing gets there with less work; then Newton, and an interior point.

    What these leave open, of 3000 planted problems of up to 30 contacts some 30, and of piles none so far, gets convex
    programs, sweeps until they stand still, and Newton's
    method from other points. Small problems have had the first two in the compiled
    loop.
    """

    name = chosen = "auto"

    def __init__(
        self, problem: Blocks, *, is_warm: bool, was_tried: bool, prove_infeasibility: bool
    ) -> None:
        self._prove_infeasibility = prove_infeasibility
        self._problem = problem
        self._newton_steps = BEFORE_THE_PATH if problem.has_friction else LONG
        is_connected = connected_components(problem.block_norms.matrix) is None
        shared = iter(
            [Choice(NPGS(), SWEEPS)]
        )  # what is left open, each component gets a run of its own for
        self._left = self._stages(is_warm=is_warm, was_tried=was_tried) if is_connected else shared

    def first(self, problem: Any) -> Choice:
        """Return the first stage."""
        return next(self._left)

    def next_step(
        self, problem: Any, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return the next stage where one has come to its end, or where sweeps need more work than Newton."""
        stage = stages[-1]
        if not failed:
            if stage.algorithm.name == "newton":
                return next(self._left, None) if stage.iterations >= self._newton_steps else None
            if stage.algorithm.name != "npgs" or stage.iterations < TRIAL:
                return None
            if stage.algorithm.sweeps >= LONG:  # type: ignore[attr-defined]
                return next(self._left, None) if stage.iterations >= LONG_STEPS else None
            left = stage.steps_to_go(goal) * 11.0 * self._problem.nonzeros
            if left <= self._newton_operations(stage):
                return None
        return next(self._left, None)

    def _newton_operations(self, stage: Stage) -> float:
        """Return about how many multiplications an answer by Newton takes, the blocks at rest left out."""
        if stage.z is None:
            return np.inf
        return NEWTON_STEPS * (newton_operations(self._problem, stage.z) + STEP_OPERATIONS)

    def _stages(self, *, is_warm: bool, was_tried: bool) -> Iterator[Choice]:
        """Yield what comes in turn; where the compiled loop `was_tried`, what it did not do."""
        middle = Choice(InteriorPoint(), MIDDLE)
        if is_warm and not was_tried:
            yield Choice(
                Newton(), "a start that is given is near: Newton's steps from there come first"
            )
        if is_warm and self._problem.has_friction:
            yield middle
        if not was_tried:
            yield Choice(NPGS(), SWEEPS, from_start=is_warm)
            yield Choice(Newton(), FOLLOWS)
        self._newton_steps = LONG
        if self._problem.has_friction and not is_warm:
            yield middle
        if self._prove_infeasibility:
            yield Choice(InfeasibilityCheck(), "is there an answer at all?")
        yield Choice(
            FixedPoint(),
            "convex programs, each with friction as after the one before",
            from_start=True,
        )
        yield Choice(NPGS(sweeps=LONG), "sweeps until they stand still", from_start=True)
        yield from (Choice(Newton(seed=seed), NEARBY) for seed in range(STARTS))


class ConeJudge(Judge):
    """Measures by blocks; see :class:`Judge`."""

    words = {  # noqa: RUF012 - read only
        Status.STALLED: "no method reduces the residual further; next: try another start z0",
        Status.INFEASIBLE: (
            "no z in the cones has an M z + q in their duals, even with errors as large as the tolerance; "
            "next: check the data; result.proof proves it"
        ),
    }
    words_of_contacts = {  # noqa: RUF012 - read only
        Status.STALLED: (
            "no method reduces the residual further; next: try another start z0, or less friction: a solution need "
            "not exist where friction is large or W is singular"
        ),
        Status.INFEASIBLE: (
            "no impulses keep every contact from closing further, even with errors as large as the tolerance; "
            "next: check the data; result.proof proves it"
        ),
    }

    def __init__(self, problem: Blocks, settings: Settings) -> None:
        self.scaling = CommonScaling(problem, problem)  # type: ignore[arg-type]
        self.problem: Any = problem
        self.asked, self.settings = problem, settings
        self.reference = 1.0  # residuals are relative to those of the components already
        self.proof = self._certificate = None
        self.products: Callable[[], float] = lambda: (
            np.inf
        )  # products with M that the run has taken
        if problem.has_friction:
            self.words = self.words_of_contacts

    def certificate_of(self, z: FloatVector) -> Certificate:
        """Return the certificate of z; the latest one is kept."""
        latest: Any = self._certificate
        answer = self._held(z)
        if latest is None or not np.array_equal(latest.point, answer):
            self._certificate = latest = ConeCertificate.at(self.problem, answer)
        return latest  # type: ignore[no-any-return]

    def measure(self, z: FloatVector) -> float:
        """Return the relative residual of z."""
        return relative_residual(self.problem, self._held(z))

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether rounding explains the residual of z, or the system of its cases makes an answer of it."""
        return super().is_at_floor(z) or (
            z is not None and self.final(z, End.AT_FLOOR, None).meets(self.settings)
        )

    def final(self, z: FloatVector, end: End, last: Algorithm | None) -> Certificate:
        """Return the certificate of the answer, or of what the system of its cases and that of the next make of it."""
        found: Any = self.certificate_of(z)
        is_cut_short = end in (End.INTERRUPTED, End.TIME_LIMIT, End.STEP_LIMIT, End.NO_SOLUTION)
        problem, z = self.problem, found.point
        for count in range(1, LAST_STEPS + 1):
            if is_cut_short or found.relative_residual <= EXACT:
                break
            if count * newton_operations(problem, z) > self.products() * problem.nonzeros:
                break
            w = problem.slack(z)
            step = NewtonSystem(problem).step(z, w, problem.residual(z, w)[0], 0.0)[1]
            if step is None:
                break
            z = z + step  # outside the cones, too: that is what tells other cases
            found = self.better_of(found, self.certificate_of(z))
        return found  # type: ignore[no-any-return]

    def _held(self, z: FloatVector) -> FloatVector:
        """Return the point of K nearest to z, with z° in the components that z° answers."""
        answered, z = criterion_of(self.problem).answered, self.problem.projected(z)
        return z if answered is None else np.where(answered, self.problem.nearest_to_zero, z)


@dataclass(frozen=True, eq=False, repr=False)
class ConeResult(Result):
    """The answer to a problem over cones; attributes as of :class:`Result`, and these.

    Attributes
    ----------
    problem : ConeProblem or FrictionalContact
        What was solved.
    z, w : ndarray, shape (n,)
        The point and its slack; impulses r and velocities u of contacts.
    certificate : ConeCertificate
        All residuals, by blocks.
    status, algorithm, iterations, work, seconds, setup_seconds, tolerance, tolerance_on, absolute_tolerance, begun
        As of :class:`Result`, in its units.
    history, stages, infeasibility
        As of :class:`Result`.
    """

    problem: Any = None

    @classmethod
    def of(cls, problem: Blocks, result: Result) -> ConeResult:
        """Return a run's result in the problem's own unknowns."""
        given = {one.name: getattr(result, one.name) for one in fields(Result)}
        certificate: Any = result.certificate
        return cls(
            **{**given, "z": certificate.point, "w": certificate.velocity, "problem": problem}
        )

    @cached_property
    def motion(self) -> ContactMotion:
        """Impulses and velocities contact by contact, and which press and stick; of a FrictionalContact."""
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
            f"{self.algorithm}: {in_words(self.iterations, 'iteration')}, {self.seconds:.3g} s (set-up "
            f"{self.setup_seconds:.3g} s), the work of {self.work:.1f} products of M with a vector"
        )

    def explain(self) -> str:
        """Return what happened, how sure that is and what to do next, a line each; then why, and what ran."""
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
            f"{in_words(problem.slope.size, 'contact')}: {int((~motion.touches).sum())} open, "
            f"{int(motion.sticks.sum())} stick, {int(slides.sum())} slide; friction and impact take "
            f"{self.certificate.lost_energy + 0.0:.4g} J in SI units"  # type: ignore[attr-defined]
        ]
        if motion.touches.any():
            pulls = np.hypot.reduce(np.abs(motion.tangential), axis=1)[motion.touches]
            angle = np.degrees(np.arctan2(pulls, motion.normal[motion.touches])).max()
            edge = np.degrees(np.arctan(problem.friction.max()))
            limit = (
                ", the limit of friction"
                if slides.any() and abs(angle - edge) <= 1e-6 * edge
                else ""
            )
            lines.append(f"the steepest impulse leans {angle:.3g}° from its normal{limit}")
        if not is_symmetric_to_rounding(problem.W):
            asymmetry = float(abs(problem.W - problem.W.T).max())
            lines.append(
                f"W is not symmetric: entries differ by up to {asymmetry:.1e}; it was used as it is given"
            )
        return lines

    def _numbers(self) -> dict[str, float]:
        certificate = self.certificate
        return {
            "n": self.problem.n,
            "relative_residual": certificate.relative_residual,
            "natural_residual": certificate.natural_residual,
            "term_residual": certificate.term_residual,
            "work": self.work,
            "setup_seconds": self.setup_seconds,
            "tolerance": self.tolerance,
            **({"absolute_tolerance": self.absolute_tolerance} if self.absolute_tolerance else {}),
        }
