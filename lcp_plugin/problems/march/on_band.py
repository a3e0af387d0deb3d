"""Time stepping on narrow bands: several marches step together, and blocks of steps are checked.

M may be tridiagonal with off-diagonal entries ≤ 0 and bounds on one side only, as in an American option. Each step
is then one pass of :func:`~lcp_plugin.methods.banded.solve_one_sided`, for several marches in one call. On other
bands a step runs :func:`~lcp_plugin.methods.banded.active_sets`, one march after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, TINY
from ...core.lcp import LCP
from ...methods.banded import active_sets, solve_one_sided
from ...systems.factors import bands


class Marches:
    """Marches of one size on narrow bands, in arrays with a batch axis.

    Parameters
    ----------
    problems : sequence of LCP
        The matrix and the bounds of each march.
    propagators : sequence of csr_array, shape (n, n)
    tolerance : float
        Tolerance of the stopping criterion.
    """

    def __init__(
        self, problems: Sequence[LCP], propagators: Sequence[sp.csr_array], tolerance: float
    ) -> None:
        self.problems, self.propagators, self.tolerance = problems, propagators, tolerance
        self.lower, self.upper, self.nearest, self.scale = (
            np.array([getattr(one, name) for one in problems])
            for name in ("lower", "upper", "nearest_to_zero", "residual_scale")
        )
        self.side = bounded_side(problems[0])
        self.bands: list[Any] = [bands(one.matrix) for one in problems]
        if self.side:
            self.value = self.lower if self.side > 0 else self.upper
            self.none_held = np.zeros(self.value.shape, np.bool_)
            are_one = all(one.matrix is problems[0].matrix for one in problems)
            self.entries = np.array([one.entries for one in self.bands[: 1 if are_one else None]])

    def steps(
        self, forcing: FloatVector, states: FloatVector
    ) -> tuple[FloatVector, FloatVector, NDArray[np.intp]]:
        """Return q and z of steps from these states, shapes (k, m, n), and the number of solved ones, shape (m,).

        Parameters
        ----------
        forcing : array, shape (k, m, n)
        states : array, shape (m, n)
        """
        Q, Z = np.empty(forcing.shape), np.full(forcing.shape, np.nan)
        of_nearest = self._product(self.nearest)
        with np.errstate(all="ignore"):
            for k, given in enumerate(forcing):
                Q[k] = given + self._propagate(states)
                found = self._step(Q[k], of_nearest, states)
                if found is None:
                    Q, Z = Q[:k], Z[:k]
                    break
                states = Z[k] = found
            are_solved = self._are_solved(Q, Z, of_nearest)
        Z.flags.writeable = False  # because they were checked
        counts = (
            np.where(are_solved.all(axis=0), len(Q), np.argmin(are_solved, axis=0))
            if len(Q)
            else np.zeros(len(states), np.intp)
        )
        return Q, Z, counts

    def _step(
        self, Q: FloatVector, of_nearest: FloatVector, states: FloatVector
    ) -> FloatVector | None:
        """Return the solutions of one step, or None if a solution was not found."""
        if self.side:
            found = solve_one_sided(self.entries, Q, self.side, self.value, self.none_held)[0]
            return None if found is None else np.clip(found, self.lower, self.upper, out=found)
        answers = []
        for j, (problem, band, q) in enumerate(zip(self.problems, self.bands, Q, strict=True)):
            reference = self._residual(of_nearest[j] + q, self.nearest[j], j)
            goal = 0.5 * self.tolerance * np.max(reference, initial=0.0)
            start = np.clip(states[j], problem.lower, problem.upper)
            rounds = active_sets(problem, band, q, start)
            answers.append(next((z for z, residual in rounds if residual <= goal), None))
            if answers[-1] is None:
                return None
        return np.array(answers)

    def _are_solved(
        self, Q: FloatVector, Z: FloatVector, of_nearest: FloatVector
    ) -> NDArray[np.bool_]:
        """Return a mask, shape (k, m), of steps that meet the criterion, rounding included."""
        T = self._product(np.abs(Z), is_magnitude=True)
        T += np.abs(Q)
        W = self._product(Z)
        W += Q
        wrong = np.abs(W)
        wrong[(self.lower >= Z) & (W >= 0.0) | (self.upper <= Z) & (W <= 0.0)] = 0.0
        wrong[np.broadcast_to(self.lower == self.upper, Z.shape)] = 0.0
        is_right = (wrong <= self.tolerance**0.75 * T).all(axis=-1)
        slip = self._bound_rounding(T)
        residual = self._residual(W, Z)
        residual += slip
        reference = self._residual(of_nearest + Q, self.nearest)
        terms = self._product(np.abs(self.nearest), is_magnitude=True)
        reference -= self._bound_rounding(terms + np.abs(Q))
        allowed = self.tolerance * reference.max(axis=-1, initial=0.0)
        answer: NDArray[np.bool_] = is_right & (residual.max(axis=-1, initial=0.0) <= allowed)
        return answer

    def _residual(
        self, W: FloatVector, Z: FloatVector, j: int | slice = slice(None)
    ) -> FloatVector:
        """Return |z − mid(lower, upper, z − w/d)|."""
        step = W / self.scale[j]
        np.minimum(step, Z - self.lower[j], out=step)
        np.maximum(step, Z - self.upper[j], out=step)
        residual: FloatVector = np.abs(step, out=step)
        return residual

    def _bound_rounding(self, T: FloatVector) -> FloatVector:
        """Return a bound of the rounding error of w/d, w with the terms T."""
        width = int(np.diff(self.problems[0].csr.indptr).max(initial=0))
        rounding: FloatVector = (T * EPSILON + TINY) * ((width + 4) / self.scale)
        return rounding

    def _product(self, Z: FloatVector, *, is_magnitude: bool = False) -> FloatVector:
        """Return M z, or |M| z."""
        if self.side:
            E = np.abs(self.entries) if is_magnitude else self.entries
            W = E[:, 1] * Z
            W[..., 1:] += E[:, 0, 1:] * Z[..., :-1]
            W[..., :-1] += E[:, 2, :-1] * Z[..., 1:]
            return W
        matrices = [abs(one.csr) if is_magnitude else one.csr for one in self.problems]
        return np.stack([(M @ Z[..., j, :].T).T for j, M in enumerate(matrices)], axis=-2)

    def _propagate(self, states: FloatVector) -> FloatVector:
        first = self.propagators[0]
        if all(one is first for one in self.propagators):
            moved: FloatVector = (first @ states.T).T
            return moved
        return np.array([C @ z for C, z in zip(self.propagators, states, strict=True)])


def bounded_side(problem: LCP) -> int:
    """Return 1 (−1) for a tridiagonal M with off-diagonal entries ≤ 0 and lower (upper) bounds only, else 0."""
    band = bands(problem.matrix)
    if band is None or not band.is_tridiagonal_z:
        return 0
    return 1 if np.isinf(problem.upper).all() else -1 if np.isinf(problem.lower).all() else 0
