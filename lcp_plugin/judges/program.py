"""Stopping criterion of a quadratic program: the test of a point x with multipliers y of the rows.

The program is min ½ xᵀP x + cᵀx with rows C x ≤ d, or = d, and bounds. The test moves x into its bounds, sets
multipliers with a wrong sign to 0, and takes the gradient r = P x + c + Cᵀy for the multipliers of the bounds. With
T_i = Σ_j |c_ij x_j| + |d_i| and K = 1000, it requires

1. rows: each row is violated by at most 1e-9 T_i;
2. gap: in each connected component, Σ |y_i| |C x − d|_i + Σ |r_j| reach_j + max |r_j| far_j ≤ tolerance · size.

- size = |cᵀx| + |xᵀP x|, at least 1e-8 of Σ |c_j x_j| + |xᵀP x|, and at least 1e-6 of Σ y'_i T_i.
- price_j = |c_j| + |P x|_j + Σ_i |c_ij| y'_i; way_j = K size / price_j is the move of x_j that costs K objectives.
- D_j is the distance from x_j to the bound to which −r_j pushes: reach_j = D_j and far_j = 0 if D_j ≤ way_j, otherwise
  reach_j = min(D_j, K |x_j|) and far_j = way_j.
- y'_i is |y_i|, at most the largest |P x + c|_j of unknowns off their bounds, divided by the largest |c_ij|.

If the gap fails, it is computed with curvature: F are the unknowns off their bounds with p_jj > 0 and r_j at the
rounding level of its terms. If P_FF less n (n + 3) ε of its diagonal has a Cholesky factor, ½ r_FᵀP_FF⁻¹ r_F, the
largest gain of moves of F, replaces the terms of F; for the other terms, r is taken after the step −P_FF⁻¹ r_F.

So no feasible point is better by more than the tolerance if each unknown differs by at most K |x_j| plus a move, and
the moves cost together at most K times the objective; at t times these moves, the gain is at most t times the
tolerance. If c_j = 0 and r_j is at the rounding level of P x, |P| |x| replaces |P x| in price_j. In a component whose
costs are all 0, it does so for every j, and the size is at least 1e-6 of |x|ᵀ|P| |x| + Σ y'_i T_i. Multipliers of a
component where P x + c = 0 are 0: no point is better. Sums are plain, with bounds of rounding errors; if these do not
decide, sums are computed without rounding.

Each row is measured relative to T_i. Two kinds of noise count as 0:

- an x_j of at most 2⁻⁴² of the largest unknown of its component, or of at most 2⁻¹⁰⁰⁰: a point that fails is tested
  again with these zeros;
- the side d_i of a row with entries whose terms c_ij x_j are all 0, if |d_i| is at most 8 ε max_j |c_ij| max_j |x_j| of
  its component. In the gap, |y_i| of this row is at least the largest price_j/|c_ij|.

Limits: if a row has a coefficient of 1e11, a violation of another row by 9e-10 T_i may lower the objective of a point
that passes by more than the tolerance. A program may be unbounded although a program within 1e-10 of it has a minimum.
An objective below 1e-12 of the terms of the rows, weighted with their multipliers, or below 1e-14 of its terms, counts
as 0. Costs beyond 2^1000 overflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Array, Indices, Vector
from ..core.entries import clip, entries_of_rows, largest_in_rows, largest_products
from ..core.kernels.compilation import helper, kernel
from ..core.kernels.floats import DATA_ROUNDING, FEW_ROUNDINGS, INF, NEGLIGIBLE, UNIT
from ..core.rounding import add_pairs, compensated_pair, compensated_product, one_number
from ..core.structure import components_of_links

PROGRAM_TOLERANCE = 1e-6  # of the gap, by default
ROWS = 1e-9  # of the rows, at every tolerance
NEARLY = (1e-6, 1e-3)  # rows and gap: a point beyond is not even inaccurately optimal
NOISE = 1e-5  # of the coefficients of a row: its limit counts as at least that large in a proof
CANCELLED = 1e-8  # share of the objective's terms to which they may cancel
LEAST_SIZE = 1e-6  # of the rows' terms with their multipliers
MOVES = 1000.0  # times its size, an unknown without a bound is moved
SMALLEST_SIZE = 2.0**-900  # of the gap: if all terms are 0, gradients are relative to their terms
SHARP = 32.0 * MOVES * UNIT  # per unknown and row: below this gap, plain sums show no error
NO_POLISH = 4.0 * SHARP  # per unknown and row: daqp ends at 1 to 3.5 SHARP
LEAST_PRICE = 2.0**-1000  # quotients by it are finite


class KKTErrors(NamedTuple):
    """The largest error of a row of a point, and the largest gap of a component; ∞ if a number is not finite."""

    primal: Array
    gap: Array

    def meet(self, tolerance: float) -> Any:
        """Return whether the point is a solution: the test of programs."""
        return (self.primal <= ROWS) & (self.gap <= tolerance)

    def nearly_meet(self, tolerance: float) -> bool:
        """Return whether both measures are small, but perhaps above the tolerance."""
        return bool(self.primal <= NEARLY[0] and self.gap <= max(tolerance, NEARLY[1]))

    @property
    def largest(self) -> Any:
        """The larger measure; an error of the rows counts 1000 times, the ratio of the default tolerances."""
        return np.maximum(self.primal * (PROGRAM_TOLERANCE / ROWS), self.gap)

    @classmethod
    def of(cls, program: JudgedProgram, x: Vector, y: Vector, tolerance: float) -> KKTErrors:
        """Return the errors of x and multipliers y of G and A, or upper bounds that meet the tolerance."""
        return cls.with_point(program, x, y, tolerance)[0]

    @classmethod
    def with_point(
        cls, program: JudgedProgram, x: Vector, y: Vector, tolerance: float
    ) -> tuple[KKTErrors, Vector]:
        """Return the errors and x; with zeros at rounding level, if the tolerance is met only with them."""
        errors = cls._at(program, x, y, tolerance)
        if not errors.meet(tolerance) and (near := with_zeros(program, x)) is not x:
            again = cls._at(program, near, y, tolerance)
            return (again, near) if again.meet(tolerance) else (errors, x)
        return errors, x

    @classmethod
    def _at(cls, program: JudgedProgram, x: Vector, y: Vector, tolerance: float) -> KKTErrors:
        errors, terms = cls(np.inf, np.inf), program.terms
        if terms.is_dense and tolerance:
            errors = sharp_errors(program, x, y)
            if errors.meet(tolerance) and errors.gap <= NO_POLISH * (x.size + y.size):
                return errors
        if np.isfinite(x).all() and np.isfinite(y).all():
            for is_exact in (False, True):
                point = PrimalDualPoint(program, x, y, is_exact=is_exact)
                both = point.row_errors(), point.gaps(tolerance or SHARP)
                largest = np.nan_to_num([error.max(initial=0.0) for error in both], nan=np.inf)
                errors = cls(*largest.tolist())
                if errors.meet(tolerance):
                    break
        return errors


class ProgramComponents(NamedTuple):
    """Connected components of a program: the component of each unknown and of each row, and their number."""

    of_unknown: Indices
    of_row: Indices
    number: int

    def largest(self, sizes: Vector) -> Vector:
        """Return the largest of the unknowns' sizes ≥ 0 in each component."""
        most = np.zeros(self.number)
        np.maximum.at(most, self.of_unknown, sizes)
        return most


class JudgedProgram(NamedTuple):
    """Arrays of a program: min ½ xᵀP x + cᵀx, C x ≤ d in the first `terms.m` rows and C x = d in the others, bounds."""

    terms: ProgramTerms
    c: Vector
    d: Vector
    lower: Vector
    upper: Vector


@dataclass(frozen=True, eq=False)
class ProgramTerms:
    """P and C of programs with other vectors, and facts about them that each point needs, computed once.

    Attributes
    ----------
    P, C : ndarrays or CSR arrays, shapes (n, n) and (m + p, n)
    m : int
        Number of rows that are inequalities.
    """

    P: AnyMatrix
    C: AnyMatrix
    m: int

    @cached_property
    def sparse_P(self) -> sp.csr_array:
        """P as CSR."""
        return sp.csr_array(self.P)

    @cached_property
    def rows(self) -> sp.csr_array:
        """C as CSR."""
        return sp.csr_array(self.C)

    @cached_property
    def columns(self) -> sp.csr_array:
        """Cᵀ as CSR."""
        return sp.csr_array(self.rows.T)

    @cached_property
    def gradient(self) -> sp.csr_array:
        """[P Cᵀ]: the part of the Lagrangian's gradient that depends on x and the multipliers."""
        return sp.csr_array(sp.hstack([self.sparse_P, self.columns], format="csr"))

    @cached_property
    def counts(self) -> Indices:
        """Number of entries of each row of C."""
        return entries_of_rows(self.C)

    @cached_property
    def row_sizes(self) -> Vector:
        """Largest |entry| of each row of C; 1 for a row without entries."""
        sizes = largest_products(self.entry_sizes[3], np.ones(self.P.shape[0]))
        return np.where(sizes > 0.0, sizes, 1.0)

    @cached_property
    def squares_of_columns(self) -> Vector:
        """Sum of squares of each column of a dense C whose rows are divided by their sizes."""
        return np.square(self.C / self.row_sizes[:, np.newaxis]).sum(axis=0)

    @cached_property
    def components(self) -> ProgramComponents:
        """Connected components of the graph of P, G and A."""
        P, C = self.P, self.C
        (m, n), is_sparse = C.shape, sp.issparse(P)
        if not n or (self.counts == n).any() or (entries_of_rows(P) == n).any():
            return ProgramComponents(np.zeros(n, np.intp), np.zeros(m, np.intp), min(n + m, 1))
        if not is_sparse and n <= 64:  # rows up to which products are quicker than scipy's search
            link, alone = (C != 0.0).astype(np.float32), self.counts == 0
            part = components_of_links((P != 0.0) | (P.T != 0.0) | (link.T @ link > 0.0))
            count = int(part.max()) + 1
            of_row = np.where(alone, count + np.cumsum(alone) - 1, part[link.argmax(axis=1)])
            return ProgramComponents(part, of_row, count + int(np.count_nonzero(alone)))
        from scipy.sparse.csgraph import connected_components

        rows = sp.csr_array(sp.vstack([P, C]) if is_sparse else np.vstack([P, C]))
        both = sp.csr_array((np.ones(rows.nnz), rows.indices, rows.indptr), shape=(n + m, n + m))
        count, part = connected_components(both, directed=False)
        return ProgramComponents(part[:n], part[n:], count)

    @cached_property
    def is_dense(self) -> bool:
        """True if :func:`sharp_errors` measures programs with these matrices."""
        m, n = self.C.shape
        return isinstance(self.P, np.ndarray) and 0 < n <= 400 >= m

    @cached_property
    def both(self) -> tuple[Vector, Vector]:
        """[P; C] and the sizes of its entries, dense."""
        both = np.concatenate((self.P, self.C))
        return both, np.abs(both)

    def needed_multipliers(self, slopes: Vector, y: Vector) -> Vector:
        """Return y with 0 in components where the slopes P x + c are 0: no point is better there."""
        largest = self.components.largest(np.abs(slopes))
        return np.where(largest[self.components.of_row] > 0.0, y, 0.0)

    @cached_property
    def entry_sizes(self) -> tuple[Any, Any, Any, Any, Any]:
        """P and C = [G; A], and the sizes of the entries of P, C and Cᵀ: all dense or all CSR arrays."""
        P, C, of_C = self.P, self.C, abs(self.C)
        return P, C, abs(P), of_C, sp.csr_array(of_C.T) if sp.issparse(P) else of_C.T

    @cached_property
    def summands(self) -> tuple[Any, Any, Any]:
        """Upper bounds of the numbers of terms in rows of C, in rows of P, and in columns of C."""
        P, C = self.P, self.C
        rows, n = C.shape
        if not sp.issparse(P):
            return n, n, rows
        in_rows, in_P = (np.diff(part.indptr).max(initial=0) for part in (C, P))
        return in_rows, in_P, np.bincount(C.indices, minlength=n)


class PrimalDualPoint:
    """Point with the sums of its two measures, and the sizes of all terms of these sums.

    Parameters
    ----------
    program : JudgedProgram
    x, y : arrays
        Finite.
    is_exact : bool
        True if sums are computed without rounding. Otherwise full bounds of rounding errors are added.

    Attributes
    ----------
    excess, row_doubt : array, shape (m + p,)
        C x − d, and a bound of its rounding error.
    gradient, doubt, product, product_doubt : array, shape (n,)
        r and P x, with bounds of their rounding errors.
    row_terms, product_terms, slope_terms : array, shapes (m + p,), (n,) and (n,)
        Σ_j |c_ij x_j| + |d_i|, |P| |x|, and the sizes of the terms of r.
    """

    def __init__(self, program: JudgedProgram, x: Vector, y: Vector, *, is_exact: bool) -> None:
        self.program, self.terms, self.is_exact = program, program.terms, is_exact
        m, lower, upper, d = self.terms.m, program.lower, program.upper, program.d
        is_limit = np.isfinite(d)
        d, y = (np.where(is_limit, side, 0.0) for side in (d, y))
        np.maximum(y[:m], 0.0, out=y[:m])
        self.point, self.x = x, clip(x, lower, upper)
        self.outside = np.abs(x - self.x)
        x, self.of_x, self.cost = self.x, np.abs(self.x), np.abs(program.c)
        P, C, of_P, of_C, of_columns = self.terms.entry_sizes
        in_rows, in_P, in_columns = self.terms.summands
        self.limits, self.product_terms = np.abs(d), of_P @ self.of_x
        self.row_terms = of_C @ self.of_x + self.limits
        if is_exact:
            of_x = compensated_pair(self.terms.sparse_P, x)
            self.product, self.product_doubt = one_number(*of_x)
        else:
            self.product, self.product_doubt = P @ x, (in_P + 3.0) * UNIT * self.product_terms
        y = self.terms.needed_multipliers(self.product + program.c, y)
        self.of_y = np.abs(y)
        self.slope_terms = self.product_terms + self.cost + of_columns @ self.of_y
        self.rounding = (in_P + in_columns + 3.0) * UNIT * self.slope_terms
        if is_exact:
            of_y = compensated_pair(self.terms.columns, y, program.c)
            self.gradient, self.doubt = one_number(*add_pairs(of_x, of_y))
            self.excess, self.row_doubt = compensated_product(self.terms.rows, x, -d)
        else:
            self.gradient, self.doubt = self.product + program.c + C.T @ y, self.rounding
            self.excess, self.row_doubt = C @ x - d, (in_rows + 3.0) * UNIT * self.row_terms
        self.most_excess = np.abs(self.excess) + self.row_doubt
        if not is_limit.all():
            self.excess[~is_limit] = -np.inf

    def row_errors(self) -> Vector:
        """Return the error of each row and of each bound; sides at rounding level count as 0 if sums are exact."""
        over, sizes, of_bounds = self.violation, self.row_terms, self.outside
        if self.is_exact and (over > ROWS * sizes).any():
            sizes = np.maximum(sizes, self.noise / ROWS)
        if of_bounds.any():
            lower, upper = self.program.lower, self.program.upper
            bound = np.where(self.x == lower, np.abs(lower), np.abs(upper))
            of_bounds = ratio(of_bounds, np.maximum(bound, np.abs(self.point)))
        return np.concatenate([ratio(over, sizes), of_bounds])

    @cached_property
    def violation(self) -> Vector:
        """Upper bound of the violation of each row, shape (m + p,)."""
        m, over = self.terms.m, self.most_excess.copy()
        np.maximum(self.excess[:m] + self.row_doubt[:m], 0.0, out=over[:m])
        return over

    @cached_property
    def noise(self) -> Vector:
        """Size up to which the side of a row counts as 0, (m + p,); 0 unless it has entries, and its c_ij x_j are 0."""
        parts = self.terms.components
        most = FEW_ROUNDINGS * self.terms.row_sizes * parts.largest(self.of_x)[parts.of_row]
        is_noise = (self.row_terms == self.limits) & (self.limits <= most) & (self.terms.counts > 0)
        return np.where(is_noise, most, 0.0)

    def gaps(self, tolerance: float = PROGRAM_TOLERANCE) -> Vector:
        """Return the gap of each component; curvature counts if a gap is above the tolerance."""
        size, way, costs = self._scales()
        of_rows = self._sums(self.of_x, 0.0 * self.of_x, costs, self.most_excess)
        gap = of_rows + self._gain(self.gradient, np.abs(self.gradient) + self.doubt, way)
        if self.is_exact and (gap > tolerance * size).any():
            gap = np.minimum(gap, of_rows + self._curved_gain(way))
        return np.where(size < np.inf, gap / size, np.nan)

    def shares(self) -> Vector:
        """Return the part of the gap that each unknown's gradient r_j causes, without curvature, shape (n,)."""
        size, way, _ = self._scales()
        near, far = self._gains(self.gradient, np.abs(self.gradient) + self.doubt, way)
        return (near + far) / self._of_unknowns(size)

    def _scales(self) -> tuple[Vector, Vector, Vector]:
        """Return the size of each component, the longest move of each unknown, and the cost of each row."""
        x, of_x, y, sums = self.x, self.of_x, self.needed_y, self._sums
        terms, in_place = self.product_terms, 0.0 * self.product_terms
        curved = np.maximum(np.abs(sums(x, self.product)) - sums(of_x, self.product_doubt), 0.0)
        size = np.abs(sums(self.program.c, x)) + curved
        # Without costs, the terms of P x take their place
        if not self.cost.all():
            in_place = np.where(self._of_unknowns(sums(self.cost, self.cost)) > 0.0, 0.0, terms)
        size = np.maximum(size, CANCELLED * (sums(self.cost, of_x) + curved))
        size = np.maximum(size, LEAST_SIZE * sums(in_place, of_x, y, self.row_terms))
        size = np.maximum(size, SMALLEST_SIZE)
        # Without a cost, a gradient at the rounding level of P x is balanced by terms of P x that cancel
        in_P = self.terms.summands[1]
        is_rounding = (self.cost == 0.0) & (np.abs(self.gradient) <= (in_P + 3.0) * UNIT * terms)
        in_place = np.where(is_rounding, terms, in_place)
        price = np.maximum(np.abs(self.product) - self.product_doubt, in_place) + self.cost
        price += self.terms.entry_sizes[4] @ y
        costs = self.of_y
        if self.is_exact and (is_noise := (self.violation > 0.0) & (self.noise > 0.0)).any():
            rows = self.terms.rows
            by_unknowns = largest_in_rows(rows, price[rows.indices] / np.abs(rows.data))
            costs = np.where(is_noise, np.maximum(costs, by_unknowns), costs)
        way = self._of_unknowns(MOVES * size) / np.maximum(price, LEAST_PRICE)
        return size, way, costs

    def _gain(self, gradient: Vector, r: Vector, way: Vector) -> Vector:
        """Return a bound of the gain of moves in each component, without curvature; r bounds |gradient|."""
        near, far = self._gains(gradient, r, way)
        return self._sums(near, np.ones(near.size)) + self.terms.components.largest(far)

    def _gains(self, gradient: Vector, r: Vector, way: Vector) -> tuple[Vector, Vector]:
        """Return the gains of each unknown: of moves that add up, and of moves of which one is as long as `way`."""
        below, above = self.x - self.program.lower, self.program.upper - self.x
        distance = np.where(gradient > 0.0, below, above)
        # Either direction may reduce the objective
        distance = np.where(np.abs(gradient) <= self.doubt, np.maximum(below, above), distance)
        is_far = distance > way
        reach = np.where(is_far, np.minimum(distance, MOVES * self.of_x), distance)
        return r * np.where(r == 0.0, 0.0, reach), np.where(is_far, r * way, 0.0)

    def _curved_gain(self, way: Vector) -> Vector | float:
        """Return the gain with ½ rᵀP⁻¹r for unknowns off their bounds whose r is at rounding level.

        They are at the minimum over their values as far as doubles show. Other unknowns move after their step.
        """
        d, x, P = self.terms.P.diagonal(), self.x, self.terms.P
        is_curved = (x > self.program.lower) & (x < self.program.upper) & (d > 0.0)
        curved = np.flatnonzero(is_curved & (np.abs(self.gradient) <= self.rounding))
        r = (self.gradient + np.copysign(self.doubt, self.gradient))[curved]
        step = curved_step(P[curved][:, curved], r) if curved.size else None
        if step is None:
            return np.inf
        move, gain = np.zeros(x.size), np.zeros(x.size)
        move[curved], gain[curved] = step, 0.5 * r
        after = self.gradient - P @ move
        others = np.abs(after) + self.doubt
        others[curved] = 0.0
        return self._sums(gain, move) + self._gain(after, others, way)

    @property
    def needed_y(self) -> Vector:
        """Sizes of the multipliers, limited so that no row does more than balance P x + c at unknowns off their bounds.

        An unknown at rounding level of its component is at its bound.
        """
        pull = np.abs(self.product + self.program.c) - self.product_doubt
        room = np.minimum(self.x - self.program.lower, self.program.upper - self.x)
        parts = self.terms.components
        at_bound = room <= self._of_unknowns(DATA_ROUNDING * parts.largest(self.of_x))
        most = parts.largest(np.where(at_bound, 0.0, pull))[parts.of_row]
        return np.minimum(self.of_y, most / self.terms.row_sizes)

    def _sums(self, a: Vector, b: Vector, of_rows: Array = 0.0, other: Array = 0.0) -> Vector:
        """Return the sums of the products a_j b_j over each component, and of products of its rows."""
        parts = self.terms.components
        if parts.number == 1:
            return np.array([a @ b + np.dot(of_rows, other)])
        # floats, also without unknowns
        totals = np.bincount(parts.of_unknown, a * b, parts.number) + 0.0
        if isinstance(of_rows, np.ndarray):
            totals += np.bincount(parts.of_row, of_rows * other, parts.number)
        return np.asarray(totals)

    def _of_unknowns(self, values: Vector) -> Vector:
        """Return the value of each unknown's component."""
        return values[self.terms.components.of_unknown]


def least_size(program: JudgedProgram, x: Vector, y: Vector) -> float:
    """Return the size that a value at x has at least, 1e-6 of the rows' terms with the multipliers y."""
    point = PrimalDualPoint(program, x, y, is_exact=True)
    return LEAST_SIZE * float(point.needed_y @ point.row_terms)


def with_zeros(program: JudgedProgram, x: Vector) -> Vector:
    """Return x with 0 for unknowns that count as 0 next to the largest of their component; x itself without any."""
    parts, sizes = program.terms.components, np.abs(x)
    least = np.maximum(NEGLIGIBLE * parts.largest(sizes), LEAST_PRICE)
    is_noise = (sizes <= least[parts.of_unknown]) & (x != 0.0)
    is_noise &= (program.lower <= 0.0) & (program.upper >= 0.0)
    return np.where(is_noise, 0.0, x) if is_noise.any() else x


def curved_step(P: AnyMatrix, r: Vector) -> Vector | None:
    """Return (P − δ)⁻¹ r, where δ = n (n + 3) ε diag P covers the rounding of a factor; None if P − δ has no factor."""
    shift = r.size * (r.size + 3.0) * 2.0 * UNIT * P.diagonal()
    if not sp.issparse(P):
        from scipy.linalg import lapack

        *_, step, info = lapack.dposv(P - np.diag(shift), r)
        return None if info else step
    from scipy.sparse.linalg import splu

    options = {
        "permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True},
    }  # fmt: skip
    try:
        factor = splu(sp.csc_array(P - sp.diags_array(shift)), **options)
    except RuntimeError:  # a pivot of 0, or no memory
        return None
    is_symmetric = np.array_equal(factor.perm_r, factor.perm_c)
    return factor.solve(r) if is_symmetric and (factor.U.diagonal() > 0.0).all() else None


def ratio(errors: Vector, sizes: Vector) -> Vector:
    """Return the quotients, 0 / 0 = 0."""
    return np.where(errors > 0.0, errors / np.maximum(sizes, LEAST_PRICE), errors)


def sharp_errors(program: JudgedProgram, x: Vector, y: Vector) -> KKTErrors:
    """Return upper bounds of the two measures of a point of a dense program, by plain sums; ∞ where costs vanish."""
    (terms, *_), parts = program, program.terms.components
    sums = sharp_sums(*terms.both, terms.m, *program[1:], x, y)  # type: ignore[no-untyped-call]
    # Python reads lists faster
    lists = [each.tolist() for each in (*sums, parts.of_unknown, parts.of_row)]
    lists.append([[0.0] * 5 for _ in range(parts.number)])
    return KKTErrors(*sharp_measures(terms.m, *lists))  # type: ignore[no-untyped-call]


def sharp_sums(both, of_both, m, c, d, lower, upper, x, y):  # type: ignore[no-untyped-def]
    """Return the arguments of `sharp_measures` for a point: sums, c, d, the point, x and |y|."""
    point, n, y = x, len(x), np.where(d < INF, y, 0.0)
    x = np.minimum(np.maximum(x, lower), upper)
    y[:m] = np.maximum(y[:m], 0.0)
    of_x, of_y, C, of_C = np.abs(x), np.abs(y), both[n:], of_both[n:]
    sums = both.dot(x), of_both.dot(of_x), y.dot(C), of_y.dot(of_C)
    return *sums, c, d, point, x, of_y


def sharp_measures(m, values, sizes, slopes, weights, c, d, point, x, of_y, part, of_row, totals):  # type: ignore[no-untyped-def]
    """Return both measures by [P; C] x, |[P; C]| |x|, yᵀC and |y|ᵀ|C|, of arrays or lists; `totals` are 0 a component.

    reach_j ≤ way_j + K |x_j| and way_j ≤ K size / price_j; further terms only raise sizes and prices.
    """
    n, rows, primal, gap = len(c), len(d), 0.0, 0.0
    of_sum, of_gradient = (n + 3.0) * UNIT, (n + rows + 3.0) * UNIT
    for j in range(n):
        value, linear, product, bend, total = x[j], c[j], values[j], sizes[j], totals[part[j]]
        of_x, cost, lost, outside = abs(value), abs(linear), of_sum * bend, abs(point[j] - value)
        price = abs(product) - lost + cost
        r = abs(product + linear + slopes[j]) + of_gradient * (bend + cost + weights[j])
        if not (price > 0.0 and r < INF and outside < INF):
            return INF, INF
        total[0] += linear * value
        total[1] += value * product
        total[2] += of_x * lost
        total[3] += r * of_x
        total[4] += r / price
        if outside > 0.0:
            primal = max(primal, outside / max(of_x, abs(point[j]), LEAST_PRICE))
    for i in range(rows):
        limit = d[i]
        if limit < INF:
            terms, excess = sizes[n + i] + abs(limit), values[n + i] - limit
            rounding = of_sum * terms
            missed = abs(excess) + rounding
            if not missed < INF:
                return INF, INF
            over = excess + rounding if i < m else missed
            if over > primal * terms:
                primal = over / max(terms, LEAST_PRICE)
            totals[of_row[i]][3] += of_y[i] * missed / MOVES
    for k in range(len(totals)):
        total = totals[k]
        size = abs(total[0]) + max(abs(total[1]) - total[2], 0.0)
        if not (size > 0.0 and total[3] < INF and total[4] < INF):
            return INF, INF
        gap = max(gap, MOVES * (total[3] / size + 2.1 * total[4]))
    return primal, gap


COMPILED_SUMS, COMPILED_MEASURES = helper(sharp_sums), helper(sharp_measures)


@kernel
def measure_many(both, m, c, d, lower, upper, x, y, errors):  # type: ignore[no-untyped-def]
    """Write both measures of points in rows, of programs of one component; `both` has one [P; C], or one a point."""
    part, of_row = np.zeros(c.shape[1], np.int64), np.zeros(d.shape[1], np.int64)
    for k in range(len(c)):
        one, ends = both[k % len(both)], (lower[k], upper[k])
        sums = COMPILED_SUMS(one, np.abs(one), m, c[k], d[k], *ends, x[k], y[k])
        errors[k] = COMPILED_MEASURES(m, *sums, part, of_row, np.zeros((1, 5)))
