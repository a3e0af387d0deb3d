"""The cases of a small problem in doubles, compiled: a solution, or a tree for exact arithmetic to check."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

import numpy as np

from ...certificates.no_solution import Case
from ...certificates.refutation import LOWER, SLACKLESS, UPPER
from ...checks import FloatVector
from ...exact.rational import integers
from ...matrix.parts import IntVector
from ...problem.lcp import LCP
from ..short_road import as_dense

MOST_CASES = 4096
CHOICES = (LOWER, SLACKLESS, UPPER)  # as numbered in `kernels.cases`


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
        As `kernels.cases` writes them.
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
    from ...kernels import cases as kernels

    n = problem.n
    most = min(MOST_CASES, 3 ** (n + 1))  # more than there are
    nodes, y, z = np.empty((most, 4), np.int64), np.empty((most, n + 1)), np.empty(n)
    M = as_dense(problem.matrix)[0]
    with np.errstate(all="ignore"):
        found, cases, entries, least = kernels.look_at(
            M, problem.q, problem.lower, problem.upper, float(most_entries), nodes, y, z
        )
        if found == kernels.FOUND and np.isfinite(z).all():
            return Outline(z, 0.0, cases, entries, nodes[:0], y[:0])
        if found != kernels.EXCLUDED or not np.isfinite(y[:cases][nodes[:cases, kernels.ROW] < 0]).all():
            return Outline(None, 0.0, cases, entries, nodes[:0], y[:0])
    return Outline(None, least, cases, entries, nodes[:cases], y[:cases])


def _tree(nodes: list[list[int]], y: FloatVector) -> Case:
    """Return the cases of the kernel as a tree."""
    cases = [Case(row) for row, *_ in nodes]
    for k, (row, parent, choice, _) in enumerate(nodes):
        if parent >= 0:
            cases[parent].branches[CHOICES[choice]] = cases[k]
        if row < 0:
            cases[k].y = [Fraction(value) for value in integers(y[k, :-1])[0]]
    return cases[0]
