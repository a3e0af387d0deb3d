"""Collects what a list of complementarities and equalities says: unknowns, bounds, rows; and the way back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..errors import UnsupportedModel
from ..problem.lcp import LCP
from ._compat import attribute_bounds, attribute_expressions
from .equations import Affine, Elimination, eliminate_definitions, is_definition, known_ranges, matched_for_monotony
from .extract import AffineMap, affine_map
from .model import BoundSource, Model, Report, Sources
from .nonlinear_expressions import nonlinear_nodes
from .nonlinear_model import nonlinear_model

if TYPE_CHECKING:
    from .constraint import Complements, Side

Single = tuple[NDArray[np.int64], FloatVector]

PLAIN, NO_VARIABLE = 4, 9  # ranks of a side: the last that is an inequality of variables; no variable at all


@dataclass(frozen=True, eq=False)
class Function:
    """Rows matrix · unknowns + offset, and what is not affine; an equation of this constraint, of a pair without one.

    Attributes
    ----------
    expression : cvxpy expression
    matrix : CSR array
    offset : ndarray
    constraint : cvxpy constraint or None
    shape : tuple
    nodes : sequence of cvxpy expression
        Those that are not affine in their arguments, arguments first.
    blocks : mapping
        From the keys of such nodes to the matrices by which their results enter the rows.
    slacks : ndarray of int or None
        The unknowns that the matrix takes off the expression, one a row; None for none.
    """

    expression: Any
    matrix: sp.csr_array
    offset: FloatVector
    constraint: Any = None
    shape: tuple[int, ...] = ()
    nodes: Sequence[Any] = ()
    blocks: Mapping[int, sp.csr_array] = field(default_factory=dict)
    slacks: NDArray[np.int64] | None = None

    def over(self, count: int) -> sp.csr_array:
        """Return the matrix over all unknowns, those included that came later."""
        matrix = self.matrix
        if matrix.shape[1] == count:
            return matrix
        return sp.csr_array((matrix.data, matrix.indices, matrix.indptr), shape=(self.offset.size, count))


class Builder:
    """Collects unknowns, bounds and rows of one list of constraints."""

    def __init__(self, constraints: list[Any], memo: dict[Any, Any]) -> None:
        self.memo = memo
        self.variables = list({v.id: v for constraint in constraints for v in constraint.variables()}.values())
        ends = np.cumsum([0, *(variable.size for variable in self.variables)]).tolist()
        self.offsets: dict[int, int] = {v.id: start for v, start in zip(self.variables, ends[:-1], strict=True)}
        self.count: int = ends[-1]
        bounds = [
            [np.ravel(np.broadcast_to(bound, variable.shape), order="F") for bound in attribute_bounds(variable)]
            for variable in self.variables
        ]
        self.lower, self.upper = (
            np.concatenate([*(pair[k] for pair in bounds), np.zeros(0)]).astype(np.float64) for k in (0, 1)
        )
        self.is_paired, self.is_defined = np.zeros(self.count, dtype=bool), np.zeros(self.count, dtype=bool)
        #: Of each pair: the unknowns, the function that belongs to them, and its sign.
        self.pairs: list[tuple[NDArray[np.int64], Function, FloatVector]] = []
        self.equations: list[Function] = []
        self.reports: list[Report] = []
        self.bounds: list[BoundSource] = []
        for variable in self.variables:
            if (stated := attribute_expressions(variable)) is not None:
                columns = self.offsets[variable.id] + np.arange(variable.size)
                self.bounds.append(BoundSource(columns, np.ones(variable.size), variable, *stated))
        #: Variables that are paired as if they had bounds, and have none.
        self.unbounded: list[Side] = []

    def add_equation(self, constraint: Any) -> None:
        """Take in one equality, before the pairs: what it defines is better not the variable of a pair."""
        # Always the same expression object, so that the memo knows it again.
        nodes, found = self._extracted(constraint.expr)
        self.equations.append(self._function(constraint.expr, nodes, found, constraint))
        for variable, block in found.blocks.items():
            if variable in self.offsets and is_definition(block):
                self.is_defined[self.offsets[variable] + block.indices] = True

    def _extracted(self, expression: Any) -> tuple[list[Any], AffineMap]:
        """Return the nodes that are not affine in their arguments, and the map that is affine in their results."""
        nodes = nonlinear_nodes(expression)
        return nodes, affine_map(expression, memo=self.memo, unknowns=set(map(id, nodes)))

    def _function(self, expression: Any, nodes: list[Any], found: AffineMap, constraint: Any = None) -> Function:
        others = {key: block for key, block in found.blocks.items() if key not in self.offsets}
        return Function(expression, self._matrix(found), found.offset, constraint, found.shape, nodes, others)

    def _matrix(self, function: AffineMap) -> sp.csr_array:
        """Return the rows of an affine map over the unknowns that variables are."""
        size = function.offset.size
        if len(self.variables) == len(function.blocks) == 1 and self.variables[0].id in function.blocks:
            return function.blocks[self.variables[0].id]  # without a copy
        parts = [function.blocks.get(v.id, sp.csr_array((size, v.size))) for v in self.variables]
        return sp.csr_array(sp.hstack(parts, format="csr")) if parts else sp.csr_array((size, 0))

    def add_pair(self, pair: Complements) -> None:
        """Take in one complementarity: find the side that is a variable, or make one of the other's value."""
        sides = (pair.first, pair.second)
        functions = [self._function(side.expression, *self._extracted(side.expression)) for side in sides]
        singles = [_single_columns(function) for function in functions]
        ranks = [self._rank(sides[k], sides[1 - k], singles[k]) for k in (0, 1)]
        k = 0 if ranks[0] <= ranks[1] else 1
        if max(ranks) <= PLAIN and self._is_defined(singles[k]) and not self._is_defined(singles[1 - k]):
            k = 1 - k
        single = singles[k]
        if ranks[k] != NO_VARIABLE and single is not None:
            self._pair_variable(pair, sides[k], functions[k], sides[1 - k], functions[1 - k], *single)
        elif {side.kind for side in sides} == {"nonnegative"} and singles == [None, None]:
            self._pair_slack(pair, *functions)
        else:
            raise UnsupportedModel(
                f"one side of {pair!r} must be a variable, or distinct entries of variables that no other pair holds; "
                "give it a variable of its own: y == side in the list, and y in its place in the pair"
            )

    def _is_defined(self, single: Single | None) -> bool:
        return single is not None and bool(self.is_defined[single[0]].all())

    def _rank(self, side: Side, other: Side, single: Single | None) -> int:
        """Return how naturally this side is the variable: 0 best, NO_VARIABLE not at all."""
        if single is None or side.kind == "zero" or other.kind == "box" or self.is_paired[single[0]].any():
            return NO_VARIABLE
        columns, weights = single
        is_bounded = bool((np.isfinite(self.lower[columns]) | np.isfinite(self.upper[columns])).any())
        is_bare = isinstance(side.expression, cp.Variable)
        if side.kind == "box":
            return 0
        if side.kind == "value":
            return 1 if is_bounded and is_bare else 2 if is_bounded else 5 if is_bare else 6
        # Of two inequalities the plainer one bounds the variable; with its attributes it must not quarrel.
        return 3 if (weights == 1.0).all() and not is_bounded else 4

    def _pair_variable(
        self, pair: Complements, side: Side, own: Function, other: Side, function: Function,
        columns: NDArray[np.int64], weights: FloatVector,
    ) -> None:
        positive = weights > 0.0
        low, high = (np.ravel(bound, order="F") for bound in side.bounds())
        if side.kind in ("nonnegative", "box"):
            with np.errstate(over="ignore"):  # beyond every double: no bound, or refused below
                low, high = (low - own.offset) / weights, (high - own.offset) / weights
            low, high = np.where(positive, low, high), np.where(positive, high, low)
            self._tighten(side, columns, low, high)
            stated = (side.lower, side.upper) if side.kind == "box" else (0.0, np.inf)
            self.bounds.append(BoundSource(columns, weights, side.expression, *stated))
        low, high = self.lower[columns], self.upper[columns]
        sign = np.where(positive, 1.0, -1.0)
        if other.kind == "nonnegative" and side.kind != "nonnegative":
            sign = self._sign_of_inequality(pair, low, high)
        elif other.kind == "value" and side.kind == "nonnegative":
            sign = np.ones(columns.size)  # F ≥ 0 at a lower bound, F ≤ 0 at an upper one
        if other.kind == "zero" and (np.isfinite(low) | np.isfinite(high)).any():
            raise UnsupportedModel(f"{pair!r} pairs an equality with a bounded variable; pair it with a free one")
        self.is_paired[columns] = True
        is_bounded = bool((np.isfinite(low) | np.isfinite(high)).any())
        if side.kind == other.kind == "value" and not is_bounded and not _states_bounds(side):
            self.unbounded.append(side)
        self._keep_pair(pair, (side, other), columns, function, sign, (weights, own.offset, side.expression))

    def _keep_pair(
        self, pair: Complements, sides: tuple[Side, Side], columns: NDArray[np.int64], function: Function,
        sign: FloatVector, value: tuple[Any, Any, Any] = (1.0, 0.0, None),
    ) -> None:
        """Keep that w = sign · function goes with the columns; value says what the first side is of its unknown."""
        self.pairs.append((columns, function, sign))
        shape = pair.first.expression.shape
        for constraint, is_slack in ((pair, True), (sides[0].constraint, True), (sides[1].constraint, False)):
            if constraint is not None:
                how = (sign, 0.0, None) if is_slack else value
                self.reports.append(Report(constraint, columns, shape, is_slack, *how))

    @staticmethod
    def _sign_of_inequality(pair: Complements, low: FloatVector, high: FloatVector) -> FloatVector:
        """Return the sign of w for a stated G ≥ 0: w = G at a lower bound, −G at an upper one; nothing else agrees."""
        has_low, has_high = np.isfinite(low), np.isfinite(high)
        if (has_low == has_high).any():
            raise UnsupportedModel(
                f"{pair!r} states an inequality opposite a variable that has two bounds, or none; give the expression "
                "alone, F instead of F >= 0: it is ≥ 0 at the lower bound and ≤ 0 at the upper one"
            )
        return np.where(has_low, 1.0, -1.0)

    def _tighten(self, side: Side, columns: NDArray[np.int64], low: FloatVector, high: FloatVector) -> None:
        """Set the bounds of the columns; the attributes of a variable may repeat them, not contradict them."""
        stated_low, stated_high = self.lower[columns], self.upper[columns]
        contradicts_low = np.isfinite(stated_low) & (stated_low != low)
        contradicts_high = np.isfinite(stated_high) & (stated_high != high)
        if contradicts_low.any() or contradicts_high.any():
            raise UnsupportedModel(
                f"the attributes of a variable in {side} state other bounds than the pair does; state them once"
            )
        if (low == np.inf).any() or (high == -np.inf).any():
            raise UnsupportedModel(f"{side} keeps a variable beyond the largest double; write it in other units")
        if (low > high).any():
            raise UnsupportedModel(f"{side} has a lower bound above its upper bound")
        self.lower[columns], self.upper[columns] = low, high

    def _pair_slack(self, pair: Complements, first: Function, second: Function) -> None:
        """S ≥ 0 ⟂ F ≥ 0 without a variable side: a new unknown s = S, s ≥ 0 ⟂ F ≥ 0."""
        size = first.offset.size
        columns = np.arange(self.count, self.count + size)
        minus = sp.csr_array((np.full(size, -1.0), (np.arange(size), columns)), shape=(size, self.count + size))
        matrix = sp.csr_array(first.over(self.count + size) + minus)
        self.equations.append(replace(first, matrix=matrix, slacks=columns))
        self.count += size
        self.lower, self.upper = np.append(self.lower, np.zeros(size)), np.append(self.upper, np.full(size, np.inf))
        self.is_paired = np.append(self.is_paired, np.ones(size, dtype=bool))
        self._keep_pair(pair, (pair.first, pair.second), columns, second, np.ones(size))

    def finished(self) -> Model:
        """Put definitions in, match the equations left with the unknowns left, and put everything in its place."""
        functions = [*(function for _, function, _ in self.pairs), *self.equations]
        if any(function.nodes for function in functions):
            return nonlinear_model(self)
        pairs = self.affine(functions[: len(self.pairs)])
        equations = self.affine(self.equations)
        before = (pairs.matrix, equations.matrix)
        free = np.flatnonzero(~self.is_paired)
        self.check_square(free, equations.offset.size)
        self.drop_implied_bounds(free)
        elimination, left, pairs = eliminate_definitions(equations, pairs, ~self.is_paired, self._variable_of())
        kept = elimination.kept
        place = np.zeros(self.count, dtype=np.int64)
        place[kept] = np.arange(kept.size)
        columns = place[np.concatenate([*(columns for columns, _, _ in self.pairs), np.zeros(0, dtype=np.int64)])]
        sign = np.concatenate([*(sign for _, _, sign in self.pairs), np.zeros(0)])
        free = np.flatnonzero(~self.is_paired[kept])
        if free.size:
            signed = sp.csr_array(sp.diags_array(sign) @ pairs.matrix)
            order, turned = matched_for_monotony(left.matrix, signed, columns, free)
            free = free[order]
            matrix = sp.csr_array(sp.vstack([pairs.matrix, left.matrix], format="csr"))
            pairs = Affine(matrix, np.append(pairs.offset, left.offset), order)
            columns, sign = np.concatenate([columns, free]), np.concatenate([sign, turned])
        self.report_equations(elimination, kept[free])
        M, q = pairs.matrix, pairs.offset  # the user's own matrix, without a copy, where nothing moves
        if (sign != 1.0).any():
            M, q = sp.csr_array(sp.diags_array(sign) @ M), sign * q
        place = np.argsort(columns, kind="stable")
        if not np.array_equal(columns, np.arange(kept.size)):
            M, q = sp.csr_array(M[place]), q[place]
        problem = LCP(M, q, lower=self.lower[kept], upper=self.upper[kept])
        sources = self.sources(before, place, sign[place])
        return Model(problem, self.variables, self.offsets, self.reports, elimination, sources)

    def sources(
        self, matrices: tuple[sp.csr_array, sp.csr_array], places: NDArray[np.int64], signs: FloatVector
    ) -> Sources:
        """Return where the rows come from: those of the pairs, then the equations."""
        functions = [*(function for _, function, _ in self.pairs), *self.equations]
        expressions = [function.expression for function in functions]
        slacks = {k: function.slacks for k, function in enumerate(functions) if function.slacks is not None}
        return Sources(expressions, matrices, places, signs, self.bounds, slacks)

    def _variable_of(self) -> NDArray[np.int64]:
        """Return the variable that each unknown is an entry of; the slacks count as one more."""
        sizes = [variable.size for variable in self.variables]
        sizes.append(self.count - sum(sizes))
        return np.repeat(np.arange(len(sizes)), sizes).astype(np.int64)

    def affine(self, functions: list[Function]) -> Affine:
        """Return all rows over all unknowns, each with the number of its function; a single block as it is."""
        blocks = [function.over(self.count) for function in functions] or [sp.csr_array((0, self.count))]
        matrix = blocks[0] if len(blocks) == 1 else sp.csr_array(sp.vstack(blocks, format="csr"))
        offset = np.concatenate([*(function.offset for function in functions), np.zeros(0)])
        return Affine(matrix, offset, np.repeat(np.arange(len(functions)), [one.offset.size for one in functions]))

    def report_equations(self, elimination: Elimination, matched: NDArray[np.int64]) -> None:
        """Report for each equation the unknown that it defined or was matched with."""
        ends = np.cumsum([function.offset.size for function in self.equations]).tolist()
        columns = np.full(ends[-1] if ends else 0, -1, dtype=np.int64)
        columns[elimination.rows] = elimination.columns
        columns[columns < 0] = matched
        for function, end in zip(self.equations, ends, strict=True):
            if function.constraint is not None:
                part = columns[end - function.offset.size : end]
                self.reports.append(Report(function.constraint, part, function.shape, False))

    def drop_implied_bounds(self, free: NDArray[np.int64]) -> None:
        """Forget the bounds of unknowns that go with an equation where the model implies them; raise where not."""
        bounded = free[np.isfinite(self.lower[free]) | np.isfinite(self.upper[free])]
        if not bounded.size:
            return
        affine = [pair for pair in self.pairs if not pair[1].nodes]
        columns = np.concatenate([*(columns for columns, _, _ in affine), np.zeros(0, dtype=np.int64)])
        has_low, has_high = np.isfinite(self.lower[columns]), np.isfinite(self.upper[columns])
        # What has both bounds, or none, leaves the sign of its function open.
        signs = np.concatenate([*(sign for _, _, sign in affine), np.zeros(0)])
        signs = np.where(has_low == has_high, np.nan, signs * np.where(has_low, 1.0, -1.0))
        equations = [function for function in self.equations if not function.nodes]
        rows = self.affine([*(function for _, function, _ in affine), *equations])
        signs = np.append(signs, np.zeros(rows.offset.size - signs.size))
        low, high, rounding = known_ranges(rows, signs, self.lower, self.upper, self.is_paired)
        wrong = bounded[((low > self.upper + rounding) | (high < self.lower - rounding))[bounded]]
        if wrong.size:
            raise UnsupportedModel(
                f"equations and pairs keep {self._entry(wrong[0])} outside its bounds, {self.lower[wrong[0]]:g} and "
                f"{self.upper[wrong[0]]:g}: no point satisfies the model; correct one of them"
            )
        is_implied = (low >= self.lower - rounding) & (high <= self.upper + rounding)
        left = bounded[~is_implied[bounded]]
        if left.size:
            entry = self._entry(left[0])
            raise UnsupportedModel(
                f"{entry} has bounds that the rest of the model does not imply, and no pair says what gives way at "
                f"them; drop them, or make it the variable of a pair, as in complements({entry}, F)"
            )
        self.lower[bounded], self.upper[bounded] = -np.inf, np.inf

    def _entry(self, column: np.int64) -> str:
        """Return how the unknown is written: h[2]."""
        variable = next(one for one in reversed(self.variables) if self.offsets[one.id] <= column)
        place = np.unravel_index(column - self.offsets[variable.id], variable.shape, order="F")
        return f"{variable.name()}[{', '.join(map(str, place))}]" if place else str(variable.name())

    def check_square(self, free: NDArray[np.int64], equations: int) -> None:
        """Raise where there are not as many equations as unknowns without a pair."""
        if free.size == equations:
            return
        names = [
            variable.name()
            for variable in self.variables
            if not self.is_paired[self.offsets[variable.id] : self.offsets[variable.id] + variable.size].all()
        ]
        of_pairs = sum(function.slacks.size for function in self.equations if function.slacks is not None)
        counted = f", {of_pairs} of them from pairs of two expressions" if of_pairs else ""
        raise UnsupportedModel(
            f"the model has {free.size} unknowns without a complementarity ({', '.join(names) or 'none'}) and "
            f"{equations} equations{counted}; it needs as many equations as such unknowns"
        )


def _single_columns(function: Function) -> Single | None:
    """Return (column, coefficient) of each row where every row is one distinct unknown, else None."""
    if function.nodes:
        return None
    matrix = function.matrix
    is_single = is_definition(matrix) and bool((matrix.data != 0.0).all())
    return (matrix.indices.astype(np.int64), matrix.data) if is_single else None


def _states_bounds(side: Side) -> bool:
    """Return whether some variable below the side has bounds, be they infinite."""
    names = ("nonneg", "nonpos", "pos", "neg", "bounds")
    return any(variable.attributes.get(name) for variable in side.expression.variables() for name in names)


def pair_residual(pair: Complements) -> FloatVector | None:
    """Return the natural residual of each row of a pair at the present values; None where one is missing."""
    with np.errstate(all="ignore"):  # outside of a domain
        values = [side.expression.value for side in (pair.first, pair.second)]
    if any(value is None for value in values):
        return None
    builder = Builder([pair], {})
    builder.add_pair(pair)
    if builder.equations:
        return np.abs(np.minimum(*(np.ravel(value, order="F") for value in values)))
    (columns, function, sign), = builder.pairs
    z = np.concatenate([np.ravel(variable.value, order="F") for variable in builder.variables])
    if function.nodes:
        value = values[function.expression is pair.second.expression]
        w = sign * np.ravel(value, order="F")
    else:
        w = sign * (function.matrix @ z + function.offset)
    x, low, high = z[columns], builder.lower[columns], builder.upper[columns]
    residual: FloatVector = np.abs(np.minimum(np.maximum(w, x - high), x - low))
    return residual
