"""Proofs that a problem has no solution, and by how much: a lower bound of the residual of every z.

A proof is a set of cases, each with a Farkas vector; the linear constraints alone are one case.

The linear constraints require a z within the bounds with a w of permitted signs. A check of each row, for signs that no
point of the box has, comes first, then a linear program. A tree contains every case of the complementarity conditions,
each closed by its Farkas vector. Zero-energy modes are directions d with P d = 0 to rounding, for example of an
unsupported structure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Array, Vector, derived_property
from ..core.entries import with_entries
from ..core.kernels.floats import DATA_ROUNDING, EPSILON, LARGEST, NEGLIGIBLE
from ..core.lcp import LCP
from ..core.names import Names, describe_radius
from ..core.problem_classes import Door
from ..core.settings import Status
from ..core.structure import is_nearly_symmetric
from ..judges.lcp import reference_residual, row_data
from .conflict import Conflict, find_conflict
from .exact import ZERO, Rational, integer_matrix, rounded_down
from .farkas import DECISIVE, WIDE, FarkasCertificate, FarkasProgram, LinearConstraints, best_proof

# Relative to the terms of P d, averaged over its rows; to √(p_ii p_jj) |d_j| in each row. More is data (a weak spring).
MEAN_ROUNDING, ROW_ROUNDING = 8.0 * EPSILON, 256.0 * EPSILON


def moved_unknowns(d: Any, names: Names) -> str:
    """Return a text with the unknowns that move along a direction, except for negligible movements.

    Examples
    --------
    >>> moved_unknowns([0, 1, 1], Names()), moved_unknowns([1, 0] * 6, Names())
    ('unknowns 1, 2', 'unknowns 0, 2, 4, 6, … (6 of 12)')
    >>> moved_unknowns([0, -2], Names())
    'unknown 1'
    """
    sizes = np.abs(np.array([float(value) for value in d]))
    moving = np.flatnonzero(sizes > 1e-6 * sizes.max(initial=0.0)).tolist()
    named = ", ".join(names.unknown(j, "{}") for j in moving[:4])
    if len(moving) > 4:
        return f"unknowns {named}, … ({len(moving)} of {len(d)})"
    return f"unknown{'s' * (len(moving) != 1)} {named}"


def is_minimizer_beyond_radius(P: AnyMatrix, c: Vector, direction: Array, left: Array) -> bool:
    """Return whether a load c moves the zero-energy mode much farther than the softest part of the structure.

    t = Σ_j |c_j d_j| / min_i (Σ_j |p_ij d_j|)² / p_ii, over the rows i that d moves, is how far the softest part gives
    under all of the load; P d stops x = s d at an s ≥ |cᵀd| / Σ_j |d_j left_j|. This is invariant to scaling: stiff
    parts hide no weak spring of a soft part.

    Parameters
    ----------
    P, c, direction
    left : mapping of int to number
        Entries of P d that are not 0.

    Examples
    --------
    >>> springs = np.array([[4.0, -4.0, 0.0], [-4.0, 5.0, -1.0], [0.0, -1.0, 1.0]])
    >>> load = np.array([6.0, 0.0, 0.0])
    >>> is_minimizer_beyond_radius(springs, load, [1, 1, 1], {2: 1e-10})
    True
    >>> is_minimizer_beyond_radius(springs, load, [1, 1, 1], {2: 1e-7})
    False
    """
    d = np.array([float(value) for value in direction])
    sizes, diagonal = np.abs(d), P.diagonal()
    # An unknown at a bound that moves so little stays there
    rows = np.flatnonzero((sizes > 1e-9 * sizes.max(initial=0.0)) & (diagonal > 0.0))
    with np.errstate(all="ignore"):  # an overflow counts as no
        stiffness = np.square((abs(P) @ sizes)[rows] / np.sqrt(diagonal[rows])).min(initial=np.inf)
        resisted = sum(abs(float(value)) * sizes[j] for j, value in left.items() if j < d.size)
        return bool(resisted * 2.0 * WIDE * (np.abs(c) @ sizes) <= abs(c @ d) * stiffness)


def is_at_rest(P: AnyMatrix, direction: Any) -> bool:
    """Return whether P d = 0 to rounding, although P is not 0 for the unknowns of d: a zero-energy mode."""
    d = np.array([float(value) for value in direction])
    moving = np.flatnonzero(d)
    P = sp.csr_array(P)
    product, terms = np.abs(P @ d), abs(P) @ np.abs(d)
    if not P[moving].count_nonzero() or product.sum() > MEAN_ROUNDING * terms.sum():
        return False
    root = np.sqrt(np.abs(P.diagonal()))
    pattern = with_entries(P, np.ones(P.nnz))
    return bool((product <= ROW_ROUNDING * root * (pattern @ (root * np.abs(d)))).all())


SAFE_RANGE = (1e-290, 1e290)
LOWER, SLACKLESS, UPPER, FIXED = "lower", "zero", "upper", "fixed"
Margins = tuple[float, float]


def row_choices(lower: float, upper: float) -> tuple[str, ...]:
    """Return the branches of a row: z_i = lower with w_i ≥ 0, w_i = 0, z_i = upper with w_i ≤ 0.

    Examples
    --------
    >>> row_choices(0.0, np.inf), row_choices(-np.inf, np.inf), row_choices(1.0, 1.0)
    (('lower', 'zero'), ('zero',), ('fixed',))
    """
    if lower == upper:
        return (FIXED,)
    return (LOWER,) * (lower > -np.inf) + (SLACKLESS,) + (UPPER,) * (upper < np.inf)


class NoSolutionProof:
    """A proof that no z solves a problem, with a lower bound of the residual of every z within the bounds.

    The status is INFEASIBLE or NO_SOLUTION only if the margin exceeds the tolerance of the run: then no z could be
    SOLVED. A smaller margin is true for the stored double-precision data, but has no practical meaning. The same holds
    for a margin at the rounding level of the data.

    Notes
    -----
    |r_i(z)| ≤ t_i, r the scaled residual, leaves a row three cases: z_i − lower_i ≤ t_i and w_i ≥ 0, or
    |w_i| ≤ d_i t_i, or upper_i − z_i ≤ t_i and w_i ≤ 0; if the case is not chosen, w_i has a wrong sign by d_i t_i
    at most. With t_i = t ‖r_P(z°)‖∞, P the component of row i, the least t at which the certificate of a piece fails,
    minimized over all pieces, bounds the relative residual from below.
    """

    problem: LCP
    status: ClassVar[Status] = Status.NO_SOLUTION  # the proved status
    save = Door()

    @property
    def radius(self) -> float:
        """Bound of ‖z‖∞ that the proof covers."""
        return np.inf

    def closings(self) -> Iterator[Margins | None]:
        """Yield the margins of each piece, (relative, absolute); None for an open piece."""
        raise NotImplementedError

    @np.errstate(all="ignore")
    def verify(self) -> bool:
        """Return whether the proof holds, computed again from only the problem's data."""
        return all(closing is not None for closing in self.closings())

    @cached_property
    def exact(self) -> bool:
        """True if the stored data have no solution, by any margin: `verify`, for all z."""
        return self.radius == np.inf and self.verify()

    @derived_property
    def _margins(self) -> Margins:
        """The smallest margins of all pieces; 0 if a piece is open."""
        pieces = list(self.closings())
        closed = [margins for margins in pieces if margins is not None]
        if len(closed) < len(pieces):
            return 0.0, 0.0
        relative, absolute = zip(*closed, strict=True)
        return min(relative), min(absolute)

    @property
    def margin(self) -> float:
        """Verified lower bound of the relative residual of every z within the bounds, or 0."""
        return self._margins[0]

    @property
    def absolute_margin(self) -> float:
        """A verified lower bound of ‖r(z)‖∞, in the unit of z, for every z within the bounds."""
        return self._margins[1]

    @derived_property
    def is_rounding(self) -> bool:
        """True if the margin is at most 2⁻⁴² of the largest T_i/d_i at z°: rounding of the data explains it.

        The weights .1, .2 and −.3 of a network, for example, have a sum of 6e-17.
        """
        data = row_data(self.problem)
        sizes = data.rows(data.origin).terms / data.scale
        return self.absolute_margin <= NEGLIGIBLE * min(float(sizes.max(initial=0.0)), LARGEST)

    def excludes(self, tolerance: float, absolute_tolerance: float = 0.0) -> bool:
        """Return whether no z within the bounds could be called SOLVED with these settings of a run."""
        if self.is_rounding or not self.margin > tolerance:
            return False
        # A point may use up both tolerances, in different components.
        return not absolute_tolerance or (
            tolerance / self.margin + absolute_tolerance / self.absolute_margin < 1.0 - EPSILON
        )


def piece_of(problem: LCP, path: Mapping[int, str], rows: Array = ...) -> LinearConstraints:
    """Return the linear constraints of these rows, or all, in a piece, in which some rows are decided by their choices.

    The other rows have w of the signs that their bounds permit. A violation implies a residual as large.
    """
    lower, upper, kept = problem.lower.copy(), problem.upper.copy(), np.zeros(problem.n)
    rise, fall = upper == np.inf, lower == -np.inf
    for i, choice in path.items():
        rise[i], fall[i] = choice in (LOWER, SLACKLESS), choice in (UPPER, SLACKLESS)
        if choice in (LOWER, UPPER):
            lower[i] = upper[i] = (lower if choice == LOWER else upper)[i]
    q, units = problem.q[rows], problem.residual_scale[rows]
    matrix = problem.csr if rows is ... else sp.csr_array(problem.M[rows])
    return LinearConstraints(matrix, q, rise[rows], fall[rows], lower, upper, units, (kept, kept))


def certificate_of(
    problem: LCP, path: Mapping[int, str], y: Mapping[int, Rational]
) -> FarkasCertificate:
    """Return the Farkas certificate of a vector, by row, for a piece."""
    # All of M is kept in integers up to 500 rows
    rows = integer_matrix(problem.matrix) if problem.n <= 500 else None
    used = {i: Fraction(value) for i, value in y.items() if value}
    return FarkasCertificate(piece_of(problem, path), used, rows)


def margins_of(problem: LCP, path: Mapping[int, str], certificate: FarkasCertificate) -> Margins:
    """Return the margins of a piece by a certificate.

    Every z has Σ share_i |r_i(z)| ≥ c, r the scaled residual, and c the size of the contradiction. The absolute
    margin is c / Σ share_i, the relative margin c / Σ share_i ‖r_P(z°)‖∞, P the component of row i.
    """
    d, most = problem.residual_scale, row_data(problem).references[1]
    is_safe = (most == 0.0) | ((most > SAFE_RANGE[0]) & (most < SAFE_RANGE[1]))
    if not is_safe.all():  # a reference may be rounded to 0, or to ∞
        return 0.0, 0.0
    y, product, held = certificate.y, certificate.product, (LOWER, UPPER)
    shares = [(i, abs(v) * Fraction(float(d[i]))) for i, v in y.items() if path.get(i) not in held]
    # of z_i from its bound
    shares += [(i, abs(v)) for i, v in product.items() if path.get(i) == held[v < 0]]
    reference = np.broadcast_to(most, (problem.n,))
    relative = sum((share * Fraction(float(reference[i])) for i, share in shares), ZERO)
    absolute = sum((share for _, share in shares), ZERO)
    size = certificate.size
    margins = (rounded_down(size / unit if unit else None) for unit in (relative, absolute))
    return next(margins), next(margins)


@dataclass(frozen=True, eq=False, repr=False)
class Infeasibility(NoSolutionProof):
    """A Farkas vector y: for no z within its bounds has w = M z + q only signs that the bounds permit.

    Permitted is w_i ≥ 0 if upper_i = ∞, w_i ≤ 0 if lower_i = −∞, both signs in a box. The sum yᵀ(M z + q − w) is
    zero for every z, yet sup (Mᵀy)ᵀz − yᵀw + qᵀy over all permitted z and w is negative. For the classical problem:
    y ≥ 0, Mᵀy ≤ 0, qᵀy < 0. With −c the supremum, Σ|y_i| d_i |r_i(z)| ≥ c for every z within the bounds: in some
    component P ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ ≥ c / Σ|y_i| d_i ‖r_P(i)(z°)‖∞, which is `margin` (d and r as in
    :mod:`lcp_plugin.judges.lcp`).

    If (Mᵀy)_j has the wrong sign on an open side, but is at rounding level of its terms, as for M = J Jᵀ with more rows
    than columns, the proof covers the z with |z_j| ≤ `radius` there, and c is half of its size at z = 0.

    Attributes
    ----------
    exact_y : tuple of Fraction
        The vector, its largest entry 1.
    y : ndarray, shape (n,)
        Rounded `exact_y`.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §2.7 (Farkas).
    """

    status: ClassVar[Status] = Status.INFEASIBLE

    problem: LCP = field(repr=False)
    exact_y: tuple[Fraction, ...] = field(repr=False)

    @classmethod
    def of(cls, problem: LCP, y: Mapping[int, Rational]) -> Infeasibility:
        """Return the proof by a nonzero vector, by row, of any scale."""
        largest, exact = max(abs(Fraction(value)) for value in y.values()), [ZERO] * problem.n
        for i, value in y.items():
            exact[i] = Fraction(value) / largest
        return cls(problem, tuple(exact))

    def excludes(self, tolerance: float, absolute_tolerance: float = 0.0) -> bool:
        """Return whether no z could be SOLVED; empty rows fail the componentwise test unless q_i is rounding."""
        is_excluded = super().excludes(tolerance, absolute_tolerance)
        if is_excluded or absolute_tolerance:
            return is_excluded
        used, sizes = list(self._used), np.abs(self.problem.q)
        is_empty = not np.diff(self.problem.csr.indptr)[used].any()
        return is_empty and bool((sizes[used] > DATA_ROUNDING * sizes.max()).all()) and self.exact

    @cached_property
    def _used(self) -> dict[int, Fraction]:
        return {i: value for i, value in enumerate(self.exact_y) if value}

    @cached_property
    def y(self) -> Vector:
        """The vector rounded, shape (n,)."""
        y = np.zeros(self.problem.n)
        y[list(self._used)] = [float(value) for value in self._used.values()]
        return y

    @cached_property
    def _certificate(self) -> FarkasCertificate:
        return certificate_of(self.problem, {}, self._used)

    @property
    def radius(self) -> float:
        """Bound of the |z_j| without bounds that the proof covers: ∞, or the value that leaves half the margin."""
        return self._certificate.radius

    def verify(self) -> bool:
        """Return whether y is a proof for the z within the radius, in exact arithmetic."""
        certificate, matrix = self._certificate, self.problem.matrix
        return certificate.holds_near and (
            certificate.holds
            or not is_nearly_symmetric(matrix)
            or is_minimizer_beyond_radius(matrix.array, self.problem.q, self.y, certificate.left)
        )

    @derived_property
    def conflict(self) -> Conflict:
        """Irreducible set of signs of w and bounds of z that conflict, by name; computed on first access."""
        problem, n = self.problem, self.problem.n
        identity, nothing = sp.eye_array(n), np.zeros(n)
        rises, falls = problem.upper == np.inf, problem.lower == -np.inf
        signs, no = np.where(rises, 1.0, -1.0), np.zeros(n, np.bool_)
        matrix = sp.vstack([sp.diags_array(signs) @ problem.csr, identity, -identity], "csr")
        q = np.concatenate([signs * problem.q, -problem.lower, problem.upper])
        needs_rise = np.concatenate([rises | falls, ~falls, ~rises])
        needs = needs_rise, np.concatenate([rises & falls, no, no])
        free, units = (nothing - np.inf, nothing + np.inf), np.ones(3 * n)
        rows = LinearConstraints(sp.csr_array(matrix), q, *needs, *free, units, (nothing, nothing))
        y = {i: value * int(signs[i]) for i, value in self._used.items()}
        for j, value in self._certificate.product.items():
            if j not in self._certificate.left:
                y[n + j + (value > 0) * n] = abs(value)
        return find_conflict(rows, self._name_of_condition, y)

    def _name_of_condition(self, k: int) -> str:
        """Return the name of the sign of w_i, then of the lower and of the upper bounds."""
        (part, i), problem = divmod(k, self.problem.n), self.problem
        low, high = float(problem.lower[i]), float(problem.upper[i])
        if part:
            return f"{problem.names.unknown(i)} {'≥' if part == 1 else '≤'} {low if part == 1 else high:.9g}"
        sign = "≤" if high < np.inf else "=" if low == -np.inf else "≥"
        return f"w {sign} 0 in {problem.names.row(i)}"

    def closings(self) -> Iterator[Margins | None]:
        """Yield the margins of the only piece: c = −sup, and weights |y_i| for a wrong sign of w_i."""
        yield margins_of(self.problem, {}, self._certificate) if self.verify() else None

    def __str__(self) -> str:
        problem, points = self.problem, describe_radius(self.radius, "z")
        how = f"checked for {points}" if points else "proof: exact"
        if is_nearly_symmetric(problem.matrix) and is_at_rest(problem.matrix.array, self.y):
            moved = moved_unknowns(self.y, problem.names)
            return f"nothing holds {moved}: along them M d = 0 and qᵀd < 0, and no bound is in the way; {how}"
        rows = list(self._used)
        name = problem.names.row
        named = ", ".join(f"{self.y[i]:.4g} × {name(i)}" for i in rows[:4])
        combined = f"{len(rows)} rows are inconsistent ({named}{', …' * (len(rows) > 4)})"
        if len(rows) == 1:
            combined = f"{name(rows[0])} contradicts its bounds"
        return f"no z within its bounds gives w the signs it needs: {combined}; {how}"


def find_infeasibility(problem: LCP, *, effort_limit: int | None = None) -> Infeasibility | None:
    """Return the proof that the linear constraints cannot be satisfied; None if they can be, or without a proof.

    A problem with infeasible linear constraints has no solution. A monotone problem (M positive semidefinite) that can
    satisfy them has a solution. The search prefers a proof with nearly the largest margin.

    Parameters
    ----------
    effort_limit : int, optional
        Pivots of the linear program, at least 0; by default 50 000 up to n = 400 and 2·10⁷/n above.

    Examples
    --------
    >>> find_infeasibility(LCP([[0, 1], [-1, 0]], [-1, 2])) is None
    True
    >>> proof = find_infeasibility(LCP([[-1, 0], [0, 1]], [-1, 2]))
    >>> print(proof)
    no z within its bounds gives w the signs it needs: row 0 contradicts its bounds; proof: exact
    >>> proof.verify(), round(proof.margin, 9)
    (True, 1.0)
    """
    if problem.n == 0:
        return None
    # A minute or so of the linear program
    effort = 20_000_000 // max(problem.n, 400) if effort_limit is None else effort_limit
    row = contradictory_row(problem)
    if row is not None and row.margin >= DECISIVE:
        return row
    proof = _by_linear_program(problem, effort) if effort else None
    return row if proof is None or (row is not None and proof.margin < row.margin) else proof


def _by_linear_program(problem: LCP, effort: int) -> Infeasibility | None:
    """Return a proof by the multipliers of a linear program, in a scaling in which it detects the inconsistency."""
    reference = reference_residual(problem)
    constraints = replace(piece_of(problem, {}), reference=reference)
    is_usual = 0.0 < reference < np.inf  # then the optimum is minus the largest margin
    units = [reference] * is_usual + FarkasProgram(constraints).sizes

    return best_proof(
        lambda _: constraints, units, lambda y: _proven(problem, dict(enumerate(y))), pivots=effort
    )


def _proven(problem: LCP, y: Mapping[int, Rational]) -> Infeasibility | None:
    """Return the proof by y itself, by row."""
    proof = Infeasibility.of(problem, y) if any(y.values()) else None
    return proof if proof is not None and proof.verify() else None


def contradictory_row(problem: LCP) -> Infeasibility | None:
    """Return the proof of the row that z within the bounds miss by most, or None if no single row is enough.

    Cost: one pass over the rows without a positive diagonal entry; in all other rows z_i can increase w_i.

    Examples
    --------
    >>> print(contradictory_row(LCP([[-1, 0], [0, 1]], [-1, 2])))
    no z within its bounds gives w the signs it needs: row 0 contradicts its bounds; proof: exact
    """
    is_open = np.isinf(problem.upper) | np.isinf(problem.lower)
    rows = np.flatnonzero(is_open & ~(problem.diagonal > 0.0))
    if not rows.size:
        return None
    suspects = piece_of(problem, {}, rows).contradictory_rows()
    proofs = (_proven(problem, {int(rows[k]): sign}) for k, sign in suspects)
    return next(filter(None, proofs), None)


@dataclass(slots=True)
class Case:
    """Case of the tree: split by the choices of a row, or closed by a Farkas vector y."""

    row: int = -1
    branches: dict[str, Case] = field(default_factory=dict)
    y: Sequence[Rational] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class NoSolution(NoSolutionProof):
    """Proof that no z solves the problem: every leaf of a complete tree is exactly infeasible.

    Attributes
    ----------
    tree : Case
        Each split has a row and covers all choices of this row; each leaf has a Farkas vector of its constraints.
    nodes : int
        Number of nodes that the search visited.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.3
    (complementary cones: a cone per choice of every row).
    """

    problem: LCP = field(repr=False)
    tree: Case = field(repr=False)
    nodes: int = 0

    @property
    def leaves(self) -> int:
        """Number of closed cases."""
        return sum(case.row < 0 for case, _ in self._cases())

    @property
    def infeasibility(self) -> Infeasibility | None:
        """The Farkas certificate of the entire problem, if its linear constraints are inconsistent without a split."""
        if self.tree.y is None or not any(self.tree.y):
            return None
        return Infeasibility.of(self.problem, dict(enumerate(self.tree.y)))

    def closings(self) -> Iterator[Margins | None]:
        """Yield the margins of each leaf, in exact arithmetic; None for an open leaf, or a split with gaps."""
        for case, path in self._cases():
            if case.row >= 0:
                ends = float(self.problem.lower[case.row]), float(self.problem.upper[case.row])
                if case.row in path or set(case.branches) != set(row_choices(*ends)):
                    yield None
            elif case.y is None or case.branches:
                yield None
            else:
                certificate = certificate_of(self.problem, path, dict(enumerate(case.y)))
                yield margins_of(self.problem, path, certificate) if certificate.holds else None

    def __str__(self) -> str:
        leaves = self.leaves
        cases = "the only case" if leaves == 1 else f"each of the {leaves} cases"
        return f"no solution: {cases} of an exhaustive search contradicts, exactly"

    def _cases(self) -> Iterator[tuple[Case, dict[int, str]]]:
        stack: list[tuple[Case, dict[int, str]]] = [(self.tree, {})]
        while stack:
            case, path = stack.pop()
            yield case, path
            stack += [(branch, path | {case.row: name}) for name, branch in case.branches.items()]
