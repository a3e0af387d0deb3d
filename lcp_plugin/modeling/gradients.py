"""``problem.backward()`` and ``problem.derivative()`` after our solves: what cvxpy's leaves ask, and what they get."""

from __future__ import annotations

from typing import Any, Protocol

import cvxpy as cp
import numpy as np

from ..errors import UnsupportedModel
from . import _compat
from .model_derivative import Changes

#: They tie the entries of a parameter to each other, or make it no real number.
UNDIFFERENTIABLE = (
    *("boolean", "integer", "symmetric", "diag", "PSD", "NSD", "sparsity", "hermitian", "complex", "imag"),
)


class SolutionMap(Protocol):
    """How a solution changes with parameters, in both directions."""

    def pushed(self, changes: Changes) -> tuple[Changes, list[tuple[Any, Any]]]:
        """Return the changes of variables and of dual values."""

    def pulled(self, by_variable: Changes, by_dual: Changes) -> Changes:
        """Return the gradients by parameters."""


class Differentiable:
    """A solution that answers for `backward` and `derivative` of its problem.

    Parameters
    ----------
    solution : SolutionMap
    parameters : list of cvxpy.Parameter
    constraints : list of cvxpy constraint
        Those whose dual values may have a gradient.
    """

    def __init__(self, solution: SolutionMap, parameters: list[Any], constraints: list[Any]) -> None:
        self._solution, self._parameters, self._constraints = solution, parameters, constraints

    def backward(self, problem: Any) -> None:
        """Set the gradients of all parameters from those of variables and dual variables; a variable has 1 by default.

        Raises
        ------
        UnsupportedModel
            Where a gradient has not the shape of its variable, or is not finite.
        """
        by_variable = {
            variable.id: _checked(variable, "gradient", 1.0) for variable in problem.variables()
        }
        duals = {constraint.id: constraint.dual_variables[0] for constraint in self._constraints}
        by_dual = {key: _checked(dual, "gradient", 0.0) for key, dual in duals.items() if dual.gradient is not None}
        gradients = self._solution.pulled(by_variable, by_dual)
        for parameter in self._parameters:
            parameter.gradient = np.zeros(parameter.shape) + gradients.get(parameter.id, 0.0)

    def derivative(self, problem: Any) -> None:
        """Set the changes of all variables and dual variables from those of the parameters; 0 by default.

        Raises
        ------
        UnsupportedModel
            Where a change has not the shape of its parameter, or is not finite.
        """
        changes = {parameter.id: _checked(parameter, "delta", 0.0) for parameter in self._parameters}
        moved, duals = self._solution.pushed(changes)
        for variable in problem.variables():
            variable.delta = moved.get(variable.id, np.zeros(variable.shape))
        for constraint, change in duals:
            constraint.dual_variables[0].delta = change


def _checked(leaf: Any, name: str, default: float) -> Any:
    """Return what a user set as gradient or delta of a leaf."""
    given = getattr(leaf, name)
    if given is None:
        return np.full(leaf.shape, default)
    values = given.toarray() if hasattr(given, "toarray") else np.asarray(given)
    if values.dtype.kind not in "fiu" or values.shape != leaf.shape or not np.isfinite(values).all():
        raise UnsupportedModel(
            f"the {name} of {leaf.name()} must be finite real numbers of its shape {leaf.shape}, got {given!r}; leave "
            f"it None for {default:g} everywhere"
        )
    return values.astype(np.float64)


def differentiable_parameters(problem: Any) -> list[Any]:
    """Return the parameters of a problem, those in bounds of variables included.

    Raises
    ------
    UnsupportedModel
        Where one is an integer, a Boolean or complex, or has entries that are tied to each other.
    """
    bounds = [bound for v in problem.variables() for bound in _compat.attribute_expressions(v) or ()]
    stated = [parameter for bound in bounds if isinstance(bound, cp.Expression) for parameter in bound.parameters()]
    parameters = list({parameter.id: parameter for parameter in (*problem.parameters(), *stated)}.values())
    for parameter in parameters:
        for name in UNDIFFERENTIABLE:
            if not (parameter.attributes.get(name) is None or parameter.attributes.get(name) is False):
                raise UnsupportedModel(
                    f"parameter {parameter.name()} has the attribute {name!r}, so that its entries cannot move freely "
                    "and have no gradients of their own; use a plain parameter, nonneg or with bounds, and build the "
                    "matrix from it, or leave requires_grad out"
                )
    return parameters


def values_of_parameters(parameters: list[Any]) -> Changes:
    """Return copies of the present values by the ids of the parameters."""
    values = {parameter.id: _compat.leaf_value(parameter) for parameter in parameters}
    return {key: value.copy() for key, value in values.items() if value is not None}
