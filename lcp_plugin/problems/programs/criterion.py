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
- **gap**: Σ |y_i (d_i − c_i x)| over rows and bounds + Σ |x_j left_j| + the rounding of xᵀP x, beside
  Σ |c_j x_j| + |xᵀP x|.

Of units u of the unknowns there are two, the caller's and fitted ones: the smaller size counts.

x is SOLVED where no measure exceeds the goal. Each size is one of the answer, or of its row at the answer: a limit that
nobody reaches, a cost or a coefficient excuses nothing elsewhere. Unknowns that stand in no condition, or in one
beneath the rounding of what acts, are no size of x; multipliers, which may be huge and cancel, are no size of the
gradient's other components. Where all terms are 0 there is no size: an error is 0 or ∞. A row without coefficients is a
number that others have computed from terms which nobody sees here: it stands beside 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON
from ...core.matrix.matrix import largest_in_rows

if TYPE_CHECKING:
    from .program import QuadraticProgram

PROGRAM_TOLERANCE = 1e-6  # of `QPSolution.is_optimal`, by default
CONSTRAINTS = 1e-7  # what constraints are asked for at any tolerance between this and 1e-6
SHARE = 0.1  # of a larger tolerance
SURE = 1e-3  # of what is called optimal: no exact proof that there is no minimum beats an answer within that
STRICT = 1e3  # times a tolerance below 1e-9: what is asked of a program's own residuals
ACTS = 1e-6  # ω
NO_EXCUSE = 1e-9  # measures beside own terms that need no other size
SMALLEST = 2.0**-1074  # instead of a size 0: an error beside it is beyond every goal, and 0 stays 0
total, most = np.add.reduce, np.maximum.reduce  # what an array's methods come to, of small arrays in half the time


class Errors(NamedTuple):
    """The three measures, rounding included; ∞ where a number is not finite. Of a batch, arrays of shape (B,)."""

    primal: Any
    dual: Any
    gap: Any

    def meet(self, goal: float) -> Any:
        """Return whether all are small: the criterion, of everybody who calls a program optimal."""
        return (self.primal <= constraint_tolerance(goal)) & (self.dual <= goal) & (self.gap <= goal)

    def are_sure(self, goal: float) -> bool:
        """Return whether they meet the goal so well that no exact proof of the contrary may beat them."""
        return bool(self.largest <= SURE * goal)

    @property
    def largest(self) -> Any:
        """The largest of the three."""
        return np.maximum(np.maximum(self.primal, self.dual), self.gap)

    @classmethod
    def of(cls, program: QuadraticProgram, x: FloatVector, multipliers: FloatVector) -> Errors:
        """Return the errors of x and of the multipliers of all constraints."""
        matrices, (m, p, n, _) = program.matrices, program.matrices.sizes
        limits = np.concatenate([program.h, program.b])
        vectors = program.c, limits, matrices.is_equality[: m + p], program.lower, program.upper
        split = multipliers[: m + p], multipliers[m + p : m + p + n], multipliers[m + p + n :]
        with np.errstate(all="ignore"):
            terms = Terms.of(program, x, split[0])
            found = measured(terms, *vectors, x, *split)
            if not found.largest <= NO_EXCUSE:
                acting = Acting.of(program, terms, x, split)
                found = measured(terms, *vectors, x, *split, acting)
        return cls(*map(float, found))


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
        if matrices.has_sparse_rows or sp.issparse(program.P):
            return cls.of_sparse(program.P, matrices.rows, x, y)
        return cls.of_dense(program.P, matrices.dense_rows, x, y)

    @classmethod
    def of_dense(cls, P: Any, C: Any, x: FloatVector, y: FloatVector) -> Terms:
        """Return those of ndarrays, or of stacks of them: shapes (…, n, n), (…, rows, n), (…, n) and (…, rows)."""
        of_rows, of_columns, of_P = C * x[..., np.newaxis, :], C * y[..., np.newaxis], P * x[..., np.newaxis, :]
        sizes = [np.abs(one) for one in (of_rows, of_columns, of_P)]
        return cls(
            total(of_rows, -1), total(sizes[0], -1), most(sizes[0], -1, initial=0.0),
            total(of_columns, -2), total(sizes[1], -2), most(sizes[1], -2, initial=0.0),
            total(of_P, -1), total(sizes[2], -1), most(sizes[2], -1, initial=0.0), max(C.shape[-2:]),
        )

    @classmethod
    def of_sparse(cls, P: Any, C: sp.csr_array, x: FloatVector, y: FloatVector) -> Terms:
        """Return those of CSR arrays, or of an ndarray P."""
        transposed = sp.csr_array(C.T)
        of_rows, of_columns = _times(C, x), _times(transposed, y)
        if sp.issparse(P):
            of_P = _sums(_times(P, x))
        else:
            products = P * x
            of_P = products.sum(axis=1), np.abs(products).sum(axis=1), np.abs(products).max(axis=1)
        return cls(
            *_sums(of_rows), *_sums(of_columns), *of_P,
            int(max(np.diff(C.indptr).max(initial=0), np.diff(transposed.indptr).max(initial=0), x.size)),
        )


class Acting(NamedTuple):
    """What acts at a point, in each row's unit, in each column's, and in that of each row's and bound's multiplier."""

    row: Any
    column: Any
    of_row: Any

    @classmethod
    def of(cls, program: QuadraticProgram, terms: Terms, x: FloatVector, multipliers: Any) -> Acting:
        """Return the smaller sizes of those in the caller's units and in fitted ones."""
        base = np.maximum(np.abs(program.c), terms.product_largest)
        own = np.maximum(np.maximum(base, terms.pull_largest), np.maximum(*np.abs(multipliers[1:])))
        is_free = (x > program.lower) & (x < program.upper)
        sizes = []
        for unit in (np.ones(x.size), program.fitted_units):
            matrix: Any = program.matrices.rows if program.matrices.has_sparse_rows else program.matrices.dense_rows
            if sp.issparse(matrix):
                entries = np.abs(matrix.data) * unit[matrix.indices]
                coefficient = 1.0 / largest_in_rows(matrix, np.where(entries > 0.0, 1.0 / entries, 0.0))
            else:
                entries = np.abs(matrix) * unit
                coefficient = np.where(entries > 0.0, entries, np.inf).min(axis=1, initial=np.inf)
            coefficient = np.where(np.isfinite(coefficient), coefficient, 0.0)
            forces = (base * unit)[is_free]
            pull = forces[forces > 0.0].min(initial=np.inf)
            pull = pull if pull < np.inf else 0.0
            reach = _reach(program, matrix, np.where(own * unit > EPSILON * pull, np.abs(x) / unit, 0.0))
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


def _times(A: sp.csr_array, x: FloatVector) -> sp.csr_array:
    return sp.csr_array((A.data * x[A.indices], A.indices, A.indptr), shape=A.shape)


def _sums(A: sp.csr_array) -> tuple[FloatVector, FloatVector, FloatVector]:
    one = np.ones(A.shape[1])
    return A @ one, abs(A) @ one, largest_in_rows(A)


def measured(
    terms: Terms, c: FloatVector, d: FloatVector, is_equality: Any, lower: FloatVector, upper: FloatVector,
    x: FloatVector, y: FloatVector, of_lower: FloatVector, of_upper: FloatVector, acting: Acting | None = None,
) -> Errors:
    """Return the three measures of one program, or, by arrays with one axis more, of a batch.

    Parameters
    ----------
    terms : Terms
        At x and y.
    c, d, is_equality, lower, upper
        Shapes (…, n), (…, rows), (rows,), (…, n), (…, n).
    x, y, of_lower, of_upper
        The point and its multipliers, those of inequalities and of bounds ≥ 0 where they are right.
    acting : Acting, optional
        Without it rows and columns are measured beside their own terms alone.
    """
    known, rounding = np.isfinite(d), 2.0 * (terms.summands + 4) * EPSILON
    right = np.where(known, d, 0.0)
    residual, of_right = np.where(known, terms.value - right, 0.0), np.abs(right)
    margin = rounding * (terms.size + of_right)
    off = np.abs(residual)
    over = np.where(known, np.maximum(np.where(is_equality, off, residual) + margin, 0.0), 0.0)
    size = np.maximum(terms.largest, of_right)
    of_x = np.abs(x)
    outside = np.maximum(np.maximum(lower - x, x - upper), 0.0)

    cost, of_y, of_bounds = np.abs(c), np.abs(y), (np.abs(of_lower), np.abs(of_upper))
    left = np.abs(terms.product + c + terms.pull - of_lower + of_upper)
    blur = rounding * (terms.product_size + cost + terms.pull_size + of_bounds[0] + of_bounds[1])
    own = np.maximum(np.maximum(cost, terms.product_largest), np.maximum(terms.pull_largest, np.maximum(*of_bounds)))
    wrong = of_y * ~(is_equality | (known & (y >= 0.0)))
    if acting is not None:
        size, own = np.maximum(size, ACTS * acting.row), np.maximum(own, ACTS * acting.column)
    primal = np.maximum(_beside(over, size), _beside(outside, of_x))
    dual = np.maximum(_beside(left + blur, own), _beside(wrong, 0.0 if acting is None else acting.of_row))

    one = most(of_x, -1, keepdims=True, initial=0.0)
    one = one + (one == 0.0)  # of x: objectives may be beyond the range of doubles
    ahead, of_ahead = x / one, of_x / one
    gap = total(of_y * (np.maximum(off - margin, 0.0) / one), -1) + total(of_ahead * np.maximum(left - blur, 0.0), -1)
    linear, hidden = total(cost * of_ahead, -1), total(of_ahead * rounding * terms.product_size, -1)
    gap = gap + np.where(hidden > linear, hidden, 0.0)  # far along P d = 0 the rounding of P x hides any cost
    for signed, of_bound, bound in ((of_lower, of_bounds[0], lower), (of_upper, of_bounds[1], upper)):
        if of_bound.any():
            has = np.isfinite(bound)
            unfit = np.where(has & (signed >= 0.0), 0.0, of_bound)
            dual = np.maximum(dual, _beside(unfit, 0.0 if acting is None else acting.column))
            slack = np.abs(x - np.where(has, bound, 0.0)) / one
            gap = gap + total(np.where(has & (of_bound != 0.0), of_bound * slack, 0.0), -1)
    objective = linear + 1.5 * np.abs(total(ahead * terms.product, -1))
    found = primal, dual, gap / np.maximum(objective, SMALLEST)
    return Errors(*(np.where(np.isnan(one), np.inf, one) for one in found))


def _beside(wrong: Any, size: Any) -> Any:
    """Return the largest quotient along the last axis, 0 / 0 = 0; NaN where one is no number."""
    return most(wrong / np.maximum(size, SMALLEST), -1, initial=0.0)


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
