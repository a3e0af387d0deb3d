"""Factorizations for Newton's steps over cones, in the unknowns or in the velocities of bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.cone_stack import ConeStack, Pattern
from ...core.matrix import fact
from ...systems.factors import factorize

LAPACK_UP_TO = 600  # unknowns of a dense system
FEW = 60  # unknowns: up to here the system of the bodies does not pay


class Factors(NamedTuple):
    """A factorization: the function that solves with it, and the number of entries processed."""

    solve: Callable[[Any], Any]
    entries: float


def factorize_matrix(J: Any) -> Factors:
    """Return a solver for J, dense or CSR.

    Raises
    ------
    LinAlgError
        For a singular matrix; raised by the solver if only its solutions reveal this.
    """
    if sp.issparse(J) and J.shape[0] <= 150:  # a small sparse system is solved as dense
        J = J.toarray()
    if (factor := factorize(J)) is None:
        raise np.linalg.LinAlgError

    def solve(right: Any) -> Any:
        solution = factor.solve(right)
        if sp.issparse(J):
            solution = solution + factor.solve(right - J @ solution)
            # A larger residual means that the matrix is singular
            most = 1e-4 * np.abs(right).max(initial=0.0)
            if not np.abs(J @ solution - right).max(initial=0.0) <= most:
                raise np.linalg.LinAlgError
        return solution

    return Factors(solve, factor.work)


class Arms:
    """The bodies behind contacts, M = J mass⁻¹ Jᵀ: the rows of J contact by contact.

    Parameters
    ----------
    bodies : Bodies
    pattern : Pattern
    """

    def __init__(self, bodies: Any, pattern: Pattern) -> None:
        self.mass, J = sp.coo_array(bodies.mass), sp.coo_array(bodies.rows)
        v, k, m = self.mass.shape[0], pattern.k, pattern.m
        block, row = pattern.of_row[J.row], pattern.in_block[J.row]
        pairs, place = np.unique(block * np.int64(v) + J.col, return_inverse=True)
        contact = pairs // v
        inner = np.arange(pairs.size) - np.searchsorted(contact, np.arange(k))[contact]
        width = int(inner.max(initial=0)) + 1
        self.columns, self.rows = np.zeros((k, width), np.int64), np.zeros((k, m, width))
        self.columns[contact, inner] = pairs % v
        self.rows[block, row, inner[place]] = J.data
        local = (self.columns[:, :, None] * v + self.columns[:, None, :]).ravel()
        of_mass = self.mass.row * np.int64(v) + self.mass.col
        self.flat, self.pattern = np.concatenate([local, of_mass]), np.arange(v * v)
        if v > LAPACK_UP_TO:
            self.pattern, self.flat = np.unique(self.flat, return_inverse=True)

    def are_fewer(self, rows: int) -> bool:
        """Return whether a system of the velocities is cheaper than a system of so many rows."""
        return bool(max(FEW, self.mass.shape[0]) < rows)

    def factorize(self, mixed: Any, by_w: Any, free: Any) -> Factors:
        """Return a solver in the velocities v: (mass + JᵀKJ) v = JᵀA right, s = A right − K J v."""
        v, columns, arms = self.mass.shape[0], self.columns, self.rows.swapaxes(1, 2)
        A = np.linalg.inv(mixed[free])
        K = np.zeros_like(by_w)
        K[free] = A @ by_w[free]
        KJ = K @ self.rows
        local = (arms @ KJ).ravel()
        entries = np.bincount(self.flat, np.concatenate([local, self.mass.data]), self.pattern.size)
        if v <= LAPACK_UP_TO:
            matrix = entries.reshape(v, v)
        else:
            indptr = np.searchsorted(self.pattern, np.arange(v + 1) * np.int64(v))
            matrix = sp.csr_array((entries, self.pattern % v, indptr), shape=(v, v))
        inverse = factorize_matrix(matrix)
        KJ, at = KJ[free], columns[free]

        def solve(right: Any) -> Any:
            s = right[0].copy()
            s[free] = (A @ s[free][..., None])[..., 0]
            pull = (arms @ s[..., None]).ravel()
            moved = inverse.solve(np.bincount(columns.ravel(), pull, v))
            s[free] -= (KJ @ moved[at][..., None])[..., 0]
            return s[None]

        return Factors(solve, inverse.entries)


@fact
def matrix_blocks(problem: Any) -> tuple[Pattern, Arms | None]:
    """Return the blocks of M, and the bodies behind them, which problems with this matrix share."""
    M = problem.rows.M
    # A small sparse problem is stored as dense
    if sp.issparse(M) and problem.n <= (FEW if problem.bodies else 300):
        M = M.toarray()
    pattern = Pattern(M[None] if isinstance(M, np.ndarray) else M, problem.starts)
    has_arms = problem.bodies is not None and pattern.n > FEW
    return pattern, Arms(problem.bodies, pattern) if has_arms else None


def cone_stack_of(problem: Any) -> ConeStack:
    """Return the stack of one problem."""
    pattern, arms = matrix_blocks(problem)
    vectors = problem.q, problem.slope, problem.lower, problem.upper
    stacked, has_friction = (vector[None] for vector in vectors), problem.has_friction
    with np.errstate(all="ignore"):
        return ConeStack(pattern, *stacked, has_friction=has_friction, arms=arms)
