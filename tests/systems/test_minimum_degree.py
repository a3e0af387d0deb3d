"""What a factor takes is known before it is made, nearly, and in a time near that of reading the pattern."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
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


def scattered(n: int) -> Any:
    R = sp.random_array((n, n), density=3.0 / n, rng=np.random.default_rng(0))
    return sp.csc_array(R + R.T + 20.0 * sp.eye_array(n))


def with_full_rows() -> Any:
    A = grid(60, 2).tolil()
    A[[5, 17], :] = 1.0
    A[:, [5, 17]] = 1.0
    A.setdiag(1e5)
    return sp.csc_array(A)


MATRICES = {
    "grid 100²": lambda: grid(100, 2),
    "cube 15³": lambda: grid(15, 3),
    "random graph": lambda: scattered(1500),
    "full rows": with_full_rows,
}


@pytest.mark.parametrize("name", MATRICES)
def test_the_counts_are_nearly_those_of_the_factor(name):
    """Entries within a fifth of SuperLU's, in its own order of minimum degree; operations from .6 to 1.6 times."""
    A = MATRICES[name]()
    entries, operations = factor_sizes(A)
    options = {"SymmetricMode": True}
    factor = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    counts = np.diff(factor.L.indptr).astype(float)
    assert 0.8 * counts.sum() <= entries <= 1.2 * counts.sum()
    assert 0.6 * (counts @ counts) <= operations <= 1.6 * (counts @ counts)


def test_full_rows_alone_exceed_the_limits_of_a_count():
    """If all rows count as full, their triangle is compared with the limits as well."""
    G = sp.random_array((2000, 2000), density=0.05, rng=np.random.default_rng(1), format="csr")
    A = sp.csr_array(sp.block_array([[None, G.T], [G, None]]))
    assert factor_sizes(A, np.inf, 1e9) == (np.inf, np.inf)
    assert factor_sizes(A, 1e6, np.inf) == (np.inf, np.inf)
