"""The row scaling of scaling="auto": as large as is quick, and small enough to be a theorem.

NP with S = θ_i/d_i, α > 0 and the coupling g = β/α in [0, 2] converges where, for some v > 0 with ⟨M⟩v > 0,

    θ_i ≤ 2   and   g θ_i ℓ_i < 1,      ℓ_i = (|L|v)_i/(d_i v_i) with L what the sweep has already updated

(θ_i ≤ 1 needs g ≤ 1 and nothing else). Where all rows are dominant, d_i ≥ Σ|m_ij|, v may be taken as near to 1 as one
likes: with ⟨M⟩y > 0 also ⟨M⟩(1 + εy) > 0. There one pass over M decides, and θ balances the two parts of the answer.
On z* > 0 an iteration contracts by about 1 − 2θ(1 − ℓ − u)/p, on w* > 0 by 1 − 2/p, p = θ/α + θ + 2: equal for
θ = 1/(1 − ℓ − u). On the gallery larger θ than 2 lost again where the rows are far from equal.
"""

from __future__ import annotations

import numpy as np

from ...checks import FloatVector
from ...matrix.matrix import Matrix, fact
from ...matrix.row_sums import has_positive_diagonal, inverse_residual_scale, row_blocks, unit_triangle_sums
from ...problem.lcp import LCP

LARGEST = 2.0
COUPLED = 0.9  # g θ ℓ stays this far below 1
ROUNDING = 1e-13  # rows whose entries were rounded miss d_i = Σ|m_ij| by this share


@fact
def automatic_factors(matrix: Matrix, coupling: float, sweep: str) -> FloatVector:
    """Return θ, shape (n,): 1 where a row is not dominant in M, else up to 2; one pass over M, kept with M.

    Parameters
    ----------
    matrix : Matrix
    coupling : float
        g = β/α.
    sweep : str
        "forward", "backward" or "symmetric".
    """
    lower, upper = unit_triangle_sums(matrix)
    updated = lower if sweep == "forward" else upper if sweep == "backward" else np.maximum(lower, upper)
    return balanced_factors(matrix, abs(coupling), updated, (lower, upper))


def balanced_factors(
    matrix: Matrix, coupling: float, updated: FloatVector, sums: tuple[FloatVector, FloatVector]
) -> FloatVector:
    """Return θ, read-only, shape (n,), from g, the sums ℓ that it couples to, and (ℓ, u) of v = 1."""
    factors = np.empty(matrix.own)
    is_dominant = matrix.residual_scale is matrix.diagonal or np.array_equal(matrix.residual_scale, matrix.diagonal)
    for rows in row_blocks(matrix.own):
        total = sums[0][rows] + sums[1][rows]
        is_dominant = is_dominant and bool(total.max() <= 1.0 + ROUNDING)  # False where it is not a number
        if not is_dominant:
            break
        with np.errstate(divide="ignore", over="ignore"):
            quick = np.minimum(LARGEST, 1.0 / np.maximum(1.0 - total, 0.0))
            np.minimum(quick, COUPLED / (coupling * updated[rows]), out=factors[rows])
    if not matrix.peers.everywhere(is_dominant):
        factors.fill(1.0)
    factors.flags.writeable = False
    return factors


def scaled_rows(problem: LCP, factors: FloatVector | float) -> FloatVector:
    """Return the diagonal of S, shape (n,): θ_i/m_ii, or θ_i over the scale of the residual if m_ii is no use; finite.

    A diagonal that is small beside its row is of use: so it is in an H₊-matrix whose columns differ in unit.
    """
    inverse = inverse_residual_scale(problem.matrix)
    with np.errstate(over="ignore", divide="ignore"):
        if problem.residual_scale is not problem.diagonal:
            inverse = np.where(has_positive_diagonal(problem.matrix), 1.0 / problem.diagonal, inverse)
        return np.minimum(factors * inverse, np.finfo(np.float64).max)
