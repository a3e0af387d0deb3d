"""Proofs that a quadratic program has no minimum: contradicting constraints, or a direction of endless descent.

Rows of one variable become bounds, then each row is held against the bounds. Where that does not decide, a linear
program of HiGHS says where to look; the answer is repaired and then checked in rational arithmetic on the program's
own numbers. Nothing else counts as a proof.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.kernels.floats import EPSILON
from ...proofs.exact.linear_systems import solved_nearby
from ...proofs.exact.rational import ZERO, Vector, rational, short
from ...proofs.no_solution.farkas import FarkasProgram, Multipliers, linear_program
from ...proofs.no_solution.free_motion import falling_directions
from ...proofs.no_solution.linear_constraints import DECISIVE, Contradiction
from ...systems.equilibration import evened
from .constraints import stationarity
from .criterion import PROGRAM_TOLERANCE
from .qp_proofs import QPInfeasibility, QPUnboundedness, losses
from .reductions import FoldedRows, fold_simple_rows

if TYPE_CHECKING:
    from .program import QuadraticProgram

LARGEST = 5000  # variables and rows of a program that is worth the linear programs
MOST_NONZEROS = 1_000_000
MANY_NONZEROS = 10_000  # beyond, fractions take longer than the linear program
LARGEST_DENSE = 1500
LARGEST_ENTRY = (1.0,)  # of each row is brought near 1
T = TypeVar("T", QPInfeasibility, QPUnboundedness)
NARROW, MET = 1e-7, 1e-8  # a room that may be none, and what is then left of a row that is an equation


def proof_of_no_minimum(
    program: QuadraticProgram, *, exactly: bool = False, is_met: bool = False
) -> QPInfeasibility | QPUnboundedness | None:
    """Return a proof that the convex program is infeasible or unbounded, or None where none was found.

    Parameters
    ----------
    program : QuadraticProgram
        Up to 5000 variables and rows with a million nonzeros; beyond, only single rows that contradict the bounds are
        found.
    exactly : bool
        Look for a proof of all x, however large the program is; by default one within a radius does where there are
        more than 10 000 nonzeros.
    is_met : bool
        An x is known that violates no constraint by much: only a direction of endless descent is looked for.

    Notes
    -----
    Cost: a look at each row, at any size; then two linear programs and, where they find something, up to five more and
    eliminations in rationals among the constraints that matter. None is no proof that there is a minimum.

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
    unbounded: the objective falls without end along a direction from a feasible point (checked exactly)
    """
    rows = fold_simple_rows(program)
    row = None if is_met else contradictory_row(rows.folded)
    found: QPInfeasibility | QPUnboundedness | None = row
    if row is None or row.margin < DECISIVE:
        other = prove_unheld(rows.folded) or _by_programs(rows.folded, exactly, is_met)
        found = row if other is None or (row is not None and row.margin > other.margin) else other
    if found is None or rows.folded is program:
        return found
    unfolded = _unfolded(rows, found)
    # A bound that a row gives is rounded, the row is not.
    return unfolded if unfolded.verify() else prove_unheld(program) or _by_programs(program, exactly, is_met)


def _by_programs(
    program: QuadraticProgram, exactly: bool, is_met: bool
) -> QPInfeasibility | QPUnboundedness | None:
    """Return a proof that linear programs find."""
    entries = sum(program.matrices.entries)
    if program.n + program.constraints.rows > LARGEST or entries > MOST_NONZEROS:
        return None
    exactly = exactly or entries <= MANY_NONZEROS
    contradiction = None if is_met else prove_infeasible(program, exactly=exactly)
    return contradiction or prove_unbounded(program, exactly=exactly)


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
    rows = program.constraints.within_bounds
    proofs = (with_bounds(program, {i: Fraction(sign)}) for i, sign in rows.contradictory_rows())
    return next((proof for proof in proofs if proof.verify()), None)


def with_bounds(program: QuadraticProgram, y: dict[int, Fraction]) -> QPInfeasibility:
    """Return multipliers of all rows with those of the bounds, which take up what the rows leave: a proof, or none."""
    m, p, n, _ = program.constraints.sizes
    multipliers = [ZERO] * (m + p + 2 * n)
    found = Contradiction(program.constraints.within_bounds, y)
    for i, value in y.items():
        multipliers[i] = value
    for j, value in found.product.items():  # what an open side leaves is rounding, or no proof
        if j not in found.left:
            multipliers[m + p + (n + j if value > 0 else j)] = abs(value)
    return QPInfeasibility(program, tuple(multipliers))


def prove_infeasible(program: QuadraticProgram, *, exactly: bool = True) -> QPInfeasibility | None:
    """Return multipliers that contradict each other, exactly if they are to; None where none were found.

    The linear program is the dual of the least uniform shift of all right-hand sides that makes them consistent.
    """
    constraints = program.constraints
    if not np.isfinite(constraints.unit[constraints.finite]).all():
        return None
    farkas = FarkasProgram(constraints.within_bounds, 1.0)
    answer = farkas.solve()
    if answer is None or not answer.is_contradiction:
        return None

    def proven(y: Multipliers) -> QPInfeasibility | None:
        proof = with_bounds(program, {i: Fraction(value) for i, value in enumerate(y) if value})
        return proof if proof.margin > 0.0 else None

    return (None if exactly else _if_enough(proven(farkas.polished(answer)))) or farkas.proof(answer, proven)


def prove_unheld(program: QuadraticProgram) -> QPUnboundedness | None:
    """Return a feasible point and a motion that P does not resist, no constraint ends, and along which cᵀx falls.

    One factorisation of P, whatever its size. A feasible point of more than 5000 variables and rows is found only where
    x nearest to 0 within its bounds is one.
    """
    null_space = program.matrices.null_space
    if null_space is None:
        return None
    rows = program.constraints
    is_said = np.flatnonzero(np.isfinite(rows.limit[: rows.rows]))
    directions = falling_directions(
        program.P, null_space, program.c, np.isfinite(program.lower), np.isfinite(program.upper),
        program.matrices.rows[is_said], rows.is_equality[is_said],
    )
    points: tuple[Vector, ...] = ()
    for d in directions:
        points = points or _points(program)
        for point in reversed(points):
            proof = QPUnboundedness(program, tuple(point), tuple(rational(d)))
            if proof.verify():
                return proof
    return None


def _points(program: QuadraticProgram) -> tuple[Vector, ...]:
    """Return feasible points: x nearest to 0 within its bounds, or what a linear program of moderate size finds."""
    x = np.clip(0.0, program.lower, program.upper)
    if not (program.constraints.excess(x) > 0.0).any():
        return (rational(x),)
    return points_inside(program) if program.n + program.constraints.rows <= LARGEST else ()


def prove_unbounded(program: QuadraticProgram, *, exactly: bool = True) -> QPUnboundedness | None:
    """Return a feasible point and a direction of endless descent, exactly if they are to; None where none were found.

    Such a direction contradicts the conditions P x + c + Gᵀy + Aᵀv = 0, y ≥ 0, with the signs that bounds permit.
    """
    if program.matrices.is_definite:
        return None
    P = sp.csr_array(program.P)
    farkas = FarkasProgram(stationarity(program, P[_independent_rows(P)]))
    answer = farkas.solve()
    if answer is None or not answer.is_contradiction:
        return None
    points: list[tuple[Vector, ...]] = []

    def proven(d: Multipliers) -> QPUnboundedness | None:
        if not points:
            points.append(points_inside(program))
        for point in reversed(points[0]):
            proof = QPUnboundedness(program, tuple(point), tuple(map(Fraction, d)))
            # Beside a direction that is none exactly, a point that meets rounded rows exactly may be far away.
            if proof.is_exact or (point is points[0][0] and proof.verify()):
                return proof
        return None

    return (None if exactly else _if_enough(proven(farkas.polished(answer)))) or farkas.proof(answer, proven)


def _if_enough(proof: T | None) -> T | None:
    """Return the proof where it counts at the tolerances that programs are solved to."""
    return proof if proof is not None and proof.excludes(PROGRAM_TOLERANCE) else None


def _independent_rows(P: sp.csr_array) -> NDArray[np.intp]:
    """Return rows of P that span the others to rounding, by a pivoted QR decomposition; all where P is large.

    A P = F Fᵀ that rounding has made nonsingular would leave no direction otherwise.
    """
    from scipy.linalg import qr

    if not P.nnz or P.shape[0] > LARGEST_DENSE:
        return np.arange(P.shape[0] if P.nnz else 0)
    root = np.sqrt(np.maximum(P.diagonal(), 0.0))
    scale = 1.0 / np.where(root > 0.0, root, 1.0)
    R, order = qr(scale[:, None] * P.toarray() * scale, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.count_nonzero(diagonal > P.shape[0] * 8 * EPSILON * diagonal.max(initial=0.0)))
    return np.asarray(order[:rank], dtype=np.intp)


def feasible_point(program: QuadraticProgram) -> Vector | None:
    """Return a point that satisfies all constraints exactly, as far inside as a linear program finds."""
    _, *exact = points_inside(program) or (None,)
    return exact[0] if exact else None


def points_inside(program: QuadraticProgram) -> tuple[Vector, ...]:
    """Return a point that satisfies all constraints to rounding, and one that does so exactly; those that are found."""
    constraints, n = program.constraints, program.n
    matrix, limit, finite = constraints.matrix, constraints.limit, constraints.finite
    is_row, is_equality = np.arange(limit.size) < constraints.rows, constraints.is_equality
    sides = sp.hstack([matrix, np.where(is_row & np.isfinite(limit), limit, 0.0)[:, None]], format="csr")
    scale = np.where(is_row, np.ldexp(1.0, evened(sides, LARGEST_ENTRY, 900).row), 1.0)
    equal, most = finite[is_equality[finite]], finite[~is_equality[finite]]
    is_fixed = np.tile(program.lower == program.upper, 2)
    margin = ~np.concatenate([np.zeros(constraints.rows, dtype=bool), is_fixed])

    def scaled(rows: NDArray[np.intp], inside: Any) -> Any:
        return sp.hstack([sp.diags_array(scale[rows]) @ matrix[rows], inside[:, None]])

    answer = linear_program(
        np.append(np.zeros(n), -1.0), scaled(equal, np.zeros(equal.size)), (scale * limit)[equal],
        [(None, None)] * n + [(0.0, 1.0)],
        (scaled(most, margin[most].astype(np.float64)), (scale * limit)[most]),
    )
    if answer is None:
        return ()
    x = np.clip(answer.x[:-1], program.lower, program.upper)
    rows = most[is_row[most]]
    value = scale[rows] * (matrix[rows] @ x - limit[rows])
    tight = rows[np.abs(value) <= MET] if answer.x[-1] <= NARROW else rows[:0]
    at_bound = (x <= program.lower) | (x >= program.upper)
    guess = [near if not stuck else exact
             for near, stuck, exact in zip(short(x, 1 << 40), at_bound, rational(x), strict=True)]
    system = [*equal.tolist(), *tight.tolist()]
    exact = solved_nearby(
        [constraints.exactly[i] for i in system], rational(limit[system]), guess, [not stuck for stuck in at_bound]
    )
    return (guess, exact) if exact is not None and not any(losses(constraints, exact)) else (guess,)
