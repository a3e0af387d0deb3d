"""A march in time: one matrix, and a q that the answer of each step gives to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...auto import asked_of_solve, solve_lcp
from ...core.algorithm import Algorithm, FusedSolve
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector, check_kind, is_number, read_only, real_array
from ...core.deadline import Clock
from ...core.errors import InvalidProblem, LCPError
from ...core.lcp import LCP
from ...core.matrix.scaling import scaling_of
from ...core.matrix.structure import connected_components
from ...core.policy.policy import Policy
from ...core.settings import Settings, Status
from ...core.solving.driver import fused_result
from ...core.solving.result import Result
from ...kinds import solve_any
from ...methods.banded import Banded
from ..cones.data import Blocks
from ..many.answers import AnswerSequence, Results
from .marching import StepPolicy

BLOCK = 64  # steps between two checks for Ctrl-C, and nothing before them is lost


class March(AnswerSequence[Result]):
    """The results of steps in time, in order; each is built when it is first read.

    Parameters
    ----------
    problem, forcing, propagator, z0 : problem, array of shape (k, n), csr_array of shape (n, n), array of shape (n,)
        What :func:`march` was given; they are read again where an answer was not kept.
    keep_every : int
        How many steps there are from one kept answer to the next. The last one is kept, too.
    again : callable
        Called with a part of the forcing, the number of its first step, what that begins with (z0 and an algorithm),
        marches there once more.

    Attributes
    ----------
    all_solved : bool
        Whether every step that was taken is SOLVED, and none was refused or interrupted.
    error : LCPError or None
        What was wrong with the q of the step that ended the march.
    seconds : float
        Wall-clock seconds of the march.
    """

    ITEM = "step"
    all_solved = True

    def __init__(
        self,
        problem: Any,
        forcing: FloatVector,
        propagator: sp.csr_array,
        z0: FloatVector,
        keep_every: int,
        again: Callable[..., March],
    ) -> None:
        self.problem, self.forcing, self.propagator = problem, forcing, propagator
        self.z0, self.keep_every = z0, keep_every
        self.seconds = 0.0
        self.error: LCPError | None = None
        self._again, self._count = again, 0
        self._part: tuple[int, March] | None = None
        self._kept: dict[
            int, tuple[FloatVector, Algorithm | None]
        ] = {}  # answers, and what the next step begins with
        self._results: dict[int, Result | Callable[[], Result]] = {}

    @property
    def z(self) -> Sequence[FloatVector]:
        """The answer of each step, a sequence of arrays of shape (n,)."""
        return _Answers(self)

    def at(self, k: int) -> Result:
        """Return the result of step k."""
        found = self._results.get(k)
        if found is None:
            first, part = self.part(k)
            return part.at(k - first)
        if not isinstance(found, Result):
            found = self._results[k] = found()
        return found

    def part(self, k: int) -> tuple[int, March]:
        """Return the number of a step, and the march that goes from there over step k to the next answer kept.

        It is taken once more where the answers between were not kept; that of the last call is remembered.
        """
        if self.keep_every == 1:
            return 0, self
        first = k - k % self.keep_every
        if self._part is None or self._part[0] != first:
            state, begin = self._kept[first - 1] if first else (self.z0, None)
            forcing = self.forcing[first : min(first + self.keep_every, len(self))]
            self._part = (
                first,
                self._again(forcing, z0=state, begin=begin, first=first, total=len(self.forcing)),
            )
        return self._part

    def __len__(self) -> int:
        return self._count

    @property
    def status(self) -> list[Status]:
        """The status of each step that was taken; all but the last are SOLVED."""
        return [Status.SOLVED] * (len(self) - 1) + [
            self[-1].status for _ in range(min(len(self), 1))
        ]

    @property
    def algorithm(self) -> str:
        """What ran in the last step."""
        return self[-1].algorithm if len(self) else "no step"

    def explain(self) -> str:
        """Return how many steps of how many were taken, how they ended, and the story of the last one."""
        last = f"the last step: {self[-1]}" if len(self) else ""
        return "\n".join(
            filter(None, [*self._summary(), propagator_remark(self.problem, self.propagator), last])
        )

    def _summary(self) -> list[str]:
        steps = f"{len(self)} of {len(self.forcing)} steps: {self.counts()}; {self.algorithm}, {self.seconds:.3g} s"
        return [steps, *([f"ended by {self.error}"] if self.error else [])]

    def __repr__(self) -> str:
        return f"March({'; '.join(self._summary())})"

    def __getstate__(self) -> dict[str, Any]:
        """Take along results instead of what makes them when they are looked at."""
        return {**self.__dict__, "_results": {k: self.at(k) for k in self._results}}

    def keeps(self, k: int) -> bool:
        """Return whether the answer of step k stays when others follow."""
        return (k + 1) % self.keep_every == 0

    def _take(
        self,
        z: FloatVector,
        result: Result | Callable[[], Result] | None,
        begin: Algorithm | None = None,
        step: int | None = None,
    ) -> None:
        """Take one step more, or all up to that number, of which nothing stays but the answer of the last."""
        last, step = self._count - 1, self._count if step is None else step
        if self.keep_every > 1:
            self._results.pop(last, None)  # it would keep the vectors of all steps of its block
            if not self.keeps(last):
                self._kept.pop(last, None)
            z = read_only(z.copy())
        self._count, self._kept[step] = step + 1, (z, begin)
        if result is not None:
            self._results[step] = result


class _Answers(Results[FloatVector]):
    """The z of the steps of a march; one that was not kept is computed once more."""

    def __init__(self, march: March) -> None:
        self._march = march

    def at(self, k: int) -> FloatVector:
        kept = self._march._kept.get(k)
        if kept is None:
            first, part = self._march.part(k)
            kept = part._kept[k - first]
        return kept[0]

    def __len__(self) -> int:
        return len(self._march)

    def __repr__(self) -> str:
        return f"<z of {len(self)} steps, each of shape ({self._march.problem.n},): z[k] is that of step k>"


def propagator_remark(problem: LCP | Blocks, propagator: sp.csr_array) -> str:
    """Return a sentence where every step raises the q of the next one, as a wrong sign of the propagator does; else ''.

    Parameters
    ----------
    problem : LCP or ConeProblem or FrictionalContact
    propagator : csr_array, shape (n, n)

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0])
    >>> print(propagator_remark(rod, sp.csr_array(np.eye(2))))
    propagator[0, 0] = 1.0 and no entry of propagator is negative: a larger z raises the q of the next step, which
    lowers z there; an implicit Euler step (I + Δt A) z = z_before has propagator −1
    >>> propagator_remark(rod, sp.csr_array(-np.eye(2)))
    ''
    """
    if not isinstance(problem, LCP):
        return ""
    diagonal = propagator.diagonal()
    rows = np.flatnonzero((diagonal > 0.0) & (problem.diagonal > 0.0))
    if not rows.size or (propagator.data < 0.0).any():
        return ""
    return (
        f"propagator[{rows[0]}, {rows[0]}] = {diagonal[rows[0]]} and no entry of propagator is negative: a larger z "
        "raises the q of the next step, which lowers z there; an implicit Euler step "
        "(I + Δt A) z = z_before has propagator −1"
    )


def begun(
    problem: LCP | Blocks,
    forcing: FloatVector,
    propagator: sp.csr_array,
    z0: FloatVector,
    keep_every: int,
    algorithm: str | Algorithm,
    wishes: dict[str, Any],
) -> March:
    """Return a march before its first step."""
    quiet = {name: wish for name, wish in wishes.items() if name not in ("callback", "verbose")}
    return March(
        problem,
        forcing,
        propagator,
        z0,
        keep_every,
        partial(_part, problem, propagator, algorithm, quiet),
    )


def _part(
    problem: LCP | Blocks,
    propagator: sp.csr_array,
    algorithm: str | Algorithm,
    wishes: dict[str, Any],
    forcing: FloatVector,
    *,
    z0: FloatVector,
    **where: Any,
) -> March:
    """Return the march along a part of the forcing, with every answer."""
    done = begun(problem, forcing, propagator, z0, 1, algorithm, wishes)
    take_steps(done, len(forcing), algorithm, wishes, **where)
    return done


def take_steps(
    done: March,
    end: int,
    algorithm: str | Algorithm,
    wishes: dict[str, Any],
    *,
    limit: float = np.inf,
    begin: Algorithm | None = None,
    first: int = 0,
    total: int | None = None,
) -> None:
    """Take the steps up to that number, after those that a march has, within so many seconds.

    The march is that from step number `first` on, beginning with `begin`, of one with so many steps in all, for which
    what is dear may pay as well.
    """
    problem, forcing, propagator = done.problem, done.forcing[:end], done.propagator
    is_lcp, clock, total = (
        isinstance(problem, LCP),
        Clock(problem.matrix),
        total or len(done.forcing),
    )
    policy, settings = asked_of_solve(algorithm, wishes) if is_lcp else asked_of_solve("auto", {})
    is_unobserved = is_lcp and settings.is_unobserved and wishes.get("callback") is None
    state, begin = done._kept[len(done) - 1] if len(done) else (done.z0, begin)
    while len(done) < end and done.all_solved:
        before = len(done)
        try:
            if is_unobserved and clock.read() < limit:
                for z, result in _fused(
                    problem, policy, settings, forcing[before : before + BLOCK], propagator, state
                ):
                    done._take(z, result, begin)
            if len(done) == before:
                with np.errstate(
                    over="ignore", invalid="ignore"
                ):  # what overflows is refused by name
                    step = problem.with_q(forcing[before] + propagator @ state)
                left = {} if limit == np.inf else {"max_seconds": max(limit - clock.read(), 0.0)}
                of_step = None
                if is_lcp and algorithm == "auto":
                    of_step = StepPolicy(begin, prove_infeasibility=settings.prove_infeasibility)
                if is_lcp:
                    found = solve_lcp(step, of_step or algorithm, z0=state, **{**wishes, **left})
                else:  # a start at rest is none: over cones Newton begins where one is given
                    start = {"z0": state} if (state != problem.nearest_to_zero).any() else {}
                    found = solve_any(step, algorithm, {**wishes, **left, **start})
                done.all_solved = found.is_solved
                if of_step is not None and found.is_solved:
                    begin = of_step.following(problem, first + before)
                done._take(found.z, found, begin)
            state = done.z[-1]
        except InvalidProblem as error:
            if not done:
                raise
            done.error, done.all_solved = error, False
        except KeyboardInterrupt:
            if not done:
                raise
            done.all_solved = False
    done.seconds += clock.read()


def _fused(
    problem: LCP,
    policy: Policy,
    settings: Settings,
    offsets: FloatVector,
    propagator: sp.csr_array,
    state: FloatVector,
) -> Iterator[tuple[FloatVector, Callable[[], Result]]]:
    """Yield the steps that one compiled loop takes, up to the first that does not converge."""
    first, clock = policy.first(problem), Clock(problem.matrix)
    if not (isinstance(first.algorithm, Banded) and needs_no_scaling(problem)):
        return
    Q, Z = np.array(offsets, order="C"), np.empty(offsets.shape)
    Q[0] += propagator @ state
    np.clip(state, problem.lower, problem.upper, out=Z[0])
    found = first.algorithm.fused_solves(
        problem, Q, Z, settings.tolerance, settings.max_iterations, propagator
    )
    seconds = clock.read() / len(found)

    def result_of(q: FloatVector, one: FusedSolve) -> Result:
        certificate = Certificate.enclosed(
            problem.with_q(q), one.z, one.residual, one.term_residual
        )
        return fused_result(certificate, policy, first, one, settings, seconds)

    for q, one in zip(Q, found, strict=True):
        if one is None:
            return
        yield one.z, partial(result_of, q, one)


def needs_no_scaling(problem: LCP) -> bool:
    """Return whether a compiled loop may judge all rows alike: with no scaling of a step's own, nor of unknowns."""
    return connected_components(problem.matrix) is None and scaling_of(problem.matrix) is None


def checked_forcing(
    forcing: Any, n: int, shape: str = "(k, n), a row a step", axes: tuple[int, ...] = (2,)
) -> FloatVector:
    """Return the forcing as a finite array of one of these numbers of axes."""
    need = f"forcing must be a finite array of shape {shape}, n = {n}"
    offsets = real_array(forcing.toarray() if sp.issparse(forcing) else forcing, need)
    if offsets.ndim not in axes or offsets.shape[-1] != n:
        raise InvalidProblem(f"{need}, got shape {offsets.shape}")
    if not np.isfinite(offsets).all():
        at = np.argwhere(~np.isfinite(offsets))[0]
        raise InvalidProblem(
            f"{need}, but forcing{at.tolist()} = {offsets[tuple(at)]}; repair that entry"
        )
    return offsets


def checked_propagator(propagator: Any, n: int) -> sp.csr_array:
    """Return the propagator as a finite matrix by rows; a number stands for a multiple of the identity."""
    need = f"propagator must be a number or a finite array of shape ({n}, {n})"
    if is_number(propagator):
        propagator = float(propagator) * sp.eye_array(n)
    elif not sp.issparse(propagator):
        propagator = real_array(propagator, need)
    if propagator.shape != (n, n):
        raise InvalidProblem(f"{need}, got shape {propagator.shape}")
    check_kind(propagator.dtype, need)
    rows = sp.csr_array(propagator, dtype=np.float64)
    if not np.isfinite(rows.data).all():
        raise InvalidProblem(f"{need}, got NaN or infinite entries; repair them")
    return rows
