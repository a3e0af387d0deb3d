"""Which rank owns which indices."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray


class Layout:
    """Consecutive ranges of indices, in the order of the ranks.

    Parameters
    ----------
    comm : mpi4py communicator
    own : int
        How many indices this rank owns; may be 0.
    """

    def __init__(self, comm: MPI.Comm, own: int) -> None:
        self.comm = comm
        self.starts = np.concatenate([[0], np.cumsum(comm.allgather(int(own)))])
        self.n = int(self.starts[-1])
        self.first, self.last = int(self.starts[comm.rank]), int(self.starts[comm.rank + 1])
        self.own = self.last - self.first

    def owners(self, indices: NDArray[Any]) -> NDArray[Any]:
        """Return the rank that owns each index."""
        return np.searchsorted(self.starts, indices, side="right") - 1

    def is_foreign(self, indices: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which of the indices others own."""
        return (indices < self.first) | (indices >= self.last)

    def local(self, columns: NDArray[Any], ghosts: NDArray[Any]) -> NDArray[Any]:
        """Return local numbers of global columns: the own ones from 0 on, then the ghosts in order, 0 for others."""
        local = (columns - self.first).astype(np.int32)
        at = np.flatnonzero((local < 0) | (local >= self.own))
        if not at.size:
            return local
        foreign = columns[at]
        local[at] = 0
        if ghosts.size:
            order = np.argsort(ghosts, kind="stable")
            ascending = ghosts[order]
            place = np.minimum(np.searchsorted(ascending, foreign), ghosts.size - 1)
            local[at] = np.where(ascending[place] == foreign, self.own + order[place], 0)
        return local
