"""solve(): the one loop, with its clock, its limits and its judgement."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms import Algorithm, Step
from ..certificates.references import CommonUnits
from ..checks import FloatVector, read_only
from ..deadline import OutOfTimeError, time_limit
from ..errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..kernels.threads import threads_for
from ..policy.choice import Policy, policy_for
from ..policy.pacing import CheckSchedule, Progress
from ..policy.stages import Choice, Stage
from ..problem.lcp import LCP, checked_start
from ..problem.nonlinear import NonlinearProblem
from ..settings import CallersOwn, Settings, Status, checked_callback
from .error_watch import BoundOrReason
from .guarantees import warn_where_known_to_be_uncovered
from .judge import Judge
from .result import Result, Sample, status_of
from .run_log import RunLog
from .sprint import sprinted
from .state import Clock, Incumbent, Ledger, name_of

Callback = Callable[[Sample, FloatVector], Any]

SAMPLE_GROWTH = 1.05
DIVERGED_BEYOND = 1e8  # times the residual of the start and of z°


def solve(
    problem: LCP,
    algorithm: str | Algorithm = "auto",
    *,
    z0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    tolerance_on: str = "residual",
    measure: str = "relative",
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    record: bool = False,
    callback: Callback | None = None,
    error_bound: bool = False,
    refute: bool = True,
    threads: int | None = None,
    verbose: bool = False,
    **options: Any,
) -> Result:
    """Return the best z an algorithm finds, judged by a certificate on the problem's own data.

    Parameters
    ----------
    problem : LCP
        Never modified. Where its rows are spread over ranks (:meth:`LCP.from_rows`), all of them call with the same
        arguments; z0, z and w are the own parts then, and everything else is the same on every rank.
    algorithm : str or Algorithm
        A registered name (see ``lcp-plugin list``), "auto", or an object such as ``NPSOR(relaxation=1.5)``.
    z0 : array, shape (n,), or a number for n = 1, optional
        Warm start, projected onto the bounds; by default the point of [lower, upper] nearest to 0.
    tolerance : float
        SOLVED means that the measured residual of the returned z is at most this: in every part of the problem
        (connected component of M's pattern) relative to that part's own reference.
    tolerance_on : {"residual", "error"}
        With "error", SOLVED means instead that ‖z − z*‖∞ ≤ tolerance · ‖z‖∞ is proved of every part, z* the solution.
    measure : {"relative", "euclidean"}
        The residual to stop on: ``Certificate.relative_residual`` (without unit) or the paper's
        ``Certificate.euclidean_residual``.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, set-up included and compilation of kernels excluded; obeyed at the end of
        the iteration under way, or within a tenth of a second inside a long factorisation, as Ctrl-C is. That goes
        on in a thread of its own until it is done, and what it finds is dropped.
    absolute_tolerance : float
        In the unit of z: a part with ‖r‖∞ ≤ absolute_tolerance is solved whatever its reference, as a contact at rest
        is whose gaps are rounding; INFEASIBLE and NO_SOLUTION are proved beyond it. With the relative residual only.
    record : bool
        Keep samples of the run at geometric intervals in ``Result.history``.
    callback : callable, optional
        Called as ``callback(sample, z)`` at every step with a read-only view of z; a truthy return value ends the
        run with status INTERRUPTED. What it raises is passed on.
    error_bound : bool
        Bound |z − z*|: in the result, computed when it is looked at; with ``record=True`` also along the run, the
        clock stopped. None where nothing about M allows a bound; see :func:`lcp_plugin.error_bound`.
    refute : bool
        Look for a proof that there is no solution where none is found. False saves the work: a run that finds none ends
        STALLED, at the start where a look at all cases of a small problem in doubles has excluded every z.
    threads : int, optional
        How many threads this solve may use; by default all that the process may use, but one where the rows are on
        ranks. The answer is the same bit for bit for any number.
    verbose : bool
        Print the problem, each stage, iterations at geometric intervals (iteration, work in passes over M, residual,
        seconds), the end, and that kernels are compiled where that takes long; nothing is printed otherwise.
    **options
        Options of the named algorithm.

    Returns
    -------
    Result
        Always, whatever the status, with the best iterate whose residual was measured (in-place methods are
        measured at intervals and at the end), also after Ctrl-C; before the first step that is the start.
        ``result.require_solved()`` raises instead.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        Before the first iteration; UnsuitableMatrix also where ``tolerance_on="error"`` and M allows no error bound.

    Notes
    -----
    Kernels of small problems are interpreted, with the same bits, until compiling them pays. The first large problem of
    its kind in an installation compiles for 2 to 10 s, once; ``lcp-plugin warm-up`` compiles everything.

    Examples
    --------
    >>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> result = solve(problem, "npsor", relaxation=1.7)
    >>> result.status.name, result.z.round(6)
    ('SOLVED', array([0.75, 0.  ]))
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(f"solve needs an LCP, got {type(problem).__name__}; write {_remedy(problem)}")
    peers, clock = problem.peers, Clock(problem.peers)
    # Ctrl-C that hits an errstate further down while it ends leaves that one's settings behind.
    with np.errstate(), peers.interruptions() as clock.hears:
        policy, settings, callers, start = peers.together(lambda: (
            policy_for(algorithm, options, on_ranks=problem.is_distributed, refutes=refute),
            Settings(
                tolerance, tolerance_on, measure, max_iterations, max_seconds, absolute_tolerance, record, error_bound,
                threads, verbose, refute,
            ),
            checked_callback(callback), checked_start(problem, z0),
        ))
        asked = policy.chosen, settings
        peers.require_same("what is asked of solve", asked, "every rank must ask for the same", InvalidOption)
        run: Run | None = None
        with threads_for(1 if threads is None and problem.is_distributed else settings.threads):  # ranks are the cores
            units = CommonUnits(problem, problem)
            try:
                warn_where_known_to_be_uncovered(problem, policy, stacklevel=2)
                if settings.measure == "relative":
                    units = CommonUnits.of(problem, settings.least_reference)
                start, first = units.inward(start), policy.first(units.problem)
                arrived = None if callers is not None else sprinted(units, policy, first, settings, start, clock)
                if arrived is not None:
                    return arrived
                run = Run(units, policy, settings, callers, clock)
                if settings.is_on_error:
                    run.judge.require_rigorous_bounds()
                left = settings.max_seconds if settings.max_seconds == math.inf else settings.max_seconds - clock.read()
                with nullcontext() if left == math.inf else time_limit(left, is_enforced=peers.is_alone):
                    reason = run.drive(start, first)
                return run.judged(start, reason)
            except KeyboardInterrupt:
                if problem.is_distributed:
                    raise  # the second one: the other ranks have not heard of it
                run = run or Run(units, policy, settings, callers, clock)
                return run.judged(start, Status.INTERRUPTED)


def _remedy(given: Any) -> str:
    if isinstance(given, NonlinearProblem):
        return "solve_nonlinear(problem, x0)"
    return "solve(scene.problem)" if isinstance(getattr(given, "problem", None), LCP) else "solve(LCP(M, q))"


class Run:
    """One run: algorithms yield steps, the judge measures them, and the first reason to end ends it.

    They work in the common units of the problem's parts. A judge of another problem than the one that the algorithms
    take may be given: of a nonlinear problem, of which that one is the linearisation at the start.
    """

    def __init__(
        self, units: CommonUnits, policy: Policy, settings: Settings, callback: CallersOwn | None, clock: Clock,
        judge: Judge | None = None,
    ) -> None:
        self.units, self.policy, self.settings, self.callback, self.clock = units, policy, settings, callback, clock
        self.judge, self.incumbent, self.ledger = judge or Judge(units, settings), Incumbent(), Ledger()
        self.problem = problem = units.problem
        self.progress = Progress(problem.n, settings.max_iterations)
        self.start_residual = math.inf
        with clock.paused():
            self.log = RunLog(self.judge.asked, settings) if settings.verbose else None
        self._is_watched = settings.record or settings.verbose or not problem.peers.everywhere(callback is None)
        self._next_sample = 0

    @cached_property
    def checks(self) -> CheckSchedule:
        """When to measure what the algorithm does not tell."""
        return CheckSchedule(self.judge.per_increment, self.settings.goal)

    def drive(self, start: FloatVector, first: Choice) -> Status:
        """Run the chain of algorithms; return why it ended."""
        following: Choice | None = first
        if self.judge.reference == 0.0:  # z° solves the problem, and no other point can be measured against it
            start = self.problem.nearest_to_zero
        try:
            with nullcontext() if self.log is None else self.log.telling_of_compilation():
                while following is not None:
                    if self.log is not None:
                        self.log.begin(following)
                    from_start = following.from_start or self.incumbent.z is None
                    self.ledger.open(Stage(following.algorithm, following.because, from_start))
                    z = (start if self.incumbent.z is None or from_start else self.incumbent.z).copy()
                    reason, following = self._follow(following.iterates(self.problem, z))
        except OutOfTimeError:
            return Status.MAX_SECONDS
        return reason

    def _follow(self, steps: Iterator[Step]) -> tuple[Status, Choice | None]:
        """Take the steps of one algorithm until the run or the policy wants an end; return why, and what comes next."""
        self.progress.restart(max(self.ledger.iteration, 0), self.incumbent.residual)
        reason: Status | None = None
        try:
            for step in steps:
                reason = self._observe(step)
                if reason is not None:
                    break
                following = self._next(has_failed=False)
                if following is not None:
                    return Status.STALLED, following
        except (UnsuitableMatrix, UnsuitableProblem) as error:
            is_the_callers = self.callback is not None and error is self.callback.raised
            is_known_to_all = not (is_the_callers or self.problem.is_distributed)
            if len(self.ledger.stages) == 1 or self.ledger.stages[-1].iterations > 0 or not is_known_to_all:
                raise  # otherwise auto tried what does not take this problem
        self.clock.read()  # what ends by itself may have done so because time is over
        is_late = self.clock.elapsed >= self.settings.max_seconds
        reason = reason or (Status.MAX_SECONDS if is_late else Status.STALLED)
        if reason in (Status.STALLED, Status.DIVERGED) and self.judge.is_at_floor(self.incumbent.z):
            reason = Status.PRECISION_LIMIT
        if reason is Status.PRECISION_LIMIT and self.judge.is_limited_by_size(self.incumbent.z):
            return reason, self.policy.another_start(self.problem, self.ledger.stages)
        if reason not in (Status.STALLED, Status.DIVERGED):
            return reason, None
        return reason, self._next(has_failed=True)

    def _next(self, *, has_failed: bool) -> Choice | None:
        return self.policy.next_step(self.problem, self.ledger.stages, self.settings.goal, has_failed)

    def _observe(self, step: Step) -> Status | None:
        """Take note of one step; return the reason to end, if there is one."""
        ledger, incumbent = self.ledger, self.incumbent
        is_first = ledger.enter(step, self.clock.read()) if isinstance(step, Step) else self._refuse(step)
        if self.settings.absolute_tolerance:
            self.ledger.stages[-1].least_residual = 0.0  # it speaks of the relative one alone
        incumbent.unmeasured = step.z
        known = residual = self.judge.residual_of(step)
        if known is None and (is_first or self.checks.is_due(ledger.iteration, step.increment)):
            residual = self.judge.measure(step.z)
            ledger.work += 1.0 if ledger.iteration > 0 else 0.0  # the start is measured for every problem
        is_within = residual is not None and residual <= self.settings.goal
        if residual is not None:
            if is_within:  # measured, not proved
                residual = self.judge.certified(step.z)
            if known is None and step.increment is not None:
                self.checks.learn(ledger.iteration, step.increment, residual)
            incumbent.offer(step.z, residual)
            ledger.stages[-1].note(residual)
            if ledger.iteration == 0:
                self.start_residual = residual
        reason = self._reason_to_end(step, residual)
        if reason is None and self.clock.is_interrupted:
            reason = Status.INTERRUPTED
        if self._is_watched and self._report(step, residual, reason is not None):
            reason = reason or Status.INTERRUPTED
        if step.proof is not None and reason is None:
            if self.judge.counts(step.proof):
                return status_of(step.proof)
            if self.judge.misses_by_rounding(self.incumbent.z):
                return Status.PRECISION_LIMIT
        return reason

    def _refuse(self, step: Any) -> bool:
        """Refuse what is no step, as an algorithm of somebody else's may yield."""
        name = self.ledger.stages[-1].algorithm.name
        raise InvalidOption(f"{name}.iterates must yield Step(z), got {type(step).__name__}; write `yield Step(z)`")

    def _reason_to_end(self, step: Step, residual: float | None) -> Status | None:
        """Return why the run ends with this step, or None."""
        iteration, best = self.ledger.iteration, self.incumbent.residual
        progress, settings = self.progress, self.settings
        is_monotone = self.ledger.stages[-1].algorithm.is_monotone
        if residual is not None:
            if self.judge.passes(step.z, residual, iteration):
                return Status.SOLVED
            is_lost = (is_monotone and progress.is_rising(residual)) or not math.isfinite(residual)
            is_beyond = is_lost and not residual <= DIVERGED_BEYOND * self.start_residual
            if is_beyond and not residual <= DIVERGED_BEYOND * self.judge.unit:
                return Status.DIVERGED
        elif step.increment is not None and not math.isfinite(step.increment):
            return Status.DIVERGED
        if iteration >= settings.max_iterations:
            return Status.MAX_ITERATIONS
        if self.clock.elapsed >= settings.max_seconds:
            return Status.MAX_SECONDS
        if step.is_settling:
            progress.restart(iteration, best)
        if residual is None:
            return None
        if progress.is_flat(iteration, best) and self.judge.is_at_floor(self.incumbent.z):
            return Status.PRECISION_LIMIT
        is_stalled = is_monotone and progress.is_stalled(iteration, best, settings.goal)
        return Status.STALLED if is_stalled else None

    # --- telling ----------------------------------------------------------------------------------------

    def _report(self, step: Step, residual: float | None, is_last: bool) -> bool:
        """Record and call back, the clock stopped; return whether the caller wants to stop."""
        ledger, stage, log = self.ledger, self.ledger.stages[-1], self.log
        is_due = self.settings.record and (is_last or ledger.iteration >= self._next_sample)
        with self.clock.paused():
            sample = Sample(ledger.iteration, ledger.work, ledger.seconds, residual, stage.algorithm.name)
            wants_to_stop = self._called_back(sample, step.z)
            is_due |= self.settings.record and wants_to_stop
            is_printed = log is not None and log.is_due(stage)
            if is_due or is_printed:
                sample = replace(sample, residual=self.judge.measure(step.z) if residual is None else residual)
            if log is not None and is_printed:
                log.step(stage, sample)
            if is_due:
                self._next_sample = max(ledger.iteration + 1, math.ceil(ledger.iteration * SAMPLE_GROWTH))
                bound = self.judge.bound_along_the_run(step.z, ledger.work)
                ledger.samples.append(replace(sample, error_bound=bound))
        return wants_to_stop

    def _called_back(self, sample: Sample, z: FloatVector) -> bool:
        """Return whether a callback, of any rank, wants to stop."""
        callback, peers = self.callback, self.problem.peers
        shown = z if callback is None else self.units.outward(z)
        wants_to_stop = peers.together(lambda: callback is not None and bool(callback(sample, read_only(shown))))
        return not peers.everywhere(not wants_to_stop)

    def judged(self, start: FloatVector, reason: Status) -> Result:
        """Return the result: finish, certify, and let the certificate name the status."""
        incumbent, ledger, settings = self.incumbent, self.ledger, self.settings
        if incumbent.unmeasured is not None:
            incumbent.offer(incumbent.unmeasured, self.judge.measure(incumbent.unmeasured))
        last = ledger.stages[-1].algorithm if ledger.stages else None
        is_excluded = bool(ledger.stages) and ledger.stages[-1].least_residual > settings.goal
        best = start if incumbent.z is None or is_excluded else incumbent.z  # no z is near a solution: as in a batch
        certificate = self.judge.final(best, reason, last)
        status = self.judge.verdict(certificate, reason, is_chain=len(ledger.stages) > 1)
        stages = ledger.records()
        result = Result(
            z=certificate.z, w=certificate.w, status=status, certificate=certificate,
            tolerance=settings.tolerance, tolerance_on=settings.tolerance_on, measure=settings.measure,
            absolute_tolerance=settings.absolute_tolerance,
            algorithm=name_of(self.policy.name, stages), iterations=max(ledger.iteration, 0), work=ledger.work,
            seconds=self.clock.read(), setup_seconds=ledger.setup_seconds, history=tuple(ledger.samples),
            stages=stages, infeasibility=self.judge.proof, chosen=self.policy.chosen,
            bounded=self.judge.bound_at_the_end(certificate) if ledger.stages else BoundOrReason(),
            words=self.judge.words if settings.refute else self._words_unrefuted(),
        )
        if self.log is not None:
            self.log.end(result)
        return result

    def _words_unrefuted(self) -> dict[Status, str]:
        words = dict(self.judge.words)
        stalled = words.get(Status.STALLED, Status.STALLED.value)
        return words | {Status.STALLED: f"{stalled}; not refuted: you asked for none"}
