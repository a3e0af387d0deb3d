"""Pyramids by three unknowns a contact: the projection, one sliding contact, whole problems, and what follows."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest
from contact_families import FAMILIES, delassus, planted
from scipy.optimize import nnls

from lcp_plugin import LCP, solve
from lcp_plugin.core.certificates.residuals import Certificate
from lcp_plugin.problems.cones import small_kernels
from lcp_plugin.problems.cones.data import Blocks
from lcp_plugin.problems.cones.methods import NPGS, NewtonSystem
from lcp_plugin.problems.contact import Contacts


def problem_of(data: Contacts, edges: int = 8) -> LCP:
    return LCP.from_contacts(data.W, data.friction, data.velocities, edges)


def cones_of(problem: LCP) -> Blocks:
    data = problem.origin
    rows = LCP(data.W, data.velocities.ravel(), lower=-np.inf, upper=np.inf)
    return Blocks(
        rows, np.arange(0, rows.n + 1, 3), np.array(data.friction), has_friction=len(data.edges)
    )


@pytest.mark.parametrize("edges", [4, 6, 8, 14])
def test_the_projection_is_the_nearest_point_of_the_pyramid(edges: int) -> None:
    """Inside, on sides, on edges, at the apex, and without friction, as nonnegative least squares have it."""
    rng = np.random.default_rng(edges)
    points, friction = rng.standard_normal((200, 3)), np.tile([0.0, 0.3, 1.5, 0.7], 50)
    points[::7, 1:] *= 1e-3
    problem = LCP.from_contacts(np.eye(600), friction, points, edges)
    found = cones_of(problem).projected(points.ravel()).reshape(-1, 3)
    for point, mu, one in zip(points, friction, found, strict=True):
        rays = np.column_stack([np.ones(edges), mu * problem.origin.edges])
        np.testing.assert_allclose(one, rays.T @ nnls(rays.T, point)[0], atol=1e-12)


def test_the_derivative_is_that_of_differences() -> None:
    """At points away from kinks the rows of Newton's system are the derivative of the residual."""
    data = planted(12, 6, 10.0, np.random.default_rng(1))
    cones, rng = cones_of(problem_of(data)), np.random.default_rng(2)
    z, way = rng.standard_normal(cones.n), rng.standard_normal(cones.n)

    def residual(point: Any) -> Any:
        return cones.residual(point, cones.slack(point))[0]

    system, step = NewtonSystem(cones), 1e-7
    J, rows = system.rows(z, cones.slack(z), 0.0)
    expected = ((residual(z + step * way) - residual(z - step * way)) / (2.0 * step))[rows]
    moved = np.zeros(cones.n)
    moved[rows] = way[rows]
    held = way - moved
    np.testing.assert_allclose(
        J @ way[rows] + system.times(cones.slack(held) - cones.q)[rows], expected, atol=1e-5
    )


def test_one_contact_is_solved_in_a_sweep() -> None:
    """Open, sticking, on an edge, on a side: one sweep leaves no residual."""
    rng, cases = np.random.default_rng(0), 300
    for _ in range(cases):
        W, _ = delassus(1, 1, 1.0, rng)
        cones = cones_of(
            LCP.from_contacts(W, rng.uniform(0.0, 0.6), rng.standard_normal((1, 3)), 8)
        )
        _, step = islice(NPGS(sweeps=1).iterates(cones, np.zeros(3)), 2)
        z = step.z
        assert np.abs(cones.residual(z, cones.slack(z))[0]).max() <= 1e-10 * np.abs(cones.q).max()


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize(("count", "edges"), [(30, 8), (60, 4), (150, 6)])
def test_auto_solves_pyramids_by_their_cones(name: str, count: int, edges: int) -> None:
    """Judged by the LCP's own criterion; watched or not with the same bits, and warm with less work."""
    problem = problem_of(
        FAMILIES[name](count, count // 2, 10.0, np.random.default_rng(count)), edges
    )
    result, watched = solve(problem).require_solved(), solve(problem, record=True)
    assert [stage.name for stage in result.stages] == ["pyramids"]
    assert result.z.tobytes() == watched.z.tobytes()
    assert Certificate.of(LCP(problem.M, problem.q), result.z).relative_residual <= 1e-8
    assert solve(problem, z0=result.z).require_solved().work <= result.work


def test_groups_of_contacts_in_units_of_their_own_are_solved() -> None:
    """Bodies apart whose velocities are 10³ apart, and one that stays away."""
    data = [planted(15, 8, 10.0, np.random.default_rng(seed)) for seed in range(3)]
    W, free = (
        np.zeros((135, 135)),
        np.concatenate([10.0 ** (3 * k) * one.velocities for k, one in enumerate(data)]),
    )
    for k, one in enumerate(data):
        W[45 * k : 45 * k + 45, 45 * k : 45 * k + 45] = one.W
    free[30:] = np.abs(free[30:])
    solve(LCP.from_contacts(W, 0.5, free, 8)).require_solved()


@pytest.mark.parametrize("unit", [1e-150, 1e-30, 1e30, 1e150])
def test_the_unit_of_impulses_changes_nothing(unit: float) -> None:
    """λ of a contact that sticks is 0, not what rounding leaves of its velocity."""
    data = planted(30, 15, 10.0, np.random.default_rng(0))
    result = solve(
        LCP.from_contacts(unit * data.W, data.friction, data.velocities, 8)
    ).require_solved()
    assert [stage.name for stage in result.stages] == ["pyramids"]


def test_what_the_cones_leave_open_goes_the_way_of_any_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the compiled loop proves nothing, auto does what it does with the same arrays."""
    problem = problem_of(planted(30, 15, 10.0, np.random.default_rng(0)))
    monkeypatch.setattr(small_kernels, "solve_each", lambda *_: None)
    result, other = solve(problem).require_solved(), solve(LCP(problem.M, problem.q))
    assert [stage.name for stage in result.stages] == [
        "pyramids",
        *(stage.name for stage in other.stages),
    ]
    np.testing.assert_allclose(result.z, other.z, atol=1e-9)
