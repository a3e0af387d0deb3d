"""What a factor takes is known before it is made, nearly, and in a time near that of reading the pattern."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.linalg import splu

from lcp_plugin.systems.minimum_degree import factor_sizes


def line(m: int) -> Any:
    return sp.diags_array([-np.ones(m - 1), 2.0 * np.ones(m), -np.ones(m - 1)], offsets=[-1, 0, 1])


def grid(m: int, dimensions: int) -> Any:
    """Five-point differences, or seven-point ones."""
    A = line(m)
    for _ in range(dimensions - 1):
        A = sp.kron(A, sp.eye_array(m)) + sp.kron(sp.eye_array(A.shape[0]), line(m))
    return sp.csc_array(A)


def elastic(a: int, b: int) -> Any:
    """Bilinear squares, two unknowns a node."""
    pattern = sp.kron(sp.kron(abs(line(a)).sign(), abs(line(b)).sign()), np.ones((2, 2)))
    return sp.csc_array(pattern + 100.0 * sp.eye_array(pattern.shape[0]))


def scattered(n: int) -> Any:
    R = sp.random_array((n, n), density=3.0 / n, rng=np.random.default_rng(0))
    return sp.csc_array(R + R.T + 20.0 * sp.eye_array(n))


def with_full_rows() -> Any:
    A = grid(60, 2).tolil()
    A[[5, 17], :] = 1.0
    A[:, [5, 17]] = 1.0
    A.setdiag(1e5)
    return sp.csc_array(A)


def arrow(n: int) -> Any:
    A = sp.eye_array(n).tolil()
    A[0, :] = A[:, 0] = 1.0
    A[0, 0] = 3.0 * n
    return sp.csc_array(A)


MATRICES = {
    "grid 100²": lambda: grid(100, 2),
    "cube 15³": lambda: grid(15, 3),
    "block of squares": lambda: elastic(50, 50),
    "random graph": lambda: scattered(1500),
    "arrow": lambda: arrow(800),
    "full rows": with_full_rows,
}


@pytest.mark.parametrize("name", MATRICES)
def test_the_counts_are_nearly_those_of_the_factor(name: str) -> None:
    """Entries within a fifth of SuperLU's, in its own order of minimum degree; operations from .6 to 1.6 times."""
    A = MATRICES[name]()
    entries, operations = factor_sizes(A)
    options = {"SymmetricMode": True}
    factor = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    counts = np.diff(factor.L.indptr).astype(float)
    assert 0.8 * counts.sum() <= entries <= 1.2 * counts.sum()
    assert 0.6 * (counts @ counts) <= operations <= 1.6 * (counts @ counts)


@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.floats(0.0, 0.5))
def test_no_factor_of_a_random_pattern_has_fewer_entries_than_the_pattern(
    n: int, seed: int, density: float
) -> None:
    """Nor more than a full one; operations are those of that many entries at least."""
    rng = np.random.default_rng(seed)
    pattern = (rng.random((n, n)) < density).astype(float)
    np.fill_diagonal(pattern, 1.0)
    entries, operations = factor_sizes(sp.csr_array(pattern))
    least = (np.count_nonzero(pattern + pattern.T) - n) // 2 + n
    assert least <= entries <= n * (n + 1) / 2
    assert (
        entries**2 / n
        <= operations * (1.0 + 1e-12)
        <= n * (n + 1) * (2 * n + 1) / 6 * (1.0 + 1e-12)
    )


@pytest.mark.parametrize("n", [2, 9, 30])
def test_a_full_matrix_and_a_diagonal_one_are_counted_exactly(n: int) -> None:
    """Columns of n, n − 1, … 1 entries, and of one each."""
    assert factor_sizes(sp.csr_array(np.ones((n, n)))) == (
        n * (n + 1) / 2,
        n * (n + 1) * (2 * n + 1) / 6,
    )
    assert factor_sizes(sp.csr_array(sp.eye_array(n))) == (n, n)
