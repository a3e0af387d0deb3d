"""Reader of cvxpy expressions as rows over variables, or over parameters.

Node by node along the expression tree, by the rules of :mod:`atom_rules`. No variable is changed, nothing is
canonicalized, and parameters count as constants, disciplined or not. Results are compared with the values of cvxpy,
before a solution is returned (:mod:`lcp_plugin.modeling.registration`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.expressions.expression import Expression

from ..core.errors import UnsupportedModel
from ..expressions.functions import SAME
from ..expressions.rows import Compiler, Rows, as_matrix
from . import _compat as atoms
from ._compat import name_of, postorder
from .atom_rules import Rule, affine_rule, linearised, refused, rule_of

Values = dict[int, Any]

#: Attributes that tie entries to each other or to a set, so that the columns would not be free.
FORBIDDEN_ATTRIBUTES = (
    "symmetric",
    "diag",
    "PSD",
    "NSD",
    "hermitian",
    "sparsity",
    "complex",
    "imag",
)
INTEGERS = ("boolean", "integer")


def folded(root: Any, rule: Callable[[Any, list[Any]], Any], known: Mapping[int, Any]) -> Any:
    """Return the root's result of ``rule(node, results of its arguments)``; drop results after their last use.

    Parameters
    ----------
    root : cvxpy expression
    rule : callable
    known : dict
        Results by the ids of nodes, below which no node is read.
    """
    nodes = postorder(root, known)
    uses = Counter(
        id(argument) for node in nodes if id(node) not in known for argument in node.args
    )
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


def rewritten(root: Any, change: Callable[[Any], Any]) -> Any:
    """Return an expression with change(node) for each node, arguments first; nodes without changes stay."""

    def rule(node: Any, arguments: list[Any]) -> Any:
        is_same = all(one is own for one, own in zip(arguments, node.args, strict=True))
        return change(node if is_same else node.copy(arguments))

    return folded(root, rule, {})


class Reader:
    """Reader of the expressions of one model into one compiler.

    Parameters
    ----------
    memo : dict, optional
        Results that do not depend on parameters; give the same dict to the next reader.
    held : dict, optional
        From the ids of variables and parameters to their values. Then the parameters are the sources, and an atom
        whose own rule is not known is replaced by its tangent there. Without it the variables are.
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
        self,
        memo: dict[int, tuple[Any, Any]] | None = None,
        held: Values | None = None,
        *,
        takes_integers: bool = False,
    ) -> None:
        self.compiler, self._takes_integers = Compiler(), takes_integers
        self._memo = {} if memo is None else memo
        self._held, self._has_sources = held, held is not None
        self._known: Values = {key: found for key, (_, found) in self._memo.items()}
        self._found: list[tuple[Any, Any]] = []  # results to be known also
        self._kept: list[Any] = []  # nodes, whose ids stay theirs while they are kept
        self._moving: set[int] = set()  # into which a parameter, or a function, enters
        self._taken: set[int] = set()  # constants that were checked

    def hold(self, sources: Mapping[int, Any]) -> None:
        """Let nodes be sources, by key, below which nothing is read; a parameter that an atom holds raises an error."""
        self._has_sources = True
        self._kept.extend(sources.values())
        for key, node in sources.items():
            self._known[id(node)] = Rows({key: 1.0}, np.zeros(node.size), node.shape)

    def rows(self, expression: Any) -> Rows:
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
            blocks = {key: as_matrix(block, rows.size) for key, block in rows.blocks.items()}
            rows = replace(rows, blocks=blocks)
            if self._held is None:
                entries = [block.data for block in blocks.values()]
                if not all(np.isfinite(values).all() for values in (rows.offset, *entries)):
                    raise UnsupportedModel(
                        f"{name_of(root)} is not finite, multiplied out: its data overflow, or are divided by 0; write "
                        "it in other units"
                    )
                self._remember(root, rows)
                self._known.update((id(node), found) for node, found in self._found)
                self._found = []
        return rows

    def _result(self, node: Any, arguments: list[Any]) -> Any:
        key, rule = id(node), affine_rule(type(node))  # type: ignore[arg-type]
        below = list(map(id, node.args))
        hidden = hidden_parameters(node) if node.args and rule is None else []
        if hidden and self._has_sources:
            raise UnsupportedModel(
                f"{name_of(node)} holds the parameter {hidden[0].name()} where no derivative reaches it; write it with "
                "products, sums, exp and log"
            )
        if isinstance(node, cp.Parameter) or hidden or not self._moving.isdisjoint(below):
            self._moving.add(key)
        result = self._computed(node, rule, arguments)
        if not isinstance(result, Rows):
            return result
        if result.shape != node.shape and result.size == node.size:
            result = replace(result, shape=node.shape)
        is_function = result.level > max(
            [own.level for own in arguments if isinstance(own, Rows)], default=0
        )
        if is_function:
            result = result if result.is_source else self.compiler.emit(SAME, result)
            self._kept.append(node)
            self._moving.add(key)
            self._known[key] = result
        if key in self._moving:
            for part, own in zip(node.args, arguments, strict=True):
                self._remember(part, own)
        return result

    def _remember(self, node: Any, result: Any) -> None:
        """Keep results that do not depend on parameters and have all entries, for later readers."""
        if id(node) not in self._moving and result.shape == node.shape:
            self._memo[id(node)] = (node, result)
            self._found.append((node, result))

    def _computed(self, node: Any, rule: Rule | None, arguments: list[Any]) -> Any:
        if isinstance(node, cp.Variable if self._held is None else cp.Parameter):
            takes = self._takes_integers
            if self._held is None and (tie := restricting_attribute(node, takes_integers=takes)):
                raise UnsupportedModel(
                    f"variable {node.name()} has the attribute {tie!r}, which ties or restricts its entries; use a "
                    "plain variable, with bounds or nonneg where needed"
                )
            return Rows({node.id: 1.0}, np.zeros(node.size), node.shape)
        constants = [
            pair for pair in zip(node.args, arguments, strict=True) if not isinstance(pair[1], Rows)
        ]
        if len(constants) == len(arguments):
            return self._value(node, arguments)
        for part, argument in constants:
            self._take_constant(part, argument)
        if rule is None:
            rule = rule_of(node)
            if rule is None and self._held is not None:
                values = [atoms.dense(folded(part, self._value, {})) for part in node.args]
                return linearised(node, arguments, values)
            if rule is None:
                raise refused(node)
        return rule(self.compiler, node, arguments)

    def _value(self, node: Any, values: list[Any]) -> Any:
        """Return the value of a node without sources, or of any node if variables are held."""
        if node.args:
            return atoms.constant_numeric(node, values)
        value = (
            None if self._held is None or isinstance(node, cp.Constant) else self._held.get(node.id)
        )
        value = atoms.leaf_value(node) if value is None else value
        if value is None:
            raise UnsupportedModel(
                f"parameter {name_of(node)} has no value; set {name_of(node)}.value before solving"
            )
        return value

    def _take_constant(self, node: Any, value: Any) -> None:
        """Raise an error for a constant that is not a finite real number."""
        if id(node) in self._taken or id(node) in self._known:
            return
        self._taken.add(id(node))
        if np.iscomplexobj(value):
            raise UnsupportedModel(
                f"{name_of(node)} is complex; write its real and imaginary parts as two expressions"
            )
        entries = value.data if sp.issparse(value) else value
        if not np.isfinite(entries).all():
            wrong = np.ravel(entries)[~np.isfinite(np.ravel(entries))][0]
            raise UnsupportedModel(
                f"constants must be finite, but {name_of(node)} holds {wrong}; repair that entry"
            )


def hidden_parameters(node: Any) -> list[Any]:
    """Return the parameters that an atom holds but has not among its arguments."""
    data = (node.get_data() or []) if node.args else []
    stated = [part for part in data if isinstance(part, cp.Expression)]
    return [parameter for part in stated for parameter in part.parameters()]


def restricting_attribute(leaf: Any, *, takes_integers: bool = False) -> str | None:
    """Return the attribute that ties or restricts entries of a variable or parameter, or None."""
    names = (*FORBIDDEN_ATTRIBUTES, *(() if takes_integers else INTEGERS))
    states = ((name, leaf.attributes.get(name)) for name in names)
    return next((name for name, state in states if not (state is None or state is False)), None)
