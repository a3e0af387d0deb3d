"""What a hierarchy is made of: matrices as bare arrays, ways between grids, grids; immutable."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector, read_only
from ...peers.alone import ALONE, Arrays, Peers
from .blocks import Blocks
from .stretches import Stretches

LARGEST_SINGLE = 1e25  # times the least: of 3e38, as sums and products of some such numbers are numbers still

NO_WEIGHT = np.zeros(0)
NO_WEIGHT.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Operator:
    """A read-only CSR matrix as bare arrays."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    data: FloatVector

    def __post_init__(self) -> None:
        # One signature for every kernel: the caller's matrix is read-only as well.
        for name in ("indptr", "indices", "data"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    @property
    def arrays(self) -> tuple[NDArray[Any], NDArray[Any], FloatVector]:
        """The three arrays, in the order the kernels take them."""
        return self.indptr, self.indices, self.data

    def single(self) -> Operator:
        """Return it with its values in single precision."""
        return Operator(self.indptr, self.indices, self.data.astype(np.float32))


@dataclass(frozen=True, eq=False)
class Transfer:
    """The way from one grid to the next coarser one: prolongation P, restriction Pᵀ or Pᵀ D⁻¹, and who is on both.

    P has a row for each foreign unknown as well, which the Galerkin product needs. What is stored of the restriction
    times `factor`, a power of two, is what restricts: so single precision sees numbers near 1, whatever unit M has.
    """

    prolongation: Operator
    restriction: Operator
    is_coarse: NDArray[np.bool_]
    factor: float = 1.0

    def single(self) -> Transfer:
        """Return it with its values in single precision."""
        return replace(self, prolongation=self.prolongation.single(), restriction=self.restriction.single())


@dataclass(frozen=True, eq=False)
class Grid:
    """One grid: its matrix with every diagonal entry stored, where those stand, equal rows, inverses of the pivots.

    A pivot is the diagonal entry, plus its weight where other processes sweep at the same time.
    """

    matrix: Operator
    split: NDArray[Any]
    stretches: Stretches
    blocks: Blocks
    inverse: FloatVector
    peers: Peers = ALONE
    weight: FloatVector = field(default_factory=lambda: NO_WEIGHT)

    @property
    def n(self) -> int:
        """Number of own unknowns."""
        return self.inverse.size

    @property
    def width(self) -> int:
        """Number of unknowns that the own rows meet."""
        return self.inverse.size + self.peers.foreign

    @property
    def fits_single(self) -> bool:
        """Whether the pivots are so near to one another that single precision holds all, and there are no others."""
        largest, least = float(self.inverse.max(initial=0.0)), float(self.inverse.min(initial=np.inf))
        return largest < LARGEST_SINGLE * least

    def single(self) -> Grid:
        """Return it with its values in single precision."""
        return replace(self, matrix=self.matrix.single(), inverse=read_only(self.inverse.astype(np.float32)))

    @property
    def rows(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], FloatVector, Stretches]:
        """The matrix as sweeps take it."""
        return self.matrix.indptr, self.split, self.matrix.indices, self.matrix.data, self.stretches

    def dense(self, values: FloatVector) -> NDArray[np.float64]:
        """Return the matrix with these values in the place of its own, of a grid that nobody shares."""
        indptr, indices, _ = self.matrix.arrays
        dense = np.zeros((self.n, self.n))
        dense[np.repeat(np.arange(self.n), np.diff(indptr)), indices] = values
        return dense

    @property
    def own_entries(self) -> int:
        """Number of entries of the own rows."""
        return int(self.matrix.indptr[self.n])

    @property
    def own_arrays(self) -> Arrays:
        """The own rows, where those of foreign unknowns stand behind them."""
        matrix = self.matrix
        if matrix.indptr.size == self.n + 1:
            return matrix.arrays
        return Operator(matrix.indptr[: self.n + 1], matrix.indices, matrix.data).arrays


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The grids from the finest to the coarsest.

    Attributes
    ----------
    grids : tuple of Grid
    transfers : tuple of Transfer
        One fewer: from each grid to the next.
    work : float
        Matrix entries touched to build them.
    is_helpful : bool
        False where coarser grids would cost too much: then there is only the finest.
    """

    grids: tuple[Grid, ...]
    transfers: tuple[Transfer, ...]
    work: float
    is_helpful: bool

    @property
    def is_single(self) -> bool:
        """Whether any of it is in single precision."""
        return any(grid.inverse.dtype == np.float32 for grid in self.grids)

    @property
    def complexity(self) -> float:
        """Entries of all matrices together, divided by those of the finest."""
        return sum(grid.matrix.data.size for grid in self.grids) / max(self.grids[0].matrix.data.size, 1)
