"""Projected relaxation (P*): projected Jacobi, Gauss–Seidel, SOR and AOR, and the general fixed-point iteration."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..algorithm import SWEEPS, Step, check_positive, require_positive_diagonal
from ..checks import FloatVector
from ..errors import InvalidOption
from ..lcp import LCP
from ..matrix.iteration_facts import PROJECTED_RELAXATION, IterationFacts
from ..matrix.row_sums import inverse_residual_scale, row_splits
from . import Splitting

# The automatic relaxation of PSOR.
FIRST_WAIT, LONGEST_WAIT = 8, 4096
LARGEST = 1.998
WORTHWHILE = 0.05  # smallest step towards 2, as a share of 2 − ω, that pays for a new transient
RECORD = 0.9
LONGEST_TRIAL = 4  # periods
HUMP = (
    40.0  # times 1/(2 − ω): how far increments may rise during a trial that is still worth its end
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
        omega, beta = self.weights()
        return IterationFacts(
            family=PROJECTED_RELAXATION, relaxation=omega, acceleration=beta, sweep=self.sweep
        )

    def weights(self) -> tuple[float, float] | tuple[None, None]:
        """Return (ω, β); each is None if the run must determine it."""
        return self.splitting()


class _InPlace(_Relaxation):
    """z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii), w_i always current."""

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z₀, z₁, …, all in the same array; the increment shows when a residual is worth measuring."""
        from ..kernels import splitting_sweeps as kernels

        matrix, M = problem.matrix, problem.matrix.csr
        pivots = require_positive_diagonal(problem, self.name)
        fixed, _ = self.weights()
        adaptive = AdaptiveRelaxation() if fixed is None else None
        relaxation = 1.0 if fixed is None else fixed
        rows = kernels.pack_vectors(problem.q, problem.lower, problem.upper, 1.0 / pivots)
        passes = SWEEPS[self.sweep]
        splits = {backward: row_splits(matrix, backward) for backward in passes}
        z = z0
        yield Step(z, work=0.0)
        while True:
            largest = total = 0.0
            for backward in passes:
                change, change_sum = kernels.relaxation_sweep(
                    M.indptr, splits[backward], M.indices, M.data, rows, relaxation, backward, z
                )
                largest = change if not change <= largest else largest  # a NaN stays
                total += change_sum
            is_settling = adaptive is not None and adaptive.is_settling
            yield Step(
                z,
                increment=largest,
                work=float(len(passes)),
                is_settling=is_settling,
            )
            if adaptive:
                relaxation = adaptive.next_relaxation(total, z)


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

    def check_weights(self) -> None:
        """Raise unless ω is "auto" or in (0, 2)."""
        if not isinstance(self.relaxation, str):
            check_positive(self, "relaxation", below=2.0)
        elif self.relaxation != "auto":
            raise InvalidOption(
                f'psor: relaxation={self.relaxation!r} is neither a number in (0, 2) nor "auto"'
            )

    def weights(self) -> tuple[float, float] | tuple[None, None]:
        """Return (ω, ω), or None for each where ω is "auto"."""
        return (None, None) if isinstance(self.relaxation, str) else self.splitting()


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
        from ..kernels.splitting_sweeps import pack_vectors, splitting_sweep

        omega, beta = self.splitting()
        with np.errstate(over="ignore"):  # a step that overflows ends in DIVERGED
            step = omega / require_positive_diagonal(problem, self.name)
        rows = pack_vectors(
            problem.q,
            problem.lower,
            problem.upper,
            inverse_residual_scale(problem.matrix),
            step,
            np.ones(problem.n),
        )
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


class AdaptiveRelaxation:
    """Automatic choice of ω by trials, measured by the increments Σ|z⁺ − z|; a trial that does not pay is undone.

    A phase of Gauss–Seidel sweeps measures the contraction λ. On a consistently ordered symmetric positive definite
    matrix, SOR with ω contracts by λ with (λ + ω − 1)² = λ ω² μ², and ω* = 2/(1 + √(1 − μ²)) is best. A trial with that
    ω lasts a few times 1/(2 − ω) sweeps, longer while its increments are still large, and ends with one Gauss–Seidel
    sweep. If the increment of this sweep is a new record (0.9 of the last), the trial is accepted, μ is estimated
    again, and the next trial begins. Otherwise z returns to the start of the trial, and the next Gauss–Seidel phase is
    twice as long.

    So the iteration converges wherever projected Gauss–Seidel does. Either infinitely many trials are kept: then
    the increments of a Gauss–Seidel sweep fall to 0, and they vanish at solutions only. Or from some point on
    all trials are undone: the remaining iteration is Gauss–Seidel.

    References
    ----------
    Hageman, Young: *Applied Iterative Methods*, Academic Press 1981, chapter 9.
    """

    def __init__(self) -> None:
        self.relaxation = self._omega = 1.0
        self._wait = FIRST_WAIT
        self._record = math.inf
        self._sizes: list[float] = []
        self._checkpoint: FloatVector | None = None
        self._is_final_sweep = False

    @property
    def is_settling(self) -> bool:
        """True if a trial is running: a rising residual is then not a sign of divergence."""
        return self._checkpoint is not None

    def next_relaxation(self, size: float, z: FloatVector) -> float:
        """Return ω for the next sweep, given Σ|z⁺ − z| of the last sweep; z is restored after a failed trial."""
        self._sizes.append(size)
        if self._checkpoint is None:
            if len(self._sizes) >= self._wait:
                self._end_phase(z)
        elif self._is_final_sweep:
            self._end_trial(size, z)
        elif not size <= self._record * HUMP / (2.0 - self._omega):
            self._undo(z)
        elif self._is_time_to_prove(size):
            self._is_final_sweep = True
            self.relaxation = 1.0
        return self.relaxation

    def _is_time_to_prove(self, size: float) -> bool:
        """Return whether the trial has lasted one period, or four periods if its increments are still large."""
        period = math.ceil(4.0 / (2.0 - self._omega)) + 8
        sweeps = len(self._sizes)
        return sweeps >= period and (
            size <= RECORD * self._record or sweeps >= LONGEST_TRIAL * period
        )

    def _end_phase(self, z: FloatVector) -> None:
        """Begin a trial where Gauss–Seidel contracts and a larger ω could do better; else another phase."""
        rate = self._rate(self._sizes)
        self._record = min(self._record, self._sizes[-1])
        self._omega = best_relaxation(rate, 1.0)
        if self._omega > 1.0 + WORTHWHILE and self._record > 0.0:
            self._begin_trial(z)
        else:
            self._wait = min(2 * self._wait, LONGEST_WAIT)
            self._sizes = []

    def _begin_trial(self, z: FloatVector) -> None:
        self._checkpoint = z.copy()
        self._sizes = []
        self._is_final_sweep = False
        self.relaxation = self._omega

    def _end_trial(self, size: float, z: FloatVector) -> None:
        if not size <= RECORD * self._record:
            self._undo(z)
            return
        self._record, self._wait = size, FIRST_WAIT
        wanted = best_relaxation(self._rate(self._sizes[:-1]), self._omega)
        if wanted > self._omega + WORTHWHILE * (2.0 - self._omega):
            self._omega = wanted
        self._begin_trial(z)

    def _undo(self, z: FloatVector) -> None:
        if self._checkpoint is not None:
            np.copyto(z, self._checkpoint)
        self._checkpoint, self._sizes, self.relaxation = None, [], 1.0
        self._wait = min(2 * self._wait, LONGEST_WAIT)

    @staticmethod
    def _rate(sizes: list[float]) -> float:
        """Return the contraction per sweep over the second half of the sweeps; the first half is transient."""
        half = len(sizes) // 2
        if not sizes[-1 - half] > 0.0:
            return 0.0
        rate: float = (sizes[-1] / sizes[-1 - half]) ** (1.0 / half)
        return rate


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
    return min(2.0 / (1.0 + math.sqrt(1.0 - mu_squared)), LARGEST) if mu_squared < 1.0 else omega
