"""An expression as a function of its parameters, its variables held: its derivative, forwards and backwards.

Node by node along the expression tree; neither direction makes a Jacobian. Parameters need not enter affinely. A matrix
whose value is sparse keeps a sparse change, and a gradient of two thin factors: what A @ x asks of A is u xᵀ.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..errors import UnsupportedModel
from . import _compat as atoms
from ._compat import name_of
from .extract import postorder
from .linear_part import Values

#: Atoms that do to changes what they do to values.
LINEAR: tuple[Any, ...] = (*atoms.NEGATIVE, *atoms.GATHERS, *atoms.ENTRY_SUM)


class Outer(NamedTuple):
    """The gradient left · rightᵀ by the entries of a matrix, not multiplied out.

    Attributes
    ----------
    left, right : array, shapes (rows, k), (columns, k)
    """

    left: Any
    right: Any

    def dense(self) -> Any:
        """Return it multiplied out."""
        return atoms.dense(self.left) @ atoms.dense(self.right).T

    def on_pattern(self, matrix: Any) -> Any:
        """Return its product with a sparse matrix, entry by entry."""
        entries = sp.coo_array(matrix)
        left, right = atoms.dense(self.left), atoms.dense(self.right)
        data = entries.data * np.einsum("ik,ik->i", left[entries.row], right[entries.col])
        return sp.csc_array((data, (entries.row, entries.col)), shape=entries.shape)


class ParametricExpression:
    """An expression whose leaves have given values, and its derivative by its parameters.

    Parameters
    ----------
    expression : cvxpy expression
    known : dict
        From the id of a variable or parameter to its value, dense or sparse; the others have the value they have.

    Examples
    --------
    >>> p, x = cp.Parameter(2), cp.Variable(2)
    >>> F = ParametricExpression(cp.multiply(p**2, x), {p.id: np.array([1.0, 3.0]), x.id: np.array([5.0, 7.0])})
    >>> F.forward({p.id: np.array([1.0, 1.0])}), F.backward(np.array([1.0, 1.0]))[p.id]
    (array([10., 42.]), array([10., 42.]))
    """

    def __init__(self, expression: Any, known: dict[int, Any]) -> None:
        self.root = expression
        self._known = known
        self._nodes = postorder(expression, ())
        self._parametric: set[int] = set()
        for node in self._nodes:
            _refuse_hidden_parameters(node)
            if isinstance(node, cp.Parameter) or not self._parametric.isdisjoint(map(id, node.args)):
                self._parametric.add(id(node))
        self._nodes = [node for node in self._nodes if id(node) in self._parametric]
        self._values: Values = {}
        self._jacobians: dict[tuple[int, int], Any] = {}

    def forward(self, changes: dict[int, Any]) -> FloatVector:
        """Return the change of the expression with its parameters, by columns.

        Parameters
        ----------
        changes : dict
            From the id of a parameter to its change; the others do not change.
        """
        moved: Values = {}
        with np.errstate(all="ignore"):
            for node in self._nodes:
                if isinstance(node, cp.Parameter):
                    moved[id(node)] = np.asarray(changes.get(node.id, np.zeros(node.shape)))
                else:
                    moved[id(node)] = self._pushed(node, [moved.get(id(argument)) for argument in node.args])
        change = atoms.dense(moved[id(self.root)]) if moved else np.zeros(self.root.shape)
        whole: FloatVector = self._finite(np.ravel(change, order="F"))
        return whole

    def backward(self, gradient: Any) -> dict[int, Any]:
        """Return the gradients by the parameters of a function that has this gradient by the expression.

        Parameters
        ----------
        gradient : array
            By the entries of the expression, by columns.

        Returns
        -------
        dict
            From the id of a parameter to an array of its shape.
        """
        if not self._nodes:
            return {}
        waiting: dict[int, list[Any]] = {id(self.root): [np.reshape(gradient, self.root.shape, order="F")]}
        found: dict[int, Any] = {}
        with np.errstate(all="ignore"):
            for node in reversed(self._nodes):
                total = _total(waiting.pop(id(node), []), node.shape)
                if isinstance(node, cp.Parameter):
                    dense = np.asarray(_dense(total), dtype=np.float64).reshape(node.shape, order="F")
                    found[node.id] = self._finite(dense) + found.get(node.id, 0.0)
                    continue
                for k, argument in enumerate(node.args):
                    if id(argument) in self._parametric:
                        waiting.setdefault(id(argument), []).append(self._pulled(node, k, total))
        return found

    def _finite(self, values: Any) -> Any:
        if not np.isfinite(values).all():
            raise UnsupportedModel(
                f"{name_of(self.root)} has no finite derivative at the present values of its parameters; move them "
                "away from the edge of what its atoms accept"
            )
        return values

    def _value(self, node: Any) -> Any:
        for part in postorder(node, self._values):
            if id(part) not in self._values:
                self._values[id(part)] = self._computed(part)
        return self._values[id(node)]

    def _computed(self, node: Any) -> Any:
        if not node.args:
            value = self._known.get(node.id) if isinstance(node, (cp.Variable, cp.Parameter)) else None
            return atoms.leaf_value(node) if value is None else value
        return atoms.shaped(node, atoms.constant_numeric(node, [self._values[id(part)] for part in node.args]))

    def _pushed(self, node: Any, changes: list[Any]) -> Any:
        """Return the change of a node from those of its arguments, None for none."""
        if isinstance(node, atoms.PRODUCT):
            terms = [self._product_change(node, k, change) for k, change in enumerate(changes) if change is not None]
            return atoms.shaped(node, sum(terms[1:], start=terms[0]))
        if isinstance(node, atoms.SUM):
            return sum(
                change if change.shape == node.shape else np.broadcast_to(atoms.dense(change), node.shape)
                for change in changes if change is not None
            )
        if isinstance(node, LINEAR):
            is_sparse = any(map(sp.issparse, changes))
            zero: Any = sp.csc_array if is_sparse else np.zeros
            parts = zip(node.args, changes, strict=True)
            whole = [zero(part.shape) if change is None else change for part, change in parts]
            return atoms.shaped(node, atoms.constant_numeric(node, whole))
        return sum(
            (self._jacobian(node, k).T @ np.ravel(atoms.dense(change), order="F"))
            for k, change in enumerate(changes) if change is not None
        ).reshape(node.shape, order="F")

    def _product_change(self, node: Any, k: int, change: Any) -> Any:
        if isinstance(node, atoms.DIVISION) and k == 1:
            return _scaled(_scaled(self._value(node), change), self._by_divisor(node, -1.0))
        pair = [self._value(argument) if j != k else change for j, argument in enumerate(node.args)]
        return atoms.shaped(node, atoms.constant_numeric(node, pair))

    def _pulled(self, node: Any, k: int, gradient: Any) -> Any:
        """Return the gradient by argument k of a node from that by the node."""
        argument = node.args[k]
        if isinstance(node, atoms.SUM):
            return _unbroadcast(gradient, argument.shape)
        if isinstance(node, atoms.NEGATIVE):
            return _scaled(gradient, -1.0)
        if isinstance(node, atoms.PRODUCT):
            is_scaling = isinstance(node, atoms.ELEMENTWISE) or any(part.shape == () for part in node.args)
            return self._pulled_factor(node, k, gradient) if is_scaling else self._pulled_product(node, k, gradient)
        if isinstance(node, atoms.TRANSPOSE) and isinstance(gradient, Outer):
            return Outer(gradient.right, gradient.left)
        if isinstance(node, tuple(atoms.STACKS)) and isinstance(gradient, Outer) and argument.ndim == 2:
            return _stacked_part(node, k, gradient)
        if isinstance(node, atoms.BROADCAST):
            return _unbroadcast(gradient, argument.shape)
        gradient = np.asarray(_dense(gradient))
        if isinstance(node, atoms.GATHERS):
            return _scattered(node, k, gradient)
        if isinstance(node, atoms.ENTRY_SUM):
            return _spread(node, gradient)
        return (self._jacobian(node, k) @ np.ravel(gradient, order="F")).reshape(argument.shape, order="F")

    def _pulled_factor(self, node: Any, k: int, gradient: Any) -> Any:
        """Return the gradient by one factor of a product entry by entry, or by one side of a division."""
        if isinstance(node, atoms.DIVISION):
            gradient = _scaled(gradient, self._by_divisor(node, 1.0 if k == 0 else -1.0))
            factor = 1.0 if k == 0 else self._value(node)
        else:
            factor = self._value(node.args[1 - k])
        return _unbroadcast(_scaled(gradient, factor), node.args[k].shape)

    def _by_divisor(self, node: Any, number: float) -> Any:
        """Return a number over the divisor of a division, a number again where all its entries are one."""
        divisor = atoms.dense(self._value(node.args[1]))
        one = atoms.uniform(divisor)
        return number / (divisor if one is None else one)

    def _pulled_product(self, node: Any, k: int, gradient: Any) -> Any:
        """Return the gradient by one factor of a matrix product: G Bᵀ by A, and Aᵀ G by B."""
        argument, other = node.args[k], self._value(node.args[1 - k])
        if isinstance(gradient, Outer):
            left, right = gradient
            return Outer(left, other @ right) if k == 0 else Outer(other.T @ left, right)
        left, right = (argument.shape, other.shape) if k == 0 else (other.shape, argument.shape)
        gradient = np.asarray(_dense(gradient))
        if len(left) == 1:
            gradient = np.expand_dims(gradient, -1 if len(right) == 1 else -2)
        if len(right) == 1:
            gradient = np.expand_dims(gradient, -1)
        if len(other.shape) == 1:
            other = other[:, None] if k == 0 else other[None, :]
        if argument.ndim == 2 and gradient.ndim == 2 and sp.issparse(self._value(argument)):
            return Outer(gradient, other) if k == 0 else Outer(other.T, gradient.T)
        if gradient.ndim > 2:
            other = atoms.dense(other)
        other = other.T if other.ndim == 2 else np.swapaxes(other, -2, -1)
        product = gradient @ other if k == 0 else other @ gradient
        if argument.ndim == 1:
            product = product[..., 0, :] if k == 0 else product[..., 0]
        return _unbroadcast(product, argument.shape)

    def _jacobian(self, node: Any, k: int) -> Any:
        """Return cvxpy's own derivative of an atom by one argument, shape (size of the argument, size of the node)."""
        key = id(node), k
        if key not in self._jacobians:
            self._jacobians[key] = _own_jacobian(node, k, [atoms.dense(self._value(part)) for part in node.args])
        return self._jacobians[key]


def _own_jacobian(node: Any, k: int, values: list[Any]) -> Any:
    """Return the derivative that an atom gives by argument k, a variable standing where parameters stood.

    cvxpy's affine atoms take parameters for constants, and give zero for them.
    """
    constants = [cp.Constant(value) for value in values]
    try:
        stand_in = node.copy([*constants[:k], cp.Variable(node.args[k].shape), *constants[k + 1 :]])
        jacobian = stand_in._grad(values)[k]
        if jacobian is None:
            raise ValueError("outside its domain, or an atom without a derivative")
        matrix = sp.csr_array(jacobian if sp.issparse(jacobian) else np.atleast_2d(jacobian))
        if matrix.shape != (values[k].size, node.size):
            raise ValueError(f"its derivative has the shape {matrix.shape}")
    except Exception as error:  # whatever an atom of cvxpy makes of it
        raise UnsupportedModel(
            f"cvxpy gives no derivative of {name_of(node)} by its argument {name_of(node.args[k])} ({error}); make the "
            "value of this atom a parameter of its own, and multiply by its derivative yourself"
        ) from error
    return matrix


def _refuse_hidden_parameters(node: Any) -> None:
    """Raise where an atom holds parameters that are not among its arguments."""
    data = (node.get_data() or []) if node.args else []
    hidden = [parameter for part in data if isinstance(part, cp.Expression) for parameter in part.parameters()]
    if hidden:
        raise UnsupportedModel(
            f"{name_of(node)} holds the parameter {hidden[0].name()} where no derivative reaches it; write it with "
            "products, sums, exp and log"
        )


def _dense(gradient: Any) -> Any:
    return gradient.dense() if isinstance(gradient, Outer) else atoms.dense(gradient)


def _total(gradients: list[Any], shape: tuple[int, ...]) -> Any:
    """Return the sum of gradients, thin as long as all of them are."""
    if not gradients:
        return np.zeros(shape)
    if len(gradients) == 1:
        return gradients[0]
    if all(isinstance(one, Outer) for one in gradients):
        return Outer(*(np.hstack([atoms.dense(one[k]) for one in gradients]) for k in (0, 1)))
    if all(map(sp.issparse, gradients)):
        return sum(gradients[1:], start=gradients[0])
    return sum(np.asarray(_dense(one)) for one in gradients)


def _scaled(gradient: Any, factor: Any) -> Any:
    """Return the gradient times a number or an array, entry by entry."""
    number = atoms.uniform(factor) if isinstance(factor, np.ndarray) else None if sp.issparse(factor) else factor
    if isinstance(gradient, Outer):
        if number is not None:
            return Outer(gradient.left * number, gradient.right)
        if sp.issparse(factor):
            return gradient.on_pattern(factor)
        gradient = gradient.dense()
    if number is not None:
        return gradient * number
    if sp.issparse(factor):
        return sp.csc_array(factor.multiply(gradient))
    return sp.csc_array(gradient.multiply(factor)) if sp.issparse(gradient) else gradient * factor


def _unbroadcast(gradient: Any, shape: tuple[int, ...]) -> Any:
    """Return the gradient by an array of that shape which was broadcast: sums where it was repeated."""
    if isinstance(gradient, Outer):
        if (gradient.left.shape[0], gradient.right.shape[0]) == shape:
            return gradient
        if int(np.prod(shape)) == 1:
            return np.reshape(gradient.left.sum(axis=0) @ gradient.right.sum(axis=0), shape)
        gradient = gradient.dense()
    if gradient.shape == shape:
        return gradient
    if sp.issparse(gradient):
        if int(np.prod(shape)) == 1:
            return np.reshape(gradient.sum(), shape)
        gradient = gradient.toarray()
    gradient = gradient.sum(axis=tuple(range(gradient.ndim - len(shape))))
    repeated = tuple(axis for axis, length in enumerate(shape) if length == 1 and gradient.shape[axis] != 1)
    return gradient.sum(axis=repeated, keepdims=True) if repeated else gradient


def _stacked_part(node: Any, k: int, gradient: Outer) -> Outer:
    """Return what of the gradient by stacked matrices belongs to one of them."""
    axis = 1 if isinstance(node, atoms.HORIZONTAL) else 0
    ends = np.cumsum([0, *(part.shape[axis] for part in node.args)])
    own = slice(ends[k], ends[k + 1])
    return Outer(gradient.left, gradient.right[own]) if axis else Outer(gradient.left[own], gradient.right)


def _scattered(node: Any, k: int, gradient: Any) -> Any:
    """Return the gradient to the entries that an atom took from argument k: numbers tell where each one went."""
    numbers = [np.zeros(part.shape, dtype=np.int64) for part in node.args]
    size = node.args[k].size
    numbers[k] = np.arange(1, size + 1).reshape(node.args[k].shape, order="F")
    place = np.ravel(np.asarray(node.numeric(numbers)), order="F").astype(np.int64)
    total = np.bincount(place, weights=np.ravel(gradient, order="F"), minlength=size + 1)[1:]
    return total.reshape(node.args[k].shape, order="F")


def _spread(node: Any, gradient: Any) -> Any:
    """Return the gradient of a sum to each entry that was added."""
    shape = node.args[0].shape
    axes = range(len(shape)) if node.axis is None else [axis % len(shape) for axis in np.atleast_1d(node.axis)]
    kept = tuple(1 if axis in axes else length for axis, length in enumerate(shape))
    one = np.reshape(gradient, kept, order="F")
    if len(shape) == 2 and 1 in kept:
        rows, columns = np.ones((shape[0], 1)), np.ones((shape[1], 1))
        return Outer(rows, one.T * columns) if kept[0] == 1 else Outer(one * rows, columns)
    return np.broadcast_to(one, shape)
