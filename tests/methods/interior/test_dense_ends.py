"""Factors that end in a dense block are those of LDLᵀ without one, and are found where LAPACK is quicker."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.settings import Status
from lcp_plugin.methods.interior.dense_ends import DenseEnd, analysed, in_order, newton_matrix
from lcp_plugin.methods.interior.quasidefinite import QuasidefiniteNewtonMatrix, Symbolic, signs_of


def program(kind: str, rng: np.random.Generator) -> sp.csr_array:
    """Return [P, Aᵀ; −A, 0] of a kind of program, its rows in any order."""
    m, n = {"lasso": (80, 400), "tall": (400, 80), "square": (120, 120), "half": (200, 400), "sparse": (500, 500)}[kind]
    density = {"half": 0.6, "sparse": 0.02}.get(kind, 1.0)
    rows = sp.random_array((m, n), density=density, rng=rng, data_sampler=rng.standard_normal)
    identity = sp.eye_array(n)
    A = sp.block_array([[rows, -sp.eye_array(m), None], [identity, None, -identity], [-identity, None, -identity]])
    P = sp.diags_array(np.repeat([0.0, 1.0, 0.0], [n, m, n]))
    order = rng.permutation(A.shape[0] + A.shape[1])
    M = sp.csr_array(sp.csr_array(sp.block_array([[P, A.T], [-A, None]]))[order][:, order])
    M.sort_indices()
    return M


def signed(M: sp.csr_array) -> FloatVector:
    """Return the signs of a program's matrix."""
    signs = signs_of(M)
    assert signs is not None
    return signs


@pytest.mark.parametrize("kind", ["lasso", "tall", "square", "half", "sparse"])
def test_a_dense_end_changes_no_solution(kind: str) -> None:
    """With its last rows eliminated by LAPACK a factor solves what LAPACK alone does, at every factorisation."""
    rng = np.random.default_rng(0)
    M = program(kind, rng)
    matrix, size = newton_matrix(M, False, signed(M)), M.shape[0]
    assert isinstance(matrix, QuasidefiniteNewtonMatrix)
    assert isinstance(matrix.symbolic, DenseEnd)
    for _ in range(3):
        diagonal, right = 10.0 ** rng.uniform(-2, 2, size), rng.standard_normal(size)
        assert matrix.factorise(diagonal)
        expected = np.linalg.solve(M.toarray() + np.diag(diagonal), right)
        np.testing.assert_allclose(matrix.solve(right), expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["lasso", "tall"])
def test_dense_rows_come_last(kind: str) -> None:
    """Of a lasso with few rows or few columns these are the dense block, and L has less than minimum degree's fill."""
    M = program(kind, np.random.default_rng(1))
    known, plain = analysed(M, signed(M)), Symbolic.of(M)
    assert isinstance(known, DenseEnd)
    assert 80 <= known.last <= 82
    assert known.entries <= 1.01 * plain.entries
    assert known.work < 0.5 * plain.work


@pytest.mark.parametrize("density", [0.0, 0.02, 0.3])
def test_the_pattern_in_any_order_is_that_of_a_dense_factor(density: float) -> None:
    """L in an order that is given has the entries that Cholesky's factor of such a matrix has, few or many."""
    rng, n = np.random.default_rng(5), 80
    half = sp.random_array((n, n), density=density, rng=rng, data_sampler=rng.random)
    M, order = sp.csr_array(half + half.T + 2.0 * n * sp.eye_array(n)), rng.permutation(n)
    M.sort_indices()
    symbolic = in_order(M, order)
    expected = np.tril(np.linalg.cholesky(M.toarray()[np.ix_(order, order)]), -1)
    _, starts, below, row_starts, columns = (part.astype(np.int64) for part in symbolic.pattern[:5])
    found = sp.csc_array((np.ones(below.size), below, starts), shape=(n, n)).toarray()
    by_rows = sp.csr_array((np.ones(columns.size), columns, row_starts), shape=(n, n)).toarray()
    assert np.array_equal(found, by_rows)
    assert np.array_equal(found > 0.0, expected != 0.0)


def test_one_sign_or_both_are_factorised() -> None:
    """The dense block may have pivots of one sign only, or of both."""
    rng = np.random.default_rng(2)
    B = rng.standard_normal((150, 150))
    for signs in (np.ones(150), -np.ones(150), np.repeat([1.0, -1.0], 75), np.tile([1.0, -1.0], 75)):
        S = B @ B.T * (signs[:, None] == signs) + B * (signs[:, None] > signs) - B.T * (signs[:, None] < signs)
        M = sp.csr_array(S)
        matrix, right = newton_matrix(M, False, signs), rng.standard_normal(150)
        assert isinstance(matrix, QuasidefiniteNewtonMatrix)
        assert isinstance(matrix.symbolic, DenseEnd)
        last = matrix.symbolic.pattern[0][-matrix.symbolic.last :]
        assert matrix.symbolic.positive == np.count_nonzero(signs[last] > 0.0)
        assert matrix.factorise(np.ones(150))
        np.testing.assert_allclose(S @ matrix.solve(right) + matrix.solve(right), right, atol=1e-9)


def test_a_block_that_is_not_definite_is_refused() -> None:
    """Where the dense block is not quasi-definite no regularisation helps, and that is said."""
    S = np.full((150, 150), 10.0) - 20.0 * np.eye(150)
    assert not newton_matrix(sp.csr_array(S), False, np.ones(150)).factorise(np.zeros(150))


def test_sparse_factors_have_no_dense_end() -> None:
    """A band, a small program and a matrix of nothing keep the pattern that qdldl gives them."""
    band = sp.diags_array([np.ones(499), np.full(500, 4.0), np.ones(499)], offsets=[-1, 0, 1], format="csr")
    small = sp.csr_array(np.ones((20, 20)) + np.eye(20))
    for M in (sp.csr_array(band), small, sp.csr_array((3, 3))):
        assert not isinstance(analysed(M, np.ones(M.shape[0])), DenseEnd)


def test_a_dense_end_gives_the_same_bits_again() -> None:
    """A problem with a dense end is solved, and to the same bits when it is solved again."""
    M, rng = program("lasso", np.random.default_rng(3)), np.random.default_rng(4)
    z = np.where(rng.random(M.shape[0]) < 0.5, rng.random(M.shape[0]), 0.0)
    w = np.where(z > 0.0, 0.0, rng.random(z.size))
    runs = [solve(LCP(M, w - M @ z), "interior_point") for _ in range(2)]
    assert runs[0].status is Status.SOLVED
    assert np.array_equal(runs[0].z, runs[1].z)
