"""Projected relaxation (P*): projected Jacobi, Gauss–Seidel, SOR and AOR, and the general fixed-point iteration."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..algorithm import SWEEPS, Step, check_choice, check_positive, require_positive_diagonal
from ..checks import FloatVector
from ..errors import InvalidOption
from ..lcp import LCP
from ..matrix.iteration_facts import PROJECTED_RELAXATION, IterationFacts
from ..matrix.row_sums import inverse_residual_scale, row_splits
from . import Splitting

FIRST_WAIT = 8  # sweeps of a first phase of Gauss–Seidel
WORTHWHILE = (
    0.05  # smallest step of ω towards 2, as a share of 2 − ω, that pays for a new transient
)


@dataclass(frozen=True, kw_only=True)
class _Relaxation(Splitting):
    """z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii)."""

    needs: ClassVar[str] = "positive diagonal"
    solves: ClassVar[str] = "H₊"
    reference: ClassVar[str] = (
        "Cryer 1971, doi:10.1137/0309028; Mangasarian 1977, doi:10.1007/BF01268170"
    )

    sweep: str = "forward"

    def facts(self, problem: LCP) -> IterationFacts:
        """Return ω and β, None if they are determined during the run, and the sweep."""
        require_positive_diagonal(problem, self.name)
        is_automatic = getattr(self, "relaxation", None) == "auto"
        omega, beta = (None, None) if is_automatic else self.weights()
        return IterationFacts(
            family=PROJECTED_RELAXATION, relaxation=omega, acceleration=beta, sweep=self.sweep
        )


class _InPlace(_Relaxation):
    """z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii), w_i always current."""

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …, all in the same array; the increment shows when a residual is worth measuring."""
        from ..kernels import splitting_sweeps as kernels

        matrix, M = problem.matrix, problem.matrix.csr
        pivots = require_positive_diagonal(problem, self.name)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, 1.0 / pivots])
        passes = SWEEPS[self.sweep]
        splits = {backward: row_splits(matrix, backward) for backward in passes}
        z, work = z0, float(len(passes))

        def sweep(relaxation: float, *, is_settling: bool = False) -> tuple[Step, float]:
            """Return the step of a sweep, and Σ|z⁺ − z|."""
            largest = total = 0.0
            for backward in passes:
                change, change_sum = kernels.relaxation_sweep(
                    M.indptr, splits[backward], M.indices, M.data, rows, relaxation, backward, z
                )
                largest = change if not change <= largest else largest  # a NaN stays
                total += change_sum
            return Step(z, increment=largest, work=work, is_settling=is_settling), total

        yield Step(z, work=0.0)
        if getattr(self, "relaxation", None) == "auto":
            yield from adaptive_sweeps(sweep, z)
        relaxation, _ = self.weights()
        while True:
            yield sweep(relaxation)[0]


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
    solves: ClassVar[str] = "SPD for ω < 2, H₊ for ω < 2/(1+ρ); the automatic ω on both"

    relaxation: float | str = "auto"

    def __post_init__(self) -> None:
        check_choice(self, "sweep", [*SWEEPS])
        if not isinstance(self.relaxation, str):
            check_positive(self, "relaxation", below=2.0)
        elif self.relaxation != "auto":
            raise InvalidOption(
                f'psor: relaxation={self.relaxation!r} is neither a number in (0, 2) nor "auto"'
            )


@dataclass(frozen=True, kw_only=True)
class PGS(_InPlace):
    """PGS, projected Gauss–Seidel: PSOR with ω = 1.

    Parameters
    ----------
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "pgs"
    solves: ClassVar[str] = "SPD, H₊"


class _Simultaneous(_Relaxation):
    """z⁺ = mid(lower, upper, z − D⁻¹(ω w + β Σ m_ij (z⁺_j − z_j))), the sum over the rows done before row i."""

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …, each with its residual."""
        from ..kernels.splitting_sweeps import splitting_sweep

        omega, beta = self.weights()
        step = omega / require_positive_diagonal(problem, self.name)
        inverse_scale, ones = inverse_residual_scale(problem.matrix), np.ones(problem.n)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, inverse_scale, step, ones])
        yield from self.swept(problem, splitting_sweep, rows, (beta / omega, False), z0)


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
    solves: ClassVar[str] = "H₊ for 0 ≤ β ≤ ω < 2/(1+ρ)"

    relaxation: float = 1.0
    acceleration: float = 0.5


@dataclass(frozen=True, kw_only=True)
class PJ(_Simultaneous):
    """PJ, projected Jacobi: z⁺ = mid(lower, upper, z − D⁻¹ w).

    Parameters
    ----------
    sweep : {"forward", "backward", "symmetric"}
        Symmetric does two Jacobi steps in one iteration; otherwise the order does not matter.
    """

    name: ClassVar[str] = "pj"
    is_coupled: ClassVar[bool] = False


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
    is_coupled: ClassVar[bool] = False
    solves: ClassVar[str] = "H₊ for ω < 2/(1+ρ)"
    reference: ClassVar[str] = "Fang 2021, doi:10.3934/math.2021691"

    relaxation: float = 1.0


def adaptive_sweeps(sweep: Callable[..., tuple[Step, float]], z: FloatVector) -> Iterator[Step]:
    """Yield sweeps with automatic ω by trials, measured by the increments Σ|z⁺ − z|.

    A phase of Gauss–Seidel sweeps measures the contraction λ. On a consistently ordered symmetric positive definite
    matrix, SOR with ω contracts by λ with (λ + ω − 1)² = λ ω² μ², and ω* = 2/(1 + √(1 − μ²)) is best. A trial with that
    ω lasts a few times 1/(2 − ω) sweeps, longer while its increments are still large, and ends with one Gauss–Seidel
    sweep. If the increment of this sweep is a new record (0.9 of the last), the trial is accepted, μ is estimated
    again, and the next trial begins. Otherwise z returns to the start of the trial, and the next Gauss–Seidel phase is
    twice as long.

    So the iteration converges wherever projected Gauss–Seidel does. Either infinitely many trials are kept: then
    the increments of a Gauss–Seidel sweep fall to 0, and they vanish at solutions only. Or from some point on
    all trials are undone: the remaining iteration is Gauss–Seidel.

    Parameters
    ----------
    sweep : callable
        Returns the step of a sweep of z with a relaxation, and Σ|z⁺ − z|.
    z : ndarray, shape (n,)
        Overwritten by each sweep.

    References
    ----------
    Hageman, Young: *Applied Iterative Methods*, Academic Press 1981, chapter 9.
    """
    wait, record = FIRST_WAIT, math.inf
    while True:
        sizes: list[float] = []
        while len(sizes) < wait:
            step, size = sweep(1.0)
            sizes.append(size)
            yield step
        record = min(record, size)
        omega = best_relaxation(contraction(sizes), 1.0)
        is_promising = omega > 1.0 + WORTHWHILE and record > 0.0
        while is_promising:
            before, sizes, is_over, is_lost = z.copy(), [], False, False
            period = math.ceil(4.0 / (2.0 - omega)) + 8
            while not (is_over or is_lost):
                step, size = sweep(omega, is_settling=True)
                sizes.append(size)
                yield step
                # Increments may rise during a trial that is still worth its end, but not without limit.
                is_lost = not size <= 40.0 / (2.0 - omega) * record
                is_long = len(sizes) >= 4 * period
                is_over = is_long or (len(sizes) >= period and size <= 0.9 * record)
            if not is_lost:
                step, size = sweep(1.0, is_settling=True)
                yield step
            is_promising = not is_lost and size <= 0.9 * record
            if is_promising:
                record, wait = size, FIRST_WAIT
                wanted = best_relaxation(contraction(sizes), omega)
                if wanted > omega + WORTHWHILE * (2.0 - omega):
                    omega = wanted
            else:
                np.copyto(z, before)
        wait = min(2 * wait, 4096)


def contraction(sizes: list[float]) -> float:
    """Return the contraction per sweep over the second half of the increments; the first half is transient."""
    half = len(sizes) // 2
    if not sizes[-1 - half] > 0.0:
        return 0.0
    return float((sizes[-1] / sizes[-1 - half]) ** (1.0 / half))


def best_relaxation(rate: float, omega: float) -> float:
    """Return ω* by Young's formula from the contraction observed at ω, or ω itself if the formula does not apply.

    Examples
    --------
    >>> round(best_relaxation(0.96, 1.0), 3)
    1.667
    """
    if not omega - 1.0 < rate < 1.0:  # beyond ω* the rate is ω − 1, for any μ
        return omega
    mu_squared = ((rate + omega - 1.0) / omega) ** 2 / rate
    return min(2.0 / (1.0 + math.sqrt(1.0 - mu_squared)), 1.998) if mu_squared < 1.0 else omega
