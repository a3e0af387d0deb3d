"""Projected full multigrid: projected sweeps find the free unknowns, truncated V-cycles correct them.

A hierarchy of M, built from its entries alone, gives the linear corrections. The answer of each grid starts the next
finer grid (nested iteration), so that the free set is nearly right before the finest grid is touched.

The safeguard is the last accepted iterate; with it convergence is proved.

J(z) = ½ zᵀMz + qᵀz, ρ(z) the largest scaled residual |z_i − mid(l_i, u_i, z_i − w_i/d_i)|, d the diagonal of M, and S
one projected Gauss–Seidel sweep. From an accepted iterate y the run tries z: any correction (a truncated V-cycle,
Krylov steps, a nested iteration), clipped to the bounds and followed by sweeps. It accepts z if

(a)  ρ(z) ≤ 0.9 · the least ρ of all accepted iterates, or
(b)  J(z) ≤ J(y) − σ min(d) ρ(y)²,  σ = 1e-4.

If J rises, or if neither (a) nor (b) holds for twelve cycles in a row, the run returns to y and accepts S²⁰(y), except
for the first time, when it tries other corrections from y.

**Theorem.** Let M be symmetric positive definite, with any bounds. In exact arithmetic the accepted iterates converge
to the solution z* from any start, for any corrections.

*Proof.* ‖y − z*‖ ≤ C ρ(y) for some C [1]_, and J(y) − J(z*) ≥ ½ λ_min ‖y − z*‖², since z* is the minimizer of J
within the bounds. If (a) accepts infinitely often, the iterates that (a) accepts tend to z*, and J along them to J(z*).
Between two of these iterates, neither (b) nor sweeps raise J. Therefore J of all accepted iterates tends to J(z*), and
the accepted iterates tend to z*. Otherwise J never rises from some iterate on and has a limit. If (b) accepts
infinitely often, the ρ(y) before the steps of (b) tend to 0, these y to z*, and J with all iterates to J(z*). If (b)
accepts finitely often, only sweeps follow from some iterate on, and sweeps converge [2]_. ∎

Without symmetry J does not exist, and z is accepted if its ρ is smaller than all since the last sweeps. On an
H₊-matrix, sweeps contract in a maximum norm, so that a run with finitely many accepted corrections converges. Any other
run would also converge if each acceptance reduced the least ρ by a fixed factor. This is not required: a correction may
lower ρ by less and less, which no proof covers. Such a run ends after cycles and sweeps have gained little three times.

Test (a) costs nothing. Test (b) costs one product with M. It follows only if (a) fails, that is, if cycles gain little.

References
----------
.. [1] J. S. Pang, *A posteriori error bounds for the linearly-constrained variational inequality problem*,
   Math. Oper. Res. 12 (1987), doi:10.1287/moor.12.3.474.
.. [2] C. W. Cryer, *The solution of a quadratic programming problem using systematic overrelaxation*,
   SIAM J. Control 9 (1971), doi:10.1137/0309028.
.. [3] C. Gräser, R. Kornhuber, *Multigrid methods for obstacle problems*, J. Comput. Math. 27 (2009): the correction
   after a nonlinear smoother needs to be monotone only.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..core import deadline
from ..core.algorithm import Algorithm, Step, check_flag, require_positive_diagonal
from ..core.checks import Vector, read_only
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact
from ..core.settings import whole_number
from ..core.structure import is_nearly_symmetric
from ..systems.hierarchy import kernels
from ..systems.hierarchy.grids import Grid, Operator
from ..systems.hierarchy.kernels import dot, span
from ..systems.hierarchy.levels import COARSEST, grid_of, hierarchy_of
from ..systems.hierarchy.truncation import KrylovCorrection, Truncation

SMOOTHING_SWEEPS = 60  # of a vector that shows how units differ
RELAXED = 0.9  # relaxation of these sweeps: it is never 0, as after full sweeps along a flow
ROUGH = 1e-3  # share of the rows with other units in which the sweeps may leave a difference


@dataclass(frozen=True, kw_only=True)
class Multigrid(Algorithm):
    """Projected full multigrid: a projected sweep, a truncated V-cycle on the free unknowns, a projected sweep back.

    Parameters
    ----------
    coarsest : int
        A grid with at most this many unknowns is not coarsened, ≥ 1; set it to study several grids of a small problem.
    hands_over : bool
        If True, end as soon as cycles and sweeps have gained little three times, even if the energy still falls, so
        that another method can continue; used by `auto`.

    Notes
    -----
    pyamg sets up the hierarchy: first pass of Ruge and Stüben, also the second pass if couplings jump from edge to
    edge, direct interpolation. Rows of a nonsymmetric M may have any scaling. If the units of neighboring unknowns
    differ, cycles run in units from a few sweeps for M v = 0 (:func:`smooth_units`). Unknowns at a bound are removed
    from all grids, fine unknowns with strong couplings to removed unknowns are no longer interpolated, and a coarse row
    is computed again only if it changes.
    If the free set changes little and a cycle gains less than a factor 10, a few steps of conjugate gradients (M
    symmetric) or generalized conjugate residuals accelerate the correction, one V-cycle each. Corrections fail if few
    contacts carry much load. Then, and from the start if couplings jump from edge to edge, such steps solve on a
    sequence of free sets. The projected solution on a free set determines the next free set, and only the last result
    is tested (primal–dual active sets). Projected Gauss–Seidel sweeps from the last accepted iterate replace the
    cycles for a while if the residual grows a hundredfold, if the energy (M symmetric) rises, or if neither has
    fallen enough for twelve cycles after such free sets. With this safeguard the run converges on every symmetric
    positive definite M, from any start, for any corrections (:mod:`lcp_plugin.methods.multigrid` has the proof). It
    ends if three such rounds gain only rounding; without symmetry, if they gain little. The driver ends a run whose
    best residual no longer falls, as for sweeps. If coarser grids would cost too much, only sweeps run.

    Passes over at least 131 072 rows are shared by the threads of the solve. If M is symmetric, sweeps take its rows in
    blocks, first all even ones: this order depends only on M, so that the number of threads changes no bit.

    For the thirteen-point stencil of plates, the number of cycles grows with the grid: 32, 61 and 138 on 30², 60² and
    120² points.

    Memory, five-point matrix: 490 bytes per unknown (98 per nonzero of M) at the peak, the problem included; measured
    at n = 10⁷: 4.9 GB.

    References
    ----------
    C. Gräser, R. Kornhuber, *Multigrid methods for obstacle problems*, J. Comput. Math. 27 (2009).
    J. Toivanen, C. W. Oosterlee, *A projected algebraic multigrid method for linear complementarity problems*,
    Numer. Math. Theory Methods Appl. 5 (2012), doi:10.4208/nmtma.2011.m11si05.

    Examples
    --------
    >>> import lcp_plugin
    >>> from lcp_plugin import gallery
    >>> lcp_plugin.solve(gallery.build("obstacle_2d", size=60).problem, "multigrid").status.name
    'SOLVED'
    """

    name: ClassVar[str] = "multigrid"
    needs: ClassVar[str] = "positive diagonal"
    solves: ClassVar[str] = "SPD"
    cost: ClassVar[str] = "about 10 passes"
    reference: ClassVar[str] = (
        "Gräser, Kornhuber 2009, J. Comput. Math. 27; Toivanen, Oosterlee 2012, doi:10.4208/nmtma.2011.m11si05"
    )
    is_monotone: ClassVar[bool] = False
    is_watched: ClassVar[bool] = True

    coarsest: int = COARSEST
    hands_over: bool = False

    def __post_init__(self) -> None:
        check_flag(self, "hands_over")
        whole_number(self.coarsest, "multigrid: coarsest", 1)

    def theorem(self, problem: LCP, report: Any) -> str | None:
        """Return the theorem on symmetric positive definite matrices; None if the run may hand over."""
        require_positive_diagonal(problem, self.name)
        if self.hands_over or not (report.is_symmetric and report.is_positive_definite):
            return None
        return "M is symmetric positive definite: the safeguard lets no energy rise for good (Gräser, Kornhuber 2009)"

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start, then z after each sweep that follows a correction on the finest grid."""
        require_positive_diagonal(problem, self.name)
        is_known = smooth_units.is_known(problem.matrix)
        if (smooth := smooth_units(problem.matrix)) is None:
            yield from MultigridRun(self, problem).iterates(z0)
            return
        units, matrix = smooth
        bounds = problem.lower, problem.upper
        lower, upper = (bound / units for bound in bounds)
        run = MultigridRun(self, LCP(matrix, units * problem.q, lower=lower, upper=upper))
        run.work += 0.0 if is_known else SMOOTHING_SWEEPS * run.entries
        for step in run.iterates(z0 / units):
            # A row at a bound stays there, although units times the scaled bound is rounded.
            z = np.select([step.z == lower, step.z == upper], bounds, units * step.z)
            yield Step(np.clip(z, *bounds), work=step.work)


@fact
def smooth_units(matrix: Matrix) -> tuple[Vector, Matrix] | None:
    """Return the units of the unknowns, shape (n,), in which M reduces constants most, and M in these units.

    Interpolation is nearly constant, so that cycles need it. In units that differ from node to node, entries of M 1 are
    larger than the diagonal. A few relaxed sweeps for M v = 0 give v, the new units: not powers of two, because
    rounding to these makes jumps of a factor two. None if the units are smooth already, or if sweeps do not help.
    """
    M, diagonal, ones = matrix.csr, matrix.diagonal, np.ones(matrix.n)

    def rough_rows(v: Vector) -> float:
        return float(np.count_nonzero(np.abs(M @ v) > 1.01 * diagonal * v))  # more than rounding

    if (rough := rough_rows(ones)) == 0:
        return None
    none, grid = 0.0 * ones, grid_of(Operator(M.indptr, M.indices, M.data))
    sweeps, v = GridProblem(grid, none, none, ones * np.inf), ones.copy()
    for k in range(SMOOTHING_SWEEPS):
        deadline.require_seconds(0.0)
        sweeps.sweep(v, backward=k % 2 == 1, relaxation=RELAXED)
    v /= v.max()
    if not (v.min() > 1e-30 and rough_rows(v) <= ROUGH * rough):
        return None
    return v, Matrix(sp.diags_array(v) @ M @ sp.diags_array(v))


ROUND_FALL = 0.5  # a round of cycles and sweeps that reduces the least residual by less has failed


class Safeguard:
    """Last accepted iterate of a run, to which the run returns if corrections fail.

    Parameters
    ----------
    problem : LCP
    is_symmetric : bool
    z : array, shape (n,)
        An iterate; copied.
    residual : float
        Largest scaled residual of the iterate.
    """

    def __init__(self, problem: LCP, is_symmetric: bool, z: Vector, residual: float) -> None:
        self.problem, self.is_symmetric = problem, is_symmetric
        self.z, self.residual, self.least = z.copy(), residual, residual
        self.idle, self.failed_rounds, self._least_of_round = 0, 0, np.inf
        self._slack: Vector | None = None
        self.products = 0

    def is_out_of_hand(self, z: Vector, residual: float) -> bool:
        """Return whether z is not finite, or its residual is much larger and its energy has not fallen."""
        if not np.isfinite(z).all():  # a NaN is left out of the largest residual
            return True
        if residual <= 100.0 * self.least:
            return False
        return not (self.is_symmetric and np.isfinite(residual) and self._energy_change(z)[0] < 0.0)

    def lets_pass(self, z: Vector, residual: float) -> bool:
        """Return whether the run may continue from z, which is accepted if it has gained enough."""
        self.idle += 1
        if residual < (0.9 * self.least if self.is_symmetric else self.least):
            self._accept(z, residual)
        elif self.is_symmetric:
            change, noise, slack = self._energy_change(z)
            if change > noise:
                return False
            least_diagonal = float(self.problem.diagonal.min(initial=np.inf))
            if change < -max(noise, 1e-4 * least_diagonal * self.residual * self.residual):
                self._accept(z, residual, slack)
        return self.idle < 12  # cycles that may pass without an accepted cycle

    def restore(self, z: Vector) -> None:
        """Overwrite z by the accepted iterate, from which other corrections are tried."""
        np.copyto(z, self.z)
        self.idle = 0

    def lets_sweeps_pass(self, z: Vector, residual: float, *, hands_over: bool) -> bool:
        """Accept the result of sweeps from the accepted iterate; return False if another method should take over.

        Another method should take over if cycles and sweeps have barely reduced the least residual three times and the
        energy has not fallen beyond rounding. If the run `hands_over`, the energy is not tested.
        """
        is_gain = self.least < ROUND_FALL * self._least_of_round
        if not is_gain and self.is_symmetric and not hands_over:
            change, noise, _ = self._energy_change(z)
            is_gain = change < -noise
        self.failed_rounds = 0 if is_gain else self.failed_rounds + 1
        self._least_of_round = self.least
        self._accept(z, residual)
        if not self.is_symmetric:
            self.least = residual
        return self.failed_rounds < 3

    def _accept(self, z: Vector, residual: float, slack: Vector | None = None) -> None:
        np.copyto(self.z, z)
        self.residual = residual
        self.least = min(self.least, residual)
        self.idle = 0
        self._slack = slack

    def _energy_change(self, z: Vector) -> tuple[float, float, Vector]:
        """Return J(z) − J(accepted) = ½ dᵀ(w + w_accepted), its rounding error bound, and w."""
        problem, accepted = self.problem, self.z
        if self._slack is None:
            self._slack = problem.slack(accepted)
            self.products += 1
        slack = problem.slack(z)
        self.products += 1
        step = z - accepted
        terms = problem.diagonal * np.maximum(np.abs(z), np.abs(accepted)) + np.abs(problem.q)
        noise = 8.0 * EPSILON * dot(np.abs(step), terms)
        return 0.5 * dot(step, slack + self._slack), noise, slack


class GridProblem:
    """The complementarity problem of one grid, with its projected sweep."""

    def __init__(self, grid: Grid, q: Vector, lower: Vector, upper: Vector) -> None:
        self.grid, self.entries = grid, grid.matrix.data.size
        # All read-only, so that every kernel is compiled once.
        self.vectors = tuple(
            read_only(np.ascontiguousarray(vector)) for vector in (grid.inverse, q, lower, upper)
        )
        _, self.q, self.lower, self.upper = self.vectors
        self.whole = np.zeros(grid.width)  # the residual and its ghosts
        self.residual = self.whole[: grid.n]

    def sweep(self, z: Vector, **how: Any) -> None:
        """Overwrite z, shape (width,), by one projected sweep, backward or relaxed if so wanted."""
        self.grid.halo.fetch(z)
        kernels.sweep(self.grid.rows, self.grid.blocks, self.vectors, z, **how)


COARSEST_SWEEPS = 50  # of the coarsest grid, which has few rows
LONG_CONJUGATE = 24  # if M is symmetric: conjugate gradients keep no directions
MOST_ROUNDS = 20  # of Krylov steps, each on the free set that the round before has left
ROUND_GAIN = 0.1  # of the residual: reduction by Krylov steps on a free set before it changes


class ProjectedCycles:
    """Projected sweeps, corrections of the free rows by a hierarchy, and starts from coarser grids.

    Parameters
    ----------
    problem : LCP, or problem on ranks
        With q, lower and upper.
    truncation : Truncation
        Of all grids.
    is_symmetric : bool

    Attributes
    ----------
    problems : list of GridProblem
        The problem of the finest grid; during a start also the problems of coarser grids.
    work : float
        Entries touched since the last step.
    rounds : int
        Most free sets on which Krylov steps follow each other.
    """

    rounds = 1
    gain = ROUND_GAIN
    tells_residual = False

    def __init__(self, problem: Any, truncation: Truncation, *, is_symmetric: bool) -> None:
        self.problem, self.truncation, self.is_symmetric = problem, truncation, is_symmetric
        self.transfers, finest = truncation.transfers, truncation.grids[0].grid
        self.problems = [GridProblem(finest, problem.q, problem.lower, problem.upper)]
        self.work, self.entries = 0.0, max(truncation.halo.total(finest.entries), 1.0)

    def add_coarse_solution(self, q: Vector, lower: Vector, upper: Vector, z: Vector) -> None:
        """Add to z the solution of the coarse problems, each of which starts the next finer problem."""
        for below, transfer in zip(self.truncation.grids[1:], self.transfers, strict=True):
            finer, q = self.problems[-1].grid.halo.whole(q), np.empty(below.grid.n)
            kernels.restrict(transfer, finer, q)
            self.work += transfer.restriction.data.size
            lower, upper = lower[transfer.is_coarse], upper[transfer.is_coarse]
            self.problems.append(GridProblem(below.grid, q, lower, upper))
        coarsest, last = self.problems[-1], len(self.problems) - 1
        answer = np.zeros_like(coarsest.whole)
        answer[: coarsest.grid.n] = np.clip(0.0, coarsest.lower, coarsest.upper)
        for k in range(COARSEST_SWEEPS):
            coarsest.sweep(answer, backward=k % 2 == 1)
        self.work += COARSEST_SWEEPS * coarsest.entries
        for k in range(last - 1, 0, -1):
            answer = self._interpolated(k, answer, np.zeros_like(self.problems[k].whole))
            self._cycle_on(k, answer)
        self._interpolated(0, answer, z)
        del self.problems[1:]

    def _interpolated(self, k: int, coarse: Vector, z: Vector) -> Vector:
        """Return z with P coarse added, within the bounds of grid k."""
        fine, transfer = self.problems[k], self.transfers[k]
        self.truncation.grids[k + 1].grid.halo.fetch(coarse)
        everywhere = np.ones(z.size, np.bool_)
        kernels.prolong(transfer, coarse, everywhere, z, (fine.lower, fine.upper))
        self.work += transfer.prolongation.data.size
        return z

    def _cycle_on(self, k: int, z: Vector) -> None:
        fine = self.problems[k]
        self.truncation.start_at(k)
        # Unknowns that may still change sides when the finer grid takes over.
        few = 5e-4 * self.truncation.halo.total(fine.grid.n)
        for cycle in range(1, 11):
            fine.sweep(z, backward=False)
            _, changed = self.look(k, z)
            self.correct(k, z)
            fine.sweep(z, backward=True)
            self.work += 2.0 * fine.entries
            # stop: few rows remain, and the finer grid moves them
            if cycle >= 2 and changed <= few:
                break

    def look(self, k: int, z: Vector) -> tuple[float, float]:
        """Find the free rows of z and truncate to them; return the largest scaled residual and the rows changed."""
        top, fine, truncation = self.truncation.grids[k], self.problems[k], self.truncation
        fine.grid.halo.fetch(z)
        flags = top.is_free, top.free_changed
        largest, rows = kernels.mark_free(fine.grid.rows, fine.vectors, z, flags, fine.residual)
        self.work += fine.entries
        if changed := truncation.halo.total(rows):
            truncation.update()
        return truncation.halo.largest(largest), changed

    def correct(self, k: int, z: Vector) -> None:
        """Add to z on the free rows the correction of one V-cycle, clipped to the bounds."""
        fine, top = self.problems[k], self.truncation.grids[k]
        if k == len(self.transfers):
            np.copyto(top.b, fine.residual)
            self.truncation.correct(k)
            np.clip(z + top.x, fine.lower, fine.upper, out=z)
            return
        below, transfer = self.truncation.grids[k + 1], self.transfers[k]
        self.truncation.restrict(k, fine.whole)
        self.truncation.correct(k + 1)
        below.grid.halo.fetch(below.x)
        kernels.prolong(transfer, below.x, top.is_interpolated, z, (fine.lower, fine.upper))
        self.work += 2.0 * transfer.prolongation.data.size

    def krylov_steps(self, z: Vector, *, is_settled: bool) -> Iterator[Step]:
        """Add to z the correction of the free rows by Krylov steps, one V-cycle each.

        The result, clipped to the bounds, determines the next free rows, until no row changes (primal–dual active
        sets). A single V-cycle cannot replace this method if few contacts carry much load.
        """
        fine = self.problems[0]
        local = z[: fine.grid.n]
        # Conjugate gradients (M symmetric) keep no directions.
        most, gain = ((LONG_CONJUGATE if self.is_symmetric else 8) if is_settled else 2, 1e-2)
        if self.rounds > 1:
            most, gain = LONG_CONJUGATE, self.gain
        fewest, idle = np.inf, 0
        for rounds_left in range(self.rounds - 1, -1, -1):
            correction = KrylovCorrection(self.truncation, fine.residual, self.is_symmetric)
            left = begun = correction.largest()
            origin = local.copy()
            for step in range(most):
                if not correction.step():
                    break
                np.clip(origin + correction.solution, fine.lower, fine.upper, out=local)
                left = correction.largest()
                if left <= gain * begun or step == most - 1:
                    break
                yield Step(z, increment=left, work=self.take_work())
            if rounds_left == 0:
                break
            if left > ROUND_GAIN * begun:  # V-cycles do not do here
                self.rounds = 1
                break
            largest, changed = self.look(0, z)
            fewest, idle = (changed, 0) if changed < fewest else (fewest, idle + 1)
            # The free set moves slowly, or repeats.
            if idle > 2:
                self.rounds = 1
            if self.rounds == 1 or not changed:
                break
            yield Step(z, residual=largest if self.tells_residual else None, work=self.take_work())

    def take_work(self) -> float:
        """Return the passes over M since the last step."""
        work = self.truncation.halo.total(self.work + self.truncation.take_work())
        self.work = 0.0
        return work / self.entries


class MultigridRun(ProjectedCycles):
    """State of a run on one problem."""

    def __init__(self, algorithm: Multigrid, problem: LCP) -> None:
        matrix, self.algorithm = problem.matrix, algorithm
        work = 0.0 if is_nearly_symmetric.is_known(matrix) else float(matrix.nonzeros)
        is_symmetric = is_nearly_symmetric(matrix)
        is_built = hierarchy_of.is_known(matrix, algorithm.coarsest)
        self.hierarchy = hierarchy = hierarchy_of(matrix, algorithm.coarsest)
        super().__init__(problem, Truncation(hierarchy), is_symmetric=is_symmetric)
        self.work = work if is_built else work + hierarchy.work
        self.tells_residual = np.array_equal(problem.residual_scale, problem.diagonal)
        self.rounds = MOST_ROUNDS if self.is_symmetric and hierarchy.has_jumps else 1
        # If couplings jump so far, w of a row that is not quite solved has wrong signs.
        jumps = hierarchy.has_jumps and hierarchy.grids[0].spread > 1e6
        self.gain = 1e-5 if jumps else ROUND_GAIN
        self.has_tried_rounds = not self.is_symmetric

    def iterates(self, z: Vector) -> Iterator[Step]:
        """Yield the start, then the iterates of the finest grid; end when no correction makes progress."""
        is_cold = np.array_equal(z, self.problem.nearest_to_zero)
        begun = self._residual(z)
        yield Step(z, residual=begun if self.tells_residual else None, work=self.take_work())
        if not self.hierarchy.is_helpful:
            yield from self._sweeps_alone(z)
            return
        start = z.copy()
        if not is_cold:  # the first cycle may increase the residual of a good start
            begun = max(begun, self._residual(self.problem.nearest_to_zero.copy()))
        if len(self.hierarchy.grids) > 1:
            self._nested_start(z, is_cold)
        yield from self._cycles(z, begun, start)

    def _residual(self, z: Vector) -> float:
        """Return the largest scaled residual of z without a change of the free set."""
        fine, flags = self.problems[0], (np.ones(z.size, np.bool_), np.empty(z.size, np.bool_))
        largest, _ = kernels.mark_free(fine.grid.rows, fine.vectors, z, flags, fine.residual)
        self.work += fine.entries
        return largest

    # --- nested iteration -------------------------------------------------------------------------------

    def _nested_start(self, z: Vector, is_cold: bool) -> None:
        """Add to z the solution of the coarse problems.

        From a warm start, they determine only the increment. This can move the free set by more rows
        than cycles can, and keeps the correct part of the start.
        """
        fine = self.problems[0]
        if is_cold:
            z[:] = 0.0
            self.add_coarse_solution(fine.q, fine.lower, fine.upper, z)
        else:
            fine.sweep(z, backward=False)
            fine.sweep(z, backward=True)
            self.add_coarse_solution(self.problem.slack(z), fine.lower - z, fine.upper - z, z)
            self.work += 3.0 * fine.entries

    # --- the finest grid --------------------------------------------------------------------------------

    def _cycles(self, z: Vector, begun: float, start: Vector) -> Iterator[Step]:
        """Yield cycles from z; after failures return to the accepted iterate, at first `start` of residual `begun`."""
        self.truncation.start_at(0)
        fine, guard = self.problems[0], Safeguard(self.problem, self.is_symmetric, start, begun)
        before = np.inf  # the residual of the last cycle
        while True:
            fine.sweep(z, backward=False)
            largest, changed = self.look(0, z)
            self.work += self.entries
            if is_lost := guard.is_out_of_hand(z, largest):
                np.copyto(z, guard.z)
                largest = guard.residual
            yield Step(z, residual=largest if self.tells_residual else None, work=self.take_work())
            is_lost = is_lost or not guard.lets_pass(z, largest)
            self.work, guard.products = self.work + guard.products * self.entries, 0
            if is_lost:
                before = np.inf
                if not (yield from self._tries_again(z, guard)):
                    return
                continue
            # Krylov steps pay from this contraction on.
            is_slow = largest > 0.1 * before
            before = largest
            # A thousandth of the unknowns may still change sides
            if is_slow and changed <= max(1e-3 * fine.grid.n, 1):
                yield from self.krylov_steps(z, is_settled=not changed)
            else:
                self.correct(0, z)
            fine.sweep(z, backward=True)
            self.work += self.entries

    def _tries_again(self, z: Vector, guard: Safeguard) -> Generator[Step, None, bool]:
        """Continue from the accepted iterate after failed corrections; return False if no method remains.

        The methods are a sequence of free sets by Krylov steps, and then sweeps.
        """
        guard.restore(z)
        if not self.has_tried_rounds:
            self.has_tried_rounds, self.rounds = True, MOST_ROUNDS
            self.look(0, z)
            yield from self.krylov_steps(z, is_settled=False)
            return True
        self.gain = max(1e-2 * self.gain, 1e-9)
        yield from self._fall_back(z)
        return guard.lets_sweeps_pass(z, self._residual(z), hands_over=self.algorithm.hands_over)

    # --- without coarser grids --------------------------------------------------------------------------

    def _sweeps_alone(self, z: Vector) -> Iterator[Step]:
        """Yield sweeps if multigrid does not help for this matrix; without a theorem, as long as they contract."""
        goes_on = self.is_symmetric and not self.algorithm.hands_over
        before = np.inf
        while True:
            change = yield from self._fall_back(z)
            if not (goes_on or change < ROUND_FALL * before):
                return
            before = change

    def _fall_back(self, z: Vector) -> Generator[Step, None, float]:
        """Yield projected Gauss–Seidel sweeps; return the change of the last sweep."""
        fine = self.problems[0]
        for _ in range(20):
            before = z.copy()
            fine.sweep(z, backward=False)
            change = span(before - z)
            self.work += fine.entries
            yield Step(z, increment=change, work=self.take_work())
        return change
