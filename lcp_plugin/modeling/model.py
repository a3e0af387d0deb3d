"""What a list of cvxpy constraints states, and the way back to its variables, dual values and parameters."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from ..core.certificates.row_residuals import magnitude
from ..core.checks import FloatVector
from ..core.errors import ModelWarning, NotSquare, UnsupportedModel
from ..core.lcp import LCP
from ..problems.nonlinear.data import NonlinearProblem
from ._compat import attribute_bounds, attribute_expressions, bound_value, by_columns, name_of
from .cones import ConePair, over_cones
from .expressions.rows import Indices, Rows, as_matrix, is_definition
from .reading import Reader
from .stated_terms import dense_value, values_below
from .statement import SquareModel, Statement

if TYPE_CHECKING:
    from .constraint import Complements, Side

DISAGREEMENT = 1e-9  # of the terms of a row


@dataclass(eq=False)
class DualReport:
    """What to write back into a constraint's dual variable: scale · (w or z)[columns] + shift."""

    constraint: Any
    columns: Indices
    shape: tuple[int, ...]
    is_slack: bool
    scale: Any = 1.0
    shift: Any = 0.0
    expression: Any = None  # whose parameters move the shift

    def value(self, z: FloatVector, w: FloatVector) -> NDArray[np.float64]:
        """Return the dual value in the constraint's own shape."""
        values: FloatVector = self.scale * (w if self.is_slack else z)[self.columns] + self.shift
        return values.reshape(self.shape, order="F")


class Model:
    """Unknowns, rows and pairs of cvxpy constraints, and the way back.

    Parameters
    ----------
    stated : list
        Constraints and expressions whose variables are the unknowns.
    memo : dict, optional
        What no parameter enters, kept from model to model.
    takes_integers : bool
        Whether variables may be whole numbers.
    compiled : CompiledProblem, optional
        Program of other terms that hold the same variables: its unknowns come first.

    Attributes
    ----------
    statement : Statement
    variables : list of cvxpy.Variable
    offsets : dict
        From the id of a variable to the number of its first unknown.
    reports : list of DualReport
    bounds : list of tuple
        Of some unknowns: columns, the expression that is these unknowns plus constants or None, and its bounds as they
        were stated. What comes last holds.
    friction : list of pairs
        Coefficients as they were stated, and of how many contacts they are.
    """

    def __init__(
        self,
        stated: Sequence[Any],
        memo: dict[Any, Any] | None = None,
        *,
        takes_integers: bool = False,
        compiled: Any = None,
    ) -> None:
        self.reader = Reader(memo, takes_integers=takes_integers)
        self.variables = list({v.id: v for one in stated for v in one.variables()}.values())
        self.offsets: dict[int, int] = {} if compiled is None else compiled.starts()
        size = 0 if compiled is None else compiled.program.n
        for variable in self.variables:
            if variable.id not in self.offsets:
                self.offsets[variable.id] = size
                size += variable.size
        #: Bounds that attributes of the variables state.
        self.declared = np.full(size, -np.inf), np.full(size, np.inf)
        for variable in self.variables:
            own = self._span(variable)
            for end, bound in zip(self.declared, attribute_bounds(variable), strict=True):
                end[own] = np.ravel(np.broadcast_to(bound, variable.shape), order="F")
        lower, upper = (end.copy() for end in self.declared)
        if compiled is not None:
            lower[: compiled.program.n] = compiled.program.lower
            upper[: compiled.program.n] = compiled.program.upper
        self.statement = Statement(
            self.reader.compiler, self.offsets, lower, upper, self._name, self._integers()
        )
        self.is_defined = np.zeros(lower.size, dtype=bool)
        self.reports: list[DualReport] = []
        self.cones: list[ConePair] = []
        self.friction: list[tuple[Any, int]] = []
        self.bounds: list[tuple[Indices, Any, Any, Any]] = []
        for variable in self.variables:
            if (ends := attribute_expressions(variable)) is not None:
                columns = np.arange(size)[self._span(variable)]
                self.bounds.append((columns, None, *ends))
        self._equations: list[Any] = []
        self._known: dict[int, tuple[Rows, tuple[Indices, FloatVector] | None]] = {}

    def _span(self, variable: Any) -> slice:
        first = self.offsets[variable.id]
        return slice(first, first + variable.size)

    def _integers(self) -> Indices:
        """Return the unknowns that are whole numbers."""
        found = [np.zeros(0, dtype=np.int64)]
        for one in self.variables:
            for chosen in (one.boolean_idx, one.integer_idx):
                found.append(self.offsets[one.id] + chosen_entries(one, chosen))
        return np.concatenate(found)

    def _name(self, column: int) -> str:
        """Return how an unknown is written: h[2]."""
        for variable in self.variables:
            if 0 <= (k := column - self.offsets[variable.id]) < variable.size:
                place = np.unravel_index(k, variable.shape, order="F")
                entry = f"[{', '.join(map(str, place))}]" if place else ""
                return f"{variable.name()}{entry}"
        return ""

    # --- reading ---

    def add_equations(self, constraints: Sequence[Any]) -> None:
        """Take in equalities, before the pairs: what they define is better not the variable of a pair."""
        for constraint in constraints:
            # Always the same expression object, so that the memo knows it again.
            rows = self.reader.rows(constraint.expr)
            self.statement.constrain(rows, origin=constraint.expr)
            self._equations.append(constraint)
            for key, block in rows.blocks.items():
                if key in self.offsets and is_definition(as_matrix(block, rows.size)):
                    self.is_defined[self.offsets[key] + as_matrix(block, rows.size).indices] = True

    def add_pairs(self, pairs: Sequence[Complements]) -> None:
        """Take in complementarities, first those of which one side alone can be the variable."""
        remarks: list[str] = []
        for pair in sorted(
            pairs, key=lambda pair: len({self._key(pair, k)[:4] for k in (0, 1)}) == 1
        ):
            sides = pair.first, pair.second
            if "cone" in (pair.first.kind, pair.second.kind):
                self._pair_cones(pair, sides)
                continue
            k = self.variable_side(pair)
            remarks += self._pair(pair, sides[k], sides[1 - k])
        for remark in remarks:
            warnings.warn(remark, ModelWarning, stacklevel=_level_of_caller())

    def variable_side(self, pair: Complements) -> int:
        """Return which side of a pair is its variable, 0 or 1: the one with bounds, of two the one that is unknowns."""
        return min((0, 1), key=lambda k: self._key(pair, k))

    def _key(self, pair: Complements, k: int) -> tuple[Any, ...]:
        """Return how little a side is the natural variable of its pair."""
        side = (pair.first, pair.second)[k]
        found = None if side.kind == "zero" else self._entries(side)
        low, high = self.bounds_of(side)
        is_bounded = bool((np.isfinite(low) | np.isfinite(high)).any())
        is_taken = found is not None and bool(self.statement.is_paired[found[0]].any())
        is_defined = found is not None and bool(self.is_defined[found[0]].all())
        is_bare = isinstance(side.expression, cp.Variable)
        return (
            side.kind == "zero",
            side.kind != "box",
            not is_bounded,
            found is None,
            is_taken,
            is_defined,
            not is_bare,
            k,
        )

    def _rows(self, side: Side) -> Rows:
        if (key := id(side.expression)) not in self._known:
            rows = self.reader.rows(side.expression)
            self._known[key] = rows, self.statement.entries(rows)
        return self._known[key][0]

    def _entries(self, side: Side) -> tuple[Indices, FloatVector] | None:
        self._rows(side)
        return self._known[id(side.expression)][1]

    def bounds_of(self, side: Side) -> tuple[FloatVector, FloatVector]:
        """Return the bounds of a side, entry by entry; those of entries of variables are what the attributes say."""
        if (
            side.kind == "value"
            and (found := self._entries(side)) is not None
            and not found[1].any()
        ):
            return self.declared[0][found[0]], self.declared[1][found[0]]
        low, high = (np.ravel(bound, order="F") for bound in side.bounds())
        return low, high

    def _pair(self, pair: Complements, side: Side, other: Side) -> list[str]:
        """Let one side be the unknowns of a pair; return what may be meant otherwise."""
        low, high = self.bounds_of(side)
        if (low == np.inf).any() or (high == -np.inf).any() or (low > high).any():
            raise UnsupportedModel(
                f"{side} has a lower bound above its upper bound, or beyond the largest double"
            )
        is_bounded, remarks = bool((np.isfinite(low) | np.isfinite(high)).any()), []
        if other.kind == "zero" and is_bounded:
            remarks.append(of_equality_between_bounds(pair, side))
        elif side.kind == other.kind == "value" and not is_bounded and not states_bounds(side):
            remarks.append(
                f"{side} has no bounds, so that complements({side}, F) means F == 0; declare the variable with "
                "nonneg=True, or write F == 0 if that is what is meant"
            )
        if side.kind == "value" and not is_bounded and self._entries(side) is None:
            raise UnsupportedModel(
                f"no side of {pair!r} has bounds, so that one must be a variable; give it one of its own: y == side in "
                "the list, and y in its place in the pair"
            )
        sign = np.ones(low.size)
        if other.kind == "nonnegative" and side.kind != "nonnegative":
            sign = sign_of_inequality(pair, low, high)
        columns, shift, expression = self._columns(side)
        stated = (side.lower, side.upper) if side.kind == "box" else (0.0, np.inf)
        if side.kind != "value":
            self.bounds.append((columns, expression, *stated))
        self.statement.complement(
            columns,
            self._rows(other),
            low - shift,
            high - shift,
            sign=sign,
            origin=other.expression,
        )
        self._report(pair, side, other, columns, sign, shift, expression)
        return remarks

    def _columns(self, side: Side) -> tuple[Indices, FloatVector, Any]:
        """Return unknowns that are a side less constants, the constants, and the expression that holds these."""
        if (found := self._entries(side)) is not None and not self.statement.is_paired[
            found[0]
        ].any():
            return *found, side.expression
        rows = self._rows(side)
        return self.statement.named(rows, side.expression), np.zeros(rows.size), None

    def _report(
        self,
        pair: Complements,
        side: Side,
        other: Side,
        columns: Indices,
        sign: Any,
        shift: Any,
        expression: Any,
    ) -> None:
        """Report w in the pair and in what bounds its variable, and the variable in what bounds w."""
        shape = pair.first.expression.shape
        for constraint, value in (
            (pair, (True, sign)),
            (side.constraint, (True, sign)),
            (other.constraint, (False, 1.0, shift, expression)),
        ):
            if constraint is not None:
                # cvxpy reads the dual value of a cone column by column.
                own = (columns.size,) if isinstance(constraint, cp.SOC) else shape
                self.reports.append(DualReport(constraint, columns, own, *value))

    def _pair_cones(self, pair: Complements, sides: tuple[Side, Side]) -> None:
        """K ∋ S ⟂ F ∈ K*: the unknowns are the side that is entries of variables, or new ones."""
        for side in sides:
            if self._rows(side).level:
                raise UnsupportedModel(
                    f"{side} must be affine, as it is paired with a cone; give it a variable, or write it by affine "
                    "expressions"
                )
        k = next(number for number in (0, 1) if sides[number].kind == "cone")
        cone, entries = sides[k], [self._unknowns(side) for side in sides]
        if entries[k] is None and cone.friction is None and entries[1 - k] is not None:
            k = 1 - k
        side, other = sides[k], sides[1 - k]
        columns = entries[k]
        if columns is None:
            columns = self.statement.named(self._rows(side), side.expression)
        else:
            self._drop_cone_bounds(side, columns.reshape(-1, cone.rows))
        rows = self._rows(other)
        self.statement.complement(columns, rows, -np.inf, np.inf, origin=other.expression)
        self._report(pair, side, other, columns, 1.0, 0.0, None)
        self.cones.append(ConePair(columns, cone.rows, friction_of(cone)))
        if cone.friction is not None:
            self.friction.append((cone.friction, columns.size // cone.rows))

    def _unknowns(self, side: Side) -> Indices | None:
        """Return the unknowns of a side that are in no other pair and not defined by equations, else None."""
        found = self._entries(side)
        if found is None or found[1].any():
            return None
        columns = found[0]
        is_free = not self.statement.is_paired[columns].any() and not self.is_defined[columns].all()
        return columns if is_free else None

    def _drop_cone_bounds(self, side: Side, columns: Indices) -> None:
        """Forget that t ≥ 0, which the cone says; raise where entries of a cone have other bounds."""
        first, lower, upper = columns[:, 0], self.statement.lower, self.statement.upper
        lower[first] = np.where(lower[first] == 0.0, -np.inf, lower[first])
        if (np.isfinite(lower[columns]) | np.isfinite(upper[columns])).any():
            raise UnsupportedModel(
                f"{side} holds variables with bounds of their own, and their partner says what gives way at the cone, "
                "not at bounds; drop the bounds, or give them a pair of their own"
            )

    # --- the complementarity problem ---

    @cached_property
    def square(self) -> SquareModel:
        """The complementarity problem; see :meth:`Statement.square`."""
        found = self.statement.square(self._variable_of())
        if self.cones:
            found = over_cones(found, self.cones, self.statement.name_of)
        equations = [one for one in self.statement.rows if one.slacks is None]
        ends = np.cumsum([one.rows.size for one in self.statement.rows]).tolist()
        columns = np.full(ends[-1] if ends else 0, -1, dtype=np.int64)
        columns[found.elimination.rows] = found.elimination.columns
        columns[columns < 0] = found.matched
        parts = np.split(columns, ends[:-1]) if ends else []
        own = [
            part for part, one in zip(parts, self.statement.rows, strict=True) if one.slacks is None
        ]
        for constraint, part, one in zip(self._equations, own, equations, strict=True):
            self.reports.append(DualReport(constraint, part, one.rows.shape, False))
        return found

    def _variable_of(self) -> Indices:
        """Return the variable that each unknown is an entry of; what stands for expressions counts as one more."""
        found = np.full(self.statement.count, len(self.variables), dtype=np.int64)
        for k, variable in enumerate(self.variables):
            found[self._span(variable)] = k
        return found

    @property
    def problem(self) -> Any:
        """The LCP, NonlinearProblem, ConeProblem or FrictionalContact."""
        return self.square.problem

    def lcp(self, purpose: str) -> LCP:
        """Return the LCP; raise where there is none that says all.

        Raises
        ------
        UnsupportedModel
            Saying what the purpose does not take.
        """
        problem = self.problem
        if not isinstance(problem, LCP):
            lacks = (
                "needs affine sides, and this model has nonlinear ones"
                if isinstance(problem, NonlinearProblem)
                else "takes no cones, and this model has some"
            )
            raise UnsupportedModel(f'{purpose} {lacks}; problem.solve(method="LCP") solves it')
        for column in self.square.dropped[:1].tolist():
            entry = self.statement.name_of(column)
            raise UnsupportedModel(
                f"{entry} has bounds that no pair implies, and {purpose} takes none beside pairs; drop them, or make "
                f"it the variable of a pair, as in complements({entry}, F)"
            )
        return problem

    def refuse_violated_bounds(self, z: FloatVector) -> None:
        """Raise NotSquare where a solution violates bounds that no pair states."""
        unknowns, dropped = self.square.elimination.expand(z), self.square.dropped
        for column in dropped[self.statement.is_outside(unknowns, dropped)][:1].tolist():
            entry = self.statement.name_of(column)
            raise NotSquare(
                f"{entry} has bounds that the rest of the model does not imply, and no pair says what gives way at "
                f"them; drop them, or make it the variable of a pair, as in complements({entry}, F)"
            )

    # --- the way back ---

    def values(self, z: FloatVector) -> dict[int, Any]:
        """Return the value of each variable by its id, in its own shape."""
        return self.split(self.square.elimination.expand(z))

    def split(self, unknowns: FloatVector) -> dict[int, Any]:
        """Return what belongs to each variable, by its id and in its shape."""
        return {
            one.id: unknowns[self._span(one)].reshape(one.shape, order="F")
            for one in self.variables
        }

    def duals(self, unknowns: FloatVector, slacks: FloatVector) -> list[tuple[Any, Any]]:
        """Return (constraint, dual value): w for what bounds a variable, the variable for what bounds w."""
        return [(report.constraint, report.value(unknowns, slacks)) for report in self.reports]

    def present(self) -> FloatVector | None:
        """Return the present values of all unknowns; None where a variable has none."""
        if any(variable.value is None for variable in self.variables):
            return None
        z = np.zeros(self.statement.count)
        for variable in self.variables:
            z[self._span(variable)] = by_columns(variable.value)
        with np.errstate(all="ignore"):  # outside of a domain
            for one in self.statement.rows:
                if one.slacks is not None:
                    z[one.slacks] = one.sign * by_columns(one.origin.value)
        return z

    def start(self) -> FloatVector | None:
        """Return the present values of the unknowns of the problem; None where a variable has none."""
        z = self.present()
        return None if z is None else z[self.square.elimination.kept]

    def consistency_error(self, z: FloatVector, w: FloatVector) -> str | None:
        """Return what the expressions themselves, evaluated by cvxpy, say against w, or None.

        Parameters
        ----------
        z, w : array, shape (n,)
            Variables have the values of z.
        """
        square, problem = self.square, self.problem
        stated, elimination = [*self.statement.pairs, *self.statement.rows], square.elimination
        unknowns = elimination.expand(z)
        with np.errstate(all="ignore"):
            found = values_below([one.origin for one in stated])
            values = [np.ravel(dense_value(found[id(one.origin)]), order="F") for one in stated]
        for k, one in enumerate(stated):
            if one.slacks is not None:
                values[k] = values[k] - unknowns[one.slacks]
        theirs = np.concatenate([*values, np.zeros(0)])
        expected, terms = np.zeros((2, theirs.size))
        left = np.delete(np.arange(theirs.size), square.stored[0].shape[0] + elimination.rows)
        left = left[square.places]
        expected[left] = square.signs * w
        if isinstance(problem, NonlinearProblem):
            terms[left] = magnitude(problem.linearised(z), z)
        else:
            terms = np.concatenate([abs(matrix) @ np.abs(unknowns) for matrix in square.stored])
        allowed = DISAGREEMENT * (terms + np.abs(theirs) + np.abs(expected))
        wrong = np.flatnonzero(np.isfinite(expected) & ~(np.abs(theirs - expected) <= allowed))
        if not wrong.size:
            return None
        owner = np.searchsorted(np.cumsum([one.size for one in values]), wrong[0], side="right")
        less = " less its slack" if stated[owner].slacks is not None else ""
        return (
            f"{name_of(stated[owner].origin)}{less} is {theirs[wrong[0]]:.9g} in one entry at the values of its "
            f"variables, and {expected[wrong[0]]:.9g} was computed"
        )


def chosen_entries(variable: Any, chosen: Any) -> Indices:
    """Return which entries, column by column, cvxpy's ``boolean_idx`` or ``integer_idx`` names."""
    if not len(chosen):
        return np.zeros(0, dtype=np.int64)
    # Arrays of row numbers and column numbers; or a list of entries.
    index = chosen if isinstance(chosen, tuple) else tuple(np.transpose(chosen))
    found = np.ravel_multi_index(index, max(variable.shape, (1,)), order="F")
    return np.asarray(found, dtype=np.int64)


def friction_of(side: Side) -> FloatVector | None:
    """Return the coefficients of the contacts of a side, None of one without friction."""
    if side.friction is None:
        return None
    return np.array(
        np.broadcast_to(bound_value(side.friction, side), (side.expression.size // side.rows,)),
        float,
    )


def sign_of_inequality(pair: Complements, low: FloatVector, high: FloatVector) -> FloatVector:
    """Return the sign of w for a stated G ≥ 0: w = G at a lower bound, −G at an upper one; nothing else agrees."""
    has_low, has_high = np.isfinite(low), np.isfinite(high)
    if (has_low == has_high).any():
        raise UnsupportedModel(
            f"{pair!r} states an inequality opposite a variable that has two bounds, or none; give the expression "
            "alone, F instead of F >= 0: it is ≥ 0 at the lower bound and ≤ 0 at the upper one"
        )
    return np.where(has_low, 1.0, -1.0)


def states_bounds(side: Side) -> bool:
    """Return whether some variable below the side has bounds, be they infinite."""
    names = ("nonneg", "nonpos", "pos", "neg", "bounds")
    return any(
        variable.attributes.get(name) for variable in side.expression.variables() for name in names
    )


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


def pair_residual(pair: Complements) -> FloatVector | None:
    """Return the natural residual of each row of a pair at the present values; None where one is missing."""
    sides = pair.first, pair.second
    with np.errstate(all="ignore"):  # outside of a domain
        values = [side.expression.value for side in sides]
    if any(value is None for value in values):
        return None
    model, values = Model([pair], takes_integers=True), [*map(by_columns, values)]
    cones = [k for k in (0, 1) if sides[k].kind == "cone"]
    k = cones[0] if cones else model.variable_side(pair)
    z, w = values[k], values[1 - k]
    if cones:
        side = sides[k]
        blocks = ConePair(np.arange(z.size), side.rows, friction_of(side)).blocks(
            np.eye(z.size), np.zeros(z.size)
        )
        return np.abs(blocks.residual(z, w, np.ones(blocks.slope.size))[0])
    low, high = model.bounds_of(sides[k])
    if sides[1 - k].kind == "nonnegative" and sides[k].kind != "nonnegative":
        w = np.where(np.isfinite(high) & ~np.isfinite(low), -w, w)
    residual: FloatVector = np.abs(np.minimum(np.maximum(w, z - high), z - low))
    return residual


def _level_of_caller() -> int:
    """Return the stacklevel at which somebody else's code called this package, or cvxpy, which called it."""
    own = {__package__.partition(".")[0], cp.__name__}
    frame, level = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in own:
        frame, level = frame.f_back, level + 1
    return level
