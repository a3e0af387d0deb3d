"""Problems with the same blocks as a stack of arrays: vectors have shape (B, k, m), and one problem is B = 1.

Block k has up to m rows; unused entries of its row in an array are 0. A block of one row is a number between bounds.
Other blocks are points of the cone K = {‖x_T‖ ≤ μ x_N}, x_N the first row. The slack of a cone is û = w + μ‖w_T‖ e_N
with friction (De Saxcé), and w without. The residual of a block is the natural map R = z − P_K(z − ŵ/d).
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from .systems import Arms

OUT, WITHIN, ON = 0, 1, 2  # location of a projection: apex or bound, interior, boundary of a cone
TINY = np.finfo(np.float64).tiny
LEAST_DIAGONAL = 2.0**-20  # relative to the largest entry of its row: a smaller one is not a scale
DENSE_UP_TO = 300  # unknowns of a sparse problem that is stored as dense
NOISE = 2.0**-42  # of the sum of a row's terms: bound of its rounding error
Array = Any


def length(x: Array) -> Array:
    """Return the norms over the last axis; squares may be beyond the range of double precision."""
    if x.shape[-1] == 2:
        return np.hypot(x[..., 0], x[..., 1])
    if x.shape[-1] == 3:
        return np.hypot(np.hypot(x[..., 0], x[..., 1]), x[..., 2])
    return np.hypot.reduce(np.abs(x), axis=-1)


class Pattern:
    """Block structure of M: nonzero blocks, their sizes, scales and connected components.

    Parameters
    ----------
    M : array, shape (B, n, n), or CSR, shape (n, n)
    starts : array of int, shape (k + 1,)
        First row of each block.

    Attributes
    ----------
    rows, indices, indptr : array of int
        The blocks of M, one after the other, by rows of blocks; all diagonal blocks are included.
    norms : array, shape (B, blocks)
        Frobenius norms of the blocks.
    own : array, shape (B, k, m, m)
        The diagonal blocks.
    d : array, shape (B, k)
        Divisor of w. It is ‖M_kk‖/√m for a block of m rows, and the diagonal entry for one row. If this is less than
        2⁻²⁰ of the largest block of its row, d is the size of that block; 1 for an empty row.
    labels : array of int, shape (B, k), or None
        The connected component of each block; None if every problem is connected.
    """

    def __init__(self, M: Array, starts: Array) -> None:
        self.starts, self.sizes = starts, np.diff(starts)
        self.k, self.n, self.m = self.sizes.size, int(starts[-1]), int(self.sizes.max(initial=1))
        is_even = bool((self.sizes == self.m).all())
        self.of_row = np.repeat(np.arange(self.k), self.sizes)
        self.place = (
            None if is_even else self.of_row * self.m + np.arange(self.n) - starts[self.of_row]
        )
        self.is_row = self.sizes == 1
        self.has_rows = bool(self.is_row.any())
        self.M, self.is_sparse = M, sp.issparse(M)
        self.B = 1 if self.is_sparse else len(M)
        if self.is_sparse:
            self._read_sparse(M)
        else:
            self._read_dense(M)
        self.is_own = self.rows == self.indices
        per_row = np.diff(M.indptr) if self.is_sparse else np.array([self.n])
        self.most_terms = int(per_row.max(initial=0))  # of a row's sum
        self._measure()

    def _read_dense(self, M: Array) -> None:
        B, k, m = self.B, self.k, self.m
        self.indices = np.tile(np.arange(k, dtype=np.int32), k)
        self.indptr = k * np.arange(k + 1, dtype=np.int32)
        self.rows = np.repeat(np.arange(k), k)
        if self.place is None:
            blocks = M.reshape(B, k, m, k, m).swapaxes(2, 3)
            blocks = blocks.reshape(B, k * k, m, m)
            self.norms = length(blocks.reshape(B, k * k, m * m))
            self.own = np.ascontiguousarray(blocks[:, :: k + 1])
            return
        by_rows = np.hypot.reduceat(np.abs(M), self.starts[:-1], axis=2)
        self.norms = np.hypot.reduceat(by_rows, self.starts[:-1], axis=1).reshape(B, k * k)
        self.own = np.zeros((B, k, m, m))
        i, j, block = self.inner
        at = self.starts[:-1][block]
        self.own[:, block, i, j] = M[:, at + i, at + j]

    def _read_sparse(self, M: Array) -> None:
        k, m = self.k, self.m
        if self.place is None:
            blocks = sp.bsr_array(M, blocksize=(m, m)) + sp.bsr_array(
                (np.zeros((k, m, m)), np.arange(k), np.arange(k + 1)), shape=M.shape
            )
            blocks.sort_indices()
            self.indices, self.indptr = blocks.indices, blocks.indptr
            self.rows = np.repeat(np.arange(k), np.diff(self.indptr))
            self.norms = length(blocks.data.reshape(1, -1, m * m))
            self.own = np.ascontiguousarray(blocks.data[self.rows == self.indices])[None]
            return
        entries = M.tocoo()
        of_row, of_column = self.of_row[entries.row], self.of_row[entries.col]
        keys = np.concatenate([of_row * np.int64(k) + of_column, np.arange(k) * np.int64(k + 1)])
        blocks, where = np.unique(keys, return_inverse=True)
        self.rows, self.indices = blocks // k, blocks % k
        self.indptr = np.searchsorted(self.rows, np.arange(k + 1))
        order = np.argsort(where[: entries.nnz], kind="stable")
        self.norms = np.zeros((1, blocks.size))
        if order.size:
            filled, begins = np.unique(where[order], return_index=True)
            self.norms[0, filled] = np.hypot.reduceat(np.abs(entries.data[order]), begins)
        self.own = np.zeros((1, k, m, m))
        inside = of_row == of_column
        row, column, block = entries.row[inside], entries.col[inside], of_row[inside]
        at = self.starts[:-1][block]
        self.own[0, block, row - at, column - at] = entries.data[inside]

    @cached_property
    def inner(self) -> tuple[Array, Array, Array]:
        """Row and column within their block, and the block, of all entries of diagonal blocks."""
        block = np.repeat(np.arange(self.k), self.sizes**2)
        first = np.cumsum(self.sizes**2) - self.sizes**2
        at = np.arange(block.size) - first[block]
        return at // self.sizes[block], at % self.sizes[block], block

    def _measure(self) -> None:
        norms, shape = self.norms, (self.B, self.k)
        self.d, self.most, self.labels = np.ones(shape), np.ones(shape), None
        if not norms.size:
            return
        self.most = np.maximum.reduceat(norms, self.indptr[:-1], axis=1)
        own = norms[:, self.is_own] / np.sqrt(self.sizes)
        if self.has_rows:
            own = np.where(self.is_row, self.own[:, :, 0, 0], own)
        usable = (own > 0.0) & (own >= LEAST_DIAGONAL * self.most)
        self.d = np.where(usable, own, np.where(self.most > 0.0, self.most, 1.0))
        is_there = norms > 0.0
        if self.k == 1 or (norms.shape[1] == self.k**2 and is_there.all()):
            return
        size = self.B * self.k
        if self.B == 1 and is_there.all():
            graph = sp.csr_array((norms[0], self.indices, self.indptr), shape=(size, size))
        else:
            shift = self.k * np.arange(self.B)[:, None]
            where = (np.broadcast_to(i, norms.shape) + shift for i in (self.rows, self.indices))
            row, column = (one[is_there] for one in where)
            graph = sp.coo_array((norms[is_there], (row, column)), shape=(size, size))
        count, labels = sp.csgraph.connected_components(graph, directed=False)
        if count > self.B:
            self.labels = labels.reshape(shape)

    def wide(self, x: Array) -> Array:
        """Return vectors of shape (B, n) as (B, k, m)."""
        shape = len(x), self.k, self.m
        if self.place is None:
            return x.reshape(shape)
        found = np.zeros((shape[0], self.k * self.m))
        found[:, self.place] = x
        return found.reshape(shape)

    def flat(self, x: Array) -> Array:
        """Return vectors of shape (B, k, m) as (B, n)."""
        x = x.reshape(len(x), self.k * self.m)
        return x if self.place is None else x[:, self.place]

    def times(self, z: Array, *, absolute: bool = False) -> Array:
        """Return M z, or |M||z|, shape (B, k, m)."""
        M, x = self.M, self.flat(z)
        if absolute:
            M, x = (self.absolute if self.B == 1 else np.abs(M)), np.abs(x)
        return self.wide((M @ x[0])[None] if self.is_sparse else (M @ x[:, :, None])[:, :, 0])

    @cached_property
    def absolute(self) -> Array:
        """|M|."""
        return abs(self.M)

    @property
    def nonzeros(self) -> int:
        """Number of entries of M of one problem."""
        return self.M.nnz if self.is_sparse else self.n**2

    def largest(self, values: Array) -> Array:
        """Return the largest value in the component of each block, shape (B, k)."""
        if self.labels is None:
            most = values.max(1, keepdims=True, initial=0.0)
            return np.broadcast_to(most, values.shape)
        most = np.zeros(int(self.labels.max()) + 1)
        np.maximum.at(most, self.labels.ravel(), values.ravel())
        return most[self.labels]

    def neighbours(self, values: Array) -> Array:
        """Return the largest ‖M_kl‖ · values_l over all blocks l of each block's row, shape (B, k)."""
        terms = self.norms * values[:, self.indices]
        return np.maximum.reduceat(terms, self.indptr[:-1], axis=1) if terms.size else values

    def take(self, some: Array) -> Pattern:
        """Return the pattern of the selected problems."""
        other = copy(self)
        for name in ("M", "norms", "own", "d", "most", "labels"):
            values = getattr(self, name)
            setattr(other, name, None if values is None else values[some])
        other.B = len(other.d)
        return other


class ConeStack:
    """Problems over cones with the same blocks.

    Parameters
    ----------
    pattern : Pattern
    q : array, shape (B, n)
    slope : array, shape (B, k)
        μ.
    lower, upper : array, shape (B, n) or (1, n)
        Bounds of the blocks of one row.
    has_friction : bool
    arms : Arms, optional
        The bodies of one problem, if any.
    """

    def __init__(
        self,
        pattern: Pattern,
        q: Array,
        slope: Array,
        lower: Array,
        upper: Array,
        *,
        has_friction: bool,
        arms: Any = None,
    ) -> None:
        self.pattern, self.has_friction, self.arms = pattern, has_friction, arms
        self.q, self.mu = pattern.wide(q), slope
        self.d, self.B, self.k, self.m = pattern.d, pattern.B, pattern.k, pattern.m
        first = pattern.starts[:-1]
        self.low: Array = lower[:, first] if pattern.has_rows else None
        self.high: Array = upper[:, first] if pattern.has_rows else None
        self.origin = self.project(np.zeros_like(self.q))
        w = self.slack(self.origin) if self.origin.any() else self.q
        size = length(self.residual(self.origin, w)[0])
        self.reference = pattern.largest(size)
        self.is_answered = self.reference == 0.0  # the origin is a solution
        self.weight = np.where(self.is_answered, 0.0, 1.0 / self.reference)
        asks = length(w)
        if pattern.has_rows and self.origin.any():
            terms = length(pattern.times(self.origin, absolute=True) + np.abs(self.q))
            asks = np.where(asks > NOISE * terms, asks, 0.0)
        # b may be rounding error at a contact of a pile and at its neighbors, so contacts use the component.
        self.asks = (
            pattern.largest(asks)
            if has_friction
            else np.maximum(asks, pattern.neighbours(asks / self.d))
        )

    @classmethod
    def of(cls, problem: Any) -> ConeStack:
        """Return the stack of one problem; the data of its matrix are cached."""
        pattern, arms = _pattern_of(problem)
        arrays = (one[None] for one in (problem.q, problem.slope, problem.lower, problem.upper))
        with np.errstate(all="ignore"):
            return cls(pattern, *arrays, has_friction=problem.has_friction, arms=arms)

    def take(self, some: Array) -> ConeStack:
        """Return the stack of the problems selected by a mask."""
        if some.all():
            return self
        other = copy(self)
        other.pattern = self.pattern.take(some)
        for name, values in vars(self).items():
            if isinstance(values, np.ndarray) and len(values) == self.B:
                setattr(other, name, values[some])
        other.B = other.pattern.B
        return other

    def slack(self, z: Array) -> Array:
        """Return w = M z + q."""
        return self.pattern.times(z) + self.q

    @np.errstate(all="ignore")
    def residual(self, z: Array, w: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return R, the locations of the projections, x = d z − w, ‖x_T‖, and x_N on the boundary.

        With friction, the sign of d z_N − w_N + μ(‖x_T‖ − ‖w_T‖) decides. The norms of a fast slide nearly cancel,
        so this uses
        ‖a‖ − ‖b‖ = (a − b)ᵀ(a + b) / (‖a‖ + ‖b‖).
        """
        mu, d = self.mu, self.d[..., None]
        at, v = d * z, w / d
        x = at - w
        tangent, above = length(x[..., 1:]), x[..., 0]
        if self.has_friction:
            slip = length(w[..., 1:])
            sums = np.maximum(tangent + slip, TINY)[..., None]
            above = above + mu * (at[..., 1:] * ((x[..., 1:] - w[..., 1:]) / sums)).sum(-1)
            v[..., 0] += mu * (slip / self.d)
        else:
            above = above + mu * tangent
        axis = above / (1.0 + mu * mu)
        case = np.where(above <= 0.0, OUT, np.where(tangent <= mu * axis, WITHIN, ON))
        share = (mu * axis / self.d)[..., None]
        edge = z - share * (x / np.maximum(tangent, TINY)[..., None])
        edge[..., 0] = z[..., 0] - axis / self.d
        where = case[..., None]
        R = np.where(where == OUT, z, np.where(where == WITHIN, v, edge))
        if self.low is not None:
            step, at = v[..., 0], z[..., 0]
            below, over = at - self.high, at - self.low
            own = np.minimum(np.maximum(step, below), over)
            is_row = self.pattern.is_row
            R[..., 0] = np.where(is_row, own, R[..., 0])
            is_free = (below < step) & (step < over)
            case = np.where(is_row, np.where(is_free, WITHIN, OUT), case)
        return R, case, x, tangent, axis

    def project(self, z: Array) -> Array:
        """Return the point of the cones nearest to z."""
        tangent, normal = length(z[..., 1:]), z[..., 0]
        on_axis = (normal + self.mu * tangent) / (1.0 + self.mu**2)
        found = (self.mu * on_axis)[..., None] * (z / np.maximum(tangent, TINY)[..., None])
        found[..., 0] = on_axis
        found = np.where((tangent <= self.mu * normal)[..., None], z, found)
        found = np.where((on_axis <= 0.0)[..., None], 0.0, found)
        if self.low is not None:
            own = np.minimum(np.maximum(normal, self.low), self.high)
            found[..., 0] = np.where(self.pattern.is_row, own, found[..., 0])
        return found

    def snap(self, z: Array) -> Array:
        """Return the nearest point of the cones; the origin in components that it solves."""
        z, answered = self.project(z), self.is_answered
        return np.where(answered[..., None], self.origin, z) if answered.any() else z

    def derivative(
        self, w: Array, case: Array, x: Array, tangent: Array, axis: Array
    ) -> tuple[Array, Array]:
        """Return an element of the generalised derivative of R by z and by w of each block, (B, k, m, m)."""
        mu, share, eye = self.mu, 1.0 / (1.0 + self.mu**2), np.eye(self.m)
        way = x[..., 1:] / np.maximum(tangent, TINY)[..., None]
        radius = mu * (axis / np.maximum(tangent, TINY))
        P = np.zeros((*w.shape, self.m))
        P[..., 0, 0] = share
        P[..., 0, 1:] = P[..., 1:, 0] = (mu * share)[..., None] * way
        P[..., 1:, 1:] = (
            (mu * mu * share - radius)[..., None, None] * way[..., :, None] * way[..., None, :]
        )
        P[..., 1:, 1:] += radius[..., None, None] * eye[1:, 1:]
        is_apex = (axis == 0.0) & (tangent == 0.0) & ~self.pattern.is_row  # belongs to all modes
        is_whole = ((case == WITHIN) | is_apex) & (mu > 0.0)
        if self.low is not None:
            is_whole |= self.pattern.is_row & (case == WITHIN)
        P[(case == OUT) & ~is_apex], P[is_whole] = 0.0, eye
        by_w = P / self.d[..., None, None]
        if self.has_friction:
            slide = mu[..., None] * w[..., 1:] / np.maximum(length(w[..., 1:]), TINY)[..., None]
            by_w[..., 1:] += by_w[..., :1] * slide[..., None, :]
        return eye - P, by_w

    def measure(self, z: Array) -> tuple[Array, Any, Array, Array]:
        """Return w, the values of `residual`, the largest ‖R_k‖ / reference, and their norm."""
        w = self.slack(z)
        found = self.residual(z, w)
        sizes = length(found[0]) * self.weight
        return w, found, sizes.max(1, initial=0.0), np.sqrt((sizes * sizes).sum(1))


def _pattern_of(problem: Any) -> tuple[Pattern, Any]:
    """Return the pattern and the arms of a problem, shared by all problems with its matrix."""
    if "stack" not in problem._facts:
        M = problem.rows.M
        if sp.issparse(M) and problem.bodies is None and problem.n <= DENSE_UP_TO:
            M = M.toarray()
        with np.errstate(all="ignore"):
            pattern = Pattern(M[None] if isinstance(M, np.ndarray) else M, problem.starts)
        arms = None if problem.bodies is None else Arms(problem.bodies, pattern.k, pattern.m)
        problem._facts["stack"] = pattern, arms
    found: tuple[Pattern, Any] = problem._facts["stack"]
    return found
