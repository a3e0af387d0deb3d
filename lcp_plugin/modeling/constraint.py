"""complements(a, b): complementarity between two sides, as a constraint that cvxpy accepts, copies and pickles."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from operator import is_
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy.constraints.constraint import Constraint
from cvxpy.constraints.nonpos import Inequality, NonNeg
from cvxpy.constraints.zero import Equality, Zero

from ..core.checks import Array, fill
from ..core.errors import InvalidProblem, UnsupportedModel
from ..problems.cones.frictional_contact import dimension_of
from ._compat import by_id
from .model import Side, cone_expression, pair_residual

REMEDY = 'solve it with problem.solve(method="LCP")'


def box(expression: cp.Expression, lower: Array, upper: Array) -> Side:
    """Return the condition lower ≤ expression ≤ upper, as one side of a complementarity.

    Parameters
    ----------
    expression : cvxpy expression
        A variable, or a part of one.
    lower, upper : scalar, array or parameter
        Bounds of the shape of the expression, or scalars; ±∞ for none.

    Examples
    --------
    >>> import cvxpy as cp
    >>> x = cp.Variable(2)
    >>> pair = complements(box(x, -1, 1), x - 3)
    """
    return Side(_expression(expression, "the expression of box"), "box", None, lower, upper)


def friction_cone(impulses: object, friction: Array, *, dimension: int | None = None) -> Side:
    """Return Coulomb's law ‖r_T‖ ≤ μ r_N, as one side of a complementarity; the other side are the velocities.

    Parameters
    ----------
    impulses : cvxpy expression, shape (d k,)
        r of k contacts one after the other: normal, then tangents.
    friction : scalar, array of shape (k,), or parameter
        Coefficients μ ≥ 0.
    dimension : int, optional
        d, 3 in space and 2 in the plane, if `friction` does not determine it: 3 by default if the length is a multiple
        of 3, with a ModelWarning if it is one of 2 also.

    Raises
    ------
    UnsupportedModel
        If the impulses are not a vector, or coefficients and contacts differ in number.

    Examples
    --------
    >>> import cvxpy as cp
    >>> r = cp.Variable(3)
    >>> pair = complements(friction_cone(r, 0.5), r + [-1, 3, 4])
    >>> _ = cp.Problem(cp.Minimize(0), [pair]).solve(method="LCP")
    >>> r.value.round(6)
    array([ 1. , -0.3, -0.4])
    """
    expression = _expression(impulses, "the impulses of friction_cone")
    if expression.ndim != 1:
        raise UnsupportedModel(
            f"friction_cone needs a vector of impulses, contact by contact, got shape {expression.shape}; write "
            'cp.vec(r, order="C") of an array with one row per contact'
        )
    rows = dimension_of(dimension, np.shape(friction), expression.size)
    count = expression.size // rows
    if np.shape(friction) not in ((), (count,)):
        raise UnsupportedModel(
            f"friction must be a number or of shape ({count},), one per {rows} rows, got {np.shape(friction)}"
        )
    return Side(expression, "cone", friction=friction, rows=rows)


def complements(first: object, second: object) -> Complements:
    """Return the constraint that two sides complement each other, row by row.

    Parameters
    ----------
    first, second : cvxpy constraints or expressions
        In either order: ``x >= 0`` with ``F >= 0``; ``box(x, l, u)`` with an expression F. Also a variable with
        bounds, with F, or a free variable with ``G == 0``. Cones: ``cp.SOC(t, x)`` with ``cp.SOC(s, y)``, or with an
        affine F that has s in its first row and y below; ``friction_cone(r, mu)`` with velocities u. Both sides may
        be general expressions, affine or smooth; see ``help("lcp_plugin.modeling")``. At a lower bound F ≥ 0, at an
        upper bound F ≤ 0, between them F = 0.

    Returns
    -------
    Complements
        For ``cp.Problem(cp.Minimize(0), [...]).solve(method="LCP")``.

    Raises
    ------
    UnsupportedModel
        If the two sides have different shapes or cannot complement each other.

    Examples
    --------
    >>> import cvxpy as cp
    >>> M = np.array([[2, 1], [1, 2]])
    >>> x = cp.Variable(2)
    >>> problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + [-5, 1] >= 0)])
    >>> _ = problem.solve(method="LCP")
    >>> x.value.round(6)
    array([2.5, 0. ])
    """
    sides = [_checked_side(first, "first"), _checked_side(second, "second")]
    forms = {side.form for side in sides}
    if forms == {"zero"}:
        raise UnsupportedModel("complements got two equalities; write them as constraints")
    if "box" in forms and forms <= {"box", "zero"}:
        raise UnsupportedModel("complements(box(x, l, u), F) needs an expression F as other side")
    if "cone" in forms:
        _require_cones(sides)
    if sides[0].expression.shape != sides[1].expression.shape:
        raise UnsupportedModel(
            f"the sides of complements must have the same shape, got {sides[0].expression.shape} for "
            f"{sides[0]} and {sides[1].expression.shape} for {sides[1]}; nothing is broadcast"
        )
    return Complements(sides[0], sides[1])


def _require_cones(sides: list[Side]) -> None:
    """Raise if one side is a cone, and the other is neither a cone like it nor an expression."""
    others = [side for side in sides if side.form != "cone"]
    is_law = not others and any(side.friction is not None for side in sides)
    if is_law or any(side.form != "value" for side in others):
        raise UnsupportedModel(
            f"one side of complements is a cone, and the other is {(others or sides)[-1]}; it must be an expression F, "
            "or a cone like it, the row of t first; friction_cone needs the velocities u"
        )


def _checked_side(stated: object, which: str) -> Side:
    if isinstance(stated, Side):
        return stated
    if isinstance(stated, Inequality):
        return Side(stated.args[1] - stated.args[0], "nonnegative", stated)
    if isinstance(stated, NonNeg):
        return Side(stated.args[0], "nonnegative", stated)
    if isinstance(stated, (Equality, Zero)):
        return Side(stated.expr, "zero", stated)
    if isinstance(stated, cp.SOC):
        expression = cone_expression(stated)
        return Side(expression, "cone", stated, rows=expression.shape[0])
    if isinstance(stated, Constraint):
        raise UnsupportedModel(
            f"the {which} side of complements is {stated!r}; write <=, >=, ==, cp.SOC(t, x) or an expression"
        )
    return Side(_expression(stated, f"the {which} side of complements"), "value")


def _expression(stated: object, what: str) -> Any:
    """Return the argument as a cvxpy expression."""
    if not isinstance(stated, cp.Expression) and _dtype_letter(stated) == "b":
        raise UnsupportedModel(
            f"{what} holds Booleans, {stated}: numbers were compared before this package saw them; write the "
            "numbers, or cp.Constant(numbers) >= 0"
        )
    expression = None
    if stated is not None:
        with suppress(Exception):  # cvxpy may raise any error
            expression = cp.Variable.cast_to_const(stated)
    is_constant = isinstance(expression, cp.Constant)
    if expression is None or (is_constant and _dtype_letter(expression.value) not in "fiuc"):
        raise UnsupportedModel(f"{what} is not a cvxpy expression: {stated!r}")
    return expression


def _dtype_letter(values: object) -> str:
    """Return numpy's letter for the type of an array or array-like; "O" if it is neither."""
    try:
        return values.dtype.kind if hasattr(values, "dtype") else np.asarray(values).dtype.kind
    except ValueError:
        return "O"


class Condition(Constraint):  # type: ignore[misc]
    """A constraint that only method="LCP" solves: complementarity, or the optimality of an agent's program."""

    def name(self) -> str:
        """Return the constraint as text, with the call that solves it: cvxpy prints this when it rejects the model."""
        return f"{self!r}  [{REMEDY}]"

    def is_dcp(self, dpp: bool = False) -> bool:
        """Return False: complementarity is not convex."""
        return False

    is_dgp = is_dqcp = is_dnlp = is_dcp

    def violation(self) -> float:
        """Return the largest natural residual.

        Raises
        ------
        InvalidProblem
            If a variable has no value yet.
        """
        residual = self.residual
        if residual is None:
            raise InvalidProblem("variables of the complementarity have no values; solve first")
        return float(np.max(residual, initial=0.0))

    def value(self, tolerance: float = 1e-8) -> bool:
        """Return whether the largest natural residual is at most the tolerance."""
        return self.violation() <= tolerance

    def copy(self, args: list[Any] | None = None, id_objects: object = None) -> Condition:
        """Return a copy with the same parts; raise UnsupportedModel for other arguments."""
        if args is not None and not all(map(is_, self.args, args)):
            raise UnsupportedModel(f"cvxpy cannot transform {self!r}; {REMEDY}")
        twin: Condition = fill(type(self).__new__(type(self)), **vars(self))
        twin._construct_dual_variables(self.args)
        return twin


class Complements(Condition):
    """Two sides that complement each other; see :func:`complements`.

    `name_of_row` is None, or a function that names the row of an entry, of an agent's conditions.

    ``dual_value`` is the value of the side that is not a variable (w); of two expressions, the value of the second.
    After a solve, the inequality that bounds the variable has the same dual value. The dual value of the other
    inequality is the variable, as after a quadratic program. For a cone, ``dual_value`` has t in its first row.

    Parameters
    ----------
    first, second : Side
        Made by :func:`complements`.
    constr_id : int, optional
        cvxpy's number of the constraint; a new one by default.
    """

    name_of_row: Callable[[int], str] | None = None

    def __init__(self, first: Side, second: Side, constr_id: int | None = None) -> None:
        self.first, self.second = first, second
        super().__init__([first.expression, second.expression], constr_id)

    def _construct_dual_variables(self, args: list[Any]) -> None:
        self.dual_variables = [cp.Variable(args[1].shape)]

    def __repr__(self) -> str:
        return f"complements({self.first}, {self.second})"

    def parameters(self) -> list[Any]:
        """Return the parameters of both sides, including parameters in the bounds of a box."""
        sides = self.first, self.second
        bounds = [bound for side in sides for bound in (side.lower, side.upper, side.friction)]
        owners = [super(), *(bound for bound in bounds if isinstance(bound, cp.Expression))]
        return list(by_id(p for owner in owners for p in owner.parameters()).values())

    @property
    def residual(self) -> Any:
        """The natural residual of each row, in the shape of a side; None without values."""
        residual = pair_residual(self)
        return None if residual is None else residual.reshape(self.shape, order="F")
