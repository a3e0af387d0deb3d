"""The automatic relaxation of PSOR: raise ω as far as the observed contraction pays, never further."""

from __future__ import annotations

import math


class AdaptiveRelaxation:
    """ω from the size of the increments: Young's formula where it pays, Gauss–Seidel where it does not.

    On a consistently ordered symmetric positive definite matrix SOR with ω contracts by λ, where
    (λ + ω − 1)² = λ ω² μ², and ω* = 2/(1 + √(1 − μ²)) is best; μ is estimated from the observed λ after every
    stretch of sweeps. Safety: a stretch at ω > 1 that contracts no better than Gauss–Seidel did sends ω back
    to 1, and after `PATIENCE` such failures ω stays there. Every other stretch contracts at least as fast as
    Gauss–Seidel, so the iteration converges wherever projected Gauss–Seidel does: for every symmetric positive
    definite and every H₊-matrix.

    References
    ----------
    Hageman, Young: *Applied Iterative Methods*, Academic Press 1981, chapter 9.
    """

    PATIENCE = 3
    LARGEST = 1.998
    WORTHWHILE = 0.05  # smallest step towards 2, as a share of 2 − ω, that pays for a new transient

    def __init__(self) -> None:
        self.relaxation = 1.0
        self._gauss_seidel_rate = 1.0
        self._failures = 0
        self._sizes: list[float] = []
        self.is_settling = False

    def after(self, size: float) -> float:
        """Return ω for the next sweep, given Σ|z⁺ − z| of the last one.

        `is_settling` tells afterwards whether ω changed less than a stretch ago, when a rising residual says nothing.
        """
        if self._failures >= self.PATIENCE or not 0.0 < size < math.inf:
            self.is_settling = False
        else:
            self._sizes.append(size)
            if len(self._sizes) > self._stretch():
                before = self.relaxation
                self._judge(self._rate())
                self._sizes = [size]
                self.is_settling = self.relaxation != before
        return self.relaxation

    def _stretch(self) -> int:
        """Sweeps to watch before judging: an ω near 2 needs a few times 1/(2 − ω) of them to show its rate."""
        return 8 if self.relaxation == 1.0 else math.ceil(4.0 / (2.0 - self.relaxation)) + 8

    def _rate(self) -> float:
        """Contraction a sweep over the second half of the stretch; the first half is transient."""
        half = self._stretch() // 2
        rate: float = (self._sizes[-1] / self._sizes[-1 - half]) ** (1.0 / half)
        return rate

    def _judge(self, rate: float) -> None:
        omega = self.relaxation
        if omega == 1.0:
            self._gauss_seidel_rate = rate
        elif rate >= min(self._gauss_seidel_rate, 1.0):
            self._failures += 1
            self.relaxation = 1.0
            return
        if rate >= 1.0 or rate <= omega - 1.0:  # beyond the best ω the rate is ω − 1 and says nothing about μ
            return
        mu_squared = ((rate + omega - 1.0) / omega) ** 2 / rate
        if mu_squared < 1.0:
            best = min(2.0 / (1.0 + math.sqrt(1.0 - mu_squared)), self.LARGEST)
            if best > omega + self.WORTHWHILE * (2.0 - omega):
                self.relaxation = best
