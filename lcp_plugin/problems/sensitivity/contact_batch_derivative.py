"""Derivatives of a batch of contact problems: stacked systems, single in doubtful cases."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import BoolVector, derived_property
from ...systems.least_norm import FreeBlocks, products
from ..batches.worlds import stack_of_worlds
from ..cones.derivative import StackDerivative
from ..cones.newton import whole_systems
from ..cones.stack import ConeStack
from ..many.chunks import run_in_chunks
from .batch_derivative import BatchGradient, ManyDerivatives

NAMED = 5  # instances in a message
TOGETHER = 512  # instances whose arrays fit into the cache


class _Together(StackDerivative):
    """Derivatives of some instances, with an inverse of each system."""

    def __init__(self, stack: ConeStack, z: Any, items: Any, is_solved: Any) -> None:
        super().__init__(stack, stack.pattern.wide(z))
        self.items = items
        self.is_plain = is_solved & (self.system.is_regular | self.system.is_singular)

    @derived_property
    def system(self) -> FreeBlocks:
        """The inverses on the free rows."""
        free = np.repeat(self.is_free, self.stack.pattern.sizes, axis=1)
        return FreeBlocks(whole_systems(self.stack, self.by_z, self.by_w), free)

    @property
    def points(self) -> Any:
        """The refined impulses, shape (B, n)."""
        return self.stack.pattern.flat(self.z)

    def changes(self, change: Any, slopes: Any) -> list[Any]:
        """Return [dz], a row per instance, for changes of W z + b and friction; NaN at a kink."""
        more = self.by_friction * np.repeat(slopes, self.stack.pattern.sizes, axis=1)
        dz = self.tangent(change, None, more)
        dz[self.degenerate.any(axis=1)] = np.nan
        return [dz]

    def _solve_free(self, right: Any, *, transposed: bool = False) -> Any:
        return self.system.solve(right, transposed=transposed)


class ContactBatchDerivative(ManyDerivatives):
    """Derivatives of the impulses of a batch of contact problems with respect to W, b and friction.

    ``found[k]`` is the :class:`~lcp_plugin.problems.cones.derivative.ConeDerivative` of instance k. The arrays for
    all instances agree with it to rounding error.

    Parameters
    ----------
    batch : BatchAnswers
    each : callable
        Returns the ConeDerivative of a ConeResult.

    Attributes
    ----------
    errors : dict
        Error of each instance without a derivative: UnsuitableProblem if it is not solved, InvalidProblem if its data
        are invalid. The rows of these instances are NaN and do not affect other instances.

    Notes
    -----
    The first call inverts the systems of all instances, with the number of threads of the batch. Every later `vjp` and
    `jvp` is a product. An instance is passed to its ConeDerivative, which takes a hundred times as long, if its system
    may be singular, or for `jvp` if it has degenerate contacts.

    Examples
    --------
    How the impulse of a block that slides depends on friction, on the push, and on W:

    >>> from lcp_plugin import FrictionalContact, derivative, solve_batch
    >>> batch = solve_batch(FrictionalContact.worlds(np.eye(3), [[-1.0, 3.0, 4.0], [-1.0, 0.3, 0.0]], 0.5))
    >>> found = derivative(batch)
    >>> (found.jvp(dfriction=1.0).round(6) + 0.0).tolist()
    [[0.0, -0.6, -0.8], [0.0, 0.0, 0.0]]
    >>> gradient = found.vjp([1.0, 0.0, 0.0])
    >>> (gradient.q.round(6) + 0.0).tolist(), (gradient.friction.round(6) + 0.0).tolist(), gradient.M.shape
    ([[-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], [[0.0], [0.0]], (2, 3, 3))
    """

    @property
    def worlds(self) -> Any:
        """The FrictionalContactBatch."""
        return self.batch.problems.worlds

    @derived_property
    def _parts(self) -> list[_Together]:
        """Derivatives of the instances, in groups."""
        worlds, z, is_solved = self.worlds, self.batch.z, self._is_solved[:, np.newaxis]
        parts: list[Any] = [None] * max(-(-len(self) // TOGETHER), 1)

        def derive(first: int, end: int) -> None:
            for k in range(first, end):
                own = slice(k * TOGETHER, (k + 1) * TOGETHER)
                W = np.where(is_solved[own, :, np.newaxis], worlds.W[own], np.eye(worlds.n))
                b, at, mu = (
                    np.where(is_solved[own], one[own], 0.0)
                    for one in (worlds.b, z, worlds.friction)
                )
                stack = stack_of_worlds(W, b, mu, worlds.dimension)
                parts[k] = _Together(stack, at, np.arange(len(self))[own], self._is_solved[own])

        run_in_chunks(derive, len(parts), self.batch.threads)
        return parts

    @derived_property
    def is_singular(self) -> Any:
        """Instances in which several impulses make one motion, bool, (B,); dz is the least."""
        is_singular = np.zeros(len(self), np.bool_)
        for part in self._parts:
            is_singular[part.items] = part.is_plain & part.system.is_singular
        for k in self._left:
            is_singular[k] = self[k].is_singular
        return is_singular

    @property
    def advice(self) -> str:
        """Warning that derivatives are not unique, as text; "" if all are unique."""
        named = {
            "contacts on the edge of two cases: jvp is one-sided there, and vjp the gradient of one of the pieces that "
            "meet": self.degenerate.any(axis=1),
            "several impulses for one motion: dz is the least change, that of the motion is the same for all": (
                self.is_singular
            ),
            "no derivative: see errors": ~self._is_solved,
        }
        return "; ".join(
            f"{which.sum()} of {len(self)} worlds ({_named(which)}) have {words}"
            for words, which in named.items()
            if which.any()
        )

    def jvp(self, *, dq: Any = None, dM: Any = None, dfriction: Any = None) -> Any:
        """Return the changes dz for changes of the data, shape (B, n); one-sided at a kink.

        Parameters
        ----------
        dq : array, shape (B, n) or (n,), optional
            db.
        dM : array, shape (B, n, n) or (n, n), optional
            dW.
        dfriction : number or array, shape (B, k) or (k,), optional

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        """
        change, slopes = self._changed(dM, dq), self._rows(dfriction, "dfriction")
        dz, counts = np.full(change.shape, np.nan), self.worlds.contacts

        def alone(k: int) -> list[Any]:
            own = slopes[k, : counts[k]]
            return [self[k].jvp(dq=change[k, : self[k].z.size], dfriction=own)]

        self._fill([dz], lambda part: part.changes(change[part.items], slopes[part.items]), alone)
        return dz

    def dw(self, dz: ArrayLike, *, dq: Any = None, dM: Any = None) -> Any:
        """Return the changes of the velocities w = W z + b for changes dz of z, shape (B, n)."""
        dw = products(self.worlds.W, self._rows(dz, "dz")) + self._changed(dM, dq)
        dw[[*self.errors]] = np.nan
        return dw

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> BatchGradient:
        """Return the gradients of a function L_k(z_k, w_k) of each instance by b, W and friction.

        Parameters
        ----------
        g : array, shape (B, n) or (n,)
            ∂L/∂z.
        gw : array, shape (B, n) or (n,), optional
            ∂L/∂w, w the velocities.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        """
        by_z, by_w = self._rows(g, "g"), self._rows(gw, "gw")
        tables = np.full(by_z.shape, np.nan), np.full(self.worlds.friction.shape, np.nan)

        def alone(k: int) -> Any:
            own = slice(self[k].z.size)
            gradient = self[k].vjp(by_z[k, own], by_w[k, own])
            return gradient.q, gradient.friction

        def together(part: _Together) -> Any:
            by_q, _, by_friction = part.gradients(by_z[part.items], by_w[part.items])
            return by_q, by_friction

        self._fill(tables, together, alone)
        self._forget_unasked(tables, g, gw)
        z, by_b = np.where(self._is_solved[:, np.newaxis], self.z, 0.0), tables[0]
        return BatchGradient(
            lambda: by_b[:, :, np.newaxis] * z[:, np.newaxis], q=by_b, friction=tables[1]
        )

    @property
    def _pieces(self) -> int:
        """Number of contacts per instance, absent contacts included."""
        return int(self.worlds.friction.shape[1])

    def _is_there(self, name: str) -> Any:
        """Return the mask of the rows, or contacts, of solved instances."""
        d = 1 if name == "dfriction" else self.worlds.dimension
        counts = np.where(self._is_solved, d * self.worlds.contacts, 0)
        return np.arange(d * self._pieces) < counts[:, np.newaxis]


def _named(which: BoolVector) -> str:
    rows = np.flatnonzero(which).tolist()
    return ", ".join(map(str, rows[:NAMED])) + (", …" if len(rows) > NAMED else "")
