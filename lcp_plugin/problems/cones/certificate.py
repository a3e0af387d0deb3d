"""Stopping criterion over cones: the criterion of an LCP, block by block, for a stack.

The point is snapped first: a block whose projection is the apex, or a bound, is moved onto it, and w is computed
again. The residual of a block is ‖R_k‖₂ of the natural map R_k(z) = z_k − P_K(z_k − ŵ_k/d_k). SOLVED requires

    ‖R_k(z)‖ ≤ tolerance · ref_P in every connected component P, rounding included,
    d_k ‖R_k‖ ≤ tolerance^(3/4) T_k  and  d_k ‖R_k‖ ≤ tolerance^(1/4) a_k  of every block.

The reference ref_P is the smaller of the largest ‖R_k(z°)‖, z° the point of K nearest to 0, and the largest T_k/d_k
of the active blocks. T_k = ‖|q_k| + Σ |m_ij z_j|‖ are the terms of a block. a_k is the size of the slack at z°: its
largest norm in the component for contacts, otherwise the larger of the block's norm and ‖M_kl‖ a_l / d_l of its
neighbors. A block with q_k = 0 is exempt from the conditions on T_k and a_k if its residual, or its terms, are at
rounding level relative to the component.

Rounding is enclosed: with |w − w̃|_i ≤ ρ_i, projections being nonexpansive, ‖R_k‖ is off by no more than
(1 + μ)‖ρ_k‖ / d_k, and by the rounding of the projection, at most 4 (m + 8) u (1 + μ)(‖z_k‖ + (1 + μ)‖w_k‖ / d_k).
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import read_only
from ...core.rounding import compensated_product
from .data import Blocks
from .stack import NOISE, OUT, WITHIN, Array, ConeStack, length

UNIT = 2.0**-53
EXCUSED = 2.0**-50  # of the largest terms, or of d ‖z_P‖: tolerated residual if q_k = 0
SMALL = 1e-2  # of the reference: a larger residual does not count as limited by rounding


class Measures:
    """Residuals of points for the problems of a stack.

    Parameters
    ----------
    stack : ConeStack
    z : array, shape (B, k, m)
        Points of the cones.
    tolerance, absolute : float
    w, error : array, shape (B, k, m), optional
        The slack of z, and a bound of its rounding error.

    Attributes
    ----------
    z, w : array, shape (B, k, m)
        The snapped points, which are measured, and their slack.
    sizes, rounding : array, shape (B, k)
        ‖R_k‖, and a bound of its rounding error.
    relative, terms : array, shape (B, k)
        (‖R_k‖ + rounding) / ref_P, and the larger of (d ‖R_k‖ / T_k)^(4/3) and (d ‖R_k‖ / a_k)⁴.
    do_pass : array, shape (B, k)
        Blocks that meet the criterion.
    is_solved : array, shape (B,)
        Whether each point is SOLVED.
    """

    def __init__(
        self,
        stack: ConeStack,
        z: Array,
        tolerance: float,
        absolute: float = 0.0,
        w: Array = None,
        error: Array = None,
    ) -> None:
        pattern, d = stack.pattern, stack.d
        w = stack.slack(z) if w is None else w
        R, case, *_ = stack.residual(z, w)
        if ((case == OUT)[..., None] & (R != 0.0)).any():
            z = np.where((case == OUT)[..., None], z - R, z)
            w, error = stack.slack(z), None
            R, case, *_ = stack.residual(z, w)
        products, q = pattern.times(z, absolute=True), np.abs(stack.q)
        if error is None:
            error = (pattern.most_terms + 2) * UNIT * np.where(products > 0.0, products + q, 0.0)
        self.stack, self.z, self.w, self.sizes = stack, z, w, length(R)
        self.rounding = self._bound_rounding(case, error)
        violation, terms = d * self.sizes, length(products + q)
        is_active = (case != OUT) | (violation > 0.0)
        active = pattern.largest(np.where(is_active, terms / d, 0.0))
        self.reference = np.where(stack.is_answered, 0.0, np.minimum(stack.reference, active))
        most = self.sizes + self.rounding
        self.relative = _ratio(most, self.reference)
        self.relative[~np.isfinite(stack.reference)] = np.inf
        self.terms = self._term_residuals(violation, terms, is_active)
        meets = (self.relative <= tolerance) & (self.terms <= tolerance)
        self.do_pass = meets | (most <= absolute)
        self.is_solved = self.do_pass.all(1) & np.isfinite(w).all((1, 2))

    def _bound_rounding(self, case: Array, error: Array) -> Array:
        """Return a bound of the rounding error of ‖R_k‖, with |w − w̃| ≤ error."""
        stack, z, w, mu, d = self.stack, self.z, self.w, self.stack.mu, self.stack.d
        at, slip, wide = length(z), length(w), length(error)
        stretch = 1.0 + mu if stack.has_friction else 1.0
        inside = 0.5 * (mu * z[..., 0] - length(z[..., 1:])) / (1.0 + mu)
        is_inner = (case == WITHIN) & (self.sizes < inside)
        pushed = stretch * slip
        is_open = (case == OUT) & (at == 0.0)
        if stack.has_friction:
            pushed = np.where(case == WITHIN, pushed, np.abs(w[..., 0]))
            is_open &= w[..., 0] >= error[..., 0]
        else:
            is_open &= w[..., 0] - error[..., 0] >= mu * (length(w[..., 1:]) + wide)
        off = np.where(is_inner, 0.0, at) + (pushed + stretch * wide) / d
        off *= np.where(case == OUT, 0.0, 4.0 * (stack.pattern.sizes + 8.0) * UNIT * (1.0 + mu))
        off += stretch * wide / d
        if stack.pattern.has_rows:
            step, error, is_row = w[..., 0], error[..., 0], stack.pattern.is_row
            is_held = (z[..., 0] == stack.low) & (step >= error)
            is_held |= (z[..., 0] == stack.high) & (step <= -error)
            off = np.where(is_row, (error + 4.0 * UNIT * np.abs(step)) / d, off)
            is_open = np.where(is_row, is_held, is_open)
        return np.where(is_open, 0.0, off)

    def _term_residuals(self, violation: Array, terms: Array, is_active: Array) -> Array:
        """Return the residuals d ‖R_k‖ = `violation` relative to T_k and a_k; 0 at rounding level."""
        stack, pattern = self.stack, self.stack.pattern
        is_open = ~(violation <= NOISE * terms)
        if not is_open.any():
            return np.zeros_like(violation)
        limits = _ratio(violation, terms) ** (4.0 / 3.0)
        of_demand = np.where(stack.demand > 0.0, _ratio(violation, stack.demand), 0.0) ** 4
        largest = stack.d * pattern.largest(length(self.z))
        size = np.minimum(largest, pattern.largest(np.where(is_active, terms, 0.0)))
        is_small, has_q = terms <= NOISE * size, stack.q.any(-1)
        is_alone = pattern.largest((is_small & has_q).astype(np.float64)) == 0.0
        is_excused = ~has_q & ((violation <= EXCUSED * size) | (is_small & is_alone))
        return np.where(is_open & ~is_excused, np.maximum(limits, of_demand), 0.0)

    def are_limited(self) -> Array:
        """Return whether rounding explains the residuals of all blocks that do not pass, shape (B,)."""
        is_small = (self.relative <= SMALL) | (self.reference == 0.0)
        return (self.do_pass | ((self.sizes <= self.rounding) & is_small)).all(1)

    def worst(self) -> Array:
        """Return the largest relative residual of each problem, shape (B,)."""
        return self.relative.max(1, initial=0.0)


def _ratio(values: Array, sizes: Array) -> Array:
    """Return values / sizes, 0 for 0/0; a NaN is ∞."""
    found = np.where(values == 0.0, 0.0, values / sizes)
    return np.where(np.isnan(found), np.inf, found)


def measure_points(stack: ConeStack, z: Array, tolerance: float, absolute: float = 0.0) -> Measures:
    """Return the measures of points of the cones.

    Sums of one problem are repeated in twice the working precision if this may decide.
    """
    with np.errstate(all="ignore"):
        found = Measures(stack, z, tolerance, absolute)
        if stack.B > 1 or found.is_solved[0]:
            return found
        if (found.sizes > np.maximum(tolerance * found.reference, absolute)).any():
            return found
        pattern = stack.pattern
        M = pattern.M if pattern.is_sparse else sp.csr_array(pattern.M[0])
        x, q = (np.ascontiguousarray(pattern.flat(one)[0]) for one in (found.z, stack.q))
        w, error = (pattern.wide(one[None]) for one in compensated_product(M, x, q))
        return Measures(stack, found.z, tolerance, absolute, w, error)


class ConeCertificate:
    """Residuals of a point for a problem over cones.

    Attributes
    ----------
    problem : Blocks
        The problem.
    z, w : ndarray, shape (n,)
        The point, and M z + q.
    relative_residual : float
        The largest ‖R_k‖ relative to the reference of its component, rounded upwards.
    term_residual : float
        The largest of (d_k ‖R_k‖ / T_k)^(4/3) and (d_k ‖R_k‖ / a_k)⁴ of all blocks; see the module.
    worst_index : int
        The block of the largest relative residual; −1 without blocks.
    """

    is_linearised: ClassVar[bool] = True  # its rows are not the rows of an LCP

    def __init__(self, problem: Blocks, measures: Measures) -> None:
        self.problem, self.measures, pattern = problem, measures, measures.stack.pattern
        self.z = read_only(pattern.flat(measures.z)[0].copy())
        self.w = read_only(pattern.flat(measures.w)[0].copy())

    @property
    def relative_residual(self) -> float:
        """The largest ‖R_k‖ relative to the reference of its component."""
        return float(self.measures.worst()[0])

    @property
    def term_residual(self) -> float:
        """The largest residual of a block relative to its terms."""
        return float(self.measures.terms.max(initial=0.0))

    @property
    def worst_index(self) -> int:
        """The block of the largest relative residual; −1 without blocks."""
        relative = self.measures.relative[0]
        return int(np.argmax(relative)) if relative.size else -1

    @property
    def scaled_residual(self) -> float:
        """‖R_k‖ of that block, in the unit of z."""
        return float(self.measures.sizes[0, self.worst_index]) if self.z.size else 0.0

    @cached_property
    def natural_residual(self) -> float:
        """The largest ‖z_k − P_K(z_k − ŵ_k)‖, unscaled."""
        plain = copy(self.measures.stack)
        plain.d = np.ones_like(plain.d)
        with np.errstate(all="ignore"):
            return float(
                length(plain.residual(self.measures.z, self.measures.w)[0]).max(initial=0.0)
            )

    @property
    def dissipation(self) -> float:
        """−zᵀw; for contacts the energy −rᵀu that friction would take at the final velocities."""
        with np.errstate(all="ignore"):
            return float(-(self.z @ self.w))

    @property
    def lost_energy(self) -> float:
        """−rᵀ(b + u)/2, the kinetic energy that impact and friction take: impulses r change velocities b to u."""
        with np.errstate(all="ignore"):
            return float(-0.5 * (self.z @ (self.problem.q + self.w)))

    def __str__(self) -> str:
        lines = [
            ("relative residual", self.relative_residual),
            ("natural residual", self.natural_residual),
            ("term residual", self.term_residual),
            ("z · w", -self.dissipation),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)
