"""Derivative of a time-stepping run: the chain of its steps, forwards or backwards.

With q_k = f_k + C z_{k−1} each step passes on dq_k = df_k + dC z_{k−1} + C dz_{k−1}. Backwards, a function L of all
z has g_k = ∂L/∂z_k + Cᵀ ∂L/∂q_{k+1}, from which the derivative of the step computes ∂L/∂q_k. The gradients by M, C
and the bounds are summed over the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core.checks import (
    FloatVector,
    change_of_vector,
    derived_property,
    rectangular_matrix,
)
from ...core.errors import InvalidOption, UnsuitableProblem, did_you_mean
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.matrix import Matrix, row_numbers
from ...methods.banded import held_entries, solve_held
from ...systems.factors import BANDED_UP_TO, Bands, bands
from ...systems.graph import bandwidth
from . import BLOCK, March, checked_propagator, checked_rows, propagation

if TYPE_CHECKING:
    from ..sensitivity import Derivative

LEFT = 2.0**-20  # relative to the last change: bound of the remaining error
CLEAR = 64.0  # times the rounding error
BACKWARD = 2.0**-40  # relative residual of a stable solution
CANCELLED = 2.0**40  # terms relative to their sum: the block is nearly singular
KINK = 2  # times the side of a row at this bound with w = 0
NEGLIGIBLE = 2.0**-960  # below, a row's distance and slack have underflown: it is at its bound


class Band(NamedTuple):
    """Matrix of a march on a narrow band, its bands, and propagator; possibly transposed."""

    M: sp.csr_array
    size: sp.csr_array
    entries: Bands
    propagate: Callable[[FloatVector], FloatVector]

    @classmethod
    def of(cls, matrix: Matrix, propagator: sp.csr_array) -> Band | None:
        """Return the band of a matrix, or None if it is not narrow."""
        width = sum(bandwidth(matrix) or (matrix.n, matrix.n))
        if width > BANDED_UP_TO or (entries := bands(matrix)) is None:
            return None
        return cls(matrix.csr, abs(matrix.csr), entries, propagation(propagator))

    def follow(
        self, state: NDArray[np.int8], value: FloatVector, right: FloatVector, before: FloatVector
    ) -> tuple[FloatVector, FloatVector, FloatVector]:
        """Return x, w = M x + r and the rounding error of w of the first of consecutive steps, r = right + C before.

        `before` is the x of the step before. x is `value` on rows with a state; the other rows are free and satisfy
        w = 0. The rounding error is relative to the row weights. Steps end before one whose block of free rows is
        nearly singular, because its residual exceeds the rounding error, or its terms cancel.

        Parameters
        ----------
        state, value, right : arrays, shape (k, n)
        before : array, shape (n,)

        Returns
        -------
        x, w : array, shape (j, n)
        rounding : array, shape (j,)
        """
        x, unit, is_free = np.empty(right.shape), self.entries.weights, state == 0
        given, weights = np.where(is_free, -right * unit, value), np.where(is_free, unit, 0.0)
        count, first = len(x), before
        for k, entries in enumerate(held_entries(self.entries, state)):
            rest = given[k] - weights[k] * self.propagate(before)
            if (found := solve_held(entries, self.entries.below, rest)) is None:
                count = k
                break
            before = x[k] = found
        x, is_free = x[:count], is_free[:count]
        right = right[:count] + self.propagate(np.array([first, *x[:-1]])[:count])
        w, size = (self.M @ x.T).T + right, ((self.size @ np.abs(x).T).T + np.abs(right)) * unit
        given = np.abs((self.M @ np.where(is_free, 0.0, x).T).T + right) * unit
        terms, given, left = (
            np.max(one, axis=1, initial=0.0, where=is_free)
            for one in (size, given, np.abs(w) * unit)
        )
        is_regular = (left <= BACKWARD * terms) & (terms <= CANCELLED * given)
        count = count if is_regular.all() else int(np.argmin(is_regular))
        return x[:count], w[:count], EPSILON * terms[:count]


def _outer_on(A: sp.csr_array, left: FloatVector, right: FloatVector) -> FloatVector:
    """Return Σ_k left_ki right_kj at the entries of A."""
    sums: FloatVector = np.einsum("kp,kp->p", left[:, row_numbers(A)], right[:, A.indices])
    return sums


def _solve_each(entries: FloatVector, below: int, right: FloatVector) -> FloatVector:
    """Return the solutions of banded systems, shape (k, n), as one system; NaN for a singular one."""
    together = solve_held(np.concatenate([*entries], axis=1), below, right.ravel())
    if together is not None:
        return together.reshape(right.shape)
    found = map(solve_held, entries, [below] * len(right), right)
    return np.array([np.full(right.shape[1], np.nan) if one is None else one for one in found])


class Steps:
    """Consecutive steps of a march; `here` is the slice of their indices.

    On a narrow band each solution is first computed again on its free rows, and its rows are classified: −1 at the
    lower bound, 0 between, 1 at the upper bound, ∓2 if also w = 0. A step is passed to its Derivative if rounding
    error leaves rows undecided, or if its free block is nearly singular.

    Parameters
    ----------
    whole : MarchDerivative
    first : int
        The number of the first step.
    states : array, shape (count + 1, n)
        The state before the first step, and the solutions.
    """

    @np.errstate(all="ignore")
    def __init__(self, whole: MarchDerivative, first: int, states: FloatVector) -> None:
        self.whole, self.march, self.states = whole, whole.march, states
        march, count = whole.march, len(states) - 1
        self.here = slice(first, first + count)
        self.q = march.forcing[self.here] + (march.propagator @ states[:-1].T).T
        self._of_step: tuple[int, Derivative] | None = None
        if (settled := whole.settled.get(first)) is None:
            settled = whole.settled[first] = self._settle(whole.band)
        self.z, (self.sides, self.is_plain) = settled[0].copy(), settled[1:]

    def __len__(self) -> int:
        return len(self.states) - 1

    def _settle(self, band: Band | None) -> tuple[FloatVector, NDArray[np.int8], NDArray[np.bool_]]:
        """Solve each step on its free rows once; return the solutions, the states of rows, and which active sets stay.

        Without a band, none stays.
        """
        problem, z = self.march.problem, self.states[1:]
        change = before = np.full(z.shape, KINK, np.int8)
        if band is None:
            return z, before, np.zeros(len(z), np.bool_)
        lower, upper, scale = problem.lower, problem.upper, problem.residual_scale
        for is_last in (False, True):
            w, size = (band.M @ z.T).T + self.q, (band.size @ np.abs(z).T).T + np.abs(self.q)
            above, below = z - lower, upper - z
            nearest = np.minimum(above, below) * scale
            is_negligible = (nearest < NEGLIGIBLE) & (np.abs(w) < NEGLIGIBLE)
            found = np.where(above * scale <= w, -1, np.where(-below * scale >= w, 1, 0))
            found = np.where(is_negligible, np.where(above <= below, -1, 1), found)
            found = np.where(lower == upper, np.where(w < 0.0, 1, -1), found)
            if is_last:
                break
            before = found
            value = np.where(found < 0, lower, upper)
            right = np.where(found, value - z, -w * band.entries.weights)
            step = _solve_each(held_entries(band.entries, found), band.entries.below, right)
            change, z = np.abs(step), np.where(found, value, z + step)
        size *= EPSILON * (np.diff(band.M.indptr) + 1)
        near, slight = size + LEFT * change * scale, size + LEFT * (band.size @ change.T).T
        is_clear = (nearest > CLEAR * near) | (np.abs(w) > CLEAR * slight) | (lower == upper)
        is_kink = is_negligible | ((nearest <= size) & (np.abs(w) <= size) & ~is_clear)
        kinks = np.where(below < above, KINK, -KINK)
        sides = np.where(is_kink & (lower != upper), kinks, found).astype(np.int8)
        return z, sides, ((found == before) & (is_clear | is_kink)).all(axis=1)

    def at(self, k: int) -> Derivative:
        """Return the derivative of a step by the data of the step."""
        if self._of_step is None or self._of_step[0] != k:
            problem, z = self.march.problem.with_q(self.q[k]), self.states[k + 1]
            self._of_step = k, self.whole.next_at(problem, z, problem.slack(z))
        return self._of_step[1]

    def degenerate(self, k: int) -> NDArray[np.intp]:
        """Return the degenerate rows of a step."""
        return (
            np.flatnonzero(np.abs(self.sides[k]) > 1) if self.is_plain[k] else self.at(k).degenerate
        )

    def jvp(
        self,
        dM: sp.csr_array,
        dforcing: FloatVector,
        dpropagator: sp.csr_array,
        dlower: FloatVector,
        dupper: FloatVector,
        before: FloatVector,
    ) -> FloatVector:
        """Return the changes of the solutions, and write the last change to `before`.

        At the call, `before` is the change of the state before the first step.
        """
        given = np.broadcast_to(dforcing, self.z.shape) + (dpropagator @ self.states[:-1].T).T
        value = np.where(self.sides < 0, dlower, np.where(self.sides > 0, dupper, 0.0))

        def solve_alone(k: int, before: FloatVector) -> FloatVector:
            alone = self.at(k)
            dq = given[k] + self.march.propagator @ before + dM @ alone.z
            return alone.jvp(dq=dq, dlower=dlower, dupper=dupper)

        forwards, right = np.arange(len(self)), given + (dM @ self.z.T).T
        dz, _ = self._follow(self.whole.band, forwards, value, right, before, solve_alone)
        before[:] = dz[-1]
        return dz

    def vjp(self, g: FloatVector, after: FloatVector, of_bounds: FloatVector) -> FloatVector:
        """Return the gradients by q, and add the gradients by the bounds to `of_bounds`.

        `after` is the gradient by q of the next step (0 if there is none), and is overwritten by the gradient of
        the first of these steps.
        """

        def solve_alone(k: int, after: FloatVector) -> FloatVector:
            alone = self.at(k)
            gradient = alone.vjp(g[k] + self.march.propagator.T @ after)
            self.z[k] = alone.z
            of_bounds[:] += gradient.lower, gradient.upper
            return np.asarray(gradient.q)

        order, none = np.arange(len(self))[::-1], np.zeros(g.shape)
        by_q, w = self._follow(self.whole.transposed, order, none, g[order], after, solve_alone)
        side = self.sides[order]
        of_bounds[:] += (w * (side < 0)).sum(axis=0), (w * (side > 0)).sum(axis=0)
        after[:] = by_q[-1]
        return by_q[order]

    def _follow(
        self,
        band: Band | None,
        order: NDArray[np.intp],
        value: FloatVector,
        right: FloatVector,
        before: FloatVector,
        solve_alone: Callable[[int, FloatVector], FloatVector],
    ) -> tuple[FloatVector, FloatVector]:
        """Return x and w of the steps in this order, on the band if that decides; w is 0 for the other steps.

        Forwards, a degenerate row stays at its bound if its slack agrees; backwards, any piece is a gradient.
        """
        x, w, k, side = np.empty(right.shape), np.zeros(right.shape), 0, self.sides[order]
        is_plain = self.is_plain[order] & (band is not None)
        is_kink = (np.abs(side) == KINK) & (order[-1] >= order[0])
        while k < len(x):
            stop = k + int(np.argmin(np.append(is_plain[k:], False)))
            if band is None or stop == k:
                before = x[k] = solve_alone(int(order[k]), before)
                k += 1
                continue
            here = slice(k, stop)
            found, slack, rounding = band.follow(side[here], value[here], right[here], before)
            here = slice(k, k + len(found))
            signed = np.where(side[here] > 0, slack, -slack) * band.entries.weights
            is_wrong = (is_kink[here] & (signed > rounding[:, np.newaxis])).any(axis=1)
            count = int(np.argmax(is_wrong)) if is_wrong.any() else len(found)
            here = slice(k, k + count)
            x[here], w[here] = found[:count], slack[:count]
            k += count
            before = x[k - 1] if count else before
            if k < stop:
                is_plain[k] = False
        return x, w


class MarchGradient(NamedTuple):
    """Gradient of a function of all steps in time, with respect to the data.

    Attributes
    ----------
    z0, lower, upper : array, shape (n,)
        Gradients by the state before the first step, also for the default z0, and by the bounds of all steps.
    M, propagator : csr_array, shape (n, n)
        Gradients by the entries of M and the propagator, on their sparsity patterns. For a number as propagator, use
        the sum of the diagonal.
    forcing : array, shape (k, n)
    """

    z0: FloatVector
    lower: FloatVector
    upper: FloatVector
    M: sp.csr_array
    propagator: sp.csr_array
    forcing: FloatVector


class MarchDerivative:
    """The derivative of all steps in time with respect to M, forcing, propagator, z0 and bounds.

    ``found[k]`` is the :class:`~lcp_plugin.problems.sensitivity.Derivative` of step k by the q of the step, with its
    proofs.

    Parameters
    ----------
    march : March
    each : callable
        Returns the Derivative of a problem at its z and w.

    Raises
    ------
    UnsuitableProblem
        If the march was not solved to its end.

    Notes
    -----
    A step on a narrow band is one banded system. A step is passed to its Derivative if its rows are nearly degenerate
    or its free block is nearly singular, and for other matrices.
    """

    def __init__(self, march: March, each: Callable[..., Derivative]) -> None:
        _require_all_steps(march)
        self.march, self._derivative_at = march, each
        self._before: Derivative | None = None  # its factorization may be used again
        # By the first step of a block: as much memory as the march, a quarter of the time of further directions.
        self.settled: dict[int, tuple[FloatVector, NDArray[np.int8], NDArray[np.bool_]]] = {}

    def __len__(self) -> int:
        return len(self.march)

    def __getitem__(self, k: int) -> Derivative:
        result = self.march[k]
        return self._derivative_at(result.certificate.problem, result.z, result.w)

    def next_at(self, problem: LCP, z: FloatVector, w: FloatVector) -> Derivative:
        """Return the derivative of the next step, with the last factorization if it fits."""
        self._before = self._derivative_at(problem, z, w, before=self._before)
        return self._before

    @derived_property
    def degenerate(self) -> NDArray[np.intp]:
        """Pairs of a step and a row at a bound with w = 0, up to rounding error; shape (count, 2).

        Rows without a bound that only prescribe z, such as boundary values as identity rows, do not count.
        """
        found = [np.empty((0, 2), np.intp)]
        for part in self._parts():
            for k in range(len(part)):
                rows = part.degenerate(k)
                found.append(np.column_stack([np.full(rows.size, part.here.start + k), rows]))
        return np.concatenate(found)

    @derived_property
    def is_unique(self) -> bool | None:
        """True if the derivative of each step exists, at its q: see ``Derivative``.

        True if this is proved for all steps, False if rows of a step are degenerate, otherwise None.
        """
        if self.degenerate.size:
            return False
        return True if all(self[k].is_unique for k in range(len(self))) else None

    def jvp(
        self,
        *,
        dM: Any = None,
        dforcing: Any = None,
        dpropagator: Any = None,
        dz0: Any = None,
        dlower: Any = None,
        dupper: Any = None,
        only_last: bool = False,
        **unknown: Any,
    ) -> FloatVector:
        """Return the changes dz of the solutions for changes of the data; one-sided at a kink.

        Parameters
        ----------
        dM : array or sparse array, shape (n, n), optional
            The change of M, on any pattern.
        dforcing : array, shape (k, n) or (n,), optional
            Change of the forcing of each step, or one row for all.
        dpropagator : number or array or sparse array, shape (n, n), optional
            The change of the propagator, on any pattern; a number stands for a multiple of the identity.
        dz0 : array, shape (n,), optional
        dlower, dupper : number or array, shape (n,), optional
            Changes of the bounds; only active bounds matter.
        only_last : bool
            If True, return only the change of the last solution.

        Returns
        -------
        array, shape (k, n), or (n,) for the last answer alone
            Changes of the solutions. Without steps, `only_last` returns dz0.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            See the Derivative of a step.

        Examples
        --------
        >>> from lcp_plugin import LCP, derivative, march
        >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)
        >>> derivative(march(rod, [[-1, 0], [-1, 0]], z0=[1, 1])).jvp(dz0=[1, 0])
        array([[0.375  , 0.125  ],
               [0.15625, 0.09375]])
        """
        if unknown:
            known = "dM", "dforcing", "dpropagator", "dz0", "dlower", "dupper", "only_last"
            name, hint = next(iter(unknown)), did_you_mean(next(iter(unknown)), known)
            hint = "; the q of the steps change by dforcing" if name == "dq" else hint
            raise InvalidOption(f"jvp of a march has no option {name!r}{hint}")
        n, steps = self.march.problem.n, len(self)
        rows = _rows(
            np.zeros(n) if dforcing is None else dforcing, "dforcing", steps, n, "all steps"
        )
        none = sp.csr_array((n, n))
        dM = none if dM is None else sp.csr_array(rectangular_matrix(dM, "dM", n, n))
        dC = none if dpropagator is None else checked_propagator(dpropagator, n, "dpropagator")
        low = change_of_vector(dlower, "dlower", n, may_be_number=True)
        high = change_of_vector(dupper, "dupper", n, may_be_number=True)
        before = change_of_vector(dz0, "dz0", n).copy()
        dz = np.empty((0 if only_last else steps, n))
        for part in self._parts():
            changes = part.jvp(
                dM, rows[part.here] if rows.ndim > 1 else rows, dC, low, high, before
            )
            if not only_last:
                dz[part.here] = changes
        return before if only_last else dz

    def vjp(self, g: ArrayLike) -> MarchGradient:
        """Return the gradients of a function L by M, forcing, propagator, z0 and bounds.

        If rows are degenerate, this is the gradient of one of the pieces that meet there: see ``Derivative.vjp``.

        Parameters
        ----------
        g : array, shape (k, n), or (n,) for the last answer alone
            ∂L/∂z.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            If the block of M on the free rows of a step is singular.

        Examples
        --------
        >>> from lcp_plugin import LCP, derivative, march
        >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)
        >>> gradient = derivative(march(rod, [[-1, 0], [-1, 0]], z0=[1, 1])).vjp([1, 0])
        >>> gradient.z0, gradient.propagator.diagonal()
        (array([0.15625, 0.09375]), array([-0.484375, -0.171875]))
        >>> gradient.forcing
        array([[-0.15625, -0.09375],
               [-0.375  , -0.125  ]])
        """
        n, steps = self.march.problem.n, len(self)
        rows = np.array(_rows(g, "g", steps, n, "the last answer alone"))
        M, propagator = self.march.problem.csr, self.march.propagator
        after, of_bounds, forcing = np.zeros(n), np.zeros((2, n)), np.empty((steps, n))
        of_M, of_C = np.zeros(M.nnz), np.zeros(propagator.nnz)
        for part in self._parts(backwards=True):
            own = np.zeros(part.z.shape)
            if rows.ndim > 1:
                own[:] = rows[part.here]
            elif part.here.stop == steps:
                own[-1] = rows
            by_q = forcing[part.here] = part.vjp(own, after, of_bounds)
            of_M += _outer_on(M, by_q, part.z)
            of_C += _outer_on(propagator, by_q, part.states[:-1])
        z0 = propagator.T @ after if steps else rows if rows.ndim == 1 else after
        by_M = sp.csr_array((of_M, M.indices, M.indptr), shape=(n, n))
        by_C = sp.csr_array((of_C, propagator.indices, propagator.indptr), shape=(n, n))
        return MarchGradient(z0, of_bounds[0], of_bounds[1], by_M, by_C, forcing)

    def _parts(self, *, backwards: bool = False) -> Iterator[Steps]:
        """Yield the steps in blocks, with their classified rows."""
        march = self.march
        starts = range(0, len(march), BLOCK)
        for first in reversed(starts) if backwards else starts:
            before = march.z[first - 1] if first else march.z0
            yield Steps(self, first, np.array([before, *march.z[first : first + BLOCK]]))

    @derived_property
    def band(self) -> Band | None:
        """The march's band, None if M has no narrow one."""
        return Band.of(self.march.problem.matrix, self.march.propagator)

    @derived_property
    def transposed(self) -> Band | None:
        """The band of the transposed matrices."""
        return Band.of(
            Matrix(sp.csr_array(self.march.problem.csr.T)), sp.csr_array(self.march.propagator.T)
        )


def _rows(given: ArrayLike, name: str, steps: int, n: int, one: str) -> FloatVector:
    """Return a row per step, or one row if one vector is passed."""
    shapes = (steps, n), (n,)
    return checked_rows(name, given, f"({steps}, {n}), or ({n},) for {one}", shapes.__contains__)


def _require_all_steps(march: March) -> None:
    """Raise UnsuitableProblem for a march that was not solved to its last step, or did not keep all steps."""
    if march.keep != 1:
        raise UnsuitableProblem(
            f"the derivative of a march needs all its steps, and keep={march.keep or 'last'} dropped some; "
            "leave out keep"
        )
    if march.all_solved and len(march) == len(march.forcing):
        return
    last = len(march) - 1
    why = march.error or (
        f"ended {march[last].status.name}"
        if not march[last].is_solved
        else "was the last one taken"
    )
    raise UnsuitableProblem(
        f"only a march solved to its end has a derivative; it took {len(march)} of {len(march.forcing)} steps, "
        f"and step {last} {why}; take derivative(march[k]) of single steps, or march along fewer of them"
    )
