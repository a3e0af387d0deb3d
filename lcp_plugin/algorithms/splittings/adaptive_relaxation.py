"""The automatic relaxation of PSOR: try a larger ω from a checkpoint, keep what it gained, undo what it spoiled."""

from __future__ import annotations

import math

import numpy as np

from ...checks import FloatVector

FIRST_WAIT, LONGEST_WAIT = 8, 4096
LARGEST = 1.998
WORTHWHILE = 0.05  # smallest step towards 2, as a share of 2 − ω, that pays for a new transient
RECORD = 0.9
LONGEST_TRIAL = 4  # stretches
HUMP = 40.0  # times 1/(2 − ω): how far increments may rise during a trial that is still worth its end


class AdaptiveRelaxation:
    """ω from the size Σ|z⁺ − z| of the increments, by trials that are undone where they do not pay.

    A phase of Gauss–Seidel sweeps measures the contraction λ. On a consistently ordered symmetric positive
    definite matrix SOR with ω contracts by λ with (λ + ω − 1)² = λ ω² μ², and ω* = 2/(1 + √(1 − μ²)) is best.
    A trial with that ω lasts a few times 1/(2 − ω) sweeps, longer while its increments are still large, and ends
    with one Gauss–Seidel sweep. If its
    increment is a new record (0.9 of the last), the trial is kept, μ is estimated anew, and the next one
    begins; otherwise z goes back to where the trial began and the next Gauss–Seidel phase is twice as long.

    So the iteration converges wherever projected Gauss–Seidel does. Either infinitely many trials are kept: then
    the increments of a Gauss–Seidel sweep fall to 0, and they vanish at solutions only. Or from some point on
    all trials are undone: then what remains is Gauss–Seidel itself.

    References
    ----------
    Hageman, Young: *Applied Iterative Methods*, Academic Press 1981, chapter 9.
    """

    def __init__(self) -> None:
        self.relaxation = 1.0
        self._omega = 1.0
        self._wait = FIRST_WAIT
        self._record = math.inf
        self._sizes: list[float] = []
        self._checkpoint: FloatVector | None = None
        self._is_final_sweep = False

    @property
    def is_settling(self) -> bool:
        """Whether a trial is under way: a residual that rises now says nothing."""
        return self._checkpoint is not None

    def after(self, size: float, z: FloatVector) -> float:
        """Return ω for the next sweep, given Σ|z⁺ − z| of the last one; z is put back where a trial failed."""
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
        """Return whether the trial has had its time, or three times as long where its increments are still large."""
        stretch = math.ceil(4.0 / (2.0 - self._omega)) + 8
        sweeps = len(self._sizes)
        return sweeps >= stretch and (size <= RECORD * self._record or sweeps >= LONGEST_TRIAL * stretch)

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
        """Return the contraction a sweep over the second half; the first half is transient."""
        half = len(sizes) // 2
        if not sizes[-1 - half] > 0.0:
            return 0.0
        rate: float = (sizes[-1] / sizes[-1 - half]) ** (1.0 / half)
        return rate


def best_relaxation(rate: float, omega: float) -> float:
    """Return ω* by Young's formula from the contraction observed at ω, or ω itself where that tells nothing.

    Examples
    --------
    >>> round(best_relaxation(0.96, 1.0), 3)
    1.667
    """
    if not omega - 1.0 < rate < 1.0:  # beyond ω* the rate is ω − 1, whatever μ
        return omega
    mu_squared = ((rate + omega - 1.0) / omega) ** 2 / rate
    return min(2.0 / (1.0 + math.sqrt(1.0 - mu_squared)), LARGEST) if mu_squared < 1.0 else omega
