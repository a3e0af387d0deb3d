"""Proofs that a quadratic program has no minimum: contradicting constraints, or a direction of endless descent.

Rows of one variable become bounds, then each row is held against the bounds. Where that does not decide, a linear
program of HiGHS says where to look; the answer is repaired and then checked in rational arithmetic on the program's
own numbers. Nothing else counts as a proof.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..exact.linear_systems import solved_nearby
from ..exact.rational import ZERO, Row, Vector, rational, rational_rows, short, transposed_product
from ..kernels.floats import EPSILON
from .qp_proofs import QPInfeasibility, QPUnboundedness, is_feasible, is_recession
from .quadratic_program import QuadraticProgram
from .simple_rows import OWN, FoldedRows, activity, fold_simple_rows

__all__ = ["QPInfeasibility", "QPUnboundedness", "proof_of_no_minimum", "prove_infeasible", "prove_unbounded"]

LARGEST = 5000  # variables and rows of a program that is worth the linear programs
MOST_NONZEROS = 300_000
ROOM = 0.1  # in a row, for a direction of entries up to 1
LARGEST_DENSE = 1500
LP_TOLERANCE = 1e-10
TIGHT = 1e-7  # times the size of a row: tight to a linear program
NEGLIGIBLE = 1e-9  # below this HiGHS's answers say nothing
MOST_SHRUNK = 2.0**20  # HiGHS drops coefficients below 1e-9
SUSPECTS = 8  # rows that are checked exactly
DECISIVE = 1e-3  # a margin that no tolerance in use reaches: a larger one is not looked for
NEAR_ENOUGH = 0.5  # of the margin that a linear program promises


def proof_of_no_minimum(program: QuadraticProgram) -> QPInfeasibility | QPUnboundedness | None:
    """Return a proof that the convex program is infeasible or unbounded, or None where none was found.

    Parameters
    ----------
    program : QuadraticProgram
        Up to 5000 variables and rows; beyond, only single rows that contradict the bounds are found.

    Notes
    -----
    Cost: a look at each row, at any size; then up to three linear programs, and an elimination in rationals among the
    constraints that matter. None is no proof that there is a minimum.

    References
    ----------
    O. L. Mangasarian, *Nonlinear Programming*, SIAM 1994, doi:10.1137/1.9781611971255, §2.4.

    Examples
    --------
    >>> program = QuadraticProgram([[0.0]], [1.0], G=[[1.0], [-1.0]], h=[0.0, -1.0])
    >>> print(proof_of_no_minimum(program))
    infeasible: 2 of its constraints contradict one another (multipliers checked exactly)
    >>> print(proof_of_no_minimum(QuadraticProgram([[0.0]], [1.0], upper=1.0)))
    unbounded: the objective falls for ever along a direction from a feasible point (checked exactly)
    """
    rows = fold_simple_rows(program)
    reduced = _folded(program, rows)
    row = contradictory_row(reduced)
    found = row if row is not None and row.margin >= DECISIVE else _larger(_by_programs(reduced), row)
    if found is None or reduced is program:
        return found
    unfolded = _unfolded(program, rows, found)
    # A bound that a row gives is rounded, the row is not.
    return unfolded if unfolded.verify() else _by_programs(program)


def _larger(
    found: QPInfeasibility | QPUnboundedness | None, row: QPInfeasibility | None
) -> QPInfeasibility | QPUnboundedness | None:
    """Return the proof of the larger margin."""
    return row if found is None or (row is not None and row.margin > found.margin) else found


def _by_programs(program: QuadraticProgram) -> QPInfeasibility | QPUnboundedness | None:
    """Return a proof that linear programs find."""
    entries = sum(sp.csr_array(matrix).nnz for matrix in (program.P, program.G, program.A))
    if program.n + program.h.size + program.b.size > LARGEST or entries > MOST_NONZEROS:
        return None
    return prove_infeasible(program) or prove_unbounded(program)


def _folded(program: QuadraticProgram, rows: FoldedRows) -> QuadraticProgram:
    """Return the program with its simple rows as bounds; the program itself where it has none."""
    if rows.count == program.h.size + program.b.size:
        return program
    inequalities, equalities = rows.inequalities, rows.equalities
    return QuadraticProgram(
        program.P, program.c, program.G[inequalities], program.h[inequalities],
        program.A[equalities], program.b[equalities], rows.lower, rows.upper,
    )


def _unfolded(
    program: QuadraticProgram, rows: FoldedRows, proof: QPInfeasibility | QPUnboundedness
) -> QPInfeasibility | QPUnboundedness:
    """Return the proof in the terms of the whole program: what a bound has, its row gets."""
    if isinstance(proof, QPUnboundedness):
        return replace(proof, program=program)
    m = program.h.size
    multipliers = [ZERO] * rows.coefficient.size
    kept = np.concatenate([rows.inequalities, m + rows.equalities]).tolist()
    for i, value in zip(kept, (*proof.inequality, *proof.equality), strict=True):
        multipliers[i] = value
    own: list[list[Fraction]] = []
    for values, owner, sign in ((proof.lower, rows.lower_row, -1), (proof.upper, rows.upper_row, 1)):
        own.append([value if row == OWN else ZERO for value, row in zip(values, owner, strict=True)])
        for value, row in zip(values, owner.tolist(), strict=True):
            if value and row != OWN:
                multipliers[row] += sign * value / Fraction(float(rows.coefficient[row]))
    return QPInfeasibility(
        program, tuple(multipliers[:m]), tuple(multipliers[m:]), tuple(own[0]), tuple(own[1])
    )


def contradictory_row(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return the proof of the row that x within the bounds miss by most; None where no single row is enough."""
    stacked = sp.csr_array(sp.vstack([sp.csr_array(program.G), sp.csr_array(program.A)], format="csr"))
    m, count = program.h.size, stacked.shape[0]
    lowest, highest = activity(stacked, program.lower, program.upper)
    limits = np.concatenate([program.h, program.b])
    unit = np.concatenate([program.units.inequality, program.units.equality])
    with np.errstate(invalid="ignore"):
        missing = np.maximum(lowest - limits, np.where(np.arange(count) >= m, limits - highest, -np.inf)) / unit
    suspects = np.flatnonzero(missing > 0.0)
    for i in suspects[np.argsort(-missing[suspects], kind="stable")][:SUSPECTS].tolist():
        y = [ZERO] * count
        y[i] = Fraction(1 if lowest[i] > limits[i] else -1)
        proof = _with_bounds(program, y, transposed_product(rational_rows(stacked[[i]]), [y[i]], program.n))
        if proof.verify():
            return proof
    return None


def _with_bounds(program: QuadraticProgram, y: Vector, left: Vector) -> QPInfeasibility:
    """Return multipliers of all rows with those of the bounds, which take up what the rows leave."""
    m = program.h.size
    return QPInfeasibility(
        program, tuple(y[:m]), tuple(y[m:]),
        tuple(max(entry, ZERO) for entry in left), tuple(max(-entry, ZERO) for entry in left),
    )


def prove_infeasible(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return multipliers that contradict each other, exactly; None where none were found.

    The linear program is the dual of the least uniform shift of all right-hand sides that makes them consistent.
    """
    n, m, p, units = program.n, program.h.size, program.b.size, program.units
    has_limit = np.isfinite(program.h)
    stacked = sp.csr_array(sp.vstack([sp.csr_array(program.G), sp.csr_array(program.A)], format="csr"))
    limits = np.concatenate([np.where(has_limit, program.h, 0.0), program.b])
    identity = sp.eye_array(n, format="csr")
    below, above = (np.flatnonzero(np.isfinite(bound)) for bound in (program.lower, program.upper))
    sizes = [np.concatenate([units.inequality, units.equality]), units.lower[below], units.upper[above]]
    if not np.isfinite(np.concatenate(sizes)).all():
        return None
    entries = [_row_largest(stacked), np.ones(below.size), np.ones(above.size)]
    scale, *bound_scale = (
        _powers_of_two(np.minimum(size, MOST_SHRUNK * np.where(entry > 0.0, entry, 1.0)))
        for size, entry in zip(sizes, entries, strict=True)
    )
    column_scale = _powers_of_two(_row_largest(stacked.T))
    scaled, right = sp.diags_array(scale) @ stacked, scale * limits
    rows = sp.vstack(
        [scaled, -scaled[m:], -sp.diags_array(bound_scale[0]) @ identity[below],
         sp.diags_array(bound_scale[1]) @ identity[above]], format="csr",
    )
    values = np.concatenate(
        [right, -right[m:], -bound_scale[0] * program.lower[below], bound_scale[1] * program.upper[above]]
    )
    own, *of_bounds = (size * near for size, near in zip(sizes, (scale, *bound_scale), strict=True))
    weights = np.concatenate([own, own[m:], *of_bounds])
    bounds = [(0.0, None if finite else 0.0) for finite in has_limit] + [(0.0, None)] * (values.size - m)
    equations, limit = sp.diags_array(column_scale) @ rows.T, sp.csr_array(weights[None, :])
    answer = _minimised(values, equations, (limit, np.ones(1)), bounds)
    if answer is None:
        return None
    wanted = -NEAR_ENOUGH * float(values @ answer)

    def repaired(answer: FloatVector) -> QPInfeasibility | None:
        y = np.where(answer > NEGLIGIBLE * answer.max(), answer, 0.0)
        own = y[: m + p].copy()
        own[m:] -= y[m + p : m + 2 * p]
        at = m + 2 * p
        leaning = np.zeros(n, dtype=bool)  # where a bound's multiplier takes up what the rows leave
        leaning[below[y[at : at + below.size] > 0.0]] = True
        leaning[above[y[at + below.size :] > 0.0]] = True
        return _repaired_multipliers(program, stacked, scale * own, ~leaning, wanted)

    return repaired(answer) or repaired(_widest(values, equations, limit, bounds, answer))


def _widest(values: FloatVector, equations: Any, limit: Any, bounds: list[Any], answer: FloatVector) -> FloatVector:
    """Return multipliers with half the margin and as many of them positive as can be.

    A vertex has as few as it can: where the coefficients carry rounding errors, those may vanish together only.
    """
    m = values.size
    identity, share = sp.eye_array(m), ROOM / limit.sum()
    inequalities = sp.block_array([[limit, None], [values[None, :], None], [-identity, identity]])
    wide = _minimised(
        np.append(np.zeros(m), -np.ones(m)), sp.hstack([equations, sp.csr_array((equations.shape[0], m))]),
        (inequalities, np.concatenate([[1.0, 0.5 * (values @ answer)], np.zeros(m)])), [*bounds, *[(0.0, share)] * m],
    )
    return answer if wide is None else wide[:m]


def _repaired_multipliers(
    program: QuadraticProgram, stacked: sp.csr_array, y: FloatVector, must_vanish: NDArray[np.bool_], wanted: float
) -> QPInfeasibility | None:
    """Return exact multipliers near y, the first of the margin wanted, else those of the largest.

    stackedᵀ y is zero in the columns that must vanish, or a bound takes it up.
    """
    rows = rational_rows(stacked)
    columns = rational_rows(sp.csr_array(stacked.T)[np.flatnonzero(must_vanish)])
    plain = np.abs(y).max(initial=0.0)
    if not plain:
        return None
    few = [Fraction(value / plain).limit_denominator(1000) for value in y.tolist()]
    best: QPInfeasibility | None = None
    for guess in (few, short(y), short(y, 1 << 60)):
        exact = solved_nearby(columns, [ZERO] * len(columns), guess, [bool(entry) for entry in guess])
        if exact is None:
            continue
        proof = _with_bounds(program, exact, transposed_product(rows, exact, program.n))
        if proof.margin > (0.0 if best is None else best.margin):
            best = proof
        if best is not None and best.margin >= wanted:
            return best
    return best


def prove_unbounded(program: QuadraticProgram) -> QPUnboundedness | None:
    """Return a feasible point and a direction of endless descent; None where none were found."""
    G, A = rational_rows(program.G), rational_rows(program.A)
    point: Vector | None = None
    for direction in _directions(program, G, A):
        point = point or _feasible_point(program, G, A)
        if point is None:
            return None
        for is_exact in (True, False):
            certificate = QPUnboundedness(program, tuple(point), tuple(direction), is_exact)
            if certificate.verify():
                return certificate
    return None


def _directions(program: QuadraticProgram, G: list[Row], A: list[Row]) -> Iterator[Vector]:
    """Yield candidates: exact in all but perhaps P d = 0."""
    P = sp.csr_array(program.P)
    equations = sp.vstack([_equilibrated(P), _equilibrated(sp.csr_array(program.A))], format="csr")
    finite = np.flatnonzero(np.isfinite(program.h))
    rows = _equilibrated(sp.csr_array(program.G)[finite])
    box = [
        (0.0 if np.isfinite(low) else -1.0, 0.0 if np.isfinite(high) else 1.0)
        for low, high in zip(program.lower, program.upper, strict=True)
    ]
    cost = program.c * _powers_of_two(np.array([np.abs(program.c).max(initial=0.0)]))[0]
    d = _minimised(cost, equations, (rows, np.zeros(finite.size)), box)
    if d is None:
        return
    curved = rational_rows(P)
    flat = [*(curved[i] for i in _independent_rows(P)), *A]

    def exactly(near: FloatVector) -> Iterator[Vector]:
        near = np.where(np.abs(near) > NEGLIGIBLE, near, 0.0)
        system = [*flat, *(G[i] for i in finite[np.abs(rows @ near) <= TIGHT].tolist())]
        for guess in (few_digits(near), short(near, 1 << 60)):
            exact = solved_nearby(system, [ZERO] * len(system), guess, [bool(entry) for entry in guess])
            if exact is not None and any(exact) and is_recession(program, G, A, exact):
                yield exact

    yield from exactly(d)
    # A vertex holds as many rows as it can: with their rounding errors they may leave no direction but zero.
    if finite.size:
        yield from exactly(_slackest(cost, equations, rows, box, d))


def _slackest(cost: FloatVector, equations: Any, rows: Any, box: list[Any], d: FloatVector) -> FloatVector:
    """Return a direction half as steep as d that leaves room in each row where descent allows it."""
    m = rows.shape[0]
    inequalities = sp.block_array([[rows, sp.eye_array(m)], [cost[None, :], None]])
    answer = _minimised(
        np.append(np.zeros(d.size), -np.ones(m)), sp.hstack([equations, sp.csr_array((equations.shape[0], m))]),
        (inequalities, np.append(np.zeros(m), 0.5 * (cost @ d))), [*box, *[(0.0, ROOM)] * m],
    )
    return d if answer is None else answer[: d.size]


def _independent_rows(P: sp.csr_array) -> list[int]:
    """Return rows of P that span the others to rounding, by a pivoted QR decomposition; all where P is large.

    A P = F Fᵀ that rounding has made nonsingular would leave no direction otherwise.
    """
    from scipy.linalg import qr

    if not P.nnz or P.shape[0] > LARGEST_DENSE:
        return list(range(P.shape[0])) if P.nnz else []
    root = np.sqrt(np.maximum(P.diagonal(), 0.0))
    scale = 1.0 / np.where(root > 0.0, root, 1.0)
    R, order = qr(scale[:, None] * P.toarray() * scale, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.count_nonzero(diagonal > P.shape[0] * 8 * EPSILON * diagonal.max(initial=0.0)))
    return [int(i) for i in order[:rank]]


def few_digits(values: FloatVector) -> Vector:
    """Return fractions with denominators up to 1000 near values of at most about 1."""
    return [Fraction(value).limit_denominator(1000) for value in values.tolist()]


def _feasible_point(program: QuadraticProgram, G: list[Row], A: list[Row]) -> Vector | None:
    """Return a point that satisfies all constraints exactly, as far inside as a linear program finds."""
    n = program.n
    finite = np.flatnonzero(np.isfinite(program.h))
    rows = sp.csr_array(program.G)[finite]
    scale = _powers_of_two(np.maximum(_row_largest(rows), np.abs(program.h[finite])))
    below, above = (np.flatnonzero(np.isfinite(bound)) for bound in (program.lower, program.upper))
    identity = sp.eye_array(n, format="csr")
    is_fixed = program.lower == program.upper
    stacked = sp.vstack([sp.diags_array(scale) @ rows, -identity[below], identity[above]], format="csr")
    margin = np.concatenate([np.ones(finite.size), ~is_fixed[below], ~is_fixed[above]])
    right = np.concatenate([scale * program.h[finite], -program.lower[below], program.upper[above]])
    equations = sp.csr_array(program.A)
    equation_scale = _powers_of_two(np.maximum(_row_largest(equations), np.abs(program.b)))
    equations = sp.hstack([sp.diags_array(equation_scale) @ equations, sp.csr_array((program.b.size, 1))])
    cost = np.append(np.zeros(n), -1.0)
    answer = _minimised(
        cost, equations, (sp.hstack([stacked, margin[:, None]]), right), [(None, None)] * n + [(0.0, 1.0)],
        equation_scale * program.b, only_negative=False,
    )
    if answer is None:
        return None
    x = np.clip(answer[:-1], program.lower, program.upper)
    value = scale * (rows @ x - program.h[finite])
    tight = finite[np.flatnonzero(np.abs(value) <= NEGLIGIBLE * 10)] if answer[-1] <= 1e-7 else finite[:0]
    at_bound = (x <= program.lower) | (x >= program.upper)
    guess = [near if not stuck else exact
             for near, stuck, exact in zip(short(x, 1 << 40), at_bound, rational(x), strict=True)]
    system = [*A, *(G[i] for i in tight)]
    exact = solved_nearby(
        system, [*rational(program.b), *rational(program.h[tight])], guess, [not stuck for stuck in at_bound]
    )
    return exact if exact is not None and is_feasible(program, G, A, exact) else None


def _minimised(
    cost: FloatVector, equations: Any, inequalities: tuple[Any, FloatVector] | None, bounds: list[Any],
    right: FloatVector | None = None, *, only_negative: bool = True,
) -> FloatVector | None:
    """Return a vertex that minimises the cost, by HiGHS; None without one, or where the minimum is not negative."""
    from scipy.optimize import linprog

    if not cost.size:
        return None
    rows, limits = inequalities if inequalities is not None and inequalities[1].size else (None, None)
    has_equations = equations.shape[0] > 0
    answer = linprog(
        cost, A_ub=None if rows is None else sp.csr_array(rows), b_ub=limits,
        A_eq=sp.csr_array(equations) if has_equations else None,
        b_eq=(np.zeros(equations.shape[0]) if right is None else right) if has_equations else None,
        bounds=bounds, method="highs",
        options={"primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE},
    )
    if answer.x is None or answer.status != 0 or (only_negative and answer.fun > -NEGLIGIBLE):
        return None
    x: FloatVector = np.asarray(answer.x)
    return x


def _row_largest(matrix: Any) -> FloatVector:
    rows = sp.csr_array(matrix)
    return np.asarray(abs(rows).max(axis=1).toarray()).ravel() if rows.shape[1] else np.zeros(rows.shape[0])


def _powers_of_two(sizes: FloatVector) -> FloatVector:
    """Return 2^−k near 1/size, 1 for size 0."""
    safe = np.where(sizes > 0.0, sizes, 1.0)
    return np.asarray(np.exp2(np.clip(-np.round(np.log2(safe)), -900, 900)))


def _equilibrated(matrix: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(sp.diags_array(_powers_of_two(_row_largest(matrix))) @ matrix)
