"""How wrong a z is for a problem over cones: the criterion of an LCP, block by block.

The residual of a block is the natural map R_k(z) = z_k − P_K(z_k − ŵ_k / d_k), ŵ = w + μ‖w_T‖ e_N with friction, w
without, and its size is ‖R_k‖₂. Scales d_k, scaling and components are those of the LCP of block norms
(:attr:`~lcp_plugin.problems.cones.data.Blocks.block_norms`), d_k = ‖M_kk‖/√m of m rows, which nothing cancels: so
SOLVED asks for z in K, ‖R̂_k(z)‖ ≤ tolerance · ‖R̂_P(z°)‖ in every component P, z° the point of K nearest to 0, and for
every block to be right beside its own terms, ‖|q_k| + Σ |m_ij z_j|‖, to √tolerance, or negligible beside what acts
(:func:`~lcp_plugin.problems.cones.kernels.own_terms`).

Rounding is enclosed: with |w − w̃|_i ≤ ρ_i, projections being nonexpansive, ‖R_k‖ is off by no more than
(1 + μ)‖ρ_k‖ / d_k, and what the projection itself rounds is at most 8 (m + 10) u (1 + μ)(‖z_k‖ + (1 + μ)‖w_k‖ / d_k), m
rows, u = 2⁻⁵³.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.certificates.criterion import VectorEnds, for_each_row, largest_of_components
from ...core.certificates.residuals import GAINED, Certificate
from ...core.certificates.row_residuals import over, rounding_floor
from ...core.checks import FloatVector, read_only
from ...core.lcp import LCP
from ...core.matrix.structure import connected_components
from ...core.rounding import compensated_product, fresh_copies, read_only_views
from .data import Blocks


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
    cones: Blocks
    point: FloatVector

    def __init__(self, cones: Blocks, point: FloatVector) -> None:
        self.__dict__.update(cones=cones, point=point)

    @classmethod
    def at(cls, cones: Blocks, z: FloatVector) -> ConeCertificate:
        """Return the certificate of z, shape (n,)."""
        return cls(cones, read_only(np.array(z, dtype=np.float64)))

    @classmethod
    def proved(cls, cones: Blocks, z: FloatVector, relative_residual: float) -> ConeCertificate:
        """Return the certificate of a z, shape (n,), whose relative residual a kernel has enclosed."""
        certificate = cls(cones, read_only(z))
        certificate.__dict__["relative_residual"] = relative_residual
        return certificate

    @cached_property
    def problem(self) -> LCP:
        """The LCP of block norms."""
        return self.cones.block_norms

    @cached_property
    def z(self) -> FloatVector:
        """Norms of z of each block, shape (k,)."""
        return read_only(self.cones.norms(self.point))

    @cached_property
    def _product(self) -> tuple[FloatVector, FloatVector]:
        with np.errstate(all="ignore"):
            w, slip = compensated_product(self.cones.rows.csr, self.point, self.cones.q)
        return read_only(w), slip

    @property
    def velocity(self) -> FloatVector:
        """W = M z + q, shape (n,)."""
        return self._product[0]

    @cached_property
    def w(self) -> FloatVector:
        """Norms of the slack of each block, shape (k,)."""
        return read_only(self.cones.norms(self.velocity))

    @property
    def references(self) -> VectorEnds:
        """Bounds of ‖R_P(z°)‖ of each component, shape (components,) each."""
        return criterion_of(self.cones).references

    def _ends(self, scale: FloatVector) -> VectorEnds:
        """Return bounds of every ‖R_k‖."""
        from .kernels import bounds

        cones, (w, slip) = self.cones, self._product
        least, most = np.empty((2, cones.slope.size))
        bounds(*cones.arrays, *fresh_copies(self.point, w, slip, scale), least, most)
        if not cones.has_friction:  # 0 and a slack on the boundary of the dual cone, exactly
            for k in np.flatnonzero(
                (most > 0.0) & (self.z == 0.0) & (cones.sizes > 1) & (cones.norms(slip) == 0.0)
            ):
                own = [
                    Fraction(value) for value in w[cones.starts[k] : cones.starts[k + 1]].tolist()
                ]
                most[k] *= own[0] < 0 or own[0] ** 2 < sum(value**2 for value in own[1:])
        return least, most

    def _sharp_ends(self) -> FloatVector:
        """Return the bounds in components that z° solves, where only what is exactly 0 will do."""
        return self._scaled_ends[1]

    @cached_property
    def term_residuals(self) -> FloatVector:
        """How wrong each block is beside its own terms, squared, shape (k,): 0 where its residual is 0."""
        from .kernels import term_residuals

        cones, several = self.cones, connected_components(self.problem.matrix)
        M, wrong = cones.rows.csr, np.empty(cones.slope.size)
        labels = np.zeros(wrong.size, np.int64) if several is None else several.labels
        vectors = fresh_copies(cones.scale, labels, self.point, self.velocity)
        of_rows = *fresh_copies(M.indptr, M.indices, M.data), *read_only_views(cones.q)
        term_residuals(*cones.arrays, *of_rows, *vectors, wrong)
        return np.where(self._scaled_ends[1] == 0.0, 0.0, wrong)

    @cached_property
    def _worst(self) -> tuple[float, int]:
        """The largest residual beside its component's reference, in the unit of z, and its block."""
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
        """True at that level, where the residual is small, or z° of its component may be an answer, too."""
        is_small = over(*self.residuals_of_components) <= GAINED
        return self.is_at_rounding_level and bool((is_small | (self.references[0] == 0.0)).all())

    @cached_property
    def natural_residual(self) -> float:
        """The largest ‖z_k − P_K(z_k − ŵ_k)‖, unscaled."""
        return float(self._natural.max(initial=0.0))

    @cached_property
    def dissipation(self) -> float:
        """−rᵀu of contacts, what friction would take at the last velocities; of others −zᵀw, their complementarity."""
        with np.errstate(all="ignore"):
            return float(-(self.point @ self.velocity))

    @cached_property
    def lost_energy(self) -> float:
        """−rᵀ(b + u)/2, the kinetic energy that impact and friction take: impulses r change velocities b to u."""
        with np.errstate(all="ignore"):
            return float(-0.5 * (self.point @ (self.cones.q + self.velocity)))

    def __str__(self) -> str:
        lines: list[tuple[str, Any]] = [
            ("relative residual", self.relative_residual),
            ("natural residual", self.natural_residual),
            ("term residual", self.term_residual),
            ("z · w", -self.dissipation),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)


class Criterion(NamedTuple):
    """What the residuals of a problem are compared with.

    Attributes
    ----------
    references : pair of arrays, shape (components,) each
        Bounds of ‖R_P(z°)‖ of each component.
    scale : ndarray, shape (k,)
        What w is divided by in each block's residual.
    weights : ndarray, shape (k,)
        Of each block's ‖R_k‖, so that they are beside the reference of their component; 0 where z° answers it.
    answered : array of bool, shape (n,), or None
        Rows of the components that z° answers; None where there are none.
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
    scaling, scale = origin._scaling, origin._scale
    least, most = origin._ends(scale)
    if scaling is not None:
        least, most = scaling.downwards(least), scaling.upwards(most)
    references = largest_of_components(norms, least), largest_of_components(norms, most)
    reference = np.broadcast_to(for_each_row(norms, references[1]), least.shape)
    with np.errstate(all="ignore"):
        weights = (1.0 if scaling is None else np.ldexp(1.0, -scaling.column)) / reference
    is_answered = (reference == 0.0)[cones.block_of_row]
    return Criterion(
        references,
        scale,
        np.where(reference == 0.0, 0.0, weights),
        is_answered if is_answered.any() else None,
    )


def relative_residual(cones: Blocks, z: FloatVector) -> float:
    """Return ‖R(z)‖ of the worst block beside the reference of its component, as double precision gives it."""
    return float(weighted(cones, cones.residual(z, cones.slack(z))[0]).max(initial=0.0))


def weighted(cones: Blocks, residual: FloatVector) -> FloatVector:
    """Return ‖R_k‖ of each block beside the reference of its component, shape (k,)."""
    sizes = cones.norms(residual)
    with np.errstate(all="ignore"):
        return np.where(sizes == 0.0, 0.0, sizes * criterion_of(cones).weights)
