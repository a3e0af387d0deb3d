"""One iterate of an infeasible interior point for a monotone box problem, and the step to the next.

Newton's directions are those of Mehrotra and Gondzio; all but the factorisation is in
:mod:`lcp_plugin.methods.interior.kernels.interior_steps`, on one array that holds every vector.
"""

from __future__ import annotations

import numpy as np

from ...core.checks import BoolVector, FloatVector
from .newton_matrix import NewtonMatrix

INSIDE = 1.5  # times the worst violation is what the start is shifted by
FAR = 10.0  # times as large as usual, a number says nothing of where to start
MOST_STARTS, LIGHTER = 4, 0.01  # the weight of a start is taken so often, each time a hundredth
SHORT = 0.15  # of the whole second step: the start is not as large as the answer
PATIENCE, LONG_PATIENCE = 12, 25  # steps


class Standstill:
    """The smallest residual so far; of a convex program, gap and infeasibility too: where none falls, nothing improves.

    That is where M is symmetric, or has the signs of a program: elsewhere there may be no solution.
    """

    def __init__(self, is_convex: bool) -> None:
        self._count, self._patience = (3, LONG_PATIENCE) if is_convex else (1, PATIENCE)
        self._least = [np.inf] * self._count
        self._since = 0

    def is_reached(self, steps: int, *measures: float) -> bool:
        """Return whether for a while none of residual, gap, infeasibility fell below nine tenths of its smallest."""
        self._since += steps
        for k, present in enumerate(measures[: self._count]):
            if present < 0.9 * self._least[k]:
                self._least[k], self._since = present, 0
        return self._since >= self._patience


class Starts:
    """The weight of the start: smaller ones as long as the second step is short, and gets longer by that."""

    def __init__(self, weight: float) -> None:
        self.weight = self._best = weight
        self._longest, self._left = 0.0, MOST_STARTS

    def has_better(self, length: float) -> bool:
        """Return whether to start again, with the present weight, after a second step of that length."""
        self._left -= 1
        if length >= SHORT or self._left <= 0:
            return False
        if length > self._longest:
            self._longest, self._best = length, self.weight
            self.weight *= LIGHTER
        else:  # the one before was better
            self.weight, self._left = self._best, 0
        return True


class PredictorCorrector:
    """M z + q = w_lower − w_upper, distances to the bounds and their multipliers positive, products driven to 0.

    Attributes
    ----------
    z : ndarray, shape (n,)
        A view: the next step changes it.
    length : float
        Share of the last direction that was taken.
    gap : float
        The mean product of a distance and its multiplier.
    infeasibility : float
        The largest |M z + q − w_lower + w_upper| before the last step.
    changes : int
        Rows that came to a bound or left one when it was advanced last.
    """

    def __init__(
        self, matrix: NewtonMatrix, q: FloatVector, lower: FloatVector, upper: FloatVector,
        corrections: int | None = None,
    ) -> None:
        from .kernels import interior_steps as kernels

        self._kernels, self.matrix = kernels, matrix
        self._vectors, self._facts = np.zeros((kernels.ROWS, q.size)), np.zeros(kernels.FACTS)
        vectors, facts = self._vectors, self._facts
        vectors[kernels.Q] = q
        sides = (kernels.LOWER, kernels.HAS_LOWER, lower), (kernels.UPPER, kernels.HAS_UPPER, upper)
        for bound_row, flag_row, bound in sides:
            is_finite = np.isfinite(bound)
            vectors[bound_row], vectors[flag_row] = np.where(is_finite, bound, 0.0), is_finite
            facts[kernels.PAIRS] += np.count_nonzero(is_finite)
        facts[kernels.CORRECTIONS] = matrix.corrections if corrections is None else corrections
        facts[kernels.IS_PROGRAM] = float((matrix.signs < 0.0).any())
        facts[kernels.INFEASIBILITY] = np.inf
        self.z = vectors[kernels.Z]
        self.changes, self._is_active = 0, np.zeros(q.size, dtype=bool)

    @property
    def length(self) -> float:
        """Share of the last direction that was taken."""
        return float(self._facts[self._kernels.LENGTH])

    @property
    def gap(self) -> float:
        """The mean product of a distance and its multiplier."""
        return float(self._facts[self._kernels.GAP])

    @property
    def infeasibility(self) -> float:
        """The largest |M z + q − w_lower + w_upper| before the last step."""
        return float(self._facts[self._kernels.INFEASIBILITY])

    def start(self, weight: float) -> bool:
        """Begin well inside, where M z + q = weight (anchor − z); return False where that cannot be factorised.

        A good weight is the size of w beside that of z; where z is a multiplier of a program, that of z beside w. With
        another one the first steps are short.
        """
        vectors, kernels = self._vectors, self._kernels
        has_lower, has_upper = vectors[kernels.HAS_LOWER], vectors[kernels.HAS_UPPER]
        weights = weight**self.matrix.signs * np.maximum(has_lower, has_upper)
        # Unbounded sides are 0 here: the middle of two bounds, or the one there is.
        middle = (vectors[kernels.LOWER] + vectors[kernels.UPPER]) / np.maximum(has_lower + has_upper, 1.0)
        if not self._facts[kernels.IS_PROGRAM]:
            return self._start_at(middle, weights)
        lower = np.where(has_lower > 0.0, vectors[kernels.LOWER], -np.inf)
        nearest = np.clip(0.0, lower, np.where(has_upper > 0.0, vectors[kernels.UPPER], np.inf))
        return self._start_at(nearest, weights * self._outlying(), middle)

    def _start_at(self, anchor: FloatVector, weights: FloatVector, middle: FloatVector | None = None) -> bool:
        """Begin where M z + q = weights (anchor − z), near the middle where that is not far away."""
        if not self.matrix.factorise(weights):
            return False
        q = self._vectors[self._kernels.Q]
        z = self.matrix.solve(weights * anchor - q)
        if middle is not None:
            is_primal = self.matrix.signs > 0.0
            size = max(_largest(z[is_primal]), _largest(anchor[is_primal]))
            is_near = (middle != anchor) & (np.abs(middle - anchor) <= FAR * size)
            if is_near.any():
                anchor = np.where(is_near, middle, anchor)
                z = self.matrix.solve(weights * anchor - q)
        # What one side lacks, the other has.
        self.start_near(z, weights * (anchor - z))
        return bool(np.isfinite(z).all())

    def _outlying(self) -> FloatVector:
        """Return how many times as large as usual q is, at least 1: a limit or a cost that says little of the answer.

        So much heavier is the weight on such a row, or all others would be drawn to where it is met.
        """
        size, outlying = np.abs(self._vectors[self._kernels.Q]), np.ones(self.z.size)
        for role in (self.matrix.signs > 0.0, self.matrix.signs < 0.0):
            known = size[role & (size > 0.0)]
            if known.size:
                outlying[role] = np.maximum(1.0, size[role] / (FAR * float(np.median(known))))
        return outlying

    def start_near(self, z: FloatVector, w: FloatVector) -> None:
        """Begin near z and w, shape (n,), with all distances and multipliers well inside."""
        vectors, facts, kernels = self._vectors, self._facts, self._kernels
        lower, upper, has = vectors[kernels.LOWER], vectors[kernels.UPPER], vectors[kernels.HAS_LOWER : kernels.Z] > 0.0
        parts = vectors[kernels.BELOW : kernels.LEFT]  # both distances, both multipliers
        parts[:2], parts[2:] = np.where(has, (z - lower, upper - z), 1.0), np.where(has, (w, -w), 0.0)
        if facts[kernels.IS_PROGRAM]:
            self._shift_roles(parts, has, z)
        else:
            for sides in (parts[:2], parts[2:]):
                sides[has] = np.maximum(sides[has], _typical(sides[has]))
        half = np.where(has.all(axis=0), 0.5 * (upper - lower), np.inf)
        np.minimum(parts[:2], half, out=parts[:2])
        self.z[:] = np.where(has[0], lower + parts[0], np.where(has[1], upper - parts[1], z))
        facts[kernels.GAP] = np.vdot(parts[:2], parts[2:]) / max(facts[kernels.PAIRS], 1.0)
        self._is_active[:], facts[kernels.SETTLED] = self.active(1.0)[0], 0.0

    def _shift_roles(self, parts: FloatVector, has: BoolVector, z: FloatVector) -> None:
        """Apply Mehrotra's shifts, one to what is primal in a program, one to what is dual.

        What is far larger than any z of its role, as the distance from a bound of 1e9, has no say in them, and a
        partner that makes their product as large as the others.
        """
        is_dual = self.matrix.signs < 0.0  # where z is a multiplier, w is a distance
        sides = np.where(is_dual, parts[[2, 3, 0, 1]], parts)  # what is primal, then what is dual
        roles = sides[:2], sides[2:]
        is_far = [has & (role > FAR * _largest(z[kind])) for role, kind in zip(roles, (~is_dual, is_dual), strict=True)]
        near = has & ~(is_far[0] | is_far[1])
        if not near.any():
            near = has
        for role in roles:
            role[near] -= INSIDE * role[near].min(initial=0.0)
        sums, product = [float(role[near].sum()) for role in roles], float(np.vdot(roles[0][near], roles[1][near]))
        for role, others in zip(roles, reversed(sums), strict=True):
            role[near] += 0.5 * product / others if 0.0 < product < np.inf and others > 0.0 else 1.0
        mean = float(np.vdot(roles[0][near], roles[1][near])) / max(int(np.count_nonzero(near)), 1)
        for far, role, partner in ((is_far[0], *roles), (is_far[1] & ~is_far[0], *reversed(roles))):
            apart = far & ~near
            partner[apart] = mean / role[apart]
        parts[:] = np.where(is_dual, sides[[2, 3, 0, 1]], sides)

    def advance(self, most: int, small_gap: float = 0.0) -> int:
        """Make so many steps, or fewer, and return how many; 0 where nothing can be factorised or is finite any more.

        Fewer where the gap is small and the active set may have settled.
        """
        facts, kernels, before = self._facts, self._kernels, self._is_active.copy()
        facts[kernels.MADE], facts[kernels.SMALL_GAP] = 0.0, small_gap
        self.matrix.steps(self._vectors, facts, self._is_active, most)
        self.changes = int(np.count_nonzero(before != self._is_active))
        return int(facts[kernels.MADE])

    @property
    def has_settled(self) -> bool:
        """Whether the active set may have, and was not looked at since."""
        return float(self._facts[self._kernels.SETTLED]) in self._kernels.LOOKS

    def is_active(self) -> BoolVector:
        """Return the rows with a distance to a bound that is less than its multiplier."""
        return self._is_active.copy()

    def active(self, threshold: float) -> tuple[BoolVector, FloatVector]:
        """Return the rows whose distance to a bound is less than threshold × its multiplier, and that bound, else 0."""
        vectors, kernels = self._vectors, self._kernels
        lower = vectors[kernels.BELOW] < threshold * vectors[kernels.W_LOWER]
        upper = vectors[kernels.ABOVE] < threshold * vectors[kernels.W_UPPER]
        return lower | upper, np.where(lower, vectors[kernels.LOWER], np.where(upper, vectors[kernels.UPPER], 0.0))


def _largest(values: FloatVector) -> float:
    return float(np.abs(values).max(initial=0.0))


def _typical(values: FloatVector) -> float:
    """Return the root mean square, and no less than a hundredth of the largest."""
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0:
        return 1.0
    return max(largest * float(np.sqrt(np.mean((values / largest) ** 2))), 0.01 * largest)
