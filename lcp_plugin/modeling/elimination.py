"""Free unknowns that an equation defines, as in w == M @ x + q, taken out of a model and put back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..conversions.substitution import put_in

Indices = NDArray[np.int64]

SMALLEST_PIVOT = 1e-8  # relative to the largest entry of its row
MOST_FILL = 4  # times the entries there were
MOST_DEFINITIONS = 500


@dataclass(eq=False)
class Affine:
    """Rows matrix · (all unknowns) + offset; `owner` says which constraint each row comes from."""

    matrix: sp.csr_array
    offset: FloatVector
    owner: Indices

    def rows(self, selected: NDArray[Any]) -> Affine:
        """Return some of the rows."""
        return Affine(sp.csr_array(self.matrix[selected]), self.offset[selected], self.owner[selected])


@dataclass(eq=False)
class Elimination:
    """z = expansion · (unknowns left) + offset; every unknown, the defined ones included.

    Attributes
    ----------
    kept : ndarray of int
        The unknowns that are left.
    expansion : CSR array, shape (all unknowns, unknowns left)
    offset : ndarray, shape (all unknowns,)
    rows, columns : ndarray of int
        Rows of the equations, and the unknown that each of them defined.
    """

    kept: Indices
    expansion: sp.csr_array
    offset: FloatVector
    rows: Indices
    columns: Indices

    def expand(self, z: FloatVector) -> FloatVector:
        """Return all unknowns."""
        whole: FloatVector = self.expansion @ z + self.offset
        return whole

    def expand_slack(self, w: FloatVector) -> FloatVector:
        """Return w with 0 for the unknowns that belong to an equation."""
        whole = np.zeros(self.offset.size)
        whole[self.kept] = w
        return whole


def is_definition(block: Any) -> bool:
    """Return whether each row of a variable's block has one entry, in a column of its own."""
    is_single = bool((np.diff(block.indptr) == 1).all())
    return is_single and int(np.bincount(block.indices, minlength=1).max()) <= 1


def eliminate_definitions(
    equations: Affine, functions: Affine, is_free: NDArray[np.bool_], variable_of: Indices
) -> tuple[Elimination, Affine, Affine] | None:
    """Return the elimination, the equations left and the functions; None where nothing is defined.

    Parameters
    ----------
    equations, functions : Affine
        Rows that are to be 0, and rows that belong to pairs; over all unknowns. What returns is over those left.
    is_free : array of bool
        Unknowns that no pair holds and that have no bounds.
    variable_of : array of int
        The variable that each unknown is an entry of.

    Notes
    -----
    One constraint after the other: its rows in which one variable has a single entry, distinct free unknowns that its
    other rows do not hold, define these unknowns; they are put in everywhere else, so that chains of definitions need
    no order. A definition whose substitution would fill the matrices is left an equation.
    """
    n = is_free.size
    back, offset = sp.eye_array(n, format="csr"), np.zeros(n)
    is_open = is_free.copy()
    left = np.ones(equations.offset.size, dtype=bool)
    limit = MOST_FILL * (equations.matrix.nnz + functions.matrix.nnz) + 10 * n
    used: list[tuple[Indices, Indices]] = []
    for owner in range(min(int(equations.owner.max(initial=-1)) + 1, MOST_DEFINITIONS)):
        rows, columns = _pivots(equations, np.flatnonzero(equations.owner == owner), is_open, variable_of)
        if not rows.size:
            continue
        substitution, shift = put_in(equations.matrix[rows], equations.offset[rows], columns)
        changed = [_replaced(part, substitution, shift) for part in (equations, functions)]
        if sum(part.matrix.nnz for part in changed) > limit:
            continue
        equations, functions = changed
        offset = offset + back @ shift
        back = sp.csr_array(back @ substitution)
        left[rows] = is_open[columns] = False
        used.append((rows, columns))
    if not used:
        return None
    defining, defined = (np.concatenate(part) for part in zip(*used, strict=True))
    is_kept = np.ones(n, dtype=bool)
    is_kept[defined] = False
    kept = np.flatnonzero(is_kept).astype(np.int64)
    elimination = Elimination(kept, sp.csr_array(back[:, kept]), offset, defining, defined)
    narrowed = [Affine(sp.csr_array(part.matrix[:, kept]), part.offset, part.owner) for part in (equations, functions)]
    return elimination, narrowed[0].rows(np.flatnonzero(left)), narrowed[1]


def _pivots(
    equations: Affine, rows: Indices, is_open: NDArray[np.bool_], variable_of: Indices
) -> tuple[Indices, Indices]:
    """Return rows of one constraint and the unknown that each defines: those of the variable with most of them."""
    part = sp.csr_array(equations.matrix[rows])
    part.eliminate_zeros()
    place = np.repeat(np.arange(rows.size), np.diff(part.indptr))
    largest = np.zeros(rows.size)
    np.maximum.at(largest, place, np.abs(part.data))
    variables = variable_of[part.indices]
    _, pair, count = np.unique(place * (variable_of.max() + 1) + variables, return_inverse=True, return_counts=True)
    times = np.bincount(part.indices, minlength=is_open.size)
    fits = is_open[part.indices] & (times[part.indices] == 1) & (np.abs(part.data) >= SMALLEST_PIVOT * largest[place])
    fits &= count[pair] == 1
    if not fits.any():
        return rows[:0], rows[:0]
    counts = np.bincount(variables[fits])
    fits &= variables == np.argmax(counts)
    return rows[place[fits]], part.indices[fits].astype(np.int64)


def _replaced(part: Affine, substitution: sp.csr_array, shift: FloatVector) -> Affine:
    return Affine(sp.csr_array(part.matrix @ substitution), part.offset + part.matrix @ shift, part.owner)
