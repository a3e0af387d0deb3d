"""How an interior point began, and whether it still gets anywhere."""

from __future__ import annotations

import numpy as np

MOST_STARTS, LIGHTER = 4, 0.01  # the weight of a start is taken so often, each time a hundredth
SHORT = 0.15  # of the whole second step: the start is not as large as the answer
PATIENCE, LONG_PATIENCE = 12, 25  # steps


class Progress:
    """The smallest residual so far; of a program, gap and infeasibility too: where none falls, nothing improves."""

    def __init__(self, is_program: bool) -> None:
        self._count, self._patience = (3, LONG_PATIENCE) if is_program else (1, PATIENCE)
        self._least = np.full(self._count, np.inf)
        self._since = 0

    def has_ended(self, *measures: float) -> bool:
        """Return whether for a while none of residual, gap, infeasibility fell below nine tenths of its smallest."""
        present = np.array(measures[: self._count])
        falls = present < 0.9 * self._least
        self._least = np.where(falls, present, self._least)
        self._since = 0 if falls.any() else self._since + 1
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
