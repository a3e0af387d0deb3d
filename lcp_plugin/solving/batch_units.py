"""Problems of a batch that have several parts: brought to common units all at once, as one problem of all of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..algorithms.base import Plan
from ..algorithms.short_road import Answers, run
from ..certificates.quotients import largest_ratio
from ..certificates.references import CommonUnits
from ..certificates.residuals import Certificate
from ..checks import BoolVector, FloatVector, read_only
from ..matrix.parts import IntVector, parts
from ..problem.lcp import LCP
from ..settings import Settings
from .batch_items import Group
from .driver import beside_the_largest


def by_parts(group: Group) -> tuple[Group | None, Group | None]:
    """Return the problems of one part and those that may have several; None where there are none."""
    is_open = _may_have_parts(group.M)
    if not is_open.any():
        return group, None
    if group.M.shape[0] == 1 or is_open.all():
        return None, group
    return chosen(group, np.flatnonzero(~is_open)), chosen(group, np.flatnonzero(is_open))


def _may_have_parts(M: Any) -> BoolVector:
    """Return where not every row but the first meets one before it, shape (k,)."""
    is_open: BoolVector = ~(M[:, 0, 1:] != 0.0).all(axis=1)
    some = np.flatnonzero(is_open)
    if some.size:
        nonzero = M[some] != 0.0
        before = np.tril(nonzero | nonzero.transpose(0, 2, 1), -1).any(axis=2)
        is_open[some] = ~before[:, 1:].all(axis=1)
    return is_open


def chosen(group: Group, rows: IntVector) -> Group:
    """Return the problems in these rows of a group."""
    named = {name: getattr(group, name) for name in ("items", "M", "q", "lower", "upper", "starts")}
    return Group(**{name: array if len(array) == 1 and name != "items" else array[rows]
                    for name, array in named.items()})


class GroupInCommonUnits:
    """Problems of a batch as one block diagonal problem, each part of which is judged by its own reference.

    Parameters
    ----------
    group : Group
    """

    def __init__(self, group: Group) -> None:
        count, n = group.items.size, group.M.shape[1]
        self.shape = count, n
        problem = block_diagonal(group)
        self.units = units = CommonUnits.of(problem)
        several = parts(problem.matrix)
        labels = np.zeros(count * n, np.int64) if several is None else several.labels
        self._ends = np.append(labels[::n], labels.max() + 1)  # parts are numbered in the order of their first rows
        given = {name: read_only(getattr(units.problem, name).reshape(count, n)) for name in ("q", "lower", "upper")}
        starts = group.starts
        if starts.shape[1]:
            starts = units.inward(np.broadcast_to(starts, self.shape).reshape(-1)).reshape(self.shape)
        self.group = replace(group, starts=read_only(starts), **given)

    def run(self, plan: Plan, settings: Settings) -> Answers:
        """Return the answers of the compiled loop in the caller's units."""
        answers, group = Answers(*self.shape), self.group
        arrays = group.M, group.q, group.lower, group.upper, group.starts
        least, most = self.units.references
        for k in range(self.shape[0]):
            own = slice(self._ends[k], self._ends[k + 1])
            tolerance = beside_the_largest(least[own], most[own], settings.tolerance)
            run(arrays, plan, tolerance, settings.max_iterations, k, k + 1, answers)
        self._judge(answers, settings.tolerance)
        return answers

    def _judge(self, answers: Answers, tolerance: float) -> None:
        """Bring the answers back, and keep those that the caller's data show to be within the tolerance."""
        certificate = Certificate.of(self.units.callers, self.units.outward(answers.z.reshape(-1)))
        answers.z[:] = certificate.z.reshape(self.shape)
        largest, least = certificate.residuals_of_parts
        for k in np.flatnonzero(answers.has_arrived).tolist():
            own = slice(self._ends[k], self._ends[k + 1])
            answers.residual[k] = largest_ratio(largest[own], least[own])
            answers.has_arrived[k] = answers.residual[k] <= tolerance


def block_diagonal(group: Group) -> LCP:
    """Return the problem of all problems of a group."""
    count, n = group.items.size, group.M.shape[1]
    blocks, rows, columns = np.nonzero(np.broadcast_to(group.M, (count, n, n)))
    entries = np.broadcast_to(group.M, (count, n, n))[blocks, rows, columns]
    M = sp.csr_array((entries, (blocks * n + rows, blocks * n + columns)), shape=(count * n, count * n))
    vectors: list[FloatVector] = [
        np.broadcast_to(vector, (count, n)).reshape(-1) for vector in (group.q, group.lower, group.upper)
    ]
    return LCP(M, vectors[0], lower=vectors[1], upper=vectors[2])
