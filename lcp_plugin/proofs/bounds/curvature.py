"""Curvature of a quadratic form, bounded below: μ with P − diag(μ) proved semidefinite.

P falls into the blocks that its pattern connects. The weight of a block of one entry is this entry. A larger block is
definite by a factorization with a rounding margin, or semidefinite by its row sums or by exact elimination. Otherwise
it may be semidefinite to rounding: then its weights are negative, by a bound of the rounding error.

On the solutions of A x = b the objective is also f(x) + ½ ρ‖A x − b‖². If P + ρ AᵀA is positive definite, ρ > 0, its
weights may replace the weights of P, between points that satisfy the equations exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...core.matrix.matrix import Matrix
from ...core.rounding import gamma, lower_end
from ...systems.comparison_sums import comparison_product
from ...systems.definiteness import is_semidefinite_to_rounding, semidefinite_margin
from ..exact.linear_systems import exact_symmetric_part, has_nonnegative_pivots
from .solution_bounds import UNDERFLOW, smallest_eigenvalue_bound

EXACT_BLOCK = 40  # rows; exact elimination then takes a tenth of a second; at 60 six times as long
OUTWARD = 1.0 + 2.0**-40  # more than the rounding of a margin of a few operations
UNKNOWN = "P could not be shown to be positive semidefinite"


@dataclass(frozen=True, eq=False)
class Curvature:
    """Weights μ for which xᵀP x ≥ Σ μ_i x_i² holds for every x.

    Attributes
    ----------
    weights : ndarray, shape (n,)
        −∞ if nothing is known.
    indefinite : str
        Why P is certainly not positive semidefinite, or nothing.
    penalty : float
        ρ: the weights are a lower bound of xᵀP x + ρ‖A x‖² for every x.
    """

    weights: FloatVector
    indefinite: str = ""
    penalty: float = 0.0

    @property
    def is_semidefinite(self) -> bool:
        """True if P, or P on the null space of A, is proved to be positive semidefinite."""
        return bool((self.weights >= 0.0).all())

    @property
    def evidence(self) -> str:
        """Description of the result about P."""
        if self.is_semidefinite:
            where = " on the null space of A" if self.penalty else ""
            return f"P is positive {'definite' if (self.weights > 0.0).all() else 'semidefinite'}{where}"
        if np.isfinite(self.weights).all():
            return f"P is positive semidefinite only to rounding, λ_min ≥ {self.weights.min():.1e}"
        return self.indefinite or UNKNOWN


def curvature(P: Any) -> Curvature:
    """Return the largest weights that can be proved at the cost of two factorizations.

    Parameters
    ----------
    P : ndarray or CSR array, shape (n, n)
        Exactly symmetric.

    Examples
    --------
    >>> curvature(np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 3.0]])).weights.round(2)
    array([0.95, 0.95, 3.  ])
    >>> curvature(np.array([[1.0, 1.0], [1.0, 1.0]])).evidence
    'P is positive semidefinite'
    >>> curvature(np.array([[1.0, 2.0], [2.0, 1.0]])).evidence
    'P has a negative eigenvalue'
    """
    rows = sp.csr_array(P)
    weights = np.array(rows.diagonal())
    if (weights < 0.0).any():
        i = int(weights.argmin())
        return Curvature(np.full(weights.size, -np.inf), f"P[{i}, {i}] = {weights[i]:g}")
    count, label = connected_components(rows, directed=False)
    sizes = np.bincount(label, minlength=count)
    order = np.argsort(label, kind="stable")
    ends = np.cumsum(sizes)
    for k in np.flatnonzero(sizes > 1).tolist():
        block = np.sort(order[ends[k] - sizes[k] : ends[k]])
        found = (
            _weights(sp.csr_array(rows[block][:, block]))
            if not is_over()
            else np.full(block.size, -np.inf)
        )
        if found is None:
            return Curvature(np.full(weights.size, -np.inf), "P has a negative eigenvalue")
        weights[block] = found
    return Curvature(weights)


def constrained_curvature(P: Any, A: Any) -> Curvature:
    """Return the curvature of P, or of P + ρ AᵀA if only this matrix is definite.

    Parameters
    ----------
    P, A : arrays or CSR arrays, shapes (n, n) and (p, n)

    Examples
    --------
    >>> found = constrained_curvature(np.diag([0.0, 2.0]), np.array([[1.0, -1.0]]))
    >>> found.evidence, found.penalty
    ('P is positive definite on the null space of A', 2.0)
    """
    own, rows = curvature(P), sp.csr_array(A)
    if own.indefinite or (own.weights > 0.0).all() or not rows.nnz or is_over():
        return own
    if (
        np.count_nonzero(np.diff(sp.csr_array(P).indptr)) + rows.shape[0] < own.weights.size
    ):  # ranks add to less than n
        return own
    square = sp.csr_array(rows.T @ rows)
    bent, held = (
        float(np.max(matrix.diagonal(), initial=0.0)) for matrix in (sp.csr_array(P), square)
    )
    if held == 0.0 or bent / held == np.inf:  # the squares underflow
        return own
    penalty = float(np.exp2(np.round(np.log2(bent / held)))) if bent / held > 0.0 else 1.0
    form = sp.csr_array(P + penalty * square)
    form = sp.csr_array((form + form.T) * 0.5)
    if not np.isfinite(form.data).all():
        return own
    found = curvature(form)
    # An entry's rounding error is below γ (|P| + ρ|A|ᵀ|A|), and a matrix is below the diagonal matrix of its row sums.
    ones, magnitude = np.ones(own.weights.size), abs(rows)
    size = abs(sp.csr_array(P)) @ ones + penalty * (magnitude.T @ (magnitude @ ones))
    weights = found.weights - 2.0 * gamma(rows.shape[0] + 8) * size - UNDERFLOW * (1.0 + penalty)
    return Curvature(weights * (1.0 - 2.0**-50), penalty=penalty) if (weights > 0.0).all() else own


def _weights(P: sp.csr_array) -> FloatVector | None:
    """Return the weights of a block that does not fall apart; None if it is proved to be indefinite."""
    bound = smallest_eigenvalue_bound(Matrix(P))
    if bound is not None:
        return np.asarray(bound.value / bound.scale / bound.scale)
    dominance = lower_end(*comparison_product(P, np.ones(P.shape[0])))
    if (dominance >= 0.0).all():
        return dominance
    if P.shape[0] <= EXACT_BLOCK and has_nonnegative_pivots(exact_symmetric_part(P)):
        return np.zeros(P.shape[0])
    to_rounding = is_semidefinite_to_rounding(P)
    if to_rounding is not True:
        return None if to_rounding is False else np.full(P.shape[0], -np.inf)
    diagonal = np.array(P.diagonal())
    unit = sp.csr_array(sp.diags_array(np.where(diagonal > 0.0, 1.0, 0.0)))
    return np.asarray(-semidefinite_margin(unit) * OUTWARD * diagonal)
