"""The likely mistake of a model without a solution, by name: a fact of M, or F′, at the last point."""

from __future__ import annotations

import re

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import Vector
from ..core.lcp import LCP
from ..core.names import Names, listed
from ..proofs.bounds import free_rows
from ..proofs.farkas import without_rounding

Numbers = NDArray[np.intp]
INDEX = re.compile(r"(\[[^\[\]]*\]|, entry .*)$")  # of a row of a constraint


def reversed_row(problem: LCP, *, is_linearized: bool = False) -> str:
    """Return the row, or the rows of one constraint, with the signs of their unknowns' columns, if only these; or "".

    Of a linear problem, also the row of the only negative diagonal entry.
    """
    M, names, negative = problem.matrix.csr, problem.names, np.flatnonzero(problem.diagonal < 0.0)
    if negative.size == 1 < problem.n and not is_linearized:
        return f"the sign of {names.pair(negative[0])[0]} may be wrong: only its diagonal entry is negative"
    products = sp.coo_array((M - sp.diags_array(M.diagonal())).multiply(M.T))
    is_equal = products.data > 0.0
    equal = np.bincount(products.row[is_equal], minlength=problem.n)
    alone = np.flatnonzero(2 * equal == is_equal.sum())[:1]
    for block in (alone, *_blocks(names, equal)):
        inside = np.zeros(problem.n, np.bool_)
        inside[block] = True
        crosses = inside[products.row] != inside[products.col]
        is_likely = np.array_equal(crosses, is_equal) and 2 < is_equal.sum() < products.nnz
        if is_likely and (block.size > 1 or M[block[0], block[0]] <= 0.0):
            break
    else:
        return ""
    if block.size > 1:
        name = INDEX.sub("", names.row(block[0]))
        return (
            f"the sign of {name} may be wrong, in all {block.size} rows: with the other sign they have, as all others, "
            "the opposite signs of the terms of their unknowns in other rows"
        )
    row, unknown = names.pair(block[0])
    return (
        f"the sign of {row} may be wrong: its terms have the signs of the terms of {unknown} in other rows, where all "
        "others have opposite signs"
    )


def _blocks(names: Names, equal: Numbers) -> list[Numbers]:
    """Return the rows of each constraint with several rows, at most 30, by their names without the index."""
    found: dict[str, list[int]] = {}
    for i in range(equal.size if equal.any() else 0):
        found.setdefault(INDEX.sub("", names.row(i)), []).append(i)
    blocks = [np.array(rows) for rows in found.values() if len(rows) > 1]
    return [rows for rows in blocks if equal[rows].all()][:30]  # constraints whose sign is tried


def likely_mistake(problem: LCP, z: Vector, w: Vector) -> str:
    """Return a row that its unknown cannot correct, a row of two units, or dependent rows: the first of them, or ""."""
    from scipy.sparse.csgraph import connected_components  # slow to import

    M, names = problem.matrix.csr, problem.names
    if wrong_sign := reversed_row(problem, is_linearized=True):
        return wrong_sign
    # w_i depends on z_i, also through other pairs, only if both are on a cycle of the pattern.
    component = connected_components(M, connection="strong")[1]
    is_apart = (np.bincount(component)[component] == 1) & (M.diagonal() == 0.0)
    is_wrong = np.where(w < 0.0, problem.upper == np.inf, problem.lower == -np.inf)
    wrong = np.abs(w) / problem.residual_scale * (is_apart & is_wrong)
    if wrong.max(initial=0.0) > 0.0:
        i = int(np.argmax(wrong))
        row, unknown = names.pair(i)
        return (
            f"{row} is {w[i]:.6g}, and {unknown} has no effect on it; see whether a term is missing"
        )
    inverse = abs(without_rounding(M))
    inverse.data = 1.0 / inverse.data
    ratio = problem.matrix.row_largest * inverse.max(axis=1).toarray().ravel()
    if ratio.max(initial=1.0) >= 1e12:  # two coefficients in different units
        i = int(np.argmax(ratio))
        return f"the coefficients of {names.row(i)} differ by a factor of {ratio[i]:.0e}; see its units"
    free = np.flatnonzero(free_rows(problem, z, w))
    if not 1 < free.size <= 400:  # singular vectors of larger matrices take more than .1 s
        return ""
    block = M[free][:, free].toarray()
    lengths = np.linalg.norm(block, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(block / np.where(lengths > 0.0, lengths, 1.0))
    part = np.abs(left[:, -1]) >= 0.1 * np.abs(left[:, -1]).max()  # rows with less are not named
    if values[-1] > 1e-6 * values[0] or part.sum() == 1:  # derivatives may be differences
        return ""
    return (
        f"the rows {listed(map(names.row, free[part]))} are dependent at this point; if they are everywhere, fix an "
        "unknown, as the price of a numeraire"
    )
