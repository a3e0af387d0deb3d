"""NP*: the projected-type splitting iterations of Kumar, Deepmala and Das.

Their Method 3.1 with any splitting M = 𝓜 − 𝓝 is, because |w − z| = w + z − 2 min(z, w), exactly

    (𝓜 + 2I + D)(z⁺ − z) = −2 min(z, M z + q):

the residual that is the stopping test anyway, and one triangular solve. Here min(z, w) is replaced by
r_S(z) = z − mid(lower, upper, z − S w), which is the same on the classical problem, allows bounds and free
rows, and lets a positive row scaling S in. Each component of z⁺ is projected onto its bounds (the paper's ζ₊)
as soon as it is computed, so that the rows after it already see the projected value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...certificates.convergence import PROJECTED_TYPE, IterationFacts
from ...checks import FloatVector
from ...errors import InvalidOption, UnsuitableMatrix
from ...problem.lcp import LCP
from ..base import (
    SWEEPS,
    Algorithm,
    Step,
    check_choice,
    check_number,
    check_positive,
    directions,
    inverse_residual_scale,
    row_splits,
)
from .automatic_scaling import automatic_factors, scaled_rows

SCALINGS = ("auto", "diagonal", None)
REFERENCE = "Kumar, Deepmala, Das: More on projected type iteration method and linear complementarity problem"


def row_scaling(problem: LCP, scaling: str | None, factor: float, coupling: float, sweep: str) -> FloatVector:
    """Return the diagonal of S, shape (n,): ones, factor/d, or θ/d with automatic θ; see `scaled_rows` for d."""
    if scaling is None:
        return np.ones(problem.own)
    return scaled_rows(problem, automatic_factors(problem.matrix, coupling, sweep) if scaling == "auto" else factor)


def check_scaling(algorithm: Algorithm, scaling: str | None, factor: float) -> None:
    """Raise unless the two options make sense, and make it together."""
    check_choice(algorithm, "scaling", SCALINGS)
    check_positive(algorithm, "scaling_factor")
    if scaling != "diagonal" and factor != 1.0:
        raise InvalidOption(
            f'{algorithm.name}: scaling_factor={factor!r} needs scaling="diagonal"; with {scaling!r} it does nothing'
        )


def clean_up_sweep(problem: LCP, z: FloatVector) -> FloatVector:
    """Return z after one projected Gauss–Seidel sweep: components that should be active are then at their bound."""
    from ...kernels import splitting_sweeps as kernels

    M = problem.matrix.csr_rows
    rows = kernels.packed(problem.q, problem.lower, problem.upper, inverse_residual_scale(problem.matrix))
    cleaned = problem.matrix.whole(z.copy())
    kernels.relaxation_sweep(M.indptr, row_splits(problem.matrix, False), M.indices, M.data, rows, 1.0, False, cleaned)
    return cleaned[: problem.own]


@dataclass(frozen=True, kw_only=True)
class ProjectedType(Algorithm):
    """(D/α + D + 2S⁻¹ − (β/α) L)(z⁺ − z) = −2 S⁻¹ r_S(z) by forward substitution, each component projected at once.

    Parameters
    ----------
    scaling : {"auto", "diagonal", None}
        Row scaling S: automatic, ``scaling_factor``/d_i with d_i the diagonal, or none (the paper). It changes the
        iteration, never the solutions. "auto" takes θ_i/d_i with θ_i from 0.9 to 2, so that the iteration is proved
        to converge for every H₊-matrix; so it is for "diagonal" with factor ≤ 1.
    scaling_factor : float
        θ of the diagonal scaling, > 0.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Paper notation: α₁ = relaxation α, β₁ = acceleration β, A = M, σ = q, λ = ζ₊ = z.

    On several ranks a sweep runs on all of them at once, with what the others had before it: L then has fewer entries,
    and the theorem holds for every such choice.
    """

    scaling: str | None = "auto"
    scaling_factor: float = 1.0
    sweep: str = "forward"

    assumption: ClassVar[str] = "d/α + d + 2 > 0"
    runs_on_ranks: ClassVar[bool] = True
    converges_on: ClassVar[str] = 'H₊ (scaling="auto", or "diagonal" with scaling_factor ≤ 1)'
    cost: ClassVar[str] = "1 pass"
    reference: ClassVar[str] = REFERENCE

    def __post_init__(self) -> None:
        check_scaling(self, self.scaling, self.scaling_factor)
        check_choice(self, "sweep", SWEEPS)

    def splitting(self) -> tuple[float, float]:
        """Return (α, β)."""
        raise NotImplementedError

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …; each with its residual, which the pass to the next iterate measures anyway."""
        from ...kernels import splitting_sweeps as kernels

        M, peers, own = problem.matrix.csr_rows, problem.peers, problem.own
        asks_peers = not peers.is_empty
        alpha, beta = self.splitting()
        step = row_scaling(problem, self.scaling, self.scaling_factor, beta / alpha, self.sweep)
        rows = kernels.packed(
            problem.q, problem.lower, problem.upper, inverse_residual_scale(problem.matrix), step,
            peers.together(lambda: self._inverse_pivot(problem, step * problem.diagonal, alpha)),
        )
        passes = directions(self.sweep)
        splits = {backward: row_splits(problem.matrix, backward) for backward in passes}
        z = problem.matrix.whole(z0)
        new = np.empty_like(z)

        def advance(backward: bool) -> tuple[float, float]:
            if asks_peers:
                peers.fetch(z)
                new[own:] = z[own:]  # what others hold is as it was
            norms: tuple[float, float] = kernels.splitting_sweep(
                M.indptr, splits[backward], M.indices, M.data, rows, beta / alpha, True, backward, z, new
            )
            return norms

        work = 1.0
        while True:
            residual, squares = advance(passes[0])
            euclidean = peers.total(squares)**0.5 if self.scaling is None else None
            yield Step(z[:own] if asks_peers else z, peers.largest(residual), euclidean, None, work)
            z, new = new, z
            for backward in passes[1:]:
                advance(backward)
                z, new = new, z
            work = float(len(passes))

    def facts(self, problem: LCP) -> IterationFacts:
        """Return α, β, S and the sweep; raise where a pivot is not positive."""
        alpha, beta = self.splitting()
        step = row_scaling(problem, self.scaling, self.scaling_factor, beta / alpha, self.sweep)
        self._inverse_pivot(problem, step * problem.diagonal, alpha)
        return IterationFacts(
            family=PROJECTED_TYPE, relaxation=alpha, acceleration=beta, sweep=self.sweep, scaling=step,
            is_scaled=self.scaling is not None,
        )

    def _inverse_pivot(self, problem: LCP, scaled_diagonal: FloatVector, alpha: float) -> FloatVector:
        with np.errstate(over="ignore", divide="ignore"):
            pivot = scaled_diagonal / alpha + scaled_diagonal + 2.0
            inverse: FloatVector = 1.0 / pivot
        if pivot.size and not pivot.min() > 0.0:
            i = int(np.flatnonzero(~(pivot > 0.0))[0])
            remedy = 'scaling="auto"'
            if self.scaling or alpha <= 1.0:
                remedy = f"npsor with {'' if self.scaling else remedy + ' and '}a relaxation above 1"
            raise UnsuitableMatrix(
                f"{self.name} needs d/α + d + 2 > 0 on every row, but M[{i}, {i}] = {problem.diagonal[i]} "
                f"gives {pivot[i]}; try {remedy}"
            )
        huge = np.isinf(pivot)
        inverse[huge] = 1.0 / scaled_diagonal[huge] / (1.0 / alpha + 1.0)
        return inverse

    def finish(self, problem: LCP, z: FloatVector) -> FloatVector:
        """Return z after one projected Gauss–Seidel sweep, so that active components are at their bound."""
        return clean_up_sweep(problem, z)


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
    The paper prints (α−β)U for (α−β)L + αU and αI + D for α(I + D); the formula above is what its
    Method 3.1 gives. Paper notation: α₁ = relaxation, β₁ = acceleration.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> lcp_plugin.solve(problem, "npaor", relaxation=1.5, acceleration=1.0).z.round(6)
    array([0.75, 0.  ])
    """

    name: ClassVar[str] = "npaor"
    converges_on: ClassVar[str] = 'H₊ for 0 ≤ β ≤ α (scaling="auto", or "diagonal" with scaling_factor ≤ 1)'
    relaxation: float = 1.7
    acceleration: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "relaxation")
        check_number(self, "acceleration")

    def splitting(self) -> tuple[float, float]:
        """Return (relaxation, acceleration)."""
        return self.relaxation, self.acceleration


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

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "relaxation")

    def splitting(self) -> tuple[float, float]:
        """Return (relaxation, relaxation)."""
        return self.relaxation, self.relaxation


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

    def splitting(self) -> tuple[float, float]:
        """Return (1, 1)."""
        return 1.0, 1.0


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
    converges_on: ClassVar[str] = "H₊"

    def splitting(self) -> tuple[float, float]:
        """Return (1, 0)."""
        return 1.0, 0.0
