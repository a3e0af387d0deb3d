"""Marches in time, one or many: the strikes of an option, a volatility for each, the loads of a rod."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, cast

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...auto import asked_of_solve
from ...core.algorithm import Algorithm
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector, checked_vector, is_number, read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kind import refusal
from ...core.lcp import LCP
from ...core.settings import Settings, Status, checked_threads
from ...core.solving.driver import fused_result
from ...core.solving.result import Result
from ...methods.banded import Banded
from ...systems.factors import bands
from ..cones.data import Blocks
from ..many.chunks import in_chunks
from ..many.data import length_of_all, rows_of_a_batch
from . import BLOCK, March, begun, checked_forcing, checked_propagator, march_one, needs_no_scaling, take_steps

SIDE_BY_SIDE = 16  # as the compiled loop has space for


@np.errstate(under="ignore")
def march(
    problem: LCP | Blocks | Sequence[LCP], forcing: ArrayLike, propagator: Any = -1.0, *, z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto", max_seconds: float | None = None, keep_every: int = 1, **wishes: Any,
) -> Any:
    """Return the results of steps in time: step j has q = forcing[j] + propagator @ z, z from the step before.

    Where forcing, z0, or ``lower=`` or ``upper=`` in the place of an LCP's own bounds have an axis more in front, or
    where problem or propagator is a list, these are as many marches, which are taken together where that is quicker.

    Parameters
    ----------
    problem : LCP or ConeProblem or FrictionalContact, or a list of m LCPs
        Gives M and the bounds or cones; its own q is not used. Of a list, each march has its own.
    forcing : array, shape (k, n), or (m, k, n) for m marches
        A row a step; ``np.broadcast_to(row, (k, n))`` where it is always the same.
    propagator : number or array or sparse array, shape (n, n), or a list of m of these
        What the z of one step adds to the q of the next; a number stands for a multiple of the identity. An implicit
        Euler step (I + Δt A) z = z_before has −1.
    z0 : array, shape (n,) or (m, n), optional
        The state before the first step; by default the point of [lower, upper] nearest to 0.
    max_seconds : float, optional
        In seconds, for all marches together: the step under way then is the last one.
    keep_every : int
        One result in so many stays in memory, and the last; the others are computed again when they are looked at, so
        that what is given must not change, and an algorithm of yours has to give the same iterates each time. √k of k
        steps take the least memory.
    algorithm, **wishes
        What else :func:`lcp_plugin.solve` takes, for each step.

    Returns
    -------
    March, or a list of m of them
        A sequence of k Results; of fewer where a step was not solved, which is the last one then, where its q
        overflows (``error`` says so), or after Ctrl-C.

    Raises
    ------
    InvalidOption, InvalidProblem, UnknownAlgorithm, UnsuitableProblem
        Before the first step; the last where the rows of M are spread over ranks.

    Notes
    -----
    Each step starts from the answer of the one before, and is judged as any other problem. On narrow bands, where
    `auto` takes `banded`, all steps run in one compiled loop, certificates included. Elsewhere `auto` chooses afresh
    in the first two steps; later ones begin with the method that ended the step before. Where few rows have a bound,
    as in contact, the others are eliminated by one factor, once for all steps, if that pays.

    A θ-scheme for B ż + A z = f, (B + θ Δt A) z = (B − (1 − θ) Δt A) z_before + Δt f, has M = B + θ Δt A, the
    propagator (1 − θ) Δt A − B and the forcing −Δt f. Crank–Nicolson, θ = ½, is of order 2 after data with a kink only
    where it is damped: by four implicit half steps at first, with the same M, the propagator −B and the forcing
    −½ Δt f (Rannacher 1984).

    Contacts with friction on elastic bodies: W has displacements by forces, and a slow load gives, step by step, the
    gaps without contact and the tangential displacements from the step before. The propagator is −W with zeros in the
    rows of the normals then: slip is what the tangents move on in a step. Where contacts change there is another W,
    and no march: write ``solve(FrictionalContact(W, b, friction), z0=result.z)`` for each step.

    References
    ----------
    R. Rannacher, *Finite element solution of diffusion problems with irregular data*, Numer. Math. 43 (1984),
    doi:10.1007/BF01390130.

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)  # cools in two steps, heated on the left
    >>> [z.round(3) for z in march(rod, [[-1, 0], [-1, 0]], z0=[1, 1]).z]
    [array([0.875, 0.625]), array([0.781, 0.469])]
    >>> [done.z[-1].round(3) for done in march(rod, [[-1, 0], [-1, 0]], z0=[1, 1], upper=[[1, 1], [0.5, 1]])]
    [array([0.781, 0.469]), array([0.5  , 0.333])]
    >>> stiffer = LCP([[4, -2], [-2, 4]], [0, 0], upper=1)
    >>> [done.z[-1].round(3) for done in march([rod, stiffer], [[-1, 0], [-1, 0]], z0=[1, 1])]
    [array([0.781, 0.469]), array([0.722, 0.528])]
    """
    if _are_many(problem, forcing, propagator, z0, wishes):
        return march_many(
            cast(LCP, problem), forcing, propagator, z0=z0, algorithm=algorithm, max_seconds=max_seconds,
            keep_every=keep_every, **wishes,
        )
    return march_one(
        cast("LCP | Blocks", problem), forcing, propagator, z0=z0, algorithm=algorithm, max_seconds=max_seconds,
        keep_every=keep_every, **wishes,
    )


def _are_many(problem: Any, forcing: Any, propagator: Any, z0: Any, wishes: dict[str, Any]) -> bool:
    """Return whether one of these has an axis for several marches."""
    if isinstance(problem, (list, tuple)) or _is_one_a_march(propagator):
        return True
    of_states: tuple[Any, ...] = z0, wishes.get("lower"), wishes.get("upper")
    try:
        return np.ndim(forcing) == 3 or any(np.ndim(one) == 2 for one in of_states)
    except ValueError:  # rows of different lengths, which one march refuses in words
        return False


@np.errstate(under="ignore")
def march_many(
    problem: LCP | Sequence[LCP], forcing: ArrayLike, propagator: Any = -1.0, *, lower: ArrayLike | None = None,
    upper: ArrayLike | None = None, z0: ArrayLike | None = None, algorithm: str | Algorithm = "auto",
    max_seconds: float | None = None, keep_every: int = 1, threads: int | None = None, **wishes: Any,
) -> list[March]:
    """Return the steps in time of several forcings, bounds, states, matrices or propagators.

    Parameters
    ----------
    problem : LCP, or a list of m
        Gives M, and the bounds where no others are given; its own q is not used. Of a list, each march has its own,
        all of one size.
    forcing : array, shape (m, k, n), or (k, n) for all marches
    propagator
        As for :func:`lcp_plugin.march`, or a list of m of these.
    lower, upper : number or array, shape (m, n) or (n,), optional
        The bounds of each march, or of all.
    z0 : array, shape (m, n) or (n,), optional
        The state of each march before the first step, or of all; by default the point within its bounds nearest to 0.
    max_seconds : float, optional
        In seconds, for all together.
    threads : int, optional
        How many threads there may be; by default all that the process may use. The bits do not depend on it.
    algorithm, keep_every, **wishes
        As for :func:`lcp_plugin.march`.

    Returns
    -------
    list of March
        One a march, in order. One that ends early is as that of :func:`lcp_plugin.march`, and stops the others only
        after Ctrl-C, or where a callback ends it.

    Raises
    ------
    InvalidOption, InvalidProblem, UnknownAlgorithm, UnsuitableProblem
        As :func:`lcp_plugin.march`, before the first step.

    Notes
    -----
    Where M is tridiagonal, with no positive entry off the diagonal, and `auto` takes `banded`, the steps of marches
    whose matrices have entries in the same places are taken together, by one factor of M where the rows at bounds come
    first, and each step is judged. Others are taken one march after the other.

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0])
    >>> [done.z[-1].round(3) for done in march_many(rod, [[-1, 0], [-1, 0]], upper=[[1, 1], [0.5, 1]], z0=[1, 1])]
    [array([0.781, 0.469]), array([0.5  , 0.333])]
    """
    problems: list[LCP] = list(problem) if isinstance(problem, (list, tuple)) else [cast(LCP, problem)]
    for j, one in enumerate(problems):
        if not isinstance(one, LCP):
            raise InvalidOption(refusal("march_many", one))
        if one.n != problems[0].n:
            raise InvalidProblem(
                f"all problems must have one size, got n = {problems[0].n}, and {one.n} of problem {j}; "
                "march along those of one size at a time"
            )
    if not problems:
        return []
    n, clock, limit = problems[0].n, Clock(problems[0].matrix), Settings(max_seconds=max_seconds).max_seconds
    given = checked_forcing(forcing, n, "(m, k, n), or (k, n) for all marches", (2, 3))
    offsets = [given] if given.ndim == 2 else list(given)
    propagators = [checked_propagator(C, n) for C in (propagator if _is_one_a_march(propagator) else [propagator])]
    rows = {name: rows_of_a_batch(values, name, n)
            for name, values in (("lower", lower), ("upper", upper), ("z0", z0)) if values is not None}
    several: dict[str, Any] = {"problem": problems, "forcing": offsets, "propagator": propagators, **rows}
    count = length_of_all({name: len(given) for name, given in several.items() if len(given) != 1})
    marches: list[March] = []
    for j in range(count):
        of_march, C = problems[min(j, len(problems) - 1)], propagators[min(j, len(propagators) - 1)]
        offset = offsets[min(j, len(offsets) - 1)]
        own = {name: given[min(j, len(given) - 1)] for name, given in rows.items()}
        start = own.pop("z0", None)
        of_march = of_march.with_q(of_march.q, **own) if own else of_march
        if not marches:  # what all share is checked once
            done = march_one(of_march, offset[:0], C, z0=start, algorithm=algorithm, keep_every=keep_every, **wishes)
            propagators[0] = done.propagator  # a shared one is one object
        else:
            of_march.matrix.require_all_rows()
            state = of_march.nearest_to_zero if start is None else checked_vector(start, "z0", n)
            done = begun(of_march, offset, C, state, done.keep_every, algorithm, wishes)
        done.forcing = offset
        marches.append(done)
    steps = _Steps(marches, algorithm, wishes, limit, clock)
    try:
        steps.take(checked_threads(threads))
    except KeyboardInterrupt:
        for done in marches:
            done.all_solved = done.all_solved and len(done) == len(done.forcing)
    return marches


def _is_one_a_march(propagator: Any) -> bool:
    """Return whether this is a sequence of propagators: of sparse arrays, or with an axis more than one has."""
    if sp.issparse(propagator) or is_number(propagator):
        return False
    if isinstance(propagator, (list, tuple)) and any(map(sp.issparse, propagator)):
        return True
    try:
        return np.ndim(propagator) in (1, 3)  # numbers, or matrices
    except ValueError:  # rows of different lengths, which one march refuses in words
        return False


class _Steps:
    """The steps of marches: side by side in a compiled loop, or those of one after the other."""

    def __init__(
        self, marches: list[March], algorithm: str | Algorithm, wishes: dict[str, Any], limit: float, clock: Clock
    ) -> None:
        self.marches, self.algorithm, self.wishes, self.limit, self.clock = marches, algorithm, wishes, limit, clock
        self.policy, self.settings = asked_of_solve(algorithm, wishes)

    def take(self, threads: int) -> None:
        """Take all steps: of neighbours together where the compiled loop is for them."""
        for of_kind in self._alike():
            if self._are_together(of_kind):
                self._take_together(of_kind, threads)
            else:
                for one in of_kind:
                    self.take_alone(one, len(one.forcing))

    def _alike(self) -> Iterator[list[March]]:
        """Yield neighbours whose matrices have entries in the same places, and propagators alike."""
        some: list[March] = []
        for one in self.marches:
            if some and not _are_alike(some[-1], one):
                yield some
                some = []
            some.append(one)
        if some:
            yield some

    def _are_together(self, marches: list[March]) -> bool:
        """Return whether the compiled loop is for these."""
        problem = marches[0].problem
        is_unobserved = self.settings.is_unobserved and self.wishes.get("callback") is None
        if not (is_unobserved and problem.n) or (problem.is_dense and problem.n > 1):
            return False
        self.first = self.policy.first(problem)
        each = {id(one.problem.matrix): one.problem for one in marches}.values()
        return isinstance(self.first.algorithm, Banded) and all(map(_is_tridiagonal_z, each))

    def _take_together(self, marches: list[March], threads: int) -> None:
        """Take all steps, a block of some marches at a time; what does not converge there is taken alone."""
        count, total = len(marches), len(marches[0].forcing)
        cuts = np.linspace(0, count, -(-count // SIDE_BY_SIDE) + 1).astype(int).tolist()
        alone = {a: 1 for a in cuts[:-1]}  # steps to be taken so where a group does not converge
        groups = {a: marches[a:b] for a, b in pairwise(cuts)}
        while groups := {a: left for a, group in groups.items() if (left := _unfinished(group))}:
            under_way = list(groups.items())

            def take(k: int, last: int, some: list[tuple[int, list[March]]] = under_way) -> None:
                for _, group in some[k:last]:
                    self._take_block(group, min(len(group[0]) + BLOCK, total))

            before = {a: len(group[0]) for a, group in under_way}
            if self.clock.read() < self.limit:
                in_chunks(take, len(under_way), threads)
            for a, group in under_way:
                if len(group[0]) == min(before[a] + BLOCK, total):
                    alone[a] = 1
                    continue
                for one in group:
                    self.take_alone(one, min(len(one) + alone[a], total))
                alone[a] = min(2 * alone[a], BLOCK)

    def _take_block(self, group: list[March], end: int) -> None:
        """Take the steps up to that number of marches that have got equally far, as long as all of them converge."""
        clock, leader, settings, first = Clock(group[0].problem.matrix), group[0], self.settings, len(group[0])
        algorithm, policy, choice = self.first.algorithm, self.policy, self.first
        assert isinstance(algorithm, Banded)
        lower, upper, states = (np.stack(rows, axis=1) for rows in zip(
            *((one.problem.lower, one.problem.upper, _state(one)) for one in group), strict=True
        ))
        here = [k for k in range(end - first) if leader.keeps(first + k)]
        kept = np.full(end - first, -1)
        kept[here] = np.arange(len(here))
        matrices = {id(one.problem.matrix) for one in group}, {id(one.propagator) for one in group}
        own = group if max(map(len, matrices)) > 1 else group[:1]
        found = algorithm.fused_marches(
            [one.problem for one in own], _forcing_of(group, first, end), [one.propagator for one in own], lower, upper,
            states, kept, settings.tolerance, settings.max_iterations,
        )
        seconds = clock.read() / max(len(group) * found.steps, 1)

        def result_of(one: March, j: int, k: int, before: FloatVector, z: FloatVector) -> Result:
            q, fused = one.forcing[first + k] + one.propagator @ before, found.solve_of(j, k, z)
            certificate = Certificate.of(one.problem.with_q(q), z)
            return fused_result(certificate, policy, choice, fused, settings, seconds)

        last, is_kept_whole = found.steps - 1, leader.keep_every == 1
        for j, one in enumerate(group):
            one.seconds += seconds * found.steps
            before = _state(one)
            for k, z in zip(here, found.answers[j], strict=True):
                if k < last + is_kept_whole:
                    result = partial(result_of, one, j, k, before, z) if is_kept_whole else None
                    one._take(z, result, step=first + k)
                    before = z
            if not is_kept_whole and last >= 0:
                before, z = found.before[j].copy(), read_only(found.last[j].copy())
                one._take(z, partial(result_of, one, j, last, before, z), step=first + last)

    def take_alone(self, one: March, end: int) -> None:
        """Take the steps up to that number of one march, after those that it has; at most one that is not solved."""
        try:
            left = max(self.limit - self.clock.read(), 0.0)
            take_steps(one, end, self.algorithm, self.wishes, limit=left)
        except InvalidProblem as error:
            one.error, one.all_solved = error, False
        ended = one[-1].status if one else Status.SOLVED
        if len(one) < end and one.error is None and ended in (Status.SOLVED, Status.INTERRUPTED):
            raise KeyboardInterrupt  # a march has kept it for itself


def _forcing_of(group: list[March], first: int, end: int) -> FloatVector:
    """Return the forcing of these steps, shape (k, n, m); one step, or one march, where it is the same for all."""
    shared = all(one.forcing is group[0].forcing for one in group)
    rows = [one.forcing[first:end] for one in (group[:1] if shared else group)]
    if all(one.strides[0] == 0 for one in rows):
        rows = [one[:1] for one in rows]
    return np.stack(rows, axis=2)


def _are_alike(one: March, other: March) -> bool:
    """Return whether the entries of both matrices stand in the same places, and those of both propagators."""
    return (
        one.problem.matrix is other.problem.matrix or _is_one_pattern(one.problem.csr, other.problem.csr)
    ) and _is_one_pattern(one.propagator, other.propagator)


def _is_one_pattern(A: sp.csr_array, B: sp.csr_array) -> bool:
    return A is B or (np.array_equal(A.indptr, B.indptr) and np.array_equal(A.indices, B.indices))


def _is_tridiagonal_z(problem: LCP) -> bool:
    band = bands(problem.matrix) if needs_no_scaling(problem) else None
    return band is not None and band.is_tridiagonal_z


def _unfinished(group: list[March]) -> list[March]:
    return [one for one in group if one.all_solved and len(one) < len(one.forcing)]


def _state(one: March) -> FloatVector:
    return one.z[-1] if len(one) else one.z0
