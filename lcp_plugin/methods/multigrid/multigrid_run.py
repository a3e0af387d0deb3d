"""Run of projected full multigrid: problems on the grids, truncation, safeguards."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...core.algorithm import Step
from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.matrix.structure import is_nearly_symmetric
from ...systems.equilibration import power_of_two
from ...systems.hierarchy import sweeps, vectors
from ...systems.hierarchy.levels import hierarchy_of
from ...systems.hierarchy.truncation import KrylovCorrection, Truncation
from ...systems.hierarchy.vectors import dot, span
from .multigrid_safeguard import GAINED, SETTLED, Advance, GridProblem, Safeguard

if TYPE_CHECKING:
    from . import Multigrid

COARSEST_SWEEPS = 50
LONG_CONJUGATE = 24  # if M is symmetric: conjugate gradients keep no directions
MOST_ROUNDS = 20  # of Krylov steps, each on the free set that the one before has left
ROUND_GAIN = 0.1


class MultigridRun:
    """State of a run on one problem."""

    def __init__(self, algorithm: Multigrid, problem: LCP) -> None:
        self.algorithm, self.problem = algorithm, problem
        matrix = problem.matrix
        self.work = 0.0 if is_nearly_symmetric.is_known(matrix) else float(matrix.nonzeros)
        self.is_symmetric = is_nearly_symmetric(matrix)
        is_built = hierarchy_of.is_known(matrix, algorithm.coarsest)
        self.hierarchy = hierarchy = hierarchy_of(matrix, algorithm.coarsest)
        self.work += 0.0 if is_built else hierarchy.work
        finest = hierarchy.grids[0]
        self.grid = finest
        self.tells_residual = np.array_equal(problem.residual_scale, problem.diagonal)
        self.truncation = Truncation(hierarchy)
        self.rounds = MOST_ROUNDS if self.is_symmetric and hierarchy.has_jumps else 1
        # If couplings jump so far, w of a row that is not quite solved has wrong signs.
        jumps = hierarchy.has_jumps and finest.spread > 1e6
        self.gain = 1e-5 if jumps else ROUND_GAIN
        self.has_tried_rounds = not self.is_symmetric
        self.problems = [GridProblem(algorithm, finest, problem.q, problem.lower, problem.upper)]
        self.size = finest.n
        self.entries = max(finest.matrix.data.size, 1.0)

    def iterates(self, z: FloatVector) -> Iterator[Step]:
        """Yield the start, then the iterates of the finest grid; end when no correction makes progress."""
        is_cold = np.array_equal(z, self.problem.nearest_to_zero)
        begun = self._residual(z)
        yield Step(z, residual=begun if self.tells_residual else None, work=self._spent())
        if not self.hierarchy.is_helpful:
            yield from self._sweeps_alone(z)
            return
        start = z.copy()
        if not is_cold:  # the first cycle may increase the residual of a good start
            begun = max(begun, self._residual(self.problem.nearest_to_zero.copy()))
        if self.algorithm.nested and len(self.hierarchy.grids) > 1:
            self._nested_start(z, is_cold)
        yield from self._cycles(z, begun, start)

    def _residual(self, z: FloatVector) -> float:
        """Return the largest scaled residual of z without a change of the free set."""
        fine = self.problems[0]
        free, changed = np.ones(z.size, np.bool_), np.empty(z.size, np.bool_)
        residual = fine.residual
        largest, _ = sweeps.free_rows(fine.grid.rows, fine.vectors, z, free, changed, residual)
        self.work += fine.entries
        return float(largest)

    # --- nested iteration -------------------------------------------------------------------------------

    def _nested_start(self, z: FloatVector, is_cold: bool) -> None:
        """Add to z the solution of the coarse problems, each of which starts the next finer problem.

        From a warm start, the coarse problems determine only the increment. This can move the free set by more rows
        than cycles can, and keeps the correct part of the start.
        """
        fine = self.problems[0]
        if is_cold:
            z[:] = 0.0
            self._add_coarse_problems(fine.q, fine.lower, fine.upper)
        else:
            fine.sweep(z, backward=False)
            fine.sweep(z, backward=True)
            self._add_coarse_problems(self.problem.slack(z), fine.lower - z, fine.upper - z)
            self.work += 3.0 * fine.entries
        coarsest, last = self.problems[-1], len(self.problems) - 1
        answer = np.zeros_like(coarsest.residual)
        np.clip(0.0, coarsest.lower, coarsest.upper, out=answer)
        for k in range(COARSEST_SWEEPS):
            coarsest.sweep(answer, backward=k % 2 == 1)
        self.work += COARSEST_SWEEPS * coarsest.entries
        for k in range(last - 1, 0, -1):
            answer = self._interpolated(k, answer, np.zeros_like(self.problems[k].residual))
            self._cycle_on(k, answer)
        self._interpolated(0, answer, z)
        del self.problems[1:]

    def _add_coarse_problems(self, q: FloatVector, lower: FloatVector, upper: FloatVector) -> None:
        for coarser, transfer in zip(
            self.hierarchy.grids[1:], self.hierarchy.transfers, strict=True
        ):
            finer, q = q, np.empty(coarser.n)
            vectors.restrict(transfer, finer, q)
            self.work += transfer.restriction.data.size
            lower, upper = lower[transfer.is_coarse], upper[transfer.is_coarse]
            self.problems.append(GridProblem(self.algorithm, coarser, q, lower, upper))

    def _interpolated(self, k: int, coarse: FloatVector, z: FloatVector) -> FloatVector:
        """Return z with P coarse added, within the bounds of grid k."""
        fine, transfer = self.problems[k], self.hierarchy.transfers[k]
        everywhere = np.ones(z.size, np.bool_)
        vectors.prolong(transfer, coarse, everywhere, fine.lower, fine.upper, z)
        self.work += transfer.prolongation.data.size
        return z

    def _cycle_on(self, k: int, z: FloatVector) -> None:
        fine = self.problems[k]
        self.truncation.start_at(k)
        # Unknowns that may still change sides when the finer grid takes over.
        few = 5e-4 * fine.q.size
        for cycle in range(1, 11):
            fine.sweep(z, backward=False)
            _, changed = self._look(k, z)
            self._correct(k, z)
            fine.sweep(z, backward=True)
            self.work += 2.0 * fine.entries
            if (
                cycle >= 2 and changed <= few
            ):  # stop: few rows remain, and the finer grid moves them
                break

    # --- the finest grid --------------------------------------------------------------------------------

    def _cycles(self, z: FloatVector, begun: float, start: FloatVector) -> Iterator[Step]:
        """Yield cycles from z; after failures return to the accepted iterate, at first `start` of residual `begun`."""
        self.truncation.start_at(0)
        fine, guard = self.problems[0], Safeguard(self.problem, self.is_symmetric, start, begun)
        advance = Advance(may_nest=self.algorithm.nested and len(self.hierarchy.grids) > 1)
        while True:
            fine.sweep(z, backward=False)
            largest, changed = self._look(0, z)
            self.work += self.entries
            if is_lost := guard.is_out_of_hand(z, largest):
                np.copyto(z, guard.z)
                largest = guard.residual
            yield Step(z, residual=largest if self.tells_residual else None, work=self._spent())
            is_lost = is_lost or not guard.lets_pass(z, largest)
            self.work += guard.take_products() * self.entries
            if is_lost:
                advance.residual = np.inf
                if not (yield from self._tries_again(z, guard)):
                    return
                continue
            advance.take(largest, changed)
            if advance.is_creeping:
                self._nested_start(z, is_cold=False)
                self.truncation.start_at(0)
                advance.start_nested(self.size)
            elif advance.is_slow and changed <= max(SETTLED * self.size, 1):
                yield from self._krylov(z, is_settled=not changed)
            else:
                self._correct(0, z)
            fine.sweep(z, backward=True)
            self.work += self.entries

    def _tries_again(self, z: FloatVector, guard: Safeguard) -> Generator[Step, None, bool]:
        """Continue from the accepted iterate after failed corrections; return False if no method remains.

        The methods are a sequence of free sets by Krylov steps, and then sweeps.
        """
        guard.restore(z)
        if not self.has_tried_rounds:
            self.has_tried_rounds, self.rounds = True, MOST_ROUNDS
            self._look(0, z)
            yield from self._krylov(z, is_settled=False)
            return True
        self.gain = max(1e-2 * self.gain, 1e-9)
        yield from self._fall_back(z)
        return guard.lets_sweeps_pass(z, self._residual(z), hands_over=self.algorithm.hands_over)

    def _look(self, k: int, z: FloatVector) -> tuple[float, float]:
        """Find the free rows of z and truncate to them; return the largest scaled residual and the rows changed."""
        top, fine = self.truncation.grids[k], self.problems[k]
        largest, changed = sweeps.free_rows(
            fine.grid.rows,
            fine.vectors,
            z,
            top.is_free,
            top.free_changed,
            fine.residual,
        )
        self.work += fine.entries
        if changed:
            self.truncation.update()
        return largest, changed

    def _correct(self, k: int, z: FloatVector) -> None:
        """Add to z on the free rows the correction of one V-cycle, clipped to the bounds."""
        fine, top = self.problems[k], self.truncation.grids[k]
        if k == len(self.hierarchy.transfers):
            np.copyto(top.b, fine.residual)
            self.truncation.correct(k)
            np.clip(z + top.x, fine.lower, fine.upper, out=z)
            return
        below, transfer = self.truncation.grids[k + 1], self.hierarchy.transfers[k]
        self.truncation.restrict(k, fine.residual)
        self.truncation.correct(k + 1)
        before = None
        if k == 0 and self.is_symmetric:
            before = self.truncation.vector()
            np.copyto(before, z)
        cut = vectors.prolong(transfer, below.x, top.is_interpolated, fine.lower, fine.upper, z)
        self.work += 2.0 * transfer.prolongation.data.size
        if before is None:
            return
        # Few unknowns clipped to a bound change the energy little.
        if cut > 1e-4 * self.size:
            self._shorten(before, z)
        self.truncation.spare.append(before)

    def _shorten(self, before: FloatVector, z: FloatVector) -> None:
        """Halve the step from `before` to z until the energy does not rise; undo the step if halving fails."""
        fine = self.problems[0]
        product, step = self.truncation.vector(), z - before
        unit = power_of_two(span(step))
        step /= unit
        sweeps.free_product(fine.grid.rows, np.ones(z.size), step, product)
        # w = −residual on the free rows; the others did not move
        slope = -dot(step, fine.residual / unit)
        curvature = dot(step, product)
        self.work += self.entries
        size = 1.0
        for _ in range(4):
            if size * slope + 0.5 * size * size * curvature <= 0.0:
                break
            size *= 0.5
        else:
            size = 0.0
        if size < 1.0:
            np.copyto(z, before + size * unit * step)
        self.truncation.spare.append(product)

    def _krylov(self, z: FloatVector, *, is_settled: bool) -> Iterator[Step]:
        """Add to z the correction of the free rows by Krylov steps, one V-cycle each.

        The result, clipped to the bounds, determines the next free rows, until no row changes (primal–dual active
        sets). A single V-cycle cannot replace this method if few contacts carry much load.
        """
        fine, origin = self.problems[0], self.truncation.vector()
        # Conjugate gradients (M symmetric) keep no directions.
        most, gain = (
            (LONG_CONJUGATE if self.is_symmetric else 8) if is_settled else 2,
            1e-2,
        )
        if self.rounds > 1:
            most, gain = LONG_CONJUGATE, self.gain
        fewest, idle = np.inf, 0
        for rounds_left in range(self.rounds - 1, -1, -1):
            correction = KrylovCorrection(self.truncation, fine.residual, self.is_symmetric)
            left = begun = correction.largest()
            np.copyto(origin, z)
            for step in range(most):
                if not correction.step():
                    break
                correction.apply_within(origin, fine.lower, fine.upper, z)
                left = correction.largest()
                if left <= gain * begun or step == most - 1:
                    break
                yield Step(z, increment=left, work=self._spent())
            correction.give_back()
            if rounds_left == 0:
                break
            if left > ROUND_GAIN * begun:  # V-cycles do not do here
                self.rounds = 1
                break
            largest, changed = self._look(0, z)
            fewest, idle = (changed, 0) if changed < fewest else (fewest, idle + 1)
            # The free set moves slowly, or repeats.
            if idle > 2:
                self.rounds = 1
            if self.rounds == 1 or not changed:
                break
            yield Step(z, residual=largest if self.tells_residual else None, work=self._spent())
        self.truncation.spare.append(origin)

    # --- without coarser grids --------------------------------------------------------------------------

    def _sweeps_alone(self, z: FloatVector) -> Iterator[Step]:
        """Yield sweeps if multigrid does not help for this matrix; without a theorem, as long as they contract."""
        goes_on = self.is_symmetric and not self.algorithm.hands_over
        before = np.inf
        while True:
            change = yield from self._fall_back(z)
            if not (goes_on or change < GAINED * before):
                return
            before = change

    def _fall_back(self, z: FloatVector) -> Generator[Step, None, float]:
        """Yield projected Gauss–Seidel sweeps; return the change of the last sweep."""
        for _ in range(20):
            change = self.problems[0].gauss_seidel(z)
            self.work += self.problems[0].entries
            yield Step(z, increment=change, work=self._spent())
        return change

    def _spent(self) -> float:
        """Return the passes over M since the last step."""
        work = self.work + self.truncation.take_work()
        self.work = 0.0
        return work / self.entries
