"""From cvxpy expressions to rows over their variables, or over their parameters where the variables are held.

Node by node along the expression tree, by the rules of :mod:`atom_rules`. No variable is touched, nothing is
canonicalised, and parameters count as constants, disciplined or not. What was read of affine parts is compared with
cvxpy's own value at one point.
"""

from __future__ import annotations

from collections import ChainMap, Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.expressions.expression import Expression

from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from . import _compat as atoms
from ._compat import name_of, postorder
from .atom_rules import AtomKind, kind_of, linearised, refused, right_to_left, rule_of, whole
from .expressions.functions import SAME
from .expressions.rows import Compiler, Rows, as_matrix

Values = dict[int, Any]

CHECK_SEED = 20
CHECK_TOLERANCE = 1e-11
#: They tie entries to each other or to a set, so that the columns would not be free.
FORBIDDEN_ATTRIBUTES = ("symmetric", "diag", "PSD", "NSD", "hermitian", "sparsity", "complex", "imag")
INTEGERS = ("boolean", "integer")


def folded(root: Any, rule: Callable[[Any, list[Any]], Any], known: Mapping[int, Any]) -> Any:
    """Return the root's result of ``rule(node, results of its arguments)``; drop results after their last use.

    Parameters
    ----------
    root : cvxpy expression
    rule : callable
    known : dict
        Results by the ids of nodes, below which nothing is looked at.
    """
    nodes = postorder(root, known)
    uses = Counter(id(argument) for node in nodes if id(node) not in known for argument in node.args)
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


class Reader:
    """Reads expressions of one model into one compiler.

    Parameters
    ----------
    memo : dict, optional
        Keeps what no parameter enters from one reader to the next: give the same dict again.
    held : dict, optional
        From the ids of variables and parameters to their values. Then the parameters are the sources, and an atom
        whose own rule is not known is replaced by its tangent there. Without it the variables are.
    takes_integers : bool
        Whether variables may be whole numbers.

    Examples
    --------
    >>> x = cp.Variable(2)
    >>> F = Reader().rows(np.array([[2.0, -1.0], [0.0, 2.0]]) @ x + 3)
    >>> F.blocks[x.id].toarray(), F.offset
    (array([[ 2., -1.], [ 0.,  2.]]), array([3., 3.]))
    """

    def __init__(
        self, memo: dict[int, tuple[Any, Any]] | None = None, held: Values | None = None, *,
        takes_integers: bool = False,
    ) -> None:
        self.compiler, self._takes_integers = Compiler(), takes_integers
        self._memo = {} if memo is None else memo
        self._held = held
        self._known: Values = {key: found for key, (_, found) in self._memo.items()}
        self._found: list[tuple[Any, Any]] = []  # what will be known, too
        self._kept: list[Any] = []  # nodes, whose ids stay theirs while they are kept
        self._moving: set[int] = set()  # into which a parameter, or a function, enters
        #: Where what was read is compared: the values of sources, of functions and of constants.
        self._generator, self._point = np.random.default_rng(CHECK_SEED), dict[int, FloatVector]()
        self._at_point: Values = {}
        self._checked: list[tuple[Any, Rows]] = []

    def rows(self, expression: Any) -> Rows:
        """Return the rows of an expression: Σ blocks[variable.id] · variable + offset, and results of functions.

        Raises
        ------
        UnsupportedModel
            Where it has an atom without a rule, a complex or non-finite constant, a parameter without a value, or a
            variable whose attributes change what its entries mean.
        """
        root = Expression.cast_to_const(expression)
        root = root if self._held is None else right_to_left(root)
        self._kept.append(root)
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            result = folded(root, self._result, self._known)
            if not isinstance(result, Rows):
                self._take_constant(root, result)
            rows = Rows.of(result).spread(root.shape)
            rows = replace(rows, blocks={key: as_matrix(block, rows.size) for key, block in rows.blocks.items()})
            if self._held is None:
                self._remember(root, rows)
                for node, own in [*self._checked, (root, rows)]:
                    self._check(node, own)
                self._known.update((id(node), found) for node, found in self._found)
                self._found, self._checked = [], []
        return rows

    def _result(self, node: Any, arguments: list[Any]) -> Any:
        key, kind = id(node), kind_of(type(node))  # type: ignore[arg-type]
        below = list(map(id, node.args))
        hidden = _hidden_parameters(node) if node.args and kind.rule is None else []
        if hidden and self._held is not None:
            raise UnsupportedModel(
                f"{name_of(node)} holds the parameter {hidden[0].name()} where no derivative reaches it; write it with "
                "products, sums, exp and log"
            )
        if kind.is_parameter or hidden or not self._moving.isdisjoint(below):
            self._moving.add(key)
        result = self._computed(node, kind, arguments)
        if not isinstance(result, Rows):
            return result
        if result.shape != node.shape and result.size == node.size:
            result = replace(result, shape=node.shape)
        is_function = result.level > max([own.level for own in arguments if isinstance(own, Rows)], default=0)
        if is_function:
            result = result if result.is_source else self.compiler.emit(SAME, result)
            self._kept.append(node)
            self._moving.add(key)
            self._known[key], self._at_point[key] = result, result.array(self._values_of(result))
            parts = zip(node.args, arguments, strict=True)
            self._checked += [(part, own) for part, own in parts if isinstance(own, Rows) and not self._is_plain(part)]
        if key in self._moving:
            for part, own in zip(node.args, arguments, strict=True):
                self._remember(part, own)
        return result

    def _is_plain(self, node: Any) -> bool:
        """Return whether a node is a source, or entries of one, which need no check: a tenth of the time."""
        node = node.args[0] if isinstance(node, atoms.SELECTION) else node
        return isinstance(node, cp.Variable) or id(node) in self._at_point

    def _remember(self, node: Any, result: Any) -> None:
        """Keep for later readers what no parameter enters, where it has all its entries."""
        if id(node) not in self._moving and result.shape == node.shape:
            self._memo[id(node)] = (node, result)
            self._found.append((node, result))

    def _computed(self, node: Any, kind: AtomKind, arguments: list[Any]) -> Any:
        if kind.is_variable if self._held is None else kind.is_parameter:
            if kind.is_variable:
                check_attributes(node, takes_integers=self._takes_integers)
            return Rows({node.id: 1.0}, np.zeros(node.size), node.shape)
        constants = [pair for pair in zip(node.args, arguments, strict=True) if not isinstance(pair[1], Rows)]
        if len(constants) == len(arguments):
            return self._value(node, arguments)
        for part, argument in constants:
            self._take_constant(part, argument)
        rule = kind.rule
        if rule is None:
            rule = rule_of(node)
            arguments = [one.full() if isinstance(one, Rows) else one for one in whole(node, arguments)]
            if rule is None and self._held is not None:
                values = [atoms.dense(folded(part, self._value, {})) for part in node.args]
                return linearised(node, arguments, values)
            if rule is None:
                raise refused(node)
        return rule(self.compiler, node, arguments if kind.broadcasts else whole(node, arguments))

    def _value(self, node: Any, values: list[Any]) -> Any:
        """Return the value of a node without sources, or of any where everything is held."""
        if node.args:
            return atoms.shaped(node, atoms.constant_numeric(node, values))
        value = None if self._held is None or isinstance(node, cp.Constant) else self._held.get(node.id)
        value = atoms.leaf_value(node) if value is None else value
        if value is None:
            raise UnsupportedModel(f"parameter {name_of(node)} has no value; set {name_of(node)}.value before solving")
        return value

    def _take_constant(self, node: Any, value: Any) -> None:
        """Keep a constant for the check, and refuse one that is no finite real number."""
        if id(node) in self._at_point:
            return
        self._at_point[id(node)] = value
        if id(node) in self._known:
            return
        if np.iscomplexobj(value):
            raise UnsupportedModel(f"{name_of(node)} is complex; write its real and imaginary parts as two expressions")
        entries = value.data if sp.issparse(value) else value
        if not _all_finite(entries):
            wrong = np.ravel(entries)[~np.isfinite(np.ravel(entries))][0]
            raise UnsupportedModel(f"constants must be finite, but {name_of(node)} holds {wrong}; repair that entry")

    def _values_of(self, rows: Rows) -> FloatVector:
        """Return the values of rows at the point."""
        for key, block in rows.blocks.items():
            if key not in self._point:
                size = rows.size if isinstance(block, float) else block.shape[1]
                self._point[key] = self._generator.random(size) + 0.5
        return rows.at(self._point)

    def _evaluated(self, root: Any, sizes: list[float] | None = None) -> FloatVector:
        """Return what cvxpy makes of an expression at the point; `sizes` gets the largest number of each value."""

        def value(node: Any, values: list[Any]) -> Any:
            if isinstance(node, cp.Variable):
                own = Rows({node.id: 1.0}, np.zeros(node.size), node.shape)
                return own.array(self._values_of(own))
            values = [own.array(self._values_of(own)) if isinstance(own, Rows) else own for own in values]
            result = atoms.dense_numeric(node, values)
            if sizes is not None:
                sizes.append(float(np.abs(result).max(initial=0.0)))
            return result

        found = folded(root, value, ChainMap(self._at_point, self._known))
        found = found.array(self._values_of(found)) if isinstance(found, Rows) else found
        return np.ravel(atoms.dense(found), order="F")

    def _check(self, root: Any, rows: Rows) -> None:
        """Raise where the rows are not the expression's value at a point, up to rounding."""
        if not _all_finite(rows.offset):
            raise UnsupportedModel(f"{name_of(root)} is not finite at zero: its data overflow; scale the data down")
        rows, actual = rows.full(), self._evaluated(root)
        error = np.abs(self._values_of(rows) - actual)
        doubtful = np.flatnonzero(~(error <= CHECK_TOLERANCE * np.abs(actual)))
        if not doubtful.size:
            return
        # Cancellation inside a row, then inside the expression: only now worth the second look.
        sizes = [0.0]
        self._evaluated(root, sizes)
        size = np.abs(rows.offset) + max(sizes)
        size += sum(abs(as_matrix(block, rows.size)) @ self._point[key] for key, block in rows.blocks.items())
        wrong = doubtful[~(error[doubtful] <= CHECK_TOLERANCE * size[doubtful])]
        if wrong.size and not np.isfinite(error[wrong[0]]):
            raise UnsupportedModel(
                f"{name_of(root)} overflows in entry {wrong[0]}, multiplied out or at a point near 1; write it in "
                "other units"
            )
        if wrong.size:
            raise UnsupportedModel(
                f"{name_of(root)} differs from its own matrices by {error[wrong[0]]:.1e} in entry {wrong[0]}; "
                "an atom in it is not what cvxpy evaluates: write the expression with products, sums and indices"
            )


def _hidden_parameters(node: Any) -> list[Any]:
    """Return the parameters that an atom holds but has not among its arguments."""
    data = (node.get_data() or []) if node.args else []
    return [parameter for part in data if isinstance(part, cp.Expression) for parameter in part.parameters()]


def check_attributes(variable: cp.Variable, *, takes_integers: bool = False) -> None:
    """Raise where the entries of a variable are not free.

    Raises
    ------
    UnsupportedModel
        Naming the attribute that ties or restricts them.
    """
    for attribute in (*FORBIDDEN_ATTRIBUTES, *(() if takes_integers else INTEGERS)):
        state = variable.attributes.get(attribute)
        if not (state is None or state is False):
            raise UnsupportedModel(
                f"variable {variable.name()} has the attribute {attribute!r}, which ties or restricts its entries; "
                "use a plain variable, with bounds or nonneg where needed"
            )


def _all_finite(values: Any) -> bool:
    return bool(np.isfinite(np.sum(values))) or bool(np.isfinite(values).all())
