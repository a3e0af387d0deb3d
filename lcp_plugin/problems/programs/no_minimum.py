"""Proofs that a quadratic program is infeasible or unbounded: a Farkas certificate or a recession direction.

The first part defines the proofs, which are checked in rational arithmetic on the unscaled program. The second part
finds them: rows of one variable become bounds, and each row is checked against the bounds. If no row decides, HiGHS
solves a linear program whose solution is repaired and then checked. Only a checked certificate is a proof.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from typing import Any, ClassVar, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core import deadline
from ...core.checks import AnyMatrix, MadeOnAccess, Vector, derived_property
from ...core.entries import largest_in_rows, largest_products, max_norm, or_one
from ...core.kernels.floats import DATA_ROUNDING, EPSILON, TINY, UNIT
from ...core.names import describe_radius, grouped, listed
from ...core.problem_classes import Door
from ...core.settings import Status
from ...engines import is_installed
from ...engines.polish import shifted_solver
from ...engines.solvers import DAQP, call_daqp, ends_of_rows, kinds_of_rows
from ...judges.program import NOISE, PROGRAM_TOLERANCE, ROWS, JudgedProgram
from ...proofs import farkas
from ...proofs.conflict import Conflict, find_conflict
from ...proofs.exact import (
    ZERO,
    Fractions,
    common_denominator,
    products,
    rational,
    rational_rows,
    rounded_down,
    short,
    solved_nearby,
)
from ...proofs.farkas import LinearConstraints
from ...proofs.no_solution import is_at_rest, is_minimizer_beyond_radius, moved_unknowns
from ...systems.definiteness import is_positive_definite
from ...systems.equilibration import equilibrating_exponents
from .constraints import Constraints, sums_and_terms
from .program import FoldedRows, QuadraticProgram

SOFTNESS = 1e-10  # share of a violation in the squares that daqp minimizes
SOFT = 8  # added to daqp's kind of a row that may be violated
MET = 1e-8  # residual of a row, in units of the data, that is attributed to rounding
Proven = TypeVar("Proven", "QPInfeasibility", "QPUnboundedness")


@dataclass(frozen=True, eq=False)
class QPInfeasibility(MadeOnAccess):
    """Multipliers that prove, after Farkas, that no x satisfies G x ≤ h, A x = b, lower ≤ x ≤ upper.

    With the constraints as rows C x ≤ d: Cᵀ multipliers = 0 and dᵀ multipliers < 0, the multipliers of inequalities ≥ 0
    (0 for an infinite right-hand side). If Cᵀ multipliers is not 0 but at rounding level relative to its terms, the
    proof covers all x with ‖x‖∞ ≤ `radius`.

    Attributes
    ----------
    program : QuadraticProgram
    multipliers : tuple of Fraction
        One multiplier per row of `program.constraints`: of G, of A, of the lower and of the upper bounds.
    """

    program: QuadraticProgram = field(repr=False)
    status: ClassVar[Status] = Status.INFEASIBLE
    save = Door()
    multipliers: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether the multipliers are a proof; exact."""
        return self._certificate.holds_near

    @derived_property
    def _certificate(self) -> farkas.FarkasCertificate:
        return farkas.FarkasCertificate(
            self.program.constraints.as_rows, {i: y for i, y in enumerate(self.multipliers) if y}
        )

    @property
    def radius(self) -> float:
        """Bound of ‖x‖∞ that the proof covers: ∞, or the radius that leaves half the contradiction."""
        return self._certificate.radius

    @property
    def is_exact(self) -> bool:
        """True if the proof covers all x."""
        return self.radius == np.inf

    @derived_property
    def margin(self) -> float:
        """Least relative change of the data that may end the contradiction; 0 if the proof does not hold.

        −dᵀy / Σ size_i |y_i|. The size of a row is |d_i|, or 1e-5 of its smallest coefficient if that is more, because
        a difference at rounding level relative to the coefficients proves nothing. For a bound of x_j, or a row of x_j
        only, the size is |x_j| there times Σ_i |c_ij y_i|, because a sum of coefficients at rounding level also proves
        nothing.
        """
        if not self.verify():
            return 0.0
        numbers, program = list(self._certificate.y), self.program
        largest, y, pulls = self._certificate.sizes
        constraints = program.constraints
        rows, sizes = abs(constraints.matrix[numbers]), constraints.own_sizes[numbers]
        is_alone, at = np.diff(rows.indptr) == 1, np.zeros(program.n)
        entries = rows.indptr[:-1][is_alone]
        np.maximum.at(at, rows.indices[entries], sizes[is_alone] / rows.data[entries])
        size = float(y[~is_alone] @ sizes[~is_alone] + at @ pulls)
        return float(self._certificate.size / largest) / size if 0.0 < size < np.inf else 0.0

    @derived_property
    def least_violation(self) -> float:
        """Lower bound of the largest violation at every x, in the units of the constraints; 0 without a proof."""
        return self._certificate.miss(np.ones(len(self.multipliers))) if self.verify() else 0.0

    def excludes(self, tolerance: float) -> bool:
        """Return whether the contradiction is more than rows of a solution may be off by, at any tolerance."""
        return self.margin > ROWS

    @derived_property
    def conflict(self) -> Conflict:
        """Irreducible set of constraints that conflict, by name; computed on first access."""
        y = dict(enumerate(self.multipliers))
        return find_conflict(self.program.constraints.as_rows, self.program.name, y)

    @property
    def doubt(self) -> str:
        """Reason why a proof that excludes no solution makes the status PRECISION_LIMIT."""
        return "the constraints are inconsistent, by a difference at rounding level relative to their coefficients"

    def __str__(self) -> str:
        how = f"multipliers {_describe_check(self.radius, 'x')}"
        heaviest = sorted(self._certificate.y.items(), key=lambda pair: (-abs(pair[1]), pair[0]))
        names = [*dict.fromkeys(self.program.name(k) for k, _ in heaviest)]
        happened = "are inconsistent" if len(names) > 1 else "cannot hold"
        return f"infeasible: {len(names)} of its constraints {happened}, {listed(grouped(names))} ({how})"


@dataclass(frozen=True, eq=False)
class QPUnboundedness:
    """Feasible point and recession direction along which the objective is unbounded below.

    point and point + t direction satisfy all constraints for every t ≥ 0, and directionᵀP direction < 0, or
    P direction = 0 with cᵀ direction < 0.

    P direction, and the changes of constraints along direction, may be at rounding level instead of 0. The rounding
    bound of P is 2 ε (k + 2) Σ_j |p_ij d_j| in a row of k entries, because a sum of stored numbers is 0 only to
    rounding. The proof then covers all x and multipliers of a size up to `radius`: no such pair is optimal. point may
    then violate constraints at rounding level. If the direction leaves a constraint beyond the radius, it shows how far
    the objective falls, but not that the program is unbounded: it excludes no solution.

    Attributes
    ----------
    program : QuadraticProgram
    point, direction : tuple of Fraction, shape (n,)
    """

    program: QuadraticProgram = field(repr=False)
    status: ClassVar[Status] = Status.UNBOUNDED
    save = Door()
    point: tuple[Fraction, ...]
    direction: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether point and direction are a proof; exact."""
        if self.is_exact:
            return True
        certificate, program = self._certificate, self.program
        return (
            self._is_rounding
            and is_minimizer_beyond_radius(program.P, program.c, self.direction, certificate.left)
            and certificate.has_signs
            and certificate.size > 0
            and self._is_wide
            and certificate.is_rounding(program.n)
            and self.violation <= MET
        )

    @derived_property
    def _is_wide(self) -> bool:
        """True if residuals of sums that should be 0 exclude no x and multipliers near the point.

        If the direction is a zero-energy mode, another test covers the x that P limits.
        """
        known = {
            j: 0.0 if self.is_free_motion else abs(float(self.point[j])) or TINY
            for j in range(self.program.n)
        }
        return self._certificate.is_wide(known)

    @derived_property
    def is_free_motion(self) -> bool:
        """True if P is nonzero, but maps the direction to 0 within rounding: a zero-energy mode of the structure."""
        return is_at_rest(self.program.P, self.direction)

    @derived_property
    def _certificate(self) -> farkas.FarkasCertificate:
        """Direction as a Farkas vector of P x + Gᵀy + Aᵀv + c, with the signs that bounds require, y ≥ 0."""
        conditions = stationarity(self.program, sp.csr_array(self.program.P))
        return farkas.FarkasCertificate(
            conditions, {i: d for i, d in enumerate(self.direction) if d}
        )

    @derived_property
    def is_exact(self) -> bool:
        """True if the objective of the stored doubles is unbounded below within all constraints."""
        n, certificate = self.program.n, self._certificate
        is_kept = certificate.has_signs and all(j < n for j in certificate.left)
        if not is_kept or not self._is_feasible:
            return False
        if not certificate.left:
            return bool(certificate.plain > 0)
        both = [i for i in certificate.y if i in certificate.left]
        left, moved = (
            common_denominator([values[i] for i in both])[0]
            for values in (certificate.left, certificate.y)
        )
        return bool(sum(map(operator.mul, left, moved)) < 0)

    @derived_property
    def _is_feasible(self) -> bool:
        """True if the point satisfies all constraints exactly; floating point mostly decides it for a float point."""
        rows, near = self.program.constraints, as_doubles(self.point)
        if tuple(rational(near)) == self.point and not (rows.excess(near) > 0.0).any():
            return True
        return not any(losses(rows, self.point))

    @derived_property
    def violation(self) -> float:
        """Largest violation of a constraint at the point, relative to its terms."""
        if self._is_feasible:
            return 0.0
        rows, x = self.program.constraints, np.abs(as_doubles(self.point))
        sizes = np.maximum(largest_products(abs(rows.matrix), x), rows.own_sizes)
        excess = np.array([*map(float, losses(rows, self.point))])
        return float(np.divide(excess, sizes, where=excess > 0.0, out=0.0 * excess).max())

    @derived_property
    def radius(self) -> float:
        """Bound of x and multipliers that the proof covers: ∞, or the radius that leaves half the slope."""
        return self._certificate.radius if self._is_rounding else np.inf

    @derived_property
    def margin(self) -> float:
        """Least relative change of all costs that ends the descent, −cᵀd / Σ|c_j d_j|, independent of scaling.

        ∞ if the negative curvature of the objective exceeds the rounding of P; 0 if the proof does not hold.
        """
        certificate = self._certificate
        if not self.verify():
            return 0.0
        if not self._is_rounding:
            return np.inf
        if not (certificate.plain > 0 and self._is_wide):
            return 0.0
        whole, denominator = common_denominator([abs(d) for d in certificate.y.values()])
        return rounded_down(
            certificate.size
            * denominator
            / farkas.exact_dot(whole, np.abs(self.program.c[list(certificate.y)]).tolist())
        )

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x is optimal at this tolerance, or for an exact proof at a thousandth of it."""
        # An exact proof of unboundedness is stronger than an answer
        least = (1e-3 if self.is_exact else 1.0) * tolerance
        return not self.leaves_rows and self.margin > least and self.violation <= ROWS

    @property
    def leaves_rows(self) -> bool:
        """True if the direction violates a constraint beyond the radius, because its change is not 0 there."""
        return any(j >= self.program.n for j in self._certificate.left)

    @property
    def doubt(self) -> str:
        """Reason why a proof that excludes no solution makes the status PRECISION_LIMIT; empty for other proofs."""
        fall = f"the objective falls along a direction for {describe_radius(self.radius, 'x and multipliers')}"
        return (
            f"{fall}, beyond which the direction violates constraints" if self.leaves_rows else ""
        )

    @derived_property
    def _is_rounding(self) -> bool:
        """True if P d is within the rounding of its terms, 2 ε (k + 2) Σ_j |p_ij d_j| in a row of k entries."""
        P = sp.csr_array(self.program.P)
        terms = abs(P) @ np.abs(as_doubles(self.direction))
        limit = 2.0 * EPSILON * (np.diff(P.indptr) + 2) * terms
        curved = self._certificate.left.items()
        return all(abs(float(value)) <= limit[j] for j, value in curved if j < limit.size)

    def __str__(self) -> str:
        how = _describe_check(self.radius, "x and multipliers")
        missed = f"point that misses constraints by {self.violation:.1e} of their terms, at most"
        along = f"a direction from a {missed if self.violation else 'feasible point'}"
        if self.is_free_motion:
            moved = moved_unknowns(self.direction, self.program.names)
            along += f", as nothing holds {moved}: P maps it to 0, and no constraint ends it"
        return f"unbounded below along {along} ({how})"


NoMinimum = QPInfeasibility | QPUnboundedness


def _describe_check(radius: float, what: str) -> str:
    """Return the points for which a proof was checked, as text."""
    points = describe_radius(radius, what)
    return f"checked for {points}" if points else "checked exactly"


def losses(rows: Constraints, x: Sequence[Fraction]) -> Fractions:
    """Return the exact violation of each constraint at x, 0 if x satisfies the constraint."""
    missed = [
        value - Fraction(most) if most != np.inf else ZERO
        for value, most in zip(products(rows.exactly, x), rows.limit.tolist(), strict=True)
    ]
    return [
        abs(by) if is_equality else max(by, ZERO)
        for by, is_equality in zip(missed, rows.is_equality.tolist(), strict=True)
    ]


def as_doubles(fractions: Any) -> Vector:
    """Return the doubles nearest to some fractions."""
    return np.array([float(value) for value in fractions], dtype=np.float64)


def stationarity(program: QuadraticProgram, P: AnyMatrix) -> LinearConstraints:
    """Return P x + Gᵀy + Aᵀv + c with the signs that bounds require, y ≥ 0; P may contain only spanning rows."""
    rows = sp.csr_array(program.G)[np.flatnonzero(np.isfinite(program.h))]
    matrix = sp.csr_array(sp.vstack([P, rows, sp.csr_array(program.A)], format="csr").T)
    free, nothing = np.full(matrix.shape[1], np.inf), np.zeros(matrix.shape[1])
    is_inequality = np.repeat([False, True, False], [P.shape[0], rows.shape[0], program.b.size])
    return LinearConstraints(
        matrix,
        program.c,
        np.isinf(program.upper),
        np.isinf(program.lower),
        np.where(is_inequality, 0.0, -np.inf),
        free,
        or_one(largest_in_rows(matrix)) + np.abs(program.c),
        (nothing, nothing),
    )


@np.errstate(all="ignore")
def proof_of_no_minimum(program: QuadraticProgram, *, exactly: bool = False) -> NoMinimum | None:
    """Return a proof that the convex program is infeasible or unbounded; None if no proof was found.

    Parameters
    ----------
    program : QuadraticProgram
        Up to 20 000 variables and rows with a million nonzeros; in larger programs, only single rows that are
        inconsistent with the bounds are found.
    exactly : bool
        Require a proof for all x, however large the program is. By default, a proof within a radius is enough for more
        than 10 000 nonzeros.

    Notes
    -----
    Cost: one test of each row, at any size; then two linear programs and, if these find a candidate, up to five more
    linear programs and rational eliminations among the relevant constraints. The result None does not prove that a
    minimum exists.

    References
    ----------
    O. L. Mangasarian, *Nonlinear Programming*, SIAM 1994, doi:10.1137/1.9781611971255, §2.4.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[0.0]], [1.0], G=[[1.0], [-1.0]], h=[0.0, -1.0])
    >>> print(proof_of_no_minimum(program))
    infeasible: 2 of its constraints are inconsistent, row 0 of G, row 1 of G (multipliers checked exactly)
    >>> print(proof_of_no_minimum(QuadraticProgram([[0.0]], [1.0], upper=1.0)))
    unbounded below along a direction from a feasible point (checked exactly)
    """
    folded = FoldedRows.of(program)
    row = contradictory_constraint(folded.reduced)
    proof: NoMinimum | None = row
    if row is None or row.margin < farkas.DECISIVE:
        other = _prove_by_programs(folded.reduced, exactly)
        proof = row if other is None or (row is not None and row.margin > other.margin) else other
    if proof is None or folded.reduced is program:
        return proof
    # A bound that a row gives is rounded, the row is not.
    return _unfolded(folded, proof) or _prove_by_programs(program, exactly)


def known_proof(program: QuadraticProgram, y: Vector | None = None) -> NoMinimum | None:
    """Return `proof_of_no_minimum` of a program, searched for once, unless a time limit cuts the search short.

    It holds for the stored data in double precision, by any margin. `margin` is the size of this margin, and
    `accepted_proof` decides whether the proof counts. Multipliers y of G and A by a solver are tried first.
    """
    if "proof" not in program.known:
        proof: NoMinimum | None = None
        if y is not None and np.isfinite(y).all():
            proof = with_bounds(program, {i: Fraction(v) for i, v in enumerate(y.tolist()) if v})
        if proof is None or not proof.excludes(PROGRAM_TOLERANCE):
            proof = proof_of_no_minimum(program)
        if deadline.is_over():
            return proof
        program.known["proof"] = proof
    return program.known["proof"]


def searched_proof(program: QuadraticProgram, y: Vector) -> QPInfeasibility:
    """Return the proof that is searched for, or the proof by multipliers of the reduced rows if no search finds one."""
    proof: Any = known_proof(program)
    if (
        proof is not None
        and proof.status is Status.INFEASIBLE
        and proof.excludes(PROGRAM_TOLERANCE)
    ):
        return proof
    nonzero = {i: Fraction(value) for i, value in enumerate(y.tolist()) if value}
    found: Any = _unfolded(program.folded, with_bounds(program.reduced, nonzero))
    return found


def accepted_proof(
    program: QuadraticProgram, tolerance: float = PROGRAM_TOLERANCE
) -> NoMinimum | None:
    """Return the proof that no x is a solution at this tolerance, or None.

    An exact proof of unboundedness counts if it excludes all solutions within a thousandth of the tolerance.
    Inconsistent constraints count as consistent if the contradiction is at most the tolerance of a row.
    """
    proof = known_proof(program)
    return proof if proof is not None and proof.excludes(tolerance) else None


def proof_of_contradiction(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return a proof that the constraints are inconsistent, for any objective; None if no proof was found."""
    folded = FoldedRows.of(program)
    proof: Any = _unfolded(folded, contradictory_constraint(folded.reduced))
    if proof is None and _is_sought(program):
        proof = prove_infeasible(program)
    return proof if proof is not None and proof.excludes(PROGRAM_TOLERANCE) else None


def _unfolded(folded: FoldedRows, reduced_proof: NoMinimum | None) -> NoMinimum | None:
    """Return the proof for the original program; None if the proof does not hold there.

    A limit over a coefficient is rounded, and no number of the program.
    """
    if reduced_proof is None or folded.reduced is folded.program:
        return reduced_proof
    proof: Any = replace(reduced_proof, program=folded.program)
    if reduced_proof.status is Status.INFEASIBLE:
        whole = folded.multipliers(np.array(proof.multipliers, dtype=object))
        proof = replace(proof, multipliers=tuple(map(Fraction, whole)))
    return proof if proof.verify() else None


def _prove_by_programs(program: QuadraticProgram, exactly: bool) -> NoMinimum | None:
    """Return a proof that linear programs find."""
    if not _is_sought(program) or deadline.is_over():
        return None
    # Beyond, fractions take longer than the linear program
    exactly = exactly or sum(program.matrices.entries) <= 10_000
    return prove_infeasible(program, exactly=exactly) or prove_unbounded(program, exactly=exactly)


def _is_sought(program: QuadraticProgram) -> bool:
    """Return whether a program is worth linear programs."""
    # Larger programs are not worth the linear programs
    is_small = program.n + program.constraints.rows <= 20_000
    return is_small and sum(program.matrices.entries) <= 1_000_000


def shown_proof(program: QuadraticProgram) -> tuple[Vector, QPInfeasibility] | None:
    """Return a point with small violations and a proof of infeasibility; None if `multipliers_of_soft_rows` finds none.

    The proof is searched for when it is read.
    """
    reduced = program.reduced
    is_suited = (
        reduced.matrices.is_small and reduced.matrices.terms.is_dense and is_installed(DAQP.name)
    )
    if not is_suited or (shown := multipliers_of_soft_rows(reduced.judged)) is None:
        return None
    make = partial(searched_proof, program, shown[1])
    return shown[0], QPInfeasibility.of_known(make, program=program)


def multipliers_of_soft_rows(program: JudgedProgram) -> list[Vector] | None:
    """Return a point with small violations and multipliers of rows that show infeasibility by plain sums; or None.

    daqp's multipliers of rows that may be violated are violations that no x reduces: yᵀC is nearly 0 where no bound
    closes a column. A least squares step removes the rest. Sums with bounds of their rounding errors accept y only if
    `with_bounds` of it is a proof with a margin at least 100 times above `ROWS`. The program is dense.
    """
    (terms, c, d, lower, upper), n = program, program.c.size
    C, of_C, soft = terms.C, terms.both[1][n:], kinds_of_rows(n, terms.m, d.size - terms.m)
    soft[n:] += SOFT
    units = np.diag(or_one(terms.squares_of_columns))
    ends, options = ends_of_rows(d, terms.m, lower, upper), DAQP.defaults | {"rho_soft": SOFTNESS}
    x, signed = call_daqp(units, np.array(C, order="C"), soft, 0.0 * c, *ends, options)[:2]
    y, sizes = signed[n:], np.abs(signed[n:]) * terms.row_sizes
    used = (sizes > 1e-4 * sizes.max(initial=0.0)).nonzero()[0]
    if not (used.size and signed @ signed < np.inf and terms.counts[used].all()):
        return None
    rows, of_y = C[used], y[used]
    columns = (rows[:, signed[:n] == 0.0] * of_y[:, np.newaxis]).T
    of_y *= 1.0 - np.linalg.lstsq(columns, columns.sum(axis=1))[0]
    y = np.zeros(d.size)
    y[used] = of_y
    np.maximum(y[: terms.m], 0.0, out=y[: terms.m])
    of_y, d = np.abs(y), np.where(y != 0.0, d, 0.0)
    sums, sizes = y @ C, of_y @ of_C
    bound, bounds = np.where(sums > 0.0, lower, upper), np.abs((lower, upper))
    is_open, rounding = np.isinf(bound), (used.size + n + 6.0) * UNIT
    reach = np.where(bounds < np.inf, bounds, 0.0).sum(axis=0)
    total = of_y @ (np.abs(d) + NOISE * terms.row_sizes) + 2.0 * sizes @ (reach + NOISE)
    left = rounding + np.where(is_open, np.abs(sums), 0.0) / or_one(sizes)
    plain = sums @ np.where(is_open, 0.0, bound) - y @ d - rounding * total
    least = max(100.0 * ROWS, 2.0 * farkas.WIDE * left.sum())
    is_shown = plain > least * total and left.max() <= DATA_ROUNDING
    return [np.clip(x, lower, upper), y] if is_shown else None


def contradictory_constraint(program: QuadraticProgram) -> QPInfeasibility | None:
    """Return the proof by the row with the largest violation within the bounds; None if no single row suffices."""
    rows = program.constraints.within_bounds
    proofs = (with_bounds(program, {i: Fraction(sign)}) for i, sign in rows.contradictory_rows())
    return next((proof for proof in proofs if proof.verify()), None)


def with_bounds(program: QuadraticProgram, y: dict[int, Fraction]) -> QPInfeasibility:
    """Return multipliers of all rows and bounds: multipliers of bounds cancel the residual; verify the result."""
    m, p, n, _ = program.matrices.sizes
    multipliers = [ZERO] * (m + p + 2 * n)
    certificate = farkas.FarkasCertificate(program.constraints.within_bounds, y)
    for i, value in y.items():
        multipliers[i] = value
    for j, value in certificate.product.items():  # an infinite bound cancels nothing
        if j not in certificate.left:
            multipliers[m + p + (n + j if value > 0 else j)] = abs(value)
    return QPInfeasibility(program, tuple(multipliers))


def balance_multipliers(program: QuadraticProgram, y: Vector) -> Vector:
    """Return multipliers of the rows, without noise, moved so that the sums which a bound does not take up cancel."""
    y = np.where(np.abs(y) > 1e-9 * max_norm(y), y, 0.0)
    used, rows = np.flatnonzero(y), program.matrices.terms.rows
    sums, terms = sums_and_terms(rows, y)
    is_open = np.isinf(program.lower) | np.isinf(program.upper)
    # A linear program takes such sums for 0
    open_columns = np.flatnonzero(is_open & (np.abs(sums) <= 1e-6 * terms) & (terms > 0.0))
    T = sp.csr_array(rows[used].T)[open_columns]
    solve = shifted_solver(sp.csr_array(sp.eye_array(used.size)), T, 2.0**-50)
    if solve is None:
        return y
    for _ in range(2):
        y[used] -= solve(np.append(np.zeros(used.size), T @ y[used]))[: used.size]
    return y


def prove_infeasible(program: QuadraticProgram, *, exactly: bool = True) -> QPInfeasibility | None:
    """Return a Farkas certificate, exact if `exactly`; None if the search fails.

    The linear program is the dual of the least uniform shift of all right-hand sides that makes them consistent.
    """
    constraints = program.constraints
    if not np.isfinite(constraints.unit[constraints.finite]).all():
        return None

    def proven(y: farkas.Multipliers) -> QPInfeasibility | None:
        for values in (y,) if exactly else (y, balance_multipliers(program, as_doubles(y))):
            nonzero = {i: Fraction(value) for i, value in enumerate(values) if value}
            if (proof := with_bounds(program, nonzero)).margin > 0.0:
                return proof
        return None

    return _best_proof(constraints.within_bounds, 1.0, proven, exactly=exactly)


def prove_unbounded(program: QuadraticProgram, *, exactly: bool = True) -> QPUnboundedness | None:
    """Return a feasible point and a recession direction, exact if `exactly`; None if the search fails.

    Such a direction contradicts the conditions P x + c + Gᵀy + Aᵀv = 0, y ≥ 0, with the signs that bounds permit.
    """
    P = sp.csr_array(program.P)
    if is_positive_definite(program.P):
        return None
    points: list[tuple[Fractions, ...]] = []

    def proven(d: farkas.Multipliers) -> QPUnboundedness | None:
        if not points:
            points.append(points_inside(program))
        for point in reversed(points[0]):
            proof = QPUnboundedness(program, tuple(point), tuple(map(Fraction, d)))
            if proof.verify():
                kept = _within_rows(proof) if proof.leaves_rows else None
                return proof if kept is None else kept
        return None

    return _best_proof(
        stationarity(program, P[_independent_rows(P)]), None, proven, exactly=exactly
    )


def _within_rows(proof: QPUnboundedness) -> QPUnboundedness | None:
    """Return the proof along a nearby direction that changes no row which it changes by rounding; None for no proof."""
    rows, near = proof.program.matrices.terms.rows, as_doubles(proof.direction)
    changes, terms = np.abs(rows @ near), abs(rows) @ np.abs(near)
    held = np.flatnonzero((changes <= DATA_ROUNDING * terms) & (terms > 0.0))
    free = (near != 0.0).tolist()
    direction = solved_nearby(
        rational_rows(rows[held]), [ZERO] * held.size, list(proof.direction), free
    )
    kept = None if direction is None else replace(proof, direction=tuple(direction))
    return kept if kept is not None and not kept.leaves_rows and kept.verify() else None


def _best_proof(
    conditions: farkas.LinearConstraints,
    first: float | None,
    proven: Callable[[farkas.Multipliers], Proven | None],
    *,
    exactly: bool,
) -> Proven | None:
    """Return the first proof that counts at the tolerances of programs, else the proof of the largest margin."""
    scale: farkas.FarkasProgram = farkas.FarkasProgram(conditions)
    vectors = conditions.q, conditions.lower, conditions.upper
    q, *bounds = (np.where(np.isfinite(vector), np.abs(vector), 0.0) for vector in vectors)

    def weighed(unit: float) -> farkas.LinearConstraints:
        weights = 1.0 / scale.rows + q / unit
        below, above = (
            (scale.columns + bound / unit) * (weight > 0.0)
            for bound, weight in zip(bounds, conditions.bound_weights, strict=True)
        )
        return replace(conditions, weights=weights, bound_weights=(below, above), reference=unit)

    units = scale.sizes if first is None else [first, *scale.sizes]
    return farkas.best_proof(weighed, units, proven, exactly=exactly)


def _independent_rows(P: sp.csr_array) -> NDArray[np.intp]:
    """Return rows of P that span the other rows to rounding, by a pivoted QR decomposition; all if P is large.

    A P = F Fᵀ that rounding has made nonsingular would leave no direction otherwise.
    """
    from scipy.linalg import qr

    filled = np.flatnonzero(np.diff(P.indptr))
    if not 0 < filled.size <= 1500:
        return filled
    dense = P[filled][:, filled].toarray()
    root = np.sqrt(np.maximum(dense.diagonal(), 0.0))
    scale = 1.0 / or_one(root)
    R, order = qr(scale[:, None] * dense * scale, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.count_nonzero(diagonal > filled.size * 8 * EPSILON * diagonal.max(initial=0.0)))
    return np.asarray(filled[order[:rank]], dtype=np.intp)


def points_inside(program: QuadraticProgram) -> tuple[Fractions, ...]:
    """Return a point that satisfies all constraints to rounding, and an exactly feasible point, as far as found.

    Unknowns are measured in the user's units, then in fitted units.
    """
    points: tuple[Fractions, ...] = ()
    one, fit = np.ones(program.n), program.matrices.fit[0]
    # A row whose side is far from its coefficients is equilibrated without its side
    for unit, has_sides in ((one, True), (fit, True), (one, False)):
        points = _points_inside(program, unit, has_sides) or points
        if len(points) > 1:
            break
    return points


def _points_inside(
    program: QuadraticProgram, unit: Vector, has_sides: bool
) -> tuple[Fractions, ...]:
    constraints, n = program.constraints, program.n
    limit, finite = constraints.limit, constraints.finite
    is_row, is_equality = np.arange(limit.size) < constraints.rows, constraints.is_equality
    matrix = constraints.matrix @ sp.diags_array(unit)
    right = np.where(is_row & np.isfinite(limit) & has_sides, limit, 0.0)
    sides = sp.hstack([matrix, right[:, None]], format="csr")
    exponents = equilibrating_exponents(sides, (1.0,), 900).row  # largest entries near 1
    of_rows = np.ldexp(1.0, exponents[: constraints.rows])
    scale = np.concatenate([of_rows, 1.0 / unit, 1.0 / unit])
    equal, most = finite[is_equality[finite]], finite[~is_equality[finite]]
    is_fixed = np.append(
        is_equality[: constraints.rows], np.tile(program.lower == program.upper, 2)
    )

    def scaled(rows: NDArray[np.intp]) -> Any:
        """Return the scaled rows, with the column of the slack."""
        inside = np.where(is_fixed[rows], 0.0, 1.0)
        return sp.hstack([sp.diags_array(scale[rows]) @ matrix[rows], inside[:, None]])

    answer = farkas.linear_program(
        np.append(np.zeros(n), -1.0),
        scaled(equal),
        (scale * limit)[equal],
        np.repeat([[-np.inf, 0.0], [np.inf, 1.0]], [n, 1], axis=1),
        (scaled(most), (scale * limit)[most]),
    )
    if answer is None:
        return ()
    x = np.clip(unit * answer.x[:-1], program.lower, program.upper)
    rows = most[is_row[most]]
    value = scale[rows] * (constraints.matrix[rows] @ x - limit[rows])
    # A slack that may be none
    tight = rows[np.abs(value) <= MET] if answer.x[-1] <= 1e-7 else rows[:0]
    at_bound = (x <= program.lower) | (x >= program.upper)
    near = zip(short(x / unit, 1 << 52), rational(unit), at_bound, rational(x), strict=True)
    guess = [exact if stuck else few * size for few, size, stuck, exact in near]
    system = [*equal.tolist(), *tight.tolist()]
    equations = [constraints.exactly[i] for i in system]
    exact = solved_nearby(equations, rational(limit[system]), guess, (~at_bound).tolist())
    return (guess, exact) if exact is not None and not any(losses(constraints, exact)) else (guess,)
