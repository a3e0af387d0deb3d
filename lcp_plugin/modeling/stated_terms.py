"""The objective and the constraints of a cvxpy problem as its user stated them, at any values of its variables."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints import Equality, Inequality, NonNeg
from numpy.typing import NDArray

from ._compat import SUM, attribute_bounds, attribute_expressions, postorder

Values = dict[int, Any]

SEED = 16
STEPS = (1.0, 0.1, 0.01)  # of 1 + |x|, where a Lagrangian is looked at
MOST_KEPT = 10**6  # numbers in all nodes at all points that are kept


class Terms(NamedTuple):
    """The objective, which is to be minimised, and the slacks, which are to be zero or not positive, at one point."""

    goal: float
    slacks: list[NDArray[np.float64]]
    #: 1 + the largest term that the objective, number 0, or a constraint is made of; looked for only where it matters.
    size: Callable[[int], float]


class _Node(NamedTuple):
    """An atom, and the keys of its value and of its arguments' values among those of all nodes."""

    key: int
    atom: Any
    arguments: tuple[int, ...]
    is_empty: bool

    @classmethod
    def of(cls, atom: Any) -> _Node:
        return cls(id(atom), atom, tuple(map(id, atom.args)), 0 in atom.shape)

    def put_into(self, results: Values) -> None:
        given = [results[key] for key in self.arguments]
        results[self.key] = np.array([]) if self.is_empty else self.atom.numeric(given)


class _Trials(NamedTuple):
    """Points around a base: the values of all nodes there, and a line of entries for each."""

    base: Values
    results: list[Values]
    lines: NDArray[np.float64]

    def is_near(self, values: Values) -> bool:
        """Return whether the values are no farther from the base than the farthest points are."""
        return all((np.abs(values[key] - x) <= STEPS[0] * (1.0 + np.abs(x))).all() for key, x in self.base.items())


class StatedTerms:
    """The objective and the constraints, as the user stated them, at any values of the variables.

    cvxpy's own ``value`` asks every node of an expression for all parameters below it, each time anew. Here each node
    is listed once, what no variable enters is computed once, and the variables themselves are not touched. Kept for
    other solves of the problem, it computes at the points that it knows only what parameters enter.

    Parameters
    ----------
    problem : cvxpy.Problem
        Its parameters have values, which are taken now, and again by `take_parameters`.
    """

    def __init__(self, problem: Any) -> None:
        self._signs = [sense_of(problem)] + [-1.0 if isinstance(c, NonNeg) else 1.0 for c in problem.constraints]
        self._roots = [problem.objective.args[0], *map(expression_of, problem.constraints)]
        ends = np.cumsum([0, *(root.size for root in self._roots)]).tolist()
        self._places = [slice(*ends[k : k + 2]) for k in range(len(self._roots))]
        nodes: dict[int, Any] = {}
        for root in self._roots:
            nodes |= {id(node): node for node in postorder(root, nodes)}
        leaves = [node for node in nodes.values() if not node.args]
        self._variables = [leaf for leaf in leaves if isinstance(leaf, cp.Variable)]
        self._parameters = [leaf for leaf in leaves if isinstance(leaf, cp.Parameter)]
        moving, steered = (set(map(id, some)) for some in (self._variables, self._parameters))
        self._values: Values = {id(leaf): leaf.value for leaf in leaves if id(leaf) not in moving}
        self._moving, self._fixed = list[_Node](), list[_Node]()
        for key, atom in nodes.items():
            if not atom.args:
                continue
            node = _Node.of(atom)
            if not steered.isdisjoint(node.arguments):
                steered.add(key)
            if moving.isdisjoint(node.arguments):
                self._fixed.append(node)
            else:
                moving.add(key)
                self._moving.append(node)
        #: Points around an earlier base may lie outside other bounds.
        self._is_kept = all(attribute_expressions(variable) is None for variable in self._variables)
        for node in self._fixed:
            node.put_into(self._values)
        self._steered = [[node for node in some if node.key in steered] for some in (self._fixed, self._moving)]
        self._steered_roots = [k for k, root in enumerate(self._roots) if id(root) in steered]
        self._latest: tuple[Values, Values] | None = None
        self._trials: _Trials | None = None

    def take_parameters(self) -> None:
        """Take the present values of the parameters, here and at the points that are kept."""
        if not self._parameters:
            return
        fixed, moving = self._steered
        self._values |= {id(parameter): parameter.value for parameter in self._parameters}
        for node in fixed:
            node.put_into(self._values)
        trials = self._trials
        for results in [*([self._latest[1]] if self._latest else ()), *(trials.results if trials else ())]:
            results.update(self._values)
            for node in moving:
                node.put_into(results)
        if trials is not None:
            for line, results in zip(trials.lines, trials.results, strict=True):
                self._put_into(line, results, self._steered_roots)

    def at(self, values: Values) -> Terms:
        """Return the objective and the slacks at the dense values of the variables, by their ids."""
        results = self._results(values)
        if self._is_kept and sum(map(np.size, results.values())) * 2 * len(STEPS) > MOST_KEPT:
            self._is_kept = False
        if self._is_kept:
            self._latest = {variable.id: values[variable.id].copy() for variable in self._variables}, results
        goal, *slacks = (self._term(k, results) for k in range(len(self._roots)))
        return Terms(float(goal.ravel()[0]), slacks, partial(self._size, results))

    def lines(self, points: Iterable[Values]) -> NDArray[np.float64]:
        """Return a line for each point: the objective, then the entries of each slack, column by column."""
        return self._lines([self._results(values) for values in points])

    def lines_around(self, base: Values) -> NDArray[np.float64]:
        """Return the lines of points on either side of the base, or of an earlier one near it."""
        trials = self._trials
        if trials is None or not trials.is_near(base):
            every = [self._results(values) for values in self.points_around(base)]
            trials = _Trials(base, every, self._lines(every))
        self._trials = trials if self._is_kept else None
        return trials.lines

    def points_around(self, base: Values) -> list[Values]:
        """Return points on either side of the base, near and far, that have the variables' attributes."""
        generator, sizes = np.random.default_rng(SEED), np.outer(STEPS, [1.0, -1.0]).ravel()
        every = {}
        for variable in self._variables:
            x = base[variable.id]
            across = np.repeat(generator.normal(size=(len(STEPS), *x.shape)), 2, axis=0)
            steps = across * sizes.reshape(-1, *[1] * x.ndim) * (1.0 + np.abs(x))
            every[variable.id] = nearest(variable, x + steps)
        return [{key: points[k] for key, points in every.items()} for k in range(sizes.size)]

    def _results(self, values: Values) -> Values:
        """Return the values of all nodes."""
        if self._latest is not None and all(np.array_equal(x, values[key]) for key, x in self._latest[0].items()):
            return self._latest[1]
        results = self._values | {id(variable): values[variable.id] for variable in self._variables}
        for node in self._moving:
            node.put_into(results)
        return results

    def _term(self, k: int, results: Values) -> NDArray[np.float64]:
        return self._signs[k] * dense_value(results[id(self._roots[k])])

    def _lines(self, every: list[Values]) -> NDArray[np.float64]:
        lines = np.empty((len(every), self._places[-1].stop))
        for line, results in zip(lines, every, strict=True):
            self._put_into(line, results, range(len(self._roots)))
        return lines

    def _put_into(self, line: NDArray[np.float64], results: Values, roots: Iterable[int]) -> None:
        for k in roots:
            line[self._places[k]] = np.ravel(self._term(k, results), order="F")

    def _size(self, results: Values, k: int) -> float:
        size = 0.0
        for node in postorder(self._roots[k], ()):
            if not node.args and not isinstance(node, cp.Variable):
                continue
            parts = [entries_of(results[id(argument)]) for argument in node.args]
            size = max(size, float(entries_of(results[id(node)]).max(initial=0.0)))
            is_sum = isinstance(node, SUM)
            for part, argument in zip(parts, node.args, strict=True):
                if is_sum:
                    size = max(size, float(part.max(initial=0.0)))
                elif argument.size > node.size:  # something adds them up
                    size = max(size, float(part.sum()))
            if len(parts) == 2 and not is_sum:
                size = max(size, float(parts[0].max(initial=0.0) * parts[1].max(initial=0.0)))
        return 1.0 + size


def nearest(variable: Any, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a point, or some, with the variable's attributes, all of them: cvxpy's own projection knows one at a time.

    Parameters
    ----------
    x : array, shape (…, *shape of the variable)
    """
    attributes, bounds = variable.attributes, attribute_bounds(variable)
    is_patterned = getattr(variable, "sparse_idx", None) is not None
    if not (attributes["symmetric"] or attributes["diag"] or is_patterned or any(np.isfinite(b).any() for b in bounds)):
        return x
    lower, upper = (np.broadcast_to(bound, variable.shape) for bound in bounds)
    if attributes["symmetric"]:
        lower, upper = np.maximum(lower, np.swapaxes(lower, -2, -1)), np.minimum(upper, np.swapaxes(upper, -2, -1))
        x = (x + np.swapaxes(x, -2, -1)) / 2
    if attributes["diag"]:
        x = x * np.eye(*variable.shape)
    if is_patterned:
        pattern = np.zeros(variable.shape)
        pattern[tuple(variable.sparse_idx)] = 1.0
        x = x * pattern
    return np.clip(x, lower, upper)


def sense_of(problem: Any) -> float:
    """Return 1 where the objective is to be minimised, −1 where it is to be maximised."""
    return -1.0 if isinstance(problem.objective, cp.Maximize) else 1.0


def expression_of(constraint: Any) -> Any:
    """Return what has to be zero, or of one sign."""
    return constraint.expr if isinstance(constraint, (Equality, Inequality)) else constraint.args[0]


def dense_value(value: Any) -> NDArray[np.float64]:
    """Return the real part of a value as a dense array."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    array = value.toarray() if sp.issparse(value) else np.asarray(value)
    return np.asarray(array.real, dtype=np.float64)


def entries_of(value: Any) -> NDArray[np.float64]:
    """Return the sizes of the stored entries of a value: what is sparse stays so, the other entries are 0."""
    return np.abs((value.tocoo().data if sp.issparse(value) else np.asarray(value)).real.astype(np.float64))
