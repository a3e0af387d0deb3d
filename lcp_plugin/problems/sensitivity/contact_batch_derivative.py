"""The derivatives of many worlds with contact: as of one problem whose matrix is stacked, one by one of the rest."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import BoolVector, read_only, real_array
from ...core.errors import InvalidProblem
from ...core.kind import changes_by_name
from ...core.lcp import LCP
from ...core.matrix.matrix import residual_scales
from ...systems.least_norm import FreeBlocks, products, solved
from ..batches.contact_batch import ContactBatchResult
from ..cones.data import Blocks
from ..cones.derivative import BY_HAND, REFINEMENTS, REFINING, ConeDerivative
from ..cones.methods import EXACT
from ..many.chunks import in_chunks
from .batch_derivative import ManyDerivatives

CHANGES = "dq", "dM", "dfriction"
NAMED = 5  # worlds, in words
TOGETHER = 512  # worlds whose arrays a cache holds


class _Worlds(Blocks):
    """The contacts of some worlds as the blocks of one problem; its matrix is not made: W stays stacked."""

    def __init__(self, W: Any, b: Any, friction: Any, dimension: int) -> None:
        rows = LCP(sp.csr_array((b.size, b.size)), b.ravel(), lower=-np.inf)
        super().__init__(rows, np.arange(0, b.size + 1, dimension), friction.ravel(), has_friction=True)
        self.W, self.d = W, dimension

    def slack(self, z: Any) -> Any:
        """Return W z + b."""
        return products(self.W, z.reshape(self.W.shape[:2])).ravel() + self.q

    @cached_property
    def scale(self) -> Any:
        """What w is divided by, as of each world by itself, shape (k,)."""
        count, n = self.W.shape[:2]
        blocks = self.W.reshape(count, n // self.d, self.d, n // self.d, self.d)
        norms = np.sqrt(np.einsum("kimjl,kimjl->kij", blocks, blocks))
        own = np.diagonal(norms, axis1=1, axis2=2) / np.sqrt(self.d)
        norms[:, range(n // self.d), range(n // self.d)] = own
        return residual_scales(own, norms.max(axis=2, initial=0.0)).ravel()


class _Together(ConeDerivative):
    """The derivative of some worlds as of one problem, whose system is one of each world."""

    problem: _Worlds

    def __init__(self, problem: _Worlds, z: Any) -> None:
        self.problem, self.shape = problem, z.shape
        self.z = self._refined(z.ravel())
        self.w = problem.slack(self.z)
        self._take_element_at(self.z, self.w)
        self.blocks = FreeBlocks(self._J, self._is_free.reshape(z.shape))

    def _take_rows(self, z: Any, w: Any) -> None:
        from ..cones.kernels import derivatives

        problem, (count, n), d = self.problem, self.shape, self.problem.d
        by_z = np.empty((problem.slope.size, d, d))
        self._by_w = np.empty_like(by_z)
        derivatives(*problem.arrays, *map(read_only, (z, w, problem.scale)), by_z, self._by_w)
        self._is_free = np.repeat(self._by_w.any(axis=(1, 2)), d)
        by_w = self._by_w.reshape(count, n // d, d, d)
        self._J = np.matmul(by_w, problem.W.reshape(count, n // d, d, n)).reshape(count, n, n)
        self._add_to_blocks(by_z)

    def _add_to_blocks(self, own: Any) -> None:
        """Add to the blocks on the diagonal of J, shape (blocks, d, d)."""
        (count, n), d = self.shape, self.problem.d
        places = np.arange(n // d)
        self._J.reshape(count, n // d, d, n // d, d)[:, places, :, places] += own.reshape(
            count, n // d, d, d).swapaxes(0, 1)

    def _refined(self, z: Any) -> Any:
        problem, shape = self.problem, self.shape

        def largest(values: Any) -> Any:
            return np.abs(values).reshape(shape).max(axis=1, initial=0.0)

        w = problem.slack(z)
        R = problem.residual(z, w)[0]
        goal = EXACT * largest(np.abs(z) + np.abs(w) / problem.scale[problem.block_of_row])
        for _ in range(REFINEMENTS):
            before = largest(R)
            if not (before > goal).any():
                break
            self._take_rows(z, w)
            self._add_to_blocks(REFINING * problem.scale[:, np.newaxis, np.newaxis] * self._by_w)
            after = z + solved(self._J, -R.reshape(*shape, 1)).ravel()
            w_after = problem.slack(after)
            R_after = problem.residual(after, w_after)[0]
            is_better = np.repeat((before > goal) & (largest(R_after) < before), shape[1])
            if not is_better.any():
                break
            z, w, R = (np.where(is_better, *pair) for pair in ((after, z), (w_after, w), (R_after, R)))
        return z

    def _sums_of_sizes(self) -> Any:
        return products(np.abs(self.problem.W), np.abs(self.z).reshape(self.shape)).ravel()

    def _product(self, x: Any, *, transposed: bool = False) -> Any:
        W = self.problem.W
        return products(W.swapaxes(1, 2) if transposed else W, x.reshape(self.shape)).ravel()

    def _by_slack(self, x: Any, *, transposed: bool = False) -> Any:
        return products(self._by_w.swapaxes(1, 2) if transposed else self._by_w, x.reshape(-1, self.problem.d)).ravel()

    def _on_free(self, right: Any, *, transposed: bool = False) -> Any:
        return self.blocks.solve(right.reshape(self.shape), transposed=transposed).ravel()


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


class ContactBatchDerivative(ManyDerivatives[ContactBatchResult]):
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
    The systems of all worlds are inverted at the first call, on as many threads as the batch had; every `vjp` and `jvp`
    after it is a product.
    Those that leave in doubt whether their system is singular, and `jvp` of those with degenerate contacts are left to
    their ConeDerivative, which takes a hundred times as long.

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

    @cached_property
    def _parts(self) -> list[_Together]:
        """The derivatives of some worlds after the others."""
        worlds, z, is_solved = self.batch.worlds, self.batch.z, self._is_solved[:, np.newaxis]
        parts: list[Any] = [None] * max(-(-len(self) // TOGETHER), 1)

        def derive(first: int, end: int) -> None:
            for k in range(first, end):
                own = slice(k * TOGETHER, (k + 1) * TOGETHER)
                W = np.where(is_solved[own, :, np.newaxis], worlds.W[own], np.eye(worlds.n))
                b, at, mu = (np.where(is_solved[own], one[own], 0.0) for one in (worlds.b, z, worlds.friction))
                parts[k] = _Together(_Worlds(W, b, mu, worlds.dimension), at)

        in_chunks(derive, len(parts), self.batch.threads)
        return parts

    def _asked(self, ask: Callable[[_Together, slice], Any]) -> Any:
        """Return what is asked of each part, and of its worlds, as one array."""
        places = (slice(k * TOGETHER, (k + 1) * TOGETHER) for k in range(len(self._parts)))
        return np.concatenate([ask(part, own) for part, own in zip(self._parts, places, strict=True)])

    @cached_property
    def _left(self) -> list[int]:
        """The solved worlds that are in doubt."""
        is_known = self._asked(lambda part, _: part.blocks.is_regular | part.blocks.is_singular)
        return np.flatnonzero(self._is_solved & ~is_known).tolist()

    @cached_property
    def z(self) -> Any:
        """The impulses at which the derivatives are taken, shape (B, n); NaN where there are none."""
        z = self._asked(lambda part, _: part.z.reshape(part.shape))
        z[~self._is_solved] = np.nan
        for k in self._left:
            z[k, :self[k].z.size] = self[k].z
        return read_only(z)

    @cached_property
    def degenerate(self) -> Any:
        """The contacts on the edge of two cases, shape (B, k), of bool: there the derivative is one of several."""
        count = self.batch.worlds.friction.shape[1]
        degenerate = self._asked(
            lambda part, _: np.isin(np.arange(part.problem.slope.size), part.degenerate).reshape(-1, count)
        )
        degenerate &= self._is_solved[:, np.newaxis]
        for k in self._left:
            degenerate[k] = np.isin(np.arange(count), self[k].degenerate)
        return degenerate

    @cached_property
    def is_singular(self) -> Any:
        """The worlds in which several impulses make one motion, shape (B,), of bool: dz is the least of several."""
        is_singular = self._is_solved & self._asked(lambda part, _: part.blocks.is_singular)
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
        worlds = self.batch.worlds
        db, dW = self._given(dq, "dq", "n", worlds.b), self._given(dM, "dM", "n, n", worlds.W)
        slopes = self._given(dfriction, "dfriction", "k", worlds.friction)
        change = self._moved(db, dW)
        change = np.zeros(worlds.b.shape) if change is None else change

        def tangent(part: _Together, own: slice) -> Any:
            more = 0.0 if slopes is None else part.by_friction * np.repeat(slopes[own].ravel(), worlds.dimension)
            return part.tangent(change[own].ravel(), None, more).reshape(part.shape)

        dz = self._asked(tangent)
        is_left = self._is_solved & self.degenerate.any(axis=1)
        is_left[self._left] = True

        def alone(k: int) -> Any:
            own = slice(self[k].z.size)
            return self[k].jvp(
                dq=None if db is None else db[k, own], dM=None if dW is None else dW[k, own, own],
                dfriction=None if slopes is None else slopes[k, :worlds.contacts[k]],
            )

        for k, answer in self._one_by_one(np.flatnonzero(is_left).tolist(), alone):
            dz[k, :answer.size] = answer
        dz[[*self.errors]] = np.nan
        return dz

    def dw(self, dz: ArrayLike, *, dq: ArrayLike | None = None, dM: ArrayLike | None = None) -> Any:
        """Return the changes of the velocities w = W z + b that go with changes dz of z, shape (B, n)."""
        worlds = self.batch.worlds
        dz = self._given(dz, "dz", "n", worlds.b)
        moved = products(worlds.W, dz)
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
        worlds = self.batch.worlds
        gw = np.zeros(worlds.n) if gw is None else gw
        by_z, by_w = self._given(g, "g", "n", worlds.b), self._given(gw, "gw", "n", worlds.b)

        contacts = worlds.friction.shape[1]

        def gradients(part: _Together, own: slice) -> Any:
            by_q, _, by_friction = part.gradients(by_z[own].ravel(), by_w[own].ravel())
            return np.hstack([by_q.reshape(part.shape), by_friction.reshape(-1, contacts)])

        by_q, by_friction = np.split(self._asked(gradients), [worlds.n], axis=1)

        def alone(k: int) -> Any:
            own = slice(self[k].z.size)
            return self[k].vjp(by_z[k, own], by_w[k, own])

        for k, gradient in self._one_by_one(self._left, alone):
            by_q[k, :gradient.q.size], by_friction[k, :gradient.friction.size] = gradient.q, gradient.friction
        missing = [k for k in self.errors if _is_asked(g, k) or _is_asked(gw, k)]
        by_q[missing] = by_friction[missing] = np.nan
        return ContactBatchGradient(by_q, by_friction, np.where(self._is_solved[:, np.newaxis], self.z, 0.0))

    def _moved(self, db: Any, dW: Any) -> Any:
        """Return dW z + db, shape (B, n), None where nothing moves."""
        if dW is None:
            return db
        turned = products(dW, np.where(self._is_solved[:, np.newaxis], self.z, 0.0))
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


def _is_asked(rows: Any, k: int) -> bool:
    """Return whether row k, or the one row for all, is not 0."""
    array = np.asarray(0.0 if rows is None else rows, np.float64)
    return bool(np.any((array[k] if array.ndim > 1 else array) != 0.0))


def _named(which: BoolVector) -> str:
    rows = np.flatnonzero(which).tolist()
    return ", ".join(map(str, rows[:NAMED])) + (", …" if len(rows) > NAMED else "")
