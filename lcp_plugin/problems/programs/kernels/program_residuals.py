"""The compiled residuals of a quadratic program, with a proved bound of what rounding did to them; arrays only.

`judge_row` and `judge_column` are the criterion, whoever has made the sums: `program_residuals` of any program, and
`measure` of dense arrays inside a compiled loop, by plain sums. Every sum of the former is one of rounded terms, beside
it their rounding errors, beside these what that second sum loses, as in :mod:`lcp_plugin.core.kernels.enclosures`.
Columns are summed while rows are read: no matrix is transposed.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import compiled_into_others, compiled_part, interpreted_while_small
from ....core.kernels.enclosures import MAY_UNDERFLOW, fused, outward, split_sum
from ....core.kernels.floats import EPSILON, TINY

TOTAL, ERRORS, LOST, TERM = range(4)  # rows of `columns`, an entry a variable
ROUNDED = 16.0 * EPSILON
PRIMAL, DUAL, PRODUCT, ROW, GAP, PRODUCT_SIZE, OBJECTIVE = range(7)  # of `worst`; the last two are sizes
MEASURES = 5
CANCELLED = 2.0**-20  # of the size of the objective: what terms that cancel leave of it is held to no less than that
SUM, SIZE, LARGEST, UNIT = range(4)  # rows of the workspace of `measure`: of a column of [C; P], and of its residual


@compiled_into_others
def _larger(a, b):  # type: ignore[no-untyped-def]
    """Return the larger one, NaN where one is NaN."""
    return b if (b > a) | (b != b) else a


@compiled_into_others
def _added(total, errors, lost, a, b):  # type: ignore[no-untyped-def]
    """Return the three sums with the product a b in them."""
    h = a * b
    total, f = split_sum(total, h)
    s, t = split_sum(fused(a, b, -h), f)
    errors, u = split_sum(errors, s)
    may_underflow = (abs(h) < MAY_UNDERFLOW) & (a != 0.0) & (b != 0.0)
    return total, errors, lost + (abs(t) + abs(u)) + (4.0 * TINY if may_underflow else 0.0)


@compiled_into_others
def _rounded(total, errors, lost, terms):  # type: ignore[no-untyped-def]
    """Return the value of such sums and how far it may be off; NaN where it is not finite."""
    value, low = split_sum(total, errors)
    # `lost` was itself rounded at most three times a term.
    error = outward(value, abs(low) + lost * (1.0 + (4.0 * terms + 8.0) * EPSILON))
    is_finite = (abs(value) < np.inf) & (error < np.inf)
    return value if is_finite else np.nan, error if is_finite else np.nan


@compiled_into_others
def judge_row(  # type: ignore[no-untyped-def]
    worst, slack, error, limit, term, y, unit, coefficient, least, is_equation
):
    """Hold a row with Σ a_j x_j − limit within slack ± error, its largest term and its multiplier against the worst.

    `coefficient` is its largest one and `least` the smallest cost, in the program's own scaling.
    """
    if abs(limit) < np.inf:
        over = abs(slack) if is_equation else slack
        excess = over + error if over == over else np.inf
        worst[PRIMAL] = _larger(worst[PRIMAL], excess / unit)
        size = max(term, abs(limit))
        violated = excess if not excess <= 0.0 else 0.0
        worst[ROW] = _larger(worst[ROW], violated / (coefficient + (size if violated > 0.0 else 0.0)))
        worst[GAP] += abs(y * slack)
        if is_equation:
            return
        wrong = -y * coefficient / least if not y >= 0.0 else 0.0
        product = abs(y) * (abs(slack) + error)
        worst[ROW] = _larger(_larger(worst[ROW], product / (least + abs(y) * size)), wrong)
        worst[PRODUCT] = _larger(worst[PRODUCT], product)
        worst[PRODUCT_SIZE] = _larger(worst[PRODUCT_SIZE], _larger(abs(y * limit), abs(y * (slack + limit))))
    elif y != 0.0:  # a multiplier of an infinite limit can never be right
        worst[ROW] = _larger(worst[ROW], abs(y) * coefficient / least)
        worst[PRODUCT] = _larger(worst[PRODUCT], abs(y) * coefficient)
        worst[PRODUCT_SIZE] = _larger(worst[PRODUCT_SIZE], abs(y * slack))


@compiled_into_others
def judge_column(  # type: ignore[no-untyped-def]
    worst, left, error, x, c, product, curvature, lower, upper, term, unit, size
):
    """Hold what is `left` ± error of the gradient at x_j, its largest term and (P x)_j against the worst.

    `size` is the smallest cost beside the unit of x_j.
    """
    worst[DUAL] = _larger(worst[DUAL], (abs(left) + error) / unit)
    worst[ROW] = _larger(worst[ROW], (abs(left) + error) / (size + term))
    bound = lower if left > 0.0 else upper
    worst[GAP] += max(abs(left * x), _far_gain(left, x, bound, curvature, term))
    worst[OBJECTIVE] += (c + 0.5 * product) * x


@compiled_into_others
def beside_sizes(worst, objective):  # type: ignore[no-untyped-def]
    """Put the products and the gap beside their sizes; return the largest measure, NaN where one is NaN."""
    worst[PRODUCT] /= objective + worst[PRODUCT_SIZE]
    worst[GAP] /= CANCELLED * objective + abs(worst[OBJECTIVE])
    largest = 0.0
    for k in range(MEASURES):
        largest = _larger(largest, worst[k])
    return largest


@compiled_into_others
def _far_gain(left, x, bound, curvature, largest):  # type: ignore[no-untyped-def]
    """Return what the objective may gain on the way to a bound where `left` of the gradient has no multiplier.

    0 where that is the rounding of the largest term; never more than the curvature allows.
    """
    if not abs(bound) < np.inf or abs(left) <= ROUNDED * largest:
        return 0.0
    gain = abs(left) * abs(x - bound)
    return min(gain, 0.5 * left * left / curvature) if curvature > 0.0 else gain


@interpreted_while_small
def program_residuals(  # type: ignore[no-untyped-def]
    of_P, indices_of_P, P, is_full, indptr, indices, data, is_full_of_rows, equations, c, limits, units, coefficients,
    dual_units, objective, x, y, columns, worst,
):
    """Fill `worst` with the largest errors of any condition and the gap; NaN where one is not finite.

    Parameters
    ----------
    of_P, indices_of_P, P, is_full
        P as CSR; where it is full, the columns of one row stand for those of all.
    indptr, indices, data, is_full_of_rows, equations
        [G; A] likewise, and the place of the first row that is an equation.
    limits, units, coefficients, y
        Of all constraints, the lower and upper bounds after the rows; a bound's coefficient is the unit of its unknown.
    dual_units, objective
        What each component of the gradient is relative to; the size of the objective and its smallest cost.
    columns, worst
        Zeros of shape (4, n), overwritten, and of shape (7,).
    """
    rows, n = indptr.size - 1, x.size
    terms = rows + n + 3.0
    for i in range(rows):
        limit, of_row = limits[i], y[i]
        total, errors, lost, largest = -limit if abs(limit) < np.inf else 0.0, 0.0, 0.0, 0.0
        begin = indptr[i]
        for k in range(begin, indptr[i + 1]):
            a, j = data[k], indices[k - begin if is_full_of_rows else k]
            if a == 0.0:
                continue
            total, errors, lost = _added(total, errors, lost, a, x[j])
            largest = max(largest, abs(a * x[j]))
            if of_row != 0.0:
                columns[TOTAL, j], columns[ERRORS, j], columns[LOST, j] = _added(
                    columns[TOTAL, j], columns[ERRORS, j], columns[LOST, j], a, of_row
                )
                columns[TERM, j] = _larger(columns[TERM, j], abs(a * of_row))
        slack, error = _rounded(total, errors, lost, terms)
        judge_row(worst, slack, error, limit, largest, of_row, units[i], coefficients[i], objective[1], i >= equations)
    for j in range(n):
        total, errors, lost, largest = columns[TOTAL, j], columns[ERRORS, j], columns[LOST, j], columns[TERM, j]
        for side in range(2):
            place, sign = rows + side * n + j, 2.0 * side - 1.0
            limit, of_bound = limits[place], y[place]
            value, low = split_sum(sign * x[j], -limit if abs(limit) < np.inf else 0.0)
            slack, error = _rounded(value, low, 0.0, terms)
            judge_row(
                worst, slack, error, limit, abs(x[j]), of_bound, units[place], coefficients[place], objective[1], False
            )
            total, errors, lost = _added(total, errors, lost, sign, of_bound)
            largest = _larger(largest, abs(of_bound))
        total, errors, lost = _added(total, errors, lost, 1.0, c[j])
        largest = _larger(largest, abs(c[j]))
        begin, product, curvature = of_P[j], 0.0, 0.0
        for k in range(begin, of_P[j + 1]):
            of = indices_of_P[k - begin if is_full else k]
            a, b = P[k], x[of]
            curvature += a if of == j else 0.0
            total, errors, lost = _added(total, errors, lost, a, b)
            product += a * b
            largest = max(largest, abs(a * b))
        left, error = _rounded(total, errors, lost, terms)
        judge_column(
            worst, left, error, x[j], c[j], product, curvature, -limits[rows + j], limits[rows + n + j], largest,
            dual_units[j], objective[1] / coefficients[rows + j],
        )
    beside_sizes(worst, objective[0])


@compiled_part
def measure(  # type: ignore[no-untyped-def]
    P, c, C, d, is_equality, lower, upper, objective, k, at_P, at_C, workspace, x, y, reduced, measures
):
    """Write upper bounds of the same of program k, in dense arrays; return the largest.

    Of a bound that x is at the multiplier is what stationarity leaves; `reduced` is that of the lower one less that of
    the upper one. `workspace` has four rows of n numbers; objective[k] the size of the objective and its
    smallest cost.
    """
    size_of_all, least = objective[k, 0], objective[k, 1]
    m, n = C.shape[1], C.shape[2]
    margin, worst = 2.0 * (n + m + 8) * EPSILON, measures[k]
    worst[:] = 0.0
    slope, right, violated, has_P = 0.0, 0.0, 0.0, False
    for j in range(n):
        workspace[UNIT, j] = 0.0  # the largest entry of each column
        for i in range(n):
            workspace[UNIT, j] = max(workspace[UNIT, j], abs(P[at_P, i, j]) / size_of_all)
        has_P |= workspace[UNIT, j] > 0.0
        workspace[SUM, j], workspace[SIZE, j], workspace[LARGEST, j] = c[k, j], abs(c[k, j]), abs(c[k, j])
    for i in range(m):
        value, size, largest, coefficient = 0.0, 0.0, 0.0, 0.0
        multiplier, limit = y[k, i], d[k, i]
        for j in range(n):
            entry = C[at_C, i, j]
            summand = entry * x[k, j]
            value += summand
            size += abs(summand)
            largest = max(largest, abs(summand))
            coefficient = max(coefficient, abs(entry))
            pull = entry * multiplier
            workspace[SUM, j] += pull
            workspace[SIZE, j] += abs(pull)
            workspace[LARGEST, j] = max(workspace[LARGEST, j], abs(pull))
        coefficient = coefficient if coefficient > 0.0 else 1.0
        for j in range(n):
            workspace[UNIT, j] = max(workspace[UNIT, j], abs(C[at_C, i, j]) / coefficient)
        unit, error = coefficient + abs(limit), margin * (size + abs(limit))
        judge_row(
            worst, value - limit, error, limit, largest, multiplier, unit, coefficient, least, is_equality[i]
        )
        if is_equality[i]:
            right = max(right, abs(limit) / coefficient)
        else:
            violated = max(violated, -limit / coefficient)
    for j in range(n):
        column = workspace[UNIT, j] if workspace[UNIT, j] > 0.0 else 1.0
        workspace[UNIT, j] = column
        slope = max(slope, abs(c[k, j]) / size_of_all / column)
    unit = 1.0 + (max(slope, right, violated) if has_P else slope)
    for j in range(n):
        value, size, largest = 0.0, 0.0, workspace[LARGEST, j]
        for i in range(n):
            summand = P[at_P, j, i] * x[k, i]
            value += summand
            size += abs(summand)
            largest = max(largest, abs(summand))
        left, error = workspace[SUM, j] + value, margin * (size + workspace[SIZE, j])
        reduced[k, j] = 0.0
        if x[k, j] == (lower[k, j] if left > 0.0 else upper[k, j]):  # what is left is the multiplier of that bound
            worst[PRODUCT_SIZE] = max(worst[PRODUCT_SIZE], abs(left * x[k, j]))
            reduced[k, j], left = left, 0.0
        judge_column(
            worst, left, error, x[k, j], c[k, j], value, P[at_P, j, j], lower[k, j], upper[k, j], largest,
            size_of_all * workspace[UNIT, j] * unit, least,
        )
    return beside_sizes(worst, size_of_all)
