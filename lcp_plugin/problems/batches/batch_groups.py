"""Problems of a batch that share a compiled call: as they are, or in a common scaling."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.algorithm import Phases
from ...core.certificates.criterion import CommonScaling, beside_the_largest, within
from ...core.certificates.residuals import Certificate
from ...core.certificates.row_residuals import largest_ratio
from ...core.checks import BoolVector, read_only
from ...core.lcp import LCP
from ...core.matrix.scaling import are_well_scaled
from ...core.matrix.structure import IntVector, connected_components
from ...core.settings import Settings
from ...methods.small.small_dense import Answers, run_phases


class Group(NamedTuple):
    """Problems of one size as arrays for a compiled run; one row in front stands for all of them.

    Attributes
    ----------
    items : array of int, shape (k,)
        Which of the batch they are.
    M : array, shape (k or 1, n, n)
    q, lower, upper, starts : arrays, shape (k or 1, n)
        Without columns, `starts` means z°.
    """

    items: Any
    M: Any
    q: Any
    lower: Any
    upper: Any
    starts: Any

    @property
    def shape(self) -> tuple[int, int]:
        """How many problems there are, and the unknowns of each."""
        return self.items.size, self.M.shape[1]

    def chosen(self, rows: IntVector) -> Group:
        """Return the problems in these rows."""
        if rows.size == self.items.size:
            return self
        return Group(
            self.items[rows], *(array if len(array) == 1 else array[rows] for array in self[1:])
        )

    def vectors(self, *names: str) -> list[Any]:
        """Return these vectors of all problems, each of shape (k, n)."""
        return [np.broadcast_to(getattr(self, name), self.shape) for name in names]

    def block_diagonal(self) -> LCP:
        """Return the problem of all of them."""
        count, n = self.shape
        M = np.broadcast_to(self.M, (count, n, n))
        blocks, rows, columns = np.nonzero(M)
        places = blocks * n + rows, blocks * n + columns
        q, lower, upper = (vector.reshape(-1) for vector in self.vectors("q", "lower", "upper"))
        M = sp.csr_array((M[blocks, rows, columns], places), shape=(count * n, count * n))
        return LCP(M, q, lower=lower, upper=upper)


def well_scaled(group: Group) -> Group:
    """Return the problems that the criterion does not scale; a compiled loop knows of no others."""
    are = are_well_scaled(group.M)
    return (
        group
        if are.all()
        else group.chosen(np.flatnonzero(are & np.ones(group.items.size, np.bool_)))
    )


def by_components(group: Group) -> tuple[Group, Group]:
    """Return the problems of one component, and those that may have several."""
    is_open = _may_have_components(group.M) & np.ones(group.items.size, np.bool_)
    return group.chosen(np.flatnonzero(~is_open)) if is_open.any() else group, group.chosen(
        np.flatnonzero(is_open)
    )


def _may_have_components(M: Any) -> BoolVector:
    """Return where not every row but the first meets one before it, shape (k,)."""
    is_open: BoolVector = ~(M[:, 0, 1:] != 0.0).all(axis=1)
    some = np.flatnonzero(is_open)
    if some.size:
        nonzero = M[some] != 0.0
        before = np.tril(nonzero | nonzero.transpose(0, 2, 1), -1).any(axis=2)
        is_open[some] = ~before[:, 1:].all(axis=1)
    return is_open


def answers_in_common_scaling(group: Group, phases: Phases, settings: Settings) -> Answers:
    """Return the answers of the compiled loop to problems each component of which is judged by its own reference."""
    (count, n), answers = group.shape, Answers(*group.shape)
    problem = group.block_diagonal()
    scaling = CommonScaling.of(problem)
    several = connected_components(problem.matrix)
    labels = np.zeros(count * n, np.int64) if several is None else several.labels
    ends = np.append(
        labels[::n], labels.max() + 1
    )  # components are numbered in the order of their first rows
    vectors = [
        read_only(getattr(scaling.problem, name).reshape(count, n))
        for name in ("q", "lower", "upper")
    ]
    M, starts = group.M, group.starts
    if starts.shape[1]:
        starts = read_only(scaling.inward(group.vectors("starts")[0].reshape(-1)).reshape(count, n))
    least, most = scaling.references
    for k in range(count):
        own = slice(ends[k], ends[k + 1])
        tolerance = beside_the_largest(least[own], most[own], settings.tolerance)
        run_phases(
            (M, *vectors, starts), phases, tolerance, settings.max_iterations, k, k + 1, answers
        )
    certificate = Certificate.of(scaling.stated, scaling.outward(answers.z.reshape(-1)))
    answers.z[:] = certificate.z.reshape(count, n)
    largest, least = certificate.residuals_of_components
    for k in np.flatnonzero(answers.has_converged).tolist():
        answers.residual[k] = largest_ratio(
            largest[ends[k] : ends[k + 1]], least[ends[k] : ends[k + 1]]
        )
    answers.terms[:] = certificate.term_residuals.reshape(count, n).max(axis=1)
    answers.has_converged &= within(answers.residual, answers.terms, settings.tolerance)
    return answers
