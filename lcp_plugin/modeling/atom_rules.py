"""Rules of cvxpy's atoms: each builds rows from sums, products and functions of `expressions`.

A rule takes a compiler, the node, and its arguments as they were read: arrays and sparse matrices for constants,
else rows. It returns the node's entries by columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, TypeAlias

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.atoms.elementwise.power import Power
from cvxpy.atoms.geo_mean import GeoMean
from cvxpy.atoms.prod import Prod
from cvxpy.atoms.quad_form import QuadForm

from ..core.errors import UnsupportedModel
from ..expressions import functions
from ..expressions.functions import Function
from ..expressions.rows import Compiler, Indices, Rows, added, entries_behind, stacked
from . import _compat as atoms
from ._compat import name_of

Rule: TypeAlias = Callable[[Compiler, Any, list[Any]], Rows]


@cache
def affine_rule(kind: type) -> Rule | None:
    """Return the rule of a class of affine atoms; cached, because cvxpy's classes are slow."""
    return next((rule for classes, rule in AFFINE.items() if issubclass(kind, classes)), None)


def rule_of(node: Any) -> Rule | None:
    """Return the rule for an atom that is not affine by its class; None if there is no rule."""
    if node.is_atom_affine():
        return _by_jacobian
    return next((SMOOTH[kind] for kind in type(node).__mro__ if kind in SMOOTH), None)


def refused(node: Any) -> UnsupportedModel:
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


def linearised(node: Any, arguments: list[Any], values: list[Any]) -> Rows:
    """Return the atom's tangent at dense values of its arguments, by the derivative that cvxpy gives."""
    parts: list[Any] = [atoms.dense_numeric(node, values)]
    for k, (argument, value) in enumerate(zip(arguments, values, strict=True)):
        if isinstance(argument, Rows):
            change = added([argument, -value], argument.shape)
            parts.append(change.applied(_own_jacobian(node, k, values), node.shape))
    return added(parts, node.shape)


def _by_jacobian(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    """Apply the derivatives that cvxpy gives, which are constant if the atom is affine."""
    rows = {k: one for k, one in enumerate(arguments) if isinstance(one, Rows)}
    offsets, values = arguments.copy(), list(map(atoms.dense, arguments))
    for k, one in rows.items():
        offsets[k] = one.offset.reshape(one.shape, order="F")
        values[k] = np.ones(one.shape)  # inside each domain; a power is not differentiated at zero
    parts = [one.applied(_own_jacobian(node, k, values), node.shape) for k, one in rows.items()]
    whole = added(parts, node.shape)
    offset = np.ravel(atoms.dense_numeric(node, offsets), order="F").astype(np.float64)
    return Rows(whole.blocks, offset, node.shape, whole.level)


def _own_jacobian(node: Any, k: int, values: list[Any]) -> sp.csr_array:
    """Return cvxpy's own derivative of an atom by argument k.

    cvxpy's affine atoms take parameters for constants, with gradient zero: a variable replaces them here.
    """
    try:
        stand_in = node
        if not node.args[k].variables():
            constants = [cp.Constant(value) for value in values]
            stand_in = node.copy(
                [*constants[:k], cp.Variable(node.args[k].shape), *constants[k + 1 :]]
            )
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


def _added(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    return added(arguments, node.shape)


def _negated(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    negative: Rows = arguments[0].scaled(-1.0)
    return negative


def _broadcast(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    rows: Rows = arguments[0].spread(node.shape)
    return rows


def _product(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    left, right = arguments
    if isinstance(node, atoms.DIVISION):
        return compiler.elementwise(functions.QUOTIENT, left, right, node.shape)
    if isinstance(node, atoms.ELEMENTWISE) or () in (left.shape, right.shape):
        return compiler.elementwise(functions.PRODUCT, left, right, node.shape)
    return compiler.product(left, right, node.shape)


def _gathered(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    """Let the atom move entry numbers instead of entries: the result shows which rows it takes."""
    parts = [Rows.of(argument) for argument in arguments]
    if isinstance(node, cp.reshape) and node.order == "F":
        return replace(parts[0], shape=node.shape)
    ends = np.cumsum([part.size for part in parts])
    # 0 stands for an entry of nothing: padding.
    numbers = [
        np.arange(end - part.size + 1.0, end + 1.0).reshape(part.shape, order="F")
        for part, end in zip(parts, ends, strict=True)
    ]
    moved = atoms.dense_numeric(node, numbers)
    return stacked(parts).taken(moved.ravel(order="F").astype(np.int64) - 1, node.shape)


def _summed(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    rows, axes = arguments[0], _axes(node)
    kept = tuple(1 if axis in axes else length for axis, length in enumerate(rows.shape))
    sums: Rows = rows.summed(entries_behind(rows.shape, kept), node.shape)
    return sums


AFFINE: dict[tuple[Any, ...], Rule] = {
    atoms.SUM: _added,
    atoms.NEGATIVE: _negated,
    (*atoms.PRODUCT, *atoms.ELEMENTWISE): _product,
    atoms.BROADCAST: _broadcast,
    atoms.GATHERS: _gathered,
    atoms.ENTRY_SUM: _summed,
}


# --- smooth ---------------------------------------------------------------------------------------------------------


def _axes(node: Any) -> list[int]:
    count, axis = len(node.args[0].shape), getattr(node, "axis", None)
    return list(range(count)) if axis is None else [one % count for one in np.atleast_1d(axis)]


def _elementary(function: Function) -> Rule:
    return lambda compiler, node, arguments: compiler.emit(function, arguments[0])


def _power(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    rows, value = arguments[0], node.p.value
    if value is None or not np.isfinite(value).all():
        raise UnsupportedModel(
            f"the exponent {name_of(node.p)} of {name_of(node)} is {value}; give it a finite value"
        )
    exponent = float(np.ravel(value)[0])
    if exponent == 0.0:  # a parameter may be
        return Rows({}, np.ones(rows.size), rows.shape)
    return rows if exponent == 1.0 else compiler.emit(functions.power(exponent), rows)


def _reduced(node: Any) -> Indices:
    """Return the entries of each result, along the node's axis: shape (entries, results)."""
    shape, axes = node.args[0].shape, _axes(node)
    moved = np.moveaxis(
        np.arange(math.prod(shape)).reshape(shape, order="F"), axes, range(len(axes))
    )
    return moved.reshape((math.prod(shape[one] for one in axes), -1), order="F")


def _folded(compiler: Compiler, function: Function, terms: Rows, size: int) -> Rows:
    """Return a function of two arguments of all terms, in pairs of pairs.

    `size` results are made at once: the terms at one position of all are consecutive.
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

    def rule(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
        groups = _reduced(node)
        return _folded(compiler, function, arguments[0].taken(groups.ravel()), groups.shape[1])

    return rule


def _geometric_mean(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    if getattr(node, "axis", None) is not None:
        raise UnsupportedModel(
            f"{name_of(node)} takes the mean along an axis; write one geo_mean for each row"
        )
    rows, weights = arguments[0], [float(weight) for weight in node.w]
    kept = np.flatnonzero(np.broadcast_to(getattr(node, "_keep", True), (rows.size,)))
    kept = kept if kept.size == len(weights) else np.arange(rows.size)
    factors = [(rows.taken(kept[k : k + 1]), weight) for k, weight in enumerate(weights) if weight]
    powers = [compiler.emit(functions.power(weight), row) for row, weight in factors]
    return _folded(compiler, functions.PRODUCT, stacked(powers), 1)


def _logistic(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    return compiler.emit(functions.LOG_ADD_EXP, arguments[0], Rows.of(np.zeros(node.shape)))


def _quad_over_lin(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    groups = _reduced(node)
    squares = compiler.emit(functions.SQUARE, Rows.of(arguments[0]).taken(groups.ravel(order="F")))
    sums = squares.summed(np.arange(groups.size) // groups.shape[0], (groups.shape[1],))
    below = arguments[1]
    if not isinstance(below, Rows):
        return compiler.elementwise(functions.QUOTIENT, sums, below, sums.shape)
    # A quotient has derivatives for negative denominators.
    inverse = compiler.emit(functions.power(-1.0), below.spread(sums.shape))
    return compiler.emit(functions.PRODUCT, sums, inverse)


def _quad_form(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    x, P = Rows.of(arguments[0]), arguments[1]
    x = x.taken(np.arange(x.size))
    return compiler.product(x, compiler.product(P, x, x.shape), ())


def _entropy(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    return compiler.emit(
        functions.RELATIVE_ENTROPY, arguments[0], Rows.of(np.ones(node.shape))
    ).scaled(-1.0)


def _relative_entropy(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    both = [Rows.of(one).spread(node.shape) for one in arguments]
    return compiler.emit(functions.RELATIVE_ENTROPY, *both)


def _kl_divergence(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    x, y = (Rows.of(one) for one in arguments)
    return added([_relative_entropy(compiler, node, arguments), x.scaled(-1.0), y], node.shape)


def _x_exp(compiler: Compiler, node: Any, arguments: list[Any]) -> Rows:
    return compiler.emit(
        functions.PRODUCT, arguments[0], compiler.emit(functions.EXP, arguments[0])
    )


#: By the class of the atom.
SMOOTH: dict[Any, Rule] = {
    Power: _power,
    cp.exp: _elementary(functions.EXP),
    cp.log: _elementary(functions.LOG),
    cp.log1p: _elementary(functions.LOG1P),
    cp.logistic: _logistic,
    cp.entr: _entropy,
    cp.xexp: _x_exp,
    cp.rel_entr: _relative_entropy,
    cp.kl_div: _kl_divergence,
    Prod: _along_axis(functions.PRODUCT),
    GeoMean: _geometric_mean,
    cp.log_sum_exp: _along_axis(functions.LOG_ADD_EXP),  # no exponential overflows
    cp.quad_over_lin: _quad_over_lin,
    QuadForm: _quad_form,
}
