"""The criterion of a quadratic program: how wrong a point and its multipliers are beside what acts at them.

Of min ½ xᵀP x + cᵀx with rows C x ≤ d, or = d, and bounds, at x with multipliers y of rows and of bounds, rounding
included:

- **primal**: by how much a row is violated beside its own terms, max(|d_i|, max_j |c_ij x_j|), or beside
  ω min_j |c_ij u_j| · max_k |x_k / u_k| where that is larger, of unknowns that rows and P connect with it, and of
  others up to 1; a bound beside |x_j|.
- **dual**: what is left of component j of P x + c + Cᵀy beside its own terms, max(|c_j|, |p_jk x_k|, |c_ij y_i|, its
  bounds' multipliers), or beside ω times the smallest |b_k u_k| / u_j of unknowns off their bounds, b_k the largest
  of |c_k| and |p_kl x_l|, where that is larger; a multiplier of a wrong sign beside the same without ω, divided by the
  largest coefficient of its row.
- **gap**: Σ |y_i (d_i − c_i x)| over rows and bounds + Σ |x_j left_j| + the rounding of xᵀP x, or where that is larger
  what Newton's steps from x lower the objective by, beside Σ |c_j x_j| + |xᵀP x|.

Of units u of the unknowns there are two, the caller's and fitted ones: the smaller size counts.

x is SOLVED where no measure exceeds the goal. Each size is one of the answer, or of its row at the answer: a limit that
nobody reaches, a cost or a coefficient excuses nothing elsewhere. Unknowns that stand in no condition, or in one
beneath the rounding of what acts, are no size of x; multipliers, which may be huge and cancel, are no size of the
gradient's other components. Where all terms are 0 there is no size: an error is 0 or ∞. A row without coefficients is a
number that others have computed from terms which nobody sees here: it stands beside 1.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, all_hold, are_no_limits
from ...core.kernels.floats import EPSILON
from ...core.matrix.matrix import largest_in_rows
from ...core.rounding import compensated_product
from .newton_falls import newton_fall

if TYPE_CHECKING:
    from .program import QuadraticProgram
    from .program_matrices import ProgramMatrices

PROGRAM_TOLERANCE = 1e-6  # of `QPSolution.is_optimal`, by default
CONSTRAINTS = 1e-7  # what constraints are asked for at any tolerance between this and 1e-6
SHARE = 0.1  # of a larger tolerance
SURE = 1e-3  # of what is called optimal: no exact proof that there is no minimum beats an answer within that
STRICT = 1e3  # times a tolerance below 1e-9: what is asked of a program's own residuals
ACTS = 1e-6  # ω
NO_EXCUSE = (
    1e-9  # measures beside own terms that need no other size, and nothing falls beside which
)
NEARLY = 1e-3  # measures beyond that are not even inaccurately optimal
LEAST_OBJECTIVE = 2.0**-900  # beside which what underflows is nothing
SMALLEST = 2.0**-1074  # added to sizes: an error beside 0 is beyond every goal, and 0 stays 0
total, most = (
    np.add.reduce,
    np.maximum.reduce,
)  # what an array's methods come to, of small arrays in half the time


class Errors(NamedTuple):
    """The three measures, rounding included; ∞ where a number is not finite. Of a batch, arrays (B,), or NaN there."""

    primal: Any
    dual: Any
    gap: Any

    def meet(self, goal: float) -> Any:
        """Return whether all are small: the criterion, of everybody who calls a program optimal."""
        return (
            (self.primal <= constraint_tolerance(goal)) & (self.dual <= goal) & (self.gap <= goal)
        )

    def decide(self, goal: float) -> Any:
        """Return whether measures beside own terms are so small that what acts, and Newton's steps, change nothing.

        With a rest γ of the gradient along a direction of curvature κ the objective falls by γ²/2κ.
        """
        return self.meet(goal) & (self.largest <= NO_EXCUSE)

    def are_sure(self, goal: float) -> bool:
        """Return whether they meet the goal so well that no exact proof of the contrary may beat them."""
        return bool(self.largest <= SURE * goal)

    @property
    def largest(self) -> Any:
        """The largest of the three."""
        return (
            max(self)
            if isinstance(self.gap, float)
            else np.maximum(np.maximum(self.primal, self.dual), self.gap)
        )

    @classmethod
    def of(cls, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector) -> Errors:
        """Return the errors of x and of the multipliers of all constraints."""
        return cls.beside_own_terms(program, x, multipliers).or_excused(program, x, multipliers)

    def or_excused(
        self, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector
    ) -> Errors:
        """Return these errors beside own terms; where they are not tiny, the same beside what acts as well."""
        if self.largest <= NO_EXCUSE:
            return self
        return self._measured(program, x, multipliers, is_beside_own=False)

    @classmethod
    def beside_own_terms(
        cls, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector
    ) -> Errors:
        """Return the same beside the own terms of rows and columns alone: bounds of the errors from above."""
        return cls._measured(program, x, multipliers, is_beside_own=True)

    @classmethod
    def _measured(
        cls,
        program: QuadraticProgram,
        x: FloatVector,
        multipliers: FloatVector,
        *,
        is_beside_own: bool,
    ) -> Errors:
        m, p, n, _ = program.matrices.sizes
        limits = np.concatenate([program.h, program.b]) if p else program.h
        split = multipliers[: m + p], multipliers[m + p : m + p + n], multipliers[m + p + n :]
        with np.errstate(all="ignore"):
            terms = Terms.of(program, x, split[0])
            acting = None if is_beside_own else Acting.of(program, terms, x, split)
            found = cls.of_numbers(
                measured(
                    terms,
                    program.c,
                    limits,
                    m,
                    program.lower,
                    program.upper,
                    x,
                    *split,
                    acting,
                    program.P,
                )
            )
            if is_beside_own or not (program.matrices.has_curvature and found.largest <= NEARLY):
                return found
            fall = newton_fall(program, x, *split, rounding_of_gradient(terms, program.c))
            objective = float(np.abs(program.c) @ np.abs(x)) + abs(float(x @ terms.product))
            return found._replace(gap=max(found.gap, fall / (objective + SMALLEST)))

    @classmethod
    def above(cls, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector) -> Errors:
        """Return bounds of these errors from above, by a third of the work; ∞ where they would take more.

        The largest of k terms is at least s/k, s the sum of their sizes: |residual| / largest ≤ k |residual| / s.
        Rounding counts twice, since products in another order have it once more. Finite where x is within its bounds,
        all multipliers have their signs, and no limit is ∞.

        Parameters
        ----------
        program : QuadraticProgram
            Whose matrices are `is_judged_by_sums`.
        """
        matrices = program.matrices
        m, p, n, _ = matrices.sizes
        rows, terms = m + p, n + m + p + 3
        y, of_bounds = multipliers[:rows], multipliers[rows:]
        if not (n and all_hold(y[:m] >= 0.0)):
            return BEYOND
        H, of_H, of_x, of_y = matrices.stacked, matrices.stacked_sizes, np.abs(x), np.abs(y)
        right = np.concatenate((program.c, -program.h, -program.b))
        left, sums, of_right = H.dot(x), of_H.dot(of_x), np.abs(right)
        gradient, sums_of_gradient = left[:n], sums[:n]
        objective = float(of_right[:n].dot(of_x)) + 1.5 * abs(float(x.dot(gradient)))
        left += right
        sums += of_right
        gap = 0.0
        if rows:
            gradient += y.dot(H[n:])
            sums_of_gradient += of_y.dot(of_H[n:])
        if not are_no_limits(program.lower, program.upper):
            ends = np.concatenate((x - program.lower, program.upper - x))
            if not (all_hold(of_bounds >= 0.0) and all_hold(ends >= 0.0)):
                return BEYOND
            acts = of_bounds.nonzero()[0]
            if acts.size:
                gap = float(of_bounds[acts].dot(ends[acts]))
                gradient += of_bounds[n:] - of_bounds[:n]
                sums_of_gradient += of_bounds[n:] + of_bounds[:n]
        off, rounding = np.abs(left), 2.0 * (max(n, rows) + 4) * EPSILON
        hidden = rounding * float(of_x.dot(sums_of_gradient))
        gap += float(of_x.dot(off[:n])) + float(of_y.dot(off[n:])) + hidden
        objective -= 2.0 * hidden
        if m:
            off[n : n + m] = np.maximum(left[n : n + m], 0.0)
        off /= sums + SMALLEST
        worst = terms * (float(off[off.argmax()]) + 2.0 * rounding)
        if not (objective > LEAST_OBJECTIVE and math.isfinite(gap + worst)):
            return BEYOND
        return cls(worst, worst, gap / objective)

    @classmethod
    def of_numbers(cls, found: Errors) -> Errors:
        """Return those of one program as floats: what is no number is beyond every goal."""
        return cls(*(math.inf if math.isnan(one) else float(one) for one in found))


def rounding_of_gradient(terms: Terms, c: FloatVector) -> FloatVector:
    """Return what rounding may be of each component of P x + c + Cᵀy."""
    return np.asarray(_rounding(terms) * (terms.product_size + terms.pull_size + np.abs(c)))


def _rounding(terms: Terms) -> float:
    """Return that of a sum of so many terms, beside the sum of their sizes."""
    return 2.0 * (terms.summands + 4) * EPSILON


BEYOND = Errors(math.inf, math.inf, math.inf)


class Terms(NamedTuple):
    """What rows and columns are made of at a point, shapes (…, rows) and (…, n).

    Attributes
    ----------
    value, size, largest : array
        Of each row: Σ c_ij x_j, Σ |c_ij x_j|, the largest |c_ij x_j|.
    pull, pull_size, pull_largest : array
        Of each column: Σ c_ij y_i, Σ |c_ij y_i|, the largest |c_ij y_i|.
    product, product_size, product_largest : array
        Of each row of P: Σ p_jk x_k, Σ |p_jk x_k|, the largest |p_jk x_k|.
    summands : int
        The most that any of these has.
    """

    value: Any
    size: Any
    largest: Any
    pull: Any
    pull_size: Any
    pull_largest: Any
    product: Any
    product_size: Any
    product_largest: Any
    summands: int

    @classmethod
    def of(cls, program: QuadraticProgram, x: FloatVector, y: FloatVector) -> Terms:
        """Return those of a program at x, with multipliers y of the rows of G and A."""
        matrices = program.matrices
        if matrices.has_sparse_rows or not isinstance(program.P, np.ndarray):
            return cls.of_sparse(matrices, x, y)
        return cls.of_dense(program.P, matrices.dense_rows, x, y)

    @classmethod
    def of_dense(cls, P: Any, C: Any, x: FloatVector, y: FloatVector) -> Terms:
        """Return those of ndarrays, or of stacks of them: shapes (…, n, n), (…, rows, n), (…, n) and (…, rows)."""
        of_P, of_C, of_x, of_y = map(np.abs, (P, C, x, y))
        each = of_x[..., np.newaxis, :]
        return cls(
            _product(C, x),
            _product(of_C, of_x),
            most(of_C * each, -1, initial=0.0),
            _pull(C, y),
            _pull(of_C, of_y),
            most(of_C * of_y[..., np.newaxis], -2, initial=0.0),
            _product(P, x),
            _product(of_P, of_x),
            most(of_P * each, -1, initial=0.0),
            max(C.shape[-2:]),
        )

    @classmethod
    def of_sparse(cls, matrices: ProgramMatrices, x: FloatVector, y: FloatVector) -> Terms:
        """Return those of a program with CSR arrays among its matrices."""
        P, C, (of_rows, numbers, summands) = matrices.sparse_P, matrices.rows, matrices.places
        of_columns, largest = C.data * y[of_rows], np.zeros(x.size)
        sizes = np.abs(of_columns)
        np.maximum.at(largest, C.indices, sizes)
        return cls(
            *_sums(C.data * x[C.indices], C, of_rows),
            _summed(C.indices, of_columns, x.size),
            _summed(C.indices, sizes, x.size),
            largest,
            *_sums(P.data * x[P.indices], P, numbers),
            summands,
        )


class Acting(NamedTuple):
    """What acts at a point, in each row's unit, in each column's, and in that of each row's and bound's multiplier."""

    row: Any
    column: Any
    of_row: Any

    @classmethod
    def of(
        cls, program: QuadraticProgram, terms: Terms, x: FloatVector, multipliers: Any
    ) -> Acting:
        """Return the smaller sizes of those in the caller's units and in fitted ones."""
        base = np.maximum(np.abs(program.c), terms.product_largest)
        own = np.maximum(np.maximum(base, terms.pull_largest), np.maximum(*np.abs(multipliers[1:])))
        is_free = (x > program.lower) & (x < program.upper)
        sizes = []
        for unit in (np.ones(x.size), program.facts.fitted_units):
            matrix: Any = (
                program.matrices.rows
                if program.matrices.has_sparse_rows
                else program.matrices.dense_rows
            )
            if sp.issparse(matrix):
                entries = np.abs(matrix.data) * unit[matrix.indices]
                coefficient = 1.0 / largest_in_rows(
                    matrix, np.where(entries > 0.0, 1.0 / entries, 0.0)
                )
            else:
                entries = np.abs(matrix) * unit
                coefficient = np.where(entries > 0.0, entries, np.inf).min(axis=1, initial=np.inf)
            coefficient = np.where(np.isfinite(coefficient), coefficient, 0.0)
            forces = (base * unit)[is_free]
            pull = forces[forces > 0.0].min(initial=np.inf)
            pull = pull if pull < np.inf else 0.0
            reach = _reach(
                program, matrix, np.where(own * unit > EPSILON * pull, np.abs(x) / unit, 0.0)
            )
            of_rows = np.where(coefficient > 0.0, coefficient * reach, 1.0 / ACTS)
            sizes.append((of_rows, pull / unit, pull / coefficient))
        return cls(*(np.fmin(one, other) for one, other in zip(*sizes, strict=True)))


def row_excuses(program: QuadraticProgram, x: FloatVector) -> FloatVector:
    """Return what rows of G and A are measured beside at x where their own terms are smaller, whatever multipliers are.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> row_excuses(QuadraticProgram([[1, 0], [0, 1]], [-1, 0], G=[[0, 1]], h=[0]), np.array([1.0, 1e-13])).tolist()
    [1e-06]
    """
    m, p, n, _ = program.matrices.sizes
    none = np.zeros(m + p), np.zeros(n), np.zeros(n)
    return np.asarray(ACTS * Acting.of(program, Terms.of(program, x, none[0]), x, none).row)


def _reach(program: QuadraticProgram, matrix: Any, sizes: FloatVector) -> Any:
    """Return the largest size that acts on each row: of all unknowns, or up to 1, or of those connected with it."""
    largest = sizes.max(initial=0.0)
    if largest <= 1.0:
        return largest
    part, of_part = program.matrices.components, np.zeros(sizes.size)
    np.maximum.at(of_part, part, sizes)
    if sp.issparse(matrix):
        return np.maximum(1.0, largest_in_rows(matrix, of_part[part[matrix.indices]]))
    return np.maximum(1.0, np.where(matrix != 0.0, of_part[part], 0.0).max(axis=1, initial=0.0))


def _product(A: Any, x: FloatVector) -> Any:
    """Return A x, of an ndarray or of a stack."""
    return A.dot(x) if x.ndim == 1 else np.matmul(A, x[..., np.newaxis])[..., 0]


def _pull(A: Any, y: FloatVector) -> Any:
    """Return Aᵀ y, of an ndarray or of a stack."""
    return y.dot(A) if y.ndim == 1 else np.matmul(y[..., np.newaxis, :], A)[..., 0, :]


def _sums(terms: FloatVector, A: sp.csr_array, rows: Any) -> tuple[Any, Any, FloatVector]:
    """Return the sums of the terms in each row of A, those of their sizes, and the largest size."""
    sizes, m = np.abs(terms), A.shape[0]
    return _summed(rows, terms, m), _summed(rows, sizes, m), largest_in_rows(A, sizes)


def _summed(places: Any, terms: FloatVector, count: int) -> Any:
    """Return the sums of the terms of each place: doubles, of no terms as well."""
    return np.bincount(places, terms, count) + 0.0


def measured(
    terms: Terms,
    c: FloatVector,
    d: FloatVector,
    m: int,
    lower: FloatVector,
    upper: FloatVector,
    x: FloatVector,
    y: FloatVector,
    of_lower: FloatVector,
    of_upper: FloatVector,
    acting: Acting | None = None,
    P: Any = None,
) -> Errors:
    """Return the three measures of one program, or, by arrays with one axis more, of a batch.

    Parameters
    ----------
    terms : Terms
        At x and y.
    c, d, lower, upper
        Shapes (…, n), (…, rows), (…, n), (…, n).
    m : int
        How many rows are inequalities; the others are equations.
    x, y, of_lower, of_upper
        The point and its multipliers, those of inequalities and of bounds ≥ 0 where they are right.
    acting : Acting, optional
        Without it rows and columns are measured beside their own terms alone.
    P : array, optional
        Of one program: P x is computed again, exactly, where its rounding might hide a cost. Without it that counts
        in full.
    """
    rounding = _rounding(terms)
    value, row_size, size = terms.value, terms.size, terms.largest
    wrong = np.minimum(y[..., :m], 0.0)
    known = np.isfinite(d)
    if not known.all():  # a limit of ∞ says nothing
        d, value, row_size, size = (np.where(known, one, 0.0) for one in (d, value, row_size, size))
        wrong = np.where(known[..., :m], wrong, y[..., :m])
    residual, of_right = value - d, np.abs(d)
    margin, size, off = (
        rounding * (row_size + of_right),
        np.maximum(size, of_right),
        np.abs(residual),
    )
    residual[..., m:] = off[..., m:]
    of_x, outside = np.abs(x), np.maximum(lower - x, x - upper)

    cost, of_y = np.abs(c), np.abs(y)
    left = terms.product + terms.pull + c
    blur = terms.product_size + terms.pull_size + cost
    own = np.maximum(np.maximum(cost, terms.product_largest), terms.pull_largest)
    sides = (-1.0, of_lower, lower), (1.0, of_upper, upper)
    of_bounds = [(sign, of, np.abs(of), bound) for sign, of, bound in sides if of.any()]
    for sign, of, of_bound, _ in of_bounds:
        left = left + sign * of
        blur, own = blur + of_bound, np.maximum(own, of_bound)
    if acting is not None:
        size, own = np.maximum(size, ACTS * acting.row), np.maximum(own, ACTS * acting.column)
    left, blur = np.abs(left), rounding * blur
    primal = _largest(_beside(residual + margin, size), _beside(outside, of_x))
    wrongs = [_beside(left + blur, own)]
    if wrong.any():
        wrongs.append(_beside(np.abs(wrong), 0.0 if acting is None else acting.of_row[..., :m]))

    one = most(of_x, -1, keepdims=True, initial=0.0)
    one = one + (one == 0.0)  # of x: objectives may be beyond the range of doubles
    ahead = x / one
    of_ahead = np.abs(ahead)
    gap = _inner(of_y, np.maximum(off - margin, 0.0) / one) + _inner(
        of_ahead, np.maximum(left - blur, 0.0)
    )
    linear, hidden = _inner(cost, of_ahead), rounding * _inner(of_ahead, terms.product_size)
    objective = linear + 1.5 * abs(_inner(ahead, terms.product))
    # Far along P d = 0 the rounding of P x may hide a cost, if there is one, and is no size of the objective.
    may_hide = (hidden > NO_EXCUSE * objective) & (linear > 0.0)
    if P is not None and may_hide:
        product, radius = compensated_product(sp.csr_array(P), x)
        gradient = product + terms.pull + c + sum(sign * of for sign, of, *_ in of_bounds)
        hidden = np.fmin(
            hidden,
            _inner(of_ahead, np.minimum(np.abs(gradient), rounding * terms.product_size) + radius),
        )
        objective = linear + 1.5 * abs(_inner(ahead, product))
    gap = gap + hidden * may_hide
    for _, of, of_bound, bound in of_bounds:
        has = np.isfinite(bound)
        wrongs.append(
            _beside(
                np.where(has & (of >= 0.0), 0.0, of_bound), 0.0 if acting is None else acting.column
            )
        )
        slack = np.abs(x - np.where(has, bound, 0.0)) / one
        gap = gap + total(np.where(has & (of_bound != 0.0), of_bound * slack, 0.0), -1)
    return Errors(primal, _largest(*wrongs), gap / (objective + SMALLEST))


def _beside(wrong: Any, size: Any) -> Any:
    """Return the quotients, 0 / 0 = 0."""
    return wrong / (size + SMALLEST)


def _largest(*quotients: Any) -> Any:
    """Return the largest along the last axis, at least 0; NaN where one is no number."""
    every = np.concatenate(quotients, axis=-1) if len(quotients) > 1 else quotients[0]
    return most(every, -1, initial=0.0)


def _inner(one: Any, other: Any) -> Any:
    """Return the inner products along the last axis."""
    return one.dot(other) if one.ndim == other.ndim == 1 else total(one * other, -1)


def program_goal(tolerance: float) -> float:
    """Return the size of a program's own residuals that is called optimal at this tolerance of a run.

    Examples
    --------
    >>> program_goal(1e-8), program_goal(1e-4), program_goal(1e-12)
    (1e-06, 0.001, 1e-09)
    """
    return max(min(PROGRAM_TOLERANCE, STRICT * tolerance), 10.0 * tolerance)


def constraint_tolerance(tolerance: float) -> float:
    """Return the primal residual that is called optimal where the other conditions hold to a tolerance.

    A tenth of the tolerance, but no less than 1e-7 where the tolerance is no less: a program whose constraints
    contradict by 1e-6 is infeasible, not nearly feasible.

    Examples
    --------
    >>> constraint_tolerance(1e-6), constraint_tolerance(1e-12), constraint_tolerance(1e-3)
    (1e-07, 1e-12, 0.0001)
    """
    return max(SHARE * tolerance, min(tolerance, CONSTRAINTS))
