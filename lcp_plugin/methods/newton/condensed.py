"""Static condensation: unknowns without bounds are eliminated by one factor, which serves all problems of one M.

With B the rows that have a bound and I the others, w_I = 0 gives z_I = −M_II⁻¹(M_IB z_B + q_I), and z_B solves the LCP
of the Schur complement S = M_BB − M_BI M_II⁻¹ M_IB. A contact problem has few such rows: those that may touch.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...core.algorithm import Algorithm, Step, without_warnings
from ...core.certificates.row_residuals import scaled_residual
from ...core.checks import BoolVector, FloatVector
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from ...systems.factors import sizes_of_factor
from ...systems.free_systems import FreeSystem
from .semismooth_newton import Newton

BOUNDED_UP_TO = 1000  # rows: the LCP that remains is dense
BOUNDED_SHARE = 0.1  # of all rows
COLUMNS = 64  # that are solved for at once
NO_GAIN = 0.5  # a round that reduces the residual by less is the last one


class Condensation:
    """The LCP of the Schur complement on the rows with a bound, and what puts the others back.

    Where the block of the others is singular to working precision, there is none, and `problem` is None.

    Attributes
    ----------
    work, solve_work : float
        Multiplications that all this has taken, and that one solution with M_II takes.
    """

    problem: LCP | None = None
    solve_work = 0.0

    def __init__(self, matrix: Matrix, bounded: BoolVector) -> None:
        self.others, self.rows = (
            FreeSystem(matrix, ~bounded, by_factor=True),
            np.flatnonzero(bounded),
        )
        self.work = self.others.work
        if self.others.is_singular:
            return
        self.coupling, self.columns = matrix.csr[self.rows], matrix.csc[:, self.rows]
        count = self.rows.size
        complement = np.empty((count, count))
        for first in range(0, count, COLUMNS):
            part = self.columns[:, first : first + COLUMNS].toarray()
            held = np.arange(first, min(first + COLUMNS, count))
            whole = -self.free(part)
            whole[self.rows[held], held - first] = 1.0
            complement[:, held] = self.coupling @ whole
        self.solve_work, self.work = (
            (self.others.work - self.work) / max(count, 1),
            self.others.work,
        )
        if np.isfinite(complement).all():
            self.problem = LCP(complement, np.zeros(count))

    def free(self, right: FloatVector) -> FloatVector:
        """Return M_II⁻¹ of what the right-hand sides have there, 0 on the rows with a bound."""
        x = np.zeros_like(right)
        x[self.others.rows] = self.others.solve_as_is(right[self.others.rows])
        return x


@fact
def condensation(matrix: Matrix, packed: bytes) -> Condensation:
    """Return that of the rows whose bits are set: it serves all steps, and all marches of the same M."""
    return Condensation(
        matrix, np.unpackbits(np.frombuffer(packed, np.uint8), count=matrix.n).astype(np.bool_)
    )


@dataclass(frozen=True, kw_only=True)
class Condensed(Algorithm):
    """newton on the Schur complement of the rows with a bound, in rounds that refine the others."""

    name: ClassVar[str] = "condensed"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then z after each round; end where a round gains nothing."""
        return without_warnings(self._steps(problem, z0))

    def _steps(self, problem: LCP, z: FloatVector) -> Iterator[Step]:
        entries, packed = max(problem.nonzeros, 1), np.packbits(has_bound(problem)).tobytes()
        is_known = condensation.is_known(problem.matrix, packed)
        known = condensation(problem.matrix, packed)
        w = problem.slack(z)
        residual = float(np.abs(scaled_residual(problem, z, w)).max(initial=0.0))
        yield Step(z, residual, work=1.0 + (0.0 if is_known else known.work / entries))
        while known.problem is not None:
            change, rows = -known.free(w), known.rows
            offset = w[rows] + known.coupling @ change - known.problem.matrix.array @ z[rows]
            smaller = known.problem.with_q(
                offset, lower=problem.lower[rows], upper=problem.upper[rows]
            )
            held, spent = z[rows], 0.0
            for step in Newton().iterates(smaller, held.copy()):
                held, spent = step.z, spent + step.work * smaller.nonzeros
            moved = held - z[rows]
            z = z + change - known.free(known.columns @ moved)
            z[rows] = held
            w, before = problem.slack(z), residual
            residual = float(np.abs(scaled_residual(problem, z, w)).max(initial=0.0))
            yield Step(z, residual, work=4.0 + (2.0 * known.solve_work + spent) / entries)
            if not residual < NO_GAIN * before:
                return


def has_bound(problem: LCP) -> BoolVector:
    """Return which rows have a bound that is finite."""
    bounded: BoolVector = np.isfinite(problem.lower) | np.isfinite(problem.upper)
    return bounded


def condensing_passes(problem: LCP) -> float:
    """Return about how many passes over M condensing takes, in operations; ∞ where many rows have a bound, or none."""
    count = int(np.count_nonzero(has_bound(problem)))
    if not 0 < count <= min(BOUNDED_UP_TO, BOUNDED_SHARE * problem.n) or problem.is_dense:
        return math.inf
    fill, operations = sizes_of_factor(problem.matrix)
    return (operations + 2.0 * fill * count + count**3) / max(problem.nonzeros, 1)
