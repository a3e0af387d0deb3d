"""What proves that a quadratic program has no minimum, checked in rational arithmetic on the program's own numbers."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON
from ...core.settings import Status
from ...proofs.exact.rational import ZERO, Vector, common_denominator, products, rounded_down
from ...proofs.no_solution.free_motion import is_at_rest, is_far_out, moved_unknowns
from ...proofs.no_solution.linear_constraints import Contradiction, exact_dot, within
from .constraints import Constraints, stationarity
from .criterion import SURE, constraint_tolerance
from .program_matrices import as_csr

if TYPE_CHECKING:
    from .program import QuadraticProgram

MET = 1e-8  # what is left of a row, in units of the data, that rounding alone keeps from being met


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
        return self._found.holds(self.program.primal_size)

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
        program = self.program
        return program.dual_size, program.n, program.size_along if self.is_free_motion else program.dual_size

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
    def row_margin(self) -> float:
        """A lower bound of the row residual of every x and multipliers; 0 where terms along the direction may cancel.

        In units u of unknowns and a of rows, f the smallest cost, component j of the gradient is left with at most
        s (f/u_j + its largest term), no multiplier y_k is below −s f/a_k. With T_k = Σ_j |c_kj d_j| of constraint k,
        which loses at least T_k/κ along the direction d, and P d = 0 without terms, |cᵀd| ≤
        s (Σ_j |d_j| (f/u_j + |c_j|) + 2 f Σ_k T_k/a_k) where s ≤ 1/κ: a component of a small unit needs no other.
        """
        found, rows = self._found, self.program.constraints
        if not self.is_exact or found.left or as_csr(self.program.P)[list(found.y)].count_nonzero():
            return 0.0
        costs, (coefficients, unknown, _, least_cost, _) = np.abs(self.program.c).tolist(), self.program.units
        of_gradient = (least_cost / unknown).tolist()
        size = sum((abs(d) * (Fraction(of_gradient[j]) + Fraction(costs[j])) for j, d in found.y.items()), ZERO)
        data = rows.limit.tolist(), rows.is_equality.tolist(), (least_cost / coefficients).tolist()
        least = Fraction(1)
        for row, limit, is_equality, of_multiplier in zip(rows.exactly, *data, strict=True):
            terms = [value * found.y[j] for j, value in row.items() if j in found.y]
            if not terms:
                continue
            total = sum(map(abs, terms), ZERO)
            if is_equality or limit < np.inf:
                least = ZERO if is_equality else min(least, abs(sum(terms, ZERO)) / total)
            size += 2 * total * Fraction(of_multiplier)
        return rounded_down(min(found.plain / size, least))

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance; where it is exact, at a thousandth of it."""
        least = (SURE if self.is_exact else 1.0) * tolerance
        margin = max(self.margin, self.row_margin, self.cost_margin)
        return margin > least and self.violation <= constraint_tolerance(tolerance)

    @cached_property
    def cost_margin(self) -> float:
        """The least relative change of all costs that stops the descent, where it is along a free motion; else 0.

        What a structure is not held against is a matter of its load, however stiff it is: |cᵀd| / 2 Σ|c_j d_j|.
        """
        found = self._found
        if not (self.is_free_motion and self.verify() and found.plain > 0 and found.is_wide(*self._sizes)):
            return 0.0
        whole, denominator = common_denominator([abs(d) for d in found.y.values()])
        size = exact_dot(whole, np.abs(self.program.c[list(found.y)]).tolist()) / denominator
        return rounded_down(found.plain / 2 / size)

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
