"""Elimination of the unknowns without a pair by the equations of a model, and the matching of the remaining ones.

Free unknowns that an equation defines, as in w == M @ x + q, are taken out of the model and put back. The equations
left are matched with the unknowns left: the diagonal that a splitting method divides by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.matrix import largest_in_rows

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

SMALLEST_PIVOT = 1e-8  # relative to the largest entry of its row
MOST_FILL = 4  # times the entries there were
MOST_DEFINITIONS = 500


@dataclass(eq=False)
class Elimination:
    """z = expansion · (unknowns left) + offset; every unknown, the defined ones included.

    Attributes
    ----------
    kept : ndarray of int
        The unknowns that are left.
    expansion : CSR array, shape (all unknowns, unknowns left), or None
        None if nothing is defined: all unknowns are left.
    offset : ndarray, shape (all unknowns,)
    rows, columns : ndarray of int
        Rows of the equations, and the unknown that each of them defined.
    """

    kept: NDArray[np.int64]
    expansion: sp.csr_array | None
    offset: FloatVector
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]

    def expand(self, z: FloatVector) -> FloatVector:
        """Return all unknowns."""
        return z if self.expansion is None else self.expansion @ z + self.offset

    def expand_change(self, dz: FloatVector) -> FloatVector:
        """Return the change of all unknowns."""
        return dz if self.expansion is None else self.expansion @ dz

    def expand_slack(self, w: FloatVector) -> FloatVector:
        """Return w with 0 for the unknowns that belong to an equation."""
        whole = np.zeros(self.offset.size)
        whole[self.kept] = w
        return whole


#: matrix · (all unknowns) + offset.
Affine = tuple[sp.csr_array, FloatVector]


def eliminate_definitions(
    equations: Affine, functions: Affine, owner: Indices, is_free: Mask, variable_of: Indices
) -> tuple[Elimination, Affine, Affine]:
    """Return the elimination of all unknowns that are only defined, the equations left and the functions.

    Parameters
    ----------
    equations, functions : pair of matrix and offset
        Rows that must be 0, and rows that belong to pairs, over all unknowns. The returned rows are over the remaining
        ones.
    owner : array of int
        The constraint that each equation is of.
    is_free : array of bool
        Unknowns that no pair holds and that have no bounds.
    variable_of : array of int
        The variable that each unknown is an entry of.

    Notes
    -----
    Constraints are treated one after the other. A row of a constraint defines a free unknown if its variable has only
    one entry in the row, and if other rows of the constraint do not contain the unknown. The unknown is substituted
    everywhere else, so that chains of definitions need no order. A definition remains an equation if its substitution
    would fill the matrices.
    """
    n = is_free.size
    back: sp.csr_array | None = None
    offset, is_open, left = np.zeros(n), is_free.copy(), np.ones(owner.size, dtype=bool)
    limit = MOST_FILL * (equations[0].nnz + functions[0].nnz) + 10 * n
    used: list[tuple[Indices, Indices]] = [(np.zeros(0, dtype=np.int64),) * 2]
    for number in range(min(int(owner.max(initial=-1)) + 1, MOST_DEFINITIONS)):
        rows, columns = _pivots(equations[0], np.flatnonzero(owner == number), is_open, variable_of)
        if not rows.size:
            continue
        substitution, shift = put_in(equations[0][rows], equations[1][rows], columns)
        changed = [
            (sp.csr_array(matrix @ substitution), constant + matrix @ shift)
            for matrix, constant in (equations, functions)
        ]
        if sum(matrix.nnz for matrix, _ in changed) > limit:
            continue
        equations, functions = changed
        offset = offset + (shift if back is None else back @ shift)
        back = substitution if back is None else sp.csr_array(back @ substitution)
        left[rows] = is_open[columns] = False
        used.append((rows, columns))
    defining, defined = (np.concatenate(part) for part in zip(*used, strict=True))
    kept = np.delete(np.arange(n), defined)
    if back is None:
        return Elimination(kept, None, offset, defining, defined), equations, functions
    return (
        Elimination(kept, sp.csr_array(back[:, kept]), offset, defining, defined),
        (sp.csr_array(equations[0][left][:, kept]), equations[1][left]),
        (sp.csr_array(functions[0][:, kept]), functions[1]),
    )


def put_in(
    matrix: sp.csr_array, offset: FloatVector, columns: Indices
) -> tuple[sp.csr_array, FloatVector]:
    """Return R and r of the substitution z ← R z + r that solves matrix · z + offset = 0 for the columns' unknowns.

    Parameters
    ----------
    matrix : CSR array, shape (k, n)
        Row i defines the unknown ``columns[i]``, and none of the others.
    offset : ndarray, shape (k,)
    columns : ndarray of int, shape (k,)
    """
    k, n = matrix.shape
    pivots = np.asarray(matrix[np.arange(k), columns]).ravel()
    keep, shift = np.ones(n), np.zeros(n)
    keep[columns], shift[columns] = 0.0, -offset / pivots
    definition = sp.diags_array(-1.0 / pivots) @ matrix @ sp.diags_array(keep)
    place = sp.csr_array((np.ones(k), (columns, np.arange(k))), shape=(n, k))
    substitution = sp.csr_array(sp.diags_array(keep) + place @ definition)
    substitution.eliminate_zeros()
    return substitution, shift


def put_in_all(
    matrix: sp.csr_array, offset: FloatVector, definitions: Indices, columns: Indices
) -> tuple[sp.csr_array, FloatVector]:
    """Return rows matrix · z + offset without the unknowns in the columns; the rows `definitions` = 0 define them.

    Definitions may depend on each other in any order without cycles. A chain takes as many products of matrices as its
    length has binary digits.

    Parameters
    ----------
    matrix : CSR array
        All rows, the definitions among them, which become 0.
    offset : array
    definitions, columns : array of int, shape (k,)
        Rows, and the unknown that each defines.

    Notes
    -----
    With z_d = H z_d + g, H strictly triangular in some order, z_d = … (I + H⁴)(I + H²)(I + H) g.
    """
    own = sp.csr_array(matrix[definitions])
    scale = sp.diags_array(-1.0 / np.asarray(own[np.arange(columns.size), columns]).ravel())
    own, shift = sp.csr_array(scale @ own), scale @ offset[definitions]
    held = sp.csr_array(own[:, columns] + sp.eye_array(columns.size))
    held.eliminate_zeros()
    while held.nnz:
        own, shift, held = (
            sp.csr_array(own + held @ own),
            shift + held @ shift,
            sp.csr_array(held @ held),
        )
    substitution, added = put_in(own, shift, columns)
    return sp.csr_array(matrix @ substitution), offset + matrix @ added


def _pivots(
    equations: sp.csr_array, rows: Indices, is_open: Mask, variable_of: Indices
) -> tuple[Indices, Indices]:
    """Return rows of one constraint and the unknown that each defines, of the variable with most unknowns."""
    part = sp.csr_array(equations[rows])
    part.eliminate_zeros()
    place = np.repeat(np.arange(rows.size), np.diff(part.indptr))
    largest = largest_in_rows(part)
    variables = variable_of[part.indices]
    _, pair, count = np.unique(
        place * (variable_of.max() + 1) + variables, return_inverse=True, return_counts=True
    )
    times = np.bincount(part.indices, minlength=is_open.size)
    fits = (
        is_open[part.indices]
        & (times[part.indices] == 1)
        & (np.abs(part.data) >= SMALLEST_PIVOT * largest[place])
    )
    fits &= count[pair] == 1
    if not fits.any():
        return rows[:0], rows[:0]
    counts = np.bincount(variables[fits])
    fits &= variables == np.argmax(counts)
    return rows[place[fits]], part.indices[fits].astype(np.int64)


def matching(block: sp.csr_array) -> Indices:
    """Return for each equation the unknown it goes with: large entries on the diagonal where that is possible."""
    from scipy.sparse.csgraph import maximum_bipartite_matching, min_weight_full_bipartite_matching

    size = block.shape[0]
    rows = np.repeat(np.arange(size), np.diff(block.indptr))
    magnitude, largest = np.abs(block.data), largest_in_rows(block)
    # Costs must be positive; a hint of the distance from the diagonal settles ties in natural order.
    cost = 1.0 + np.log(largest[rows] / magnitude) + 1e-9 * np.abs(rows - block.indices)
    index, pointer = block.indices.astype(np.int32), block.indptr.astype(np.int32)
    pattern = sp.csr_matrix((cost, index, pointer), shape=block.shape)
    try:
        return np.asarray(min_weight_full_bipartite_matching(pattern)[1], dtype=np.int64)
    except ValueError:  # no full matching: the diagonal will have gaps
        matched = np.asarray(
            maximum_bipartite_matching(pattern, perm_type="column"), dtype=np.int64
        )
        missing = np.flatnonzero(matched < 0)
        matched[missing] = np.setdiff1d(np.arange(size), matched[matched >= 0])
        return matched


def matched_for_monotony(
    equations: sp.csr_array, pairs: sp.csr_array, paired: Indices, free: Indices
) -> tuple[Indices, FloatVector]:
    """Return for each equation the place in `free` of the unknown it goes with, and the sign of its row.

    Parameters
    ----------
    equations, pairs : CSR array
        Over all unknowns; the rows of pairs with their signs.
    paired, free : array of int
        The unknown of each row of pairs, and those that are left for the equations.

    Notes
    -----
    Each equation is matched by a large entry, which becomes a diagonal entry. The sign of a row makes its diagonal
    entry positive; if this entry is zero, the row must be minus the column, because the matrix of optimality
    conditions is skew.
    """
    order = matching(sp.csr_array(equations[:, free]))
    rows = np.arange(order.size)
    signs = np.sign(np.asarray(equations[rows, free[order]]).ravel()) if order.size else np.zeros(0)
    column = free[order]
    # If the diagonal is zero, the row must be minus the column.
    across = _row_dots(sp.csr_array(equations[:, paired]), sp.csr_array(pairs[:, column].T))
    signs = np.where(signs == 0.0, -np.sign(across), signs)
    block = sp.csr_array(equations[:, column])
    across = _row_dots(block, sp.csr_array(sp.diags_array(signs) @ block).T.tocsr())
    signs = np.where(signs == 0.0, -np.sign(across), signs)
    return order, np.where(signs == 0.0, 1.0, signs)


def _row_dots(first: sp.csr_array, second: sp.csr_array) -> FloatVector:
    """Return the dot products of the rows of two matrices."""
    return np.asarray(first.multiply(second).sum(axis=1), dtype=np.float64).ravel()
