"""The derivative of an answer over cones by q, M, bounds and friction, from R(z; M, q, μ) = 0, the natural map.

It is that of :mod:`lcp_plugin.systems.linearised` with the generalised derivatives that Newton's steps use, R_μ dμ
beside them. Where M leaves
the blocks that press undetermined (several impulses make one motion), dz is the least of several, and of velocities
that all of them share the derivative is that of all. Where a block is on the edge of two cases, dz is one-sided: the
elements are those of the piece into which dz and dw lead.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core.checks import (
    FloatVector,
    changes_by_name,
    checked_vector,
    is_number,
    rectangular_matrix,
)
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.matrix.matrix import Matrix
from ...core.matrix.structure import row_numbers
from ...systems.free_systems import FreeSystem
from ...systems.linearised import Linearised
from .certificate import weighted
from .data import Blocks
from .methods import EXACT, NewtonSystem

REFINEMENTS = 5  # steps of Newton towards the answer before it is differentiated
REFINING = 1e-8  # of d, their proximal term: rounding moves no impulses that the motion leaves undetermined
BY_HAND = "; of a mass matrix m give dM = −J m⁻¹ dm m⁻¹ Jᵀ, of bodies' velocities u dq = J du"
ON_THE_EDGE = 1e-6  # of the size of z − ŵ/d, from where another case begins
ROUNDING = 1e-12  # of a block's terms: z and w/d that are smaller are both 0
PIECES, ALIKE = (
    20,
    1e-12,
)  # most that are tried for a direction, and the change of dz that tells that one is right


class ConeGradient(NamedTuple):
    """What a function of z has for gradients: by q and the bounds, (n,), by M on its pattern, by friction, (k,)."""

    q: FloatVector
    M: sp.csr_array
    friction: FloatVector
    lower: FloatVector
    upper: FloatVector


class ConeDerivative(Linearised):
    """The derivative of z by the data, at one answer.

    Parameters
    ----------
    problem : ConeProblem or FrictionalContact
    z : array, shape (n,)
        Its answer, which is refined first.
    """

    def __init__(self, problem: Blocks, z: FloatVector) -> None:
        self.problem, self._system = problem, NewtonSystem(problem)
        self.z = self._refined(np.array(z))
        self.w = problem.slack(self.z)
        self._take_element_at(self.z, self.w)

    def _take_element_at(self, z: FloatVector, w: FloatVector) -> None:
        """Take the generalised derivative at z and w, the answer or a point nearby; what sticks has w = 0.

        Its rounding has a direction, that of ‖w_T‖, on which gradients by least norm would depend.
        """
        problem = self.problem
        if problem.has_friction:
            self._cases = problem.residual(z, w)[1]
            w = np.where((self._cases == 1)[problem.block_of_row], 0.0, w)
        self._point = z, w
        self._take_rows(z, w)

    def _take_rows(self, z: FloatVector, w: FloatVector) -> None:
        """Take J, the rows that are free, and R_w."""
        self._J, self.free = self._system.rows(z, w, 0.0)
        self._by_w, self._is_free = self._system.by_w, np.isin(np.arange(self.problem.n), self.free)

    def _refined(self, z: FloatVector) -> FloatVector:
        problem = self.problem
        R = problem.residual(z, problem.slack(z))[0]
        largest = weighted(problem, R).max(initial=0.0)
        for _ in range(REFINEMENTS):
            _, step = (
                self._system.step(z, problem.slack(z), R, REFINING)
                if largest > EXACT
                else (0.0, None)
            )
            if step is None:
                break
            R, before = problem.residual(z + step, problem.slack(z + step))[0], largest
            largest = weighted(problem, R).max(initial=0.0)
            if not largest < before:
                break
            z = z + step
        return z

    @cached_property
    def _block(self) -> FreeSystem:
        return FreeSystem(Matrix(self._J), np.ones(self.free.size, np.bool_), by_factor=True)

    @property
    def is_singular(self) -> bool:
        """Whether several z make one motion, as far as rounding tells: dz is the least of several then."""
        return self._block.is_singular

    @property
    def is_unique(self) -> bool | None:
        """False where blocks are degenerate or several z answer the problem; else None: nothing is proved."""
        return False if self.degenerate.size or self.is_singular else None

    @cached_property
    def degenerate(self) -> NDArray[np.intp]:
        """The blocks on the edge of two cases, as far as rounding tells: there the derivative is one of several."""
        problem, shift = self.problem, ON_THE_EDGE * self._sizes
        cases = problem.residual(self.z, self.w)[1]
        differs = np.zeros(cases.size, np.bool_)
        for sign in (-1.0, 1.0):
            moved = self.z.copy()
            moved[problem.starts[:-1]] += sign * shift
            differs |= problem.residual(moved, self.w)[1] != cases
        return np.flatnonzero(differs)

    @cached_property
    def _sizes(self) -> FloatVector:
        """The size of z and w/d of each block, shape (k,); where both are rounding of its terms, that of these."""
        problem = self.problem
        sizes = problem.norms(np.abs(self.z) + np.abs(self.w) / problem.scale[problem.block_of_row])
        terms = problem.norms(self._sums_of_sizes() + np.abs(problem.q)) / problem.scale
        terms[terms == 0.0] = 1.0  # nothing acts: any size will do
        return np.where(sizes <= ROUNDING * terms, ROUNDING / ON_THE_EDGE * terms, sizes)

    def _sums_of_sizes(self) -> FloatVector:
        """Return |M| |z|."""
        return np.asarray(abs(self.problem.rows.csr) @ np.abs(self.z))

    def _towards(self, dz: FloatVector, dw: FloatVector) -> ConeDerivative:
        """Return the derivative of the piece that begins in this direction from the blocks on the edge of two cases."""
        problem, d = self.problem, self.problem.scale
        length = problem.norms(np.abs(dz) + np.abs(dw) / d[problem.block_of_row])
        t = np.zeros(length.size)
        moved = self.degenerate[length[self.degenerate] > 0.0]
        t[moved] = ON_THE_EDGE * self._sizes[moved] / length[moved]
        piece = copy(self)
        for known in ("_block", "_holds", "by_friction"):
            piece.__dict__.pop(known, None)
        piece._system = NewtonSystem(problem)
        t = t[problem.block_of_row]
        piece._take_element_at(self.z + t * dz, self.w + t * dw)
        return piece

    def jvp(
        self,
        *,
        dq: ArrayLike | None = None,
        dM: Any = None,
        dfriction: ArrayLike | None = None,
        dlower: ArrayLike | None = None,
        dupper: ArrayLike | None = None,
        **named: Any,
    ) -> FloatVector:
        """Return the change dz, shape (n,), that changes of the data make; one-sided where blocks are degenerate.

        Parameters
        ----------
        dq : array, shape (n,), optional
            db of contacts.
        dM : array, shape (n, n), optional
            dW of contacts.
        dfriction : number or array, shape (k,), optional
        dlower, dupper : array, shape (n,), optional
            Of the bounds; only those that hold matter.

        Raises
        ------
        InvalidOption
            For any other name: of a mass matrix give dM = −J m⁻¹ dm m⁻¹ Jᵀ, of bodies' velocities dq = J du.
        """
        changes_by_name(None, named, ("dq", "dM", "dfriction", "dlower", "dupper"), BY_HAND)
        changes = dq, dM, dfriction, dlower, dupper
        dz = self._change(*changes)
        for _ in range(PIECES if self.degenerate.size else 0):
            of_bound = np.zeros(dz.size)
            for change, is_there in (
                (dlower, self.z <= self.problem.lower),
                (dupper, self.z >= self.problem.upper),
            ):
                if change is not None:
                    of_bound[is_there] = np.asarray(change)[is_there]
            last, dz = dz, self._towards(dz - of_bound, self.dw(dz, dq=dq, dM=dM))._change(*changes)
            if np.abs(dz - last).max(initial=0.0) <= ALIKE * np.abs(dz).max(initial=0.0):
                break
        return dz

    def _change(self, dq: Any, dM: Any, dfriction: Any, dlower: Any, dupper: Any) -> FloatVector:
        """Return dz by the element that was taken."""
        problem, n = self.problem, self.problem.n
        held, more = np.zeros(n), np.zeros(())
        for change, holds in ((dlower, self._holds[0]), (dupper, self._holds[1])):
            if change is not None:
                held[holds] = checked_vector(change, "dlower or dupper", n)[holds]
        if dfriction is not None:
            if not problem.has_friction:
                raise InvalidOption(
                    "dfriction is of a FrictionalContact; a ConeProblem has dq, dM, dlower and dupper"
                )
            dfriction = (
                np.full(problem.slope.size, dfriction) if is_number(dfriction) else dfriction
            )
            slopes = checked_vector(dfriction, "dfriction", problem.slope.size)
            more = self.by_friction * slopes[problem.block_of_row]
        dz: FloatVector = self.tangent(self._moved(dq, dM), held, more)
        return dz

    def dw(self, dz: FloatVector, *, dq: ArrayLike | None = None, dM: Any = None) -> FloatVector:
        """Return the change of w = M z + q that goes with a change dz of z, shape (n,)."""
        return self._product(dz) + self._moved(dq, dM)

    def _moved(self, dq: ArrayLike | None, dM: Any) -> FloatVector:
        """Return dM z + dq."""
        n = self.problem.n
        change = np.zeros(n) if dq is None else checked_vector(dq, "dq", n)
        return change if dM is None else change + rectangular_matrix(dM, "dM", n, n) @ self.z

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> ConeGradient:
        """Return the gradients of a function that has the gradients g by z and gw, 0 by default, by w, (n,) each."""
        n, M = self.problem.n, self.problem.rows.csr
        by_w = np.zeros(n) if gw is None else checked_vector(gw, "gw", n)
        by_q, by_bound, by_friction = self.gradients(checked_vector(g, "g", n), by_w)
        by_M = sp.csr_array(
            (by_q[row_numbers(M)] * self.z[M.indices], M.indices, M.indptr), shape=M.shape
        )
        lower, upper = (np.where(holds, by_bound, 0.0) for holds in self._holds)
        return ConeGradient(by_q, by_M, by_friction, lower, upper)

    def gradients(
        self, g: FloatVector, by_w: FloatVector
    ) -> tuple[FloatVector, FloatVector, FloatVector]:
        """Return the gradients by q, by the bounds that hold, and by friction, (k,)."""
        by_q, by_bound, multiplier = self.adjoint(g, by_w)
        sums = (
            np.add.reduceat(self.by_friction * multiplier, self.problem.starts[:-1])
            if g.size
            else np.zeros(0)
        )
        return by_q, by_bound, -sums

    def _product(self, x: FloatVector, *, transposed: bool = False) -> FloatVector:
        M = self.problem.rows.csr
        product: FloatVector = (M.T if transposed else M) @ x
        return product

    def _by_slack(self, x: FloatVector, *, transposed: bool = False) -> FloatVector:
        return self._system.times(x, transposed=transposed)

    def _on_free(self, right: FloatVector, *, transposed: bool = False) -> FloatVector:
        x = np.zeros(right.size)
        x[self.free] = self._solved(right[self.free], transposed=transposed)
        return x

    @cached_property
    def _holds(self) -> tuple[Any, Any]:
        """Which rows are at their lower bound, and which at the upper one."""
        problem, at_bound = (
            self.problem,
            ~self._is_free & (self.problem.sizes == 1)[self.problem.block_of_row],
        )
        z, w = self._point
        is_lower = (z <= problem.lower) & ((z < problem.upper) | (w > 0.0))
        return at_bound & is_lower, at_bound & ~is_lower

    @cached_property
    def by_friction(self) -> FloatVector:
        """R_μ, shape (n,), of blocks on the boundary of their cones."""
        problem, found = self.problem, np.zeros(self.problem.n)
        if not (problem.has_friction and problem.n):
            return found
        on = np.flatnonzero(self._cases == 2)
        z, w = (vector.reshape(problem.slope.size, -1)[on] for vector in self._point)
        mu, d, by_w = problem.slope[on], problem.scale[on], self._by_w[on]
        x = z - w / d[:, np.newaxis]
        slip, tangent = np.hypot.reduce(w[:, 1:], axis=1), np.hypot.reduce(x[:, 1:], axis=1)
        radius = (x[:, 0] - mu * slip / d + mu * tangent) / (1.0 + mu * mu)
        change = (tangent - 2.0 * mu * radius) / (1.0 + mu * mu)
        rows = slip[:, np.newaxis] * by_w[:, :, 0]
        rows[:, 0] -= change
        rows[:, 1:] -= ((radius + mu * change) / tangent)[:, np.newaxis] * x[:, 1:]
        found.reshape(problem.slope.size, -1)[on] = rows
        return found

    def _solved(self, right: FloatVector, *, transposed: bool = False) -> FloatVector:
        if not right.size:
            return right
        x = self._block.solve(right, transposed=transposed)
        if x is not None:
            return x
        inverse = self._block.pseudo_inverse
        if inverse is None:
            raise UnsuitableProblem(
                "several answers share the same motion, and their system is too large for a pseudo-inverse (500 rows): "
                "state fewer contacts, or add a small compliance to the diagonal of W"
            )
        least: FloatVector = (inverse.T if transposed else inverse) @ right
        return least
