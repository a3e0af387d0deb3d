"""Collects what a list of complementarities and equalities says: unknowns, bounds, rows; and the way back."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import ModelWarning, UnsupportedModel
from ._compat import attribute_bounds, attribute_expressions, bound_value, by_columns
from .assembly import Assembly, PairedRows
from .cones import ConePair, over_cones
from .equations import Elimination
from .expressions.rows import as_matrix, is_definition
from .model import BoundSource, DualReport, Model, Sources
from .reading import Reader

if TYPE_CHECKING:
    from .constraint import Complements, Side

Single = tuple[NDArray[np.int64], FloatVector]

PLAIN, NO_VARIABLE = (
    4,
    9,
)  # ranks of a side: the last that is an inequality of variables; no variable at all


class Builder(Assembly):
    """Collects unknowns, bounds and rows of one list of constraints."""

    def __init__(
        self, constraints: list[Any], memo: dict[Any, Any], *, takes_integers: bool = False
    ) -> None:
        self.reader = Reader(memo, takes_integers=takes_integers)
        self.variables = list(
            {v.id: v for constraint in constraints for v in constraint.variables()}.values()
        )
        ends = np.cumsum([0, *(variable.size for variable in self.variables)]).tolist()
        self.offsets: dict[int, int] = {
            v.id: start for v, start in zip(self.variables, ends, strict=False)
        }
        bounds = [
            [
                np.ravel(np.broadcast_to(bound, variable.shape), order="F")
                for bound in attribute_bounds(variable)
            ]
            for variable in self.variables
        ]
        lower, upper = (
            np.concatenate([*(pair[k] for pair in bounds), np.zeros(0)]).astype(np.float64)
            for k in (0, 1)
        )
        super().__init__(
            self.reader.compiler, dict(self.offsets), lower, upper
        )  # of slacks, too, later
        self.is_defined = np.zeros(self.count, dtype=bool)
        self.reports: list[DualReport] = []
        self.bounds: list[BoundSource] = []
        for variable in self.variables:
            if (stated := attribute_expressions(variable)) is not None:
                columns = self.offsets[variable.id] + np.arange(variable.size)
                self.bounds.append(BoundSource(columns, np.ones(variable.size), variable, *stated))
        self.cones: list[ConePair] = []
        self.friction: list[tuple[Any, int]] = []
        #: Variables that are paired as if they had bounds, and have none.
        self.remarks: list[str] = []

    def add_equation(self, constraint: Any) -> None:
        """Take in one equality, before the pairs: what it defines is better not the variable of a pair."""
        # Always the same expression object, so that the memo knows it again.
        rows = self.reader.rows(constraint.expr)
        self.equations.append(PairedRows(constraint.expr, rows, constraint))
        for key, block in rows.blocks.items():
            if key in self.offsets and is_definition(as_matrix(block, rows.size)):
                self.is_defined[self.offsets[key] + as_matrix(block, rows.size).indices] = True

    def add_pair(self, pair: Complements) -> None:
        """Take in one complementarity: find the side that is a variable, or make one of the other's value."""
        sides = (pair.first, pair.second)
        functions = [
            PairedRows(side.expression, self.reader.rows(side.expression)) for side in sides
        ]
        if "cone" in (pair.first.kind, pair.second.kind):
            self._pair_cones(pair, sides, functions)
            return
        singles = [self._single_columns(function) for function in functions]
        ranks = [self._rank(sides[k], sides[1 - k], singles[k]) for k in (0, 1)]
        k = 0 if ranks[0] <= ranks[1] else 1
        if (
            max(ranks) <= PLAIN
            and self._is_defined(singles[k])
            and not self._is_defined(singles[1 - k])
        ):
            k = 1 - k
        single = singles[k]
        if ranks[k] != NO_VARIABLE and single is not None:
            self._pair_variable(
                pair, sides[k], functions[k], sides[1 - k], functions[1 - k], *single
            )
        elif {side.kind for side in sides} == {"nonnegative"} and singles == [None, None]:
            self._pair_slack(pair, *functions)
        else:
            raise UnsupportedModel(
                f"one side of {pair!r} must be a variable, or distinct entries of variables that no other pair holds; "
                "give it a variable of its own: y == side in the list, and y in its place in the pair"
            )

    def _single_columns(self, function: PairedRows) -> Single | None:
        """Return (column, coefficient) of each row where every row is one distinct unknown, else None."""
        rows = function.rows
        if rows.level or rows.terms != rows.size:
            return None
        matrix = self.affine([function]).matrix
        is_single = is_definition(matrix) and bool((matrix.data != 0.0).all())
        return (matrix.indices.astype(np.int64), matrix.data) if is_single else None

    def _is_defined(self, single: Single | None) -> bool:
        return single is not None and bool(self.is_defined[single[0]].all())

    def _rank(self, side: Side, other: Side, single: Single | None) -> int:
        """Return how naturally this side is the variable: 0 best, NO_VARIABLE not at all."""
        if (
            single is None
            or side.kind == "zero"
            or other.kind == "box"
            or self.is_paired[single[0]].any()
        ):
            return NO_VARIABLE
        columns, weights = single
        is_bounded = bool(
            (np.isfinite(self.lower[columns]) | np.isfinite(self.upper[columns])).any()
        )
        return preference(side, is_bounded, bool((weights == 1.0).all()))

    def _pair_variable(
        self,
        pair: Complements,
        side: Side,
        own: PairedRows,
        other: Side,
        function: PairedRows,
        columns: NDArray[np.int64],
        weights: FloatVector,
    ) -> None:
        positive = weights > 0.0
        low, high = (np.ravel(bound, order="F") for bound in side.bounds())
        if side.kind in ("nonnegative", "box"):
            with np.errstate(over="ignore"):  # beyond every double: no bound, or refused below
                low, high = (low - own.rows.offset) / weights, (high - own.rows.offset) / weights
            low, high = np.where(positive, low, high), np.where(positive, high, low)
            self._tighten(side, columns, low, high)
            stated = (side.lower, side.upper) if side.kind == "box" else (0.0, np.inf)
            self.bounds.append(BoundSource(columns, weights, side.expression, *stated))
        low, high = self.lower[columns], self.upper[columns]
        sign = np.where(positive, 1.0, -1.0)
        if other.kind == "nonnegative" and side.kind != "nonnegative":
            sign = sign_of_inequality(pair, low, high)
        elif other.kind == "value" and side.kind == "nonnegative":
            sign = np.ones(columns.size)  # F ≥ 0 at a lower bound, F ≤ 0 at an upper one
        is_bounded = bool((np.isfinite(low) | np.isfinite(high)).any())
        if other.kind == "zero" and is_bounded:
            self.remarks.append(of_equality_between_bounds(pair, side))
        self.is_paired[columns] = True
        if side.kind == other.kind == "value" and not is_bounded and not states_bounds(side):
            self.remarks.append(of_missing_bounds(side))
        self._keep_pair(
            pair,
            (side, other),
            columns,
            function,
            sign,
            (weights, own.rows.offset, side.expression),
        )

    def _keep_pair(
        self,
        pair: Complements,
        sides: tuple[Side, Side],
        columns: NDArray[np.int64],
        function: PairedRows,
        sign: FloatVector,
        value: tuple[Any, Any, Any] = (1.0, 0.0, None),
    ) -> None:
        """Keep that w = sign · function goes with the columns; value says what the first side is of its unknown."""
        self.pairs.append((columns, function, sign))
        shape = pair.first.expression.shape
        for constraint, is_slack in (
            (pair, True),
            (sides[0].constraint, True),
            (sides[1].constraint, False),
        ):
            if constraint is not None:
                how = (sign, 0.0, None) if is_slack else value
                own = (
                    (columns.size,) if isinstance(constraint, cp.SOC) else shape
                )  # cvxpy reads it cone by cone
                self.reports.append(DualReport(constraint, columns, own, is_slack, *how))

    def _tighten(
        self, side: Side, columns: NDArray[np.int64], low: FloatVector, high: FloatVector
    ) -> None:
        """Set the bounds of the columns; the attributes of a variable may repeat them, not contradict them."""
        stated_low, stated_high = self.lower[columns], self.upper[columns]
        contradicts_low = np.isfinite(stated_low) & (stated_low != low)
        contradicts_high = np.isfinite(stated_high) & (stated_high != high)
        if contradicts_low.any() or contradicts_high.any():
            raise UnsupportedModel(
                f"the attributes of a variable in {side} state other bounds than the pair does; state them once"
            )
        if (low == np.inf).any() or (high == -np.inf).any():
            raise UnsupportedModel(
                f"{side} keeps a variable beyond the largest double; write it in other units"
            )
        if (low > high).any():
            raise UnsupportedModel(f"{side} has a lower bound above its upper bound")
        self.lower[columns], self.upper[columns] = low, high

    def _pair_slack(self, pair: Complements, first: PairedRows, second: PairedRows) -> None:
        """S ≥ 0 ⟂ F ≥ 0 without a variable side: a new unknown s = S, s ≥ 0 ⟂ F ≥ 0."""
        columns = self._slacks_of(first, 0.0)
        self._keep_pair(pair, (pair.first, pair.second), columns, second, np.ones(columns.size))

    def _slacks_of(self, function: PairedRows, lower: float) -> NDArray[np.int64]:
        """Return new unknowns s, which an equation makes the rows of the function."""
        size = function.rows.size
        columns = np.arange(self.count, self.count + size)
        key = cp.Variable(size).id
        self.first[key] = self.count
        rows = replace(function.rows, blocks={**function.rows.blocks, key: -1.0})
        self.equations.append(replace(function, rows=rows, slacks=columns))
        self.lower, self.upper = (
            np.append(self.lower, np.full(size, lower)),
            np.append(self.upper, [np.inf] * size),
        )
        self.is_paired = np.append(self.is_paired, np.ones(size, dtype=bool))
        return columns

    def _pair_cones(
        self, pair: Complements, sides: tuple[Side, Side], functions: list[PairedRows]
    ) -> None:
        """K ∋ S ⟂ F ∈ K*: the unknowns are the side that is entries of variables, or new ones."""
        for side, function in zip(sides, functions, strict=True):
            if function.rows.level:
                raise UnsupportedModel(
                    f"{side} must be affine, as it is paired with a cone; give it a variable, or write it by affine "
                    "expressions"
                )
        k = next(number for number in (0, 1) if sides[number].kind == "cone")
        cone = sides[k]
        entries = [self._entries(function) for function in functions]
        if entries[k] is None and cone.friction is None and entries[1 - k] is not None:
            k = 1 - k
        columns = entries[k]
        if columns is None:
            columns = self._slacks_of(functions[k], -np.inf)
        else:
            self._drop_cone_bounds(sides[k], columns.reshape(-1, cone.rows))
            self.is_paired[columns] = True
        self._keep_pair(
            pair, (sides[k], sides[1 - k]), columns, functions[1 - k], np.ones(columns.size)
        )
        self.cones.append(ConePair(columns, cone.rows, friction_of(cone)))
        if cone.friction is not None:
            self.friction.append((cone.friction, columns.size // cone.rows))

    def _entries(self, function: PairedRows) -> NDArray[np.int64] | None:
        """Return the unknown that each row is, where they are distinct and in no other pair; else None."""
        single = self._single_columns(function)
        if single is None or (single[1] != 1.0).any() or np.any(function.rows.offset):
            return None
        columns = single[0]
        return None if self.is_paired[columns].any() or self._is_defined(single) else columns

    def _drop_cone_bounds(self, side: Side, columns: NDArray[np.int64]) -> None:
        """Forget that t ≥ 0, which the cone says; raise where entries of a cone have other bounds."""
        first = columns[:, 0]
        self.lower[first] = np.where(self.lower[first] == 0.0, -np.inf, self.lower[first])
        if (np.isfinite(self.lower[columns]) | np.isfinite(self.upper[columns])).any():
            raise UnsupportedModel(
                f"{side} holds variables with bounds of their own, and their partner says what gives way at the cone, "
                "not at bounds; drop the bounds, or give them a pair of their own"
            )

    def finished(self) -> Model:
        """Return the problem with the way back: see :meth:`Assembly.arranged`."""
        found = self.arranged()
        problem: Any = found.problem
        if self.cones:
            problem, found = over_cones(found, self.cones, self.names_of)
        self._report_equations(found.elimination, found.matched)
        functions = [*(one for _, one, _ in self.pairs), *self.equations]
        slacks = {k: one.slacks for k, one in enumerate(functions) if one.slacks is not None}
        expressions = [one.expression for one in functions]
        sources = Sources(
            expressions, found.stored, found.places, found.signs, self.bounds, slacks, self.friction
        )
        return Model(
            problem, self.variables, self.offsets, self.reports, found.elimination, sources
        )

    def variable_of(self) -> NDArray[np.int64]:
        """Return the variable that each unknown is an entry of; the slacks count as one more."""
        sizes = [variable.size for variable in self.variables]
        sizes.append(self.count - sum(sizes))
        return np.repeat(np.arange(len(sizes)), sizes).astype(np.int64)

    def _report_equations(self, elimination: Elimination, matched: NDArray[np.int64]) -> None:
        """Report for each equation the unknown that it defined or was matched with."""
        ends = np.cumsum([function.rows.size for function in self.equations]).tolist()
        columns = np.full(ends[-1] if ends else 0, -1, dtype=np.int64)
        columns[elimination.rows] = elimination.columns
        columns[columns < 0] = matched
        for function, end in zip(self.equations, ends, strict=True):
            if function.constraint is not None:
                part = columns[end - function.rows.size : end]
                self.reports.append(
                    DualReport(function.constraint, part, function.rows.shape, False)
                )

    def names_of(self, columns: NDArray[np.int64]) -> list[str]:
        """Return the names of the variables that these unknowns are entries of."""
        is_asked = np.zeros(self.count, dtype=bool)
        is_asked[columns] = True
        return [
            v.name()
            for v in self.variables
            if is_asked[self.offsets[v.id] : self.offsets[v.id] + v.size].any()
        ]

    def entry(self, column: np.int64) -> str:
        """Return how the unknown is written: h[2]."""
        variable = next(one for one in reversed(self.variables) if self.offsets[one.id] <= column)
        return entry_name(variable, int(column) - self.offsets[variable.id])


def friction_of(side: Side) -> FloatVector | None:
    """Return the coefficients of the contacts of a side, None of one without friction."""
    if side.friction is None:
        return None
    return np.array(
        np.broadcast_to(bound_value(side.friction, side), (side.expression.size // side.rows,)),
        float,
    )


def entry_name(variable: Any, k: int) -> str:
    """Return how the entry of a variable is written that comes k-th, column by column: h[2]."""
    place = np.unravel_index(k, variable.shape, order="F")
    return f"{variable.name()}[{', '.join(map(str, place))}]" if place else str(variable.name())


def preference(side: Side, is_bounded: bool, is_plain: bool) -> int:
    """Return how naturally a side whose rows are entries of variables is the one that has bounds, 0 best."""
    if side.kind == "box":
        return 0
    if side.kind == "value":
        is_bare = isinstance(side.expression, cp.Variable)
        return 1 if is_bounded and is_bare else 2 if is_bounded else 5 if is_bare else 6
    # Of two inequalities the plainer one bounds the variable; with its attributes it must not quarrel.
    return 3 if is_plain and not is_bounded else PLAIN


def sign_of_inequality(pair: Complements, low: FloatVector, high: FloatVector) -> FloatVector:
    """Return the sign of w for a stated G ≥ 0: w = G at a lower bound, −G at an upper one; nothing else agrees."""
    has_low, has_high = np.isfinite(low), np.isfinite(high)
    if (has_low == has_high).any():
        raise UnsupportedModel(
            f"{pair!r} states an inequality opposite a variable that has two bounds, or none; give the expression "
            "alone, F instead of F >= 0: it is ≥ 0 at the lower bound and ≤ 0 at the upper one"
        )
    return np.where(has_low, 1.0, -1.0)


def single_entries(
    expression: Any,
) -> tuple[FloatVector, FloatVector, FloatVector, FloatVector] | None:
    """Return (lower, upper, weight, offset) of the entry that each row is, by attributes; None where some are none."""
    builder = Builder([expression], {})
    try:
        function = PairedRows(expression, builder.reader.rows(expression))
    except UnsupportedModel:  # reported where the expression is solved for
        return None
    if (single := builder._single_columns(function)) is None:
        return None
    columns, weights = single
    return (
        builder.lower[columns],
        builder.upper[columns],
        weights,
        np.broadcast_to(function.rows.offset, weights.shape),
    )


def by_rank(pair: Complements) -> list[Side]:
    """Return the sides of a pair, first the one that is more naturally the side with bounds, a variable or not."""

    def rank(side: Side) -> tuple[int, bool]:
        if side.kind in ("box", "zero"):
            return (0 if side.kind == "box" else NO_VARIABLE), False
        if (single := single_entries(side.expression)) is None:
            return (PLAIN if side.kind == "nonnegative" else NO_VARIABLE - 1), True
        is_bounded = any(np.isfinite(bound).any() for bound in single[:2])
        return preference(side, is_bounded, bool((single[2] == 1.0).all())), False

    return sorted((pair.first, pair.second), key=rank)


def bounds_of_rows(side: Side) -> tuple[FloatVector, FloatVector]:
    """Return the bounds of the rows of a side; those of entries of variables are what the attributes say."""
    if side.kind != "value":
        lower, upper = (np.ravel(bound, order="F") for bound in side.bounds())
        return lower, upper
    single = single_entries(side.expression)
    if single is None:
        return np.full(side.expression.size, -np.inf), np.full(side.expression.size, np.inf)
    low, high, weights, offset = single
    ends = weights * low + offset, weights * high + offset
    return np.minimum(*ends), np.maximum(*ends)


def states_bounds(side: Side) -> bool:
    """Return whether some variable below the side has bounds, be they infinite."""
    names = ("nonneg", "nonpos", "pos", "neg", "bounds")
    return any(
        variable.attributes.get(name) for variable in side.expression.variables() for name in names
    )


def pair_residual(pair: Complements) -> FloatVector | None:
    """Return the natural residual of each row of a pair at the present values; None where one is missing."""
    with np.errstate(all="ignore"):  # outside of a domain
        values = {id(side): side.expression.value for side in (pair.first, pair.second)}
    if any(value is None for value in values.values()):
        return None
    if (
        cone := next((side for side in (pair.first, pair.second) if side.kind == "cone"), None)
    ) is not None:
        other = pair.second if cone is pair.first else pair.first
        z, w = (by_columns(values[id(side)]) for side in (cone, other))
        blocks = ConePair(np.arange(z.size), cone.rows, friction_of(cone)).blocks(
            np.eye(z.size), np.zeros(z.size)
        )
        return np.abs(blocks.residual(z, w, np.ones(blocks.slope.size))[0])
    first, second = by_rank(pair)
    low, high = bounds_of_rows(first)
    z, w = (by_columns(values[id(side)]) for side in (first, second))
    if second.kind == "nonnegative" and first.kind != "nonnegative":
        w = np.where(np.isfinite(high) & ~np.isfinite(low), -w, w)
    residual: FloatVector = np.abs(np.minimum(np.maximum(w, z - high), z - low))
    return residual


def of_equality_between_bounds(pair: Complements, side: Side) -> str:
    """Return that the equality of a pair holds between the bounds of its variable alone; refuse an inequality."""
    if side.kind != "value":
        raise UnsupportedModel(
            f"{pair!r} pairs an equality with an inequality; pair it with a variable"
        )
    return (
        f"{pair!r} pairs an equality with a bounded variable: at a bound it need not hold, as in complements(x, F); "
        "write G == 0 in the list, outside the pair, where it always has to"
    )


def of_missing_bounds(side: Side) -> str:
    """Return that a side is paired as if it had bounds, and has none."""
    return (
        f"{side} has no bounds, so that complements({side}, F) means F == 0; declare the variable with nonneg=True, or "
        "write F == 0 if that is what is meant"
    )


def warn(remarks: Sequence[str]) -> None:
    """Warn the caller of a model that can be read, but may mean something else."""
    for remark in remarks:
        warnings.warn(remark, ModelWarning, stacklevel=_level_of_caller())


def _level_of_caller() -> int:
    """Return the stacklevel at which somebody else's code called this package, or cvxpy, which called it."""
    own = {__package__.partition(".")[0], cp.__name__}
    frame, level = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in own:
        frame, level = frame.f_back, level + 1
    return level
