"""Linear constraints, and proofs by Farkas's lemma that they are inconsistent.

A linear program finds the multipliers. HiGHS's multipliers are not a proof: they are projected to the required signs
and solved for in rational arithmetic; the caller decides which of these vectors is a proof, and with which margin.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core import deadline
from ..core.checks import AnyMatrix, Array, BoolVector, Vector
from ..core.entries import max_norm, row_numbers, scale_matrix
from ..core.kernels.floats import DATA_ROUNDING
from ..core.rounding import ROUNDING
from ..engines.linear_program import FEASIBLE, highs
from ..judges.program import PROGRAM_TOLERANCE
from ..systems.equilibration import EQUILIBRATING_PASSES, equilibrating_exponents, power_of_two
from . import exact
from .exact import ZERO, IntegerMatrix, Rational, common_denominator, exact_power_of_two

DECISIVE = 1e-3  # no tolerance in use is as large: the search ends if one row has this margin
WIDE = 1e8  # times the size of the data: a proof within a smaller radius does not count


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    """The x within their bounds for which w = M x + q has the signs required by its rows.

    Attributes
    ----------
    matrix : CSR array, shape (m, n)
    q : array, shape (m,)
        Finite for rows with a required sign.
    needs_rise, needs_fall : arrays of bool, shape (m,)
        Whether w_i ≥ 0 and w_i ≤ 0 is required; both make an equality, neither leaves the row out.
    lower, upper : arrays, shape (n,)
    weights : array, shape (m,)
        Positive: unit of the violation of each row's sign.
    bound_weights : pair of arrays, shape (n,)
        Units of the violation of the lower and of the upper bounds of x; 0 if bounds must hold.
    reference : float
        Reference of the largest violation.
    """

    matrix: sp.csr_array
    q: Vector
    needs_rise: BoolVector
    needs_fall: BoolVector
    lower: Vector
    upper: Vector
    weights: Vector
    bound_weights: tuple[Vector, Vector]
    reference: float = 1.0

    def contradictory_rows(self) -> Iterator[tuple[int, int]]:
        """Yield the rows whose sign no x within the bounds gives, to rounding, the most violated first.

        Each with +1 if w_i is too small, and −1 if it is too large.
        """
        rows, matrix = row_numbers(self.matrix), self.matrix
        with np.errstate(all="ignore"):
            ends = [matrix.data * bound[matrix.indices] for bound in (self.lower, self.upper)]
            sides = (side(*ends) for side in (np.minimum, np.maximum))
            lowest, highest = (np.bincount(rows, side, self.q.size) + self.q for side in sides)
            below = np.where(self.needs_rise, -highest, -np.inf)
            most = np.maximum(below, np.where(self.needs_fall, lowest, -np.inf))
            suspects = np.flatnonzero(most > 0.0)
            order = np.argsort(-most[suspects] / self.weights[suspects], kind="stable")
        # Rows that look contradictory in floating point and are checked exactly
        for i in suspects[order][:8].tolist():
            yield i, 1 if below[i] > 0.0 else -1


def without_rounding(matrix: sp.csr_array) -> sp.csr_array:
    """Return the matrix without entries at rounding level relative to the largest of their row and column.

    The result of a cancelling sum of decimals must not influence the scaling.
    """
    size = abs(matrix)
    if 0 in matrix.shape or not matrix.nnz:
        return matrix
    across, down = (np.asarray(size.max(axis=axis).toarray()).ravel() for axis in (1, 0))
    rows = row_numbers(matrix)
    kept = size.data > DATA_ROUNDING * np.minimum(across[rows], down[matrix.indices])
    if kept.all():
        return matrix
    return sp.csr_array((matrix.data[kept], (rows[kept], matrix.indices[kept])), shape=matrix.shape)


class FarkasCertificate:
    """Inconsistency of linear constraints, proved by a Farkas vector y in exact arithmetic.

    y_i > 0 takes w_i ≥ 0 for granted, y_i < 0 takes w_i ≤ 0, and yᵀw = qᵀy + (Mᵀy)ᵀx for every x. If its supremum
    over the bounds is −c < 0, no x within the bounds gives all rows their signs: each misses some of them, and of
    bounds that may be missed too, by t in units u with t (Σ|y_i| u_i + Σ|(Mᵀy)_j| u_j) ≥ c. If Mᵀy should be 0 on an
    open side but is at rounding level of its terms, the proof covers all x with |x_j| ≤ `radius` there.

    Attributes
    ----------
    sides : LinearConstraints
        Signs of rows, bounds of unknowns, the matrix and q.
    y : mapping of int to Fraction
        Entries by row, none of them 0.
    rows : IntegerMatrix, optional
        M, if it is known in integers.
    left : dict of int to Fraction
        Entries of Mᵀy that are not 0 on open sides.
    plain : Fraction
        c without the contribution of `left`.
    """

    def __init__(
        self, sides: LinearConstraints, y: Mapping[int, Fraction], rows: IntegerMatrix | None = None
    ) -> None:
        self.sides, self.y = sides, y
        self.plain, self.left = ZERO, dict[int, Fraction]()
        self._integers, self._unit = dict[int, int](), ZERO  # the product is these times the unit
        if self.has_signs:
            self._combine(rows)

    @cached_property
    def product(self) -> dict[int, Fraction]:
        """The entries of Mᵀy that are not 0."""
        return {j: self._unit * value for j, value in self._integers.items()}

    def _combine(self, rows: IntegerMatrix | None) -> None:
        """Compute Mᵀy, c and what is left of open sides."""
        numbers, (whole, denominator) = list(self.y), common_denominator(list(self.y.values()))
        matrix = rows or IntegerMatrix.of(self.sides.matrix, numbers)
        unit = self._unit = exact_power_of_two(matrix.exponent) / denominator
        product = self._integers = matrix.combination(dict(zip(numbers, whole, strict=True)))
        ends = self.sides.lower, self.sides.upper
        bounds = {j: float(ends[value > 0][j]) for j, value in product.items()}
        closed = [j for j, bound in bounds.items() if math.isfinite(bound)]
        highest = unit * exact_dot([product[j] for j in closed], [bounds[j] for j in closed])
        self.plain = -exact_dot(whole, self.sides.q[numbers].tolist()) / denominator - highest
        self.left = {j: unit * value for j, value in product.items() if math.isinf(bounds[j])}

    @cached_property
    def radius(self) -> float:
        """Bound of the |x_j| without bounds that the proof covers: ∞, or the value that leaves half the margin."""
        left = sum(map(abs, self.left.values()))
        return exact.rounded_down(max(self.plain, ZERO) / (2 * left) if left else None)

    @property
    def size(self) -> Fraction:
        """A lower bound of c, within the radius."""
        return self.plain / 2 if self.left else self.plain

    @property
    def has_signs(self) -> bool:
        """True if each y_i has the sign required by its row."""
        permitted = self.sides.needs_rise, self.sides.needs_fall
        return all(permitted[value < 0][i] for i, value in self.y.items())

    @property
    def holds(self) -> bool:
        """True if it is a proof for all x."""
        return self.has_signs and not self.left and self.plain > 0

    @cached_property
    def sizes(self) -> tuple[Fraction, Vector, Vector]:
        """The largest |y_i|, the |y_i| divided by it, and Σ|y_i m_ij| of each column in this unit."""
        largest = max(map(abs, self.y.values()))
        y = np.array([float(abs(value) / largest) for value in self.y.values()])
        return largest, y, abs(self.sides.matrix[list(self.y)]).T @ y

    @property
    def holds_near(self) -> bool:
        """True if it is a proof for all x, or within a radius that is wide and leaves sums at rounding level."""
        return self.has_signs and self.size > 0 and self.is_rounding() and self.is_wide()

    def is_wide(self, known: Mapping[int, float] | None = None) -> bool:
        """Return whether x of 10⁸ times the size that it has itself leaves half the contradiction.

        That size is Σ|y_i q_i| / Σ|y_i m_ij|, at which the terms of column j are as large as the terms of q, or a known
        size if that is larger; columns of size 0 do not count.
        """
        if not self.left:
            return True
        (largest, y, terms), known = self.sizes, known or {}
        offset = float(y @ np.abs(self.sides.q[list(self.y)]))
        with np.errstate(all="ignore"):
            moved = sum(
                float(abs(value) / largest) * max(offset / terms[j], known.get(j, 0.0))
                for j, value in self.left.items()
                if known.get(j) != 0.0
            )
        return bool(float(self.plain / largest) >= 2.0 * WIDE * moved)

    def is_rounding(self, first: int = 0) -> bool:
        """Return whether sums that should be 0 are at rounding level of their terms; data are larger."""
        left = {j: value for j, value in self.left.items() if j >= first}
        if not left:
            return True
        largest, _, terms = self.sizes
        levels = ((value, DATA_ROUNDING * float(terms[j])) for j, value in left.items())
        return all(abs(value) <= largest * Fraction(level) for value, level in levels)

    def miss(self, weights: Vector) -> float:
        """Return the least violation, by any x, in these units, rounded down; 0 after overflow."""
        used = [float(weights[i]) for i in self.y]
        if not all(map(math.isfinite, used)):
            return 0.0
        whole, denominator = common_denominator([abs(value) for value in self.y.values()])
        return exact.rounded_down(self.size * denominator / exact_dot(whole, used))


def exact_dot(factors: Sequence[int], values: Sequence[float]) -> Fraction:
    """Return Σ factor · value without rounding; the values are finite."""
    whole, exponent = exact.integers(np.array(values, dtype=np.float64))
    return exact_power_of_two(exponent) * sum(map(operator.mul, factors, whole))


PIVOT_WORK = 120_000_000  # pivots times rows and columns: on 12 000 of both they take 4 s
LP_TOLERANCE = 1e-9  # a tenth of it is the least that HiGHS takes
NORMS = (1e-6, 1e6)  # smallest and largest: entries of one row of the linear program
# times the unit: sizes that a linear program distinguishes from ∞ and from 0
MOST_UNITS, LEAST_UNIT = 1e5, 1e-6


Multipliers = Vector | Sequence[Rational]


@dataclass(eq=False)
class FarkasProgram:
    """min qᵀy + Σ sup over the bounds of (Mᵀy)_j x_j, y of the signs that a Farkas vector needs, Σ|y_i| weight_i ≤ 1.

    This is the dual of min t over lower ≤ x ≤ upper with every w_i of its sign up to weight_i t. Minus the optimum is
    the least violation that the signs allow, and y proves it. y = 0 is always allowed. If the constraints are feasible,
    the optimum is 0, and its multipliers are a feasible x. Rows and columns are scaled by powers of two first. Parts
    of y are scaled also: v, its nonnegative parts and the multipliers of finite bounds.

    Attributes
    ----------
    unit : float or None
        Divisor of q and the bounds, in the scale of the program; their largest entry by default. With a smaller unit,
        entries that are huge relative to it are cut off: the result must be checked, as every result here is.
    pivots : int or None
        A linear program that takes more has no answer.
    """

    constraints: LinearConstraints
    unit: float | None = None
    pivots: int | None = None

    def __post_init__(self) -> None:
        matrix = self.constraints.matrix
        exponents = equilibrating_exponents(without_rounding(matrix), EQUILIBRATING_PASSES, 500)
        self.rows, self.columns = (np.ldexp(1.0, side) for side in exponents)
        self.matrix: AnyMatrix = scale_matrix(matrix, exponents)

    @cached_property
    def sizes(self) -> list[float]:
        """The sizes of offsets and of bounds in the scale of the program, the largest first."""
        asked = self.constraints
        q = (self.rows * asked.q)[asked.needs_rise | asked.needs_fall]
        sizes = np.abs(np.concatenate([q, asked.lower / self.columns, asked.upper / self.columns]))
        return list(map(float, np.unique(sizes[np.isfinite(sizes) & (sizes > 0.0)])[::-1]))

    @cached_property
    def _scaled_unit(self) -> float:
        largest = max(self.sizes, default=0.0) if self.unit is None else self.unit
        return float(0.5 * power_of_two(max(largest, 2.0**-900)))

    def margin_of(self, optimum: float) -> float:
        """Return the margin relative to the reference, as far as an optimum of the program can be trusted."""
        with np.errstate(all="ignore"):
            margin = float(-optimum * self._scaled_unit / np.float64(self.constraints.reference))
        return margin if np.isfinite(margin) else 0.0

    def solve(self) -> Any:
        """Return HiGHS's result with the optimum, or None if it took more pivots or time than there is."""
        asked, unit, n = self.constraints, self._scaled_unit, self.columns.size
        q, weights = self.rows * asked.q, self.rows * asked.weights
        of_lower, of_upper = (weight / self.columns for weight in asked.bound_weights)
        parts: Sequence[tuple[Any, ...]] = (  # parts of y, and multipliers of finite bounds
            (1.0, asked.needs_rise, q, weights),
            (-1.0, asked.needs_fall, q, weights),
            (1.0, np.isfinite(asked.upper), asked.upper / self.columns, of_upper),
            (-1.0, np.isfinite(asked.lower), asked.lower / self.columns, of_lower),
        )
        signs, masks, costs, norms = zip(*parts, strict=True)
        kept = ([v[k] for v, k in zip(side, masks, strict=True)] for side in (costs, norms))
        cost, norm = map(np.concatenate, kept)
        places = np.arange(q.size), np.arange(q.size), *[np.arange(q.size, q.size + n)] * 2
        self.place = np.concatenate([p[k] for p, k in zip(places, masks, strict=True)])
        # HiGHS drops coefficients below 1e-9
        scale = 2.0 / power_of_two(np.clip(norm, 1.0, 2.0**20))
        self.signed = np.repeat(signs, [np.count_nonzero(mask) for mask in masks]) * scale
        both = sp.hstack([self.matrix.T, -sp.eye_array(n)], format="csc")
        self.equations = sp.csc_array(both[:, self.place])
        self.equations.data *= np.repeat(self.signed, np.diff(self.equations.indptr))
        self.norm = np.where(norm > 0.0, np.clip(scale * norm, *NORMS), 0.0)
        cost = self.signed * cost
        self.cost = np.where(np.isinf(cost), cost, np.clip(cost / unit, -MOST_UNITS, MOST_UNITS))
        at_most = self.norm[None, :], [1.0]
        return linear_program(self.cost, self.equations, 0.0, (0.0, np.inf), at_most, self.pivots)

    def vector(self, v: Vector) -> Vector:
        """Return y, shape (m,), of a solution of the linear program."""
        m = self.rows.size
        return np.bincount(self.place, self.signed * v, m)[:m].astype(np.float64)

    def proof(self, answer: Any, proven: Callable[[Multipliers], Any]) -> Any:
        """Return the first proof of all x with half the predicted margin, else the one of the largest margin, or None.

        A proof within a radius is returned only without a proof of all x.

        Parameters
        ----------
        proven : callable
            Gives the proof by a y in the scale of the constraints, or None if that is none.
        """
        wanted, proofs = 0.5 * self.margin_of(answer.fun), list[Any]()
        for y in self._tried(answer):
            proofs += filter(None, [proven(y)])
            is_enough = proofs and proofs[-1].radius == math.inf and proofs[-1].margin >= wanted
            if is_enough or deadline.is_over():
                break
        return max(proofs, key=lambda proof: (proof.radius == math.inf, proof.margin), default=None)

    def polished(self, answer: Any) -> Vector:
        """Return the answer's y, shape (m,), with the equalities that a proof needs met to rounding."""
        y = self.vector(answer.x)
        return self._polished(y / (max_norm(y) or 1.0))

    def _tried(self, answer: Any) -> Iterator[Multipliers]:
        """Yield vectors near the answer, then near another that leaves slack."""
        yield from self.candidates(self.vector(answer.x))
        if (moved := self._with_slack(answer)) is not None:
            yield from self.candidates(self.vector(moved))

    def _with_slack(self, answer: Any) -> Vector | None:
        """Return v ≥ t that keeps about half of the optimum, t as large as can be; None if that is nothing.

        A vertex has as few positive multipliers as it can: if the coefficients carry rounding errors, those may
        vanish only together, and proofs with rounding margins require slack: in all one-sided bounds, or everywhere.
        """
        is_open = np.isinf(self.constraints.lower) != np.isinf(self.constraints.upper)
        shares = np.append(np.zeros(self.rows.size), is_open)[self.place]
        shares = shares if shares.any() else np.ones(shares.size)
        size, largest = shares.size, 0.1 * shares.size / self.norm.sum()
        both = sp.hstack([sp.eye_array(size), sp.csc_array(shares[:, None])], format="csc")
        # Enough in spite of rounding
        cost, most = np.append(np.zeros(size), -1.0), np.append(np.full(size, np.inf), largest)
        at_most = np.stack([self.norm, self.cost]) @ both, [1.0, 0.55 * answer.fun]
        equations = self.equations @ both
        result = linear_program(cost, equations, 0.0, (0.0, most), at_most, self.pivots)
        return None if result is None or result.fun > -LP_TOLERANCE else np.asarray(both @ result.x)

    def candidates(self, y: Vector) -> Iterator[Multipliers]:
        """Yield vectors near a y in the scale of the program that may be Farkas vectors of the constraints themselves.

        First with corrected signs and without negligible entries, then rounded, then from an exact and a rounded solve.
        """
        y = np.where(np.abs(y) <= 1e-14 * max_norm(y), 0.0, y)
        asked = self.constraints
        y = np.where(asked.needs_fall, y, np.maximum(y, 0.0))
        y = np.where(asked.needs_rise, y, np.minimum(y, 0.0))
        if not y.any():
            return
        y = y / max_norm(y)
        unscaled = y * self.rows
        yield unscaled / max_norm(unscaled)
        # Multipliers of stated models are often integers.
        for unit in (1.0, np.abs(y[np.abs(y) > ROUNDING]).min()):
            yield np.rint(y / unit) * self.rows
        if (repaired := self._repaired(y)) is not None:
            yield repaired
        yield self._polished(y)

    def _polished(self, y: Vector) -> Vector:
        """Return a vector near y that satisfies to rounding the equalities which y satisfies without slack.

        Dependent equalities become independent by rounding: singular values at rounding level count as 0.
        """
        support, tight = self._tight(y)
        if support.size * tight.size <= 1_000_000:  # entries; .1 s
            rows = self.matrix.T.tocsr()[tight][:, support].toarray()
            for _ in range(2):  # the second removes the rounding of the first
                y = y.copy()
                y[support] -= np.linalg.lstsq(rows, rows @ y[support], rcond=ROUNDING)[0]
        return y * self.rows

    def _repaired(self, y: Vector) -> list[Fraction] | None:
        """Return a vector near y that satisfies exactly the (in)equalities which y satisfies without slack."""
        support, equalities = self._tight(y)
        if min(support.size, equalities.size) > exact.MOST_UNKNOWNS:
            return None
        columns = exact.rational_rows(self.matrix.T.tocsr()[equalities][:, support])
        # Any nearby value will do: short ones keep the exact solve short.
        near = exact.short(y[support], 1 << 50)
        solved = exact.solved_nearby(columns, [ZERO] * len(columns), near, [True] * support.size)
        if solved is None:
            return None
        unscaled = [ZERO] * self.rows.size
        for i, value in zip(support.tolist(), solved, strict=True):
            unscaled[i] = value * Fraction(float(self.rows[i]))
        return unscaled

    def _tight(self, y: Vector) -> tuple[Any, Any]:
        """Return the indices of nonzero y, and the open columns at which Mᵀy has no slack."""
        size = abs(self.matrix).T @ np.abs(y)
        is_unbounded = np.isinf(self.constraints.lower) | np.isinf(self.constraints.upper)
        is_tight = is_unbounded & (np.abs(self.matrix.T @ y) <= FEASIBLE * size) & (size > 0.0)
        return np.flatnonzero(np.abs(y) > FEASIBLE), np.flatnonzero(is_tight)


def best_proof(
    stated: Callable[[float], LinearConstraints],
    units: Sequence[float],
    proven: Callable[[Multipliers], Any],
    *,
    exactly: bool = True,
    pivots: int | None = None,
) -> Any:
    """Return the first proof that excludes the tolerance 1e-6, else the proof of the largest margin, or None.

    Parameters
    ----------
    stated : callable
        Gives the constraints with the weights of a unit.
    units : sequence of float
        Units of offsets and bounds: the linear program cannot distinguish 1e-6 of a unit from 0, and truncates 1e5.
    """
    proofs, left = list[Any](), pivots
    for unit in distinct_units(units):
        asked = stated(unit)
        left = pivot_limit(sum(asked.matrix.shape)) if left is None else left
        farkas = FarkasProgram(asked, unit, left)
        answer = farkas.solve()
        left -= left if answer is None else answer.nit
        # The linear program cannot distinguish less from 0
        if answer is None or answer.fun > -1e-9:  # they seem consistent
            continue
        proof = None if exactly else proven(farkas.polished(answer))
        if proof is None or not proof.excludes(PROGRAM_TOLERANCE):
            proof = farkas.proof(answer, proven)
        if proof is not None:
            proofs.append(proof)
            if proof.excludes(PROGRAM_TOLERANCE):
                break
        if deadline.is_over() or left <= 0:
            break
    return max(proofs, key=lambda proof: proof.margin, default=None)


def distinct_units(units: Sequence[float]) -> Iterator[float]:
    """Yield the units that a linear program in an earlier unit cannot replace."""
    tried = list[float]()
    for unit in units:
        if not any(LEAST_UNIT * known <= unit <= MOST_UNITS * known for known in tried):
            tried.append(unit)
            yield unit


def pivot_limit(size: int) -> int:
    """Return the pivots of linear programs of so many rows and columns: fewer if they are many, and slow."""
    # Most linear programs take half as many pivots as rows
    return min(5 * size, PIVOT_WORK // max(size, 1))


def linear_program(
    cost: Vector, equations: Any, right: Any, bounds: Array, at_most: Any, pivots: int | None = None
) -> Any:
    """Return HiGHS's result of min costᵀv, equations · v = right, rows · v ≤ limits; None if it has no optimum.

    Parameters
    ----------
    bounds : pair of numbers or arrays
        Lower and upper bounds of v.
    at_most : pair
        Rows and limits.
    pivots : int, optional
        Largest number of pivots, by default `pivot_limit` of the rows and columns: on ill-conditioned rows the
        simplex method may repeat its vertices indefinitely. The time limit of a run also holds.
    """
    if not cost.size or not np.isfinite(cost).all() or not np.isfinite(equations.data).all():
        return None
    size = cost.size + equations.shape[0] + at_most[0].shape[0]
    right = np.broadcast_to(right, equations.shape[0])
    names = "primal_feasibility_tolerance", "dual_feasibility_tolerance"
    options: Any = dict.fromkeys(names, LP_TOLERANCE) | {"maxiter": pivots or pivot_limit(size)}
    if math.isfinite(left := deadline.left()):
        options["time_limit"] = left
    ends = np.broadcast_to(bounds[0], cost.size), np.broadcast_to(bounds[1], cost.size)
    result = highs(cost, at_most[0], at_most[1], equations, right, ends, **options)
    return result if result.status == 0 else None
