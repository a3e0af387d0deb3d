"""P*: projected Jacobi, Gauss–Seidel, SOR and AOR, and the general fixed-point iteration."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...certificates.convergence import PROJECTED_RELAXATION, IterationFacts
from ...checks import FloatVector
from ...crossovers import PSOR_GAIN, PSOR_PASSES
from ...errors import InvalidOption
from ...matrix.pivots import pivot_weight
from ...matrix.symmetry import has_symmetric_entries
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
    require_positive_diagonal,
    row_splits,
)
from .adaptive_relaxation import AdaptiveRelaxation

CRYER = "Cryer 1971, doi:10.1137/0309028; Mangasarian 1977, doi:10.1007/BF01268170"


@dataclass(frozen=True, kw_only=True)
class _InPlace(Algorithm):
    """z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii), w_i always current.

    On several ranks a sweep runs on all of them at once, with what the others had before it. That is a splitting with
    fewer entries of L, which converges on H₊-matrices with ω ≤ 1; where M is symmetric, pivots beside other ranks are
    made larger, so that it converges on every positive definite one, see `pivot_weight`.
    """

    assumption: ClassVar[str] = "positive diagonal"
    cost: ClassVar[str] = "1 pass"
    reference: ClassVar[str] = CRYER
    runs_on_ranks: ClassVar[bool] = True

    sweep: str = "forward"

    def __post_init__(self) -> None:
        check_choice(self, "sweep", SWEEPS)

    def fixed_relaxation(self) -> float | None:
        """Return ω, or None where it is to be found during the run."""
        raise NotImplementedError

    def facts(self, problem: LCP) -> IterationFacts:
        """Return ω, None where it is found during the run, and the sweep."""
        require_positive_diagonal(problem, self.name)
        fixed = self.fixed_relaxation()
        return IterationFacts(
            family=PROJECTED_RELAXATION, relaxation=fixed, acceleration=fixed, sweep=self.sweep
        )

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …, all in the same array; the increment tells when a residual is worth measuring."""
        from ...kernels import splitting_sweeps as kernels

        M, peers = problem.matrix.csr_rows, problem.peers
        pivots = require_positive_diagonal(problem, self.name)
        fixed = self.fixed_relaxation()
        adaptive = AdaptiveRelaxation() if fixed is None else None
        relaxation = 1.0 if fixed is None else fixed
        if not peers.is_empty and has_symmetric_entries(problem.matrix):
            pivots = pivots + pivot_weight(M, peers, relaxation)
        rows = kernels.packed(problem.q, problem.lower, problem.upper, 1.0 / pivots)
        passes = directions(self.sweep)
        splits = {backward: row_splits(problem.matrix, backward) for backward in passes}
        z = problem.matrix.whole(z0)
        own = z[: problem.own]
        yield Step(own, work=0.0)
        while True:
            largest = total = 0.0
            for backward in passes:
                peers.fetch(z)
                change, change_sum = kernels.relaxation_sweep(
                    M.indptr, splits[backward], M.indices, M.data, rows, relaxation, backward, z
                )
                largest = change if not change <= largest else largest  # a NaN stays
                total += change_sum
            is_settling = adaptive is not None and adaptive.is_settling
            yield Step(own, increment=peers.largest(largest), work=float(len(passes)), is_settling=is_settling)
            if adaptive:
                relaxation = adaptive.after(peers.total(total), z)


@dataclass(frozen=True, kw_only=True)
class PSOR(_InPlace):
    """PSOR, projected successive overrelaxation: z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii), w_i always current.

    Parameters
    ----------
    relaxation : float or "auto"
        ω in (0, 2), or found during the run by trials that are undone where they do not pay, so that it
        converges wherever Gauss–Seidel does.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Converges for symmetric positive definite M (0 < ω < 2) and for H₊-matrices (0 < ω < 2/(1 + ρ),
    ρ the spectral radius of D⁻¹|L + U|).
    """

    name: ClassVar[str] = "psor"
    converges_on: ClassVar[str] = "SPD for ω < 2, H₊ for ω < 2/(1+ρ), both for auto"

    relaxation: float | str = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.relaxation, str):
            check_positive(self, "relaxation", below=2.0)
        elif self.relaxation != "auto":
            raise InvalidOption(f'psor: relaxation={self.relaxation!r} is neither a number in (0, 2) nor "auto"')

    def predicted_passes(self, problem: LCP, sweeps: float) -> float:
        """Return a multiple of the root of npsor's, as relaxation has it at best, and some in any case."""
        return max(PSOR_PASSES, PSOR_GAIN * math.sqrt(sweeps))

    def fixed_relaxation(self) -> float | None:
        """Return ω, or None for "auto"."""
        return None if isinstance(self.relaxation, str) else float(self.relaxation)


@dataclass(frozen=True, kw_only=True)
class PGS(_InPlace):
    """PGS, projected Gauss–Seidel: PSOR with ω = 1.

    Parameters
    ----------
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "pgs"
    converges_on: ClassVar[str] = "SPD, H₊"

    def fixed_relaxation(self) -> float | None:
        """Return 1."""
        return 1.0


@dataclass(frozen=True, kw_only=True)
class _Simultaneous(Algorithm):
    """z⁺ = mid(lower, upper, z − D⁻¹(ω w + β Σ m_ij (z⁺_j − z_j))), the sum over the rows done before row i."""

    assumption: ClassVar[str] = "positive diagonal"
    cost: ClassVar[str] = "1 pass"
    sweep: str = "forward"

    def __post_init__(self) -> None:
        check_choice(self, "sweep", SWEEPS)

    def weights(self) -> tuple[float, float]:
        """Return (ω, β)."""
        raise NotImplementedError

    def facts(self, problem: LCP) -> IterationFacts:
        """Return ω, β and the sweep."""
        require_positive_diagonal(problem, self.name)
        omega, beta = self.weights()
        return IterationFacts(family=PROJECTED_RELAXATION, relaxation=omega, acceleration=beta, sweep=self.sweep)

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …, each with its residual."""
        from ...kernels import splitting_sweeps as kernels

        M = problem.csr
        omega, beta = self.weights()
        with np.errstate(over="ignore"):  # a step that overflows ends in DIVERGED
            step = omega / require_positive_diagonal(problem, self.name)
        rows = kernels.packed(
            problem.q, problem.lower, problem.upper, inverse_residual_scale(problem.matrix), step, np.ones(problem.n)
        )
        passes = directions(self.sweep)
        splits = {backward: row_splits(problem.matrix, backward) for backward in passes}
        z, new = z0, np.empty_like(z0)
        work = 1.0
        while True:
            for k, backward in enumerate(passes):
                residual, _ = kernels.splitting_sweep(
                    M.indptr, splits[backward], M.indices, M.data, rows, beta / omega, False, backward, z, new
                )
                if k == 0:
                    yield Step(z, residual, work=work)
                z, new = new, z
            work = float(len(passes))


@dataclass(frozen=True, kw_only=True)
class PAOR(_Simultaneous):
    """PAOR, projected accelerated overrelaxation: ω weighs the residual, β what is already updated.

    Parameters
    ----------
    relaxation : float
        ω > 0.
    acceleration : float
        β; PAOR(ω, ω) is PSOR(ω), PAOR(1, 0) projected Jacobi.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "paor"
    converges_on: ClassVar[str] = "H₊ for 0 ≤ β ≤ ω < 2/(1+ρ)"
    reference: ClassVar[str] = CRYER

    relaxation: float = 1.0
    acceleration: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "relaxation")
        check_number(self, "acceleration")

    def weights(self) -> tuple[float, float]:
        """Return (relaxation, acceleration)."""
        return float(self.relaxation), float(self.acceleration)


@dataclass(frozen=True, kw_only=True)
class PJ(_Simultaneous):
    """PJ, projected Jacobi: z⁺ = mid(lower, upper, z − D⁻¹ w).

    Parameters
    ----------
    sweep : {"forward", "backward", "symmetric"}
        Symmetric does two Jacobi steps in one iteration; otherwise the order does not matter.
    """

    name: ClassVar[str] = "pj"
    converges_on: ClassVar[str] = "H₊"
    reference: ClassVar[str] = CRYER

    def weights(self) -> tuple[float, float]:
        """Return (1, 0)."""
        return 1.0, 0.0


@dataclass(frozen=True, kw_only=True)
class GFP(_Simultaneous):
    """GFP, general fixed point: z⁺ = mid(lower, upper, z − Ω (M z + q)) with Ω = ω D⁻¹.

    Parameters
    ----------
    relaxation : float
        ω > 0.
    sweep : {"forward", "backward", "symmetric"}
        Symmetric does two fixed-point steps in one iteration; otherwise the order does not matter.

    Notes
    -----
    On the classical problem z = max(0, z − Ω w) is the same as (I + ΩM) z = |(ΩM − I) z + Ωq| − Ωq.
    """

    name: ClassVar[str] = "gfp"
    converges_on: ClassVar[str] = "H₊ for ω < 2/(1+ρ)"
    reference: ClassVar[str] = "Fang 2021, doi:10.3934/math.2021691"

    relaxation: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "relaxation")

    def weights(self) -> tuple[float, float]:
        """Return (relaxation, 0)."""
        return float(self.relaxation), 0.0
