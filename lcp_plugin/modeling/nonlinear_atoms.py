"""How each nonlinear atom of cvxpy is made of elementary functions of rows, and of sums of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..errors import UnsupportedModel
from . import _compat as atoms
from . import nonlinear_rules as rules
from ._compat import name_of
from .extract import constant_value
from .linear_part import broadcast_rows
from .nonlinear_program import Indices
from .nonlinear_rules import Rule

if TYPE_CHECKING:
    from .nonlinear_expressions import Compiler


@dataclass(frozen=True, eq=False)
class Rows:
    """Linear combinations of the quantities that a compiler has numbered so far.

    Attributes
    ----------
    matrix : CSR array
        Its columns are quantities, as many as there were when it was made.
    offset : ndarray
    level : int
        Of the highest quantity in it; unknowns have 0.
    are_last : bool
        Whether the rows are the latest quantities, one each and in their order.
    """

    matrix: sp.csr_array
    offset: FloatVector
    level: int
    are_last: bool = False

    @property
    def size(self) -> int:
        """The number of rows."""
        return int(self.offset.size)

    def over(self, count: int) -> sp.csr_array:
        """Return the matrix over that many quantities."""
        matrix = self.matrix
        return sp.csr_array((matrix.data, matrix.indices, matrix.indptr), shape=(self.size, count))

    def __getitem__(self, places: Indices | None) -> Rows:
        """Return the rows in these places; all of them for None."""
        return self if places is None else Rows(self.matrix[places], self.offset[places], self.level)

    def applied(self, operator: Any) -> Rows:
        """Return operator · rows."""
        operator = sp.csr_array(operator)
        return Rows(sp.csr_array(operator @ self.matrix), operator @ self.offset, self.level)


def compiled(compiler: Compiler, node: Any) -> Rows:
    """Return the rows of a nonlinear node whose arguments are compiled."""
    build = _builder_of(node)
    assert build is not None  # refuse_unknown was asked before
    return build(compiler, node)


def refuse_unknown(node: Any) -> None:
    """Raise where no derivative of the node's atom is known.

    Raises
    ------
    UnsupportedModel
        Naming the atom, and what to write instead.
    """
    if _builder_of(node) is not None:
        return
    if isinstance(node, atoms.NONSMOOTH):
        raise UnsupportedModel(
            f"{name_of(node)} is not smooth, so that no derivative tells how it goes on; give its kink a variable "
            "and a complementarity of its own: complements(s >= 0, x + s >= 0) makes s = max(−x, 0) and x + 2 s = |x|"
        )
    raise UnsupportedModel(
        f"{name_of(node)} is not affine, and of the atom {type(node).__name__} no derivative is known here; write it "
        "with products, quotients, powers, exp, log, log1p, logistic, entr and sums, or linearise"
    )


def _builder_of(node: Any) -> Callable[[Compiler, Any], Rows] | None:
    return next((BUILDERS[kind] for kind in type(node).__mro__ if kind in BUILDERS), None)


def _elementary(rule: Rule) -> Callable[[Compiler, Any], Rows]:
    return lambda compiler, node: compiler.emit(rule, compiler.argument(node.args[0]))


def _power(compiler: Compiler, node: Any) -> Rows:
    exponent, rows = float(np.ravel(constant_value(node.p))[0]), compiler.argument(node.args[0])
    if exponent == 0.0:  # a parameter may be
        return Rows(sp.csr_array(rows.matrix.shape), np.ones(rows.size), rows.level)
    return compiler.emit(rules.power(exponent), rows)


def _product(compiler: Compiler, node: Any) -> Rows:
    left, right = node.args
    is_matrix_product = isinstance(node, atoms.MATRIX_PRODUCT) and not isinstance(node, atoms.ELEMENTWISE)
    if is_matrix_product and left.shape and right.shape:
        return _matrix_product(compiler, node)
    rule = rules.QUOTIENT if isinstance(node, atoms.DIVISION) else rules.PRODUCT
    if left is right and rule is rules.PRODUCT:
        return compiler.emit(rules.SQUARE, compiler.argument(left))
    return compiler.emit(rule, *_broadcast(compiler, node))


def _broadcast(compiler: Compiler, node: Any) -> list[Rows]:
    """Return the rows of the arguments, each in the shape of the node."""
    return [compiler.argument(argument)[broadcast_rows(argument.shape, node.shape)] for argument in node.args]


def _matrix_product(compiler: Compiler, node: Any) -> Rows:
    """Multiply all pairs of entries that meet, and add them; of stacks of matrices, too."""
    left, right = node.args
    if left is right and left.ndim == 1:
        return _added(compiler.emit(rules.SQUARE, compiler.argument(left)))
    m, depth, n = (left.shape[-2:-1] or (1,)), (left.shape[-1],), (right.shape[-1:] if right.ndim > 1 else (1,))
    batch = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    shape = batch + m + depth + n
    first = np.broadcast_to(_numbers(left).reshape(left.shape[:-2] + m + depth)[..., None], shape)
    second = np.broadcast_to(_numbers(right).reshape(right.shape[:-2] + depth + n)[..., None, :, :], shape)
    sums = np.broadcast_to(np.arange(node.size).reshape(batch + m + n, order="F")[..., None, :], shape)
    rows = [compiler.argument(argument) for argument in node.args]
    terms = compiler.emit(rules.PRODUCT, rows[0][first.ravel()], rows[1][second.ravel()])
    return _added(terms, sums.ravel(), node.size)


def _numbers(expression: Any) -> Indices:
    """Return the place of each entry, in the shape of the expression."""
    return np.arange(expression.size).reshape(expression.shape, order="F")


def _added(rows: Rows, targets: Indices | None = None, size: int = 1) -> Rows:
    """Return `size` sums: row k belongs to the one with the number targets[k]."""
    targets = np.zeros(rows.size, dtype=np.int64) if targets is None else targets
    entries = (np.ones(rows.size), (targets, np.arange(rows.size)))
    return rows.applied(sp.coo_array(entries, shape=(size, rows.size)))


def _reduced(node: Any) -> Indices:
    """Return the entries that each result is made of, along the node's axis: shape (entries, results)."""
    shape, axis = node.args[0].shape, getattr(node, "axis", None)
    axes = range(len(shape)) if axis is None else [one % len(shape) for one in np.atleast_1d(axis)]
    moved = np.moveaxis(_numbers(node.args[0]), list(axes), range(len(axes)))
    return moved.reshape((math.prod(shape[one] for one in axes), -1), order="F")


def _sums_along(rows: Rows, groups: Indices) -> Rows:
    """Return the sum of each group's rows, which follow each other."""
    return _added(rows, np.arange(groups.size) // groups.shape[0], groups.shape[1])


def _multiplied(compiler: Compiler, factors: list[Rows]) -> Rows:
    """Return the product of all, in pairs of pairs."""
    while len(factors) > 1:
        pairs = [compiler.emit(rules.PRODUCT, *factors[k : k + 2]) for k in range(0, len(factors) - 1, 2)]
        factors = pairs + factors[2 * len(pairs) :]
    return factors[0]


def _product_of_entries(compiler: Compiler, node: Any) -> Rows:
    rows = compiler.argument(node.args[0])
    return _multiplied(compiler, [rows[places] for places in _reduced(node)])


def _geometric_mean(compiler: Compiler, node: Any) -> Rows:
    if getattr(node, "axis", None) is not None:
        raise UnsupportedModel(f"{name_of(node)} takes the mean along an axis; write one geo_mean for each row")
    rows, weights = compiler.argument(node.args[0]), [float(weight) for weight in node.w]
    kept = np.flatnonzero(np.broadcast_to(getattr(node, "_keep", True), (rows.size,)))
    kept = kept if kept.size == len(weights) else np.arange(rows.size)
    factors = [(rows[kept[k : k + 1]], weight) for k, weight in enumerate(weights) if weight]
    return _multiplied(compiler, [compiler.emit(rules.power(weight), row) for row, weight in factors])


def _log_sum_exp(compiler: Compiler, node: Any) -> Rows:
    """Add the exponentials in pairs of pairs, each pair by its logarithms: no exponential overflows."""
    groups, rows = _reduced(node), compiler.argument(node.args[0])
    terms, left = rows[groups.ravel()], []  # terms of one place in the groups follow each other
    count, size = groups.shape
    while count > 1:
        half = count // 2 * size
        if count % 2:
            left.append(terms[np.arange(2 * half, terms.size)])
        terms = compiler.emit(rules.LOG_ADD_EXP, terms[np.arange(half)], terms[np.arange(half, 2 * half)])
        count //= 2
    for other in left:
        terms = compiler.emit(rules.LOG_ADD_EXP, terms, other)
    return terms


def _quad_over_lin(compiler: Compiler, node: Any) -> Rows:
    groups = _reduced(node)
    squares = compiler.emit(rules.SQUARE, compiler.argument(node.args[0])[groups.ravel(order="F")])
    sums, divisor = _sums_along(squares, groups), compiler.argument(node.args[1])
    if not node.args[1].variables():
        return sums.applied(sp.eye_array(sums.size) / divisor.offset[0])
    return compiler.emit(rules.QUOTIENT, sums, divisor[np.zeros(sums.size, dtype=np.int64)])


def _quad_form(compiler: Compiler, node: Any) -> Rows:
    x = compiler.argument(node.args[0])
    return _added(compiler.emit(rules.PRODUCT, x, x.applied(constant_value(node.args[1]))))


def _relative_entropy(compiler: Compiler, node: Any) -> Rows:
    return compiler.emit(rules.RELATIVE_ENTROPY, *_broadcast(compiler, node))


def _kl_divergence(compiler: Compiler, node: Any) -> Rows:
    x, y = _broadcast(compiler, node)
    return compiler.total((1.0, _relative_entropy(compiler, node)), (-1.0, x), (1.0, y))


def _x_exp(compiler: Compiler, node: Any) -> Rows:
    x = compiler.argument(node.args[0])
    return compiler.emit(rules.PRODUCT, x, compiler.emit(rules.EXP, x))


#: By the class of the atom.
BUILDERS: dict[type, Callable[[Compiler, Any], Rows]] = {
    kind: build
    for kinds, build in (
        ((*atoms.PRODUCT, *atoms.ELEMENTWISE), _product),
        (atoms.POWER, _power),
        (atoms.smooth_atoms("elementwise.exp.exp"), _elementary(rules.EXP)),
        (atoms.smooth_atoms("elementwise.log.log"), _elementary(rules.LOG)),
        (atoms.smooth_atoms("elementwise.log1p.log1p"), _elementary(rules.LOG1P)),
        (atoms.smooth_atoms("elementwise.logistic.logistic"), _elementary(rules.LOGISTIC)),
        (atoms.smooth_atoms("elementwise.entr.entr"), _elementary(rules.ENTROPY)),
        (atoms.smooth_atoms("elementwise.xexp.xexp"), _x_exp),
        (atoms.smooth_atoms("elementwise.rel_entr.rel_entr"), _relative_entropy),
        (atoms.smooth_atoms("elementwise.kl_div.kl_div"), _kl_divergence),
        (atoms.smooth_atoms("prod.Prod"), _product_of_entries),
        (atoms.smooth_atoms("geo_mean.GeoMean", "geo_mean.geo_mean"), _geometric_mean),
        (atoms.smooth_atoms("log_sum_exp.log_sum_exp"), _log_sum_exp),
        (atoms.smooth_atoms("quad_over_lin.quad_over_lin"), _quad_over_lin),
        (atoms.smooth_atoms("quad_form.QuadForm"), _quad_form),
    )
    for kind in kinds
}
