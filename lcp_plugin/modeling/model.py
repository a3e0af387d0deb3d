"""Complementarity problem of a list of cvxpy constraints, and the map back to cvxpy's objects.

The sides of a pair may also be points of cones: ``cp.SOC(t, x)``, and impulses with friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.problems.problem import SolverStats
from cvxpy.reductions.solution import Solution

from ..core.checks import AnyMatrix, Array, Indices, Vector, normalize_bounds
from ..core.errors import NotSquare, UnsupportedModel, warn
from ..core.lcp import LCP
from ..expressions.rows import Rows, as_matrix, is_definition
from ..problems.cones.data import Blocks, ConeProblem
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.statement import SquareModel, Statement, name_of_row
from . import _compat as compat
from .reading import Reader


@dataclass(frozen=True, eq=False)
class Side:
    """Side of a complementarity: an expression, with its relation to the other side.

    Attributes
    ----------
    expression : cvxpy expression
        In the form "box" a variable, or a part of a variable.
    form : str
        "nonnegative" (expression ≥ 0), "box" (lower ≤ expression ≤ upper), "zero" (expression = 0) or "value" (an
        expression whose bounds, if any, are its variable's bounds), "cone" (each column of expression in a cone).
    constraint : cvxpy constraint or None
        The inequality, equality or cone that states the side.
    lower, upper : scalar, array or parameter
        Bounds of a box, of the shape of the expression, or scalars; ±∞ for none.
    friction : scalar, array or parameter, or None
        Coefficients of friction, of impulses.
    rows : int
        Number of rows of one cone.
    """

    expression: cp.Expression
    form: str
    constraint: Any = None
    lower: Array = None
    upper: Array = None
    friction: Array = None
    rows: int = 0

    def __str__(self) -> str:
        if self.constraint is not None:
            return str(self.constraint)
        if self.form == "box":
            return f"box({self.expression}, {self.lower}, {self.upper})"
        if self.form == "cone":
            return f"friction_cone({self.expression}, {self.friction})"
        return str(self.expression)

    def bounds(self) -> tuple[Any, Any]:
        """Return the bounds of a box, of an inequality or of the variable's attributes, in the shape of the side."""
        shape, lower, upper = self.expression.shape, -np.inf, np.inf  # type: Any, Any, Any
        if self.form == "box":
            ends = [compat.bound_value(end, self) for end in (self.lower, self.upper)]
            lower, upper = normalize_bounds(*ends)
        elif self.form == "nonnegative":
            lower = 0.0
        elif isinstance(self.expression, cp.Variable):
            lower, upper = compat.attribute_bounds(self.expression)
        for bound in (lower, upper):
            if np.shape(bound) not in ((), shape):
                raise UnsupportedModel(
                    f"the bounds of {self} must be numbers or have its shape {shape}, got {np.shape(bound)}"
                )
        return np.broadcast_to(lower, shape), np.broadcast_to(upper, shape)


class TwoSides(Protocol):
    """Two sides that complement each other: :class:`~lcp_plugin.modeling.constraint.Complements`."""

    first: Side
    second: Side
    id: int


@dataclass(frozen=True, eq=False)
class ConePair:
    """The unknowns of one pair, cone by cone.

    Attributes
    ----------
    columns : ndarray of int, shape (d k,)
    rows : int
        d, number of rows of a cone.
    friction : ndarray, shape (k,), or None
        Coefficients if the slack follows Coulomb's law.
    """

    columns: Indices
    rows: int
    friction: Vector | None


def cone_problem(
    M: AnyMatrix, q: Vector, pairs: Sequence[ConePair], box: Sequence[tuple[Any, ...]] = ()
) -> Blocks:
    """Return the problem of M and q over the cones of pairs, of which all or none have friction, after a box."""
    friction = [pair.friction for pair in pairs if pair.friction is not None]
    if friction:
        return FrictionalContact(M, q, np.concatenate(friction), dimension=pairs[0].rows)
    cones = [*box]
    for pair in pairs:
        cones += [("second_order", pair.rows)] * (pair.columns.size // pair.rows)
    return ConeProblem(M, q, cones)


def cone_expression(cone: cp.SOC) -> Any:
    """Return t above x: shape (d,) of one cone, (d, k) of k."""
    t, x = cone.args
    if x.ndim < 2:
        return cp.hstack([t, x if x.ndim else cp.reshape(x, (1,), order="F")])
    return cp.vstack([cp.reshape(t, (1, t.size), order="F"), x if cone.axis == 0 else x.T])


def over_cones(model: SquareModel, pairs: Sequence[ConePair], name: Any) -> SquareModel:
    """Return the problem over cones, the rows of other pairs and equations before the cones.

    Parameters
    ----------
    model : SquareModel
        Model in which the unknowns of cones have no bounds.
    pairs : sequence of ConePair
    name : callable
        Function from the number of an unknown to its name.

    Raises
    ------
    UnsupportedModel
        If sides are not affine, or the model has friction and other conditions.
    """
    problem_rows = model.problem
    if not isinstance(problem_rows, LCP):
        raise UnsupportedModel(
            "cones can be combined with affine sides only; write nonlinear ones as affine, or solve them apart"
        )
    kept = model.elimination.kept
    of_cones = np.searchsorted(kept, np.concatenate([pair.columns for pair in pairs]))
    others = np.setdiff1d(np.arange(kept.size), of_cones)
    order = np.concatenate([others, of_cones])
    has_friction = [pair.friction is not None for pair in pairs]
    is_mixed = others.size or not all(has_friction) or len({pair.rows for pair in pairs}) > 1
    if any(has_friction) and is_mixed:
        names = [name(column) for column in kept[others][:5].tolist()]
        raise UnsupportedModel(
            "a model with friction_cone has impulses as its only unknowns, and this one has also "
            f"{', '.join(names or ['cones of another kind'])}; write the "
            "velocities as u = W @ r + b, or as a chain of definitions"
        )
    box = [("box", problem_rows.lower[others], problem_rows.upper[others])] if others.size else []
    problem = cone_problem(problem_rows.csr[order][:, order], problem_rows.q[order], pairs, box)
    expansion = model.elimination.expansion[:, order]
    elimination = replace(model.elimination, kept=kept[order], expansion=expansion)
    model = replace(model, problem=problem, elimination=elimination, whole=None)
    return replace(model, places=model.places[order], signs=model.signs[order])


@dataclass(eq=False)
class DualReport:
    """Value for a constraint's dual variable: scale · (w or z)[columns] + shift."""

    constraint: cp.Constraint
    columns: Indices
    shape: tuple[int, ...]
    is_slack: bool
    scale: Any = 1.0
    shift: Any = 0.0
    expression: Any = None  # whose parameters move the shift


class ReadSide(NamedTuple):
    """Rows of one side of a pair, weights · distinct unknowns + shift if columns is not None, and their bounds."""

    rows: Rows
    columns: Any
    weights: Array
    shift: Any
    low: Vector
    high: Vector


class Model:
    """Unknowns, rows and pairs of cvxpy constraints, and the map back to variables and dual values.

    It is one class because `write_back` inverts, entry by entry, the lists that reading the constraints has filled.

    Parameters
    ----------
    stated : list
        Constraints and expressions whose variables are the unknowns.
    memo : dict, optional
        Results that do not depend on parameters, kept from model to model.
    takes_integers : bool
        Whether variables may be integers.

    Attributes
    ----------
    statement : Statement
    variables : list of cvxpy.Variable
    spans : dict
        From the id of a variable to the slice of its unknowns.
    reports : list of DualReport
    agents : list of Optimal
        Agents whose conditions are among the constraints.
    numbers : dict
        Places of constraints in the user's list, by their ids.
    bounds : list of tuple
        Bounds of unknowns: columns, weights, the expression that is weights · unknowns + constants or None, and the
        bounds as expressions. A later entry overrides an earlier one.
    friction : list of pairs
        Coefficients as expressions, and the number of contacts of each.
    """

    def __init__(
        self, stated: Sequence[Any], reader: Reader, constraints: Sequence[Any] = ()
    ) -> None:
        self.reader = reader
        leaves = compat.by_id(variable for item in stated for variable in item.variables())
        self.variables, (self.spans, size) = list(leaves.values()), spans_of(leaves)
        self.bounds: list[tuple[Indices, Any, Any, Any, Any]] = []
        #: Bounds that attributes of the variables state.
        self.declared = np.full(size, -np.inf), np.full(size, np.inf)
        for variable in self.variables:
            span = self.spans[variable.id]
            for end, bound in zip(self.declared, compat.attribute_bounds(variable), strict=True):
                end[span] = compat.by_columns(np.broadcast_to(bound, variable.shape))
            if variable.attributes.get("bounds") is not None:
                ends = compat.attribute_expressions(variable)
                self.bounds.append((np.arange(size)[span], 1.0, None, *ends))
        lower, upper = (end.copy() for end in self.declared)
        first = {key: span.start for key, span in self.spans.items()}
        # Without a reference to the model, which is freed at once: a cycle would wait for the collector.
        named: list[Any] = [(v.size, partial(compat.entry_of, v)) for v in self.variables]
        name = partial(name_of_row, named, range(size))
        self.statement = Statement(self.reader.compiler, first, lower, upper, name)
        self.statement.other_way = ", or list them in over=[…] of an agent"
        self.statement.way_to_fix = "fix it with box({name}, {value}, {value})"
        self.is_defined = np.zeros(size, dtype=bool)
        self.reports: list[DualReport] = []
        self.agents = [item for item in constraints if hasattr(item, "save_duals")]
        self.numbers = {item.id: k for k, item in enumerate(constraints)}
        self.cones: list[ConePair] = []
        self.friction: list[tuple[Any, int]] = []
        self._equations: list[Any] = []
        self._known: dict[int, ReadSide] = {}

    # --- reading ---

    def add_equations(self, constraints: Sequence[Any]) -> None:
        """Read equalities, before the pairs: defined variables should not be paired."""
        for constraint in constraints:
            # The same expression object in every call, so that the memo has its rows.
            rows = self.reader.rows(constraint.expr)
            number = self.numbers.get(constraint.id)
            name = partial(compat.row_of, constraint, number=number)
            self.statement.constrain(rows, origin=constraint.expr, name=name)
            self._equations.append(constraint)
            for key, block in rows.blocks.items():
                if key in self.spans and is_definition(as_matrix(block, rows.size)):
                    first = self.spans[key].start
                    self.is_defined[first + as_matrix(block, rows.size).indices] = True

    def add_pairs(self, pairs: Sequence[TwoSides]) -> None:
        """Read complementarities, first the pairs with only one side that can be the variable."""
        order = sorted(pairs, key=lambda p: self._key(p.first)[0] == self._key(p.second)[0])
        for pair in order:
            self._pair(pair, *self.sides(pair))

    def sides(self, pair: TwoSides) -> list[Side]:
        """Return the sides of a pair, first its variable: the side with bounds, of two such sides the unknowns."""
        return sorted((pair.first, pair.second), key=self._key)

    def _key(self, side: Side) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
        """Return a sort key of the sides of a pair, by how it is stated, then by its unknowns; variables are first."""
        _, columns, _, _, low, high = self.read(side)
        is_plain, has_bounds = columns is not None, bool(np.isfinite((low, high)).any())
        is_paired = is_plain and bool(self.statement.is_paired[columns].any())
        is_defined = is_plain and bool(self.is_defined[columns].all())
        stated = side.form == "zero", side.form not in ("box", "cone"), not has_bounds, not is_plain
        return stated, (is_paired, is_defined, not isinstance(side.expression, cp.Variable))

    def read(self, side: Side) -> ReadSide:
        """Return the rows of a side, the unknowns that they are, and their bounds."""
        if (key := id(side)) not in self._known:  # one expression may have two boxes
            rows = self.reader.rows(side.expression)
            columns, weights, shift = self.statement.entries(rows) or (None, 1.0, 0.0)
            if side.form == "value" and columns is not None and not np.any(shift):
                ends = [weights * end[columns] for end in self.declared]
                low, high = np.minimum(*ends), np.maximum(*ends)
            else:
                low, high = map(compat.by_columns, side.bounds())
            self._known[key] = ReadSide(rows, columns, weights, shift, low, high)
        return self._known[key]

    def _pair(self, pair: TwoSides, side: Side, other: Side) -> None:
        """Let the first side be the unknowns of a pair; warn of other readings."""
        if "cone" in (side.form, other.form):
            self._pair_cones(pair, side, other)
            return
        rows, columns, weights, shift, low, high = self.read(side)
        is_new = columns is None or bool(self.statement.is_paired[columns].any())
        if columns is not None and is_new:
            self.statement.repeat(columns)
        if columns is None and other.form == "value" and side.form in ("nonnegative", "value"):
            raise UnsupportedModel(
                f"{side} is not a variable, and {other} has no sign; write {other} >= 0 or <= 0, or give one side a "
                "variable of its own: y == side in the list, and y in its place in the pair"
            )
        is_bounded = np.isfinite((low, high))
        check_inequality(pair, side, other, is_bounded)
        if other.form == "zero" and is_bounded.any():
            warn_of_equality_between_bounds(pair, side)
        elif (
            side.form == other.form == "value" and not is_bounded.any() and not states_bounds(side)
        ):
            warn(
                f"{side} has no bounds: complements({side}, F) means F == 0; write that, or nonneg=True"
            )
        expression, scale, offset = side.expression, weights, shift
        if is_new:
            columns = self.statement.named(rows, expression)
            expression, scale, offset = None, 1.0, 0.0
        with np.errstate(all="ignore"):
            ends = (low - offset) / scale, (high - offset) / scale
        lower, upper = np.minimum(*ends), np.maximum(*ends)
        is_crossed = (lower == np.inf) | (upper == -np.inf) | (ends[0] * scale > ends[1] * scale)
        if is_crossed.any():
            raise UnsupportedModel(f"the lower bound of {side} is above the upper, or overflows")
        sign = np.sign(scale) * sign_of_slack(side, other, self.read(side))
        if side.form != "value":
            stated = (side.lower, side.upper) if side.form == "box" else (0.0, np.inf)
            self.bounds.append((columns, scale, expression, *stated))
        number = self.numbers.get(pair.id)
        name = partial(compat.row_of, other.expression, constraint=pair, number=number)
        rows, origin = self.read(other).rows, other.expression
        self.statement.complement(columns, rows, lower, upper, sign, origin=origin, name=name)
        self._report(pair, (side, other), columns, sign, scale, offset, expression)

    def _report(
        self, pair: TwoSides, sides: Any, columns: Indices, sign: float = 1.0, *value: Any
    ) -> None:
        """Report w for the pair and the variable's constraint, the variable for w's constraint."""
        shape = pair.first.expression.shape
        owners = pair, *(side.constraint for side in sides)
        duals = (True, sign), (True, sign), (False, *value)
        for constraint, dual in zip(owners, duals, strict=True):
            if constraint is not None:
                # cvxpy reads the dual value of a cone column by column.
                dual_shape = (columns.size,) if isinstance(constraint, cp.SOC) else shape
                self.reports.append(DualReport(constraint, columns, dual_shape, *dual))

    def _pair_cones(self, pair: TwoSides, cone: Side, other: Side) -> None:
        """K ∋ S ⟂ F ∈ K*: the unknowns are the side that is entries of variables, or new ones."""
        side, entries = cone, []
        for item in (cone, other):
            rows, columns, weights, shift, *_ = self.read(item)
            if rows.level:
                raise UnsupportedModel(f"{item} must be affine next to a cone; give it a variable")
            is_plain = columns is not None and not shift.any() and (weights == 1.0).all()
            is_taken = is_plain and (
                self.statement.is_paired[columns].any() or self.is_defined[columns].all()
            )
            entries.append(columns if is_plain and not is_taken else None)
        if entries[0] is None and cone.friction is None and entries[1] is not None:
            side, other, entries = other, cone, entries[::-1]
        if (columns := entries[0]) is None:
            columns = self.statement.named(self.read(side).rows, side.expression)
        else:
            self._drop_cone_bounds(side, columns.reshape(-1, cone.rows))
        rows = self.read(other).rows
        self.statement.complement(columns, rows, -np.inf, np.inf, origin=other.expression)
        self._report(pair, (side, other), columns)
        self.cones.append(ConePair(columns, cone.rows, friction_of(cone)))
        if cone.friction is not None:
            self.friction.append((cone.friction, columns.size // cone.rows))

    def _drop_cone_bounds(self, side: Side, columns: Indices) -> None:
        """Drop t ≥ 0, which the cone implies; raise if entries of a cone have other bounds."""
        first, lower, upper = columns[:, 0], self.statement.lower, self.statement.upper
        lower[first] = np.where(lower[first] == 0.0, -np.inf, lower[first])
        if np.isfinite((lower[columns], upper[columns])).any():
            raise UnsupportedModel(f"{side} has bounds next to a cone; drop or pair them")

    # --- the complementarity problem ---

    @cached_property
    def square(self) -> SquareModel:
        """The complementarity problem; see :meth:`Statement.square`."""
        rows, variable_of = self.statement.rows, np.full(self.statement.lower.size, -1)
        for k, variable in enumerate(self.variables):
            variable_of[self.spans[variable.id]] = k
        # All unknowns that name expressions count as one more variable.
        variable_of[variable_of < 0] = len(self.variables)
        square = self.statement.square(variable_of)
        if (remark := self.statement.repeated(at_least=3)) is not None:
            warn(remark)
        if self.cones:
            square = over_cones(square, self.cones, self.statement.name_of)
        if self._equations:
            ends = np.cumsum([row.rows.size for row in rows]).tolist()
            columns = np.full(ends[-1], -1, dtype=np.int64)
            columns[square.elimination.rows] = square.elimination.columns
            columns[columns < 0] = square.matched
            parts = zip(np.split(columns, ends[:-1]), rows, strict=True)
            equations = [part for part, row in parts if row.slacks is None]
            for constraint, part in zip(self._equations, equations, strict=True):
                self.reports.append(DualReport(constraint, part, constraint.shape, False))
        return square

    @property
    def problem(self) -> Any:
        """The LCP, NonlinearProblem, ConeProblem or FrictionalContact."""
        return self.square.problem

    def lcp(self, purpose: str) -> LCP:
        """Return the LCP; raise if the model has other conditions.

        Raises
        ------
        UnsupportedModel
            Names the parts of the model that the purpose does not support.
        """
        problem = self.problem
        if not isinstance(problem, LCP):
            raise UnsupportedModel(
                f'{purpose} takes affine sides without cones; problem.solve(method="LCP") takes others also'
            )
        for column in self.square.dropped[:1].tolist():
            entry = self.statement.name_of(column)
            raise UnsupportedModel(
                f"{entry} has bounds that no pair implies, and {purpose} supports no further bounds; drop them, or "
                f"make it the variable of a pair, as in complements({entry}, F)"
            )
        return problem

    def refuse_violated_bounds(self, z: Vector) -> None:
        """Raise NotSquare if a solution violates bounds that no pair states."""
        unknowns, dropped = self.square.elimination.expand(z), self.square.dropped
        for entry, *_ in self.statement.violated_bounds(unknowns, dropped)[:1]:
            raise NotSquare(
                f"{entry} has bounds that the rest of the model does not imply, and no pair states the slack at "
                f"them; drop them, or make it the variable of a pair, as in complements({entry}, F)"
            )

    # --- from the solution to cvxpy ---

    def values(self, z: Vector) -> dict[int, Any]:
        """Return the value of each variable by its id, in the variable's shape."""
        return self.split(self.square.elimination.expand(z))

    def split(self, unknowns: Vector) -> dict[int, Any]:
        """Return a value for each variable, by id, in the variable's shape."""
        spans = self.spans
        return {v.id: unknowns[spans[v.id]].reshape(v.shape, order="F") for v in self.variables}

    @np.errstate(all="ignore")  # outside of a domain
    def present(self) -> Vector | None:
        """Return the present values of all unknowns; None if a variable has no value."""
        if any(variable.value is None for variable in self.variables):
            return None
        z = np.zeros(self.statement.lower.size)
        for variable in self.variables:
            z[self.spans[variable.id]] = compat.by_columns(variable.value)
        for row in self.statement.rows:
            if row.slacks is not None:
                z[row.slacks] = row.sign * compat.by_columns(row.origin.value)
        return z

    def write_back(
        self, problem: cp.Problem, result: Any, point: tuple[Vector, Vector, float] | None
    ) -> None:
        """Give a cvxpy problem its status, values, dual values and statistics.

        Parameters
        ----------
        problem : cvxpy.Problem
        result : Result or EquilibriumResult
        point : tuple or None
            All unknowns, their slacks and the value of the objective; None if a proof excludes solutions.
        """
        if point is not None:
            result = replace(result, agents=tuple(self.agents))
        status, attributes = compat.CVXPY_STATUS[result.status], compat.statistics(result)
        if point is None:
            worst = np.inf if status == settings.INFEASIBLE else -np.inf
            value = compat.sense_of(problem) * worst
            problem.unpack(Solution(status, value, {}, {}, attributes))
            for report in self.reports:
                for variable in report.constraint.dual_variables:
                    variable.save_value(None)
        else:
            z, w, value = point
            problem.unpack(Solution(status, value, self.split(z), {}, attributes))
            for report in self.reports:
                entries = (w if report.is_slack else z)[report.columns]
                dual = report.scale * entries + report.shift
                report.constraint.save_dual_value(dual.reshape(report.shape, order="F"))
        for agent in self.agents:
            agent.save_duals()
        problem._solver_stats = SolverStats.from_dict(attributes, "LCP")

    def consistency_error(self, z: Vector, w: Vector) -> str | None:
        """Compare w with the expressions, evaluated by cvxpy; return the mismatch, or None.

        Parameters
        ----------
        z, w : array, shape (n,)
            Variables have the values of z.
        """
        square, stated = self.square, [*self.statement.pairs, *self.statement.rows]
        unknowns = square.elimination.expand(z)
        below = compat.values_below([row.origin for row in stated])
        values = [compat.by_columns(below[id(row.origin)]) for row in stated]
        for k, row in enumerate(stated):
            if row.slacks is not None:
                values[k] = values[k] - unknowns[row.slacks]
        theirs = np.concatenate([*values, np.zeros(0)])
        if (mismatch := square.first_mismatch(z, w, theirs)) is None:
            return None
        number, expected = mismatch
        owner = np.searchsorted(np.cumsum([part.size for part in values]), number, side="right")
        less = " less its slack" if stated[owner].slacks is not None else ""
        name = f"{compat.name_of(stated[owner].origin)}{less}"
        return f"an entry of {name} is {theirs[number]:.9g}, and {expected:.9g} was computed"


def spans_of(leaves: dict[int, Any]) -> tuple[dict[int, slice], int]:
    """Return the slice of each expression in their concatenation, and the number of entries."""
    ends = np.cumsum([0, *(leaf.size for leaf in leaves.values())]).tolist()
    return {key: slice(*pair) for key, pair in zip(leaves, pairwise(ends), strict=True)}, ends[-1]


def friction_of(side: Side) -> Vector | None:
    """Return the coefficients of the contacts of a side; None without friction."""
    if side.friction is None:
        return None
    contacts = np.zeros(side.expression.size // side.rows)
    return np.asarray(contacts + compat.bound_value(side.friction, side))


def sign_of_slack(side: Side, other: Side, read: ReadSide) -> Vector:
    """Return the sign of w in the other side: of G ≥ 0, −1 at an upper bound; of F next to u ≥ 0, of u in z."""
    if other.form == "nonnegative" and side.form != "nonnegative":
        return np.where(np.isfinite(read.high) & ~np.isfinite(read.low), -1.0, 1.0)
    is_turned = (side.form, other.form) == ("nonnegative", "value")
    return np.ones(read.low.size) * (np.sign(read.weights) if is_turned else 1.0)


def check_inequality(pair: TwoSides, side: Side, other: Side, is_bounded: Array) -> None:
    """Raise UnsupportedModel for an inequality opposite a variable that does not have exactly one bound."""
    is_stated = other.form == "nonnegative" and side.form != "nonnegative"
    if is_stated and (is_bounded[0] == is_bounded[1]).any():
        raise UnsupportedModel(
            f"{pair!r} states an inequality opposite a variable that has two bounds, or none; give the expression "
            "alone, F instead of F >= 0: it is ≥ 0 at the lower bound and ≤ 0 at the upper one"
        )


def states_bounds(side: Side) -> bool:
    """Return whether some variable below the side has bounds, finite or infinite."""
    names = ("nonneg", "nonpos", "pos", "neg", "bounds")
    return any(v.attributes.get(name) for v in side.expression.variables() for name in names)


def warn_of_equality_between_bounds(pair: TwoSides, side: Side) -> None:
    """Warn of an equality that holds only between bounds; raise for an inequality."""
    if side.form != "value":
        raise UnsupportedModel(
            f"{pair!r} pairs an equality with an inequality; pair it with a variable"
        )
    warn(
        f"{pair!r} pairs an equality with a bounded variable: at a bound it need not hold, as in complements(x, F); "
        "write G == 0 in the list, outside the pair, where it always has to"
    )


def pair_residual(pair: TwoSides) -> Vector | None:
    """Return the natural residual of each row of a pair at the present values, or None."""
    model = Model([pair], Reader(takes_integers=True))
    side, other = model.sides(pair)
    with np.errstate(all="ignore"):  # outside of a domain
        values = [item.expression.value for item in (side, other)]
    if any(value is None for value in values):
        return None
    z, w = map(compat.by_columns, values)
    if side.form == "cone":
        cones = ConePair(np.arange(z.size), side.rows, friction_of(side))
        return np.abs(cone_problem(np.eye(z.size), np.zeros(z.size), [cones]).residual(z, w))
    read = model.read(side)
    w = sign_of_slack(side, other, read) * w
    return np.abs(np.minimum(np.maximum(w, z - read.high), z - read.low))
