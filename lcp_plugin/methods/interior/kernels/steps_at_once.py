"""Predictor–corrector steps of :mod:`.interior_steps` with factors of :mod:`.symmetric_factors`, many in one call."""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import kernel
from ....systems.refinement import REFINEMENTS
from . import interior_steps as step
from .symmetric_factors import factorise, is_useful, solve


@kernel
def steps(vectors, facts, state, is_active, most, pattern, entries, own, signs, M, factor, spare):  # type: ignore[no-untyped-def]
    """Make so many steps, or fewer: until the active set has settled and the gap is small, or one fails.

    Changed are vectors, facts, state, `is_active`, `factor` (L, D) and `spare`, shape (3, n). `pattern` is that of a
    Symbolic, M = (indptr, indices, data) of a CSR array, `own` its diagonal, `entries` those of S M. Return how many
    factors were made, and how many solves.
    """
    order, starts, below = pattern[0], pattern[1], pattern[2]
    indptr, indices, data = M
    values, pivots = factor
    asked, factors, solves = step.PRODUCT, 0, 0
    while asked >= 0 and facts[step.MADE] < most:
        error = size = 0.0
        if asked == step.PRODUCT:
            for i in range(own.size):
                total = 0.0
                for p in range(indptr[i], indptr[i + 1]):
                    total += data[p] * vectors[step.Z, indices[p]]
                vectors[step.LEFT, i] = total
        elif asked == step.FACTOR:
            for i in range(own.size):
                pivots[i] = signs[i] * (own[i] + vectors[step.SHIFTED, i])
            factors, error = factors + 1, np.inf
            if factorise(
                order, starts, below, pattern[3], pattern[4], pattern[5], pattern[6], pattern[7], entries, values,
                pivots, spare[0],
            ):
                solves += 1
                if is_useful(
                    order, starts, below, values, pivots, signs, indptr, indices, data, vectors[step.SHIFTED],
                    vectors[step.RIGHT], vectors[step.FOUND], spare,
                ):
                    error = 0.0
        else:
            error, size, passes = solve(
                order, starts, below, values, pivots, signs, indptr, indices, data, vectors[step.DIAGONAL],
                vectors[step.RIGHT], vectors[step.FOUND], spare, REFINEMENTS, step.ENOUGH * facts[step.INFEASIBILITY],
            )
            solves += passes
        asked = step.go_on(vectors, facts, state, is_active, asked, error, size)
    return factors, solves
