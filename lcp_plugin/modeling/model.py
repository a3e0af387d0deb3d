"""From a list of cvxpy constraints to (M, q, lower, upper), and back to values, duals and a status."""

from __future__ import annotations

import inspect
import warnings
import weakref
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy.constraints.zero import Equality, Zero

from ..checks import FloatVector
from ..errors import ModelWarning, UnsupportedModel
from ..problem.lcp import LCP
from .builder import Builder
from .compiled_model import Model
from .constraint import Complements

__all__ = ["Model", "build", "build_from", "pair_residual", "stated_in_cvxpy"]


def pair_residual(pair: Complements) -> FloatVector | None:
    """Return the natural residual of each row of a pair at the present values; None where one is missing."""
    values = [side.expression.value for side in (pair.first, pair.second)]
    if any(value is None for value in values):
        return None
    builder = Builder([pair], {})
    builder.add_pair(pair)
    if builder.slacks:
        return np.abs(np.minimum(*(np.ravel(value, order="F") for value in values)))
    rows = builder.rows[-1]
    z = np.concatenate([np.ravel(variable.value, order="F") for variable in builder.variables])
    w = rows.sign * (builder.matrix(rows.function) @ z + rows.function.offset)
    x, low, high = z[rows.columns], builder.lower[rows.columns], builder.upper[rows.columns]
    residual: FloatVector = np.abs(np.minimum(np.maximum(w, x - high), x - low))
    return residual


def build(constraints: list[Any], memo: dict[Any, Any] | None = None) -> Model:
    """Return the LCP that a list of complementarities and equalities states.

    Raises
    ------
    UnsupportedModel
        Naming the constraint or variable that stands in the way, and the remedy.
    """
    builder = Builder(constraints, {} if memo is None else memo)
    for constraint in constraints:
        if isinstance(constraint, (Equality, Zero)):
            builder.add_equation(constraint)
    for constraint in constraints:
        if isinstance(constraint, Complements):
            builder.add_pair(constraint)
        elif not isinstance(constraint, (Equality, Zero)):
            raise UnsupportedModel(
                f"the constraint {constraint} stands alone beside complementarities; make it part of a pair, as in "
                f"complements({constraint}, F >= 0)"
            )
    for side in builder.unbounded:
        warnings.warn(
            f"{side} has no bounds, so that complements({side}, F) means F == 0; declare the variable with "
            "nonneg=True, or write F == 0 if that is what is meant",
            ModelWarning, stacklevel=_level_of_caller(),
        )
    return builder.finished()


def _level_of_caller() -> int:
    """Return the stacklevel at which somebody else's code called this package, or cvxpy, which called it."""
    own = {__package__.partition(".")[0], cp.__name__}
    frame, level = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in own:
        frame, level = frame.f_back, level + 1
    return level


def stated_in_cvxpy(problem: LCP) -> Any:
    """Return the ComplementarityProblem in one variable z that states an LCP."""
    from .constraint import box, complements
    from .registration import ComplementarityProblem

    if problem.n == 0:  # older versions of cvxpy have no empty variables
        return ComplementarityProblem([])
    z = cp.Variable(problem.n, name="z")
    F = problem.csr @ z + problem.q
    return ComplementarityProblem([complements(box(z, problem.lower, problem.upper), F)])


_memos: weakref.WeakKeyDictionary[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()


def build_from(problem: Any) -> Model:
    """Return the model of a cvxpy problem; what depends on no parameter is kept for the next call."""
    if not isinstance(problem, cp.Problem):
        kind = type(problem).__name__
        raise UnsupportedModel(f"a cvxpy problem is needed, got {kind}; write ComplementarityProblem([…])")
    if not problem.objective.args[0].is_constant():
        raise UnsupportedModel(
            "a complementarity problem has no objective; write cp.Minimize(0), or state optimality conditions as pairs"
        )
    return build(problem.constraints, _memos.setdefault(problem, {}))
