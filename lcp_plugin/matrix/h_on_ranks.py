"""A proof that a matrix whose rows are spread over processes is an H₊-matrix."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..checks import FloatVector
from ..exact.rounding import comparison_product, lower_end
from .comparison import comparison_of
from .matrix import Matrix
from .symmetry import has_symmetric_entries

GAINS = (1e-2, 1e-6)  # what a solve with ⟨M⟩ shall leave of its residual
MOST_STEPS = 30  # a matrix that is not H₊ lets v grow for ever


@np.errstate(all="ignore")
def positive_product(matrix: Matrix) -> tuple[FloatVector, FloatVector] | None:
    """Return the own parts of v > 0 and of a margin, ⟨M⟩v ≥ margin > 0, or None where none was found; all peers call.

    v is a vector of ones or solves ⟨M⟩v = diag(M) roughly. That it does its work is verified row by row with all
    rounding counted.
    """
    if not matrix.peers.everywhere(bool((matrix.diagonal > 0.0).all())):
        return None
    for v in _candidates(matrix):
        margin = lower_end(*comparison_product(matrix.csr_rows, matrix.whole(v)))
        least = min(float(v.min(initial=np.inf)), float(margin.min(initial=np.inf)))
        if matrix.peers.everywhere(least > 0.0):
            return v, margin
    return None


def _candidates(matrix: Matrix) -> Iterator[FloatVector]:
    """Yield vectors that may be such a v: ones, then solutions of ⟨M⟩v = diag(M), each nearer than the one before."""
    from .hierarchy.levels import COARSEST, build_hierarchy
    from .hierarchy.truncation import (
        KrylovCorrection,  # numba, which not every proof needs
        Truncation,
    )

    ones = np.ones(matrix.own)
    yield ones
    comparison, is_symmetric = comparison_of(matrix.csr_rows), has_symmetric_entries(matrix)
    hierarchy = build_hierarchy(comparison, COARSEST, scales_rows=not is_symmetric, peers=matrix.peers)
    residual = matrix.diagonal - comparison @ np.ones(matrix.width)
    solution = KrylovCorrection(Truncation(hierarchy), residual, is_symmetric)
    begun, steps = solution.largest(), 0
    for gain in GAINS:
        while solution.largest() > gain * begun and steps < MOST_STEPS and solution.step():
            steps += 1
        v = np.empty(matrix.own)
        solution.apply_to(ones, v)
        yield v
