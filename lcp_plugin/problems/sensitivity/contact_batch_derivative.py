"""The derivatives of many worlds with contact: a compiled loop over what is small and plain, one by one the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import BoolVector, read_only, real_array
from ...core.errors import InvalidProblem, LCPError, UnsuitableProblem
from ...core.kind import changes_by_name
from ...core.settings import Status
from ..batches.contact_batch import ContactBatchResult
from ..cones.derivative import BY_HAND, ON_THE_EDGE, REFINEMENTS, REFINING, ROUNDING, ConeDerivative
from ..cones.small import LARGEST
from ..cones.solving import ConeResult
from ..many.chunks import in_chunks

CHANGES = "dq", "dM", "dfriction"
NAMED = 5  # worlds, in words


class _Jacobians(NamedTuple):
    """What the loop has found, a world a row."""

    z: Any
    by_q: Any
    by_friction: Any
    degenerate: Any
    ends: Any


class ContactBatchGradient:
    """Gradients of functions of the impulses and velocities of each world, with respect to its data.

    Parameters
    ----------
    q : array, shape (B, n)
        By b.
    friction : array, shape (B, k)
    z : array, shape (B, n)
        The impulses.

    Notes
    -----
    NaN where ``errors`` of the derivative says why there is none; 0 where the function does not look at the world, and
    for contacts that are not there. What you gave once for all worlds has the sum over the worlds for its gradient.
    """

    def __init__(self, q: Any, friction: Any, z: Any) -> None:
        self.q, self.friction, self._z = q, friction, z

    @cached_property
    def M(self) -> Any:
        """By the entries of W, shape (B, n, n); computed when it is looked at."""
        return self.q[:, :, np.newaxis] * self._z[:, np.newaxis]


class ContactBatchDerivative:
    """The derivatives of the impulses of many worlds by their W, b and friction.

    ``found[k]`` is the :class:`~lcp_plugin.problems.cones.derivative.ConeDerivative` of world k. What the arrays say of
    all worlds equals what it says, to rounding.

    Parameters
    ----------
    batch : ContactBatchResult
    each : callable
        Gives the ConeDerivative of a ConeResult.

    Attributes
    ----------
    errors : dict
        Why world k has no derivative: an UnsuitableProblem where it is not solved, an InvalidProblem where it is none.
        Their rows are NaN, and cost the others nothing.

    Notes
    -----
    One compiled loop, on as many threads as the batch had, takes ∂z/∂b and ∂z/∂μ of all worlds at the first call;
    every `vjp` and `jvp` after it is a product. Worlds in several units, those that leave in doubt whether their system
    is singular, and `jvp` of those with degenerate contacts are left to their ConeDerivative, which takes a hundred
    times as long.

    Examples
    --------
    How the impulse of a block that slides depends on friction, on the push, and on W:

    >>> from lcp_plugin import FrictionalContact, derivative, solve_batch
    >>> batch = solve_batch(FrictionalContact(np.eye(3), [[-1.0, 3.0, 4.0], [-1.0, 0.3, 0.0]], 0.5))
    >>> found = derivative(batch)
    >>> (found.jvp(dfriction=1.0).round(6) + 0.0).tolist()
    [[0.0, -0.6, -0.8], [0.0, 0.0, 0.0]]
    >>> gradient = found.vjp([1.0, 0.0, 0.0])
    >>> (gradient.q.round(6) + 0.0).tolist(), (gradient.friction.round(6) + 0.0).tolist(), gradient.M.shape
    ([[-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], [[0.0], [0.0]], (2, 3, 3))
    """

    def __init__(self, batch: ContactBatchResult, each: Callable[[ConeResult], ConeDerivative]) -> None:
        self.batch, self._derivative_of = batch, each
        self._each: dict[int, ConeDerivative] = {}
        self._is_solved: BoolVector = np.array([status is Status.SOLVED for status in batch.status], np.bool_)
        self.errors: dict[int, LCPError] = {**batch.errors}
        for k in np.flatnonzero(~self._is_solved).tolist():
            if k not in self.errors:
                status = batch.status[k]
                self.errors[k] = UnsuitableProblem(
                    f"only a solution has a derivative, and world {k} ended {status.name}: {status.value}"
                )

    def __len__(self) -> int:
        return len(self.batch)

    def __getitem__(self, k: int) -> ConeDerivative:
        k = range(len(self))[k]
        if k not in self._each:
            self._each[k] = self._derivative_of(self.batch[k])
        return self._each[k]

    @cached_property
    def _jacobians(self) -> _Jacobians:
        worlds = self.batch.worlds
        (count, n), k, d = worlds.b.shape, worlds.friction.shape[1], worlds.dimension
        found = _Jacobians(
            np.where(self._is_solved[:, np.newaxis], self.batch.z, 0.0), np.zeros((count, n, n)),
            np.zeros((count, n, k)), np.zeros((count, k), np.bool_), np.zeros(count, np.int8)
        )
        if not 0 < n <= LARGEST:
            return found
        from ..cones.derivative_kernels import derive_each

        starts, far, origin = np.arange(0, n + 1, d, dtype=np.int64), np.full(n, np.inf), np.zeros(n)
        data = *map(read_only, (starts, worlds.friction, -far, far, worlds.W, worlds.b, origin)),
        limits = REFINEMENTS, REFINING, ON_THE_EDGE, ROUNDING, read_only(self._is_solved)
        in_chunks(lambda first, end: derive_each(first, end, *data, *limits, *found), count, self.batch.threads)
        return found

    @property
    def _left(self) -> list[int]:
        """The solved worlds that the loop has left."""
        return np.flatnonzero(self._is_solved & (self._jacobians.ends == 0)).tolist()

    @cached_property
    def z(self) -> Any:
        """The impulses at which the derivatives are taken, shape (B, n); NaN where there are none."""
        z = np.where(self._is_solved[:, np.newaxis], self._jacobians.z, np.nan)
        for k in self._left:
            z[k, :self[k].z.size] = self[k].z
        return read_only(z)

    @cached_property
    def degenerate(self) -> Any:
        """The contacts on the edge of two cases, shape (B, k), of bool: there the derivative is one of several."""
        degenerate = self._jacobians.degenerate.copy()
        for k in self._left:
            degenerate[k] = np.isin(np.arange(degenerate.shape[1]), self[k].degenerate)
        return degenerate

    @cached_property
    def is_singular(self) -> Any:
        """The worlds in which several impulses make one motion, shape (B,), of bool: dz is the least of several."""
        is_singular = self._jacobians.ends == 2
        for k in self._left:
            is_singular[k] = self[k].is_singular
        return is_singular

    @property
    def advice(self) -> str:
        """What to know of derivatives that are not the only ones, in words; "" where none is known of others."""
        parts = (
            (self.degenerate.any(axis=1), "have contacts on the edge of two cases: jvp is one-sided there, and vjp the "
             "gradient of one of the pieces that meet"),
            (self.is_singular, "have several impulses for one motion: dz is the least change, that of the motion is "
             "the same for all"),
            (~self._is_solved, "have no derivative: errors says why"),
        )
        of_all = f"of {len(self)} worlds"
        return "; ".join(f"{which.sum()} {of_all} ({_named(which)}) {words}" for which, words in parts if which.any())

    def jvp(
        self, *, dq: ArrayLike | None = None, dM: ArrayLike | None = None, dfriction: ArrayLike | None = None,
        **named: Any,
    ) -> Any:
        """Return the changes dz that changes of the data make, shape (B, n); one-sided where contacts are degenerate.

        Parameters
        ----------
        dq : array, shape (B, n) or (n,), optional
            db.
        dM : array, shape (B, n, n) or (n, n), optional
            dW.
        dfriction : number or array, shape (B, k) or (k,), optional

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        InvalidOption
            For any other name.
        """
        changes_by_name(None, named, CHANGES, BY_HAND)
        worlds, found = self.batch.worlds, self._jacobians
        db, dW = self._given(dq, "dq", "n", worlds.b), self._given(dM, "dM", "n, n", worlds.W)
        change, slopes = self._moved(db, dW), self._given(dfriction, "dfriction", "k", worlds.friction)
        dz = np.zeros(found.z.shape)
        if change is not None:
            dz += _products(found.by_q, change)
        if slopes is not None:
            dz += _products(found.by_friction, slopes)
        is_left = self._is_solved & ((found.ends == 0) | found.degenerate.any(axis=1))
        for k, one, own in self._one_by_one(np.flatnonzero(is_left).tolist()):
            dz[k, own] = one.jvp(
                dq=None if db is None else db[k, own], dM=None if dW is None else dW[k, own, own],
                dfriction=None if slopes is None else slopes[k, :worlds.contacts[k]],
            )
        dz[[*self.errors]] = np.nan
        return dz

    def dw(self, dz: ArrayLike, *, dq: ArrayLike | None = None, dM: ArrayLike | None = None) -> Any:
        """Return the changes of the velocities w = W z + b that go with changes dz of z, shape (B, n)."""
        worlds = self.batch.worlds
        dz = self._given(dz, "dz", "n", worlds.b)
        moved = _products(worlds.W, dz)
        change = self._moved(self._given(dq, "dq", "n", worlds.b), self._given(dM, "dM", "n, n", worlds.W))
        dw = moved if change is None else moved + change
        dw[[*self.errors]] = np.nan
        return dw

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> ContactBatchGradient:
        """Return the gradients of functions L_k(z_k, w_k) of each world by its b, W and friction.

        Parameters
        ----------
        g : array, shape (B, n) or (n,)
            ∂L/∂z.
        gw : array, shape (B, n) or (n,), optional
            ∂L/∂w, w the velocities.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        """
        worlds, found = self.batch.worlds, self._jacobians
        by_z, by_w = self._given(g, "g", "n", worlds.b), self._given(gw, "gw", "n", worlds.b)
        whole = by_z if by_w is None else by_z + _products(worlds.W.swapaxes(1, 2), by_w)
        by_q = _products(found.by_q.swapaxes(1, 2), whole)
        by_q += 0.0 if by_w is None else by_w
        by_friction = _products(found.by_friction.swapaxes(1, 2), whole)
        for k, one, own in self._one_by_one(self._left):
            gradient = one.vjp(by_z[k, own], None if by_w is None else by_w[k, own])
            by_q[k, own], by_friction[k, :worlds.contacts[k]] = gradient.q, gradient.friction
        missing = [k for k in self.errors if _is_asked(g, k) or _is_asked(gw, k)]
        by_q[missing] = by_friction[missing] = np.nan
        return ContactBatchGradient(by_q, by_friction, np.where(self._is_solved[:, np.newaxis], self.z, 0.0))

    def _one_by_one(self, items: Sequence[int]) -> Iterator[tuple[int, ConeDerivative, slice]]:
        """Yield worlds, their derivatives and rows, and note what is wrong with one."""
        for k in items:
            try:
                yield k, self[k], slice(self[k].z.size)
            except LCPError as error:
                self.errors[k] = error

    def _moved(self, db: Any, dW: Any) -> Any:
        """Return dW z + db, shape (B, n), None where nothing moves."""
        if dW is None:
            return db
        turned = _products(dW, np.where(self._is_solved[:, np.newaxis], self.z, 0.0))
        return turned if db is None else db + turned

    def _given(self, values: Any, name: str, size: str, like: Any) -> Any:
        """Return an array as long as `like`, 0 where there is no contact and no answer; None stays."""
        if values is None:
            return None
        worlds, own = self.batch.worlds, like.shape[1:]
        one = f"({size})" if len(own) > 1 else f"({size},)"
        need = f"{name} must have shape (B, {size}) or {one}, here {like.shape} or {own}"
        given = real_array(values, need)
        if given.shape not in (like.shape, own, () if name == "dfriction" else own):
            raise InvalidProblem(f"{need}, got shape {given.shape}")
        rows = worlds.contacts * (1 if size == "k" else worlds.dimension)
        is_there = (np.arange(own[0]) < rows[:, np.newaxis]) & self._is_solved[:, np.newaxis]
        if is_there.all():
            given = np.broadcast_to(given, like.shape)
        else:
            is_there = is_there[:, :, np.newaxis] & is_there[:, np.newaxis] if len(own) > 1 else is_there
            given = np.where(is_there, given, 0.0)
        if not np.isfinite(given).all():
            at = tuple(np.argwhere(~np.isfinite(given))[0].tolist())
            raise InvalidProblem(f"{name} must be finite, but {name}{[*at]} = {given[at]}; repair that entry")
        return given


def _products(matrices: Any, rows: Any) -> Any:
    """Return A_k x_k, shapes (B, m, n) and (B, n)."""
    return np.matmul(matrices, rows[:, :, np.newaxis])[:, :, 0]


def _is_asked(rows: Any, k: int) -> bool:
    """Return whether row k, or the one row for all, is not 0."""
    array = np.asarray(0.0 if rows is None else rows, np.float64)
    return bool(np.any((array[k] if array.ndim > 1 else array) != 0.0))


def _named(which: BoolVector) -> str:
    rows = np.flatnonzero(which).tolist()
    return ", ".join(map(str, rows[:NAMED])) + (", …" if len(rows) > NAMED else "")
