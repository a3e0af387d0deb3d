"""What a grid asks of the processes that hold its other rows; here there are none.

A vector of a grid holds its own values first and behind them those of foreign unknowns that its rows meet. A matrix
holds the own rows and behind them, where it is coarsened, those of foreign unknowns next to the own ones. What is
computed from all values is asked of everybody, so that every process takes the same decisions.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..checks import FloatVector


class Peers(Protocol):
    """The processes that share a grid, this one among them."""

    foreign: int
    """How many foreign unknowns the own rows meet."""

    def fetch(self, x: FloatVector) -> None:
        """Overwrite the foreign values in x, shape (own + foreign,)."""

    def fetch_flags(self, flags: NDArray[np.bool_]) -> None:
        """Overwrite the foreign flags, shape (own + foreign,)."""

    def fetch_entries(self, data: FloatVector) -> None:
        """Overwrite the entries of the foreign rows behind those of the own rows."""

    def largest(self, value: float) -> float:
        """Return the largest of everybody's values; a NaN stays."""

    def total(self, value: float) -> float:
        """Return the sum of everybody's values."""


class Alone:
    """One process holds all rows."""

    foreign = 0

    def fetch(self, x: FloatVector) -> None:
        """Nothing is foreign."""

    def fetch_flags(self, flags: NDArray[Any]) -> None:
        """Nothing is foreign."""

    def fetch_entries(self, data: FloatVector) -> None:
        """Nothing is foreign."""

    def largest(self, value: float) -> float:
        """Return the value."""
        return value

    def total(self, value: float) -> float:
        """Return the value."""
        return value


ALONE = Alone()
