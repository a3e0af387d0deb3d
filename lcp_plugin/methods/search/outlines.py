"""What a compiled pass over the cases in doubles sees: a solution, or a tree for exact arithmetic to check."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.matrix.structure import IntVector
from ...core.rounding import read_only_views
from ...proofs.exact.rational import integers
from ...proofs.no_solution.infeasibility import Case
from ...proofs.no_solution.proof import LOWER, SLACKLESS, UPPER
from ..small.small_dense import as_dense

MOST_CASES = 4096  # for one solution
MOST_OF_ALL = 2**16
MOST_ENTRIES = 1e9  # about a second
CHOICES = (LOWER, SLACKLESS, UPPER)  # as numbered in `methods.search.kernels`
UNUSED = -2


@dataclass(frozen=True, eq=False)
class Outline:
    """What a pass in doubles found; nothing of it is proved.

    Attributes
    ----------
    z : ndarray, shape (n,), or None
        A solution to rounding.
    least_residual : float
        About the least relative residual of any z, where every case seems to contradict; 0 elsewhere.
    cases : int
        That were looked at.
    entries : float
        Of the tableau that were computed.
    nodes, y : arrays
        As `methods.search.kernels` writes them.
    """

    z: FloatVector | None
    least_residual: float
    cases: int
    entries: float
    nodes: IntVector = field(repr=False)
    y: FloatVector = field(repr=False)

    @cached_property
    def tree(self) -> Case | None:
        """All cases where each seems to contradict, with Farkas vectors to be verified."""
        return _tree(self.nodes.tolist(), self.y) if self.nodes.size else None


def outline(problem: LCP, most_entries: float) -> Outline:
    """Return what one pass over the cases finds before it has computed so many entries of its tableau.

    Examples
    --------
    >>> outline(LCP([[0, 2], [1, 0]], [-1, -1]), 1e6).z.tolist()
    [1.0, 0.5]
    >>> found = outline(LCP([[1, -2, 1], [-3, 2, -2], [1, -2, 0]], [-1, 2, 2]), 1e6)
    >>> found.tree is not None, round(found.least_residual, 3) > 0.0
    (True, True)
    """
    from . import kernels  # numba, which a program that engines solve does without

    (found, cases, entries, least), nodes, y, z = _looked_at(
        problem, most_entries, MOST_CASES, first=True
    )
    if found == kernels.FOUND and np.isfinite(z).all():
        return Outline(z, 0.0, cases, entries, nodes[:0], y[:0])
    if (
        found != kernels.EXCLUDED
        or not np.isfinite(y[:cases][nodes[:cases, kernels.ROW] < 0]).all()
    ):
        return Outline(None, 0.0, cases, entries, nodes[:0], y[:0])
    return Outline(None, least, cases, entries, nodes[:cases], y[:cases])


def whole_tree(problem: LCP) -> Case:
    """Return the cases that a search for all solutions has to look at: most are closed by Farkas vectors.

    Each of these is to be verified, and what is left open holds a solution, or was not come to.

    Examples
    --------
    >>> tree = whole_tree(LCP([[0, 2], [1, 0]], [-1, -1]))
    >>> tree.branches["lower"].y is not None, tree.branches["zero"].y is None
    (True, True)
    """
    from . import kernels

    _, nodes, y, _ = _looked_at(problem, MOST_ENTRIES, MOST_OF_ALL, first=False)
    count = int(np.count_nonzero(nodes[:, kernels.PARENT] != UNUSED))
    return _tree(nodes[:count].tolist(), y)


def _looked_at(
    problem: LCP, most_entries: float, most_cases: int, *, first: bool
) -> tuple[Any, ...]:
    from . import kernels

    n = problem.n
    most = min(most_cases, 3 ** (n + 1))  # more than there are
    nodes, y, z = np.full((most, 4), UNUSED), np.empty((most, n + 1)), np.empty(n)
    data = read_only_views(as_dense(problem.matrix)[0], problem.q, problem.lower, problem.upper)
    ended = kernels.look_at(*data, float(most_entries), first, nodes, y, z)
    return ended, nodes, y, z


def _tree(nodes: list[list[int]], y: FloatVector) -> Case:
    """Return the cases of the kernel as a tree."""
    cases = [Case(row) for row, *_ in nodes]
    for k, (_, parent, choice, is_closed) in enumerate(nodes):
        if parent >= 0:
            cases[parent].branches[CHOICES[choice]] = cases[k]
        if is_closed and np.isfinite(y[k]).all():
            cases[k].y = integers(y[k, :-1])[0]
    return cases[0]
