"""From a list of cvxpy constraints to (M, q, lower, upper), and back to values, duals and a status."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints.zero import Equality, Zero
from numpy.typing import NDArray

from ..errors import UnsupportedModel
from ..problem import LCP, FloatVector
from .constraint import Complements, Side, attribute_bounds, bounds_of
from .extract import AffineMap, affine_map
from .matching import matching

NO_VARIABLE = 9


@dataclass(eq=False)
class _Rows:
    """Rows of the function that belong to the columns of some unknowns."""

    columns: NDArray[np.int64]
    function: AffineMap
    sign: FloatVector


@dataclass(eq=False)
class _Report:
    """What to write back into a constraint's dual variable: scale · (w or z)[columns] + shift."""

    constraint: Any
    columns: NDArray[np.int64]
    shape: tuple[int, ...]
    is_slack: bool
    scale: Any = 1.0
    shift: Any = 0.0

    def value(self, z: FloatVector, w: FloatVector) -> NDArray[np.float64]:
        """Return the dual value in the constraint's own shape."""
        values: FloatVector = self.scale * (w if self.is_slack else z)[self.columns] + self.shift
        return values.reshape(self.shape, order="F")


@dataclass(eq=False)
class Model:
    """An LCP together with the way back to the cvxpy variables and constraints."""

    problem: LCP
    variables: list[Any]
    offsets: dict[int, int]
    reports: list[_Report] = field(repr=False)

    def values(self, z: FloatVector) -> dict[int, Any]:
        """Return the value of each variable by its id, in its own shape."""
        values = {}
        for variable in self.variables:
            start = self.offsets[variable.id]
            values[variable.id] = z[start : start + variable.size].reshape(variable.shape, order="F")
        return values

    def duals(self, z: FloatVector, w: FloatVector) -> list[tuple[Any, Any]]:
        """Return (constraint, dual value): w for what bounds a variable, the variable for what bounds w."""
        return [(report.constraint, report.value(z, w)) for report in self.reports]

    def start(self) -> FloatVector | None:
        """Return the present values of all variables as one vector; None where one has no value."""
        if any(variable.value is None for variable in self.variables):
            return None
        z = np.zeros(self.problem.n)
        for variable in self.variables:
            first = self.offsets[variable.id]
            z[first : first + variable.size] = np.ravel(variable.value, order="F")
        return z


class _Builder:
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
        self.reports: list[_Report] = []

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
        single = singles[k]
        if ranks[k] == NO_VARIABLE or single is None:
            if {side.kind for side in sides} == {"nonnegative"} and singles == [None, None]:
                self._pair_slack(pair, maps)
                return
            raise UnsupportedModel(
                f"one side of {pair!r} must be a variable, or distinct entries of variables that no other pair holds"
            )
        self._pair_variable(pair, sides[k], maps[k], sides[1 - k], maps[1 - k], *single)

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
        shape = side.expression.shape
        self.reports.append(_Report(pair, columns, shape, True, sign))
        if side.constraint is not None:
            self.reports.append(_Report(side.constraint, columns, shape, True, sign))
        if other.constraint is not None:
            self.reports.append(_Report(other.constraint, columns, shape, False, weights, own.offset))

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
            self.reports.append(_Report(constraint, columns, shape, is_slack))

    def finished(self) -> Model:
        """Match the equations with the unknowns left over, and put everything in its place."""
        row_blocks = [self._matrix(rows.function) for rows in self.rows]
        offsets = [rows.function.offset for rows in self.rows]
        columns = [rows.columns for rows in self.rows]
        signs = [rows.sign for rows in self.rows]
        equation_blocks, equation_offsets, owners = self._equations()
        free = np.flatnonzero(~self.is_paired)
        equations = sum(block.shape[0] for block in equation_blocks)
        self._check_square(free, equations)
        if equations:
            self._refuse_bounded(free)
            stacked = sp.csr_array(sp.vstack(equation_blocks, format="csr"))
            order = matching(stacked[:, free])
            row_blocks.append(stacked)
            offsets.append(np.concatenate(equation_offsets))
            columns.append(free[order])
            matched = np.asarray(stacked[np.arange(equations), free[order]]).ravel()
            signs.append(np.where(matched < 0.0, -1.0, 1.0))
            self._report_equations(owners, free[order])
        return self._assembled(row_blocks, offsets, columns, signs)

    def _assembled(self, blocks: list[Any], offsets: list[Any], columns: list[Any], signs: list[Any]) -> Model:
        if len(blocks) == 1 and np.array_equal(columns[0], np.arange(self.count)) and (signs[0] == 1.0).all():
            M, q = blocks[0], offsets[0]  # the user's own matrix, without a copy
        else:
            place = np.argsort(np.concatenate([*columns, np.zeros(0, dtype=np.int64)]), kind="stable")
            sign = np.concatenate([*signs, np.zeros(0)])
            stacked = sp.csr_array(sp.vstack(blocks, format="csr")) if blocks else sp.csr_array((0, 0))
            if (sign != 1.0).any():
                stacked = sp.csr_array(sp.diags_array(sign) @ stacked)
            M, q = sp.csr_array(stacked[place]), (sign * np.concatenate([*offsets, np.zeros(0)]))[place]
        return Model(LCP(M, q, lower=self.lower, upper=self.upper), self.variables, self.offsets, self.reports)

    def _matrix(self, function: AffineMap) -> sp.csr_array:
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
            blocks.append(self._matrix(function))
            offsets.append(function.offset)
            owners.append((constraint, function.offset.size, function.shape))
        for function, first in self.slacks:
            size = function.offset.size
            place = (np.arange(size), np.arange(first, first + size))
            slack = sp.csr_array((-np.ones(size), place), shape=(size, self.count))
            blocks.append(sp.csr_array(self._matrix(function) + slack))
            offsets.append(function.offset)
            owners.append((None, size, function.shape))
        return blocks, offsets, owners

    def _report_equations(self, owners: list[Any], columns: NDArray[np.int64]) -> None:
        first = 0
        for constraint, size, shape in owners:
            if constraint is not None:
                part = columns[first : first + size]
                self.reports.append(_Report(constraint, part, shape, False))
            first += size

    def _refuse_bounded(self, free: NDArray[np.int64]) -> None:
        """Raise where an unknown that goes with an equation has a bound, at which the equation need not hold."""
        bounded = free[np.isfinite(self.lower[free]) | np.isfinite(self.upper[free])]
        if bounded.size:
            name = next(
                variable.name()
                for variable in reversed(self.variables)
                if self.offsets[variable.id] <= bounded[0]
            )
            raise UnsupportedModel(
                f"the variable {name} has bounds but belongs to no pair, only to equations; drop its bounds where a "
                "pair implies them, or pair it"
            )

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


def _variables(constraints: list[Any]) -> list[Any]:
    """Return the variables of the constraints in the order of their first appearance."""
    seen: dict[int, Any] = {}
    for constraint in constraints:
        for variable in constraint.variables():
            seen.setdefault(variable.id, variable)
    return list(seen.values())


def pair_residual(pair: Complements) -> FloatVector | None:
    """Return the natural residual of each row of a pair at the present values; None where one is missing."""
    values = [side.expression.value for side in (pair.first, pair.second)]
    if any(value is None for value in values):
        return None
    builder = _Builder([pair], {})
    builder.add_pair(pair)
    if builder.slacks:
        return np.abs(np.minimum(*(np.ravel(value, order="F") for value in values)))
    rows = builder.rows[-1]
    z = np.concatenate([np.ravel(variable.value, order="F") for variable in builder.variables])
    w = rows.sign * (builder._matrix(rows.function) @ z + rows.function.offset)
    x, low, high = z[rows.columns], builder.lower[rows.columns], builder.upper[rows.columns]
    residual: FloatVector = np.abs(np.minimum(np.maximum(w, x - high), x - low))
    return residual


def build(constraints: list[Any], memo: dict[Any, Any] | None = None) -> Model:
    """Return the LCP that a list of complementarities and equalities states.

    Raises
    ------
    UnsupportedModel
        Naming the constraint or variable that stands in the way, and the remedy.
    """
    builder = _Builder(constraints, {} if memo is None else memo)
    for constraint in constraints:
        if isinstance(constraint, Complements):
            builder.add_pair(constraint)
    for constraint in constraints:
        if isinstance(constraint, (Equality, Zero)):
            # Always the same expression object, so that the memo knows it again.
            builder.equations.append((affine_map(constraint.expr, memo=builder.memo), constraint))
        elif not isinstance(constraint, Complements):
            raise UnsupportedModel(
                f"the constraint {constraint} stands alone beside complementarities; make it part of a pair, as in "
                f"complements({constraint}, F >= 0)"
            )
    return builder.finished()


def stated_in_cvxpy(problem: LCP) -> Any:
    """Return the ComplementarityProblem in one variable z that states an LCP."""
    from .constraint import box, complements
    from .registration import ComplementarityProblem

    if problem.n == 0:  # older versions of cvxpy have no empty variables
        return ComplementarityProblem([])
    z = cp.Variable(problem.n, name="z")
    F = problem.csr @ z + problem.q
    return ComplementarityProblem([complements(box(z, problem.lower, problem.upper), F)])


_memos: weakref.WeakKeyDictionary[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()


def build_from(problem: Any) -> Model:
    """Return the model of a cvxpy problem; what depends on no parameter is kept for the next call."""
    if not isinstance(problem, cp.Problem):
        kind = type(problem).__name__
        raise UnsupportedModel(f"a cvxpy problem is needed, got {kind}; write ComplementarityProblem([…])")
    if not problem.objective.args[0].is_constant():
        raise UnsupportedModel(
            "a complementarity problem has no objective; write cp.Minimize(0), or state optimality conditions as pairs"
        )
    return build(problem.constraints, _memos.setdefault(problem, {}))
