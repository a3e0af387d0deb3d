"""The free boundary between nodes, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import brentq

from lcp_plugin import LCP, Certificate, InvalidOption, solve
from lcp_plugin.evidence.free_boundary import free_boundary


def second_difference(n: int) -> sp.dia_array:
    return sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("n", [20, 21, 37, 50, 333])
def test_a_string_leaves_the_ground_where_it_should(n: int, side: float) -> None:
    """u″ = 8, u(0) = 1, u ≥ 0 leaves the ground at 1/2 whatever the mesh, from above and, mirrored, from below."""
    h = 1.0 / (n + 1)
    q = np.full(n, 8.0 * h**2)
    q[0] -= 1.0
    x = h * np.arange(1, n + 1)
    bounds = {"lower": 0.0} if side > 0 else {"lower": -np.inf, "upper": 0.0}
    found = free_boundary(solve(LCP(second_difference(n), side * q, **bounds)), coordinates=x)
    (place,) = found.positions
    assert abs(place - 0.5) <= 0.03 * h
    assert abs(found.area - (x[-1] - place)) <= 1e-12


def membrane(size: int) -> tuple[LCP, np.ndarray, float]:
    """A membrane over a ball, its nodes along an axis, and the radius up to which it touches."""
    nodes = np.linspace(-2, 2, size + 2)
    r = np.hypot(*np.meshgrid(nodes, nodes, indexing="ij"))
    radius = brentq(lambda one: one**2 * (1 - np.log(one / 2)) - 1, 0.1, 0.9)
    ball = np.where(r < 0.9, np.sqrt(1 - np.minimum(r, 0.9) ** 2), -1.0)
    edge = -(radius**2) / np.sqrt(1 - radius**2) * np.log(np.maximum(r, radius) / 2)
    edge[1:-1, 1:-1] = 0.0
    q = -(edge[:-2, 1:-1] + edge[2:, 1:-1] + edge[1:-1, :-2] + edge[1:-1, 2:]).ravel()
    M = sp.kron(second_difference(size), sp.eye_array(size)) + sp.kron(
        sp.eye_array(size), second_difference(size)
    )
    return LCP(M, q, lower=ball[1:-1, 1:-1].ravel()), nodes[1:-1], radius


@pytest.mark.parametrize("size", [30, 61, 120])
def test_a_membrane_touches_a_ball_in_a_circle(size: int) -> None:
    """The boundary is round to .2 of the mesh width; the edge of the set of nodes is off by more than half of it."""
    problem, nodes, radius = membrane(size)
    result = solve(problem)
    h = nodes[1] - nodes[0]
    found = free_boundary(result, coordinates=(nodes, nodes))
    distance = np.hypot(*found.segments.reshape(-1, 2).T)
    assert abs(distance - radius).max() <= 0.2 * h
    touching = np.hypot(*np.meshgrid(nodes, nodes)).ravel()[result.z == problem.lower]
    assert radius - touching.max() < h
    assert found.area == pytest.approx(np.pi * radius**2, rel=0.3 * h)
    length = np.linalg.norm(np.diff(found.segments, axis=1), axis=2).sum()
    assert length == pytest.approx(2 * np.pi * radius, rel=0.02)


def test_nodes_of_triangles_and_a_grid_agree() -> None:
    """The same nodes as a mesh give the same boundary, and a certificate that of its result."""
    problem, nodes, _ = membrane(30)
    result = solve(problem)
    grid = free_boundary(result, coordinates=(nodes, nodes))
    corners = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    halves = [(corners, corners + 1, corners + 30), (corners + 1, corners + 31, corners + 30)]
    triangles = np.concatenate([np.stack(half, axis=1) for half in halves])
    mesh = free_boundary(Certificate.of(problem, result.z), mesh=(grid.points[:900], triangles))
    assert np.array_equal(mesh.level, grid.level[:900])
    assert mesh.area == pytest.approx(grid.area, rel=0.01)
    assert len(mesh.segments) == pytest.approx(len(grid.segments) / 1.5, rel=0.3)
    assert np.array_equal(free_boundary(result, shape=(30, 30)).level, grid.level)


def test_where_no_force_presses_the_nodes_that_rest_are_known() -> None:
    """A string over a flat roof is pressed at its two corners alone, and rests between them."""
    n = 200
    x = np.linspace(0, 1, n)
    roof = np.where(abs(x - 0.5) < 0.1, 1.0, -1.0)
    result = solve(LCP(second_difference(n), np.zeros(n), lower=roof))
    found = free_boundary(result, coordinates=x)
    rests = x[result.z == roof]
    np.testing.assert_allclose(found.positions, [rests[0], rests[-1]], atol=1.0 / n)
    assert (found.level[result.z == roof][1:-1] < 0.0).all()


def test_an_answer_that_touches_nowhere_has_no_boundary() -> None:
    """Of a free answer, and of one that rests on its bounds everywhere."""
    free = free_boundary(solve(LCP(second_difference(5), -np.ones(5))))
    assert free.positions.size == 0
    assert free.area == 0.0
    held = free_boundary(solve(LCP(second_difference(5), np.ones(5))))
    assert held.positions.size == 0
    assert held.area == 4.0


def test_a_wrong_number_of_nodes_is_refused() -> None:
    """Each message says how many are needed."""
    result = solve(LCP(second_difference(6), -np.ones(6)))
    for wrong, words in (
        ({"coordinates": [1.0, 2.0]}, "6 numbers, finite"),
        ({"shape": (2, 2)}, "6 unknowns"),
        ({"mesh": (np.zeros((2, 6)), np.zeros((1, 3), dtype=int))}, r"\(6, 2\)"),
    ):
        with pytest.raises(InvalidOption, match=words):
            free_boundary(result, **wrong)
    with pytest.raises(InvalidOption, match="a Result or Certificate"):
        free_boundary(result.z)  # type: ignore[arg-type]
    with pytest.raises(InvalidOption, match="segments"):
        _ = free_boundary(result, shape=(2, 3)).positions
