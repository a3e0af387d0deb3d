"""The objective and the constraints of a cvxpy problem, as its user stated them, at any values of its variables.

cvxpy's own ``value`` asks every node of an expression for all parameters below it, each time anew. Here each node is
listed once, what no variable enters is computed once, and the variables themselves are not touched.
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints import Equality, Inequality, NonNeg, NonPos, Zero
from numpy.typing import NDArray

from .extract import postorder

Values = dict[int, Any]

EQUATIONS = (Equality, Zero)
INEQUALITIES = (Inequality, NonPos, NonNeg)


class StatedTerms:
    """What is to be minimised, and what each constraint wants to be zero or not positive.

    Parameters
    ----------
    problem : cvxpy.Problem
        Its parameters have values, which are taken now.
    """

    def __init__(self, problem: Any) -> None:
        self._signs = [sense_of(problem)] + [-1.0 if isinstance(c, NonNeg) else 1.0 for c in problem.constraints]
        roots = [problem.objective.args[0], *map(expression_of, problem.constraints)]
        nodes: dict[int, Any] = {}
        for root in roots:
            nodes |= {id(node): node for node in postorder(root, nodes)}
        place = {key: k for k, key in enumerate(nodes)}
        self._roots = [place[id(root)] for root in roots]
        self._values: list[Any] = [None] * len(nodes)
        self._leaves: list[tuple[int, int]] = []
        self._steps: list[tuple[int, Any, list[int]]] = []
        moves = [False] * len(nodes)
        for k, node in enumerate(nodes.values()):
            arguments = [place[id(argument)] for argument in node.args]
            if isinstance(node, cp.Variable):
                self._leaves.append((k, node.id))
                moves[k] = True
            elif not node.args:
                self._values[k] = node.value
            elif any(moves[argument] for argument in arguments):
                self._steps.append((k, node, arguments))
                moves[k] = True
            else:
                self._values[k] = _numeric(node, [self._values[argument] for argument in arguments])

    def at(self, values: Values) -> tuple[float, list[NDArray[np.float64]]]:
        """Return the objective and the slacks at the dense values of the variables, by their ids."""
        results = self._values.copy()
        for k, key in self._leaves:
            results[k] = values[key]
        for k, node, arguments in self._steps:
            results[k] = _numeric(node, [results[argument] for argument in arguments])
        goal, *slacks = (
            sign * dense_value(results[k]) for sign, k in zip(self._signs, self._roots, strict=True)
        )
        return float(goal.ravel()[0]), slacks


def _numeric(node: Any, values: list[Any]) -> Any:
    return np.array([]) if 0 in node.shape else node.numeric(values)


def sense_of(problem: Any) -> float:
    """Return 1 where the objective is to be minimised, −1 where it is to be maximised."""
    return -1.0 if isinstance(problem.objective, cp.Maximize) else 1.0


def expression_of(constraint: Any) -> Any:
    """Return what has to be zero, or of one sign."""
    return constraint.expr if isinstance(constraint, (Equality, Inequality)) else constraint.args[0]


def dense_value(value: Any) -> NDArray[np.float64]:
    """Return the real part of a value as a dense array."""
    array = value.toarray() if sp.issparse(value) else np.asarray(value)
    return np.asarray(array.real, dtype=np.float64)
