"""Symmetric up to rounding is symmetric, for every method and prediction."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, FrictionalContact, Status, solve
from lcp_plugin.core.matrix.matrix import Matrix
from lcp_plugin.core.matrix.symmetry import is_nearly_symmetric


def laplacian(side: int, noise: float = 0.0) -> sp.csr_array:
    """The 5-point matrix, with rounding of another size where an assembly leaves entries that ought to cancel."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    near, same = sp.diags_array([1.0, 1.0], offsets=[-1, 1], shape=(side, side)), sp.eye_array(side)
    corners = sp.csr_array(sp.kron(near, near))
    corners.data = noise * np.random.default_rng(0).uniform(-1.0, 1.0, corners.nnz)
    return sp.csr_array(sp.kron(line, same) + sp.kron(same, line) + corners)


def test_entries_that_ought_to_cancel_leave_a_matrix_symmetric():
    """|m_ij − m_ji| is rounding beside rows, however large beside m_ij; a real flow is none."""
    M = laplacian(20, noise=4e-16)
    assert is_nearly_symmetric(Matrix(M))
    assert not is_nearly_symmetric(Matrix(laplacian(20, noise=1e-9)))
    assert not is_nearly_symmetric(Matrix(sp.csr_array([[1.0, 1e-6], [0.0, 1.0]])))


@pytest.mark.parametrize("algorithm", ["auto", "multigrid"])
def test_an_assembled_matrix_is_solved_as_its_symmetric_part(algorithm):
    """The same stages and steps, and within a tenth the same work, for K and (K + Kᵀ)/2."""
    K = laplacian(60, noise=4e-16)
    q = np.full(K.shape[0], -0.01)
    q[: q.size // 2] = 0.01
    one, other = (
        solve(LCP(M, q, upper=30.0), algorithm) for M in (K, sp.csr_array((K + K.T) * 0.5))
    )
    assert one.status is other.status is Status.SOLVED
    assert (one.algorithm, one.iterations) == (other.algorithm, other.iterations)
    assert one.work == pytest.approx(other.work, rel=0.1)


def test_rounding_in_w_is_not_told():
    """`explain` of a contact problem names an asymmetry of W that is none of rounding, and no other."""
    W = np.eye(3) + 0.1
    W[0, 1] += 4e-17 * 4
    assert W[0, 1] != W[1, 0]
    rounded = solve(FrictionalContact(W, [-1.0, 0.3, 0.2], 0.5))
    assert "not symmetric" not in rounded.explain()
    W[0, 1] += 1e-6
    assert "W is not symmetric" in solve(FrictionalContact(W, [-1.0, 0.3, 0.2], 0.5)).explain()
