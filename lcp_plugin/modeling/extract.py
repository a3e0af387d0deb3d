"""From an affine cvxpy expression to the matrices of its variables: F(x) = M x + q.

The linear part is composed atom by atom along the expression tree; the offset is the expression's own value at
zero; one more evaluation checks both together. No variable is touched, nothing is canonicalized, and parameters
count as constants, disciplined or not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Hashable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.expressions.expression import Expression

from ..checks import FloatVector
from ..errors import UnsupportedModel
from . import _compat as atoms
from ._compat import name_of
from .linear_part import Blocks, Values, as_matrix, node_blocks

CHECK_SEED = 20
CHECK_TOLERANCE = 1e-11
#: They tie entries to each other or to a set, so that the columns would not be free.
FORBIDDEN_ATTRIBUTES = (
    *("symmetric", "diag", "PSD", "NSD", "hermitian", "sparsity"),
    *("complex", "imag", "boolean", "integer"),
)


@dataclass(frozen=True)
class AffineMap:
    """The expression as a sum of ``blocks[variable.id] @ variable`` and ``offset``, vectorised by columns.

    Parameters
    ----------
    blocks : dict
        Variable id → CSR array, shape (size of the expression, size of the variable). Read-only: it may be the
        array of a constant in the expression.
    offset : array, shape (size of the expression,)
    shape : tuple
        The shape of the expression.
    """

    blocks: dict[int, sp.csr_array]
    offset: FloatVector
    shape: tuple[int, ...]


def affine_map(
    expression: Any, *, memo: dict[Hashable, Any] | None = None, unknowns: Container[int] = ()
) -> AffineMap:
    """Return the map x ↦ M x + q that an affine expression states, compared with its value at one more point.

    Parameters
    ----------
    expression : cvxpy expression or constant
    memo : dict, optional
        Keeps what no parameter enters from one call to the next: give the same dict again.
    unknowns : container of int, optional
        The ids of nodes that count as variables, whatever they are; `key_of` says where their blocks are.

    Raises
    ------
    UnsupportedModel
        Where the expression is not affine, has a complex or non-finite constant, a parameter without a value,
        or a variable whose attributes change what its entries mean.

    Examples
    --------
    >>> x = cp.Variable(2)
    >>> F = affine_map(np.array([[2.0, -1.0], [0.0, 2.0]]) @ x + 3)
    >>> F.blocks[x.id].toarray(), F.offset
    (array([[ 2., -1.], [ 0.,  2.]]), array([3., 3.]))
    """
    root = Expression.cast_to_const(expression)
    kept: dict[Hashable, Any] = {} if memo is None else memo
    tree = _Tree(postorder(root, unknowns), unknowns)
    shapes = {key_of(node): node.shape for node in (*tree.variables, *tree.cuts)}
    for variable in tree.variables:
        check_attributes(variable)
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        constants = _constants(tree, kept)
        blocks = _linear_part(tree, constants, kept)
        offset = _evaluated(tree, constants, {key: np.zeros(shape) for key, shape in shapes.items()})
        if not _all_finite(offset):
            raise UnsupportedModel(f"{name_of(root)} is not finite at zero: its data overflow; scale the data down")
        _check(tree, constants, blocks, offset, shapes)
    return AffineMap(blocks, offset, root.shape)


def key_of(unknown: Any) -> int:
    """Return the key of a variable's blocks, its id, or of another node's that counts as one."""
    return int(unknown.id) if isinstance(unknown, cp.Variable) else ~id(unknown)


def constant_value(expression: Any) -> Any:
    """Return the value of an expression without variables, an array or a CSC array; raise where it is none."""
    value = _fold(postorder(expression, ()), _constant_value, {})
    _check_constant(expression, value)
    return value


class _Tree:
    """The nodes of an expression, arguments first, and the ids of those that variables or parameters enter."""

    def __init__(self, nodes: list[Any], unknowns: Container[int]) -> None:
        self.nodes = nodes
        self.root = nodes[-1]
        self.variables = [node for node in nodes if isinstance(node, cp.Variable)]
        #: Other nodes that count as variables.
        self.cuts = [node for node in nodes if id(node) in unknowns]
        free = {id(node) for node in (*self.variables, *self.cuts)}
        self.variable: set[int] = set()
        self.parametric: set[int] = set()
        #: Whose linear part depends on parameters.
        self.varying: set[int] = set()
        for node in nodes:
            below = [] if id(node) in free else [id(argument) for argument in node.args]
            if id(node) in free or not self.variable.isdisjoint(below):
                self.variable.add(id(node))
            if isinstance(node, cp.Parameter) or not self.parametric.isdisjoint(below):
                self.parametric.add(id(node))
            # Sums and gathers take no coefficient from a constant argument.
            takes_coefficients = not isinstance(node, (*atoms.SUM, *atoms.GATHERS))
            if id(node) in self.variable and any(
                key in self.varying or (takes_coefficients and key in self.parametric and key not in self.variable)
                for key in below
            ):
                self.varying.add(id(node))


def postorder(root: Any, stop: Container[int]) -> list[Any]:
    """Return the nodes below the root once each, arguments first; nothing below a node whose id is in `stop`.

    Without recursion: a sum written in a Python loop may be thousands of atoms deep.
    """
    nodes, seen, stack = [], set(), [(root, False)]
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


def _fold(nodes: list[Any], rule: Callable[[Any, list[Any]], Any], known: Values) -> Any:
    """Return the last node's result of ``rule(node, results of its arguments)``; drop results after their last use."""
    uses = Counter(id(argument) for node in nodes for argument in node.args)
    results: Values = {}
    for node in nodes:
        if id(node) in known:
            results[id(node)] = known[id(node)]
            continue
        results[id(node)] = rule(node, [results[id(argument)] for argument in node.args])
        for argument in node.args:
            uses[id(argument)] -= 1
            if not uses[id(argument)]:
                del results[id(argument)]
    return results[id(nodes[-1])]


def _constants(tree: _Tree, kept: dict[Hashable, Any]) -> Values:
    """Return the values of the largest sub-expressions without variables, those that meet variables checked."""
    meets_variables = {id(tree.root)}
    meets_parameters: set[int] = set()
    for node in tree.nodes:
        if id(node) in tree.variable:
            meets_variables.update(map(id, node.args))
        elif id(node) in tree.parametric:
            meets_parameters.update(map(id, node.args))
    values: Values = {}
    for node in tree.nodes:
        key = id(node)
        is_checked = key in meets_variables
        if key in tree.variable or not (is_checked or (key in meets_parameters and key not in tree.parametric)):
            continue
        if ("value", key) in kept:
            values[key] = kept["value", key][1]
            continue
        values[key] = _fold(postorder(node, values), _constant_value, values)
        if is_checked:
            _check_constant(node, values[key])
        if key not in tree.parametric:
            kept["value", key] = (node, values[key])
    return values


def _constant_value(node: Any, values: list[Any]) -> Any:
    if not node.args:
        value = atoms.leaf_value(node)
        if value is None:
            raise UnsupportedModel(f"parameter {name_of(node)} has no value; set {name_of(node)}.value before solving")
        return value
    return atoms.shaped(node, atoms.constant_numeric(node, values))


def _check_constant(node: Any, value: Any) -> None:
    if np.iscomplexobj(value):
        raise UnsupportedModel(f"{name_of(node)} is complex; write its real and imaginary parts as two expressions")
    entries = value.data if sp.issparse(value) else value
    if not _all_finite(entries):
        wrong = np.ravel(entries)[~np.isfinite(np.ravel(entries))][0]
        raise UnsupportedModel(f"constants must be finite, but {name_of(node)} holds {wrong}; repair that entry")


def _evaluated(
    tree: _Tree, constants: Values, point: dict[int, FloatVector], sizes: list[float] | None = None
) -> FloatVector:
    """Return the expression's value where the variables have the given values, by columns.

    `sizes`, where it is given, gets the largest number of each value on the way.
    """
    known = {**constants, **{id(node): point[key_of(node)] for node in tree.cuts}}

    def value(node: Any, values: list[Any]) -> Any:
        result = point[node.id] if isinstance(node, cp.Variable) else atoms.dense_numeric(node, values)
        if sizes is not None:
            sizes.append(float(np.abs(result).max(initial=0.0)))
        return result

    result = _fold(postorder(tree.root, known), value, known)
    return np.array(atoms.dense(result), dtype=np.float64).ravel(order="F")


def _check(tree: _Tree, constants: Values, blocks: dict[int, sp.csr_array], offset: FloatVector, shapes: Any) -> None:
    """Raise where M x + q is not the expression's value at a point, up to rounding."""
    generator = np.random.default_rng(CHECK_SEED)
    point = {key: generator.random(shape) + 0.5 for key, shape in shapes.items()}
    columns = {key: np.ravel(value, order="F") for key, value in point.items()}
    actual = _evaluated(tree, constants, point)
    error = np.abs(sum((blocks[key] @ columns[key] for key in blocks), start=offset) - actual)
    doubtful = np.flatnonzero(~(error <= CHECK_TOLERANCE * np.abs(actual)))
    if not doubtful.size:
        return
    # Cancellation inside a row, then inside the expression: only now worth the second look.
    size = sum((abs(blocks[key][doubtful]) @ columns[key] for key in blocks), start=np.abs(offset[doubtful]))
    sizes = [0.0]
    _evaluated(tree, constants, point, sizes)
    wrong = doubtful[~(error[doubtful] <= CHECK_TOLERANCE * (size + max(sizes)))]
    if wrong.size and not np.isfinite(error[wrong[0]]):
        raise UnsupportedModel(
            f"{name_of(tree.root)} overflows in entry {wrong[0]}, multiplied out or at a point near 1; write it in "
            "other units"
        )
    if wrong.size:
        raise UnsupportedModel(
            f"{name_of(tree.root)} differs from its own matrices by {error[wrong[0]]:.1e} in entry {wrong[0]}; "
            "an atom in it is not what cvxpy evaluates: write the expression with products, sums and indices"
        )


def _linear_part(tree: _Tree, constants: Values, kept: dict[Hashable, Any]) -> dict[int, sp.csr_array]:
    known: Values = {**{key: {} for key in constants}, **{id(node): {key_of(node): 1.0} for node in tree.cuts}}
    for node in tree.nodes:
        if ("linear", id(node)) in kept:
            known[id(node)] = kept["linear", id(node)][1]
    worth_keeping = {id(argument) for node in tree.nodes if id(node) in tree.varying for argument in node.args}
    worth_keeping.add(id(tree.root))

    def rule(node: Any, arguments: list[Blocks]) -> Blocks:
        blocks = node_blocks(node, arguments, constants)
        if node is tree.root:
            blocks = {key: as_matrix(block, node.size) for key, block in blocks.items()}
        if id(node) in worth_keeping and id(node) not in tree.varying:
            kept["linear", id(node)] = (node, blocks)
        return blocks

    blocks: Blocks = _fold(postorder(tree.root, known), rule, known)
    # The root of one call may have been an argument in an earlier one.
    return {key: as_matrix(block, tree.root.size) for key, block in blocks.items()}


def check_attributes(variable: cp.Variable) -> None:
    """Raise where the entries of a variable are not free.

    Raises
    ------
    UnsupportedModel
        Naming the attribute that ties or restricts them.
    """
    for attribute in FORBIDDEN_ATTRIBUTES:
        state = variable.attributes.get(attribute)
        if not (state is None or state is False):
            raise UnsupportedModel(
                f"variable {variable.name()} has the attribute {attribute!r}, which ties or restricts its entries; "
                "use a plain variable, with bounds or nonneg where needed"
            )


def _all_finite(values: Any) -> bool:
    return bool(np.isfinite(np.sum(values))) or bool(np.isfinite(values).all())
