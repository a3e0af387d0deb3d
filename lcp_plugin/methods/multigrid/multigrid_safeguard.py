"""Convergence proof of projected multigrid, and its safeguard: the last accepted iterate.

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

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...core.checks import FloatVector, read_only
from ...core.kernels.floats import EPSILON
from ...systems.hierarchy import sweeps
from ...systems.hierarchy.grids import Grid
from ...systems.hierarchy.vectors import dot, span

if TYPE_CHECKING:
    from ...core.lcp import LCP

PATIENCE = 12  # cycles that may pass without an accepted one
SETTLED = 1e-3  # share of the unknowns that may still change sides while they do
GAINED = 0.5  # a round of cycles and sweeps that reduces the least residual by less has failed


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

    def __init__(self, problem: LCP, is_symmetric: bool, z: FloatVector, residual: float) -> None:
        self.problem, self.is_symmetric = problem, is_symmetric
        self.z, self.residual, self.least = z.copy(), residual, residual
        self.idle, self.failed_rounds, self._least_of_round = 0, 0, np.inf
        self._slack: FloatVector | None = None
        self._products = 0

    def is_out_of_hand(self, z: FloatVector, residual: float) -> bool:
        """Return whether z is not finite, or its residual is much larger and its energy has not fallen."""
        if not np.isfinite(z).all():  # a NaN is left out of the largest residual
            return True
        if residual <= 100.0 * self.least:
            return False
        return not (self.is_symmetric and np.isfinite(residual) and self._energy_change(z)[0] < 0.0)

    def lets_pass(self, z: FloatVector, residual: float) -> bool:
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
        return self.idle < PATIENCE

    def restore(self, z: FloatVector) -> None:
        """Overwrite z by the accepted iterate, from which other corrections are tried."""
        np.copyto(z, self.z)
        self.idle = 0

    def lets_sweeps_pass(self, z: FloatVector, residual: float, *, hands_over: bool) -> bool:
        """Accept the result of sweeps from the accepted iterate; return False if another method should take over.

        Another method should take over if cycles and sweeps have barely reduced the least residual three times and the
        energy has not fallen beyond rounding. If the run `hands_over`, the energy is not tested.
        """
        is_gain = self.least < GAINED * self._least_of_round
        if not is_gain and self.is_symmetric and not hands_over:
            change, noise, _ = self._energy_change(z)
            is_gain = change < -noise
        self.failed_rounds = 0 if is_gain else self.failed_rounds + 1
        self._least_of_round = self.least
        self._accept(z, residual)
        if not self.is_symmetric:
            self.least = residual
        return self.failed_rounds < 3

    def take_products(self) -> int:
        """Return the products with M since the last call."""
        products, self._products = self._products, 0
        return products

    def _accept(self, z: FloatVector, residual: float, slack: FloatVector | None = None) -> None:
        np.copyto(self.z, z)
        self.residual, self.least, self.idle, self._slack = (
            residual,
            min(self.least, residual),
            0,
            slack,
        )

    def _energy_change(self, z: FloatVector) -> tuple[float, float, FloatVector]:
        """Return J(z) − J(accepted) = ½ dᵀ(w + w_accepted), its rounding error bound, and w."""
        problem, accepted = self.problem, self.z
        if self._slack is None:
            self._slack = problem.slack(accepted)
            self._products += 1
        slack = problem.slack(z)
        self._products += 1
        step = z - accepted
        terms = problem.diagonal * np.maximum(np.abs(z), np.abs(accepted)) + np.abs(problem.q)
        return (
            0.5 * dot(step, slack + self._slack),
            8.0 * EPSILON * dot(np.abs(step), terms),
            slack,
        )


if TYPE_CHECKING:
    from . import Multigrid


class GridProblem:
    """The complementarity problem of one grid, with its projected sweep."""

    def __init__(
        self,
        algorithm: Multigrid,
        grid: Grid,
        q: FloatVector,
        lower: FloatVector,
        upper: FloatVector,
    ) -> None:
        self.grid, self.entries = grid, grid.matrix.data.size
        # All read-only, so that every kernel is compiled once.
        self.vectors = tuple(
            read_only(np.ascontiguousarray(vector)) for vector in (grid.inverse, q, lower, upper)
        )
        _, self.q, self.lower, self.upper = self.vectors
        self.residual = np.zeros(grid.n)
        self.relaxation = algorithm.relaxation if algorithm.smoother == "psor" else 1.0

    def sweep(self, z: FloatVector, backward: bool) -> None:
        """Overwrite z by one projected sweep."""
        sweeps.projected_sweep(
            self.grid.rows, self.grid.blocks, self.vectors, self.relaxation, backward, z
        )

    def gauss_seidel(self, z: FloatVector) -> float:
        """Overwrite z by one forward projected Gauss–Seidel sweep; return the largest change."""
        before = z.copy()
        sweeps.projected_sweep(self.grid.rows, self.grid.blocks, self.vectors, 1.0, False, z)
        before -= z
        return span(before)


@dataclass
class Advance:
    """Progress of cycles: last residual, number of rows that changed sides, and duration of slow front movement."""

    may_nest: bool
    residual: float = np.inf
    changed: float = 0.0
    crept: int = 0  # cycles in a row
    nested_at: float = np.inf  # the residual at a nested start one cycle ago
    is_slow: bool = False

    def take(self, residual: float, changed: float) -> None:
        """Record a cycle."""
        # Krylov steps pay from this contraction on.
        self.is_slow = residual > 0.1 * self.residual
        # Nearly as many rows change sides as a cycle ago: the free set moves layer by layer.
        self.crept = self.crept + 1 if changed > 0.6 * self.changed else 0
        self.may_nest = self.may_nest and residual <= GAINED * self.nested_at
        self.residual, self.changed, self.nested_at = residual, changed, np.inf

    @property
    def is_creeping(self) -> bool:
        """True if the free set moves layer by layer, and no nested start has failed to help."""
        return self.is_slow and bool(self.changed) and self.crept > 2 and self.may_nest

    def start_nested(self, size: float) -> None:
        """Record that coarser grids determine the free set again, so that `size` rows may change."""
        self.changed, self.crept, self.nested_at = size, 0, self.residual
