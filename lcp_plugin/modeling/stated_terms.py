"""The objective and the constraints of a cvxpy problem as its user stated them, at the values of his variables."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints import Equality, Inequality, NonNeg, NonPos, Zero
from numpy.typing import NDArray

from ._compat import SUM, UnsolvableModel, attribute_bounds, leaf_value, name_of, postorder

EQUATIONS = (Equality, Zero)
INEQUALITIES = (Inequality, NonPos, NonNeg)


class StatedTerms(NamedTuple):
    """The objective, which is to be minimised, and the slacks, which are to be zero or not positive."""

    goal: float
    slacks: list[NDArray[np.float64]]
    #: The largest term that the objective, number 0, or a constraint is made of; looked for only where it matters.
    size: Callable[[int], float]

    @classmethod
    def of(cls, problem: Any) -> StatedTerms:
        """Return those at the present values of variables and parameters."""
        roots = [problem.objective.args[0], *map(expression_of, problem.constraints)]
        values = values_below(roots)
        signs = [sense_of(problem)] + [
            -1.0 if isinstance(c, NonNeg) else 1.0 for c in problem.constraints
        ]
        goal, *slacks = (
            sign * dense_value(values[id(root)]) for sign, root in zip(signs, roots, strict=True)
        )
        return cls(float(goal.ravel()[0]), slacks, partial(_size, roots, values))

    def violated(self, problem: Any) -> list[float]:
        """Return by how much each constraint is violated; NaN where it is not a number."""
        pairs = zip(problem.constraints, self.slacks, strict=True)
        return [
            float(np.max(violation_of(constraint, slack), initial=0.0))
            for constraint, slack in pairs
        ]


def values_below(roots: list[Any]) -> dict[int, Any]:
    """Return the values of all nodes of expressions, by their ids, at the present values of variables and parameters.

    cvxpy's own ``value`` asks every node for all parameters below it, each time anew, and calls itself from node to
    node, however deep they are. Here each is computed once.
    """
    values: dict[int, Any] = {}
    for root in roots:
        for node in postorder(root, values):
            if id(node) not in values:
                values[id(node)] = _value(node, [values[id(argument)] for argument in node.args])
    return values


def _value(node: Any, arguments: list[Any]) -> Any:
    if isinstance(node, cp.Variable):
        value = leaf_value(node)
        return None if value is None else dense_value(value)
    if not node.args:
        return node.value
    return np.array([]) if 0 in node.shape else node.numeric(arguments)


def _size(roots: list[Any], values: dict[int, Any], k: int) -> float:
    size = 0.0
    for node in postorder(roots[k], ()):
        if not node.args and not isinstance(node, cp.Variable):
            continue
        parts = [entries_of(values[id(argument)]) for argument in node.args]
        size = max(size, float(entries_of(values[id(node)]).max(initial=0.0)))
        is_sum = isinstance(node, SUM)
        for part, argument in zip(parts, node.args, strict=True):
            if is_sum:
                size = max(size, float(part.max(initial=0.0)))
            elif argument.size > node.size:  # something adds them up
                size = max(size, float(part.sum()))
        if len(parts) == 2 and not is_sum:
            size = max(size, float(parts[0].max(initial=0.0) * parts[1].max(initial=0.0)))
    return size


def attribute_error(variable: Any) -> float:
    """Return how far the value of a variable is from one that has all of its attributes."""
    entries = dense_value(leaf_value(variable))
    return float(np.abs(_nearest(variable, entries) - entries).max(initial=0.0))


def _nearest(variable: Any, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a value with the variable's attributes, all of them: cvxpy's own projection knows one at a time."""
    attributes = variable.attributes
    lower, upper = (np.broadcast_to(bound, variable.shape) for bound in attribute_bounds(variable))
    if attributes["symmetric"]:
        x, lower, upper = (x + x.T) / 2, np.maximum(lower, lower.T), np.minimum(upper, upper.T)
    if attributes["diag"]:
        x = x * np.eye(*variable.shape)
    if getattr(variable, "sparse_idx", None) is not None:
        pattern = np.zeros(variable.shape)
        pattern[tuple(variable.sparse_idx)] = 1.0
        x = x * pattern
    return np.clip(x, lower, upper)


def violation_of(constraint: Any, slack: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much each entry of a constraint is violated."""
    if not isinstance(constraint, (*EQUATIONS, *INEQUALITIES)):
        return np.atleast_1d(dense_value(constraint.violation()))
    return np.abs(slack) if isinstance(constraint, EQUATIONS) else np.maximum(slack, 0.0)


def why_not(problem: Any) -> list[str]:
    """Return what in the problem is not of a quadratic program, in the user's words."""
    reasons = []
    for variable in problem.variables():
        for attribute in ("boolean", "integer", "PSD", "NSD", "hermitian"):
            if np.size(variable.attributes[attribute]) and np.any(variable.attributes[attribute]):
                reasons.append(f"variable {variable.name()} is {attribute}")
        if variable.is_complex():
            reasons.append(
                f"variable {variable.name()} is complex; give its real and imaginary part a variable each"
            )
    for constraint in problem.constraints:
        if isinstance(constraint, INEQUALITIES):
            if not expression_of(constraint).is_pwl():
                reasons.append(f"constraint {name_of(constraint)} is not piecewise linear")
        elif not isinstance(constraint, EQUATIONS):
            reasons.append(f"constraint {name_of(constraint)} is a {type(constraint).__name__}")
    if not problem.objective.args[0].is_qpwa():
        reasons.append(
            f"the objective {name_of(problem.objective.args[0])} is not quadratic or piecewise linear"
        )
    return reasons


def refusal(problem: Any) -> UnsolvableModel | None:
    """Return why the problem is no quadratic program, None where its expressions do not tell."""
    if not (reasons := why_not(problem)):
        return None
    return UnsolvableModel(
        'QPSolver and method="LCP" take programs with a convex quadratic objective and linear constraints, and what '
        f"can be written so; here {'; '.join(reasons)}. Choose a solver for cones or integers, as solver=cp.CLARABEL "
        "or cp.HIGHS"
    )


def sense_of(problem: Any) -> float:
    """Return 1 where the objective is to be minimised, −1 where it is to be maximised."""
    return -1.0 if isinstance(problem.objective, cp.Maximize) else 1.0


def expression_of(constraint: Any) -> Any:
    """Return what has to be zero, or of one sign."""
    return constraint.expr if isinstance(constraint, (Equality, Inequality)) else constraint.args[0]


def dense_value(value: Any) -> NDArray[np.float64]:
    """Return the real part of a value as a dense array."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    array = value.toarray() if sp.issparse(value) else np.asarray(value)
    return np.asarray(array.real, dtype=np.float64)


def entries_of(value: Any) -> NDArray[np.float64]:
    """Return the sizes of the stored entries of a value: what is sparse stays so, the other entries are 0."""
    return np.abs(
        (value.tocoo().data if sp.issparse(value) else np.asarray(value)).real.astype(np.float64)
    )
