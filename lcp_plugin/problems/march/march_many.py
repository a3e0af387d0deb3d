"""Marches in time, one or many: the strikes of an option, a volatility for each, the loads of a rod."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...auto import asked_of_solve
from ...core.algorithm import Algorithm
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector, checked_vector, is_number, read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem, did_you_mean
from ...core.kind import kind_of, refusal
from ...core.lcp import LCP
from ...core.settings import OF_SOLVE, Settings, Status, checked_threads
from ...core.solving.driver import fused_result
from ...core.solving.result import Result
from ...methods.banded import Banded
from ...systems.factors import bands
from ..cones.data import Blocks
from ..many.chunks import in_chunks
from ..many.data import length_of_all, rows_of_a_batch
from . import BLOCK, March, begun, checked_forcing, checked_propagator, needs_no_scaling, take_steps

SIDE_BY_SIDE = 16  # as the compiled loop has space for


@np.errstate(under="ignore")
def march(
    problem: LCP | Blocks | Sequence[LCP],
    forcing: ArrayLike,
    propagator: Any = -1.0,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    max_seconds: float | None = None,
    keep_every: int = 1,
    threads: int | None = None,
    **wishes: Any,
) -> Any:
    """Return the results of steps in time: step j has q = forcing[j] + propagator @ z, z from the step before.

    Where forcing, z0, lower or upper have an axis more in front, or where problem or propagator is a list, these are as
    many marches, which are taken together where that is quicker.

    Parameters
    ----------
    problem : LCP or ConeProblem or FrictionalContact, or a list of m LCPs
        Gives M and the bounds or cones; its own q is not used. Of a list, each march has its own.
    forcing : array, shape (k, n), or (m, k, n) for m marches
        A row a step; ``np.broadcast_to(row, (k, n))`` where it is always the same.
    propagator : number or array or sparse array, shape (n, n), or a list of m of these
        What the z of one step adds to the q of the next; a number stands for a multiple of the identity. An implicit
        Euler step (I + Δt A) z = z_before has −1.
    lower, upper : number or array, shape (n,) or (m, n), optional
        In the place of an LCP's own bounds.
    z0 : array, shape (n,) or (m, n), optional
        The state before the first step; by default the point of [lower, upper] nearest to 0.
    max_seconds : float, optional
        In seconds, for all marches together: the step under way then is the last one.
    threads : int, optional
        How many threads there may be; by default all that the process may use. The bits do not depend on it.
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
        overflows (``error`` says so), or after Ctrl-C. That ends the other marches, too, and so does a callback.

    Raises
    ------
    InvalidOption, InvalidProblem, UnknownAlgorithm, UnsuitableProblem
        Before the first step; the last where the rows of M are spread over ranks.

    Notes
    -----
    Each step starts from the answer of the one before, and is judged as any other problem. On narrow bands, where
    `auto` takes `banded`, all steps run in one compiled loop, certificates included. Elsewhere `auto` chooses afresh
    in the first two steps; later ones begin with the method that ended the step before. Where few rows have a bound,
    as in contact, the others are eliminated by one factor, once for all steps, if that pays. Several marches are taken
    together where their matrices are tridiagonal, with no positive entry off the diagonal and entries in the same
    places, and `auto` takes `banded`: by one factor of M where the rows at bounds come first, each step judged.

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
    of_states = lower, upper, z0
    are_many = (
        isinstance(problem, (list, tuple))
        or _is_one_a_march(propagator)
        or _has_more_axes(forcing, of_states)
    )
    problems = list(problem) if isinstance(problem, (list, tuple)) else [problem]
    if not problems:
        return []
    clock, limit = Clock(), Settings(max_seconds=max_seconds).max_seconds
    if not are_many and threads is not None:
        wishes["threads"] = threads
    states = {
        name: values
        for name, values in zip(("lower", "upper", "z0"), of_states, strict=True)
        if values is not None
    }
    marches = _begin(
        problems, forcing, propagator, states, keep_every, algorithm, wishes, are_many=are_many
    )
    if not are_many:
        take_steps(marches[0], len(marches[0].forcing), algorithm, wishes, limit=limit)
        return marches[0]
    try:
        _Steps(marches, algorithm, wishes, limit, clock).take(checked_threads(threads))
    except KeyboardInterrupt:
        for done in marches:
            done.all_solved = done.all_solved and len(done) == len(done.forcing)
    return marches


def march_many(problem: Any, *given: Any, **named: Any) -> list[March]:
    """Return what :func:`march` does of several marches, a list also of one.

    Parameters
    ----------
    problem : LCP, or a list of m
    *given, **named
        As for :func:`march`.

    Returns
    -------
    list of March
        One a march, in order.

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0])
    >>> [done.z[-1].round(3) for done in march_many(rod, [[-1, 0], [-1, 0]], z0=[1, 1])]
    [array([0.781, 0.469])]
    """
    marches: list[March] = march(
        problem if isinstance(problem, (list, tuple)) else [problem], *given, **named
    )
    return marches


def _has_more_axes(forcing: Any, of_states: tuple[Any, ...]) -> bool:
    """Return whether one of these has an axis for several marches."""
    try:
        return np.ndim(forcing) == 3 or any(np.ndim(one) == 2 for one in of_states)
    except ValueError:  # rows of different lengths, which one march refuses in words
        return False


def _begin(
    problems: list[Any],
    forcing: ArrayLike,
    propagator: Any,
    states: dict[str, Any],
    keep_every: int,
    algorithm: str | Algorithm,
    wishes: dict[str, Any],
    *,
    are_many: bool,
) -> list[March]:
    """Return the marches before their first steps; whatever is wrong is refused."""
    way, n = "march_many" if are_many else "march", getattr(problems[0], "n", 0)
    for j, one in enumerate(problems):
        kind = kind_of(one)
        if kind is None or way not in kind.ways:
            raise InvalidOption(refusal(way, one))
        if not isinstance(one, LCP) and states.keys() - {"z0"}:
            raise InvalidOption(
                f"lower and upper of a march are bounds of an LCP; a {kind.word} has none"
            )
        if one.n != n:
            raise InvalidProblem(
                f"all problems must have one size, got n = {n}, and {one.n} of problem {j}; "
                "march along those of one size at a time"
            )
        if isinstance(one, LCP):
            one.matrix.require_all_rows()
    if algorithm == "auto" and (unknown := [name for name in wishes if name not in OF_SOLVE]):
        raise InvalidOption(
            f"march has no option {unknown[0]!r}{did_you_mean(unknown[0], OF_SOLVE)}"
        )
    if (
        isinstance(keep_every, bool)
        or not isinstance(keep_every, (int, np.integer))
        or keep_every < 1
    ):
        raise InvalidOption(
            f"keep_every must be an integer ≥ 1, got {keep_every!r}; 1 keeps every answer"
        )
    shape, axes = (
        ("(m, k, n), or (k, n) for all marches", (2, 3))
        if are_many
        else ("(k, n), a row a step", (2,))
    )
    given = checked_forcing(forcing, n, shape, axes)
    offsets = [given] if given.ndim == 2 else list(given)
    propagators = [
        checked_propagator(C, n)
        for C in (propagator if _is_one_a_march(propagator) else [propagator])
    ]
    rows = {
        name: rows_of_a_batch(values, name, n) if are_many else [values]
        for name, values in states.items()
    }
    if isinstance(problems[0], LCP):
        asked_of_solve(algorithm, wishes)
    several: dict[str, Any] = {
        "problem": problems,
        "forcing": offsets,
        "propagator": propagators,
        **rows,
    }
    marches: list[March] = []
    for j in range(
        length_of_all({name: len(one) for name, one in several.items() if len(one) != 1})
    ):
        own = {name: one[min(j, len(one) - 1)] for name, one in several.items()}
        stated, bounds = (
            own["problem"],
            {name: own[name] for name in ("lower", "upper") if name in own},
        )
        stated = stated.with_q(stated.q, **bounds) if bounds else stated
        state = checked_vector(own["z0"], "z0", n) if "z0" in own else stated.nearest_to_zero
        marches.append(
            begun(
                stated, own["forcing"], own["propagator"], state, int(keep_every), algorithm, wishes
            )
        )
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
        self,
        marches: list[March],
        algorithm: str | Algorithm,
        wishes: dict[str, Any],
        limit: float,
        clock: Clock,
    ) -> None:
        self.marches, self.algorithm, self.wishes, self.limit, self.clock = (
            marches,
            algorithm,
            wishes,
            limit,
            clock,
        )
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
        clock, leader, settings, first = (
            Clock(group[0].problem.matrix),
            group[0],
            self.settings,
            len(group[0]),
        )
        algorithm, policy, choice = self.first.algorithm, self.policy, self.first
        assert isinstance(algorithm, Banded)
        lower, upper, states = (
            np.stack(rows, axis=1)
            for rows in zip(
                *((one.problem.lower, one.problem.upper, _state(one)) for one in group), strict=True
            )
        )
        here = [k for k in range(end - first) if leader.keeps(first + k)]
        kept = np.full(end - first, -1)
        kept[here] = np.arange(len(here))
        matrices = {id(one.problem.matrix) for one in group}, {id(one.propagator) for one in group}
        own = group if max(map(len, matrices)) > 1 else group[:1]
        found = algorithm.fused_marches(
            [one.problem for one in own],
            _forcing_of(group, first, end),
            [one.propagator for one in own],
            lower,
            upper,
            states,
            kept,
            settings.tolerance,
            settings.max_iterations,
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
        one.problem.matrix is other.problem.matrix
        or _is_one_pattern(one.problem.csr, other.problem.csr)
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
