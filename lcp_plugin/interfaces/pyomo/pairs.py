"""The complementarities of a Pyomo model as rows and partners; the model is not changed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pyomo.core import value
from pyomo.core.expr import (
    EqualityExpression,
    InequalityExpression,
    RangedExpression,
    SumExpression,
)
from pyomo.core.expr.numvalue import is_potentially_variable

from ...core.errors import UnsupportedModel
from ...core.representation import format_count


@dataclass(frozen=True, eq=False)
class PairSide:
    """Side of a pair, lower ≤ body ≤ upper; an absent bound is infinite."""

    lower: float
    body: Any
    upper: float

    @property
    def bounds(self) -> int:
        """The number of finite bounds."""
        return math.isfinite(self.lower) + math.isfinite(self.upper)

    @property
    def is_equation(self) -> bool:
        """True for body == number; a range with equal bounds holds its body, and leaves the row any sign."""
        return self.lower == self.upper

    @property
    def is_fixed(self) -> bool:
        """True if nothing in the body can change."""
        return cannot_vary(self.body)

    @property
    def variable(self) -> Any:
        """The variable that the body is, or None; a fixed one is a number."""
        is_variable = hasattr(self.body, "is_variable_type") and self.body.is_variable_type()
        return self.body if is_variable and not self.body.fixed else None

    @property
    def slack(self) -> Any:
        """The expression that is ≥ 0 at the one finite bound: body − lower or upper − body."""
        if math.isfinite(self.upper):
            return difference(self.upper, self.body)
        return difference(self.body, self.lower) if self.lower else self.body


@dataclass(frozen=True, eq=False)
class Pair:
    """A pair of sides with two finite bounds in total; `held` decides the sign of `row`.

    Attributes
    ----------
    stated : ComplementarityData
    held : PairSide
    row : expression
        ≥ 0 if the held body is at its lower bound, ≤ 0 at its upper bound, 0 between.
    """

    stated: Any
    held: PairSide
    row: Any


def sides_of(stated: Any) -> tuple[PairSide, PairSide]:
    """Return both sides of a ComplementarityData, checked.

    Raises
    ------
    UnsupportedModel
        If the pair has not exactly two finite bounds, or a bound that is not constant.
    """
    if getattr(stated, "_args", None) is None:
        raise UnsupportedModel(
            f"{stated.name} has no sides; give it complements(x >= 0, F >= 0), or deactivate it"
        )
    first, second = (_side(argument, stated) for argument in stated._args)
    if first.is_equation or second.is_equation:
        other = second if first.is_equation else first
        if other.bounds:
            raise UnsupportedModel(
                f"{stated.name} has an equation on one side and a bound on the other; if F = 0 only where x > 0, "
                "write complements(x >= 0, F >= 0); if F is always 0, write a Constraint and bound the variable"
            )
    elif first.bounds + second.bounds != 2:
        bounds = format_count(first.bounds + second.bounds, "finite bound")
        raise UnsupportedModel(
            f"{stated.name} has {bounds} on its two sides together, and needs two: "
            "complements(x >= 0, F >= 0), or complements(inequality(lower, x, upper), F)"
        )
    return first, second


def _side(argument: Any, stated: Any) -> PairSide:
    if argument is None or isinstance(argument, (bool, str)):
        raise UnsupportedModel(
            f"a side of {stated.name} is {argument!r}; it needs an expression of variables"
        )
    if isinstance(argument, EqualityExpression):
        left, right = argument.args
        return PairSide(0.0, difference(left, right) if _counts(right) else left, 0.0)
    if isinstance(argument, (InequalityExpression, RangedExpression)) and any(_strict(argument)):
        raise UnsupportedModel(f"a side of {stated.name} is strict, {argument}; write <= or >=")
    if isinstance(argument, RangedExpression):
        lower, body, upper = argument.args
        return PairSide(_bound(lower, stated), body, _bound(upper, stated))
    if isinstance(argument, InequalityExpression):
        smaller, larger = argument.args
        if not is_potentially_variable(smaller) or (
            is_potentially_variable(larger) and cannot_vary(smaller)
        ):
            return PairSide(_bound(smaller, stated), larger, math.inf)
        if cannot_vary(larger):
            return PairSide(-math.inf, smaller, _bound(larger, stated))
        return PairSide(0.0, difference(larger, smaller), math.inf)
    return PairSide(-math.inf, argument, math.inf)


def _counts(expression: Any) -> bool:
    return bool(is_potentially_variable(expression) or value(expression) != 0.0)


def _strict(expression: Any) -> tuple[bool, ...]:
    strict = expression._strict
    return tuple(strict) if isinstance(strict, (tuple, list)) else (strict,)


def _bound(expression: Any, stated: Any) -> float:
    if not cannot_vary(expression):
        raise UnsupportedModel(
            f"a bound of {stated.name} is {expression}, which varies; state the difference: "
            "complements(body - bound >= 0, …)"
        )
    return float(value(expression))


def difference(first: Any, second: Any) -> Any:
    """Return first − second as a sum of its own: Pyomo's ``+`` may append to the list of a sum that the user holds."""
    return SumExpression([first, -second])


def cannot_vary(expression: Any) -> bool:
    """Return whether nothing in an expression is free; the first free variable ends the search."""
    left = [expression]
    while left:
        part = left.pop()
        if not is_potentially_variable(part):
            continue
        if part.is_expression_type():
            left.extend(part.args)
        elif not part.fixed:
            return False
    return True


def number(expression: Any) -> float:
    """Return the value of an expression at the present values of its variables, NaN if it has none."""
    found = value(expression, exception=False)
    return math.nan if found is None or isinstance(found, complex) else float(found)


def paired(stated: Any, sides: tuple[PairSide, PairSide], is_taken: Callable[[Any], bool]) -> Pair:
    """Return a pair. Held is the ranged side, else a variable that is not taken, else a fixed side.

    Parameters
    ----------
    stated : ComplementarityData
    sides : tuple of PairSide
        Both sides, neither an equality.
    is_taken : callable
        Tells whether a variable already belongs to another row.
    """
    first, second = sides
    if first.bounds == 0 or second.bounds == 0:
        held, free = (second, first) if first.bounds == 0 else (first, second)
        return Pair(stated, held, free.body)
    free_sides = [
        side for side in sides if side.variable is not None and not is_taken(side.variable)
    ]
    held = free_sides[0] if free_sides else second if second.is_fixed else first
    slack = (second if held is first else first).slack
    return Pair(stated, held, slack if math.isfinite(held.lower) else -slack)
