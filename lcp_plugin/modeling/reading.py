"""Reader of cvxpy expressions as rows over variables, or over parameters.

Node by node along the expression tree, by a rule for each atom. No variable is changed, nothing is canonicalized, and
parameters count as constants, disciplined or not. Results are compared with the values of cvxpy, before a solution is
returned (:mod:`lcp_plugin.modeling.registration`).

A rule builds rows from sums, products and functions of `expressions`. It takes a compiler, the node, and its arguments
as they were read: arrays and sparse matrices for constants, else rows. It returns the node's entries by columns.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from operator import is_
from typing import Any, TypeAlias

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.atoms.elementwise.power import Power
from cvxpy.atoms.geo_mean import GeoMean
from cvxpy.atoms.prod import Prod
from cvxpy.atoms.quad_form import QuadForm
from cvxpy.expressions.expression import Expression

from ..core.checks import Indices
from ..core.errors import UnsupportedModel
from ..expressions import functions
from ..expressions import rows as arrays
from ..expressions.functions import SAME, Function
from ..expressions.rows import Compiler, Rows, added, stacked
from . import _compat as atoms
from ._compat import name_of, postorder

Rule: TypeAlias = Callable[[Compiler, Any, list[Any]], Rows]


@cache
def affine_rule(atom: type) -> Rule | None:
    """Return the rule of a class of affine atoms; cached, because cvxpy's classes are slow."""
    return next((rule for classes, rule in AFFINE.items() if issubclass(atom, classes)), None)


def rule_of(node: cp.Expression) -> Rule | None:
    """Return the rule for an atom that is not affine by its class; None if there is no rule."""
    if node.is_atom_affine() and not isinstance(node, Power):
        return _by_jacobian
    return next((SMOOTH[atom] for atom in type(node).__mro__ if atom in SMOOTH), None)


def refused(node: cp.Expression) -> UnsupportedModel:
    """Return the error that names an atom without a rule, and a remedy."""
    if isinstance(node, atoms.NONSMOOTH):
        return UnsupportedModel(
            f"{name_of(node)} is not smooth, so it has no derivative at its kink; replace the kink by a variable "
            "and a pair: complements(s >= 0, x + s >= 0) makes s = max(−x, 0) and x + 2 s = |x|"
        )
    return UnsupportedModel(
        f"{name_of(node)} is not affine, and the atom {type(node).__name__} has no derivative here; write it with "
        "products, quotients, powers, exp, log, log1p, logistic, entr and sums, or linearize"
    )


def linearised(node: cp.Expression, arguments: list[Any], values: list[Any]) -> Rows:
    """Return the atom's tangent at dense values of its arguments, by the derivative that cvxpy gives."""
    parts: list[Any] = [atoms.dense(atoms.constant_numeric(node, values))]
    for k, (argument, value) in enumerate(zip(arguments, values, strict=True)):
        if isinstance(argument, Rows):
            change = added([argument, -value], argument.shape)
            parts.append(change.applied(_cvxpy_jacobian(node, k, values), node.shape))
    return added(parts, node.shape)


def _by_jacobian(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    """Return the tangent of an affine atom, which is the atom, at the offsets of its arguments."""
    values = [
        part.offset.reshape(part.shape, order="F") if isinstance(part, Rows) else atoms.dense(part)
        for part in arguments
    ]
    return linearised(node, arguments, values)


def _cvxpy_jacobian(node: cp.Expression, k: int, values: list[Any]) -> sp.csr_array:
    """Return cvxpy's derivative of an atom by argument k.

    cvxpy's affine atoms take parameters for constants, with gradient zero: a variable replaces them here.
    """
    try:
        stand_in = node
        if not node.args[k].variables():
            stand_ins: list[Any] = [cp.Constant(value) for value in values]
            stand_ins[k] = cp.Variable(node.args[k].shape)
            stand_in = node.copy(stand_ins)
        jacobian = stand_in._grad(values)[k]
        if jacobian is None:
            raise ValueError("outside its domain, or an atom without a derivative")
        matrix = sp.csr_array(jacobian if sp.issparse(jacobian) else np.atleast_2d(jacobian))
        if matrix.shape != (values[k].size, node.size):
            raise ValueError(f"its derivative has the shape {matrix.shape}")
    except Exception as error:  # any error of an atom of cvxpy
        raise UnsupportedModel(
            f"cvxpy gives no derivative of {name_of(node)} by its argument {name_of(node.args[k])} ({error}); make the "
            "value of this atom a parameter of its own, and multiply by its derivative yourself"
        ) from error
    return sp.csr_array(matrix.T)


# --- affine ---------------------------------------------------------------------------------------------------------


def _product_rows(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    left, right = arguments
    if isinstance(node, atoms.DIVISION):
        return compiler.elementwise(functions.QUOTIENT, left, right, node.shape)
    if isinstance(node, atoms.ELEMENTWISE) or () in (left.shape, right.shape):
        return compiler.elementwise(functions.PRODUCT, left, right, node.shape)
    return compiler.product(left, right, node.shape)


def _gathered(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    """Let the atom move entry numbers instead of entries: the result shows which rows it takes."""
    parts = [Rows.of(argument) for argument in arguments]
    if isinstance(node, cp.reshape) and node.order == "F":
        return replace(parts[0], shape=node.shape)
    ends = np.cumsum([part.size for part in parts])
    # 0 stands for an entry of nothing: padding.
    starts = [1.0, *(ends[:-1] + 1.0)]
    numbers = [
        arrays.entry_numbers(part.shape) + start for part, start in zip(parts, starts, strict=True)
    ]
    moved = atoms.dense(atoms.constant_numeric(node, numbers))
    return stacked(parts).taken(moved.ravel(order="F").astype(np.int64) - 1, node.shape)


def _summed(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    rows, axes = arguments[0], _summed_axes(node)
    kept = tuple(1 if axis in axes else length for axis, length in enumerate(rows.shape))
    return rows.summed(arrays.entries_behind(rows.shape, kept), node.shape)


AFFINE: dict[tuple[Any, ...], Rule] = {
    atoms.SUM: lambda _, node, arguments: added(arguments, node.shape),
    atoms.NEGATIVE: lambda _, node, arguments: arguments[0].scaled(-1.0),
    (*atoms.PRODUCTS, *atoms.ELEMENTWISE): _product_rows,
    atoms.BROADCAST: lambda _, node, arguments: arguments[0].spread(node.shape),
    atoms.GATHERS: _gathered,
    atoms.ENTRY_SUM: _summed,
}


# --- smooth ---------------------------------------------------------------------------------------------------------


def _summed_axes(node: cp.Expression) -> list[int]:
    count, axis = len(node.args[0].shape), getattr(node, "axis", None)
    return [k % count for k in (range(count) if axis is None else np.atleast_1d(axis).tolist())]


def _elementary(function: Function) -> Rule:
    return lambda compiler, node, arguments: compiler.emit(function, arguments[0])


def _with_constant(function: Function, constant: float) -> Rule:
    """Return the rule of a function of the argument and a constant."""
    return lambda compiler, node, arguments: compiler.emit(
        function, arguments[0], Rows.of(np.full(node.shape, constant))
    )


def _power(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    rows, value = arguments[0], node.p.value
    if value is None or not np.isfinite(value).all():
        raise UnsupportedModel(f"{name_of(node.p)} is {value} in {name_of(node)}; give a number")
    exponent = float(np.ravel(value)[0])
    if exponent == 0.0:  # a parameter may be
        return Rows({}, np.ones(rows.size), rows.shape)
    return rows if exponent == 1.0 else compiler.emit(functions.power(exponent), rows)


def _reduced(node: cp.Expression) -> Indices:
    """Return the entries of each result, along the node's axis: shape (entries, results)."""
    shape, axes = node.args[0].shape, _summed_axes(node)
    moved = np.moveaxis(arrays.entry_numbers(shape), axes, range(len(axes)))
    return moved.reshape((math.prod(shape[axis] for axis in axes), -1), order="F")


def _folded(compiler: Compiler, function: Function, terms: Rows, size: int) -> Rows:
    """Return a function of two arguments of all terms, in pairs of pairs.

    `size` results are computed at once: their terms at one position are consecutive.
    """
    left: list[Rows] = []
    count = terms.size // max(size, 1)
    while count > 1:
        half = count // 2 * size
        if count % 2:
            left.append(terms.taken(np.arange(2 * half, terms.size)))
        halves = np.arange(half), np.arange(half, 2 * half)
        terms = compiler.emit(function, *(terms.taken(places) for places in halves))
        count //= 2
    for other in left:
        terms = compiler.emit(function, terms, other)
    return terms


def _along_axis(function: Function) -> Rule:
    """Return the rule of an atom that folds a function along its axis."""

    def rule(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
        groups = _reduced(node)
        return _folded(compiler, function, arguments[0].taken(groups.ravel()), groups.shape[1])

    return rule


def _geometric_mean(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    if getattr(node, "axis", None) is not None:
        raise UnsupportedModel(f"{name_of(node)} has an axis; write one geo_mean for each row")
    rows, weights = arguments[0], [float(weight) for weight in node.w]
    kept = np.flatnonzero(np.broadcast_to(getattr(node, "_keep", True), (rows.size,)))
    kept = kept if kept.size == len(weights) else np.arange(rows.size)
    factors = [(rows.taken(kept[k : k + 1]), weight) for k, weight in enumerate(weights) if weight]
    powers = [compiler.emit(functions.power(weight), row) for row, weight in factors]
    return _folded(compiler, functions.PRODUCT, stacked(powers), 1)


def _quad_over_lin(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    groups = _reduced(node)
    squares = compiler.emit(functions.SQUARE, Rows.of(arguments[0]).taken(groups.ravel(order="F")))
    sums = squares.summed(np.arange(groups.size) // groups.shape[0], (groups.shape[1],))
    below = arguments[1]
    if not isinstance(below, Rows):
        return compiler.elementwise(functions.QUOTIENT, sums, below, sums.shape)
    # A quotient has derivatives for negative denominators.
    inverse = compiler.emit(functions.power(-1.0), below.spread(sums.shape))
    return compiler.emit(functions.PRODUCT, sums, inverse)


def _quad_form(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    x, P = Rows.of(arguments[0]), arguments[1]
    x = x.taken(np.arange(x.size))
    return compiler.product(x, compiler.product(P, x, x.shape), ())


def _relative_entropy(compiler: Compiler, node: cp.Expression, arguments: list[Any]) -> Rows:
    both = [Rows.of(argument).spread(node.shape) for argument in arguments]
    return compiler.emit(functions.RELATIVE_ENTROPY, *both)


#: By the class of the atom.
SMOOTH: dict[Any, Rule] = {
    Power: _power,
    cp.exp: _elementary(functions.EXP),
    cp.log: _elementary(functions.LOG),
    cp.log1p: _elementary(functions.LOG1P),
    cp.logistic: _with_constant(functions.LOG_ADD_EXP, 0.0),
    cp.entr: lambda *call: _with_constant(functions.RELATIVE_ENTROPY, 1.0)(*call).scaled(-1.0),
    cp.xexp: lambda compiler, _, u: compiler.emit(
        functions.PRODUCT, u[0], compiler.emit(functions.EXP, u[0])
    ),
    cp.rel_entr: _relative_entropy,
    cp.kl_div: lambda compiler, node, u: added(
        [_relative_entropy(compiler, node, u), Rows.of(u[0]).scaled(-1.0), u[1]], node.shape
    ),
    Prod: _along_axis(functions.PRODUCT),
    GeoMean: _geometric_mean,
    cp.log_sum_exp: _along_axis(functions.LOG_ADD_EXP),  # no exponential overflows
    cp.quad_over_lin: _quad_over_lin,
    QuadForm: _quad_form,
}


Values = dict[int, Any]
Memo = dict[int, tuple[Any, Any]]  # nodes and their results, by id

#: Attributes that tie entries to each other or to a set, so that the columns would not be free.
FORBIDDEN_ATTRIBUTES = "symmetric diag PSD NSD hermitian sparsity complex imag"
INTEGRAL = "boolean integer"


def folded(
    root: cp.Expression, rule: Callable[[Any, list[Any]], Any], known: Mapping[int, Any]
) -> Any:
    """Return the root's result of ``rule(node, results of its arguments)``; drop results after their last use.

    Parameters
    ----------
    root : cvxpy expression
    rule : callable
    known : dict
        Results by the ids of nodes, below which no node is read.
    """
    nodes = postorder([root], known)
    read = (node for node in nodes if id(node) not in known)
    uses = Counter(id(argument) for node in read for argument in node.args)
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
    return results[id(root)]


def rewritten(root: cp.Expression, change: Callable[[Any], Any]) -> Any:
    """Return an expression with change(node) for each node, arguments first; nodes without changes stay."""

    def rule(node: cp.Expression, arguments: list[Any]) -> Any:
        return change(node if all(map(is_, arguments, node.args)) else node.copy(arguments))

    return folded(root, rule, {})


class Reader:
    """Reader of the expressions of one model into one compiler.

    Parameters
    ----------
    memo : dict, optional
        Results that do not depend on parameters; give the same dict to the next reader.
    held : dict, optional
        From the ids of variables and parameters to their values. Then the parameters are the sources, and an atom
        without a rule is replaced by its tangent there. Without `held` the variables are the sources.
    takes_integers : bool
        Whether variables may be integers.

    Examples
    --------
    >>> x = cp.Variable(2)
    >>> F = Reader().rows(np.array([[2.0, -1.0], [0.0, 2.0]]) @ x + 3)
    >>> F.blocks[x.id].toarray(), F.offset
    (array([[ 2., -1.], [ 0.,  2.]]), array([3., 3.]))
    """

    def __init__(
        self, memo: Memo | None = None, held: Values | None = None, *, takes_integers: bool = False
    ) -> None:
        self.compiler, self._takes_integers = Compiler(), takes_integers
        self._memo = {} if memo is None else memo
        self._held, self._has_sources = held, held is not None
        self._known: Values = {key: result for key, (_, result) in self._memo.items()}
        self._kept: list[Any] = []  # nodes that must live: the id of a freed node is used again
        self._moving: set[int] = set()  # ids of nodes that depend on a parameter or a function

    def hold(self, sources: Mapping[int, Any]) -> None:
        """Let nodes be sources, by key, below which nothing is read; a parameter that an atom holds raises an error."""
        self._has_sources = True
        self._kept.extend(sources.values())
        for key, node in sources.items():
            self._known[id(node)] = Rows({key: 1.0}, np.zeros(node.size), node.shape)

    def rows(self, expression: cp.Expression) -> Rows:
        """Return the rows of an expression: Σ blocks[variable.id] · variable + offset, and results of functions.

        Raises
        ------
        UnsupportedModel
            If it has an atom without a rule, a complex or non-finite constant, a parameter without a value, or a
            variable whose attributes change the meaning of its entries.
        """
        root = Expression.cast_to_const(expression)
        self._kept.append(root)
        with np.errstate(all="ignore"):  # values that are not finite raise an error later
            result = folded(root, self._result, self._known)
            if not isinstance(result, Rows):
                self._take_constant(root, result)
            rows = Rows.of(result).spread(root.shape)
            blocks = {key: arrays.as_matrix(block, rows.size) for key, block in rows.blocks.items()}
            rows = replace(rows, blocks=blocks)
            if self._held is None:
                entries = [block.data for block in blocks.values()]
                if not all(np.isfinite(values).all() for values in (rows.offset, *entries)):
                    raise UnsupportedModel(
                        f"{name_of(root)} overflows, or is divided by 0; write it in other units"
                    )
                self._remember(root, rows)
        return rows

    def _result(self, node: cp.Expression, arguments: list[Any]) -> Any:
        key, rule = id(node), affine_rule(type(node))  # type: ignore[arg-type]
        below = list(map(id, node.args))
        hidden = hidden_parameters(node) if rule is None else []
        if hidden and self._has_sources:
            raise UnsupportedModel(
                f"{name_of(node)} holds {hidden[0].name()} where no derivative reaches it; write it with "
                "products, sums, exp and log"
            )
        if isinstance(node, cp.Parameter) or hidden or not self._moving.isdisjoint(below):
            self._moving.add(key)
        result = self._computed(node, rule, arguments)
        if not isinstance(result, Rows):
            return result
        if result.shape != node.shape and result.size == node.size:
            result = replace(result, shape=node.shape)
        levels = [rows.level for rows in arguments if isinstance(rows, Rows)]
        if result.level > max(levels, default=0):  # the atom is a function
            result = result if result.is_source else self.compiler.emit(SAME, result)
            self._kept.append(node)
            self._moving.add(key)
            self._known[key] = result
        if key in self._moving:
            for part, argument in zip(node.args, arguments, strict=True):
                self._remember(part, argument)
        return result

    def _remember(self, node: cp.Expression, result: Any) -> None:
        """Keep results that do not depend on parameters and have all entries, for later readers."""
        if id(node) not in self._moving and result.shape == node.shape:
            self._memo[id(node)] = (node, result)
            self._known[id(node)] = result

    def _computed(self, node: cp.Expression, rule: Rule | None, arguments: list[Any]) -> Any:
        if isinstance(node, cp.Variable if self._held is None else cp.Parameter):
            takes = self._takes_integers
            if self._held is None and (tie := restricting_attribute(node, takes_integers=takes)):
                raise UnsupportedModel(
                    f"variable {node.name()} has the attribute {tie!r}, which ties its entries; use a plain one"
                )
            return Rows({node.id: 1.0}, np.zeros(node.size), node.shape)
        pairs = zip(node.args, arguments, strict=True)
        constants = [pair for pair in pairs if not isinstance(pair[1], Rows)]
        if len(constants) == len(arguments):
            return self._value(node, arguments)
        for part, argument in constants:
            self._take_constant(part, argument)
        if (rule := rule or rule_of(node)) is not None:
            return rule(self.compiler, node, arguments)
        if self._held is None:
            raise refused(node)
        values = [atoms.dense(folded(part, self._value, {})) for part in node.args]
        return linearised(node, arguments, values)

    def _value(self, node: cp.Expression, values: list[Any]) -> Any:
        """Return the value of a node without sources, or of any node if variables are held."""
        if node.args:
            return atoms.constant_numeric(node, values)
        value = (self._held or {}).get(getattr(node, "id", 0))  # a constant has no id
        value = atoms.leaf_value(node) if value is None else value
        if value is None:
            raise UnsupportedModel(f"parameter {name_of(node)} has no value; set it first")
        return value

    def _take_constant(self, node: cp.Expression, value: Any) -> None:
        """Raise an error for a constant that is not a finite real number."""
        if id(node) in self._known:
            return
        if np.iscomplexobj(value):
            raise UnsupportedModel(f"{name_of(node)} is complex; write real and imaginary part")
        entries = atoms.stored_entries(value)
        if (wrong := entries[~np.isfinite(entries)]).size:
            raise UnsupportedModel(f"{name_of(node)} must be finite, got {wrong[0]}; repair it")


def hidden_parameters(node: cp.Expression) -> list[Any]:
    """Return the parameters that an atom holds but has not among its arguments."""
    data = (node.get_data() or []) if node.args else []
    stated = [part for part in data if isinstance(part, cp.Expression)]
    return [parameter for part in stated for parameter in part.parameters()]


def restricting_attribute(leaf: Any, *, takes_integers: bool = False) -> str | None:
    """Return the attribute that ties or restricts entries of a variable or parameter, or None."""
    names = FORBIDDEN_ATTRIBUTES if takes_integers else f"{FORBIDDEN_ATTRIBUTES} {INTEGRAL}"
    states = ((name, leaf.attributes.get(name)) for name in names.split())
    return next((name for name, state in states if not (state is None or state is False)), None)
