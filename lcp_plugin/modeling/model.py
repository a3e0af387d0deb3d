"""From a list of cvxpy constraints to (M, q, lower, upper), and back to values, duals and a status."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from cvxpy.constraints.zero import Equality, Zero
from numpy.typing import NDArray
from scipy.sparse.csgraph import maximum_bipartite_matching

from ..errors import UnsupportedModel
from ..problem import LCP, FloatVector
from .constraint import Complements, Side, attribute_bounds, bounds_of
from .extract import AffineMap, affine_map


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
        maps = [affine_map(side.expression, memo=self.memo) for side in (pair.first, pair.second)]
        order = (0, 1) if pair.second.kind not in ("box",) and pair.first.kind != "zero" else (1, 0)
        sides = (pair.first, pair.second)
        for k in order:
            if sides[k].kind == "zero" or (sides[1 - k].kind == "box"):
                continue
            single = self._single_columns(maps[k])
            if single is not None and not self.is_paired[single[0]].any():
                self._pair_variable(pair, sides[k], maps[k], sides[1 - k], maps[1 - k], *single)
                return
        for k in order:
            if self._single_columns(maps[k]) is not None and sides[1 - k].kind != "nonnegative":
                raise UnsupportedModel(f"an entry of {sides[k]} is already paired by another constraint; pair it once")
        if {side.kind for side in sides} != {"nonnegative"}:
            raise UnsupportedModel(f"one side of {pair!r} must be a variable or distinct entries of one")
        if any(single is not None for single in map(self._single_columns, maps)):
            raise UnsupportedModel(f"an entry of {pair.first} is already paired by another constraint; pair it once")
        self._pair_slack(pair, maps)

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
        sign = np.where(positive, 1.0, -1.0)
        if other.kind == "zero" and (np.isfinite(self.lower[columns]) | np.isfinite(self.upper[columns])).any():
            raise UnsupportedModel(f"{pair!r} pairs an equality with a bounded variable; pair it with a free one")
        self.is_paired[columns] = True
        self.rows.append(_Rows(columns, function, sign))
        shape = side.expression.shape
        self.reports.append(_Report(pair, columns, shape, True, sign))
        if side.constraint is not None:
            self.reports.append(_Report(side.constraint, columns, shape, True, sign))
        if other.constraint is not None:
            self.reports.append(_Report(other.constraint, columns, shape, False, weights, own.offset))

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
            stacked = sp.csr_array(sp.vstack(equation_blocks, format="csr"))
            order = _matching(stacked[:, free])
            row_blocks.append(stacked)
            offsets.append(np.concatenate(equation_offsets))
            columns.append(free[order])
            signs.append(np.ones(equations))
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


def _matching(block: sp.csr_array) -> NDArray[np.int64]:
    """Return for each equation the unknown it goes with, so that the diagonal has entries where that is possible."""
    pattern = sp.csr_matrix(
        (np.ones(block.nnz), block.indices.astype(np.int32), block.indptr.astype(np.int32)), shape=block.shape
    )
    matched = np.asarray(maximum_bipartite_matching(pattern, perm_type="column"), dtype=np.int64)
    missing = np.flatnonzero(matched < 0)
    matched[missing] = np.setdiff1d(np.arange(block.shape[1]), matched[matched >= 0])
    return matched


def _variables(constraints: list[Any]) -> list[Any]:
    """Return the variables of the constraints in the order of their first appearance."""
    seen: dict[int, Any] = {}
    for constraint in constraints:
        for variable in constraint.variables():
            seen.setdefault(variable.id, variable)
    return list(seen.values())


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
            expression = constraint.args[0] - constraint.args[1] if len(constraint.args) == 2 else constraint.args[0]
            builder.equations.append((affine_map(expression, memo=builder.memo), constraint))
        elif not isinstance(constraint, Complements):
            raise UnsupportedModel(
                f"the constraint {constraint} stands alone beside complementarities; make it part of a pair, as in "
                f"complements({constraint}, F >= 0)"
            )
    return builder.finished()


def stated_in_cvxpy(problem: LCP) -> Any:
    """Return the ComplementarityProblem in one variable z that states an LCP."""
    import cvxpy as cp

    from .constraint import box, complements
    from .registration import ComplementarityProblem

    z = cp.Variable(problem.n, name="z")
    F = problem.csr @ z + problem.q
    return ComplementarityProblem([complements(box(z, problem.lower, problem.upper), F)])


_memos: weakref.WeakKeyDictionary[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()


def build_from(problem: Any) -> Model:
    """Return the model of a cvxpy problem; what depends on no parameter is kept for the next call."""
    if not problem.objective.args[0].is_constant():
        raise UnsupportedModel(
            "a complementarity problem has no objective; write cp.Minimize(0), or state optimality conditions as pairs"
        )
    return build(problem.constraints, _memos.setdefault(problem, {}))
