"""One complementarity problem of cvxpy for many values of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import cvxpy as cp
import numpy as np

from ..errors import InvalidProblem, UnsupportedModel
from ..solving.batch import solve_batch
from ..solving.batch_result import BatchResult
from .model import Model


class ModelBatch:
    """The answers to one model for many values of its parameters.

    Attributes
    ----------
    batch : BatchResult
        Of the LCPs behind it: status, residuals, a Result each.
    models : list of Model
        The way from each of them back to the variables.
    """

    def __init__(self, batch: BatchResult, models: list[Model]) -> None:
        self.batch, self.models = batch, models

    def value(self, variable: cp.Variable) -> Any:
        """Return the values of a variable of the model, shape (B, *its shape); NaN where there is no answer.

        Raises
        ------
        UnsupportedModel
            Where it is no variable of the model.
        """
        if not any(variable is one for model in self.models[:1] for one in model.variables):
            raise UnsupportedModel(f"{variable} is no variable of the problem; ask for one of its own")
        each = [model.values(z)[variable.id] for model, z in zip(self.models, self.batch.z, strict=True)]
        return np.array(each)

    def __repr__(self) -> str:
        return f"ModelBatch({self.batch!r})"


def solve_for(
    problem: cp.Problem, parameters: Mapping[cp.Parameter, Any], build: Callable[[Any], Model], options: dict[str, Any]
) -> ModelBatch:
    """Return the answers for stacked values of the parameters, which have their present values again afterwards.

    Raises
    ------
    InvalidProblem
        Where the stacks are not equally long, or a value has not the parameter's shape.
    """
    stacks = {parameter: np.asarray(values) for parameter, values in parameters.items()}
    counts = {parameter.name(): stack.shape[:1] for parameter, stack in stacks.items()}
    for parameter, stack in stacks.items():
        if stack.shape[1:] != parameter.shape or stack.ndim == 0 or len(set(counts.values())) > 1:
            raise InvalidProblem(
                f"{parameter.name()} must be a stack of shape (B, {', '.join(map(str, parameter.shape))}), B the same "
                f"for all parameters, got {stack.shape}"
            )
    if not stacks:
        raise InvalidProblem("give at least one parameter with its stacked values, as in {parameter: values}")
    before, models = {parameter: parameter.value for parameter in stacks}, []
    try:
        for k in range(next(iter(stacks.values())).shape[0]):
            for parameter, stack in stacks.items():
                parameter.value = stack[k]
            models.append(build(problem))
    finally:
        for parameter, value in before.items():
            parameter.value = value
    return ModelBatch(solve_batch([model.lcp("solve_batch") for model in models], **options), models)
