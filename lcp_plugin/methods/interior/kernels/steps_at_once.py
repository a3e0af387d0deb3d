"""Predictor–corrector steps with sparse quasi-definite factors, many in one call.

What a step does between linear solves is in :mod:`.interior_steps`, factors and solves in :mod:`.symmetric_factors`;
how much is regularised, in :mod:`lcp_plugin.methods.interior.newton_matrix`, whose rules these are.
"""

from __future__ import annotations

from ....core.kernels.compilation import compiled, compiled_in_place
from ....systems.refinement import REFINEMENTS, STABLE, USEFUL
from ..newton_matrix import LARGEST_REGULARISATION, REGULARISATION, SMALLEST, SMALLEST_REGULARISATION, WORSE
from . import interior_steps as step
from .symmetric_factors import factorise, solve

# Entries of `state`: the regularisation, now and at least; whether it may become smaller, and whether the last factor
# was useful at once; the largest error that a solve has left, and beside its right-hand side, that a factorisation ago
# too; how many factors were made, and how many solves.
NOW, LEAST, MAY_SHARPEN, IS_EASY, MISSED, SHARE, SHARE_BEFORE, FACTORS, SOLVES = range(9)
STATE = 9


@compiled
def steps(  # type: ignore[no-untyped-def]
    vectors, facts, state, pattern, entries, own, signs, M, factor, spare, is_active, small_gap, most, settled
):
    """Make so many steps, or fewer: until the active set has settled and the gap is small, or one fails.

    Changed are vectors, facts, state, `factor` (L, D), `spare`, shape (4, n), and `is_active`, shape (n,). `pattern` is
    that of a Symbolic, M = (indptr, indices, data) of a CSR array, `own` its diagonal, `entries` those of S M. Return
    how many steps were made, and before how many the active set has changed last, or the gap was not small.
    """
    order, starts, below = pattern[0], pattern[1], pattern[2]
    indptr, indices, data = M
    values, pivots = factor
    diagonal = vectors[step.DIAGONAL]
    for made in range(most):
        for i in range(own.size):
            total = 0.0
            for p in range(indptr[i], indptr[i + 1]):
                total += data[p] * vectors[step.Z, indices[p]]
            vectors[step.LEFT, i] = total
        if not step.begin(vectors, facts):
            return made, settled
        phase = step.advance(vectors, facts, step.BEGUN)
        if not _factorised(
            state, pattern, entries, own, signs, indptr, indices, data, values, pivots, spare, diagonal,
            vectors[step.RIGHT], vectors[step.FOUND],
        ):
            return made, settled
        enough, phase = step.ENOUGH * facts[step.INFEASIBILITY], step.advance(vectors, facts, phase)
        while phase != step.DONE:
            error, size, passes = solve(
                order, starts, below, values, pivots, signs, indptr, indices, data, diagonal, vectors[step.RIGHT],
                vectors[step.FOUND], spare, REFINEMENTS, enough,
            )
            state[SOLVES] += passes
            state[MISSED] = error if error > state[MISSED] else state[MISSED]
            share = error / max(size, SMALLEST)
            state[SHARE] = share if share > state[SHARE] else state[SHARE]
            phase = step.advance(vectors, facts, phase)
        is_blunt = facts[step.IS_PROGRAM] > 0.0 and state[MISSED] > step.SHARP * facts[step.INFEASIBILITY]
        if is_blunt and state[MAY_SHARPEN] > 0.0:
            _sharpen(state)
        if not step.move(vectors, facts):
            return made, settled
        settled += 1
        for i in range(own.size):
            now = vectors[step.BELOW, i] < vectors[step.W_LOWER, i] or vectors[step.ABOVE, i] < vectors[step.W_UPPER, i]
            if now != is_active[i]:
                is_active[i], settled = now, 0
        if facts[step.GAP] > small_gap:
            settled = 0
        elif settled in step.LOOKS:
            return made + 1, settled
    return most, settled


@compiled_in_place
def _factorised(  # type: ignore[no-untyped-def]
    state, pattern, entries, own, signs, indptr, indices, data, values, pivots, spare, diagonal, right, x
):
    """Factorise M + diag(diagonal), regularised as little as gives a useful factor; return whether there is one.

    It is useful where the predictor x comes out of it: that only says where to aim, and is not refined.
    """
    order, starts, below = pattern[0], pattern[1], pattern[2]
    row_starts, columns, above_starts, above, at = pattern[3], pattern[4], pattern[5], pattern[6], pattern[7]
    shifted = spare[3]
    state[MISSED] = state[SHARE] = 0.0
    if state[IS_EASY] > 0.0:
        state[NOW] = max(state[LEAST], 0.01 * state[NOW])
    state[IS_EASY], is_useful = 1.0, False
    while not is_useful:
        for i in range(own.size):
            shifted[i] = diagonal[i] + state[NOW]
            pivots[i] = signs[i] * (own[i] + shifted[i])
        state[FACTORS] += 1.0
        if factorise(
            order, starts, below, row_starts, columns, above_starts, above, at, entries, values, pivots, spare[0]
        ):
            error, size, passes = solve(
                order, starts, below, values, pivots, signs, indptr, indices, data, shifted, right, x, spare, 0, 0.0
            )
            state[SOLVES] += passes
            largest = 0.0
            for i in range(own.size):
                largest = max(largest, abs(x[i]))
            is_useful = error <= max(USEFUL * size, STABLE * largest)
        if not is_useful:
            state[MAY_SHARPEN] = state[IS_EASY] = 0.0
            state[NOW] *= 100.0
            state[LEAST] = min(state[NOW], REGULARISATION)
            if state[NOW] > LARGEST_REGULARISATION:
                return False
    return True


@compiled_in_place
def _sharpen(state):  # type: ignore[no-untyped-def]
    """Regularise less from the next factorisation on, unless that has made matters worse before."""
    may = state[SHARE] <= WORSE * state[SHARE_BEFORE]
    state[MAY_SHARPEN], state[SHARE_BEFORE] = may, state[SHARE]
    state[LEAST] = (
        max(0.01 * state[LEAST], SMALLEST_REGULARISATION) if may else min(100.0 * state[LEAST], REGULARISATION)
    )
