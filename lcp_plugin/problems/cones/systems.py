"""Factorizations for Newton's steps, in the unknowns or in the velocities of bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

ACCURATE = 1e-4  # of the right-hand side: a larger residual means that the matrix is singular
LAPACK_UP_TO = 600  # unknowns of a dense system
DENSE_UP_TO = 150  # unknowns of a sparse system that is solved as dense
FEW = 60  # unknowns: up to here the system of the bodies does not pay


class Factors(NamedTuple):
    """A factorization: the function that solves with it, and the number of entries processed."""

    solve: Callable[[Any], Any]
    entries: float


def factorize_matrix(J: Any) -> Factors:
    """Return a solver for J, by LAPACK or SuperLU.

    Raises
    ------
    LinAlgError
        For a singular matrix; raised by the solver if only its solutions reveal this.
    """
    from scipy.linalg.lapack import dgetrf, dgetrs

    if not sp.issparse(J) or J.shape[0] <= DENSE_UP_TO:
        factors, pivots, failed = dgetrf(J.toarray() if sp.issparse(J) else J)
        if failed:
            raise np.linalg.LinAlgError
        return Factors(lambda right: dgetrs(factors, pivots, right)[0], J.shape[0] ** 3 / 3.0)
    J = sp.csc_array(J)
    try:
        options = {"SymmetricMode": True}
        lu = sp.linalg.splu(J, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options)
    except RuntimeError as error:
        raise np.linalg.LinAlgError from error

    def solve(right: Any) -> Any:
        found = lu.solve(right)
        most = ACCURATE * np.abs(right).max(initial=0.0)
        if not np.abs(J @ found - right).max(initial=0.0) <= most:
            raise np.linalg.LinAlgError
        return found

    return Factors(solve, 2.0 * lu.nnz)


class Arms:
    """The bodies behind contacts, M = J mass⁻¹ Jᵀ: the rows of J contact by contact.

    Parameters
    ----------
    bodies : Bodies
    k, m : int
        Number of contacts, rows of each.
    """

    def __init__(self, bodies: Any, k: int, m: int) -> None:
        self.mass, J = sp.coo_array(bodies.mass), sp.coo_array(bodies.rows)
        v = self.mass.shape[0]
        pairs, place = np.unique(J.row // m * np.int64(v) + J.col, return_inverse=True)
        contact = pairs // v
        inner = np.arange(pairs.size) - np.searchsorted(contact, np.arange(k))[contact]
        width = int(inner.max(initial=0)) + 1
        self.columns, self.rows = np.zeros((k, width), np.int64), np.zeros((k, m, width))
        self.columns[contact, inner] = pairs % v
        self.rows[J.row // m, J.row % m, inner[place]] = J.data
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
            inverse = factorize_matrix(entries.reshape(v, v))
        else:
            indptr = np.searchsorted(self.pattern, np.arange(v + 1) * np.int64(v))
            inverse = factorize_matrix(
                sp.csr_array((entries, self.pattern % v, indptr), shape=(v, v))
            )
        KJ, at = KJ[free], columns[free]

        def solve(right: Any) -> Any:
            s = right[0].copy()
            s[free] = (A @ s[free][..., None])[..., 0]
            pull = (arms @ s[..., None]).ravel()
            moved = inverse.solve(np.bincount(columns.ravel(), pull, v))
            s[free] -= (KJ @ moved[at][..., None])[..., 0]
            return s[None]

        return Factors(solve, inverse.entries)
