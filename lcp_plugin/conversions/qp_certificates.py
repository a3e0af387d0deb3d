"""Proofs that a quadratic program has no minimum: contradicting constraints, or a direction of endless descent.

Rows of one variable become bounds, then each row is held against the bounds. Where that does not decide, a linear
program of HiGHS says where to look; the answer is repaired and then checked in rational arithmetic on the program's
own numbers. Nothing else counts as a proof.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..exact.linear_systems import solved_nearby
from ..exact.rational import ZERO, Row, Vector, rational, rational_rows, short, transposed_product
from ..kernels.floats import EPSILON
from .constraints import FoldedRows, fold_simple_rows, largest_entries
from .qp_proofs import QPInfeasibility, QPUnboundedness, combination, is_feasible, is_recession

if TYPE_CHECKING:
    from .program import QuadraticProgram

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
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[0.0]], [1.0], G=[[1.0], [-1.0]], h=[0.0, -1.0])
    >>> print(proof_of_no_minimum(program))
    infeasible: 2 of its constraints contradict one another (multipliers checked exactly)
    >>> print(proof_of_no_minimum(QuadraticProgram([[0.0]], [1.0], upper=1.0)))
    unbounded: the objective falls for ever along a direction from a feasible point (checked exactly)
    """
    rows = fold_simple_rows(program)
    row = contradictory_row(rows.folded)
    found = row if row is not None and row.margin >= DECISIVE else _larger(_by_programs(rows.folded), row)
    if found is None or rows.folded is program:
        return found
    unfolded = _unfolded(rows, found)
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


def _unfolded(
    rows: FoldedRows, proof: QPInfeasibility | QPUnboundedness
) -> QPInfeasibility | QPUnboundedness:
    """Return the proof in the terms of the whole program: what a bound has, its row gets."""
    if isinstance(proof, QPUnboundedness):
        return replace(proof, program=rows.program)
    multipliers = rows.unfold(np.array(proof.multipliers, dtype=object))
    return QPInfeasibility(rows.program, tuple(map(Fraction, multipliers)))


def contradictory_row(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return the proof of the row that x within the bounds miss by most; None where no single row is enough."""
    rows = program.constraints
    both = rows.missing
    above, missing = both[0], both.max(axis=0)
    suspects = np.flatnonzero(missing > 0.0)
    for i in suspects[np.argsort(-missing[suspects], kind="stable")][:SUSPECTS].tolist():
        y = [ZERO] * rows.rows
        y[i] = Fraction(1 if above[i] > 0.0 else -1)
        proof = _with_bounds(program, y, combination(rows, [i], [y[i]]))
        if proof.verify():
            return proof
    return None


def _with_bounds(program: QuadraticProgram, y: Vector, left: Vector) -> QPInfeasibility:
    """Return multipliers of all rows with those of the bounds, which take up what the rows leave."""
    bounds = [max(sign * entry, ZERO) for sign in (1, -1) for entry in left]
    return QPInfeasibility(program, (*y, *bounds))


def prove_infeasible(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return multipliers that contradict each other, exactly; None where none were found.

    The linear program is the dual of the least uniform shift of all right-hand sides that makes them consistent.
    """
    rows, finite = program.constraints, program.constraints.finite
    unit, matrix, is_row = rows.unit[finite], rows.matrix[finite], finite < rows.rows
    if not np.isfinite(unit).all():
        return None
    entries = largest_entries(matrix, 1)
    scale = _powers_of_two(np.minimum(unit, MOST_SHRUNK * np.where(entries > 0.0, entries, 1.0)))
    column_scale = _powers_of_two(largest_entries(rows.matrix[: rows.rows], 0))
    # An equation holds in both directions.
    listed = np.insert(np.arange(finite.size), is_row.sum(), np.flatnonzero(rows.is_equality[finite]))
    sign = np.where((np.arange(listed.size) >= is_row.sum()) & is_row[listed], -1.0, 1.0) * scale[listed]
    values, weights = sign * rows.limit[finite][listed], sp.csr_array((unit * scale)[listed][None, :])
    equations = sp.diags_array(column_scale) @ (sp.diags_array(sign) @ matrix[listed]).T
    bounds: list[Any] = [(0.0, None)] * listed.size
    answer = _minimised(values, equations, (weights, np.ones(1)), bounds)
    if answer is None:
        return None
    wanted = -NEAR_ENOUGH * float(values @ answer)

    def repaired(answer: FloatVector) -> QPInfeasibility | None:
        used = np.where(answer > NEGLIGIBLE * answer.max(), answer, 0.0)
        y = np.zeros(rows.limit.size)
        y[finite] = np.bincount(listed, sign * used, finite.size)
        # A bound's multiplier takes up what the rows leave.
        leaning = np.add(*rows.split(y)[2:]) > 0.0
        return _repaired_multipliers(program, y[: rows.rows], ~leaning, wanted)

    return repaired(answer) or repaired(_widest(values, equations, weights, bounds, answer))


def _widest(values: FloatVector, equations: Any, limit: Any, bounds: list[Any], answer: FloatVector) -> FloatVector:
    """Return multipliers with half the margin and as many of them positive as can be.

    A vertex has as few as it can: where the coefficients carry rounding errors, those may vanish together only.
    """
    m, share = values.size, ROOM / limit.sum()
    half_the_margin = sp.vstack([limit, values[None, :]]), [1.0, 0.5 * (values @ answer)]
    return _with_room(-sp.eye_array(m), np.zeros(m), share, half_the_margin, equations, bounds, answer)


def _with_room(
    rows: Any, limits: FloatVector, room: float, others: tuple[Any, Any], equations: Any, bounds: list[Any],
    answer: FloatVector,
) -> FloatVector:
    """Return x with rows · x ≤ limits − t, t as large as can be up to `room`, and others · x ≤ their limits."""
    m, n = rows.shape
    wide = _minimised(
        np.append(np.zeros(n), -np.ones(m)), sp.hstack([equations, sp.csr_array((equations.shape[0], m))]),
        (sp.block_array([[others[0], None], [rows, sp.eye_array(m)]]), np.concatenate([others[1], limits])),
        [*bounds, *[(0.0, room)] * m],
    )
    return answer if wide is None else wide[:n]


def _repaired_multipliers(
    program: QuadraticProgram, y: FloatVector, must_vanish: NDArray[np.bool_], wanted: float
) -> QPInfeasibility | None:
    """Return exact multipliers of the rows of G and A near y, the first of the margin wanted, else of the largest.

    Their combination is zero in the columns that must vanish, elsewhere a bound takes it up.
    """
    stacked = program.constraints.matrix[: y.size]
    rows, columns = rational_rows(stacked), rational_rows(sp.csr_array(stacked.T)[np.flatnonzero(must_vanish)])
    plain = np.abs(y).max(initial=0.0)
    best: QPInfeasibility | None = None
    for exact in _near(columns, [few_digits(y / plain), short(y), short(y, 1 << 60)] if plain else []):
        proof = _with_bounds(program, exact, transposed_product(rows, exact, program.n))
        if proof.margin > (0.0 if best is None else best.margin):
            best = proof
        if best is not None and best.margin >= wanted:
            return best
    return best


def prove_unbounded(program: QuadraticProgram) -> QPUnboundedness | None:
    """Return a feasible point and a direction of endless descent; None where none were found."""
    rows = rational_rows(program.constraints.matrix)
    point: Vector | None = None
    for direction in _directions(program, rows):
        point = point or _feasible_point(program, rows)
        if point is None:
            return None
        for is_exact in (True, False):
            certificate = QPUnboundedness(program, tuple(point), tuple(direction), is_exact)
            if certificate.verify():
                return certificate
    return None


def _directions(program: QuadraticProgram, exact_rows: list[Row]) -> Iterator[Vector]:
    """Yield candidates: exact in all but perhaps P d = 0."""
    P, constraints, m = sp.csr_array(program.P), program.constraints, program.h.size
    equations = sp.vstack([_equilibrated(P), _equilibrated(constraints.matrix[m : constraints.rows])], format="csr")
    finite = np.flatnonzero(np.isfinite(program.h))
    rows = _equilibrated(constraints.matrix[finite])
    box = [
        (0.0 if np.isfinite(low) else -1.0, 0.0 if np.isfinite(high) else 1.0)
        for low, high in zip(program.lower, program.upper, strict=True)
    ]
    cost = program.c * _powers_of_two(np.array([np.abs(program.c).max(initial=0.0)]))[0]
    d = _minimised(cost, equations, (rows, np.zeros(finite.size)), box)
    if d is None:
        return
    curved = rational_rows(P)
    flat = [*(curved[i] for i in _independent_rows(P)), *exact_rows[m : constraints.rows]]

    def exactly(near: FloatVector) -> Iterator[Vector]:
        near = np.where(np.abs(near) > NEGLIGIBLE, near, 0.0)
        system = [*flat, *(exact_rows[i] for i in finite[np.abs(rows @ near) <= TIGHT].tolist())]
        for exact in _near(system, [few_digits(near), short(near, 1 << 60)]):
            if any(exact) and is_recession(constraints, exact_rows, exact):
                yield exact

    yield from exactly(d)
    # A vertex holds as many rows as it can: with their rounding errors they may leave no direction but zero.
    if finite.size:
        half_as_steep = sp.csr_array(cost[None, :]), [0.5 * (cost @ d)]
        yield from exactly(_with_room(rows, np.zeros(finite.size), ROOM, half_as_steep, equations, box, d))


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


def _near(system: list[Row], guesses: list[Vector]) -> Iterator[Vector]:
    """Yield exact solutions of system · x = 0 near the guesses; what is zero stays so."""
    for guess in guesses:
        exact = solved_nearby(system, [ZERO] * len(system), guess, [bool(entry) for entry in guess])
        if exact is not None:
            yield exact


def few_digits(values: FloatVector) -> Vector:
    """Return fractions with denominators up to 1000 near values of at most about 1."""
    return [Fraction(value).limit_denominator(1000) for value in values.tolist()]


def _feasible_point(program: QuadraticProgram, exact_rows: list[Row]) -> Vector | None:
    """Return a point that satisfies all constraints exactly, as far inside as a linear program finds."""
    constraints, n = program.constraints, program.n
    matrix, limit, is_equality = constraints.matrix, constraints.limit, constraints.is_equality
    is_row = np.arange(limit.size) < constraints.rows
    scale = np.where(is_row, _powers_of_two(np.maximum(largest_entries(matrix, 1), np.abs(limit))), 1.0)
    finite = constraints.finite
    equal, most = finite[is_equality[finite]], finite[~is_equality[finite]]
    is_fixed = np.tile(program.lower == program.upper, 2)
    margin = ~np.concatenate([np.zeros(constraints.rows, dtype=bool), is_fixed])

    def scaled(rows: NDArray[np.intp], inside: Any) -> Any:
        return sp.hstack([sp.diags_array(scale[rows]) @ matrix[rows], inside[:, None]])

    answer = _minimised(
        np.append(np.zeros(n), -1.0), scaled(equal, np.zeros(equal.size)),
        (scaled(most, margin[most].astype(np.float64)), (scale * limit)[most]),
        [(None, None)] * n + [(0.0, 1.0)], (scale * limit)[equal], only_negative=False,
    )
    if answer is None:
        return None
    x = np.clip(answer[:-1], program.lower, program.upper)
    rows = most[is_row[most]]
    value = scale[rows] * (matrix[rows] @ x - limit[rows])
    tight = rows[np.abs(value) <= NEGLIGIBLE * 10] if answer[-1] <= 1e-7 else rows[:0]
    at_bound = (x <= program.lower) | (x >= program.upper)
    guess = [near if not stuck else exact
             for near, stuck, exact in zip(short(x, 1 << 40), at_bound, rational(x), strict=True)]
    system = [*equal.tolist(), *tight.tolist()]
    exact = solved_nearby(
        [exact_rows[i] for i in system], rational(limit[system]), guess, [not stuck for stuck in at_bound]
    )
    return exact if exact is not None and is_feasible(constraints, exact_rows, exact) else None


def _minimised(
    cost: FloatVector, equations: Any, inequalities: tuple[Any, FloatVector], bounds: list[Any],
    right: FloatVector | float = 0.0, *, only_negative: bool = True,
) -> FloatVector | None:
    """Return a vertex that minimises the cost, by HiGHS; None without one, or where the minimum is not negative."""
    from scipy.optimize import linprog

    if not cost.size:
        return None
    answer = linprog(
        cost, A_ub=sp.csr_array(inequalities[0]), b_ub=inequalities[1], A_eq=sp.csr_array(equations),
        b_eq=np.broadcast_to(right, equations.shape[0]), bounds=bounds, method="highs",
        options={"primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE},
    )
    if answer.x is None or answer.status != 0 or (only_negative and answer.fun > -NEGLIGIBLE):
        return None
    x: FloatVector = np.asarray(answer.x)
    return x


def _powers_of_two(sizes: FloatVector) -> FloatVector:
    """Return 2^−k near 1/size, 1 for size 0."""
    safe = np.where(sizes > 0.0, sizes, 1.0)
    return np.asarray(np.exp2(np.clip(-np.round(np.log2(safe)), -900, 900)))


def _equilibrated(matrix: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(sp.diags_array(_powers_of_two(largest_entries(matrix, 1))) @ matrix)
