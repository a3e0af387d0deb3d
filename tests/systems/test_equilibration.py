"""Scaling by powers of two, and iterated solutions of large comparison systems."""

import numpy as np
import scipy.sparse as sp

from lcp_plugin import gallery
from lcp_plugin.systems.free_systems import have_one_unit
from lcp_plugin.systems.graph import ComparisonMatrix


def test_small_units_are_seen():
    """A row in small units with a smaller pivot needs a scaling, also if no entry exceeds 1."""
    apart = np.array([[1.0, 2.0**-20], [2.0**-20, 2.0**-30]])
    assert have_one_unit(np.array([apart, np.full((2, 2), 0.5)])).tolist() == [False, True]


def test_a_diagonal_matrix_needs_little():
    """A matrix without other entries whose diagonal spans fifteen powers of two is not scaled, twenty-five are."""
    for power, scaled in ((15, False), (25, True)):
        matrix = ComparisonMatrix(sp.csr_array(np.diag([1.0, 2.0**power])))
        assert (matrix.exponents is not None) == scaled


def test_a_large_comparison_system_is_solved_by_iteration():
    """On a grid with 6400 rows the residual is below the tolerance."""
    system = ComparisonMatrix(gallery.build("obstacle_2d", size=80).problem.csr)
    rhs = np.ones(system.matrix.shape[0])
    x = system.iterated(rhs, 0.1)
    assert x is not None
    assert np.linalg.norm(rhs - system.matrix @ x) <= 0.1001 * np.linalg.norm(rhs)
