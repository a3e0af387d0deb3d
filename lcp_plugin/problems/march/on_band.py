"""Time stepping on a narrow band: steps are solved one after the other, and checked in blocks.

M may be tridiagonal with off-diagonal entries ≤ 0 and bounds on one side only, as in an American option. Each step
is then one pass of :func:`~lcp_plugin.methods.banded.solve_one_sided`. On other bands a step runs
:func:`~lcp_plugin.methods.banded.active_sets`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...core.kernels.floats import EPSILON, TINY
from ...core.lcp import LCP
from ...methods.banded import active_sets, solve_one_sided
from ...systems.factors import Bands


class BandSteps:
    """The steps of a march on a narrow band.

    Parameters
    ----------
    problem : LCP
        The matrix and the bounds.
    band : Bands
        Bands of its matrix.
    propagator : csr_array, shape (n, n)
    tolerance : float
        Tolerance of the stopping criterion.
    """

    def __init__(
        self, problem: LCP, band: Bands, propagator: sp.csr_array, tolerance: float
    ) -> None:
        self.problem, self.band, self.propagator = problem, band, propagator
        self.tolerance, self.absolute = tolerance, abs(problem.csr)
        self.of_nearest: FloatVector = problem.csr @ problem.nearest_to_zero
        #: 1 if a step is one pass from the lower bounds, −1 from the upper ones, else 0.
        self.side = 0
        if band.is_tridiagonal_z:
            self.side = int(np.isinf(problem.upper).all()) or -int(np.isinf(problem.lower).all())

    @np.errstate(all="ignore")
    def solve(self, forcing: FloatVector, state: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return q and z of the first steps that meet the criterion from this state, shapes (k, n).

        Parameters
        ----------
        forcing : array, shape (k, n)
        state : array, shape (n,)
        """
        Q, Z = np.empty(forcing.shape), np.empty(forcing.shape)
        for k, given in enumerate(forcing):
            Q[k] = given + self.propagator @ state
            found = self._step(Q[k], state)
            if found is None:
                Q, Z = Q[:k], Z[:k]
                break
            state = Z[k] = found
        Z.flags.writeable = False  # because they are checked now
        are_solved = self._are_solved(Q, Z)
        count = len(Q) if are_solved.all() else int(np.argmin(are_solved))
        return Q[:count], Z[:count]

    def _step(self, q: FloatVector, state: FloatVector) -> FloatVector | None:
        """Return the solution of one step, or None if none was found."""
        problem = self.problem
        if self.side:
            value = problem.lower if self.side > 0 else problem.upper
            none = np.zeros(q.size, np.bool_)
            found = solve_one_sided(self.band.entries, q, self.side, value, none)[0]
            return None if found is None else np.clip(found, problem.lower, problem.upper)
        reference = self._residual(self.of_nearest + q, problem.nearest_to_zero)
        goal = 0.5 * self.tolerance * np.max(reference, initial=0.0)
        rounds = active_sets(problem, self.band, q, np.clip(state, problem.lower, problem.upper))
        return next((z for z, residual in rounds if residual <= goal), None)

    def _are_solved(self, Q: FloatVector, Z: FloatVector) -> BoolVector:
        """Return the mask of the steps that meet the criterion, rounding included."""
        problem, nearest = self.problem, self.problem.nearest_to_zero
        T, W = (self.absolute @ np.abs(Z).T).T + np.abs(Q), (problem.csr @ Z.T).T + Q
        is_held = ((problem.lower >= Z) & (W >= 0.0)) | ((problem.upper <= Z) & (W <= 0.0))
        wrong = np.where(is_held | (problem.lower == problem.upper), 0.0, np.abs(W))
        is_right = (wrong <= self.tolerance**0.75 * T).all(axis=1)
        residual = self._residual(W, Z) + self._rounding(T)
        reference = self._residual(self.of_nearest + Q, nearest)
        reference -= self._rounding(self.absolute @ np.abs(nearest) + np.abs(Q))
        allowed = self.tolerance * reference.max(axis=1, initial=0.0)
        are_solved: BoolVector = is_right & (residual.max(axis=1, initial=0.0) <= allowed)
        return are_solved

    def _residual(self, w: FloatVector, z: FloatVector) -> FloatVector:
        """Return |z − mid(lower, upper, z − w/d)|."""
        problem = self.problem
        step = np.clip(w / problem.residual_scale, z - problem.upper, z - problem.lower)
        return np.asarray(np.abs(step))

    def _rounding(self, terms: FloatVector) -> Any:
        """Return a bound of the rounding error of w/d."""
        width = int(np.diff(self.problem.csr.indptr).max(initial=0))
        return (terms * EPSILON + TINY) * ((width + 4) / self.problem.residual_scale)
