r"""How far an x is from the optimal one, as its own residuals bound it: no root of a gap is taken.

A value that is optimal to g says ‖x − x*‖ ≤ √(2 g/μ) only: 10⁻⁸ at the best, where g is rounding. That is enough to
tell rows C_i x ≤ d_i that cannot be active at x*; their multipliers are 0 there. Let I be the others and equations, λ
any multipliers of I, not negative for inequalities, s = P x + c + C_Iᵀλ, δ = C_I x − d_I, e = x − x*. With the optimal
multipliers λ* and the slack C_I e = δ + (d_I − C_I x*)

    eᵀP e = sᵀe − (λ − λ*)ᵀC_I e ≤ sᵀe − (λ − λ*)ᵀδ,    C_Iᵀ(λ − λ*) = s − P e,

as λ_i (d_i − C_i x*) ≥ 0 and λ*_i (d_i − C_i x*) = 0. With σ > 0 the least singular value of C_I and the curvature
μ‖e‖² ≤ eᵀP e + ρ‖A e‖²,

    μ‖e‖² ≤ ‖s‖‖e‖ + (‖s‖ + ‖P‖‖e‖) ‖δ‖/σ + ρ‖δ_A‖²,

a bound in proportion to the residuals. Unknowns are measured in powers of two, so that μ ≥ 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...core.kernels.floats import EPSILON
from ...core.matrix.matrix import Matrix, largest_in_rows
from ...core.rounding import compensated_product, gamma
from ...proofs.bounds.solution_bounds import norm_above, smallest_eigenvalue_bound
from ...systems.factors import factor_fits, factorise
from .feasible_points import FeasiblePoint
from .program import QuadraticProgram

if TYPE_CHECKING:
    from ...proofs.bounds.curvature import Curvature

OUTWARD = 1.0 + 2.0**-30  # more than what rounds in some operations
LARGEST_SCALE = 400  # exponent, so that squares of scales are in range
CORRECTIONS = 2


@np.errstate(all="ignore")  # what overflows bounds nothing
def sharp_distance(
    program: QuadraticProgram,
    curvature: Curvature,
    x: FloatVector,
    points: Sequence[FeasiblePoint],
    lower: float,
    columns: Any = slice(None),
) -> float:
    """Return a bound of ‖x − x*‖₂ in these columns for the optimal x*; ∞ where nothing is proved.

    Parameters
    ----------
    program : QuadraticProgram
    curvature : Curvature
        Of P, or of P on the null space of A; it has to be definite.
    x : array, shape (n,)
    points : sequence of FeasiblePoint
    lower : float
        A proved lower bound of the optimal value.
    columns : indices

    Examples
    --------
    >>> from lcp_plugin.problems.programs.certification import ProgramProofs
    >>> proofs = ProgramProofs(QuadraticProgram([[2.0, 0.0], [0.0, 2.0]], [-2.0, -4.0], G=[[1.0, 1.0]], h=[2.0]))
    >>> x = np.array([0.5, 1.5])
    >>> sharp_distance(proofs.program, proofs.bounds.curvature, x, proofs.upper(x), proofs.own_lower) < 1e-15
    True
    """
    roots = np.sqrt(curvature.weights) * (1.0 - EPSILON)
    if lower == -math.inf or not points or not ((roots > 0.0) & (roots < math.inf)).all():
        return math.inf
    exponents = np.frexp(roots)[1] - 1
    if np.abs(exponents).max(initial=0) > LARGEST_SCALE:
        return math.inf
    unit = np.ldexp(1.0, exponents)  # of e: μ ≥ unit²
    rows = program.constraints
    is_fixed = program.lower == program.upper
    is_said = np.isfinite(rows.limit) & (np.diff(rows.matrix.indptr) > 0)
    is_said[-program.n :] &= ~is_fixed  # the other bound is the equation
    kept = np.flatnonzero(is_said)
    is_equality = rows.is_equality.copy()
    is_equality[-2 * program.n : -program.n] |= is_fixed
    matrix, is_equality = rows.matrix[kept], is_equality[kept]
    value, radius = compensated_product(matrix, x, -rows.limit[kept])
    scaled = sp.csr_array(matrix @ sp.diags_array(1.0 / unit))
    sizes = np.ldexp(1.0, np.frexp(largest_in_rows(scaled))[1])
    scaled = sp.csr_array(sp.diags_array(1.0 / sizes) @ scaled)  # entries of at most 1
    lengths = np.sqrt(_sums_of_squares(scaled)) * OUTWARD
    far = OUTWARD**2 * min(_far(x, point, lower, unit) for point in points)
    active = np.flatnonzero(is_equality | ~(value + radius + OUTWARD * lengths * sizes * far < 0.0))
    found = _bound(
        program,
        curvature,
        x,
        unit,
        scaled[active],
        sizes[active],
        (matrix[active], is_equality[active]),
        (np.abs(value) + radius)[active],
        kept[active],
    )
    return OUTWARD * found / float(unit[columns].min(initial=math.inf))


def _sums_of_squares(rows: sp.csr_array) -> FloatVector:
    squares = sp.csr_array((np.square(rows.data), rows.indices, rows.indptr), rows.shape)
    return np.asarray(squares @ np.ones(rows.shape[1]))


def _far(x: FloatVector, point: FeasiblePoint, lower: float, unit: FloatVector) -> float:
    """Return a bound of ‖unit (x − x*)‖ by the value of a feasible point."""
    gap = 2.0 * max(point.value - lower, 0.0) * OUTWARD
    return (
        float(norm_above(unit * (np.abs(x - point.near) * OUTWARD + point.radius)))
        + math.sqrt(gap) * OUTWARD
    )


def _bound(
    program: QuadraticProgram,
    curvature: Curvature,
    x: FloatVector,
    unit: FloatVector,
    rows: sp.csr_array,
    sizes: FloatVector,
    of_user: tuple[sp.csr_array, Any],
    missed: FloatVector,
    numbers: Any,
) -> float:
    """Return a bound of ‖unit (x − x*)‖ by the residuals of x; rows are those of I in units, `missed` is |δ|."""
    matrix, is_equality = of_user
    k, P = rows.shape[0], program.matrices.sparse_P
    if k > program.n or is_over():  # these rows are not independent
        return math.inf
    multipliers, least = np.zeros(k), 1.0
    if k:
        gram = sp.csr_array(rows @ rows.T)
        if not np.isfinite(gram.data).all() or not factor_fits(gram):
            return math.inf
        factor, least = (
            factorise(gram, is_symmetric=True),
            _least_singular_value(gram, rows.shape[1]),
        )
        if factor is None or not least > 0.0:
            return math.inf
        slope = (P @ x + program.c) / unit
        for _ in range(CORRECTIONS):
            multipliers -= factor.solve(rows @ (slope + rows.T @ multipliers))
        multipliers = np.where(is_equality, multipliers, np.maximum(multipliers, 0.0)) / sizes
    s, radius = compensated_product(
        sp.csr_array(sp.hstack([P, matrix.T], format="csr")),
        np.concatenate([x, multipliers]),
        program.c,
    )
    steep = OUTWARD * float(norm_above((np.abs(s) + radius) / unit))
    missed_share = OUTWARD**2 * float(norm_above(missed / sizes)) / least
    curved = sp.csr_array((np.abs(P.data), P.indices, P.indptr), P.shape) @ (1.0 / unit) / unit
    size = OUTWARD * float(curved.max(initial=0.0))
    m, p = program.h.size, program.b.size
    of_A = float(norm_above(missed[(numbers >= m) & (numbers < m + p)]))
    slanted = steep + size * missed_share
    offset = steep * missed_share + curvature.penalty * of_A * of_A * OUTWARD
    found = 0.5 * OUTWARD * (slanted + math.sqrt((slanted * slanted + 4.0 * offset) * OUTWARD))
    return found if found < math.inf else math.inf  # NaN proves nothing


def _least_singular_value(gram: sp.csr_array, terms: int) -> float:
    """Return a lower bound of σ, of rows with entries of at most 1 and their computed products; 0 for none."""
    k = gram.shape[0]
    bound = smallest_eigenvalue_bound(Matrix(0.5 * (gram + gram.T)))
    if bound is None or not bound.is_rigorous:
        return 0.0
    largest = float(gram.diagonal().max())  # no product of two rows exceeds that
    slip, scale = (
        k * OUTWARD * (gamma(2 * terms + 16) + EPSILON) * largest,
        float(bound.scale.max()),
    )
    squared = (bound.value - slip * scale * scale) / (scale * scale) / OUTWARD
    return math.sqrt(squared) / OUTWARD if squared > 0.0 else 0.0
