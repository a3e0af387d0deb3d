"""Steps of a march and their derivatives: by compiled loops on narrow bands, else one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.matrix.matrix import Matrix
from ...core.matrix.structure import row_numbers
from ...systems.factors import BANDED_UP_TO, Bands, bands
from ...systems.graph import bandwidth
from . import March

if TYPE_CHECKING:
    from ..sensitivity.derivative import Derivative


class Change(NamedTuple):
    """A direction in the data."""

    dM: sp.csr_array  # noqa: N815 - the argument's name
    dforcing: FloatVector
    dcarry: sp.csr_array
    dlower: FloatVector
    dupper: FloatVector


class Sums(NamedTuple):
    """The gradient by the state after the steps not yet gone back, and what has been summed up over the others."""

    after: FloatVector
    lower: FloatVector
    upper: FloatVector
    M: FloatVector
    carry: FloatVector


class Band(NamedTuple):
    """What the compiled loops take of a narrow band: M, the carry, both transposed; where their entries are."""

    band: Any
    transposed: Any
    rows: Any
    carry: Any
    transposed_carry: Any
    of_matrix: Any
    of_carry: Any

    @classmethod
    def of(cls, matrix: Matrix, carry: sp.csr_array) -> Band | None:
        """Return it, None where the band is not narrow."""
        if sum(bandwidth(matrix) or (matrix.n, matrix.n)) > BANDED_UP_TO or (band := bands(matrix)) is None:
            return None
        back = bands(Matrix(sp.csr_array(matrix.csr.T)))
        if back is None:
            return None
        return cls(
            _given(band), _given(back), _by_rows(matrix.csr), _by_rows(carry), _by_rows(sp.csr_array(carry.T)),
            _places(matrix.csr), _places(carry),
        )


def _given(band: Bands) -> Any:
    return band.entries, band.below, band.is_tridiagonal_z, band.weights


def _by_rows(A: sp.csr_array) -> Any:
    return A.indptr.astype(np.int64), A.indices.astype(np.int64), A.data


def _places(A: sp.csr_array) -> Any:
    return row_numbers(A).astype(np.int64), A.indices.astype(np.int64)


class CompiledSteps:
    """Some steps that follow each other, by the compiled loops as far as these go.

    Parameters
    ----------
    march : March
    first : int
        The number of the first of them.
    states : array, shape (count + 1, n)
        The state before it, and the answers.
    band : Band or None
    derivative_at : callable
        Gives the Derivative of a problem at its z and w.
    """

    def __init__(
        self, march: March, first: int, states: FloatVector, band: Band | None, derivative_at: Callable[..., Derivative]
    ) -> None:
        self.march, self.first, self.states, self.band, self.derivative_at = march, first, states, band, derivative_at
        count = len(states) - 1
        self.q = np.add(march.forcing[first : first + count], (march.carry @ states[:-1].T).T, order="C")
        self.z, self.sides = states[1:].copy(), np.zeros((count, states.shape[1]), np.int8)
        self._of_step: tuple[int, Derivative] | None = None
        self.is_plain = np.zeros(count, np.bool_)
        if self.band is not None:
            from .kernels import settle

            problem = march.problem
            settle(self.band.band, *self.band.rows, problem.residual_scale, self.q, problem.lower, problem.upper,
                   self.z, self.sides, self.is_plain)

    def __len__(self) -> int:
        return len(self.z)

    def at(self, k: int) -> Derivative:
        """Return the derivative of a step by its own data."""
        if self._of_step is None or self._of_step[0] != k:
            problem, z = self.march.problem.with_q(self.q[k]), self.states[k + 1]
            self._of_step = k, self.derivative_at(problem, z, problem.slack(z))
        return self._of_step[1]

    def degenerate(self, k: int) -> NDArray[np.intp]:
        """Return the degenerate rows of a step."""
        from .kernels import KINK

        return np.flatnonzero(np.abs(self.sides[k]) == KINK) if self.is_plain[k] else self.at(k).degenerate

    def jvp(self, change: Change, dforcing: FloatVector, before: FloatVector, dz: FloatVector) -> None:
        """Write the changes of the answers, and that of the state, which comes with that before the first step."""
        k, carry = 0, self.march.carry
        while k < len(self):
            if self.band is not None:
                from .kernels import tangents

                k = tangents(
                    self.band.band, self.band.carry, _by_rows(change.dM), _by_rows(change.dcarry), dforcing,
                    change.dlower, change.dupper, self.states, self.z, self.sides, self.is_plain, k, before, dz,
                )
            if k < len(self):
                dq = dforcing[min(k, len(dforcing) - 1)] + change.dcarry @ self.states[k] + carry @ before
                before[:] = self.at(k).jvp(
                    dq=dq + change.dM @ self.at(k).z, dlower=change.dlower, dupper=change.dupper
                )
                dz[min(k, len(dz) - 1)] = before
                k += 1

    def vjp(self, g: FloatVector, sums: Sums, by_q: FloatVector) -> None:
        """Add what these steps have to the sums, and write their gradients by q where there is room."""
        k, march = len(self) - 1, self.march
        while k >= 0:
            if self.band is not None:
                from .kernels import adjoints

                k = adjoints(
                    self.band.transposed, self.band.transposed_carry, g, self.band.of_matrix, self.band.of_carry,
                    self.states, self.z, self.sides, self.is_plain, k, sums.after, by_q, sums.lower, sums.upper,
                    sums.M, sums.carry,
                )
            if k >= 0:
                found = self.at(k).vjp(sums.after + g[k] if len(g) else sums.after)
                sums.lower[:] += found.lower
                sums.upper[:] += found.upper
                sums.M[:] += found.M.data
                sums.carry[:] += found.q[row_numbers(march.carry)] * self.states[k][march.carry.indices]
                sums.after[:] = march.carry.T @ found.q
                if len(by_q):
                    by_q[k] = found.q
                k -= 1
