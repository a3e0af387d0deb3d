"""Problems with the same blocks as a stack of arrays: vectors have shape (B, k, m), and B = 1 for one problem.

Block k has up to m rows; unused entries of its row in an array are 0. A block of one row is a number between bounds.
Other blocks are points of the cone K = {‖x_T‖ ≤ μ x_N}, x_N the first row. The slack of a cone is û = w + μ‖w_T‖ e_N
with friction (De Saxcé), and w without. The residual of a block is the natural map R = z − P_K(z − ŵ/d).
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from .checks import Array, copy_without, read_only
from .entries import clip
from .kernels.compilation import helper, kernel
from .kernels.floats import NEGLIGIBLE_DIAGONAL, NORMAL

OUT, WITHIN, ON = 0, 1, 2  # location of a projection: apex or bound, interior, boundary of a cone


def length(x: Array) -> Array:
    """Return the norms over the last axis; squares may be beyond the range of double precision."""
    if x.shape[-1] == 2:
        return np.hypot(x[..., 0], x[..., 1])
    if x.shape[-1] == 3:
        return np.hypot(np.hypot(x[..., 0], x[..., 1]), x[..., 2])
    return np.hypot.reduce(np.abs(x), axis=-1)


@helper
def read_blocks_of_problem(starts, indptr, indices, data, blocks, d, labels):  # type: ignore[no-untyped-def]
    """Write the diagonal blocks of one matrix, their scales d, and the first block of the component of each."""
    k = starts.size - 1
    of_row, sums = np.empty(starts[k], np.int64), np.zeros(k)
    for c in range(k):
        of_row[starts[c] : starts[c + 1]] = labels[c] = c
    for c in range(k):
        first, size = starts[c], starts[c + 1] - starts[c]
        norm, largest = 0.0, 0.0
        for i in range(size):
            for p in range(indptr[first + i], indptr[first + i + 1]):
                sums[of_row[indices[p]]] += abs(data[p])
                if of_row[indices[p]] == c:
                    blocks[c, i, indices[p] - first] = data[p]
                    norm = np.hypot(norm, data[p])
        for p in range(indptr[first], indptr[first + size]):
            a, other = c, of_row[indices[p]]
            if sums[other] == 0.0:
                continue
            # Σ |m_ij| / √(rows · columns), at most the Frobenius norm, of the largest block of the row
            width = starts[other + 1] - starts[other]
            largest, sums[other] = max(largest, sums[other] / np.sqrt(size * width)), 0.0
            while labels[a] != a:
                a = labels[a]
            while labels[other] != other:
                other = labels[other]
            labels[max(a, other)] = min(a, other)
        norm = norm / np.sqrt(size) if size > 1 else blocks[c, 0, 0]
        d[c] = norm
        if not (norm > 0.0 and norm >= NEGLIGIBLE_DIAGONAL * largest):
            d[c] = largest if largest > 0.0 else 1.0
    for c in range(k):
        labels[c] = labels[labels[c]]


@kernel
def read_blocks(starts, indptr, indices, data, blocks, d, labels):  # type: ignore[no-untyped-def]
    """Write the diagonal blocks of matrices with one pattern, their scales and their components."""
    for problem in range(d.shape[0]):
        arrays = blocks[problem], d[problem], labels[problem]
        read_blocks_of_problem(starts, indptr, indices, data[problem], *arrays)


class Pattern:
    """Block structure of M: diagonal blocks, scales and connected components.

    Parameters
    ----------
    M : array, shape (B, n, n), or CSR, shape (n, n)
    starts : array of int, shape (k + 1,)
        First row of each block.

    Attributes
    ----------
    inner : tuple of two arrays of int
        Row and column of each entry of the diagonal blocks.
    blocks : array, shape (B, k, m, m)
        The diagonal blocks.
    d : array, shape (B, k)
        Divisor of w. It is ‖M_kk‖/√m for a block of m rows, and the diagonal entry for one row. If this is less than
        2⁻²⁰ of the largest block of its row, d is the size of that block; 1 for an empty row.
    labels : array of int, shape (B, k), or None
        The connected component of each block; None if every problem is connected.
    """

    def __init__(self, M: Array, starts: Array) -> None:
        self.M, self.is_sparse = M, sp.issparse(M)
        self.B = 1 if self.is_sparse else len(M)
        self.nonzeros = M.size // max(self.B, 1)  # of one problem
        self.starts, self.sizes = starts, np.diff(starts)
        self.k, self.n, self.m = self.sizes.size, int(starts[-1]), int(self.sizes.max(initial=1))
        self.of_row = np.repeat(np.arange(self.k), self.sizes)
        self.in_block = np.arange(self.n) - starts[self.of_row]
        is_even = (self.sizes == self.m).all()
        self.place = None if is_even else self.of_row * self.m + self.in_block
        self.is_row = self.sizes == 1
        self.has_rows = bool(self.is_row.any())
        counts = self.sizes[self.of_row]
        row = np.repeat(np.arange(self.n), counts)
        shift = np.cumsum(counts) - counts - starts[self.of_row]
        self.inner = row, np.arange(row.size) - np.repeat(shift, counts)
        self.blocks = np.zeros((self.B, self.k, self.m, self.m))
        self.d, labels = np.empty((self.B, self.k)), np.empty((self.B, self.k), np.int64)
        read_blocks(read_only(self.starts), *self.entries, self.blocks, self.d, labels)
        firsts = self.k * np.arange(self.B)[:, np.newaxis]
        self.labels = labels + firsts if labels.any() else None

    def entry(self, row: Array, column: Array) -> tuple[Array, ...]:
        """Return the index of entries of diagonal blocks in arrays of shape (B, k, m, m)."""
        return slice(None), self.of_row[row], self.in_block[row], self.in_block[column]

    @cached_property
    def entries(self) -> tuple[Array, Array, Array]:
        """Pointers, columns, and values, (B, …), of M by rows, for the compiled loop."""
        M, n = self.M, self.n
        if self.is_sparse:
            arrays = M.indptr.astype(np.int64), M.indices.astype(np.int64), M.data[None]
        else:
            values = np.ascontiguousarray(M).reshape(self.B, n * n)
            arrays = n * np.arange(n + 1), np.tile(np.arange(n), n), values
        indptr, indices, values = map(read_only, arrays)
        return indptr, indices, values

    def wide(self, x: Array) -> Array:
        """Return arrays of shape (B, n, …) as (B, k, m, …)."""
        shape = len(x), self.k, self.m, *x.shape[2:]
        if self.place is None:
            return x.reshape(shape)
        padded = np.zeros((len(x), self.k * self.m, *x.shape[2:]))
        padded[:, self.place] = x
        return padded.reshape(shape)

    def flat(self, x: Array) -> Array:
        """Return arrays of shape (B, k, m, …) as (B, n, …)."""
        x = x.reshape(len(x), self.k * self.m, *x.shape[3:])
        return x if self.place is None else x[:, self.place]

    def times(self, z: Array, *, absolute: bool = False) -> Array:
        """Return M z, or |M||z|, shape (B, k, m)."""
        M, x = self.M, self.flat(z)
        if absolute:
            M, x = abs(M), np.abs(x)
        return self.wide((M @ x[0])[None] if self.is_sparse else (M @ x[:, :, None])[:, :, 0])

    def largest(self, values: Array) -> Array:
        """Return the largest value in the component of each block, shape (B, k), or (B, 1) if there is one."""
        if self.labels is None:
            return values.max(1, keepdims=True, initial=0.0)
        most = np.zeros(int(self.labels.max()) + 1)
        np.maximum.at(most, self.labels.ravel(), values.ravel())
        return most[self.labels]

    def take(self, some: Array) -> Pattern:
        """Return the pattern of the selected problems."""
        other = copy_without(self, "entries")
        for name in ("M", "blocks", "d", "labels"):
            values = getattr(self, name)
            setattr(other, name, None if values is None else values[some])
        other.B = len(other.d)
        return other


class NaturalMap(NamedTuple):
    """The natural map R of a stack and its slack w at a point, data of its projections, and its size.

    The data are the locations of the projections, x = d z − w, ‖x_T‖, and x_N on the boundary; the size is the largest
    ‖R_k‖ / reference of each problem, and the Euclidean norm of these ratios.
    """

    R: Array
    w: Array
    case: Array
    x: Array
    tangent: Array
    axis: Array
    largest: Array
    norm: Array


class ConeStack:
    """Problems over cones with the same blocks.

    Parameters
    ----------
    pattern : Pattern
    *vectors : arrays
        q, shape (B, n), the slopes μ, shape (B, k), and the lower and upper bounds of the blocks of one row, shape
        (B, n) or (1, n).
    has_friction : bool
    arms : Arms, optional
        The bodies of one problem, if any.
    """

    def __init__(
        self, pattern: Pattern, *vectors: Array, has_friction: bool, arms: Any = None
    ) -> None:
        q, slope, lower, upper = vectors
        self.pattern, self.has_friction, self.arms = pattern, has_friction, arms
        self.q, self.mu = pattern.wide(q), slope
        self.d, self.B, self.k, self.m = pattern.d, pattern.B, pattern.k, pattern.m
        first = pattern.starts[:-1]
        self.low, self.high = lower[:, first], upper[:, first]
        self.origin = np.zeros_like(self.q)
        if has_friction:
            size = -self.q[..., 0] / self.d  # the largest is at least 0
            if pattern.has_rows:
                size = np.where(pattern.is_row, np.abs(size), size)
        else:
            self.origin = self.project(self.origin)
            w = self.slack(self.origin) if self.origin.any() else self.q
            size = length(self.residual(self.origin, w)[0])
        self.reference = pattern.largest(size)
        self.is_answered = self.reference == 0.0  # the origin is a solution
        self.weight = np.where(self.is_answered, 0.0, 1.0 / self.reference)

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
            sliding = length(w[..., 1:])
            sums = np.maximum(tangent + sliding, NORMAL)[..., None]
            above = above + mu * (at[..., 1:] * ((x[..., 1:] - w[..., 1:]) / sums)).sum(-1)
            v[..., 0] += mu * (sliding / self.d)
        else:
            above = above + mu * tangent
        axis = above / (1.0 + mu * mu)
        case = np.where(above <= 0.0, OUT, np.where(tangent <= mu * axis, WITHIN, ON))
        share = (mu * axis / self.d)[..., None]
        edge = z - share * (x / np.maximum(tangent, NORMAL)[..., None])
        edge[..., 0] = z[..., 0] - axis / self.d
        where = case[..., None]
        R = np.where(where == OUT, z, np.where(where == WITHIN, v, edge))
        if self.pattern.has_rows:
            step, at = v[..., 0], z[..., 0]
            below, over = at - self.high, at - self.low
            of_rows = clip(step, below, over)
            is_row = self.pattern.is_row
            R[..., 0] = np.where(is_row, of_rows, R[..., 0])
            is_free = (below < step) & (step < over)
            case = np.where(is_row, np.where(is_free, WITHIN, OUT), case)
        return R, case, x, tangent, axis

    def project(self, z: Array) -> Array:
        """Return the point of the cones nearest to z."""
        tangent, normal = length(z[..., 1:]), z[..., 0]
        on_axis = (normal + self.mu * tangent) / (1.0 + self.mu**2)
        projection = (self.mu * on_axis)[..., None] * (z / np.maximum(tangent, NORMAL)[..., None])
        projection[..., 0] = on_axis
        # So that the projection of a projection is the same
        is_inside = tangent <= self.mu * normal * (1.0 + 2.0**-50)
        projection = np.where(is_inside[..., None], z, projection)
        projection = np.where((on_axis <= 0.0)[..., None], 0.0, projection)
        if self.pattern.has_rows:
            clamped = clip(normal, self.low, self.high)
            projection[..., 0] = np.where(self.pattern.is_row, clamped, projection[..., 0])
        return projection

    def snap(self, z: Array) -> Array:
        """Return the nearest point of the cones; the origin in components that it solves."""
        z, answered = self.project(z), self.is_answered
        return np.where(answered[..., None], self.origin, z) if answered.any() else z

    def derivative(self, w: Array, *projection: Array) -> tuple[Array, Array]:
        """Return an element of the generalized derivative of R by z and by w of each block, (B, k, m, m)."""
        case, x, tangent, axis = projection
        mu, eye, tangents = self.mu, np.eye(self.m), np.diag(np.arange(self.m) > 0)
        away = x / np.maximum(tangent, NORMAL)[..., None]
        away[..., 0] = 0.0
        edge = mu[..., None] * away
        edge[..., 0] = 1.0
        across = tangents - away[..., :, None] * away[..., None, :]
        radius = (mu * (axis / np.maximum(tangent, NORMAL)))[..., None, None]
        P = edge[..., :, None] * edge[..., None, :] / (1.0 + mu * mu)[..., None, None]
        P += radius * across
        is_apex = (axis == 0.0) & (tangent == 0.0) & ~self.pattern.is_row  # belongs to all modes
        is_whole = ((case == WITHIN) | is_apex) & (mu > 0.0)
        if self.pattern.has_rows:
            is_whole |= self.pattern.is_row & (case == WITHIN)
        P[(case == OUT) & ~is_apex], P[is_whole] = 0.0, eye
        by_w = P / self.d[..., None, None]
        if self.has_friction:
            slide = mu[..., None] * w[..., 1:] / np.maximum(length(w[..., 1:]), NORMAL)[..., None]
            by_w[..., 1:] += by_w[..., :1] * slide[..., None, :]
        return eye - P, by_w

    def measure(self, z: Array) -> NaturalMap:
        """Return the natural map at z, the largest ‖R_k‖ / reference, and the norm of these ratios."""
        w = self.slack(z)
        R, case, x, tangent, axis = self.residual(z, w)
        sizes = length(R) * self.weight
        largest, norm = sizes.max(1, initial=0.0), np.sqrt((sizes * sizes).sum(1))
        return NaturalMap(R, w, case, x, tangent, axis, largest, norm)

    def relative_residual(self, z: Array) -> float:
        """Return the largest ‖R_k‖ / reference of one problem, without rounding errors."""
        return float(self.measure(z).largest[0])
