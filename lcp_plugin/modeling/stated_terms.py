"""Values of cvxpy expressions as they were stated, and why a problem is not a quadratic program."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints import Equality, Inequality, NonNeg, NonPos, Zero
from numpy.typing import NDArray

from ._compat import UnsolvableModel, leaf_value, name_of, postorder

EQUATIONS = (Equality, Zero)
INEQUALITIES = (Inequality, NonPos, NonNeg)


def values_below(roots: list[Any]) -> dict[int, Any]:
    """Return the values of all nodes of expressions, by their ids, at the present values of variables and parameters.

    cvxpy's ``value`` queries all parameters below every node, and recurses from node to node, however deep they are.
    Here each is computed once.
    """
    values: dict[int, Any] = {}
    for root in roots:
        for node in postorder(root, values):
            if id(node) in values:
                continue
            if isinstance(node, cp.Variable):
                value = leaf_value(node)
                values[id(node)] = value.toarray() if sp.issparse(value) else value
            elif not node.args:
                values[id(node)] = node.value
            else:
                arguments = [values[id(argument)] for argument in node.args]
                values[id(node)] = np.zeros(0) if 0 in node.shape else node.numeric(arguments)
    return values


def why_not(problem: Any) -> list[str]:
    """Return the reasons why a problem is not a quadratic program, in the user's names."""
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
    """Return an error with the reasons why a problem is not a quadratic program, or None."""
    if not (reasons := why_not(problem)):
        return None
    return UnsolvableModel(
        'QPSolver and method="LCP" support convex quadratic programs, and problems that cvxpy compiles to them; '
        f"here {'; '.join(reasons)}. Choose a solver for cones or integers, as solver=cp.CLARABEL "
        "or cp.HIGHS"
    )


def sense_of(problem: Any) -> float:
    """Return 1 if the objective is minimized, −1 if it is maximized."""
    return -1.0 if isinstance(problem.objective, cp.Maximize) else 1.0


def expression_of(constraint: Any) -> Any:
    """Return the expressions of a constraint that must be zero, or of one sign."""
    return constraint.expr if isinstance(constraint, (Equality, Inequality)) else constraint.args[0]


def dense_value(value: Any) -> NDArray[np.float64]:
    """Return the real part of a value as a dense array."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    array = value.toarray() if sp.issparse(value) else np.asarray(value)
    return np.asarray(array.real, dtype=np.float64)
