"""Proofs that a quadratic program has no minimum: contradicting constraints, or a direction of endless descent.

A linear program of HiGHS says where to look; the answer is repaired and then checked in rational arithmetic on the
program's own numbers. Nothing else counts as a proof.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..problem import FloatVector
from .quadratic_program import QuadraticProgram
from .rational import ZERO, Row, Vector, dot, rational, rational_rows, short, solved_nearby, transposed_product

LARGEST = 5000  # variables and rows of a program that is worth the linear programs
MOST_NONZEROS = 300_000
LARGEST_DENSE = 1500
TIGHT = 1e-7  # HiGHS's own tolerance
NEGLIGIBLE = 1e-9  # below this HiGHS's answers say nothing
EPSILON = 2.0**-52


@dataclass(frozen=True, eq=False)
class QPInfeasibility:
    """Multipliers that prove, after Farkas, that no x satisfies G x ≤ h, A x = b, lower ≤ x ≤ upper.

    Gᵀ inequality + Aᵀ equality − lower + upper = 0 with inequality, lower, upper ≥ 0 (0 where the limit is infinite)
    and hᵀ inequality + bᵀ equality − (program.lower)ᵀ lower + (program.upper)ᵀ upper < 0.

    Attributes
    ----------
    program : QuadraticProgram
    inequality, equality, lower, upper : tuple of Fraction
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "infeasible"
    inequality: tuple[Fraction, ...]
    equality: tuple[Fraction, ...]
    lower: tuple[Fraction, ...]
    upper: tuple[Fraction, ...]

    def holds(self) -> bool:
        """Return whether the multipliers are a proof; exact."""
        program = self.program
        if min([*self.inequality, *self.lower, *self.upper], default=ZERO) < 0:
            return False
        total = transposed_product(rational_rows(program.G), self.inequality, program.n)
        equations = transposed_product(rational_rows(program.A), self.equality, program.n)
        sums = zip(total, equations, self.lower, self.upper, strict=True)
        if any(g + a - low + high for g, a, low, high in sums):
            return False
        parts = [(self.inequality, program.h), (self.equality, program.b), (self.upper, program.upper)]
        value = ZERO
        for multipliers, limits in [*parts, (self.lower, -program.lower)]:
            for multiplier, limit in zip(multipliers, limits.tolist(), strict=True):
                if multiplier:
                    if not np.isfinite(limit):
                        return False
                    value += multiplier * Fraction(limit)
        return value < 0

    def __str__(self) -> str:
        used = sum(1 for part in (self.inequality, self.equality, self.lower, self.upper) for y in part if y)
        return f"infeasible: {used} of its constraints contradict one another (multipliers checked exactly)"


@dataclass(frozen=True, eq=False)
class QPUnboundedness:
    """A feasible point and a direction along which the objective falls for ever.

    point satisfies all constraints; point + t direction does so for every t ≥ 0; and directionᵀP direction < 0, or
    P direction = 0 with cᵀ direction < 0.

    Attributes
    ----------
    program : QuadraticProgram
    point, direction : tuple of Fraction, shape (n,)
    is_exact : bool
        False where P direction is zero only to within the rounding errors that P itself carries,
        n ε Σ_j √(p_ii p_jj) |direction_j|: the program is then as good as unbounded, as a P that is positive
        semidefinite is so to rounding only. Everything else is always exact.
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "unbounded"
    point: tuple[Fraction, ...]
    direction: tuple[Fraction, ...]
    is_exact: bool

    def holds(self) -> bool:
        """Return whether point and direction are a proof; exact but for what `is_exact` admits."""
        program, d = self.program, self.direction
        G, A = rational_rows(program.G), rational_rows(program.A)
        if not _is_feasible(program, G, A, self.point) or not _is_recession(program, G, A, d):
            return False
        slope = sum((Fraction(c) * entry for c, entry in zip(program.c.tolist(), d, strict=True)), ZERO)
        curvature = [dot(row, d) for row in rational_rows(program.P)]
        square = sum((p * entry for p, entry in zip(curvature, d, strict=True)), ZERO)
        if square < 0 or not any(curvature):
            return square < 0 or slope < 0
        return not self.is_exact and slope < 0 and _is_rounding(program, curvature, d)

    def __str__(self) -> str:
        how = "checked exactly" if self.is_exact else "P d = 0 to the rounding errors of P"
        return f"unbounded: the objective falls for ever along a direction from a feasible point ({how})"


def proof_of_no_minimum(program: QuadraticProgram) -> QPInfeasibility | QPUnboundedness | None:
    """Return a proof that the convex program is infeasible or unbounded, or None where none was found.

    Parameters
    ----------
    program : QuadraticProgram
        Up to 5000 variables and rows; beyond, None.

    Notes
    -----
    Cost: up to three linear programs, and an elimination in rationals among the constraints that matter. None is
    no proof that there is a minimum.

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
    entries = sum(sp.csr_array(matrix).nnz for matrix in (program.P, program.G, program.A))
    if program.n + program.h.size + program.b.size > LARGEST or entries > MOST_NONZEROS:
        return None
    return prove_infeasible(program) or prove_unbounded(program)


def prove_infeasible(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return multipliers that contradict each other, exactly; None where none were found."""
    n, m, p = program.n, program.h.size, program.b.size
    has_limit = np.isfinite(program.h)
    stacked = sp.csr_array(sp.vstack([sp.csr_array(program.G), sp.csr_array(program.A)], format="csr"))
    limits = np.concatenate([np.where(has_limit, program.h, 0.0), program.b])
    scale = _powers_of_two(np.maximum(_row_largest(stacked), np.abs(limits)))
    column_scale = _powers_of_two(_row_largest(stacked.T))
    bounds, identity = [], sp.eye_array(n, format="csr")
    below, above = (np.flatnonzero(np.isfinite(bound)) for bound in (program.lower, program.upper))
    bound_scale = [_powers_of_two(np.maximum(1.0, np.abs(b))) for b in (program.lower[below], program.upper[above])]
    rows = sp.vstack(
        [sp.diags_array(scale) @ stacked, -sp.diags_array(bound_scale[0]) @ identity[below],
         sp.diags_array(bound_scale[1]) @ identity[above]], format="csr",
    )
    values = np.concatenate(
        [scale * limits, -bound_scale[0] * program.lower[below], bound_scale[1] * program.upper[above]]
    )
    bounds = [
        *((0.0, 1.0 if finite else 0.0) for finite in has_limit), *[(-1.0, 1.0)] * p,
        *[(0.0, 1.0)] * (below.size + above.size),
    ]
    answer = _minimised(values, sp.diags_array(column_scale) @ rows.T, None, bounds)
    if answer is None:
        return None
    y = np.where(np.abs(answer) > NEGLIGIBLE, answer, 0.0)
    at = np.cumsum([m + p, below.size])
    leaning = np.zeros(n, dtype=bool)  # where a bound's multiplier takes up what the rows leave
    leaning[below[y[at[0] : at[1]] > 0.0]] = True
    leaning[above[y[at[1] :] > 0.0]] = True
    return _repaired_multipliers(program, stacked, scale * y[: m + p], ~leaning)


def _repaired_multipliers(
    program: QuadraticProgram, stacked: sp.csr_array, y: FloatVector, must_vanish: NDArray[np.bool_]
) -> QPInfeasibility | None:
    """Return exact multipliers near y; stackedᵀ y is zero in the columns that must vanish, or a bound takes it up."""
    m = program.h.size
    rows = rational_rows(stacked)
    columns = rational_rows(sp.csr_array(stacked.T)[np.flatnonzero(must_vanish)])
    plain = np.abs(y).max(initial=0.0)
    few = [Fraction(value / plain).limit_denominator(1000) for value in y.tolist()] if plain else []
    for guess in (few, short(y)):
        exact = solved_nearby(columns, [ZERO] * len(columns), guess, [bool(entry) for entry in guess])
        if exact is None:
            continue
        left = transposed_product(rows, exact, program.n)
        certificate = QPInfeasibility(
            program, tuple(exact[:m]), tuple(exact[m:]),
            tuple(max(entry, ZERO) for entry in left), tuple(max(-entry, ZERO) for entry in left),
        )
        if certificate.holds():
            return certificate
    return None


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
            if certificate.holds():
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
    d = np.where(np.abs(d) > NEGLIGIBLE, d, 0.0)
    tight = [G[i] for i in finite[np.abs(rows @ d) <= TIGHT].tolist()]
    curved = rational_rows(P)
    system = [*(curved[i] for i in _independent_rows(P)), *A, *tight]
    for guess in (few_digits(d), short(d, 1 << 60)):
        exact = solved_nearby(system, [ZERO] * len(system), guess, [bool(entry) for entry in guess])
        if exact is not None and any(exact) and _is_recession(program, G, A, exact):
            yield exact


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
    return exact if exact is not None and _is_feasible(program, G, A, exact) else None


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
    )
    if answer.x is None or answer.status != 0 or (only_negative and answer.fun > -NEGLIGIBLE):
        return None
    x: FloatVector = np.asarray(answer.x)
    return x


def _is_feasible(program: QuadraticProgram, G: list[Row], A: list[Row], x: Any) -> bool:
    return (
        all(dot(row, x) == Fraction(b) for row, b in zip(A, program.b.tolist(), strict=True))
        and all(dot(row, x) <= Fraction(h) for row, h in zip(G, program.h.tolist(), strict=True) if h != np.inf)
        and all(entry >= Fraction(low) for entry, low in zip(x, program.lower.tolist(), strict=True) if low != -np.inf)
        and all(entry <= Fraction(top) for entry, top in zip(x, program.upper.tolist(), strict=True) if top != np.inf)
    )


def _is_recession(program: QuadraticProgram, G: list[Row], A: list[Row], d: Any) -> bool:
    return (
        all(dot(row, d) == 0 for row in A)
        and all(dot(row, d) <= 0 for row, h in zip(G, program.h.tolist(), strict=True) if h != np.inf)
        and all(entry >= 0 for entry, low in zip(d, program.lower.tolist(), strict=True) if low != -np.inf)
        and all(entry <= 0 for entry, top in zip(d, program.upper.tolist(), strict=True) if top != np.inf)
    )


def _is_rounding(program: QuadraticProgram, curvature: Vector, d: Any) -> bool:
    """Whether P d is within n ε √p_ii Σ_j √p_jj |d_j|, the rounding of a P = F Fᵀ."""
    root = np.sqrt(np.maximum(program.P.diagonal(), 0.0))
    size = float(root @ np.abs(np.array([float(entry) for entry in d])))
    margin = program.n * EPSILON * size * root
    return all(abs(float(p)) <= limit for p, limit in zip(curvature, margin.tolist(), strict=True))


def _row_largest(matrix: Any) -> FloatVector:
    rows = sp.csr_array(matrix)
    return np.asarray(abs(rows).max(axis=1).toarray()).ravel() if rows.shape[1] else np.zeros(rows.shape[0])


def _powers_of_two(sizes: FloatVector) -> FloatVector:
    """Return 2^−k near 1/size, 1 for size 0."""
    safe = np.where(sizes > 0.0, sizes, 1.0)
    return np.asarray(np.exp2(np.clip(-np.round(np.log2(safe)), -900, 900)))


def _equilibrated(matrix: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(sp.diags_array(_powers_of_two(_row_largest(matrix))) @ matrix)
