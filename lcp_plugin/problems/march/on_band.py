"""Time stepping on a narrow band: steps are solved one after the other, and checked in blocks.

M may be tridiagonal with off-diagonal entries ≤ 0 and bounds on one side only, as in an American option. Each step
is then one pass of :func:`~lcp_plugin.methods.banded.solve_one_sided`. On other bands a step runs
:func:`~lcp_plugin.methods.banded.active_sets`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import RowData
from ...core.checks import FloatVector, read_only
from ...core.lcp import LCP
from ...core.matrix.structure import row_numbers
from ...methods.banded import active_sets, solve_one_sided
from ...systems.factors import Bands


def propagation(C: sp.csr_array) -> Callable[[FloatVector], FloatVector]:
    """Return the function C z, for each row of z; if C is diagonal, a product of vectors."""
    if np.array_equal(C.indices, row_numbers(C)):
        diagonal: FloatVector = C.diagonal()
        return lambda z: diagonal * z
    return lambda z: np.asarray((C @ z.T).T)


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
        self.problem, self.band, self.propagate = problem, band, propagation(propagator)
        self.tolerance, self.absolute = tolerance, abs(problem.csr)
        self.of_nearest: FloatVector = problem.csr @ problem.nearest_to_zero
        #: 1 if a step is one pass from the lower bounds, −1 from the upper ones, else 0.
        self.side, self.none = 0, read_only(np.zeros(problem.n, np.bool_))
        if band.is_tridiagonal_z:
            self.side = int(np.isinf(problem.upper).all()) or -int(np.isinf(problem.lower).all())

    def solve(self, forcing: FloatVector, state: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return q and z of the first steps that meet the criterion from this state, shapes (k, n).

        Parameters
        ----------
        forcing : array, shape (k, n)
        state : array, shape (n,)
        """
        Q, Z = np.empty(forcing.shape), np.empty(forcing.shape)
        fixed = read_only(Q)
        for k, given in enumerate(forcing):
            Q[k] = given + self.propagate(state)
            found = self._step(fixed[k], state)
            if found is None:
                Q, Z = Q[:k], Z[:k]
                break
            state = Z[k] = found
        measured = self._data(Q).measure(Z, self.tolerance, power=1.0)
        passes, moves = measured.passes, (measured.z != Z).any(axis=1)
        count = len(Q) if passes.all() else int(np.argmin(passes))
        if moves[:count].any():  # later steps were computed from the point before it was moved
            count = int(np.argmax(moves)) + 1
        return Q[:count], read_only(measured.z)[:count]

    def _step(self, q: FloatVector, state: FloatVector) -> FloatVector | None:
        """Return the solution of one step, or None if none was found."""
        problem = self.problem
        if self.side:
            value = problem.lower if self.side > 0 else problem.upper
            found = solve_one_sided(self.band.entries, q, self.side, value, self.none)[0]
            return (
                None
                if found is None
                else np.minimum(np.maximum(found, problem.lower), problem.upper)
            )
        data = self._data(q)
        reference = data.residual(data.start, self.of_nearest + q)
        goal = 0.5 * self.tolerance * np.abs(reference).max(initial=0.0)
        rounds = active_sets(problem, self.band, q, np.clip(state, problem.lower, problem.upper))
        return next((z for z, residual in rounds if residual <= goal), None)

    def _data(self, q: FloatVector) -> RowData:
        """Return the data of the criterion of one step, q of shape (n,), or of several."""
        problem = self.problem
        vectors = q, problem.lower, problem.upper, problem.residual_scale
        return RowData(problem.csr, self.absolute, *vectors, start=problem.nearest_to_zero)
