"""The free boundary between nodes, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from contourpy import contour_generator

from lcp_plugin import LCP, gallery, solve
from lcp_plugin.evidence.drawing import contact_level
from lcp_plugin.gallery.problems import CONTACT_RADIUS


def second_difference(n: int) -> sp.dia_array:
    return sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("n", [20, 21, 37, 50, 333])
def test_a_string_leaves_the_ground_where_it_should(n, side):
    """u″ = 8, u(0) = 1, u ≥ 0 leaves the ground at 1/2 whatever the mesh, from above and, mirrored, from below."""
    h = 1.0 / (n + 1)
    q = np.full(n, 8.0 * h**2)
    q[0] -= 1.0
    x = h * np.arange(1, n + 1)
    bounds = {"lower": 0.0} if side > 0 else {"lower": -np.inf, "upper": 0.0}
    level = contact_level(solve(LCP(second_difference(n), side * q, **bounds)).certificate)
    assert np.count_nonzero(np.diff(level < 0.0)) == 1
    assert abs(np.interp(0.0, -level, x) - 0.5) <= 0.03 * h


@pytest.mark.parametrize("size", [30, 61, 120])
def test_a_membrane_touches_a_ball_in_a_circle(size):
    """The boundary is round to .2 of the mesh width; the edge of the set of nodes is off by more than half of it."""
    scene = gallery.obstacle_2d(size=size)
    result, nodes = solve(scene.problem), scene.coordinates[0]
    h = nodes[1] - nodes[0]
    level = contact_level(result.certificate).reshape(size, size)
    (edge,) = contour_generator(nodes, nodes, level).lines(0.0)
    assert abs(np.hypot(*edge.T) - CONTACT_RADIUS).max() <= 0.2 * h


def test_where_no_force_presses_the_nodes_that_rest_are_known():
    """A string over a flat roof is pressed at its two corners alone, and rests between them."""
    n = 200
    roof = np.where(abs(np.linspace(0, 1, n) - 0.5) < 0.1, 1.0, -1.0)
    result = solve(LCP(second_difference(n), np.zeros(n), lower=roof))
    level, rests = contact_level(result.certificate), result.z == roof
    assert (level[rests][1:-1] < 0.0).all()
    assert (level[~rests] >= 0.0).all()
