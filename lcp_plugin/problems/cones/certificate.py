"""How wrong a z is for a problem over cones: the criterion of an LCP, block by block.

The residual of a block is the natural map R_k(z) = z_k − P_K(z_k − ŵ_k / d_k), ŵ = w + μ‖w_T‖ e_N with friction, w
without, and its size is ‖R_k‖₂. Scales d_k, units and parts are those of the LCP of block norms
(:attr:`~lcp_plugin.problems.cones.data.Blocks.block_norms`), d_k the mean of the block's diagonal: so SOLVED asks for
‖R̂_k(z)‖ ≤ tolerance · ‖R̂_P(z°)‖ in every part P, z° the point of K nearest to 0, and for every block to be right in its
own terms to √tolerance, by the functions that an LCP is judged by.

Rounding is enclosed: with |w − w̃|_i ≤ ρ_i, projections being nonexpansive, ‖R_k‖ is off by no more than
(1 + μ)‖ρ_k‖ / d_k, and what the projection itself rounds is at most 8 (m + 10) u (1 + μ)(‖z_k‖ + (1 + μ)‖w_k‖ / d_k), m
rows, u = 2⁻⁵³.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.certificates.criterion import VectorEnds, for_each_row, largest_of_parts
from ...core.certificates.own_terms import term_residuals
from ...core.certificates.residuals import GAINED, Certificate
from ...core.certificates.row_residuals import over, residual_ends_of, rounding_floor, sharp_residual_ends
from ...core.checks import FloatVector, read_only
from ...core.kernels.floats import TINY, UNIT
from ...core.rounding import compensated_product, lower_end
from .data import Blocks

OUTWARD = 1.0 + 2.0**-48  # of a handful of roundings


@dataclass(frozen=True, eq=False)
class ConeCertificate(Certificate):
    """Every measure of how far a point is from solving a problem over cones.

    Attributes
    ----------
    problem : LCP
        Of block norms, whose rows are blocks: `worst_index` is the number of a block.
    cones : Blocks
        The problem.
    point : ndarray, shape (n,)
        z.
    velocity : ndarray, shape (n,)
        w = M z + q.
    """

    is_linearised: ClassVar[bool] = True  # its rows are not those of an LCP

    cones: Blocks = field(kw_only=True, repr=False)
    point: FloatVector = field(kw_only=True, repr=False)
    velocity: FloatVector = field(kw_only=True, repr=False)
    slip: FloatVector = field(kw_only=True, repr=False)

    @classmethod
    def at(cls, cones: Blocks, z: FloatVector) -> ConeCertificate:
        """Return the certificate of z, shape (n,)."""
        point = read_only(np.array(z, dtype=np.float64))
        with np.errstate(all="ignore"):
            w, slip = compensated_product(cones.rows.csr, point, cones.q)
            return cls(cones.block_norms, read_only(cones.norms(point)), cones=cones, point=point,
                       velocity=read_only(w), slip=slip)

    @cached_property
    def w(self) -> FloatVector:
        """Norms of the slack of each block, shape (k,)."""
        return read_only(self.cones.norms(self.velocity))

    @property
    def references(self) -> VectorEnds:
        """Bounds of ‖R_P(z°)‖ of each part, shape (parts,) each."""
        return criterion_of(self.cones).references

    def _ends(self, scale: FloatVector) -> VectorEnds:
        """Return bounds of every ‖R_k‖; of rows that are no cone's those of an LCP."""
        cones, is_cone = self.cones, self.cones.sizes > 1
        mu = np.where(is_cone, cones.slope, 0.0)
        with np.errstate(all="ignore"):
            sizes = cones.norms(cones.residual(self.point, self.velocity, scale)[0])
            stretch = 1.0 + (mu if cones.has_friction else 0.0)
            moved = stretch * cones.norms(self.slip) / scale
            terms = self.z + stretch * (self.w + cones.norms(self.slip)) / scale
            rounded = 8.0 * (cones.sizes + 10.0) * UNIT * (1.0 + mu) * terms
            off = OUTWARD * (moved + rounded) + 4.0 * TINY
            is_finite = np.isfinite(sizes) & np.isfinite(off)
            least = np.where(is_finite, np.maximum(sizes / OUTWARD - off, 0.0), 0.0)
            most = np.where(is_finite, OUTWARD * (sizes + off), np.inf)
            most = np.where(self._is_open, 0.0, most)
        if not is_cone.all() and is_cone.size:
            of_rows = residual_ends_of(
                cones.rows.csr, self.point, cones.rows, self.point, scale[cones.block_of_row]
            )
            first = cones.starts[:-1]
            least, most = (np.where(is_cone, end, row[first]) for end, row in zip((least, most), of_rows, strict=True))
        return least, most

    @cached_property
    def _is_open(self) -> NDArray[np.bool_]:
        """Which cones have a point that is 0 and a slack proved to be in the dual cone: their residual is 0."""
        cones, first = self.cones, self.cones.starts[:-1]
        normal = lower_end(self.velocity, self.slip)[first]
        is_open: NDArray[np.bool_] = (self.z == 0.0) & (cones.sizes > 1) & (normal >= 0.0)
        if cones.has_friction:  # û_N ≥ μ‖u_T‖ says u_N ≥ 0
            return is_open
        tangents = np.abs(self.velocity) + self.slip
        tangents[first] = 0.0
        enough = normal >= OUTWARD * cones.norms(tangents)
        for k in np.flatnonzero((self.z == 0.0) & (normal > 0.0) & ~enough & (cones.norms(self.slip) == 0.0)):
            own = [Fraction(value) for value in self.velocity[cones.starts[k]:cones.starts[k + 1]].tolist()]
            enough[k] = own[0] ** 2 >= sum(value**2 for value in own[1:])
        is_open &= enough
        return is_open

    def _sharp_ends(self) -> FloatVector:
        """Return the bounds in parts that z° solves, where only what is exactly 0 will do."""
        return self._sharp_ends_at(self._scale)

    def _sharp_ends_at(self, scale: FloatVector) -> FloatVector:
        cones = self.cones
        rows = sharp_residual_ends(cones.rows, self.point, scale[cones.block_of_row])[1]
        return np.where(cones.sizes > 1, self._ends(scale)[1], rows[cones.starts[:-1]])

    @cached_property
    def term_residuals(self) -> FloatVector:
        """How wrong each block is in its own terms, shape (k,): d_k ‖R_k‖ is its wrong part."""
        residual = self._ends(self.problem.residual_scale)[1]
        with np.errstate(all="ignore"):
            return term_residuals(self.problem, self.z, residual * self.problem.residual_scale)

    @cached_property
    def _worst(self) -> tuple[float, int]:
        """The largest residual beside its part's reference, in the unit of z, and its block."""
        ends = self._scaled_ends[1]
        with np.errstate(all="ignore"):
            shares = np.where(ends > 0.0, ends * criterion_of(self.cones).weights, 0.0)
            worst = int(np.argmax(shares)) if ends.size else -1
        return (float(ends[worst]), worst) if ends.size else (0.0, -1)

    @cached_property
    def rounding_floor(self) -> FloatVector:
        """What rounding alone can make of each block's residual, estimated, shape (k,)."""
        return 4.0 * self.cones.sizes * rounding_floor(self.problem, self._terms, self._scale)

    @cached_property
    def is_limited_by_rounding(self) -> bool:
        """True at that level, where the residual is small, or in its part z° cannot be told from an answer either."""
        is_small = over(*self.residuals_of_parts) <= GAINED
        return self.is_at_rounding_level and bool((is_small | (self.references[0] == 0.0)).all())

    @cached_property
    def natural_residual(self) -> float:
        """The largest ‖z_k − P_K(z_k − ŵ_k)‖, unscaled."""
        return float(self._natural.max(initial=0.0))

    @cached_property
    def dissipation(self) -> float:
        """−rᵀu of contacts: the work that friction takes, in J; zᵀw of others is its complementarity."""
        return float(-(self.point @ self.velocity))

    def __str__(self) -> str:
        lines: list[tuple[str, Any]] = [
            ("relative residual", self.relative_residual), ("natural residual", self.natural_residual),
            ("term residual", self.term_residual), ("z · w", -self.dissipation),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)


class Criterion(NamedTuple):
    """What the residuals of a problem are compared with.

    Attributes
    ----------
    references : pair of arrays, shape (parts,) each
        Bounds of ‖R_P(z°)‖ of each part.
    scale : ndarray, shape (k,)
        What w is divided by in each block's residual.
    weights : ndarray, shape (k,)
        Of each block's ‖R_k‖, so that they are beside the reference of their part; 0 where z° answers it.
    answered : array of bool, shape (n,), or None
        Rows of the parts that z° answers; None where there are none.
    """

    references: VectorEnds
    scale: FloatVector
    weights: FloatVector
    answered: NDArray[np.bool_] | None


def criterion_of(cones: Blocks) -> Criterion:
    """Return that of a problem, which keeps it."""
    known: Criterion | None = cones.__dict__.get("_criterion")
    if known is None:
        known = cones.__dict__["_criterion"] = _criterion(cones)
    return known


def _criterion(cones: Blocks) -> Criterion:
    norms, origin = cones.block_norms, ConeCertificate.at(cones, cones.nearest_to_zero)
    units, scale = origin._units, origin._scale
    least, most = origin._ends(scale)
    if ((least == 0.0) & (most > 0.0)).any():
        most = np.where(least == 0.0, origin._sharp_ends_at(scale), most)
    if units is not None:
        least, most = units.downwards(least), units.upwards(most)
    references = largest_of_parts(norms, least), largest_of_parts(norms, most)
    reference = np.broadcast_to(for_each_row(norms, references[1]), least.shape)
    with np.errstate(all="ignore"):
        weights = (1.0 if units is None else np.ldexp(1.0, -units.column)) / reference
    is_answered = (reference == 0.0)[cones.block_of_row]
    return Criterion(
        references, scale, np.where(reference == 0.0, 0.0, weights), is_answered if is_answered.any() else None
    )


def relative_residual(cones: Blocks, z: FloatVector) -> float:
    """Return ‖R(z)‖ of the worst block beside the reference of its part, as double precision gives it."""
    return float(weighted(cones, cones.residual(z, cones.slack(z))[0]).max(initial=0.0))


def weighted(cones: Blocks, residual: FloatVector) -> FloatVector:
    """Return ‖R_k‖ of each block beside the reference of its part, shape (k,)."""
    sizes = cones.norms(residual)
    with np.errstate(all="ignore"):
        return np.where(sizes == 0.0, 0.0, sizes * criterion_of(cones).weights)
