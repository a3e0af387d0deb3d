"""New projected-type methods (NP*): the splitting iterations of Kumar, Deepmala and Das.

Their Method 3.1 with any splitting M = 𝓜 − 𝓝 is, because |w − z| = w + z − 2 min(z, w), exactly

    (𝓜 + 2I + D)(z⁺ − z) = −2 min(z, M z + q):

the residual that is the stopping test anyway, and one triangular solve. Here min(z, w) is replaced by
r_S(z) = z − mid(lower, upper, z − S w), which is the same on the classical problem, allows bounds and free
rows, and lets a positive row scaling S in. Each component of z⁺ is projected onto its bounds (the paper's ζ₊)
immediately, so that the rows after it already see the projected value.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..algorithm import Algorithm, Step, check_choice, check_positive
from ..checks import FloatVector
from ..errors import InvalidOption, UnsuitableMatrix
from ..lcp import LCP
from ..matrix.iteration_facts import PROJECTED_TYPE, IterationFacts
from ..matrix.row_sums import (
    automatic_factors,
    has_positive_diagonal,
    inverse_residual_scale,
    row_splits,
)
from . import Splitting


@dataclass(frozen=True, kw_only=True)
class ScaledByRows(Algorithm):
    """Base of all NP iterations: a row scaling S, and a last projected Gauss–Seidel sweep."""

    scaling: str | None = "auto"
    scaling_factor: float = 1.0

    reference: ClassVar[str] = (
        "Kumar, Deepmala, Das: More on projected type iteration method and linear complementarity problem"
    )

    def __post_init__(self) -> None:
        check_choice(self, "scaling", ("auto", "diagonal", None))
        check_positive(self, "scaling_factor")
        if self.scaling != "diagonal" and self.scaling_factor != 1.0:
            raise InvalidOption(
                f'{self.name}: scaling_factor={self.scaling_factor!r} needs scaling="diagonal"; '
                f"with {self.scaling!r} it does nothing"
            )

    @abstractmethod
    def automatic_factors(self, problem: LCP) -> FloatVector | float:
        """Return the automatic θ, shape (n,) or a number."""

    def row_scaling(self, problem: LCP) -> FloatVector:
        """Return the diagonal of S, shape (n,): ones, factor/m_ii, or θ/m_ii with automatic θ; finite.

        The scale of the residual replaces m_ii if m_ii ≤ 0 or tiny. A diagonal that is small relative to its row is
        used, as in an H₊-matrix with columns of different units.
        """
        if self.scaling is None:
            return np.ones(problem.q.size)
        factors = self.automatic_factors(problem) if self.scaling == "auto" else self.scaling_factor
        inverse = inverse_residual_scale(problem.matrix)
        if problem.matrix.residual_scale is not problem.matrix.diagonal:
            inverse = np.where(
                has_positive_diagonal(problem.matrix), 1.0 / problem.matrix.diagonal, inverse
            )
        return np.minimum(factors * inverse, np.finfo(np.float64).max)

    def finish(self, problem: LCP, z: FloatVector) -> FloatVector:
        """Return z after one projected Gauss–Seidel sweep, which puts active components at their bounds."""
        from ..kernels.splitting_sweeps import relaxation_sweep

        M, split, cleaned = problem.matrix.csr, row_splits(problem.matrix, False), z.copy()
        inverse_scale = inverse_residual_scale(problem.matrix)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, inverse_scale])
        relaxation_sweep(M.indptr, split, M.indices, M.data, rows, 1.0, False, cleaned)
        return cleaned


@dataclass(frozen=True, kw_only=True)
class ProjectedType(ScaledByRows, Splitting):
    """(D/α + D + 2S⁻¹ − (β/α) L)(z⁺ − z) = −2 S⁻¹ r_S(z) by forward substitution, each component projected at once.

    Parameters
    ----------
    scaling : {"auto", "diagonal", None}
        Row scaling S: automatic, ``scaling_factor``/d_i with d_i the diagonal, or none (the paper). S changes the
        iteration, never the solutions. "auto" uses θ_i/d_i with θ_i from 0.9 to 2. The iteration is proved to converge
        for every H₊-matrix with "auto", and with "diagonal" if the factor is ≤ 1.
    scaling_factor : float
        θ of the diagonal scaling, > 0.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Paper notation: α₁ = relaxation α, β₁ = acceleration β, A = M, σ = q, λ = ζ₊ = z.
    """

    sweep: str = "forward"

    needs: ClassVar[str] = "d/α + d + 2 > 0"
    solves: ClassVar[str] = 'H₊ (scaling="auto", or "diagonal" with scaling_factor ≤ 1)'

    def __post_init__(self) -> None:
        ScaledByRows.__post_init__(self)
        Splitting.__post_init__(self)

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …; each with its residual, which the pass to the next iterate measures anyway."""
        from ..kernels.splitting_sweeps import splitting_sweep

        alpha, beta = self.weights()
        step = self.row_scaling(problem)
        pivot = self._inverse_pivot(problem, step * problem.matrix.diagonal, alpha)
        inverse_scale = inverse_residual_scale(problem.matrix)
        rows = np.column_stack(
            [problem.q, problem.lower, problem.upper, inverse_scale, step, pivot]
        )
        yield from self.swept(problem, splitting_sweep, rows, (beta / alpha, True), z0)

    def facts(self, problem: LCP) -> IterationFacts:
        """Return α, β, S and the sweep; raise UnsuitableMatrix if a pivot is not positive."""
        alpha, beta = self.weights()
        step = self.row_scaling(problem)
        self._inverse_pivot(problem, step * problem.matrix.diagonal, alpha)
        return IterationFacts(
            family=PROJECTED_TYPE,
            relaxation=alpha,
            acceleration=beta,
            sweep=self.sweep,
            scaling=step,
            is_scaled=self.scaling is not None,
        )

    def automatic_factors(self, problem: LCP) -> FloatVector:
        """Return θ, shape (n,)."""
        alpha, beta = self.weights()
        return automatic_factors(problem.matrix, beta / alpha, self.sweep)

    def _inverse_pivot(
        self, problem: LCP, scaled_diagonal: FloatVector, alpha: float
    ) -> FloatVector:
        pivot = scaled_diagonal / alpha + scaled_diagonal + 2.0
        inverse: FloatVector = 1.0 / pivot
        if pivot.size and not pivot.min() > 0.0:
            i = int(np.flatnonzero(~(pivot > 0.0))[0])
            raise UnsuitableMatrix(
                f"{self.name} needs d/α + d + 2 > 0 on every row, but M[{i}, {i}] = {problem.matrix.diagonal[i]} "
                f'gives {pivot[i]}; try algorithm="auto"'
            )
        huge = np.isinf(pivot)
        inverse[huge] = 1.0 / scaled_diagonal[huge] / (1.0 / alpha + 1.0)
        return inverse


@dataclass(frozen=True, kw_only=True)
class NPAOR(ProjectedType):
    """NPAOR, new projected-type accelerated overrelaxation: (D/α + D + 2I − (β/α) L)(z⁺ − z) = −2 min(z, w).

    Parameters
    ----------
    relaxation : float
        α > 0.
    acceleration : float
        β; convergence is proved for 0 ≤ β ≤ α.
    scaling : {"auto", "diagonal", None}
        Row scaling S: automatic, ``scaling_factor``/d_i with d_i the diagonal, or none (the paper).
    scaling_factor : float
        θ of the diagonal scaling, > 0.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    The paper prints (α−β)U for (α−β)L + αU and αI + D for α(I + D); the formula above follows
    from its Method 3.1. Paper notation: α₁ = relaxation, β₁ = acceleration.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> lcp_plugin.solve(problem, "npaor", relaxation=1.5, acceleration=1.0).z.round(6)
    array([0.75, 0.  ])
    """

    name: ClassVar[str] = "npaor"
    solves: ClassVar[str] = (
        'H₊ for 0 ≤ β ≤ α (scaling="auto", or "diagonal" with scaling_factor ≤ 1)'
    )
    relaxation: float = 1.7
    acceleration: float = 1.0


@dataclass(frozen=True, kw_only=True)
class NPSOR(ProjectedType):
    """NPSOR, new projected-type successive overrelaxation: NPAOR with α = β = relaxation.

    Parameters
    ----------
    relaxation : float
        α > 0; 1.7 is the paper's choice.
    scaling, scaling_factor : {"auto", "diagonal", None} and float
        Row scaling S: automatic, ``scaling_factor``/d_i, or none (the paper); see :class:`NPAOR`.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    The paper prints U for αU and αI + D for α(I + D); implemented as printed it converges to a wrong point.
    Paper notation: α₁ = relaxation.
    """

    name: ClassVar[str] = "npsor"
    relaxation: float = 1.7


@dataclass(frozen=True, kw_only=True)
class NPGS(ProjectedType):
    """NPGS, new projected-type Gauss–Seidel: NPAOR with α = β = 1.

    Parameters
    ----------
    scaling, scaling_factor : {"auto", "diagonal", None} and float
        Row scaling S: automatic, ``scaling_factor``/d_i, or none (the paper); see :class:`NPAOR`.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "npgs"


@dataclass(frozen=True, kw_only=True)
class NPJ(ProjectedType):
    """NPJ, new projected-type Jacobi: z⁺ = z − min(z, w)/(d + 1), NPAOR with α = 1, β = 0.

    Parameters
    ----------
    scaling, scaling_factor : {"auto", "diagonal", None} and float
        Row scaling S: automatic, ``scaling_factor``/d_i, or none (the paper); see :class:`NPAOR`.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Converges for every H₊-matrix at every scale.
    """

    name: ClassVar[str] = "npj"
    solves: ClassVar[str] = "H₊"
    is_coupled: ClassVar[bool] = False
