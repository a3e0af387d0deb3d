"""Scaling by powers of two, and iterated solutions of large comparison systems."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lcp_plugin import gallery
from lcp_plugin.core.matrix.scaling import are_well_scaled, fit_scaling
from lcp_plugin.systems.comparison import ComparisonMatrix


def test_a_similarity_is_undone_at_once() -> None:
    """The fit to ratios s_row − s_column along a path and a chord is s, up to a constant."""
    s = np.array([0.0, 700.0, -300.0, 20.0, 5.0])
    rows, columns = np.array([1, 2, 3, 4, 4]), np.array([0, 1, 2, 3, 1])
    found = fit_scaling(s[rows] - s[columns], rows, columns, 5)
    np.testing.assert_allclose(found - found[0], s, atol=1e-2)


def test_small_units_are_seen() -> None:
    """A row in small units with a smaller pivot needs a scaling, also if no entry exceeds 1."""
    apart = np.array([[1.0, 2.0**-20], [2.0**-20, 2.0**-30]])
    assert are_well_scaled(np.array([apart, np.full((2, 2), 0.5)])).tolist() == [False, True]


def test_a_diagonal_matrix_needs_little() -> None:
    """A matrix without other entries whose diagonal spans fifteen powers of two is not scaled, twenty-five are."""
    for power, scaled in ((15, False), (25, True)):
        matrix = ComparisonMatrix(sp.csr_array(np.diag([1.0, 2.0**power])))
        assert (matrix.exponents is not None) == scaled


def test_a_large_comparison_system_is_solved_by_iteration() -> None:
    """On a grid with 6400 rows the residual is below the tolerance."""
    system = ComparisonMatrix(gallery.build("obstacle_2d", size=80).problem.csr)
    rhs = np.ones(system.matrix.shape[0])
    x = system.iterated(rhs, 0.1)
    assert x is not None
    assert np.linalg.norm(rhs - system.matrix @ x) <= 0.1001 * np.linalg.norm(rhs)
