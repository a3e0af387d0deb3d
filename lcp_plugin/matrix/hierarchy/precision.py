"""Whether single precision can carry the coarser grids of a hierarchy.

Rounded to single precision a matrix differs from what it was by some 6e-8 D, D its diagonal. To errors that M hardly
sees that is a force of its own: where ‖M⁻¹D‖ is not well below 2²⁴, on long thin domains, in stiff layers between soft
ones, without anything that holds the unknowns, a cycle no longer knows what to do about them. Unknowns that are fixed
only make it less. M⁻¹D e, e = (1, …, 1), is what M x = D e answers; the coarsest grid answers it well enough.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..factors import dense_lu
from . import transfers as ways
from .grids import Grid, Transfer

ROUNDING = 2.0**-24
LARGEST_FORCE = 0.25  # of what M does; 0.0737 · 4 n · 2⁻²⁴ on a square: 0.18 for n = 10⁷
LARGEST_COARSEST = 500  # unknowns, of whose dense matrix a factor takes some milliseconds


@np.errstate(all="ignore")
def carries_single(grids: Sequence[Grid], transfers: Sequence[Transfer]) -> bool:
    """Return whether it can; False where the coarsest grid is too large to ask."""
    coarsest = grids[-1]
    if len(grids) == 1 or coarsest.n > LARGEST_COARSEST or not all(grid.fits_single for grid in grids[1:]):
        return False
    load = 1.0 / grids[0].inverse
    for transfer, below in zip(transfers, grids[1:], strict=True):
        finer, load = load, np.empty(below.n)
        ways.restrict(transfer, finer, 1.0, load)
    factor = dense_lu(coarsest.dense(coarsest.matrix.data))
    if factor is None:
        return False
    largest = float(np.abs(factor.solve(load)).max())
    return largest * ROUNDING <= LARGEST_FORCE
