"""Internals of cvxpy: the location of its atoms, and values with sparse constants kept."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy import settings
from cvxpy.atoms.affine.add_expr import AddExpression
from cvxpy.atoms.affine.binary_operators import DivExpression, MulExpression, multiply
from cvxpy.atoms.affine.concatenate import Concatenate
from cvxpy.atoms.affine.diag import diag_mat, diag_vec
from cvxpy.atoms.affine.hstack import Hstack
from cvxpy.atoms.affine.index import index, special_index
from cvxpy.atoms.affine.promote import Promote
from cvxpy.atoms.affine.sum import Sum
from cvxpy.atoms.affine.transpose import transpose
from cvxpy.atoms.affine.unary_operators import NegExpression
from cvxpy.atoms.affine.vstack import Vstack
from cvxpy.atoms.affine.wraps import Wrap
from cvxpy.atoms.pnorm import Pnorm
from cvxpy.constraints import Equality, Inequality, NonNeg, NonPos, Zero
from cvxpy.error import SolverError
from cvxpy.reductions.eliminate_pwl.canonicalizers import CANON_METHODS
from numpy.typing import NDArray

from ..core.checks import Array, normalize_bounds
from ..core.errors import UnsupportedModel
from ..core.names import UNLABELED, listed
from ..expressions.rows import uniform
from ..problems.statement import STATUS_ELSEWHERE

LONGEST_NAME = 80  # characters of a constraint in a message
# in a text of cvxpy: an array of numbers, or an end that is cut
PRINTED_NUMBER = re.compile(r"\[ *-?\d+\.|…$")
# names of atoms that are private
ATOMS = re.compile(r"(?:Promote|reshape)\((\w[\w.]*), \([\d, ]*\)(?:, F)?\)|(Power|Pnorm)Approx")
WHOLE_SUM = re.compile(r"Sum\(([^(),]*), None, False\)")  # cvxpy's text of sum(x)


SUM = (AddExpression,)
NEGATIVE = (NegExpression,)
ELEMENTWISE = (multiply, DivExpression)
DIVISION = (DivExpression,)
PRODUCTS = (MulExpression, DivExpression)
MATRIX_PRODUCT = (MulExpression,)
ENTRY_SUM = (Sum,)
BROADCAST = (Promote, cp.broadcast_to)
TRANSPOSE = (transpose,)
STACKS: dict[Any, Any] = {Hstack: sp.hstack, Vstack: sp.vstack}
SELECTION = (index, special_index, Wrap)
#: Atoms whose numeric accepts sparse arrays and returns sparse arrays, or few numbers.
KEEP_SPARSE: tuple[Any, ...] = (*SUM, *NEGATIVE, *MATRIX_PRODUCT, *ENTRY_SUM, *SELECTION)

#: Atoms whose every entry is an entry of an argument, or zero.
REORDERS = diag_mat, diag_vec, cp.reshape, Concatenate, cp.upper_tri, cp.real, cp.conj
GATHERS = (*SELECTION, *BROADCAST, *TRANSPOSE, *STACKS, *REORDERS)
EXTREMES = cp.max, cp.min, cp.maximum, cp.minimum, cp.norm_inf, cp.sum_largest
NONSMOOTH = (*EXTREMES, cp.abs, cp.huber, cp.norm1, Pnorm)
#: Atoms with a graph of inequalities, and the functions of (atom, arguments) that return value and inequalities.
KINKS = {atom: graph for atom, graph in CANON_METHODS.items() if atom is not cp.cumsum}


def by_id(objects: Iterable[Any]) -> dict[int, Any]:
    """Return variables, parameters or constraints by their ids, each once."""
    return {item.id: item for item in objects}


def postorder(roots: Sequence[Any], stop: Container[int] = ()) -> list[Any]:
    """Return the nodes below the roots once each, arguments first; nothing below a node whose id is in `stop`.

    Without recursion: a sum written in a Python loop may be thousands of atoms deep.
    """
    nodes, seen, stack = [], set(), [(root, False) for root in reversed(roots)]
    while stack:
        node, is_expanded = stack.pop()
        if is_expanded:
            nodes.append(node)
        elif id(node) not in seen:
            seen.add(id(node))
            stack.append((node, True))
            if id(node) not in stop:
                stack.extend((argument, False) for argument in reversed(node.args))
    return nodes


def leaf_value(leaf: Any) -> Any:
    """Return the value of a constant or parameter: None, an array, or a two-dimensional CSC array."""
    # The value of a parameter with a sparsity pattern is dense, with a warning.
    is_patterned = getattr(leaf, "sparse_idx", None) is not None
    value = leaf.value_sparse if is_patterned and leaf._value is not None else leaf.value
    if sp.issparse(value):
        return sp.csc_array(value) if value.ndim == 2 else value.toarray()
    return None if value is None else np.asarray(value)


def constant_numeric(node: cp.Expression, values: list[Any]) -> Any:
    """Return the value of an atom of constants in the atom's shape; a sparse 2-D value stays sparse, as CSC."""
    if isinstance(node, BROADCAST):
        value = np.broadcast_to(dense(values[0]), node.shape)
    elif not any(map(sp.issparse, values)):
        value = node.numeric(values)
    elif isinstance(node, TRANSPOSE):
        value = values[0].T
    elif isinstance(node, cp.kron):
        value = sp.kron(*values)
    elif isinstance(node, diag_mat):
        value = values[0].diagonal(node.k)
    elif isinstance(node, DIVISION) and uniform(values[1]):
        value = values[0] / uniform(values[1])
    elif type(node) in STACKS and len(node.shape) == 2:
        value = STACKS[type(node)]([v if sp.issparse(v) else np.atleast_2d(v) for v in values])
    elif isinstance(node, KEEP_SPARSE) and all(part.ndim <= 2 for part in values):
        value = node.numeric(values)
    else:
        value = node.numeric(list(map(dense, values)))
    if sp.issparse(value) and value.shape == node.shape and value.ndim == 2:
        return sp.csc_array(value)
    array: NDArray[Any] = np.asarray(dense(value))
    if array.size != node.size:
        raise UnsupportedModel(
            f"{name_of(node)} has the shape {node.shape}, but its value {array.shape}; write it in another way"
        )
    return array.reshape(node.shape, order="F")


def dense(value: Any) -> Any:
    """Return a value as a dense array."""
    return value.toarray() if sp.issparse(value) else value


def stored_entries(value: Any) -> Any:
    """Return the stored entries of a sparse array, and all entries of another value, as a vector."""
    return np.ravel(value.data if sp.issparse(value) else value)


def by_columns(value: object) -> Any:
    """Return the real parts of all entries of a value as a vector, column by column."""
    return np.ravel(dense_value(value), order="F")


class UnsolvableModel(UnsupportedModel, SolverError):  # type: ignore[misc]
    """Error for a model that no algorithm supports: an UnsupportedModel and cvxpy's SolverError."""


@contextmanager
def solver_errors() -> Iterator[None]:
    """Raise an UnsupportedModel from inside cvxpy as an error that is also a SolverError."""
    try:
        yield
    except UnsupportedModel as error:
        if isinstance(error, SolverError):
            raise
        raise UnsolvableModel(str(error)) from error


def entry_of(variable: cp.Variable, k: int) -> str:
    """Return the name of entry k of a variable, column by column: h[2]."""
    return f"{variable.name()}{_index(variable, k, '[{}]') if variable.shape else ''}"


def row_of(stated: Any, k: int, constraint: Any = None, number: int | None = None) -> str:
    """Return the name of entry k of a constraint, or of its expression: market[2] by a label, F(x), entry 2 without.

    A text with arrays of numbers is replaced by the number of the constraint and its variables.
    """
    constraint = stated if constraint is None else constraint
    if (name_of_row := getattr(constraint, "name_of_row", None)) is not None:  # of an agent
        return name_of_row(k)
    label = getattr(constraint, "label", None)
    name = label or name_of(stated)
    if not label and number is not None and PRINTED_NUMBER.search(name):
        name = f"{UNLABELED} {number} ({listed(variable.name() for variable in constraint.variables())})"
    return name + (_index(stated, k, "[{}]" if label else ", entry {}") if stated.size > 1 else "")


def _index(stated: Any, k: int, form: str) -> str:
    return form.format(", ".join(map(str, np.unravel_index(k, stated.shape, order="F"))))


def name_of(expression: cp.Expression) -> str:
    """Return cvxpy's text of an expression in one line, of at most LONGEST_NAME characters."""
    try:
        text = WHOLE_SUM.sub(r"sum(\1)", " ".join(str(expression).split()))
        text = ATOMS.sub(r"\1\2", text)
    except RecursionError:
        text = f"a deep {type(expression).__name__}"
    return text if len(text) <= LONGEST_NAME else f"{text[: LONGEST_NAME - 1]}…"


def attribute_bounds(variable: cp.Variable) -> tuple[Any, Any]:
    """Return the bounds that a variable's attributes state: nonneg, pos, nonpos, neg, bounds."""
    attributes = variable.attributes
    lower: Array = 0.0 if attributes.get("nonneg") or attributes.get("pos") else -np.inf
    upper: Array = 0.0 if attributes.get("nonpos") or attributes.get("neg") else np.inf
    if (stated := attributes.get("bounds")) is not None:
        low, high = (bound_value(bound, variable) for bound in stated)
        lower, upper = np.maximum(lower, low), np.minimum(upper, high)
    return normalize_bounds(lower, upper)


def attribute_expressions(variable: cp.Variable) -> tuple[Any, Any]:
    """Return the stated bounds of a variable with the attribute "bounds", which may hold parameters."""
    attributes, (lower, upper) = variable.attributes, variable.attributes["bounds"]
    lower = cp.maximum(0.0, lower) if attributes.get("nonneg") or attributes.get("pos") else lower
    upper = cp.minimum(0.0, upper) if attributes.get("nonpos") or attributes.get("neg") else upper
    return lower, upper


def bound_value(bound: Any, owner: object) -> Any:
    """Return the user's bound as a float64 array; raise if it is not a number or an array of numbers."""
    is_expression = isinstance(bound, cp.Expression)
    if is_expression and (bound.variables() or bound.value is None):
        what = "contains a variable" if bound.variables() else "has no value"
        raise UnsupportedModel(f"the bound {bound} of {owner} {what}; set a number or its value")
    array = np.asarray(dense(bound.value if is_expression else bound))
    if array.dtype.kind not in "fiub" or np.isnan(array).any():
        raise UnsupportedModel(f"a bound of {owner} must be real, ±inf for none, got {bound!r}")
    return array.astype(np.float64)


#: cvxpy's word for a status.
CVXPY_STATUS = {status: words[1] for status, words in STATUS_ELSEWHERE.items()}


def statistics(result: Any) -> dict[str, Any]:
    """Return cvxpy's record of a run, without the values."""
    setup = getattr(result, "setup_seconds", None)
    times = {settings.SOLVE_TIME: result.seconds, settings.SETUP_TIME: setup}
    return times | {settings.NUM_ITERS: result.iterations, settings.EXTRA_STATS: result}


EQUATIONS = (Equality, Zero)
INEQUALITIES = (Inequality, NonPos, NonNeg)


def values_below(roots: list[Any]) -> dict[int, Any]:
    """Return the values of all nodes of expressions, by their ids, at the present values of variables and parameters.

    cvxpy's ``value`` queries all parameters below every node, and recurses from node to node, however deep they are.
    Here each value is computed once.
    """
    values: dict[int, Any] = {}
    for node in postorder(roots):
        if isinstance(node, cp.Variable):
            values[id(node)] = dense(leaf_value(node))
        elif not node.args:
            values[id(node)] = node.value
        else:
            arguments = [values[id(argument)] for argument in node.args]
            values[id(node)] = np.zeros(0) if 0 in node.shape else node.numeric(arguments)
    return values


def why_not(problem: cp.Problem) -> list[str]:
    """Return the reasons why a problem is not a quadratic program, in the user's names."""
    reasons = []
    for variable in problem.variables():
        for attribute in ("boolean", "integer", "PSD", "NSD", "hermitian"):
            if np.any(variable.attributes[attribute]):
                reasons.append(f"variable {variable.name()} is {attribute}")
        if variable.is_complex():
            reasons.append(f"variable {variable.name()} is complex; take real and imaginary part")
    for constraint in problem.constraints:
        if isinstance(constraint, INEQUALITIES):
            if not expression_of(constraint).is_pwl():
                reasons.append(f"constraint {name_of(constraint)} is not piecewise linear")
        elif not isinstance(constraint, EQUATIONS):
            reasons.append(f"constraint {name_of(constraint)} is a {type(constraint).__name__}")
    if not (goal := problem.objective.args[0]).is_qpwa():
        reasons.append(f"the objective {name_of(goal)} is not quadratic or piecewise linear")
    return reasons


def sense_of(problem: cp.Problem) -> float:
    """Return 1 if the objective is minimized, −1 if it is maximized."""
    return -1.0 if isinstance(problem.objective, cp.Maximize) else 1.0


def expression_of(constraint: cp.Constraint) -> Any:
    """Return the expressions of a constraint that must be zero, or of one sign."""
    return constraint.expr if isinstance(constraint, (Equality, Inequality)) else constraint.args[0]


def dense_value(value: Any) -> NDArray[np.float64]:
    """Return the real part of a value as a dense array."""
    return np.asarray(np.asarray(dense(value)).real, dtype=np.float64)
