"""Proofs that a quadratic program has no minimum: contradicting constraints, or a direction of endless descent.

What such a proof is, checked in rational arithmetic on the program's own numbers; then how one is found. Rows of one
variable become bounds, each row is held against the bounds. Where that does not decide, a linear program of HiGHS says
where to look; the answer is repaired, and then checked. Nothing else counts as a proof.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, LARGEST
from ...core.matrix.matrix import largest_in_rows
from ...core.representation import within
from ...core.settings import Status
from ...proofs.exact.linear_systems import solved_nearby
from ...proofs.exact.rational import ZERO, Vector, common_denominator, products, rational, rounded_down, short
from ...proofs.no_solution.farkas import FarkasProgram, Multipliers, linear_program
from ...proofs.no_solution.free_motion import falling_directions, is_at_rest, is_far_out, moved_unknowns
from ...proofs.no_solution.linear_constraints import DECISIVE, Contradiction, exact_dot
from ...systems.equilibration import equilibrating_exponents
from .constraints import Constraints, stationarity
from .criterion import PROGRAM_TOLERANCE, SURE, constraint_tolerance
from .program_matrices import as_csr, or_one
from .reductions import FoldedRows

if TYPE_CHECKING:
    from .program import QuadraticProgram

MET = 1e-8  # what is left of a row, in units of the data, that rounding alone keeps from being met
LARGEST_SOUGHT = 5000  # variables and rows of a program that is worth the linear programs
MOST_NONZEROS = 1_000_000
MANY_NONZEROS = 10_000  # beyond, fractions take longer than the linear program
LARGEST_DENSE = 1500
LARGEST_ENTRY = (1.0,)  # of each row is brought near 1
T = TypeVar("T", "QPInfeasibility", "QPUnboundedness")
NARROW = 1e-7  # a slack that may be none


@dataclass(frozen=True, eq=False)
class QPInfeasibility:
    """Multipliers that prove, after Farkas, that no x satisfies G x ≤ h, A x = b, lower ≤ x ≤ upper.

    With the constraints as rows C x ≤ d: Cᵀ multipliers = 0 and dᵀ multipliers < 0, the multipliers of inequalities ≥ 0
    (0 where the limit is infinite). Where Cᵀ multipliers is rounding beside its terms, and not 0, the proof is of all x
    with ‖x‖∞ ≤ `radius`.

    Attributes
    ----------
    program : QuadraticProgram
    multipliers : tuple of Fraction
        One a row of `program.constraints`: of G, of A, of the lower and of the upper bounds.
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "infeasible"
    status: ClassVar[Status] = Status.INFEASIBLE
    multipliers: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether the multipliers are a proof; exact."""
        return self._found.holds(size_of_limits(self.program, list(self._found.y)))

    @cached_property
    def _found(self) -> Contradiction:
        return Contradiction(self.program.constraints.as_rows, {i: y for i, y in enumerate(self.multipliers) if y})

    @property
    def contradiction(self) -> Fraction:
        """−dᵀ multipliers, less what Cᵀ multipliers takes off within the radius."""
        return self._found.size

    @property
    def radius(self) -> float:
        """Of the ‖x‖∞ that it speaks of: ∞, or the one that leaves half the contradiction."""
        return self._found.radius

    @property
    def is_exact(self) -> bool:
        """Whether it speaks of all x."""
        return self.radius == np.inf

    @cached_property
    def margin(self) -> float:
        """A lower bound of the primal residual of every x, in units of the data; 0 where the proof does not hold.

        The least shift of all limits, each in its unit, that could make the constraints consistent.
        """
        return self._found.miss(self.program.constraints.unit) if self.verify() else 0.0

    @cached_property
    def least_violation(self) -> float:
        """By how much every x violates some constraint, each in its own unit; a lower bound, 0 without a proof."""
        return self._found.miss(np.ones(len(self.multipliers))) if self.verify() else 0.0

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance."""
        return self.margin > constraint_tolerance(tolerance)

    def __str__(self) -> str:
        how = f"multipliers checked exactly{within(self.radius, 'x')}"
        return f"infeasible: {len(self._found.y)} of its constraints contradict one another ({how})"


@dataclass(frozen=True, eq=False)
class QPUnboundedness:
    """A feasible point and a direction along which the objective falls without end.

    point satisfies all constraints; point + t direction does so for every t ≥ 0; and directionᵀP direction < 0, or
    P direction = 0 with cᵀ direction < 0.

    Where P direction, and what constraints lose along it, is rounding and not 0 – of P, n ε Σ_j √(p_ii p_jj) |d_j|, as
    a P that is positive semidefinite is so to rounding only – the proof is of all x and multipliers of a size up to
    `radius`: none of them are a minimum and what proves it. point may then miss constraints by rounding.

    Attributes
    ----------
    program : QuadraticProgram
    point, direction : tuple of Fraction, shape (n,)
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "unbounded"
    status: ClassVar[Status] = Status.UNBOUNDED
    point: tuple[Fraction, ...]
    direction: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether point and direction are a proof; exact."""
        if self.is_exact:
            return True
        return self._is_rounding and self._holds and self.violation <= MET

    @cached_property
    def _holds(self) -> bool:
        is_held = self.is_free_motion and not is_far_out(
            self.program.P, self.program.c, self.direction, self._found.left
        )
        return not is_held and self._found.holds(*self._sizes)

    @property
    def _sizes(self) -> tuple[float, int, float]:
        """The size of multipliers, how many unknowns come before them, and that of x where P hardly resists d."""
        program, moved = self.program, [j for j, d in enumerate(self.direction) if d]
        column = or_one(np.maximum(largest_in_rows(program.P), program.matrices.columns_of_rows))
        of_dual = 1.0 + float((np.abs(program.c) / column)[moved].max(initial=0.0))
        if not program.matrices.entries[0]:
            return of_dual, program.n, of_dual
        of_x = size_of_limits(program)
        of_costs = float((np.abs(program.c) / or_one(largest_in_rows(program.P)))[moved].max(initial=0.0))
        return max(of_dual, of_x), program.n, max(of_costs, of_x - 1.0) if self.is_free_motion else max(of_dual, of_x)

    @cached_property
    def is_free_motion(self) -> bool:
        """Whether P, not 0 along the direction, resists none of it but by rounding: nothing holds the structure."""
        return is_at_rest(self.program.P, self.direction)

    @cached_property
    def _found(self) -> Contradiction:
        """The direction as a Farkas vector of P x + Gᵀy + Aᵀv + c, with the signs that bounds ask for, y ≥ 0."""
        conditions = stationarity(self.program, as_csr(self.program.P))
        return Contradiction(conditions, {i: d for i, d in enumerate(self.direction) if d})

    @cached_property
    def is_exact(self) -> bool:
        """Whether the objective falls without end on the stored doubles, within all constraints."""
        n, found = self.program.n, self._found
        is_kept = found.has_signs and all(j < n for j in found.left)
        if not is_kept or not self._is_feasible:
            return False
        if not found.left:
            return bool(found.plain > 0)
        both = [i for i in found.y if i in found.left]
        left, moved = (common_denominator([values[i] for i in both])[0] for values in (found.left, found.y))
        return bool(sum(map(operator.mul, left, moved)) < 0)

    @cached_property
    def _is_feasible(self) -> bool:
        """Whether the point meets all constraints exactly; a point of doubles is mostly seen to do so in doubles."""
        rows, near = self.program.constraints, numbers(self.point)
        are_doubles = all(
            x.as_integer_ratio() == (value.numerator, value.denominator)
            for value, x in zip(self.point, near.tolist(), strict=True)
        )
        return (are_doubles and not (rows.excess(near) > 0.0).any()) or not any(losses(rows, self.point))

    @cached_property
    def violation(self) -> Fraction:
        """By how much the point violates some constraint, each in units of the data; exact."""
        if self._is_feasible:
            return ZERO
        rows = self.program.constraints
        units = np.minimum(rows.unit, np.finfo(np.float64).max).tolist()
        excess = zip(losses(rows, self.point), units, strict=True)
        return max((value / Fraction(unit) for value, unit in excess if value), default=ZERO)

    @cached_property
    def radius(self) -> float:
        """Of the x and multipliers that it speaks of: ∞, or the one that leaves half the slope."""
        return self._found.radius if self._is_rounding else np.inf

    @cached_property
    def margin(self) -> float:
        """A lower bound of the dual residual of every x and multipliers, in units of the data.

        The least shift of c, each component in its unit, that stops the descent. ∞ where the objective is curved
        downwards by more than the rounding of P; 0 where the proof does not hold.
        """
        if not self.verify():
            return 0.0
        if not self._is_rounding:
            return np.inf
        is_fall = self._found.plain > 0 and self._found.is_wide(*self._sizes)
        return self._found.miss(self.program.dual_unit) if is_fall else 0.0

    @cached_property
    def cost_margin(self) -> float:
        """The least relative change of all costs that stops the descent, −cᵀd / Σ|c_j d_j|, in any units.

        Where it is exact, or along a free motion: what a structure is not held against is a matter of its load, however
        stiff it is. Else 0.
        """
        found = self._found
        if not (self.verify() and found.plain > 0 and found.is_wide(*self._sizes)):
            return 0.0
        if not (self.is_exact or self.is_free_motion):
            return 0.0
        whole, denominator = common_denominator([abs(d) for d in found.y.values()])
        return rounded_down(found.size * denominator / exact_dot(whole, np.abs(self.program.c[list(found.y)]).tolist()))

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance; where it is exact, at a thousandth of it."""
        least = (SURE if self.is_exact else 1.0) * tolerance
        return max(self.margin, self.cost_margin) > least and self.violation <= constraint_tolerance(tolerance)

    @cached_property
    def _is_rounding(self) -> bool:
        """Whether P d is within n ε √p_ii Σ_j √p_jj |d_j|, the rounding of a P = F Fᵀ."""
        root = np.sqrt(np.maximum(self.program.P.diagonal(), 0.0))
        size = float(root @ np.abs(numbers(self.direction)))
        curved, limit = self._found.left.items(), self.program.n * EPSILON * size * root
        return all(abs(float(value)) <= limit[j] for j, value in curved if j < limit.size)

    def __str__(self) -> str:
        how = f"checked exactly{within(self.radius, 'x and multipliers')}"
        along = "a direction from a feasible point"
        if self.is_free_motion:
            along += f", as nothing holds {moved_unknowns(self.direction)}: P maps it to 0, and no constraint ends it"
        return f"unbounded: the objective falls without end along {along} ({how})"


def size_of_limits(program: QuadraticProgram, rows: Sequence[int] | None = None) -> float:
    """Return 1 + the largest limit of some constraints ÷ the largest coefficient of its row: a size of x."""
    constraints = program.constraints
    some = constraints.finite if rows is None else np.array(rows, dtype=np.intp)
    with np.errstate(over="ignore"):
        found = 1.0 + float((np.abs(constraints.limit) / program.matrices.row_sizes)[some].max(initial=0.0))
    return min(found, LARGEST)


def losses(rows: Constraints, x: Sequence[Fraction]) -> Vector:
    """Return by how much x misses each constraint, 0 where it does not; exact."""
    missed = [
        value - Fraction(most) if most != np.inf else ZERO
        for value, most in zip(products(rows.exactly, x), rows.limit.tolist(), strict=True)
    ]
    return [abs(by) if is_equality else max(by, ZERO)
            for by, is_equality in zip(missed, rows.is_equality.tolist(), strict=True)]


def numbers(fractions: Any) -> FloatVector:
    """Return the doubles nearest to some fractions."""
    return np.array([float(value) for value in fractions], dtype=np.float64)


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
    rows = FoldedRows.of(program)
    row = None if is_met else contradictory_row(rows.reduced)
    found: QPInfeasibility | QPUnboundedness | None = row
    if row is None or row.margin < DECISIVE:
        other = prove_unheld(rows.reduced) or _by_programs(rows.reduced, exactly, is_met)
        found = row if other is None or (row is not None and row.margin > other.margin) else other
    if found is None or rows.reduced is program:
        return found
    # A bound that a row gives is rounded, the row is not.
    proof: QPInfeasibility | QPUnboundedness | None = rows.proof(found)
    return proof or prove_unheld(program) or _by_programs(program, exactly, is_met)


def _by_programs(
    program: QuadraticProgram, exactly: bool, is_met: bool
) -> QPInfeasibility | QPUnboundedness | None:
    """Return a proof that linear programs find."""
    entries = sum(program.matrices.entries)
    if program.n + program.constraints.rows > LARGEST_SOUGHT or entries > MOST_NONZEROS:
        return None
    exactly = exactly or entries <= MANY_NONZEROS
    contradiction = None if is_met else prove_infeasible(program, exactly=exactly)
    return contradiction or prove_unbounded(program, exactly=exactly)


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
    return points_inside(program) if program.n + program.constraints.rows <= LARGEST_SOUGHT else ()


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

    filled = np.flatnonzero(np.diff(P.indptr))
    if not 0 < filled.size <= LARGEST_DENSE:
        return filled
    dense = P[filled][:, filled].toarray()
    root = np.sqrt(np.maximum(dense.diagonal(), 0.0))
    scale = 1.0 / np.where(root > 0.0, root, 1.0)
    R, order = qr(scale[:, None] * dense * scale, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.count_nonzero(diagonal > filled.size * 8 * EPSILON * diagonal.max(initial=0.0)))
    return np.asarray(filled[order[:rank]], dtype=np.intp)


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
    scale = np.where(is_row, np.ldexp(1.0, equilibrating_exponents(sides, LARGEST_ENTRY, 900).row), 1.0)
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
             for near, stuck, exact in zip(short(x, 1 << 52), at_bound, rational(x), strict=True)]
    system = [*equal.tolist(), *tight.tolist()]
    exact = solved_nearby(
        [constraints.exactly[i] for i in system], rational(limit[system]), guess, [not stuck for stuck in at_bound]
    )
    return (guess, exact) if exact is not None and not any(losses(constraints, exact)) else (guess,)
