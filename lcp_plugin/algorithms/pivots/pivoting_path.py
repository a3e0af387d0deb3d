"""One path of complementary pivoting: where it starts, how far it is, whether its numbers still hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ...kernels import pivoting
from ...kernels.desk import AT_LOWER, AT_UPPER, BETWEEN
from ...kernels.pivoting import CANCELLED, GOING_ON, LOST, RETURNED, SOLVED
from .canonical_box import WELL_CONDITIONED

FloatMatrix = NDArray[np.float64]

FRESH_FOR = 25  # pivots after which B is inverted anew, at least; an inversion costs about n / 3 of them
ACCURATE = 1e-12
FEASIBLE = 1e-7
NOT_STARTED = -1


class Path:
    """The path of w = M z + q + t r, 0 ≤ z ≤ u complementary, from one start towards t = 0.

    Parameters
    ----------
    M : ndarray, shape (n, n)
        Equilibrated; not modified.
    q, upper : ndarray, shape (n,)
        `upper` is positive, ∞ allowed.
    """

    def __init__(self, M: FloatMatrix, q: FloatVector, upper: FloatVector) -> None:
        self.M, self.q, self.upper = M, q, upper
        self.columns = np.ascontiguousarray(M.T)
        self.absolute = np.abs(M)
        self.n = n = q.size
        self.inverse = np.zeros((n, n))
        self.entries = 0.0  # touched so far
        self.fresh_for = max(FRESH_FOR, n // 3)
        self.is_well_conditioned = True  # B, when it was last inverted
        self._begin(np.zeros(n), n + np.arange(n), np.zeros(n, dtype=np.int64), 2 * n, 1.0, 0.0)

    def _begin(
        self, covering: FloatVector, basis: Any, side: Any, driven: int, direction: float, level: float
    ) -> None:
        n = self.n
        self.covering, self.basis, self.side = covering, basis.astype(np.int64), side.astype(np.int64)
        self.driven, self.direction, self.level = driven, direction, level
        self.start_side = np.full(n, NOT_STARTED)
        self.place = np.full(n, -1)
        self._note_places()
        self.values, self.noise = np.zeros(n), np.zeros(n)
        self.pivots = self.age = 0

    # --- starts -----------------------------------------------------------------------------------------

    def start_along(self, covering: FloatVector) -> bool:
        """Start at z = 0 with the smallest t for which q + t r ≥ 0; False where there is none.

        `covering` is r, shape (n,), positive where q is negative and nowhere negative.
        """
        n, q = self.n, self.q
        if not np.all(covering[q < 0.0] > 0.0):
            return False
        is_usable = covering > 0.0
        with np.errstate(all="ignore"):
            level = np.where(is_usable, -q / covering, -np.inf)
        # Among equals the last is the one that the perturbation q + (ε, ε², …) blocks first.
        k = int(np.flatnonzero(level == level.max())[-1])
        basis = n + np.arange(n)
        basis[k] = 2 * n
        self._begin(covering, basis, np.full(n, AT_LOWER), k, 1.0, 0.0)
        self.inverse[:] = np.eye(n)
        self.inverse[k] = -covering / covering[k]
        self.inverse[k, k] = -1.0 / covering[k]
        self.values = q + level[k] * covering
        self.values[k] = level[k]
        self._reset_noise()
        return True

    @np.errstate(all="ignore")
    def start_in_cell(self, side: Any, z: FloatVector, w: FloatVector) -> bool:
        """Start at t = 1 from a complementary pair with the vector r that makes it exact; False if B is singular.

        `side` names the cell; z and w must lie strictly inside it.
        """
        n = self.n
        basis = np.where(side == BETWEEN, np.arange(n), n + np.arange(n))
        self._begin(w - self.M @ z - self.q, basis, side, 2 * n, -1.0, 1.0)
        if not self._invert():
            return False
        self.start_side = self.side.copy()
        return True

    def start_at_vertex(self, covering: FloatVector, basis: Any, side: Any, driven: int, direction: float) -> bool:
        """Start at a given basis with variable `driven` moving in the direction; t, if driven, stands at 0."""
        self._begin(covering, basis, side, driven, direction, 0.0)
        return self._invert()

    # --- moving -----------------------------------------------------------------------------------------

    def advance(self, limit: int) -> int:
        """Make up to `limit` pivots and return the outcome, a constant of `pivoting`.

        A ray, and a pivot too small to trust, are looked at again with a new inverse.
        """
        outcome = self._run(limit)
        if outcome in (SOLVED, RETURNED):
            return outcome
        is_doubtful = outcome != GOING_ON and self.age > 0
        if not self._is_sound(is_doubtful):
            return LOST
        if is_doubtful:
            outcome = self._run(limit)
        return GOING_ON if outcome == LOST else outcome

    def _run(self, limit: int) -> int:
        outcome, driven, direction, made, touched = pivoting.pivots(
            self.columns, self.covering, self.upper, self.basis, self.place, self.side, self.start_side,
            self.values, self.noise, self.inverse, self.driven, self.direction, self.level, self.age == 0, limit,
        )
        self.driven, self.direction = int(driven), float(direction)
        self.pivots += int(made)
        self.age += int(made)
        self.entries += float(touched)
        return int(outcome)

    @np.errstate(all="ignore")
    def _is_sound(self, is_doubtful: bool) -> bool:
        """Correct the values, with a new inverse where one is due; return whether they are feasible."""
        wrong = self._correct()
        if is_doubtful or wrong > ACCURATE or self.age >= self.fresh_for:
            if not self._invert():
                return False
            wrong = self._correct()
        if not wrong <= np.sqrt(ACCURATE):
            return False
        n, basis = self.n, self.basis
        rows = basis % n
        is_z = basis < n
        low = np.where(~is_z & (self.side[rows] == AT_UPPER) & (basis < 2 * n), -np.inf, 0.0)
        high = np.where(is_z, self.upper[rows], np.where(low < 0.0, 0.0, np.inf))
        outside = np.maximum(low - self.values, self.values - high)
        return bool(np.all(outside <= FEASIBLE * max(1.0, float(np.abs(self.values).max(initial=0.0)))))

    def _note_places(self) -> None:
        is_w = (self.basis >= self.n) & (self.basis < 2 * self.n)
        self.place[:] = -1
        self.place[self.basis[is_w] - self.n] = np.flatnonzero(is_w)

    @np.errstate(all="ignore")
    def _invert(self) -> bool:
        """Compute B⁻¹ and the basic values from the data; False where B is singular to working precision."""
        n, basis = self.n, self.basis
        self._note_places()
        others, rows = np.flatnonzero((basis < n) | (basis == 2 * n)), np.flatnonzero(self.place < 0)
        block = np.empty((n, others.size))
        is_t = basis[others] == 2 * n
        block[:, ~is_t] = -self.columns[basis[others[~is_t]]].T
        block[:, is_t] = -self.covering[:, None]
        core = block[rows]
        try:
            inverse = np.linalg.inv(core)
        except np.linalg.LinAlgError:
            return False
        if not np.isfinite(inverse).all():
            return False
        absolute = np.abs(inverse)
        size = absolute.sum(axis=0).max(initial=0.0) * np.abs(core).sum(axis=0).max(initial=0.0)
        self.is_well_conditioned = bool(size < WELL_CONDITIONED)
        # What is zero in exact arithmetic must be zero here, or a pivot could stand on it.
        inverse[absolute <= CANCELLED * (absolute @ np.abs(core) @ absolute)] = 0.0
        if not inverse.any(axis=1).all():  # a row of nothing but rounding
            return False
        slack_rows = np.flatnonzero(self.place >= 0)
        below = block[slack_rows]
        image = -below @ inverse
        image[np.abs(image) <= CANCELLED * (np.abs(below) @ np.abs(inverse))] = 0.0
        self.inverse[:] = 0.0
        self.inverse[slack_rows, self.place[slack_rows]] = 1.0
        self.inverse[np.ix_(rows, others)] = inverse.T
        self.inverse[np.ix_(rows, self.place[slack_rows])] = image.T
        self.entries += 3.0 * float(rows.size) ** 3 + 2.0 * float(n) * float(rows.size) ** 2
        self.values = self._right_hand_side() @ self.inverse
        self.age = 0
        self._correct()
        self._reset_noise()
        return True

    def _right_hand_side(self) -> FloatVector:
        b = self.q.copy()
        at_upper = self.side == AT_UPPER
        if at_upper.any():
            b += self.M[:, at_upper] @ self.upper[at_upper]
        if self.driven == 2 * self.n:
            b += self.level * self.covering
        return b

    @np.errstate(all="ignore")
    def _correct(self) -> float:
        """Refine the basic values by one step; return how wrong they were, relative to their terms."""
        z, w, t = self.z, np.zeros(self.n), self._level_now()
        is_w = (self.basis >= self.n) & (self.basis < 2 * self.n)
        w[self.basis[is_w] - self.n] = self.values[is_w]
        error = w - self.M @ z - t * self.covering - self.q
        size = np.abs(w) + self.absolute @ np.abs(z) + abs(t) * np.abs(self.covering) + np.abs(self.q)
        self.entries += 3.0 * self.n * self.n
        self.values -= error @ self.inverse
        return float(np.max(np.abs(error) / np.maximum(size, 1e-300), initial=0.0))

    @np.errstate(all="ignore")
    def _reset_noise(self) -> None:
        size = np.abs(self._right_hand_side()) @ np.abs(self.inverse)
        self.noise = 2.0**-46 * size

    # --- reading ----------------------------------------------------------------------------------------

    def _level_now(self) -> float:
        if self.driven == 2 * self.n:
            return self.level
        return float(self.values[self.basis == 2 * self.n].sum())

    @property
    def z(self) -> FloatVector:
        """The present z, shape (n,)."""
        z = np.where(self.side == AT_UPPER, self.upper, 0.0)
        is_z = self.basis < self.n
        z[self.basis[is_z]] = self.values[is_z]
        return z

    @property
    def ray(self) -> FloatVector:
        """The direction of z along which nothing blocks the driven variable, shape (n,)."""
        n = self.n
        column = np.zeros(n)
        direction = np.zeros(n)
        if self.driven < n:
            column[:] = -self.columns[self.driven]
            direction[self.driven] = self.direction
        elif self.driven < 2 * n:
            column[self.driven - n] = 1.0
        else:
            column[:] = -self.covering
        image = self.direction * (column @ self.inverse)
        is_z = self.basis < n
        direction[self.basis[is_z]] -= image[is_z]
        return direction
