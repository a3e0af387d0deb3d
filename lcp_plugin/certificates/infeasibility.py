"""Proofs that no z lies within the bounds with a w of the signs that they permit (Farkas), found by an LP."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..checks import FloatVector
from ..errors import InvalidOption
from ..exact.rational import common_denominator, power_of_two
from ..exact.rounding import compensated_product, lower_end, upper_end
from ..kernels.floats import EPSILON, TINY
from ..matrix.parts import IntVector
from ..matrix.structure import compressed_rows
from ..problem.exactly import farkas_margin, integer_matrix, slack_bounds
from ..problem.lcp import LCP
from ..problem.linear_constraints import (
    DECISIVE,
    WIDE,
    LinearConstraints,
    is_rounding,
    radius_of_proof,
    within,
)
from .references import reference_residual, row_references
from .refutation import Closing, Refutation, bounds_within, closed_exactly, in_other_units, sum_bound

if TYPE_CHECKING:
    from ..problem.farkas import Multipliers

Verdict = Literal["infeasible", "feasible", "undecided"]

EXACT_NONZEROS = 1_000_000  # about half a second
LARGEST_EXACT = 500  # above, floating point with margins is tried first
DEFAULT_EFFORT = 20_000_000  # pivots times n: a minute or so of the linear program
UNITS_TRIED = 3


@dataclass(frozen=True, eq=False)
class Infeasibility(Refutation):
    """A Farkas vector y: for no z within its bounds has w = M z + q only signs that the bounds permit.

    Permitted is w_i ≥ 0 where upper_i = ∞, w_i ≤ 0 where lower_i = −∞, both signs in a box. The sum yᵀ(M z + q − w) is
    zero for every z, yet sup (Mᵀy)ᵀz − yᵀw + qᵀy over all permitted z and w is negative. For the classical problem:
    y ≥ 0, Mᵀy ≤ 0, qᵀy < 0. With −c the supremum, Σ|y_i| d_i |r_i(z)| ≥ c for every z within the bounds: in some part P
    ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ ≥ c / Σ|y_i| d_i ‖r_P(i)(z°)‖∞, and the euclidean residual is at least c/‖y‖₂: `margin` and
    `euclidean_margin`. Where Mᵀy should be 0 and is rounding beside its terms, all this is said of the z whose entries
    without bounds are at most `radius` in size.

    Attributes
    ----------
    y : ndarray, shape (n,)
        The vector, its largest entry 1; rounded, where it was proven in fractions.
    exact_y : tuple of Fraction or None
        The vector without rounding; None where y itself is proven with rounding margins.
    kind : str
        "exact": proven in rational arithmetic; "rounding margins": in floating point, every rounding bounded.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §2.7 (Farkas).
    """

    problem: LCP = field(repr=False)
    y: FloatVector = field(repr=False)
    exact_y: tuple[Fraction, ...] | None = field(repr=False)

    @property
    def kind(self) -> str:
        """How it is proven: "exact" or "rounding margins"."""
        return "rounding margins" if self.exact_y is None else "exact"

    @cached_property
    def radius(self) -> float:
        """Of the |z_i| without bounds that it speaks of: ∞, or the one that leaves half the contradiction."""
        if self.exact_y is None:
            return np.inf
        w_bounds = tuple(side.tolist() for side in slack_bounds(self.problem))
        at_zero, at_one = (
            farkas_margin(self.problem, self.exact_y, bounds_within(self.problem, radius), (w_bounds[0], w_bounds[1]))
            for radius in (0.0, 1.0)
        )
        return np.inf if at_zero is None or at_one is None else radius_of_proof(-at_zero, at_one - at_zero)

    @cached_property
    def exact(self) -> bool:
        """Whether the stored doubles have no solution at all, by however little."""
        return self.radius == np.inf and self.verify()

    @property
    def _is_wide(self) -> bool:
        """Whether it speaks of all z that data of this size may mean, and what is left of Mᵀy is rounding."""
        problem = self.problem
        if self.radius == np.inf:
            return True
        with np.errstate(all="ignore"):
            sizes = np.abs(np.concatenate([problem.q / problem.residual_scale, problem.lower, problem.upper]))
        if self.radius < WIDE * sizes[np.isfinite(sizes)].max(initial=1.0):
            return False
        numerators, denominator = common_denominator(self.exact_y or ())
        matrix = integer_matrix(problem.matrix)
        unit = power_of_two(matrix.exponent) / denominator
        product = [unit * value for value in matrix.transposed_product(numerators)]
        is_open = [np.isinf(high if value > 0 else low) for value, low, high in
                   zip(product, problem.lower.tolist(), problem.upper.tolist(), strict=True)]
        left = [value if is_left else Fraction(0) for value, is_left in zip(product, is_open, strict=True)]
        return is_rounding(left, abs(problem.csr).T @ np.abs(self.y))

    def in_units(self, problem: LCP, exponents: IntVector) -> Infeasibility:
        """Return what this proves of the problem in other units of z; see :meth:`Refutation.in_units`."""
        if self.exact_y is None:
            y = np.ldexp(self.y, -exponents)
            return Infeasibility(problem, np.ldexp(y, -np.frexp(np.abs(y).max())[1]), None)
        return _of_exact(problem, in_other_units(self.exact_y, exponents))

    def closings(self) -> Iterator[Closing | None]:
        """Yield what the only case is closed with: by c = −sup, and |y_i| for a wrong sign of w_i."""
        if self.exact_y is not None:
            yield closed_exactly(self.problem, self.exact_y, {}, self.radius) if self._is_wide else None
            return
        contradiction = -margin_with_rounding(self.problem, self.y)
        with np.errstate(all="ignore"):
            size = np.abs(self.y)
            scaled = size * self.problem.residual_scale
            sums = [sum_bound(terms) for terms in (scaled * row_references(self.problem), scaled, size * size)]
        if not contradiction > 0.0 or None in sums:
            yield None
        else:
            yield Closing(Fraction(contradiction), *(sum_ for sum_ in sums if sum_ is not None))

    def __str__(self) -> str:
        rows = np.flatnonzero(self.y)
        named = ", ".join(f"{self.y[i]:.4g} × row {i}" for i in rows[:4]) + (", …" if rows.size > 4 else "")
        combined = f"{rows.size} row{'s' * (rows.size != 1)} ({named})"
        proof = f"{self.kind}{within(self.radius, 'z')}"
        return f"no z within its bounds gives w the signs it needs: {combined} contradict; proof: {proof}"


@dataclass(frozen=True, eq=False)
class Feasibility:
    """What is known about the linear constraints of a problem.

    Attributes
    ----------
    verdict : str
        "infeasible" (proven), "feasible" (up to the rounding of the linear program: `point`) or "undecided".
    proof : Infeasibility or None
    point : ndarray or None, shape (n,)
        Within the bounds, with w of the permitted signs up to rounding.
    reason : str
        A clause for the story of a run.
    """

    verdict: Verdict
    proof: Infeasibility | None = None
    point: FloatVector | None = field(default=None, repr=False)
    reason: str = ""


@np.errstate(all="ignore")
def decide_feasibility(
    problem: LCP, *, effort_limit: int | None = None, measure: str = "relative"
) -> Feasibility:
    """Return whether the linear constraints can be satisfied, with the proof that they cannot or a point that does.

    Without a solution of its linear constraints a problem has none; a monotone one (M positive semidefinite) that can
    satisfy them has one. Of the proofs, one with nearly the largest margin is looked for.

    Parameters
    ----------
    effort_limit : int, optional
        Pivots of the linear program, at least 0; by default 50 000 up to n = 400 and 2·10⁷/n above.
    measure : {"relative", "euclidean"}
        Whose margin a proof should have nearly the largest of.

    Raises
    ------
    InvalidOption
        Where the limit is no whole number ≥ 0.

    Examples
    --------
    >>> decide_feasibility(LCP([[0, 1], [-1, 0]], [-1, 2])).verdict
    'feasible'
    >>> proof = decide_feasibility(LCP([[-1, 0], [0, 1]], [-1, 2])).proof
    >>> print(proof)
    no z within its bounds gives w the signs it needs: 1 row (1 × row 0) contradict; proof: exact
    >>> proof.verify(), round(proof.margin, 9)
    (True, 1.0)
    """
    if effort_limit is None:
        effort_limit = DEFAULT_EFFORT // max(problem.n, 400)
    if isinstance(effort_limit, bool) or not isinstance(effort_limit, (int, np.integer)) or effort_limit < 0:
        raise InvalidOption(f"effort_limit must be a whole number of pivots, at least 0, got {effort_limit!r}")
    if problem.n == 0:
        return Feasibility("feasible", point=np.zeros(0), reason="nothing to satisfy")
    row = contradictory_row(problem)
    if row is not None and (row.margin >= DECISIVE or not effort_limit):
        return Feasibility("infeasible", row, reason="one row contradicts its bounds")
    if not effort_limit:
        return Feasibility("undecided", reason="no linear program was tried")
    known = _decided_by_program(problem, int(effort_limit), measure)
    if row is None or (known.proof is not None and known.proof.measured(measure) >= row.measured(measure)):
        return known
    return Feasibility("infeasible", row, reason="one row contradicts its bounds")


def _decided_by_program(problem: LCP, effort: int, measure: str) -> Feasibility:
    from ..problem.farkas import FarkasProgram

    constraints, unit = _linear_constraints(problem), None
    if measure == "relative":
        reference = reference_residual(problem)
        constraints = replace(constraints, reference=reference)
        unit = reference if 0.0 < reference < np.inf else None  # then the optimum is minus the largest margin
    else:  # within a factor √n, y is then best for that residual
        constraints = replace(constraints, weights=np.ones(problem.n))
    contradiction: Feasibility | None = None
    for _ in range(UNITS_TRIED):
        program = FarkasProgram(constraints, unit, effort)
        answer = program.solve()
        if answer is None:
            return contradiction or Feasibility(
                "undecided", reason=f"the linear program did not end within {effort} pivots"
            )
        if answer.is_contradiction:
            proven = partial(_proven, problem)
            found = _told(program.proof(
                answer, proven, lambda proof: proof.measured(measure), lambda proof: proof.radius
            ))
            if found.proof is not None or unit is None:
                return found
            contradiction, unit = found, None  # what this unit cuts off may matter
            continue
        point = np.clip(answer.point, problem.lower, problem.upper)
        unit = program.unit_of_violation(point)
        if unit is None:
            return Feasibility("feasible", point=point, reason="the linear constraints can be satisfied")
    return contradiction or Feasibility(
        "undecided", reason="the linear program is too badly scaled for double precision"
    )


def _linear_constraints(problem: LCP, rows: Any = slice(None)) -> LinearConstraints:
    """Return what z has to satisfy in these rows but for complementarity; what misses it has a residual as large."""
    kept = np.zeros(problem.n)
    return LinearConstraints(
        problem.csr[rows], problem.q[rows], problem.upper[rows] == np.inf, problem.lower[rows] == -np.inf,
        problem.lower, problem.upper, problem.residual_scale[rows], (kept, kept),
    )


def _told(proof: Infeasibility | None) -> Feasibility:
    if proof is None:
        return Feasibility("undecided", reason="the linear constraints seem to contradict, which could not be proven")
    return Feasibility("infeasible", proof, reason=f"linear constraints contradict ({proof.kind} proof)")


def _proven(problem: LCP, y: Multipliers) -> Infeasibility | None:
    """Return the proof by y itself; the rounding of doubles is bounded where the problem is large."""
    is_large = problem.nonzeros > EXACT_NONZEROS or problem.n > LARGEST_EXACT
    if isinstance(y, np.ndarray) and is_large and (proof := Infeasibility(problem, y, None)).verify():
        return proof
    if problem.nonzeros > EXACT_NONZEROS or not any(y):
        return None
    proof = _of_exact(problem, [Fraction(value) for value in y])
    return proof if proof.verify() else None


def _of_exact(problem: LCP, y: Sequence[Fraction]) -> Infeasibility:
    largest = max(map(abs, y))
    exact = tuple(value / largest for value in y)
    return Infeasibility(problem, np.array([float(value) for value in exact]), exact)


def margin_with_rounding(problem: LCP, y: FloatVector) -> float:
    """Return a number that is certainly ≥ sup (Mᵀy)ᵀz − yᵀw + qᵀy over the bounds, in floating point; perhaps ∞."""
    slack_lower, slack_upper = slack_bounds(problem)
    if np.any((y < 0.0) & (slack_upper == np.inf)) or np.any((y > 0.0) & (slack_lower == -np.inf)):
        return np.inf
    with np.errstate(all="ignore"):
        product, radius = compensated_product(problem.matrix.transpose, y)
        low, high = lower_end(product, radius), upper_end(product, radius)
        # Where one end of the product is 0 and the bound infinite, that end contributes nothing.
        corners = [
            np.where(end == 0.0, 0.0, end * bound) for end in (low, high) for bound in (problem.lower, problem.upper)
        ]
        terms = np.concatenate([np.maximum.reduce(corners), problem.q * y])
        size = float(np.abs(terms).sum())
        rounding = (terms.size + 8) * EPSILON * size + (terms.size + 8) * TINY
        margin = float(terms.sum()) + 2.0 * rounding
    return margin if np.isfinite(size) else np.inf


def _may_miss(problem: LCP, rows: Any) -> bool:
    """Return whether z within the bounds miss one of the rows, to rounding; one pass."""
    from ..kernels.rows import is_missed  # numba, which `import lcp_plugin` must not load

    M = compressed_rows(problem.M)
    return bool(is_missed(*M, problem.q, problem.lower, problem.upper, rows))


def contradictory_row(problem: LCP) -> Infeasibility | None:
    """Return the proof of the row that z within the bounds miss by most, or None where no single row is enough.

    Cost: one look at each entry of the rows without a positive diagonal; in the others, their own unknown lets w grow.

    Examples
    --------
    >>> print(contradictory_row(LCP([[-1, 0], [0, 1]], [-1, 2])))
    no z within its bounds gives w the signs it needs: 1 row (1 × row 0) contradict; proof: exact
    """
    rows = np.flatnonzero((np.isinf(problem.upper) | np.isinf(problem.lower)) & ~(problem.diagonal > 0.0))
    if not rows.size or not _may_miss(problem, rows):
        return None
    for k, sign in _linear_constraints(problem, rows).contradictory_rows():
        y = np.zeros(problem.n)
        y[rows[k]] = sign
        proof = _proven(problem, y)
        if proof is not None:
            return proof
    return None
