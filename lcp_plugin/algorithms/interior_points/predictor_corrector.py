"""One iterate of an infeasible interior point for a monotone box problem, and the step to the next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...checks import BoolVector, FloatVector
from .newton_matrix import NewtonMatrix

TO_THE_BOUNDARY = 0.995
CENTRAL = (0.1, 10.0)  # products outside this share of the target are corrected
WORTH_A_CORRECTION = 1.05
SHORT = 0.1
SMALLEST = 1e-300
INSIDE = 1.5  # times the worst violation is what the start is shifted by
LARGEST_CENTRING = 1e3
SHARP = 0.01  # share of the infeasibility that a linear system may leave


@dataclass
class Direction:
    """A change of z, of the distances to both bounds, and of both parts of w."""

    z: FloatVector
    below: FloatVector
    above: FloatVector
    w_lower: FloatVector
    w_upper: FloatVector


class PredictorCorrector:
    """M z + q = w_lower − w_upper, distances to the bounds and their multipliers positive, products driven to 0.

    Attributes
    ----------
    z : ndarray, shape (n,)
    below, w_lower : ndarray
        Distance to the lower bound and the positive part of w, on the rows of `has_lower`.
    above, w_upper : ndarray
        The same for the upper bounds, on the rows of `has_upper`.
    length : float
        Share of the last direction that was taken.
    infeasibility : float
        The largest |M z + q − w_lower + w_upper| before the last step.
    """

    def __init__(
        self, matrix: NewtonMatrix, q: FloatVector, lower: FloatVector, upper: FloatVector, corrections: int
    ) -> None:
        self.matrix, self.q, self.corrections = matrix, q, corrections
        self.length, self.infeasibility = 0.0, np.inf
        self._is_program = bool((matrix.signs < 0.0).any())
        self.has_lower, self.has_upper = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
        self.lower, self.upper = lower[self.has_lower], upper[self.has_upper]
        self._pairs = self.has_lower.size + self.has_upper.size
        self._both = np.isin(self.has_lower, self.has_upper), np.isin(self.has_upper, self.has_lower)

    def start(self, weight: float) -> bool:
        """Begin well inside, where M z + q = weight (anchor − z); return False where that cannot be factorised.

        A good weight is the size of w beside that of z; where z is a multiplier of a program, that of z beside w. With
        another one the first steps are short.
        """
        n = self.q.size
        weights, anchor, every = np.zeros(n), np.zeros(n), weight**self.matrix.signs
        for rows in (self.has_lower, self.has_upper):
            weights[rows] = every[rows]
        anchor[self.has_upper] = self.upper
        anchor[self.has_lower] = self.lower
        middle = self._both
        anchor[self.has_lower[middle[0]]] = 0.5 * (self.lower[middle[0]] + self.upper[middle[1]])
        if not self.matrix.factorise(weights):
            return False
        # What one side lacks, the other has.
        z = self.matrix.solve(weights * anchor - self.q)
        self._begin(z, weights * (anchor - z))
        return bool(np.isfinite(z).all())

    def _begin(self, z: FloatVector, w: FloatVector) -> None:
        """Begin near z and w, shape (n,), with all distances and multipliers well inside."""
        self.below, self.above = z[self.has_lower] - self.lower, self.upper - z[self.has_upper]
        self.w_lower, self.w_upper = w[self.has_lower], -w[self.has_upper]
        if self._is_program:
            self._shift_roles()
        else:
            for sides in ((self.below, self.above), (self.w_lower, self.w_upper)):
                typical = _typical(*sides)
                for values in sides:
                    np.maximum(values, typical, out=values)
        both_lower, both_upper = self._both
        half = 0.5 * (self.upper[both_upper] - self.lower[both_lower])
        self.below[both_lower] = np.minimum(self.below[both_lower], half)
        self.above[both_upper] = np.minimum(self.above[both_upper], half)
        self.z = z.copy()
        self.z[self.has_upper] = self.upper - self.above
        self.z[self.has_lower] = self.lower + self.below

    def _shift_roles(self) -> None:
        """Apply Mehrotra's shifts, one to what is primal in a program, one to what is dual."""
        is_dual = self.matrix.signs < 0.0  # where z is a multiplier, w is a distance
        lower, upper = is_dual[self.has_lower], is_dual[self.has_upper]
        parts = self.below, self.above, self.w_lower, self.w_upper
        of_roles = (~lower, ~upper, lower, upper), (lower, upper, ~lower, ~upper)
        roles = [tuple(zip(parts, of_role, strict=True)) for of_role in of_roles]
        sums = [_shifted(role, -INSIDE * min(float(part[of].min(initial=0.0)) for part, of in role)) for role in roles]
        product = float(self.below @ self.w_lower + self.above @ self.w_upper)
        for role, others in zip(roles, reversed(sums), strict=True):
            _shifted(role, 0.5 * product / others if 0.0 < product < np.inf and others > 0.0 else 1.0)

    @property
    def gap(self) -> float:
        """The mean product of a distance and its multiplier."""
        return float(self.below @ self.w_lower + self.above @ self.w_upper) / max(self._pairs, 1)

    def step(self) -> bool:
        """Make one predictor–corrector step; return False where nothing can be factorised or is finite any more."""
        self._remember_residuals()
        diagonal = np.zeros(self.q.size)
        with np.errstate(over="ignore"):
            diagonal[self.has_lower] += self.w_lower / self.below
            diagonal[self.has_upper] += self.w_upper / self.above
        if not np.isfinite(diagonal).all() or not self.matrix.factorise(diagonal):
            return False
        gap = self.gap
        affine = self._direction(np.zeros_like(self.below), np.zeros_like(self.above))
        length = self._length(affine)
        centring = (self._gap_after(affine, min(1.0, length)) / gap) ** 3 if gap > 0.0 else 0.0
        direction, length = self._towards(centring * gap, affine, 1.0 if length > SHORT else length)
        if length <= SHORT and self._is_program:
            # What is infeasible has become small more slowly than the gap: first larger products, then less of it.
            # (Where M is no program's there may be no solution, and products would grow beyond all bounds.)
            self._r *= SHARP
            centring = min(1.0 / max(length, SMALLEST), LARGEST_CENTRING)
            direction, length = self._towards(centring * gap, affine, length)
        self.length = min(1.0, TO_THE_BOUNDARY * length)
        if self._is_program and self.matrix.missed > SHARP * self.infeasibility:
            self.matrix.sharpen()
        self._move(direction, self.length)
        return bool(np.isfinite(self.z).all())

    def _towards(self, target: float, affine: Direction, weight: float) -> tuple[Direction, float]:
        """Return the corrected direction to products of that size, and how far it can be followed."""
        lower = target - weight * affine.below * affine.w_lower
        upper = target - weight * affine.above * affine.w_upper
        direction = self._direction(lower, upper)
        length = self._length(direction)
        for _ in range(self.corrections):
            lower, upper, better, longer = self._corrected(lower, upper, direction, length, target)
            if longer < WORTH_A_CORRECTION * length:
                break
            direction, length = better, longer
        return direction, length

    def _remember_residuals(self) -> None:
        self._r = self.matrix.M @ self.z + self.q
        self._r[self.has_lower] -= self.w_lower
        self._r[self.has_upper] += self.w_upper
        self.infeasibility = float(np.max(np.abs(self._r), initial=0.0))
        self._r_lower = self.z[self.has_lower] - self.lower - self.below
        self._r_upper = self.upper - self.z[self.has_upper] - self.above

    def _direction(self, lower: FloatVector, upper: FloatVector) -> Direction:
        """Return the Newton direction to products `lower` and `upper`."""
        right = -self._r
        to_lower, to_upper = lower / self.below - self.w_lower, upper / self.above - self.w_upper
        slope_lower, slope_upper = self.w_lower / self.below, self.w_upper / self.above
        right[self.has_lower] += to_lower - slope_lower * self._r_lower
        right[self.has_upper] -= to_upper - slope_upper * self._r_upper
        z = self.matrix.solve(right)
        below, above = z[self.has_lower] + self._r_lower, self._r_upper - z[self.has_upper]
        return Direction(z, below, above, to_lower - slope_lower * below, to_upper - slope_upper * above)

    def _corrected(
        self, lower: FloatVector, upper: FloatVector, direction: Direction, length: float, target: float
    ) -> tuple[FloatVector, FloatVector, Direction, float]:
        """Return Gondzio's correction: products that a longer step would leave far from the target are pulled in."""
        trial = min(1.0, 1.1 * length + 0.1)
        products = (self.below + trial * direction.below) * (self.w_lower + trial * direction.w_lower)
        lower = lower + _pull(products, target)
        products = (self.above + trial * direction.above) * (self.w_upper + trial * direction.w_upper)
        upper = upper + _pull(products, target)
        better = self._direction(lower, upper)
        return lower, upper, better, self._length(better)

    def _length(self, direction: Direction) -> float:
        """Return the longest step, at most 1/TO_THE_BOUNDARY, that keeps everything positive."""
        steepest = TO_THE_BOUNDARY
        for value, change in self._positive_parts(direction):
            if value.size:
                steepest = max(steepest, float(np.max(-change / value)))
        return 1.0 / steepest

    def _gap_after(self, direction: Direction, length: float) -> float:
        products = (self.below + length * direction.below) @ (self.w_lower + length * direction.w_lower)
        products += (self.above + length * direction.above) @ (self.w_upper + length * direction.w_upper)
        return max(float(products), 0.0) / max(self._pairs, 1)

    def _move(self, direction: Direction, length: float) -> None:
        self.z += length * direction.z
        for value, change in self._positive_parts(direction):
            np.maximum(value + length * change, SMALLEST, out=value)

    def _positive_parts(self, direction: Direction) -> tuple[tuple[FloatVector, FloatVector], ...]:
        return (
            (self.below, direction.below), (self.w_lower, direction.w_lower),
            (self.above, direction.above), (self.w_upper, direction.w_upper),
        )


def _typical(first: FloatVector, second: FloatVector) -> float:
    """Return the root mean square of both, and no less than a hundredth of the largest."""
    values = np.abs(np.concatenate([first, second]))
    largest = float(values.max(initial=0.0))
    if largest == 0.0:
        return 1.0
    return max(largest * float(np.sqrt(np.mean((values / largest) ** 2))), 0.01 * largest)


def _shifted(role: Iterable[tuple[FloatVector, BoolVector]], by: float) -> float:
    """Add to the values of one role, each part of which says where it has it; return their sum."""
    total = 0.0
    for part, of in role:
        part[of] += by
        total += float(part[of].sum())
    return total


def _pull(products: FloatVector, target: float) -> FloatVector:
    wanted = np.clip(products, CENTRAL[0] * target, CENTRAL[1] * target)
    pull: FloatVector = np.maximum(wanted - products, -CENTRAL[1] * target)
    return pull
