"""Active sets of banded problems, in compiled rounds: O(n) each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ...core.algorithm import Algorithm, FusedSolve, Step, check_flag
from ...core.certificates.criterion import within
from ...core.certificates.row_residuals import ratio_upwards
from ...core.checks import FloatVector, read_only
from ...core.errors import UnsuitableMatrix
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.structure import IntVector
from ...core.tuning import BANDED_PASSES, BANDED_ROUNDS, BOXED_ROUNDS
from ...systems.factors import Bands, bands
from ...systems.graph import bandwidth

DIRECT_COST = 3.0  # passes over a tridiagonal M: the contacts, the other rows, the residual


class FusedMarches(NamedTuple):
    """Steps that one compiled loop has taken.

    Attributes
    ----------
    steps : int
        How many there are.
    answers : array, shape (m, k, n)
        Those of the kept steps.
    before, last : arrays, shape (m, n)
        The states before the last step, where there is one, and after it.
    solve_of : callable
        Called with the numbers of a march and a step, and its answer, returns its fused solve.
    """

    steps: int
    answers: FloatVector
    before: FloatVector
    last: FloatVector
    solve_of: Callable[[int, int, FloatVector], FusedSolve]


@dataclass(frozen=True, kw_only=True)
class Banded(Algorithm):
    """Active sets of a banded M, by compiled rounds: solve for the rows off their bounds, then change what is wrong.

    Notes
    -----
    A round is a factorisation of the free block, with pivots from the column, within the band: O(n) on a narrow one.
    Then all wrong rows change, those whose z leaves the bounds or whose w has the wrong sign; where that makes neither
    them nor the rows at bounds fewer for a while, half of them by lot, up to 200 times. On M-matrices bounded on one
    side the changes are monotone and finite. An active set that comes out again has its z refined once. A start says
    which bounds hold at first.

    Where M is tridiagonal and no entry off the diagonal is positive, the rows at their bounds on one side are found
    directly, in O(n), those at the other side held: bounds on one side take one round, boxes some, in which the sides
    take turns. Where 30 turns have not settled it, one side stays: on an M-matrix z is monotone then, and rows only
    leave the other side, so that it ends. The direct part is the method of Brennan and Schwartz where the contact set
    is one interval at an end, Cryer's in general.

    Parameters
    ----------
    hands_over : bool
        Whether to end after a few changes by lot, as where another method is to follow.

    References
    ----------
    Cryer 1983, *ACM Trans. Math. Software* 9, 199–214, doi:10.1145/357456.357458. Brennan, Schwartz 1977, *J. Finance*
    32, 449–462, doi:10.2307/2326779. Chandrasekaran 1970, *Opsearch* 7, 263–268. Júdice, Pires 1994,
    doi:10.1016/0305-0548(94)90106-6.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[2, -1, 0], [-1, 2, -1], [0, -1, 2]], [-3, 4, 1])
    >>> lcp_plugin.solve(problem, Banded()).z
    array([1.5, 0. , 0. ])
    """

    name: ClassVar[str] = "banded"
    needs: ClassVar[str] = "a narrow band"
    solves: ClassVar[str] = "M-matrices, bounds on one side; tridiagonal ones"
    cost: ClassVar[str] = "1 factorisation of the band"
    reference: ClassVar[str] = (
        "Cryer 1983, doi:10.1145/357456.357458; Júdice, Pires 1994, doi:10.1016/0305-0548(94)90106-6"
    )
    is_monotone: ClassVar[bool] = False
    ends_with_a_case: ClassVar[bool] = True

    hands_over: bool = False

    def __post_init__(self) -> None:
        check_flag(self, "hands_over")

    def predicted_passes(self, problem: LCP, sweeps: float) -> float:
        """Return those of as many rounds as there usually are; ∞ where M is dense."""
        return math.inf if problem.is_dense else _predicted_passes(problem.matrix)

    def theorem(self, problem: LCP, report: Any) -> str | None:
        """Return the theorem on M-matrices."""
        is_one_sided = _is_one_sided(problem)
        band = bands(problem.matrix)
        is_covered = is_one_sided or (band is not None and band.is_tridiagonal_z)
        if not is_covered or report.is_m_matrix is not True:
            return None
        what = "bounded on one side" if is_one_sided else "tridiagonal"
        return f"M is an M-matrix, {what}: the changes are monotone and finite (Chandrasekaran 1970, Cryer 1983)"

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, and then z of one active set after the other; end where no other is to be tried."""
        from . import kernels

        band, n = self._bands(problem), problem.n
        if n == 0:
            yield Step(z0, 0.0)
            return
        costs = *_costs(band, problem), 1.0
        vectors, sets, memory = (
            np.empty((4, n)),
            np.empty((4, n), np.int8),
            np.empty(kernels.SLOTS, np.int64),
        )
        memory[kernels.WAY], goes_on = kernels.BEGINNING, True
        given = (
            band.entries,
            band.below,
            band.is_tridiagonal_z,
            band.weights,
            problem.residual_scale,
            problem.q,
            problem.lower,
            problem.upper,
            z0,
            vectors,
            sets,
            memory,
            np.empty((n, band.entries.shape[0])),
            self._halves(),
        )
        while goes_on:
            residual, goes_on = kernels.step(*given)
            yield Step(z0, residual, work=costs[memory[kernels.LAST_WAY]])

    def solve_fused(
        self, problem: LCP, z0: FloatVector, tolerance: float, max_iterations: int
    ) -> FusedSolve | None:
        """Return the answer of the same rounds in one call."""
        return self.fused_solves(
            problem, problem.q[None].copy(), z0[None].copy(), tolerance, max_iterations
        )[0]

    def fused_solves(
        self,
        problem: LCP,
        Q: FloatVector,
        Z: FloatVector,
        tolerance: float,
        max_iterations: int,
        propagator: Any = None,
    ) -> list[FusedSolve | None]:
        """Return the fused solve of each row of Q, one after the other in one compiled loop.

        Parameters
        ----------
        problem : LCP
            Gives M and the bounds.
        Q, Z : arrays, shape (k, n)
            Offsets, and starts within the bounds; the latter are overwritten by the answers, and read-only then.
        tolerance, max_iterations
            As for `solve_fused`, of each.
        propagator : CSR array, shape (n, n), optional
            The march in time: Q[k] becomes Q[k] + propagator @ z of the row before, and that z its start. Where a row
            does not converge, the next ones have to wait, None.
        """
        k, n = Q.shape
        if n == 0 or (
            problem.is_dense and n > 1
        ):  # the products of an ndarray are BLAS's, summed in its own order
            return [None] * k
        from .kernels import run_all

        band, M = self._bands(problem), problem.csr
        rounds, ends = np.empty((k, 2), np.int64), np.empty((k, 3))
        arrays = [M.indptr[:0], M.indices[:0], M.data[:0]]
        if propagator is not None:
            index = M.indptr.dtype
            arrays = [
                propagator.indptr.astype(index),
                propagator.indices.astype(index),
                propagator.data,
            ]
        arrays = [
            read_only(array) for array in arrays
        ]  # one signature with a propagator and without
        run_all(
            band.entries,
            band.below,
            band.is_tridiagonal_z,
            band.weights,
            problem.residual_scale,
            M.indptr,
            M.indices,
            M.data,
            *arrays,
            Q,
            problem.lower,
            problem.upper,
            problem.nearest_to_zero,
            tolerance,
            max_iterations,
            self._halves(),
            Z,
            rounds,
            ends,
        )
        costs = _costs(band, problem)
        Z.flags.writeable = False  # they are judged
        found: list[FusedSolve | None] = []
        for z, (largest, least, terms), (direct, blocks) in zip(
            Z, ends.tolist(), rounds.tolist(), strict=True
        ):
            residual, work = ratio_upwards(largest, least), _work(costs, direct, blocks)
            part = self.name, direct + blocks, work
            is_solved = within(residual, terms, tolerance)
            found.append(FusedSolve(z, residual, terms, work, (part,)) if is_solved else None)
        return found

    def fused_marches(
        self,
        problems: Sequence[LCP],
        forcing: FloatVector,
        propagators: Sequence[Any],
        lower: FloatVector,
        upper: FloatVector,
        z: FloatVector,
        kept: IntVector,
        tolerance: float,
        max_iterations: int,
    ) -> FusedMarches:
        """Return the first steps of some marches, as many as have converged in all of them.

        Parameters
        ----------
        problems : sequence of LCP
            Give M, tridiagonal, with no positive entry off the diagonal: one for all, or that of each on one pattern.
        forcing : array, shape (k, n, m), or (k, n, 1) for all marches, k = 1 for all steps
        propagators : sequence of CSR arrays, shape (n, n)
            One for all, or that of each on one pattern.
        lower, upper, z : arrays, shape (n, m)
            Bounds, and the states before the first step; there are at most `march_kernels.MARCHES`.
        kept : array of int, shape (k,)
            For each step its number among those whose answers are kept, −1 where they are not.
        tolerance, max_iterations
            As for `solve_fused`, of each step.
        """
        from .march_kernels import MARCHES, march_all

        def filled(rows: FloatVector) -> FloatVector:
            return np.ascontiguousarray(
                rows[..., np.minimum(np.arange(MARCHES), rows.shape[-1] - 1)]
            )

        first, C, (n, m) = problems[0], propagators[0], z.shape
        are_one = len(problems) == len(propagators) == 1

        def values(each: Iterable[FloatVector]) -> FloatVector:
            return next(iter(each)) if are_one else filled(np.stack(list(each), axis=-1))

        answers, rounds = (
            np.empty((m, kept.max(initial=-1) + 1, n)),
            np.empty((len(kept), MARCHES), np.int64),
        )
        ends, states = np.empty((*rounds.shape, 2)), np.empty((3, n, MARCHES))
        lower, upper = filled(lower), filled(upper)
        states[0] = filled(z)
        whole = [
            A.astype(np.int64) for A in (first.csr.indptr, first.csr.indices, C.indptr, C.indices)
        ]
        steps = march_all(
            *values(self._bands(one).entries for one in problems),
            values(one.residual_scale for one in problems),
            *whole[:2],
            values(one.csr.data for one in problems),
            *whole[2:],
            values(one.data for one in propagators),
            np.ascontiguousarray(forcing) if forcing.shape[-1] == 1 else filled(forcing),
            lower,
            upper,
            np.clip(0.0, lower, upper),
            tolerance,
            max_iterations,
            kept,
            states,
            answers,
            rounds,
            ends,
        )
        answers.flags.writeable = False  # they are judged
        costs = _costs(self._bands(first), first)

        def solve_of(march: int, step: int, z: FloatVector) -> FusedSolve:
            count, (largest, least) = int(rounds[step, march]), ends[step, march].tolist()
            work = _work(costs, count, 0)
            part = self.name, count, work
            return FusedSolve(
                z, ratio_upwards(largest, least), 0.0, work, (part,)
            )  # rows are right to rounding

        before, last = (states[k % 3].T[:m] for k in (steps - 1, steps))
        return FusedMarches(steps, answers, before, last, solve_of)

    def _halves(self) -> int:
        from .kernels import FEW_HALVES, HALVES

        return FEW_HALVES if self.hands_over else HALVES

    def _bands(self, problem: LCP) -> Bands:
        band = bands(problem.matrix)
        if band is None:
            raise UnsuitableMatrix(
                f"{self.name} needs a narrow band, but a factor of that of M is too large: "
                f'its {problem.n} rows reach too far beside the diagonal; try algorithm="auto"'
            )
        return band


def _is_one_sided(problem: LCP) -> bool:
    return bool(np.all(problem.upper == np.inf) or np.all(problem.lower == -np.inf))


@fact
def _predicted_passes(matrix: Matrix) -> float:
    M, middle = matrix.csr, matrix.n // 2
    columns = M.indices[M.indptr[middle] : M.indptr[middle + 1]] if matrix.n else np.zeros(0)
    if abs(columns - middle).max(initial=0) * BANDED_ROUNDS > BANDED_PASSES:
        return math.inf  # a look at one row spares most matrices the look at all
    below, above = bandwidth(matrix) or (0, 0)
    rounds, cost = BANDED_ROUNDS, below + 2.0
    if max(below, above) <= 1 and (band := bands(matrix)) is not None and band.is_tridiagonal_z:
        rounds, cost = BOXED_ROUNDS, DIRECT_COST
    return rounds * cost * (below + above + 1.0) * matrix.n / max(matrix.nonzeros, 1)


def _work(costs: tuple[float, float], direct: int, blocks: int) -> float:
    """Return the work of a run, added up as single steps are."""
    work = 1.0
    for cost, count in zip(costs, (direct, blocks), strict=True):
        for _ in range(count):
            work += cost
    return work


def _costs(band: Bands, problem: LCP) -> tuple[float, float]:
    """Return the work of a round on the direct way and on the other, in passes over M."""
    width, n = band.entries.shape
    passes = width * n / max(problem.nonzeros, 1)
    return DIRECT_COST * passes, (band.below + 2.0) * passes
