"""A model as unknowns, rows, pairs and an objective, for any modeling language; and its conversion to a problem.

Free unknowns that an equation defines, as in w == M @ x + q, are taken out of the model and put back. The equations
left are matched with the unknowns left: the diagonal that a splitting method divides by.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core import deadline
from ..core.checks import Array, BoolVector, Indices, Vector
from ..core.entries import largest_in_rows, row_numbers
from ..core.errors import NotSquare, UnsupportedModel
from ..core.kernels.floats import DATA_ROUNDING, NEGLIGIBLE
from ..core.lcp import LCP
from ..core.names import MOST_NAMES, Names, format_count
from ..core.settings import Status
from ..core.structure import equation_signs
from ..expressions import functions
from ..expressions.rows import Compiler, Program, Rows, added, as_matrix, assembled, is_definition
from ..judges.worst_rows import WorstRow, outside_row
from ..proofs.no_solution import find_infeasibility
from ..solving.dispatch import solve
from ..solving.result import Result
from .equilibria.equilibrium_program import EquilibriumProgram, SmoothPart
from .nonlinear.data import NonlinearProblem
from .programs.program import QuadraticProgram


@dataclass(eq=False)
class Elimination:
    """z = expansion · (unknowns left) + offset; every unknown, the defined ones included.

    Attributes
    ----------
    kept : ndarray of int
        The unknowns that are left.
    expansion : CSR array, shape (all unknowns, unknowns left)
    offset : ndarray, shape (all unknowns,)
    rows, columns : ndarray of int
        Rows of the equations, and the unknown that each of them defined.
    """

    kept: NDArray[np.int64]
    expansion: sp.csr_array
    offset: Vector
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]

    def expand(self, z: Vector) -> Vector:
        """Return all unknowns."""
        return np.asarray(self.expansion @ z + self.offset)

    def terms(self, z: Vector) -> Vector:
        """Return the sum of the sizes of the terms of each unknown."""
        return np.asarray(abs(self.expansion) @ np.abs(z) + np.abs(self.offset))

    def expand_slack(self, w: Vector) -> Vector:
        """Return w with 0 for the unknowns that belong to an equation."""
        whole = np.zeros(self.offset.size)
        whole[self.kept] = w
        return whole


#: matrix · (all unknowns) + offset.
Affine = tuple[sp.csr_array, Vector]


def eliminate_definitions(
    equations: Affine, functions: Affine, owner: Indices, is_free: BoolVector, variable_of: Indices
) -> tuple[Elimination, Affine, Affine]:
    """Return the elimination of all unknowns that are only defined, the equations left and the functions.

    Parameters
    ----------
    equations, functions : pair of matrix and offset
        Rows that must be 0, and rows that belong to pairs, over all unknowns. The returned rows are over the remaining
        ones.
    owner : array of int
        The constraint that each equation is of.
    is_free : array of bool
        Unknowns that no pair holds and that have no bounds.
    variable_of : array of int
        The variable that each unknown is an entry of.

    Notes
    -----
    Constraints are treated one after the other. A row of a constraint defines a free unknown if its variable has only
    one entry in the row, and if other rows of the constraint do not contain the unknown. The unknown is substituted
    everywhere else, so that chains of definitions need no order. A definition remains an equation if its substitution
    would fill the matrices.
    """
    n = is_free.size
    expansion = sp.eye_array(n, format="csr")
    offset, is_open, remaining = np.zeros(n), is_free.copy(), np.ones(owner.size, dtype=bool)
    limit = 4 * (equations[0].nnz + functions[0].nnz) + 10 * n  # times the entries there were
    defining = defined = np.zeros(0, dtype=np.int64)
    for number in range(min(int(owner.max(initial=-1)) + 1, 500)):
        rows, columns = _pivots(equations[0], np.flatnonzero(owner == number), is_open, variable_of)
        if not rows.size:
            continue
        substitution, shift = put_in(equations[0][rows], equations[1][rows], columns)
        changed = [(A @ substitution, b + A @ shift) for A, b in (equations, functions)]
        if sum(matrix.nnz for matrix, _ in changed) > limit:
            continue
        equations, functions = changed
        offset, expansion = offset + expansion @ shift, expansion @ substitution
        remaining[rows] = is_open[columns] = False
        defining, defined = np.append(defining, rows), np.append(defined, columns)
    kept = np.delete(np.arange(n), defined)
    if defined.size:
        equations = equations[0][remaining][:, kept], equations[1][remaining]
        functions = functions[0][:, kept], functions[1]
    elimination = Elimination(kept, expansion[:, kept], offset, defining, defined)
    return elimination, equations, functions


def put_in(matrix: sp.csr_array, offset: Vector, columns: Indices) -> tuple[sp.csr_array, Vector]:
    """Return R and r of the substitution z ← R z + r that solves matrix · z + offset = 0 for the columns' unknowns.

    Parameters
    ----------
    matrix : CSR array, shape (k, n)
        Row i defines the unknown ``columns[i]``, and none of the others.
    offset : ndarray, shape (k,)
    columns : ndarray of int, shape (k,)
    """
    k, n = matrix.shape
    row, pivots, shift = row_numbers(matrix), np.ones(k), np.zeros(n)
    is_pivot = matrix.indices == columns[row]
    pivots[row[is_pivot]] = matrix.data[is_pivot]
    shift[columns] = -offset / pivots
    others, row = np.delete(np.arange(n), columns), row[~is_pivot]
    rows, places = np.append(others, columns[row]), np.append(others, matrix.indices[~is_pivot])
    values = np.append(np.ones(others.size), -matrix.data[~is_pivot] / pivots[row])
    substitution = sp.csr_array((values, (rows, places)), shape=(n, n))
    substitution.eliminate_zeros()
    return substitution, shift


def _pivots(
    equations: sp.csr_array, rows: Indices, is_open: BoolVector, variable_of: Indices
) -> tuple[Indices, Indices]:
    """Return rows of one constraint and the unknown that each defines, of the variable with most unknowns."""
    part = equations[rows]
    part.eliminate_zeros()
    place = row_numbers(part).astype(np.int64)
    variables = variable_of[part.indices]
    code = place * (variable_of.max() + 1) + variables
    _, pair, count = np.unique(code, return_inverse=True, return_counts=True)
    times = np.bincount(part.indices, minlength=is_open.size)
    fits = is_open[part.indices] & (times[part.indices] == 1) & (count[pair] == 1)
    fits &= np.abs(part.data) >= 1e-8 * largest_in_rows(part)[place]  # of its row
    if not fits.any():
        return rows[:0], rows[:0]
    fits &= variables == np.argmax(np.bincount(variables[fits]))
    return rows[place[fits]], part.indices[fits].astype(np.int64)


def matching(block: sp.csr_array) -> Indices:
    """Return for each equation the unknown it goes with: large entries on the diagonal where that is possible."""
    from scipy.sparse.csgraph import maximum_bipartite_matching, min_weight_full_bipartite_matching

    rows, largest = row_numbers(block), largest_in_rows(block)
    # Costs must be positive; a hint of the distance from the diagonal settles ties in natural order.
    cost = 1.0 + np.log(largest[rows] / np.abs(block.data)) + 1e-9 * np.abs(rows - block.indices)
    index, pointer = block.indices.astype(np.int32), block.indptr.astype(np.int32)
    pattern = sp.csr_matrix((cost, index, pointer), shape=block.shape)
    try:
        return np.asarray(min_weight_full_bipartite_matching(pattern)[1], dtype=np.int64)
    except ValueError:  # no full matching: the diagonal will have gaps
        pairs = maximum_bipartite_matching(pattern, perm_type="column")
        matched = np.asarray(pairs, dtype=np.int64)
        matched[matched < 0] = np.setdiff1d(np.arange(matched.size), matched)
        return matched


def matched_for_monotony(
    equations: sp.csr_array, pairs: sp.csr_array, paired: Indices, free: Indices
) -> tuple[Indices, Vector]:
    """Return for each equation the place in `free` of the unknown it goes with, and the sign of its row.

    Parameters
    ----------
    equations, pairs : CSR array
        Over all unknowns; the rows of pairs with their signs.
    paired, free : array of int
        The unknown of each row of pairs, and those that are left for the equations.

    Notes
    -----
    Each equation is matched by a large entry, which becomes a diagonal entry. The sign of a row makes its diagonal
    entry positive; if this entry is zero, the sign is computed by :func:`~lcp_plugin.core.structure.equation_signs`.
    """
    order = matching(sp.csr_array(equations[:, free]))
    rows = np.arange(order.size)
    signs = np.sign(np.asarray(equations[rows, free[order]]).ravel()) if order.size else np.zeros(0)
    signs = np.where(signs == 0.0, 1.0, signs)
    whole = sp.vstack([pairs, sp.diags_array(signs) @ equations], format="csr")
    whole = whole[:, np.concatenate([paired, free[order]])]
    is_equation = np.arange(whole.shape[0]) >= paired.size
    return order, signs * equation_signs(whole, is_equation)[paired.size :]


RowNumbers = Sequence[int] | Indices
BEGUN = (
    "started from the values of the variables, which are the last solution unless others were set"
)
OUTSIDE = 1e-8  # of 1 + |x|: a bound that no pair states is violated beyond
#: The names of a status in AMPL, cvxpy and Pyomo.
STATUS_ELSEWHERE = {
    Status.SOLVED: (0, "optimal", "optimal"),
    Status.PRECISION_LIMIT: (100, "optimal_inaccurate", "other"),
    Status.INFEASIBLE: (200, "infeasible", "infeasible"),
    Status.NO_SOLUTION: (200, "infeasible", "infeasible"),
    Status.UNBOUNDED: (300, "unbounded", "unbounded"),
    Status.MAX_ITERATIONS: (400, "user_limit", "maxIterations"),
    Status.MAX_SECONDS: (401, "user_limit", "maxTimeLimit"),
    Status.INTERRUPTED: (402, "user_limit", "userInterrupt"),
    Status.STALLED: (500, "user_limit", "noSolution"),
    Status.DIVERGED: (501, "solver_error", "noSolution"),
}


class MissingPair(NotSquare):
    """The model has more unknowns without a pair than equations."""


@dataclass(frozen=True, eq=False)
class StatedRows:
    """Rows between two limits; or rows that complement unknowns between two bounds.

    Attributes
    ----------
    rows : Rows
    low, high : ndarray
        low ≤ rows ≤ high; of a pair low ≤ z ≤ high.
    origin : object
        Expression of the language that the rows were read from: rows = sign · origin − slacks.
    sign : ndarray or float
    z : ndarray of int or None
        Unknowns complementary to the rows: sign · rows ≥ 0 if z = low, ≤ 0 if z = high, and 0 between.
    slacks : ndarray of int or None
        Unknowns that the rows define.
    name : callable or None
        From the number of a row to its name.
    """

    rows: Rows
    low: Vector
    high: Vector
    origin: Any = None
    sign: Any = 1.0
    z: Array = None
    slacks: Any = None
    name: Callable[[int], str] | None = None


@dataclass(frozen=True, eq=False)
class SquareModel:
    """The complementarity problem that a statement becomes, and where its unknowns and rows come from.

    Attributes
    ----------
    problem : LCP or NonlinearProblem; Blocks over cones
        An LCP where everything is affine.
    elimination : Elimination
        The way from its unknowns to all of them.
    stored : csr_array, csr_array
        The entries of the pairs and of the equations, over all unknowns; empty in a nonlinear problem.
    places : ndarray of int, shape (n,)
        Row number of each row of the problem, up to `signs`: pairs first, then equations that are not definitions.
    signs : ndarray, shape (n,)
    matched : ndarray of int
        Unknown matched with each equation that is not a definition, in order.
    dropped : ndarray of int
        Unknowns with bounds that no pair states or implies: the problem does not have them.
    whole : callable or None
        Returns the model of all unknowns, without an elimination; None over cones.
    """

    problem: Any
    elimination: Elimination
    stored: tuple[sp.csr_array, sp.csr_array]
    places: Indices
    signs: Vector
    matched: Indices
    dropped: Indices
    whole: Callable[[], SquareModel] | None

    def proved(self, result: Result) -> Result:
        """Return the result with a proof for the data of the model, because a substitution rounds products.

        INFEASIBLE becomes PRECISION_LIMIT without such a proof.
        """
        is_infeasible = result.status is Status.INFEASIBLE
        if self.whole is None or not self.elimination.rows.size or not is_infeasible:
            return result
        proof = find_infeasibility(self.whole().problem)
        if proof is None or not proof.excludes(result.tolerance, result.absolute_tolerance):
            return replace(result, status=Status.PRECISION_LIMIT, z=result.certificate.z)
        return replace(result, infeasibility=proof)

    def numbers(self, count: int) -> Indices:
        """Return the number of each row of the problem among all `count` rows: of the pairs, then of the equations."""
        defining = self.stored[0].shape[0] + self.elimination.rows
        return np.delete(np.arange(count), defining)[self.places]

    def at_values(
        self, unknowns: Vector, tolerance: float, name: Callable[[int], str]
    ) -> tuple[Any, Vector, list[WorstRow]]:
        """Return the problem and its point at values of all unknowns, and the definitions that do not hold there.

        If the value of a defined unknown differs from its definition by more than rounding, the constants of the
        problem are those that its rows have at these values.
        """
        elimination = self.elimination
        z = unknowns[elimination.kept]
        defined, terms = elimination.expand(z), elimination.terms(z)
        error = unknowns - defined
        error[np.abs(error) <= NEGLIGIBLE * terms] = 0.0
        if not error.any():
            return self.problem, z, []
        change = sp.vstack(self.stored, format="csr") @ error
        shift = self.signs * change[self.numbers(change.size)]
        violated = []
        for k in np.flatnonzero(~(np.abs(error) <= tolerance * terms)).tolist():
            off, size = abs(float(error[k])), float(terms[k])
            text = f"{name(k)} = {unknowns[k]:.6g}, and its equation gives {defined[k]:.6g}"
            violated.append(WorstRow(name(k), off / size if size else math.inf, off, size, text))
        violated.sort(key=lambda row: -row.residual)
        return self.problem.with_q(self.problem.q + shift), z, violated

    def first_mismatch(self, z: Vector, w: Vector, values: Vector) -> tuple[int, float] | None:
        """Return the first row that the language evaluates otherwise than it was computed, and the computed value.

        Parameters
        ----------
        z, w : ndarray, shape (n,)
            Solution of the problem.
        values : ndarray
            Rows of the pairs, then of the equations, as the language evaluates them.
        """
        expected, numbers = np.zeros(values.size), self.numbers(values.size)
        expected[numbers] = self.signs * w
        unknowns, matrices = self.elimination.expand(z), list[Any](self.stored)
        order, largest = np.arange(values.size), np.abs(unknowns).max(initial=0.0)
        if isinstance(self.problem, NonlinearProblem):  # e.g. exp(x) − 1 has constants of size 1
            slopes = self.problem.slopes(z, self.problem.value(z))
            matrices, order, largest = [slopes], numbers, max(largest, 1.0)
        terms = np.abs(values) + np.abs(expected)
        sizes, at = [abs(matrix) for matrix in matrices], np.abs(unknowns)
        terms[order] += np.concatenate([matrix @ at for matrix in sizes])
        allowed = 1e-9 * terms  # relative to the terms of a row
        # Terms may be rounding errors of larger unknowns
        sums = np.concatenate([matrix.sum(axis=1) for matrix in sizes])
        allowed[order] += DATA_ROUNDING * largest * sums
        is_near = np.abs(values - expected) <= allowed
        wrong = np.flatnonzero(np.isfinite(expected) & ~is_near)
        return (int(wrong[0]), float(expected[wrong[0]])) if wrong.size else None


class Statement:
    """Unknowns with bounds, rows, pairs and an objective of one model.

    It is one class because both forms of a model, `square` and `best`, read all rows, pairs and bounds that were
    stated.

    Parameters
    ----------
    compiler : Compiler
        Compiler that created the rows.
    first : mapping
        From the key of a source to the number of its first unknown.
    lower, upper : ndarray, shape (count,)
        Bounds of the unknowns, in addition to the conditions of the pairs.
    name : callable
        From the number of an unknown to its name.
    """

    other_way = ""  # of the language of the model, to give an unknown a condition
    way_to_fix = "set both bounds of {name} to {value}"  # of the language also

    def __init__(
        self,
        compiler: Compiler,
        first: Mapping[int, int],
        lower: Vector,
        upper: Vector,
        name: Callable[[int], str],
    ) -> None:
        self.compiler, self.first, self.lower, self.upper = compiler, dict(first), lower, upper
        self._named, self.name = lower.size, name
        self.is_paired = np.zeros(lower.size, dtype=bool)
        self.rows: list[StatedRows] = []
        self.pairs: list[StatedRows] = []
        self._repeated: list[int] = []  # unknowns of further pairs of which they are the variable

    def constrain(
        self, rows: Rows, low: Array = 0.0, high: Array = 0.0, origin: Any = None, name: Any = None
    ) -> None:
        """Let low ≤ rows ≤ high."""
        zero = np.zeros(rows.size)
        self.rows.append(StatedRows(rows, zero + low, zero + high, origin, name=name))

    def complement(
        self, z: Indices, w: Rows, low: Array, high: Array, sign: float = 1.0, **facts: Any
    ) -> None:
        """Let sign · w complement the unknowns z between low and high; facts are the origin and the name."""
        zero = np.zeros(z.size)
        self.is_paired[z] = True
        self.pairs.append(StatedRows(w, zero + low, zero + high, sign=zero + sign, z=z, **facts))

    def entries(self, rows: Rows) -> tuple[Indices, Vector, Vector] | None:
        """Return columns, weights and constants of rows weights · distinct unknowns + constants, or None."""
        if rows.level or rows.terms != rows.size:
            return None
        matrix, offset = assembled([rows], self.first, self.lower.size)
        if not is_definition(matrix) or not matrix.data.all():
            return None
        return matrix.indices.astype(np.int64), matrix.data, offset

    def repeat(self, columns: Indices) -> None:
        """Note that unknowns which have a pair are the variable of another pair."""
        self._repeated += columns[self.is_paired[columns]].tolist()

    def named(self, rows: Rows, origin: object, sign: float = 1.0) -> Indices:
        """Return new unknowns, which an equation makes sign · rows."""
        first, free, zero = self.lower.size, np.full(rows.size, np.inf), np.zeros(rows.size)
        key, columns = 2**62 + first, np.arange(first, first + rows.size)
        self.first[key] = first
        self.lower, self.upper = np.append(self.lower, -free), np.append(self.upper, free)
        self.is_paired = np.append(self.is_paired, zero > 0.0)
        rows = rows.scaled(sign)
        rows = Rows({**rows.blocks, key: -1.0}, rows.offset, (rows.size,), rows.level)
        self.rows.append(StatedRows(rows, zero, zero, origin, sign, None, columns))
        return columns

    def name_of(self, column: int) -> str:
        """Return the name of an unknown; "" for an unknown that stands for an expression."""
        return self.name(column) if column < self._named else ""

    # --- a complementarity problem ---

    def square(self, variable_of: Indices, *, eliminates: bool = True) -> SquareModel:
        """Return the complementarity problem, with substituted definitions and matched equations.

        Parameters
        ----------
        variable_of : ndarray of int
            The variable of the language that each unknown is an entry of, by number.
        eliminates : bool
            Whether definitions are substituted.

        Raises
        ------
        NotSquare
            If inequalities or bounds without a pair leave more unknowns than equations.
        UnsupportedModel
            If the numbers of equations and unknowns differ for another reason.

        Notes
        -----
        A nonlinear model keeps all unknowns, also unknowns that an equation defines, because a substitution would fill
        its sparse matrices.
        """
        free, n = np.flatnonzero(~self.is_paired), self.lower.size
        functions = [part.rows for part in self.pairs]
        equations = [replace(part.rows, offset=part.rows.offset - part.low) for part in self.rows]
        groups = functions, equations
        sizes = [sum(rows.size for rows in group) for group in groups]
        has_bounds = np.isfinite([self.lower[free], self.upper[free]]).any()
        if free.size != sizes[1]:
            raise self._not_square(free, sizes[1], has_bounds)
        lower, upper = self._bounds_of_pairs()
        dropped = self._dropped(free) if has_bounds else free[:0]
        lower[free], upper[free] = -np.inf, np.inf
        paired, signs = _stacked(self.pairs, "z", "sign")
        program = None
        owner = np.repeat(np.arange(len(equations)), [rows.size for rows in equations])
        if any(rows.level for rows in (*functions, *equations)):
            program = Program.of(self.compiler, [*functions, *equations], self.first, n)
            (M, q), (E, e) = ((sp.csr_array((size, n)), np.zeros(size)) for size in sizes)
        else:
            (M, q), (E, e) = (assembled(rows, self.first, n) for rows in groups)
        stored = M, E
        if program is not None or not eliminates:
            owner[:] = -1
        facts = owner, ~self.is_paired, variable_of
        elimination, (E, e), (M, q) = eliminate_definitions((E, e), (M, q), *facts)
        kept = elimination.kept
        columns: Any = np.searchsorted(kept, paired)
        free = np.flatnonzero(~self.is_paired[kept])
        if free.size:
            if program is not None:
                derivative = _filled(program.jacobian(_generic_point(lower, upper)))
                M, E = derivative[: sizes[0]], derivative[sizes[0] :]
            signed = sp.csr_array(sp.diags_array(signs) @ M)
            order, turned = matched_for_monotony(E, signed, columns, free)
            free = free[order]
            columns, signs = np.concatenate([columns, free]), np.concatenate([signs, turned])
        places = np.argsort(columns, kind="stable")
        signs = signs[places]
        numbers = np.delete(np.arange(sum(sizes)), sizes[0] + elimination.rows)[places]
        names = self._names([*self.pairs, *self.rows], numbers, kept)
        low, high = lower[kept], upper[kept]
        problem: LCP | NonlinearProblem
        if program is None:
            M, q = _arranged(M, q, E, e, places, signs)
            problem = LCP(M, q, lower=low, upper=high, names=names)
        else:
            program = program.rearranged(places, signs)
            problem = NonlinearProblem(program.value, program.jacobian, low, high, names=names)
            problem.affine_part = partial(self._affine_part, lower, upper)
        whole = partial(self.square, variable_of, eliminates=False)
        return SquareModel(problem, elimination, stored, places, signs, kept[free], dropped, whole)

    def _affine_part(self, lower: Vector, upper: Vector) -> QuadraticProgram:
        """Return the program of affine rows within the bounds of pairs, without an objective."""
        pairs = [part for part in self.pairs if not part.rows.level]
        others = [part for part in self.rows if not part.rows.level]
        rows, stated = [part.rows.scaled(part.sign) for part in pairs], [*pairs, *others]
        rows += [part.rows for part in others]
        A, shift = assembled(rows, self.first, self.lower.size)
        low, high = _stacked(stated, "low", "high")
        is_pair = np.arange(low.size) < sum(part.rows.size for part in pairs)
        ends = np.where(np.isfinite(high), -np.inf, 0.0), np.where(np.isfinite(low), np.inf, 0.0)
        sides = zip(ends, (low, high), strict=True)
        low, high = (np.where(is_pair, *both) - shift for both in sides)
        names, c = self._names(stated, range(low.size), range(lower.size)), np.zeros(lower.size)
        return QuadraticProgram.from_ranges(None, c, A, low, high, lower, upper, names=names)

    def _names(self, stated: list[StatedRows], rows: RowNumbers, kept: RowNumbers) -> Names:
        """Return the names of a problem with some of the stated rows and of the unknowns."""
        named = [(part.rows.size, part.name) for part in stated]
        unknown = partial(name_of_row, [(self._named, self.name)], kept)
        return Names(partial(name_of_row, named, rows), unknown)

    def _not_square(self, free: Indices, equations: int, has_bounds: object) -> UnsupportedModel:
        """Return the error that there are not as many equations as unknowns without a pair."""
        of_pairs = sum(part.rows.size for part in self.rows if part.slacks is not None)
        counted = f", {of_pairs} of them from pairs of two expressions" if of_pairs else ""
        names = [*filter(None, map(self.name_of, free[:MOST_NAMES].tolist()))]
        names += ["…"] * (free.size > MOST_NAMES)
        way_out = ""
        if equations > free.size and (reason := self._fixing_equation() or self.repeated()):
            way_out = f"; {reason}"
        elif equations > free.size:
            way_out = (
                "; if one fixes the scale of prices, as sum(p) == 1, drop a market that the others imply, or give "
                "the equation a free multiplier, a variable in the rows of the pairs"
            )
        elif names:
            way_out = f"; give these a pair or an equation{self.other_way}"
        return (MissingPair if free.size > equations and has_bounds else UnsupportedModel)(
            f"the model has {format_count(equations, 'equation')}{counted} and "
            f"{format_count(free.size, 'unknown')} without a complementarity ({', '.join(names) or 'none'}); it needs "
            f"as many equations as such unknowns{way_out}"
        )

    def repeated(self, at_least: int = 2) -> str | None:
        """Return advice on the unknown that is the variable of most pairs, if of so many."""
        column, others = (Counter(self._repeated).most_common(1) or [(0, 0)])[0]
        if others + 1 < at_least:
            return None
        return (
            f"{self.name_of(column)} is the variable of {others + 1} pairs, and each pair after the first needs a free "
            "unknown or a variable of its own; give the pairs different variables"
        )

    def _fixing_equation(self) -> str:
        """Return advice on an equation that fixes an unknown with a pair, or ""."""
        for part in self.rows:
            if part.slacks is not None or part.rows.level:
                continue
            matrix, offset = assembled([part.rows], self.first, self.lower.size)
            for row in np.flatnonzero(np.diff(matrix.indptr) == 1).tolist():
                k = matrix.indptr[row]
                column, weight = matrix.indices[k], matrix.data[k]
                if self.is_paired[column] and weight:
                    value = f"{(part.low[row] - offset[row]) / weight + 0.0:.9g}"
                    name = self.name_of(int(column))
                    way_out = self.way_to_fix.format(name=name, value=value)
                    return (
                        f"an equation fixes {name}, which has a pair: {way_out} in that pair, and drop "
                        "the equation"
                    )
        return ""

    def _bounds_of_pairs(self) -> tuple[Vector, Vector]:
        """Return the bounds of all unknowns; raise UnsupportedModel if a pair has wider ones than its unknown."""
        lower, upper = self.lower.copy(), self.upper.copy()
        for pair in self.pairs:
            for bounds, stated, sign in ((lower, pair.low, 1.0), (upper, pair.high, -1.0)):
                others = np.flatnonzero(sign * bounds[pair.z] > sign * stated)
                if others.size:
                    raise UnsupportedModel(
                        f"{self.name_of(int(pair.z[others[0]]))} is declared with other bounds than its pair states; "
                        "state them once"
                    )
                bounds[pair.z] = stated
        return lower, upper

    def _dropped(self, free: Indices) -> Indices:
        """Return the unpaired unknowns with bounds that no pair implies."""
        low, high = self.lower.copy(), self.upper.copy()
        for pair in self.pairs:
            if (definition := self.entries(pair.rows)) is None:
                continue
            columns, weights, shift = definition
            has_low, has_high = np.isfinite(pair.low), np.isfinite(pair.high)
            sign = np.where(has_low, 1.0, -1.0) * pair.sign * weights * (has_low != has_high)
            low[columns[(sign > 0.0) & (low[columns] <= -shift / weights)]] = -np.inf
            high[columns[(sign < 0.0) & (high[columns] >= -shift / weights)]] = np.inf
        return free[np.isfinite(low[free]) | np.isfinite(high[free])]

    def violated_bounds(
        self, unknowns: Vector, columns: Indices, allowed: float = OUTSIDE
    ) -> list[WorstRow]:
        """Return the unknowns of the columns that violate their bounds by more than a part of 1 + |x|."""
        beyond = np.maximum(self.lower - unknowns, unknowns - self.upper)[columns]
        violated = []
        for k in columns[~(beyond <= allowed * (1.0 + np.abs(unknowns[columns])))].tolist():
            value, lower, upper = map(float, (unknowns[k], self.lower[k], self.upper[k]))
            violated.append(outside_row(self.name_of(k), value, lower if value < lower else upper))
        return violated

    # --- the best of all solutions ---

    def best(self, goal: Rows, sign: float, integers: Indices) -> EquilibriumProgram:
        """Return the program: minimize sign · goal, with unknowns that are integers."""
        seconds = [np.zeros(0), *map(self._value_of, self.pairs)]
        n, goal = self.lower.size, goal.scaled(sign)
        quadratic, smooth = self.quadratic(goal), None
        linear = [part for part in self.rows if not part.rows.level]
        bent = [part for part in self.rows if part.rows.level]
        if bent or quadratic is None:
            objective = goal if quadratic is None else Rows({}, np.zeros(1), (1,))
            results = [objective, *(part.rows for part in bent)]
            functions_of = Program.of(self.compiler, results, self.first, n)
            smooth = SmoothPart(functions_of, *_stacked(bent, "low", "high"))
        P, c, constant = quadratic or (sp.csr_array((n, n)), np.zeros(n), 0.0)
        A, shift = assembled([part.rows for part in linear], self.first, n)
        low, high = (ends - shift for ends in _stacked(linear, "low", "high"))
        bounds = self.lower, self.upper
        names = self._names(linear, range(low.size), range(n))
        program = QuadraticProgram.from_ranges(P, c, A, low, high, *bounds, constant, names)
        program = program.replaced(sense=sign)
        first, low, high = _stacked(self.pairs, "z", "low", "high")
        pairs = first.astype(np.int64), np.concatenate(seconds).astype(np.int64), low, high
        return EquilibriumProgram(program, *pairs, integers, smooth)

    def _value_of(self, pair: StatedRows) -> Indices:
        """Return the unknowns that are w of a pair."""
        definition = self.entries(pair.rows)
        if definition is None or (pair.sign * definition[1] != 1.0).any() or definition[2].any():
            return self.named(pair.rows, pair.origin, pair.sign)
        return definition[0]

    def quadratic(self, goal: Rows) -> tuple[sp.csr_array, Vector, float] | None:
        """Return P, c, r where the objective is ½ xᵀP x + cᵀx + r, None if it is something else."""
        n, goal = self.lower.size, self._without_copies(goal)
        c, shift = np.zeros(n), float(goal.offset[0])
        half = sp.csr_array((n, n))
        for key, block in goal.blocks.items():
            weights = as_matrix(block, 1).toarray().ravel()
            if key in self.first:
                c[self.first[key] : self.first[key] + weights.size] += weights
                continue
            _, function, arguments, _ = self.compiler.groups[-1 - key]
            if function not in (functions.PRODUCT, functions.SQUARE):
                return None
            sides = [self._without_copies(side) for side in (arguments[0], arguments[-1])]
            if any(side.blocks.keys() - self.first.keys() for side in sides):
                return None
            (A, a), (B, b) = (assembled([side], self.first, n) for side in sides)
            half = sp.csr_array(half + A.T @ sp.diags_array(weights) @ B)
            c += A.T @ (weights * b) + B.T @ (weights * a)
            shift += float(weights @ (a * b))
        return sp.csr_array(half + half.T), c, shift

    def _without_copies(self, rows: Rows) -> Rows:
        """Return rows in which the results of functions that only name expressions are substituted."""
        groups = self.compiler.groups
        while names := [
            key
            for key in rows.blocks.keys() - self.first.keys()
            if groups[-1 - key][1] is functions.SAME
        ]:
            blocks = {key: block for key, block in rows.blocks.items() if key not in names}
            weights = [(key, as_matrix(rows.blocks[key], rows.size)) for key in names]
            named = [groups[-1 - key][2][0].applied(A, rows.shape) for key, A in weights]
            rows = added([replace(rows, blocks=blocks), *named], rows.shape)
        return rows


def name_of_row(
    stated: list[tuple[int, Callable[[int], str] | None]], rows: RowNumbers, i: int
) -> str:
    """Return the name of row or unknown i of a problem, by the counts and names of stated parts; "" without a name."""
    k = int(rows[i])
    for size, name in stated:
        if k < size:
            return "" if name is None else name(k)
        k -= size
    return ""


def _stacked(stated: list[StatedRows], *names: str) -> list[Vector]:
    """Return these attributes of all rows, concatenated."""
    columns = ([getattr(part, name) for part in stated] for name in names)
    return [np.concatenate([*column, np.zeros(0)]) for column in columns]


def _generic_point(lower: Vector, upper: Vector) -> Vector:
    """Return a point within the bounds, of different entries near 1, at which no slope is 0 by chance."""
    near = np.random.default_rng(0).uniform(0.9, 1.1, lower.size)
    x: Vector = np.clip(near, lower, upper)
    return np.where(x == 0.0, -near, x)


def _filled(derivative: sp.csr_array) -> sp.csr_array:
    """Return a derivative without zeros and without entries that are not finite."""
    sizes = np.where(np.isfinite(derivative.data), derivative.data, 0.0)
    # In place of zero or infinite entries of a derivative where equations are matched
    derivative.data = np.where(sizes == 0.0, 1e-3, sizes)
    return derivative


def _arranged(
    M: sp.csr_array, q: Vector, E: sp.csr_array, e: Vector, places: Indices, signs: Vector
) -> tuple[sp.csr_array, Vector]:
    """Return the rows in order, with their signs; the user's matrix is not copied if unchanged."""
    if e.size:
        M, q = sp.csr_array(sp.vstack([M, E], format="csr")), np.append(q, e)
    if not np.array_equal(places, np.arange(q.size)):
        M, q = sp.csr_array(M[places]), q[places]
    return (sp.csr_array(sp.diags_array(signs) @ M), signs * q) if (signs != 1.0).any() else (M, q)


def solve_from(square: SquareModel, start: Vector | None, options: dict[str, Any]) -> Result:
    """Return the result of the problem that a model became.

    Parameters
    ----------
    square : SquareModel
    start : array, shape (n,), or None
        Present values of the unknowns, ignored unless all are finite; ``z0`` in the options has priority.
    options : dict
        Options of `solve`.
    """
    problem = square.problem
    is_given = bool(options.keys() & {"z0", "x0"}) or start is None or not np.isfinite(start).all()
    if isinstance(problem, NonlinearProblem):
        # The derivative is ours; the result is compared with the language's evaluation at the end.
        options = {"check_jacobian": False, "x0": np.zeros_like(problem.lower), **options}
    options = options if is_given else {**options, "z0": start}
    result: Result = solve(problem, **options)
    limit = options.get("max_seconds")
    with deadline.limit(np.inf if limit is None else limit - result.seconds):
        result = square.proved(result)
    return result if is_given else replace(result, begun=result.begun or BEGUN)
