"""Collects what a list of complementarities and equalities says: unknowns, bounds, rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..errors import UnsupportedModel
from ..problem.lcp import LCP
from .compiled_model import Model, Report
from .constraint import Complements, Side, attribute_bounds, bounds_of
from .elimination import Affine, Elimination, eliminate_definitions, is_definition
from .extract import AffineMap, affine_map
from .implied_bounds import KnownRanges
from .matching import matched_for_monotony

PLAIN, NO_VARIABLE = 4, 9  # ranks of a side: the last that is an inequality of variables; no variable at all


@dataclass(eq=False)
class _Rows:
    """Rows of the function that belong to the columns of some unknowns."""

    columns: NDArray[np.int64]
    function: AffineMap
    sign: FloatVector


class Builder:
    """Collects unknowns, bounds and rows of one list of constraints."""

    def __init__(self, constraints: list[Any], memo: dict[Any, Any]) -> None:
        self.memo = memo
        self.variables = _variables(constraints)
        self.offsets: dict[int, int] = {}
        self.count = 0
        for variable in self.variables:
            self.offsets[variable.id] = self.count
            self.count += variable.size
        self.width = self.count
        bounds = [attribute_bounds(variable) for variable in self.variables]
        self.lower = self._stacked([low for low, _ in bounds])
        self.upper = self._stacked([high for _, high in bounds])
        self.is_paired = np.zeros(self.count, dtype=bool)
        self.rows: list[_Rows] = []
        self.equations: list[tuple[AffineMap, Any]] = []
        self.slacks: list[tuple[AffineMap, int]] = []
        self.reports: list[Report] = []
        self.is_defined = np.zeros(self.count, dtype=bool)
        #: Sides that are one unknown each and whose sign the pair knows: columns, weights, offset, sign.
        self.signed: list[tuple[NDArray[np.int64], FloatVector, FloatVector, FloatVector]] = []
        #: Variables that are paired as if they had bounds, and have none.
        self.unbounded: list[Side] = []

    def add_equation(self, constraint: Any) -> None:
        """Take in one equality, before the pairs: what it defines is better not the variable of a pair."""
        # Always the same expression object, so that the memo knows it again.
        function = affine_map(constraint.expr, memo=self.memo)
        self.equations.append((function, constraint))
        for variable, block in function.blocks.items():
            if is_definition(block):
                self.is_defined[self.offsets[variable] + block.indices] = True

    def _stacked(self, bounds: list[Any]) -> FloatVector:
        parts = [
            np.ravel(np.broadcast_to(bound, variable.shape), order="F")
            for bound, variable in zip(bounds, self.variables, strict=True)
        ]
        return np.concatenate([*parts, np.zeros(0)]).astype(np.float64)

    def add_pair(self, pair: Complements) -> None:
        """Take in one complementarity: find the side that is a variable, or make one of the other's value."""
        sides = (pair.first, pair.second)
        maps = [affine_map(side.expression, memo=self.memo) for side in sides]
        singles = [self._single_columns(given) for given in maps]
        ranks = [self._rank(sides[k], sides[1 - k], singles[k]) for k in (0, 1)]
        k = 0 if ranks[0] <= ranks[1] else 1
        if max(ranks) <= PLAIN and self._is_defined(singles[k]) and not self._is_defined(singles[1 - k]):
            k = 1 - k
        single = singles[k]
        if ranks[k] == NO_VARIABLE or single is None:
            if {side.kind for side in sides} == {"nonnegative"} and singles == [None, None]:
                self._pair_slack(pair, maps)
                return
            raise UnsupportedModel(
                f"one side of {pair!r} must be a variable, or distinct entries of variables that no other pair holds"
            )
        self._pair_variable(pair, sides[k], maps[k], sides[1 - k], maps[1 - k], *single)

    def _is_defined(self, single: tuple[NDArray[np.int64], FloatVector] | None) -> bool:
        return single is not None and bool(self.is_defined[single[0]].all())

    def _rank(self, side: Side, other: Side, single: tuple[NDArray[np.int64], FloatVector] | None) -> int:
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

    def _single_columns(self, given: AffineMap) -> tuple[NDArray[np.int64], FloatVector] | None:
        """Return (column, coefficient) of each row where every row is one distinct unknown, else None."""
        size = int(given.offset.size)
        columns = np.full(size, -1, dtype=np.int64)
        weights = np.zeros(size)
        for variable, block in given.blocks.items():
            counts = np.diff(block.indptr)
            rows = np.flatnonzero(counts)
            if (counts > 1).any() or (columns[rows] >= 0).any():
                return None
            columns[rows] = self.offsets[variable] + block.indices
            weights[rows] = block.data
        if (columns < 0).any() or (weights == 0.0).any() or np.bincount(columns, minlength=1).max() > 1:
            return None
        return columns, weights

    def _pair_variable(
        self, pair: Complements, side: Side, own: AffineMap, other: Side, function: AffineMap,
        columns: NDArray[np.int64], weights: FloatVector,
    ) -> None:
        positive = weights > 0.0
        low, high = (np.ravel(bound, order="F") for bound in bounds_of(side))
        if side.kind in ("nonnegative", "box"):
            low, high = (low - own.offset) / weights, (high - own.offset) / weights
            low, high = np.where(positive, low, high), np.where(positive, high, low)
            self._tighten(side, columns, low, high)
        low, high = self.lower[columns], self.upper[columns]
        sign = np.where(positive, 1.0, -1.0)
        if other.kind == "nonnegative" and side.kind != "nonnegative":
            sign = self._sign_of_inequality(pair, low, high)
        elif other.kind == "value" and side.kind == "nonnegative":
            sign = np.ones(columns.size)  # F ≥ 0 at a lower bound, F ≤ 0 at an upper one
        if other.kind == "zero" and (np.isfinite(low) | np.isfinite(high)).any():
            raise UnsupportedModel(f"{pair!r} pairs an equality with a bounded variable; pair it with a free one")
        self.is_paired[columns] = True
        self.rows.append(_Rows(columns, function, sign))
        has_low, has_high = np.isfinite(low), np.isfinite(high)
        opposite = self._single_columns(function)
        if opposite is not None:
            known = np.where(has_low & ~has_high, sign, np.where(has_high & ~has_low, -sign, 0.0))
            self.signed.append((*opposite, function.offset, known))
        if side.kind == other.kind == "value" and not (has_low | has_high).any() and not _states_bounds(side):
            self.unbounded.append(side)
        shape = side.expression.shape
        self.reports.append(Report(pair, columns, shape, True, sign))
        if side.constraint is not None:
            self.reports.append(Report(side.constraint, columns, shape, True, sign))
        if other.constraint is not None:
            self.reports.append(Report(other.constraint, columns, shape, False, weights, own.offset))

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
        if (low > high).any():
            raise UnsupportedModel(f"{side} has a lower bound above its upper bound")
        self.lower[columns], self.upper[columns] = low, high

    def _pair_slack(self, pair: Complements, maps: list[AffineMap]) -> None:
        """S ≥ 0 ⟂ F ≥ 0 without a variable side: a new unknown s = S, s ≥ 0 ⟂ F ≥ 0."""
        size = int(maps[0].offset.size)
        columns = np.arange(self.count, self.count + size)
        self.count += size
        self.lower = np.concatenate([self.lower, np.zeros(size)])
        self.upper = np.concatenate([self.upper, np.full(size, np.inf)])
        self.is_paired = np.concatenate([self.is_paired, np.ones(size, dtype=bool)])
        ones = np.ones(size)
        self.rows.append(_Rows(columns, maps[1], ones))
        self.slacks.append((maps[0], int(columns[0]) if size else self.count))
        shape = pair.first.expression.shape
        for constraint, is_slack in ((pair, True), (pair.first.constraint, True), (pair.second.constraint, False)):
            self.reports.append(Report(constraint, columns, shape, is_slack))

    def finished(self) -> Model:
        """Put definitions in, match the equations left with the unknowns left, and put everything in its place."""
        blocks, offsets, owners = self._equations()
        count = sum(block.shape[0] for block in blocks)
        free = np.flatnonzero(~self.is_paired)
        self._check_square(free, count)
        columns, signs = [rows.columns for rows in self.rows], [rows.sign for rows in self.rows]
        functions = [self.matrix(rows.function) for rows in self.rows], [rows.function.offset for rows in self.rows]
        if not count:
            return self._assembled(*functions, columns, signs, None)
        owner = np.repeat(np.arange(len(owners)), [size for _, size, _ in owners])
        equations, pairs = _stacked(blocks, offsets, owner, self.count), _stacked(*functions, None, self.count)
        self._drop_implied_bounds(free, equations)
        found = eliminate_definitions(equations, pairs, ~self.is_paired, self._variable_of())
        elimination, left, pairs = (None, equations, pairs) if found is None else found
        kept = np.arange(self.count) if elimination is None else elimination.kept
        free = np.flatnonzero(~self.is_paired[kept])
        place = np.zeros(self.count, dtype=np.int64)
        place[kept] = np.arange(kept.size)
        columns = [place[own] for own in columns]
        sign = np.concatenate([*signs, np.zeros(0)])
        paired = np.concatenate([*columns, np.zeros(0, dtype=np.int64)])
        order, turned = free, np.zeros(0)
        if free.size:
            signed = sp.csr_array(sp.diags_array(sign) @ pairs.matrix)
            order, turned = matched_for_monotony(left.matrix, signed, paired, free)
        self._report_equations(owners, _columns_of(count, elimination, kept[free[order]]))
        return self._assembled(
            [pairs.matrix, left.matrix], [pairs.offset, left.offset], [*columns, free[order]], [*signs, turned],
            elimination,
        )

    def _assembled(
        self, blocks: list[Any], offsets: list[Any], columns: list[Any], signs: list[Any],
        elimination: Elimination | None,
    ) -> Model:
        kept = np.arange(self.count) if elimination is None else elimination.kept
        if len(blocks) == 1 and np.array_equal(columns[0], np.arange(self.count)) and (signs[0] == 1.0).all():
            M, q = blocks[0], offsets[0]  # the user's own matrix, without a copy
        else:
            place = np.argsort(np.concatenate([*columns, np.zeros(0, dtype=np.int64)]), kind="stable")
            sign = np.concatenate([*signs, np.zeros(0)])
            stacked = sp.csr_array(sp.vstack(blocks, format="csr")) if blocks else sp.csr_array((0, 0))
            if (sign != 1.0).any():
                stacked = sp.csr_array(sp.diags_array(sign) @ stacked)
            M, q = sp.csr_array(stacked[place]), (sign * np.concatenate([*offsets, np.zeros(0)]))[place]
        problem = LCP(M, q, lower=self.lower[kept], upper=self.upper[kept])
        return Model(problem, self.variables, self.offsets, self.reports, elimination)

    def _variable_of(self) -> NDArray[np.int64]:
        """Return the variable that each unknown is an entry of; the slacks count as one more."""
        sizes = [*(variable.size for variable in self.variables), self.count - self.width]
        return np.repeat(np.arange(len(sizes)), sizes).astype(np.int64)

    def matrix(self, function: AffineMap) -> sp.csr_array:
        """Return the rows of an affine map over all unknowns."""
        size = int(function.offset.size)
        if len(function.blocks) == 1 and len(self.variables) == 1 and self.count == self.width:
            return next(iter(function.blocks.values()))
        parts: list[Any] = [
            function.blocks.get(variable.id, sp.csr_array((size, variable.size))) for variable in self.variables
        ]
        if self.count > self.width:
            parts.append(sp.csr_array((size, self.count - self.width)))
        return sp.csr_array(sp.hstack(parts, format="csr")) if parts else sp.csr_array((size, 0))

    def _equations(self) -> tuple[list[Any], list[Any], list[Any]]:
        blocks, offsets, owners = [], [], []
        for function, constraint in self.equations:
            blocks.append(self.matrix(function))
            offsets.append(function.offset)
            owners.append((constraint, function.offset.size, function.shape))
        for function, first in self.slacks:
            size = function.offset.size
            place = (np.arange(size), np.arange(first, first + size))
            slack = sp.csr_array((-np.ones(size), place), shape=(size, self.count))
            blocks.append(sp.csr_array(self.matrix(function) + slack))
            offsets.append(function.offset)
            owners.append((None, size, function.shape))
        return blocks, offsets, owners

    def _report_equations(self, owners: list[Any], columns: NDArray[np.int64]) -> None:
        first = 0
        for constraint, size, shape in owners:
            if constraint is not None:
                part = columns[first : first + size]
                self.reports.append(Report(constraint, part, shape, False))
            first += size

    def _drop_implied_bounds(self, free: NDArray[np.int64], equations: Affine) -> None:
        """Forget the bounds of unknowns that go with an equation where the model implies them; raise where not."""
        bounded = free[np.isfinite(self.lower[free]) | np.isfinite(self.upper[free])]
        if not bounded.size:
            return
        known = KnownRanges(self.count)
        with np.errstate(all="ignore"):
            for signed in self.signed:
                known.of_signed(*signed)
            known.of_equations(equations.matrix, equations.offset, self.lower, self.upper, self.is_paired)
        wrong = bounded[known.contradict(self.lower, self.upper)[bounded]]
        if wrong.size:
            raise UnsupportedModel(
                f"equations and pairs keep {self._entry(wrong[0])} outside its bounds, {self.lower[wrong[0]]:g} and "
                f"{self.upper[wrong[0]]:g}: no point satisfies the model; correct one of them"
            )
        left = bounded[~known.imply(self.lower, self.upper)[bounded]]
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

    def _check_square(self, free: NDArray[np.int64], equations: int) -> None:
        if free.size == equations:
            return
        names = [
            variable.name()
            for variable in self.variables
            if not self.is_paired[self.offsets[variable.id] : self.offsets[variable.id] + variable.size].all()
        ]
        raise UnsupportedModel(
            f"the model has {free.size} unknowns without a complementarity ({', '.join(names) or 'none'}) and "
            f"{equations} equations; it needs as many equations as such unknowns"
        )


def _stacked(blocks: list[Any], offsets: list[Any], owner: NDArray[np.int64] | None, width: int) -> Affine:
    matrix = sp.csr_array(sp.vstack(blocks, format="csr")) if blocks else sp.csr_array((0, width))
    offset = np.concatenate([*offsets, np.zeros(0)])
    return Affine(matrix, offset, np.zeros(offset.size, dtype=np.int64) if owner is None else owner)


def _columns_of(count: int, elimination: Elimination | None, matched: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each equation the unknown that it defined or was matched with."""
    if elimination is None:
        return matched
    columns = np.full(count, -1, dtype=np.int64)
    columns[elimination.rows] = elimination.columns
    columns[columns < 0] = matched
    return columns


def _states_bounds(side: Side) -> bool:
    """Return whether some variable below the side has bounds, be they infinite."""
    names = ("nonneg", "nonpos", "pos", "neg", "bounds")
    return any(variable.attributes.get(name) for variable in side.expression.variables() for name in names)


def _variables(constraints: list[Any]) -> list[Any]:
    """Return the variables of the constraints in the order of their first appearance."""
    seen: dict[int, Any] = {}
    for constraint in constraints:
        for variable in constraint.variables():
            seen.setdefault(variable.id, variable)
    return list(seen.values())
