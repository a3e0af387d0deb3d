r"""Row and column scaling of M, where its entries show that it is badly scaled: exact powers of two, from M alone.

M̂ = R M C, R = diag(2^row), C = diag(2^column). An entry far larger than the diagonal entry of its row is evidence of a
unit; a small one is a weak coupling or a flow, and |m_ij| / |m_ji| may be a unit or a flow: M alone cannot tell. So a
connected component of M is not scaled where

- the largest entries of all its rows and columns lie within 2¹⁰ of each other, zeros on the diagonal or not; or
- no entry exceeds 2⁴ times the diagonal entry of its row, however different these are: dominant rows, grids with jumps,
  convection, option prices; or
- what follows would change its unknowns by less than 2⁸ beside each other: the units of rows change no residual.

Else those c are looked for, integers, with

    |m_ij| 2^(c_j − c_i) ≤ 2^τ |m_ii|,  τ = 4, or 6, 8, 10 where there are none.

Shortest paths give the greatest of them ≤ 0 and the least ≥ 0. With units u of the unknowns c + u is the largest
function below u, or the smallest above u, that changes by at most τ an entry in the wrong direction. Both are held by u
itself, so that they cannot drift along a flow, as what balances |m_ij| against |m_ji| does. From their middle a few
sweeps of balancing (least squares of the logarithms) go at most 4 beyond them. Where |M| is symmetric as it is given,
nothing flows, and c = d^(−1/2), the best conditioned scaling of a positive definite M up to the factor n (van der
Sluis). Where the diagonal has zeros or nothing but noise, rows and columns are fitted together over all entries
(Curtis, Reid).

M̂ leaves one number open for each connected component of the graph of rows and columns: one a component of M, or
several where the diagonal has zeros, as those of a game and of a linear program have two.

References
----------
Curtis, Reid, On the automatic scaling of matrices for Gaussian elimination, J. Inst. Math. Appl. 10 (1972),
doi:10.1093/imamat/10.1.118. van der Sluis, Condition numbers and equilibration of matrices, Numer. Math. 14 (1969),
doi:10.1007/BF02165096.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector, read_only
from .matrix import Matrix, fact, largest_in_rows
from .structure import IntVector, connected_components, row_numbers

SPREAD = 10  # log2 of what entries in one unit differ by
ALIKE = 8  # log2 of what unknowns in one unit differ by
BESIDE_DIAGONAL = 4  # log2 of what an entry in one unit may exceed the diagonal entry of its row by
WIDER = (
    BESIDE_DIAGONAL,
    6,
    8,
    10,
)  # where units would have to fall for ever around a cycle of large entries
BALANCED_BEYOND, BALANCING_SWEEPS = (
    4.0,
    8,
)  # log2, of the bounds; more sweeps would carry balance along a flow
SYMMETRIC_WITHIN = 16  # log2: how far rows may leave the diagonal's units to make |M̂| symmetric
NOISE = -30.0  # log2: smaller entries of M̂ distort the fit
ROUNDED = 2.0**-20  # log2: what a symmetric matrix may have lost in rounding
LARGEST_UNIT = 300  # log2
FITTED, MOST_STEPS = (
    1e-6,
    300,
)  # what is left of a fit beside its right-hand side; steps of conjugate gradients
LARGEST_OFF = (
    2.0**SPREAD
)  # beside a diagonal of 1; where an entry is larger, the diagonal is none to go by


Fit = tuple[Any, Any]
"""Integers and what is to be added to them."""


class Exponents(NamedTuple):
    """The scaled matrix has entries m_ij 2^(row_i + column_j); an exponent a row and one a column."""

    row: IntVector
    column: IntVector


class Scaling(NamedTuple):
    """Row and column scaling by powers of two, and the scaled matrix.

    Attributes
    ----------
    row, column : array of int, shape (n,)
        w_i is measured in 2^−row, z_j in 2^column; 0 in components that need no scaling.
    of_row, of_column : array of int, shape (n,)
        The connected component of the graph of rows and columns: M̂ stays where 2^k multiplies a component's rows and
        divides its columns.
    matrix : Matrix
        M̂, which needs no scaling.
    scale : array, shape (n,)
        d̂_i / 2^(row_i + column_i), d̂ the residual scale of M̂: what the caller's w_i is divided by.
    """

    row: IntVector
    column: IntVector
    of_row: IntVector
    of_column: IntVector
    matrix: Matrix
    scale: FloatVector


@fact
def scaling_of(matrix: Matrix) -> Scaling | None:
    """Return the scaling that M shows a need of; None where it needs none.

    Examples
    --------
    >>> columns = np.array([1.0, 2.0**30, 2.0**-30])
    >>> scaling_of(Matrix(np.array([[4, 1, 2], [1, 4, 1], [-2, 1, 4]]) / columns)).column.tolist()
    [0, 30, -30]
    """
    pivots = np.abs(matrix.diagonal)
    is_led_by_diagonal = pivots.min(initial=np.inf) >= matrix.largest * 2.0**-SPREAD
    if is_led_by_diagonal or (matrix.is_dense and are_well_scaled(matrix.array[np.newaxis])[0]):
        return None
    several = connected_components(matrix)
    labels = np.zeros(matrix.n, np.int64) if several is None else several.labels
    if (
        several is None
        and matrix.is_dense
        and (found := _of_symmetric(matrix.array, matrix.diagonal)) is not None
    ):
        return _scaling(matrix, labels, *found)  # as below, for a tenth of the price
    M = matrix.csr
    badly_scaled = _badly_scaled_components(M, labels, pivots)
    if not badly_scaled.any():
        return None
    row, column = np.zeros((2, matrix.n), np.int64)
    some = np.flatnonzero(badly_scaled[labels])
    row[some], column[some] = _balanced(
        M[some][:, some] if some.size < matrix.n else M, labels[some]
    )
    return _scaling(matrix, labels, row, column)


def are_well_scaled(matrices: Any) -> BoolVector:
    """Return which dense matrices, shape (k, n, n), need no scaling as a whole: shape (k,)."""
    sizes, pivots = np.abs(matrices), np.abs(np.diagonal(matrices, axis1=1, axis2=2))
    most = sizes.max(axis=(1, 2), initial=0.0) * 2.0**-SPREAD
    are: BoolVector = most <= pivots.min(axis=1, initial=np.inf)
    rest = np.flatnonzero(~are)
    if rest.size:
        left = sizes[rest] if rest.size < are.size else sizes
        rows, columns = left.max(axis=2), left.max(axis=1)
        shows_none = (rows * 2.0**-BESIDE_DIAGONAL <= pivots[rest]).all(axis=1)
        sides = np.concatenate([rows, columns], axis=1)
        are[rest] = shows_none | (
            most[rest] <= sides.min(axis=1, initial=np.inf, where=sides > 0.0)
        )
    return are


def _of_symmetric(M: FloatVector, diagonal: FloatVector) -> Exponents | None:
    """Return the exponents of a dense M of symmetric sizes with a positive diagonal, d^(−1/2); None of another one."""
    sizes = np.abs(M)
    if not diagonal.min() > 0.0 or not np.array_equal(sizes, sizes.T):
        return None
    total = 1 - np.frexp(diagonal)[1].astype(np.int64)
    ratio = total[0] % 2
    column = (total - ratio) // 2
    found = Exponents(column + ratio, column)
    return found if np.abs(scaled(M, found)).max() <= LARGEST_OFF else None


def _scaling(
    matrix: Matrix, labels: IntVector, row: IntVector, column: IntVector
) -> Scaling | None:
    """Return the scaling by these exponents, centred, but 0 in components whose unknowns they leave alike.

    None where all are alike, and where an entry or what w is divided by is beyond the range of doubles.
    """
    of_row, of_column = (
        (labels, labels) if matrix.diagonal.all() else _components_of_both(matrix.csr)
    )
    most, least = (_extremes(column, labels, side) for side in (np.maximum, np.minimum))
    middle, are_alike = ((most + least) // 2)[labels], most - least <= ALIKE
    np.logical_and.at(
        are_alike, labels, of_row == of_column
    )  # what M leaves open between components may be anything
    is_alike = are_alike[labels]
    if is_alike.all():
        return None
    row, column = (np.where(is_alike, 0, side) for side in (row + middle, column - middle))
    M = scaled(matrix.array, Exponents(row, column))
    if not np.isfinite(M.data if sp.issparse(M) else M).all():
        return None
    balanced = Matrix(M)
    scaling_of.keep(balanced, None)
    scale = times_power(balanced.residual_scale, -(row + column))
    if not is_representable(scale):
        return None
    row, column, of_row, of_column = (read_only(side) for side in (row, column, of_row, of_column))
    return Scaling(row, column, of_row, of_column, balanced, read_only(scale))


def is_representable(scale: FloatVector) -> bool:
    """Return whether all scales are normal numbers: beside 0 or ∞ no w would count, or none but 0."""
    return bool(((scale >= np.finfo(float).tiny) & (scale <= np.finfo(float).max)).all())


def _badly_scaled_components(M: sp.csr_array, labels: IntVector, pivots: FloatVector) -> BoolVector:
    """Return which components, shape (components,), have entries of several sizes, some far beyond their diagonal."""
    rows, columns = largest_in_rows(M), largest_in_rows(sp.csr_array(M.T))
    most, least = np.zeros(labels.max() + 1), np.full(labels.max() + 1, np.inf)
    for side in (rows, columns):
        np.maximum.at(most, labels, side)
        np.minimum.at(least, labels, np.where(side > 0.0, side, np.inf))
    is_badly_scaled = np.zeros(most.size, np.bool_)
    np.logical_or.at(is_badly_scaled, labels, rows * 2.0**-BESIDE_DIAGONAL > pivots)
    return (most * 2.0**-SPREAD > least) & is_badly_scaled


def _balanced(M: sp.csr_array, labels: IntVector) -> Exponents:
    """Return the exponents of M, the square block of some components, up to one number a component."""
    count, pivots = int(labels.max()) + 1, np.abs(M.diagonal())
    ratio, is_symmetric = _symmetrising(M, labels)
    column, is_served = _between_paths(M, labels, pivots)
    of_diagonal = 1 - np.frexp(np.where(pivots > 0.0, pivots, 1.0))[1].astype(np.int64)
    # Where |M| is symmetric as it is given, d^(−1/2); an odd exponent of the first row is its rows' alone.
    is_given = _all_of_components(is_symmetric & (ratio == 0) & (pivots > 0.0), labels, count)
    odd = np.zeros(count, np.int64)
    roots = np.unique(labels, return_index=True)
    odd[roots[0]] = of_diagonal[roots[1]] % 2
    half = (of_diagonal - odd[labels]) // 2
    given = Exponents(half + odd[labels], half)
    is_given &= _all_of_components(largest_in_rows(scaled(M, given)) <= LARGEST_OFF, labels, count)
    row = of_diagonal - column
    apart = column + ratio - row
    most, least = (_extremes(apart, labels, side) for side in (np.maximum, np.minimum))
    near = _all_of_components(is_symmetric, labels, count) & (most - least <= 2 * SYMMETRIC_WITHIN)
    row = np.where(near[labels], column + ratio - ((most + least) // 2)[labels], row)
    row, column = (
        np.where(is_given[labels], one, two) for one, two in zip(given, (row, column), strict=True)
    )
    is_found = (is_served | is_given)[labels]
    if is_found.all():
        return Exponents(row, column)
    other = _together(M, labels, ratio, is_symmetric)
    return Exponents(
        *(np.where(is_found, one, two) for one, two in zip((row, column), other, strict=True))
    )


def _all_of_components(claim: BoolVector, labels: IntVector, count: int) -> BoolVector:
    """Return of which components all rows are so, shape (components,)."""
    are = np.ones(count, np.bool_)
    np.logical_and.at(are, labels, claim)
    return are


def _between_paths(
    M: sp.csr_array, labels: IntVector, pivots: FloatVector
) -> tuple[IntVector, BoolVector]:
    """Return c of the module's head, and which components have one, shape (components,)."""
    from ..kernels import scaling

    n, count, rows = M.shape[0], int(labels.max()) + 1, row_numbers(M)
    serves = _all_of_components(pivots > 0.0, labels, count)
    is_entry = (rows != M.indices) & (M.data != 0.0) & serves[labels[rows]]
    pattern = sp.csr_array((M.data[is_entry], (rows[is_entry], M.indices[is_entry])), shape=(n, n))
    pattern.sort_indices()
    of_pivot, pivot = np.frexp(np.where(pivots > 0.0, pivots, 1.0))
    of_entry, entry = np.frexp(np.abs(pattern.data))
    here = row_numbers(pattern)
    whole = (entry - pivot[here]).astype(np.int64)
    sizes = (
        whole + np.log2(of_entry) - np.log2(of_pivot)[here]
    )  # log₂ |m_ij| / |m_ii|, and rounded up
    pattern.data = whole + (of_entry > of_pivot[here]).astype(np.float64)
    mirror = sp.csr_array(pattern.T)
    below, above = np.zeros((2, n), np.int64)
    work, is_open = (np.empty(n, np.int64), np.empty(n, np.bool_)), serves.copy()
    for beside in WIDER:
        if not is_open.any():
            break
        ends, is_cut = np.zeros((2, n), np.int64), ~is_open
        for graph, distance in zip((pattern, mirror), ends, strict=True):
            lengths = beside - graph.data.astype(np.int64)
            scaling.shortest(graph.indptr, graph.indices, lengths, labels, is_cut, distance, *work)
        is_found = (is_open & ~is_cut)[labels]
        below, above = np.where(is_found, ends[0], below), np.where(is_found, -ends[1], above)
        is_open &= is_cut
    position = 0.5 * (below + above)
    pattern.data = sizes
    mirror = sp.csr_array(pattern.T)
    arrays = [
        array for graph in (pattern, mirror) for array in (graph.indptr, graph.indices, graph.data)
    ]
    scaling.balance_within(
        *arrays, below - BALANCED_BEYOND, above + BALANCED_BEYOND, position, BALANCING_SWEEPS
    )
    return np.rint(position).astype(np.int64), serves & ~is_open


def _together(
    M: sp.csr_array, labels: IntVector, ratio: IntVector, is_symmetric: BoolVector
) -> Exponents:
    """Return the exponents of rows and columns fitted together, |M̂| symmetric where some D₁ M D₂ is."""
    whole, part = map(np.stack, _fitted_together(M.data, row_numbers(M), M.indices, M.shape))
    row, column = whole + np.rint(part).astype(np.int64)
    # Rows beside columns by this ratio, so that |M̂| is symmetric; what M̂ leaves open decides between t and t + 1.
    total = whole[0] + whole[1] - ratio
    roots = np.unique(labels, return_index=True)
    first = np.zeros(labels.max() + 1, np.int64)
    first[roots[0]] = total[roots[1]] % 2
    ratio, total = ratio + first[labels], total - first[labels]
    middle = total // 2 + np.rint(0.5 * (total % 2 + (part[0] + part[1]))).astype(np.int64)
    return Exponents(
        np.where(is_symmetric, middle + ratio, row), np.where(is_symmetric, middle, column)
    )


def _symmetrising(M: sp.csr_array, labels: IntVector) -> tuple[IntVector, BoolVector]:
    """Return t with 2^t_i |m_ij| = 2^t_j |m_ji|, but for rounding, and the rows of components that have such a t."""
    n, mirror = M.shape[0], sp.csr_array(M.T)
    mirror.sort_indices()
    has_mirror = np.array_equal(M.indptr, mirror.indptr) and np.array_equal(
        M.indices, mirror.indices
    )
    if not has_mirror:
        return np.zeros(n, np.int64), np.zeros(n, np.bool_)
    if np.array_equal(
        np.abs(M.data), np.abs(mirror.data)
    ):  # most are so: t = 0, without a look at the graph
        return np.zeros(n, np.int64), np.ones(n, np.bool_)
    rows, columns = row_numbers(M), M.indices.astype(np.int64)
    here, there = np.frexp(np.abs(M.data)), np.frexp(np.abs(mirror.data))
    difference = np.log2(there[0]) - np.log2(here[0])
    whole = (there[1] - here[1]).astype(np.int64) + np.rint(difference).astype(np.int64)
    ratio = _potentials(whole, rows, columns, n)
    fits = (whole + ratio[columns] == ratio[rows]) & (
        np.abs(difference - np.rint(difference)) <= ROUNDED
    )
    are = np.ones(labels.max() + 1, np.bool_)
    np.logical_and.at(are, labels[rows], fits)
    return ratio, are[labels]


def fitted_units(M: sp.csr_array, right: FloatVector) -> FloatVector:
    """Return units of x, powers of two, in which entries of M and of the right-hand side are of like sizes, shape (n,).

    Powers of two that multiply columns are found again; rows may be in any unit.

    Examples
    --------
    >>> fitted_units(sp.csr_array([[1.0, 1024.0], [8.0, 8192.0]]), np.array([4.0, 32.0])).tolist()
    [4.0, 0.00390625]
    """
    m, n = M.shape
    data = np.append(M.data, np.where(np.isfinite(right), right, 0.0))
    rows, columns = np.append(row_numbers(M), np.arange(m)), np.append(M.indices, np.full(m, n))
    whole, part = _fitted_together(data, rows, columns, (m, n + 1))
    exponents = whole[1] + np.rint(part[1]).astype(np.int64)
    return np.asarray(
        np.ldexp(1.0, np.clip(exponents[:-1] - exponents[-1], -LARGEST_UNIT, LARGEST_UNIT))
    )


def _fitted_together(
    data: FloatVector, rows: IntVector, columns: IntVector, shape: tuple[int, int]
) -> tuple[Any, Any]:
    """Return the exponents of rows and of columns that make all entries even."""
    m, kept = shape[0], data != 0.0
    mantissas, exponents = np.frexp(np.abs(data[kept]))
    tails, heads = rows[kept].astype(np.int64), columns[kept].astype(np.int64) + m
    whole, part = _fit(exponents.astype(np.int64), np.log2(mantissas), tails, heads, sum(shape))
    return (-whole[:m], whole[m:]), (-part[:m], part[m:])


def _fit(
    whole: IntVector, part: FloatVector, tails: IntVector, heads: IntVector, nodes: int
) -> Fit:
    """Return s, integers and the rest of it, for which whole_k + part_k + s_head − s_tail is about 0: least squares.

    Potentials that make `whole` vanish along a spanning forest come first: whatever powers of two multiplied rows and
    columns, the rest is the same. A second fit leaves out what the first has shown to be noise.
    """
    start = _potentials(whole, tails, heads, nodes)
    rest = (whole + start[heads] - start[tails]) + part
    found = fitted(rest, tails, heads, nodes)
    size = rest + found[heads] - found[tails]
    if (size < NOISE).any():
        kept = size >= NOISE
        found = fitted(rest[kept], tails[kept], heads[kept], nodes)
    return start, found


def _potentials(whole: Any, tails: IntVector, heads: IntVector, nodes: int) -> Any:
    """Return p with whole_k + p_head − p_tail = 0 along a breadth first forest, 0 at its roots."""
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    graph = _graph(tails, heads, nodes)
    roots = np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]
    origin = np.full(roots.size, nodes)  # one node more, which all roots hang on
    tied = _graph(np.append(tails, origin), np.append(heads, roots), nodes + 1)
    before = breadth_first_order(tied, nodes, directed=False)[1][:nodes]
    step = np.zeros(nodes + 1, whole.dtype)
    parents, children = np.append(tails, heads), np.append(heads, tails)
    is_tree = np.flatnonzero(before[children] == parents)[
        ::-1
    ]  # of two entries between a pair the first counts
    step[children[is_tree]] = np.append(-whole, whole)[is_tree]
    parent, potential = np.append(np.where(before < 0, nodes, before), nodes), step
    while (parent != nodes).any():  # each jump doubles how far back a node has looked
        potential = potential + potential[parent]
        parent = parent[parent]
    return potential[:nodes]


def _components_of_both(M: sp.csr_array) -> tuple[IntVector, IntVector]:
    """Return the components of the graph of rows and columns, of each row and of each column."""
    from scipy.sparse.csgraph import connected_components

    n = M.shape[0]
    graph = _graph(row_numbers(M), M.indices.astype(np.int64) + n, 2 * n)
    labels = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels[:n], labels[n:]


def _graph(tails: IntVector, heads: IntVector, nodes: int) -> sp.csr_array:
    return sp.csr_array((np.ones(tails.size, np.int8), (tails, heads)), shape=(nodes, nodes))


def _extremes(values: IntVector, places: IntVector, of: Any) -> IntVector:
    found = np.full(
        int(places.max()) + 1,
        np.iinfo(np.int64).min if of is np.maximum else np.iinfo(np.int64).max,
    )
    of.at(found, places, values)
    return found


def scaled(M: Any, exponents: Exponents | None) -> Any:
    """Return the array or CSR array with entries m_ij 2^(row_i + column_j)."""
    if exponents is None:
        return M
    row, column = (side.astype(np.int32) for side in exponents)
    if not sp.issparse(M):
        return times_power(M, row[:, None] + column)
    data = times_power(M.data, row[row_numbers(M)] + column[M.indices])
    return sp.csr_array((data, M.indices, M.indptr), shape=M.shape)


def times_power(x: FloatVector, exponent: IntVector | None) -> FloatVector:
    """Return x_i 2^exponent_i, of the shape of x."""
    with np.errstate(under="ignore", over="ignore"):
        return x if exponent is None else np.asarray(np.ldexp(x, exponent))


def fitted(ratios: FloatVector, rows: IntVector, columns: IntVector, n: int) -> FloatVector:
    """Return s, shape (n,), for which ratio_k + s_column − s_row is about 0 in the least squares sense.

    By conjugate gradients, preconditioned with the diagonal, on the Laplacian of the graph of all k.
    """
    right: Any = np.bincount(rows, ratios, n) - np.bincount(columns, ratios, n)
    degree: Any = np.bincount(rows, minlength=n) + np.bincount(columns, minlength=n)
    weights, found = np.where(degree > 0, degree, 1).astype(np.float64), np.zeros(n)
    ends = np.concatenate([rows, columns]), np.concatenate([columns, rows])
    edges = sp.csr_array((np.ones(2 * rows.size), ends), shape=(n, n))
    residual, direction, before = right, np.zeros(n), 1.0
    least = FITTED * float(np.sqrt(right.dot(right)))
    for _ in range(MOST_STEPS):
        if np.sqrt(residual.dot(residual)) <= least:
            break
        ahead = residual / weights
        slope = float(residual.dot(ahead))
        direction = ahead + (slope / before) * direction
        image = degree * direction - edges @ direction
        length, before = slope / float(direction.dot(image)), slope
        found = found + length * direction
        residual = residual - length * image
    return found
