"""A predictor–corrector step, but for linear algebra, which it asks for; one array holds every vector.

A step asks for M z, for a factor of M + diag(vectors[SHIFTED]) with a first solution, and for solutions of
(M + diag(vectors[DIAGONAL])) x = vectors[RIGHT], wanted in vectors[FOUND]. `go_on` takes what was asked for and says
what is wanted next. :mod:`lcp_plugin.methods.interior.predictor_corrector` has the mathematics.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import inlined, kernel

TO_THE_BOUNDARY = 0.995
LEAST_CENTRAL, MOST_CENTRAL = 0.1, 10.0  # products outside this share of the target are corrected
WORTH_A_CORRECTION = 1.05
SHORT = 0.1
SMALLEST = 1e-300
LARGEST_CENTRING = 1e3
SHARP = 0.01  # share of the infeasibility that a linear system may leave
ENOUGH = 0.01  # of the infeasibility: an error that a solve of a direction may leave
REGULARISATION = 1e-9  # of the equilibrated matrix, on rows without a barrier term of that size
SMALLEST_REGULARISATION, LARGEST_REGULARISATION = 1e-15, 1e-4
WORSE = 100.0  # times as large an error, beside its right-hand side, as before a smaller regularisation
LOOKS = (1, 3, 6)  # steps with a small gap after the last change of the active set: then somebody solves for it

# Rows of `vectors`, each of n numbers: the problem (bounds 0 where there are none, and whether there are, 0 or 1), the
# point (a distance of 1 and a multiplier of 0 where there is no bound), residuals, what a solve is asked and answers,
Q, LOWER, UPPER, HAS_LOWER, HAS_UPPER = 0, 1, 2, 3, 4
Z, BELOW, ABOVE, W_LOWER, W_UPPER = 5, 6, 7, 8, 9
LEFT, LEFT_LOWER, LEFT_UPPER, DIAGONAL, RIGHT, FOUND = 10, 11, 12, 13, 14, 15
# products to aim at and those of the predictor, a direction on trial and the chosen one: five rows each, as the point.
AIM_LOWER, AIM_UPPER, SECOND_LOWER, SECOND_UPPER = 16, 17, 18, 19
TRIAL, CHOSEN, SHIFTED = 20, 25, 30
ROWS = 31

# Entries of `facts`: of a step; how many were made, since how many the active set is the same and the gap small, and
# what gap is small.
PAIRS, GAP, TARGET, LENGTH, INFEASIBILITY, CORRECTIONS, LEFT_TO_CORRECT, IS_PROGRAM, IS_SECOND_TRY = range(9)
MADE, SETTLED, SMALL_GAP = 9, 10, 11
FACTS = 12

# Entries of `state`: the regularisation, now and at least; whether it may become smaller, and whether the last factor
# was useful at once; the largest error that a solve has left since, and beside its right-hand side, that before too.
NOW, LEAST, MAY_SHARPEN, IS_EASY, MISSED, SHARE, SHARE_BEFORE = range(7)
STATE = 7

# What is asked for: M z, a factor and its first solution, other solutions; or nothing, and why.
PRODUCT, FACTOR, DIRECTION, CORRECTION, FAILED, HAS_SETTLED = 0, 1, 2, 3, -1, -2


@kernel
def go_on(vectors, facts, state, is_active, asked, error, size):  # type: ignore[no-untyped-def]
    """Take what was asked for; return what is asked for now. After a step that is PRODUCT, HAS_SETTLED or FAILED.

    `error` is what the solution leaves of a right-hand side of that `size`; of a FACTOR, ∞ where it is useless.
    """
    if asked == PRODUCT:
        if not _begin(vectors, facts):
            return FAILED
        _demand(vectors)
        relax(state)
    elif asked == FACTOR and not error < np.inf:
        if not regularise(state):
            return FAILED
    else:
        if asked != FACTOR:
            share = error / max(size, SMALLEST)
            state[MISSED] = error if error > state[MISSED] else state[MISSED]  # and not where it is NaN
            state[SHARE] = share if share > state[SHARE] else state[SHARE]
        asked = _aim(vectors, facts, asked, _turn(vectors))
        if asked != PRODUCT:
            _demand(vectors)
            return asked
        if facts[IS_PROGRAM] > 0.0 and state[MISSED] > SHARP * facts[INFEASIBILITY] and state[MAY_SHARPEN] > 0.0:
            _sharpen(state)
        return _move(vectors, facts, is_active)
    for i in range(vectors.shape[1]):
        vectors[SHIFTED, i] = vectors[DIAGONAL, i] + state[NOW]
    return FACTOR


@kernel
def relax(state):  # type: ignore[no-untyped-def]
    """Begin with a new factor: regularised less where the last one was useful at once."""
    state[MISSED] = state[SHARE] = 0.0
    if state[IS_EASY] > 0.0:
        state[NOW] = max(state[LEAST], 0.01 * state[NOW])
    state[IS_EASY] = 1.0


@kernel
def regularise(state):  # type: ignore[no-untyped-def]
    """Regularise more, as a factor was useless; return False where that is too much."""
    state[MAY_SHARPEN] = state[IS_EASY] = 0.0
    state[NOW] *= 100.0
    state[LEAST] = min(state[NOW], REGULARISATION)
    return 0.0 < state[NOW] <= LARGEST_REGULARISATION


@inlined
def _sharpen(state):  # type: ignore[no-untyped-def]
    """Regularise less from the next factorisation on, unless that has made matters worse before."""
    may = state[SHARE] <= WORSE * state[SHARE_BEFORE]
    state[MAY_SHARPEN], state[SHARE_BEFORE] = may, state[SHARE]
    state[LEAST] = (
        max(0.01 * state[LEAST], SMALLEST_REGULARISATION) if may else min(100.0 * state[LEAST], REGULARISATION)
    )


@inlined
def _begin(vectors, facts):  # type: ignore[no-untyped-def]
    """Fill the residuals, M z given in vectors[LEFT], and the diagonal, aim at 0; return whether all are finite."""
    largest, is_finite = 0.0, True
    for i in range(vectors.shape[1]):
        w_lower, w_upper, below, above = vectors[W_LOWER, i], vectors[W_UPPER, i], vectors[BELOW, i], vectors[ABOVE, i]
        left = vectors[LEFT, i] + vectors[Q, i] - w_lower + w_upper
        largest = max(largest, abs(left))
        vectors[LEFT, i] = left
        vectors[LEFT_LOWER, i] = vectors[HAS_LOWER, i] * (vectors[Z, i] - vectors[LOWER, i] - below)
        vectors[LEFT_UPPER, i] = vectors[HAS_UPPER, i] * (vectors[UPPER, i] - vectors[Z, i] - above)
        diagonal = w_lower / below + w_upper / above
        is_finite &= np.isfinite(diagonal)
        vectors[DIAGONAL, i] = diagonal
        vectors[AIM_LOWER, i] = vectors[AIM_UPPER, i] = 0.0
    facts[INFEASIBILITY], facts[IS_SECOND_TRY] = largest, 0.0
    return is_finite


@inlined
def _demand(vectors):  # type: ignore[no-untyped-def]
    """Fill the right-hand side of the direction that meets the aim."""
    for i in range(vectors.shape[1]):
        w_lower, w_upper, below, above = vectors[W_LOWER, i], vectors[W_UPPER, i], vectors[BELOW, i], vectors[ABOVE, i]
        right = (vectors[AIM_LOWER, i] - w_lower * vectors[LEFT_LOWER, i]) / below - w_lower
        right -= (vectors[AIM_UPPER, i] - w_upper * vectors[LEFT_UPPER, i]) / above - w_upper
        vectors[RIGHT, i] = right - vectors[LEFT, i]


@inlined
def _move(vectors, facts, is_active):  # type: ignore[no-untyped-def]
    """Follow the chosen direction; return PRODUCT, FAILED where z is not finite, or HAS_SETTLED."""
    length, is_finite, total = facts[LENGTH], True, 0.0
    settled = facts[SETTLED] + 1.0
    for i in range(vectors.shape[1]):
        vectors[Z, i] += length * vectors[CHOSEN, i]
        is_finite &= np.isfinite(vectors[Z, i])
        for part in range(1, 5):
            least = SMALLEST * vectors[HAS_LOWER if part in (1, 3) else HAS_UPPER, i]
            vectors[Z + part, i] = max(vectors[Z + part, i] + length * vectors[CHOSEN + part, i], least)
        total += vectors[BELOW, i] * vectors[W_LOWER, i] + vectors[ABOVE, i] * vectors[W_UPPER, i]
        now = vectors[BELOW, i] < vectors[W_LOWER, i] or vectors[ABOVE, i] < vectors[W_UPPER, i]
        if now != is_active[i]:
            is_active[i], settled = now, 0.0
    facts[GAP] = total / max(facts[PAIRS], 1.0)
    if not is_finite:
        return FAILED
    facts[MADE] += 1.0
    facts[SETTLED] = 0.0 if facts[GAP] > facts[SMALL_GAP] else settled
    return HAS_SETTLED if facts[SETTLED] in LOOKS else PRODUCT


@inlined
def _aim(vectors, facts, asked, length):  # type: ignore[no-untyped-def]
    """Choose the direction on trial, of that length, or not; fill the products that the next one aims at.

    Return what is asked for to find it, PRODUCT where the direction of the step is chosen.
    """
    if asked == FACTOR:
        gap = facts[GAP]
        share = _gap_after(vectors, min(1.0, length)) / max(facts[PAIRS], 1.0) / gap if gap > 0.0 else 0.0
        centring = share * (share * share)
        for i in range(vectors.shape[1]):
            vectors[SECOND_LOWER, i] = vectors[TRIAL + 1, i] * vectors[TRIAL + 3, i]
            vectors[SECOND_UPPER, i] = vectors[TRIAL + 2, i] * vectors[TRIAL + 4, i]
        weight = 1.0 if length > SHORT else length
    else:
        is_better = asked == DIRECTION or length >= WORTH_A_CORRECTION * facts[LENGTH]
        if is_better:
            facts[LENGTH] = length
            for part in range(5):
                for i in range(vectors.shape[1]):
                    vectors[CHOSEN + part, i] = vectors[TRIAL + part, i]
        if is_better and facts[LEFT_TO_CORRECT] > 0.0:
            facts[LEFT_TO_CORRECT] -= 1.0
            _pull(vectors, facts[TARGET], min(1.0, 1.1 * length + 0.1))
            return CORRECTION
        weight = facts[LENGTH]
        if weight > SHORT or facts[IS_PROGRAM] == 0.0 or facts[IS_SECOND_TRY] > 0.0:
            facts[LENGTH] = min(1.0, TO_THE_BOUNDARY * weight)
            return PRODUCT
        # What is infeasible has become small more slowly than the gap: first larger products, then less of it.
        # (Where M is no program's there may be no solution, and products would grow beyond all bounds.)
        facts[IS_SECOND_TRY] = 1.0
        for i in range(vectors.shape[1]):
            vectors[LEFT, i] *= SHARP
        centring = min(1.0 / max(weight, SMALLEST), LARGEST_CENTRING)
    facts[TARGET], facts[LEFT_TO_CORRECT] = centring * facts[GAP], facts[CORRECTIONS]
    for i in range(vectors.shape[1]):
        vectors[AIM_LOWER, i] = vectors[HAS_LOWER, i] * facts[TARGET] - weight * vectors[SECOND_LOWER, i]
        vectors[AIM_UPPER, i] = vectors[HAS_UPPER, i] * facts[TARGET] - weight * vectors[SECOND_UPPER, i]
    return DIRECTION


@inlined
def _turn(vectors):  # type: ignore[no-untyped-def]
    """Fill the direction on trial; return the longest step, at most 1/TO_THE_BOUNDARY, that keeps all positive."""
    steepest = TO_THE_BOUNDARY
    for i in range(vectors.shape[1]):
        z = vectors[FOUND, i]
        w_lower, w_upper, below, above = vectors[W_LOWER, i], vectors[W_UPPER, i], vectors[BELOW, i], vectors[ABOVE, i]
        to_lower = vectors[HAS_LOWER, i] * (z + vectors[LEFT_LOWER, i])
        to_upper = vectors[HAS_UPPER, i] * (vectors[LEFT_UPPER, i] - z)
        more_lower = (vectors[AIM_LOWER, i] - w_lower * to_lower) / below - w_lower
        more_upper = (vectors[AIM_UPPER, i] - w_upper * to_upper) / above - w_upper
        vectors[TRIAL, i] = z
        vectors[TRIAL + 1, i], vectors[TRIAL + 2, i] = to_lower, to_upper
        vectors[TRIAL + 3, i], vectors[TRIAL + 4, i] = more_lower, more_upper
        steepest = max(steepest, -to_lower / below, -to_upper / above)
        if vectors[HAS_LOWER, i] > 0.0:
            steepest = max(steepest, -more_lower / w_lower)
        if vectors[HAS_UPPER, i] > 0.0:
            steepest = max(steepest, -more_upper / w_upper)
    return 1.0 / steepest


@inlined
def _gap_after(vectors, length):  # type: ignore[no-untyped-def]
    """Return the sum of all products after a step on trial, at least 0."""
    total = 0.0
    for i in range(vectors.shape[1]):
        below = vectors[BELOW, i] + length * vectors[TRIAL + 1, i]
        above = vectors[ABOVE, i] + length * vectors[TRIAL + 2, i]
        total += below * (vectors[W_LOWER, i] + length * vectors[TRIAL + 3, i])
        total += above * (vectors[W_UPPER, i] + length * vectors[TRIAL + 4, i])
    return max(total, 0.0)


@inlined
def _pull(vectors, target, length):  # type: ignore[no-untyped-def]
    """Aim, as Gondzio does, away from products that a step of that length would leave far from the target."""
    for i in range(vectors.shape[1]):
        below = vectors[BELOW, i] + length * vectors[CHOSEN + 1, i]
        above = vectors[ABOVE, i] + length * vectors[CHOSEN + 2, i]
        w_lower = vectors[W_LOWER, i] + length * vectors[CHOSEN + 3, i]
        w_upper = vectors[W_UPPER, i] + length * vectors[CHOSEN + 4, i]
        vectors[AIM_LOWER, i] += vectors[HAS_LOWER, i] * _towards(below * w_lower, target)
        vectors[AIM_UPPER, i] += vectors[HAS_UPPER, i] * _towards(above * w_upper, target)


@inlined
def _towards(product, target):  # type: ignore[no-untyped-def]
    wanted = min(max(product, LEAST_CENTRAL * target), MOST_CENTRAL * target)
    return max(wanted - product, -MOST_CENTRAL * target)
