"""One stressed problem, its exact answer, and the blocks that such problems are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...checks import FloatVector
from ...problem.exactly import exact_slack
from ...problem.lcp import LCP
from ..gallery.stencil import stencil_matrix
from .exact_answers import Answer, condition_of_answer, exact_answer

LARGEST_INTEGER = 9


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """A problem under one stress.

    Parameters
    ----------
    stress : str
        What is extreme about it, with the number.
    problem : LCP
    near : sequence of float, shape (n,), optional
        A point on the right bounds, from which the exact answer is found; None where there is no solution.
    start : ndarray, shape (n,), optional
        z0 of the runs.
    unit : ndarray, shape (n,), optional
        In which each component of z is measured; 1 by default.
    has_line : bool
        All z* + t with t ≥ 0 are solutions.
    reference : sequence of Fraction, shape (n,), optional
        The answer of the same problem before a change of 1 ulp.
    """

    stress: str
    problem: LCP = field(repr=False)
    near: Sequence[float] | FloatVector | None = field(default=None, repr=False)
    start: FloatVector | None = field(default=None, repr=False)
    unit: FloatVector | None = field(default=None, repr=False)
    has_line: bool = False
    reference: Answer | None = field(default=None, repr=False)

    @property
    def units(self) -> FloatVector:
        """The unit of each component of z, shape (n,)."""
        return np.ones(self.problem.n) if self.unit is None else self.unit

    @cached_property
    def exact(self) -> Answer | None:
        """z* in fractions, verified exactly; None where there is no solution."""
        return None if self.near is None else exact_answer(self.problem, [float(value) for value in self.near])

    @cached_property
    def condition(self) -> float:
        """See `condition_of_answer`; ∞ where the answer is not unique or does not exist."""
        if self.exact is None or self.has_line:
            return np.inf
        return condition_of_answer(self.problem, self.exact, self.units)


def grid(size: int, centre: Any = 4.0, below: Any = (-1.0, -1.0), above: Any = (-1.0, -1.0)) -> sp.csr_array:
    """Return a five-point matrix on size × size nodes, −Δ by default."""
    return stencil_matrix((size, size), centre, below, above)


def pattern(n: int, *, active: float = 0.5, degenerate: float = 0.0, seed: int = 0) -> tuple[FloatVector, FloatVector]:
    """Return complementary integer vectors z, w with these shares of active and, among them, degenerate rows."""
    generator = np.random.default_rng(seed)
    z, w = generator.integers(1, LARGEST_INTEGER + 1, size=(2, n)).astype(np.float64)
    order = generator.permutation(n)
    count = round(active * n)
    z[order[:count]] = 0.0
    w[order[count:]] = 0.0
    w[order[: round(degenerate * count)]] = 0.0
    return z, w


def planted(stress: str, M: Any, z: FloatVector, w: FloatVector, **facts: Any) -> Case:
    """Return the case with q = w − M z, each entry rounded once; the exact answer then belongs to the rounded q."""
    unrounded = exact_slack(LCP(M, np.zeros(z.size)), z)
    q = [float(Fraction(value) - product) for value, product in zip(w.tolist(), unrounded, strict=True)]
    return Case(stress=stress, problem=LCP(M, q), near=z, **facts)


def half_active(stress: str, M: Any, *, degenerate: float = 0.0, seed: int = 0, **facts: Any) -> Case:
    """Return a case with this matrix and an answer of small integers, half of it active, here and there.

    On the active rows w is a small integer times the diagonal.
    """
    z, w = pattern(M.shape[0], degenerate=degenerate, seed=seed)
    return planted(stress, M, z, w * np.abs(M.diagonal()), **facts)


def mostly_free(stress: str, M: Any, *, seed: int = 0, **facts: Any) -> Case:
    """Return a case with this matrix and an answer of small integers whose first fifth is active, in one piece.

    What couples far-off rows can then be felt.
    """
    n = M.shape[0]
    z, w = np.random.default_rng(seed).integers(1, LARGEST_INTEGER + 1, size=(2, n)).astype(np.float64)
    is_active = np.arange(n) < n // 5
    return planted(stress, M, np.where(is_active, 0.0, z), np.where(is_active, w * np.abs(M.diagonal()), 0.0), **facts)


def rescaled(stress: str, case: Case, row: Any, column: Any) -> Case:
    """Return the case with rows multiplied by `row` and z measured in units of 1/`column`."""
    problem = case.problem
    row, column = (np.broadcast_to(np.asarray(factor, dtype=np.float64), problem.n) for factor in (row, column))
    M = problem.csr.copy()
    # One factor after the other: their product may overflow although the entry does not.
    data = M.data * np.repeat(row, np.diff(M.indptr)) * column[M.indices]
    scaled = sp.csr_array((data, M.indices, M.indptr), shape=M.shape)
    unit = 1.0 / column
    near = None if case.near is None else np.asarray(case.near) * unit
    start = None if case.start is None else case.start * unit
    return Case(
        stress=stress, problem=LCP(scaled, problem.q * row), near=near, start=start, unit=unit, has_line=case.has_line
    )
