"""Cones in cvxpy: the pair (t, x) of cp.SOC and its slack, impulses with friction, mixed with ordinary pairs."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    ConeProblem,
    FrictionalContact,
    box,
    complements,
    derivative,
    friction_cone,
    solve,
)

RNG = np.random.default_rng(3)


def definite(n: int) -> Any:
    A = RNG.standard_normal((n, n))
    return A @ A.T + np.eye(n)


def solved(*constraints: Any, **options: Any) -> Any:
    problem = cp.Problem(cp.Minimize(0), list(constraints))
    problem.solve(method="LCP", **options)
    return problem


def test_a_convex_program_over_cones_has_the_same_answer_in_cvxpy():
    """Of min ½ zᵀM z + qᵀz over a cone: complementarity is its optimality condition, duals included."""
    M, q = definite(4), RNG.standard_normal(4)
    z = cp.Variable(4)
    pair = complements(cp.SOC(z[0], z[1:]), M @ z + q)
    solved(pair, tolerance=1e-10)
    found = z.value
    soc = cp.SOC(z[0], z[1:])
    cp.Problem(cp.Minimize(0.5 * cp.quad_form(z, cp.psd_wrap(M)) + q @ z), [soc]).solve(
        solver="CLARABEL", tol_gap_abs=1e-13, tol_gap_rel=1e-13
    )
    np.testing.assert_allclose(found, z.value, atol=1e-6)
    np.testing.assert_allclose(pair.dual_value, M @ found + q, atol=1e-8)
    np.testing.assert_allclose(
        np.concatenate([np.ravel(one) for one in soc.dual_value]), pair.dual_value, atol=1e-5
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_several_cones_beside_boxes_and_equations_make_one_cone_problem(axis):
    """Each pair holds, whatever the order of rows in the model, and a second solve begins at the first."""
    t, X, y, total = cp.Variable(3), cp.Variable((2, 3)), cp.Variable(2), cp.Variable()
    q = RNG.standard_normal((3, 3))
    cone = cp.SOC(t, X) if axis == 0 else cp.SOC(t, X.T, axis=1)
    F = 3.0 * cp.vstack([cp.reshape(t, (1, 3), order="F"), X]) + q + 0.1 * cp.sum(y)
    pairs = [complements(cone, F), complements(y >= 0, 2 * y + X[0, :2] - total - [1.0, -4.0] >= 0)]
    problem = cp.Problem(cp.Minimize(0), [*pairs, total == 0.1 * cp.sum(X)])
    problem.solve(method="LCP", tolerance=1e-10)
    assert problem.status == "optimal"
    assert isinstance(problem.solver_stats.extra_stats.problem, ConeProblem)
    assert max(pair.violation() for pair in pairs) <= 1e-8
    assert (np.linalg.norm(X.value, axis=0) <= t.value + 1e-8).all()
    np.testing.assert_allclose(pairs[0].dual_value, F.value, atol=1e-8)
    assert pairs[0].residual.shape == (3, 3)
    problem.solve(method="LCP")
    assert "started from the values" in problem.solver_stats.extra_stats.begun


def test_two_cones_of_expressions_complement_each_other():
    """Neither side is entries of variables: a new unknown is, and both constraints get their duals."""
    x = cp.Variable(3)
    A, q = definite(3), RNG.standard_normal(3)
    first, second = cp.SOC((A @ x)[0] + 1, (A @ x)[1:]), cp.SOC(x[0] + q[0], x[1:] + q[1:])
    pair = complements(first, second)
    problem = cp.Problem(cp.Minimize(0), [pair])
    problem.solve(method="LCP", tolerance=1e-10)
    z, w = A @ x.value + [1, 0, 0], x.value + q
    assert pair.violation() <= 1e-8
    assert abs(z @ w) <= 1e-8
    for dual, value in ((first.dual_value, w), (second.dual_value, z)):
        np.testing.assert_allclose(
            np.concatenate([np.ravel(one) for one in dual]), value, atol=1e-8
        )


def test_friction_in_cvxpy_is_frictional_contact():
    """By velocities of bodies as definitions, with parameters for μ and the push; again after they change."""
    J, push, mu = RNG.standard_normal((6, 4)), cp.Parameter(4), cp.Parameter(2)
    r, v = cp.Variable(6), cp.Variable(4)
    problem = cp.Problem(
        cp.Minimize(0), [complements(friction_cone(r, mu), J @ v), v == push + J.T @ r]
    )
    for scale in (1.0, 2.0):
        push.value, mu.value = scale * np.array([1.0, -2.0, 0.5, 1.0]), np.array([0.3, 0.9]) * scale
        problem.solve(method="LCP", tolerance=1e-10)
        expected = solve(
            FrictionalContact(J @ J.T, J @ push.value, mu.value), tolerance=1e-10
        ).require_solved()
        np.testing.assert_allclose(r.value, expected.z, atol=1e-7)
        found = problem.solver_stats.extra_stats
        assert isinstance(found.problem, FrictionalContact)
        assert found.motion.touches.shape == (2,)


def test_the_order_of_the_sides_is_free():
    """Of cones and of friction."""
    for side in (lambda r: cp.SOC(r[0], r[1:]), lambda r: friction_cone(r, 1.0)):
        r = cp.Variable(3)
        pair = complements(r - np.array([1.0, -3.0, -4.0]), side(r))
        solved(pair)
        np.testing.assert_allclose(
            pair.dual_value, r.value - np.array([1.0, -3.0, -4.0]), atol=1e-8
        )
        assert pair.violation() <= 1e-8


t, x, y = cp.Variable(), cp.Variable(2), cp.Variable(3)


@refusals(r"""
complements(cp.SOC(t, x), y >= 0) → must be an expression F, or a cone like it
complements(cp.SOC(t, x), x - 1) → same shape, got \(3,\)
complements(friction_cone(y, 1.0), cp.SOC(t, x)) → needs the velocities u
friction_cone(cp.Variable((2, 3)), 1.0) → needs a vector of impulses
friction_cone(cp.Variable(7), 1.0) → multiple of
friction_cone(cp.Variable(6), [1.0, 2.0, 3.0], dimension=3) → one per 3 rows
solved(complements(cp.SOC(t, x), cp.exp(cp.hstack([t, x])))) → must be affine
solved(complements(cp.SOC(t, x), cp.hstack([t, x])), complements(y >= 0, cp.exp(y) >= 2)) → with affine sides only
solved(complements(friction_cone(y, 1.0), y - 1), complements(x >= 0, x)) → has impulses as its only unknowns
solved(complements(friction_cone(y, -1.0), y - 1)) → not be negative
cp.Problem(cp.Minimize(t), [complements(cp.SOC(t, x), cp.hstack([t, x]))]).solve(method='LCP')
    → the best of its solutions cannot be computed
solved(complements(cp.SOC(t, (z := cp.Variable(2, nonneg=True))), cp.hstack([t, z]))) → has bounds next to a cone
LCP.from_cvxpy(cp.Problem(cp.Minimize(0), [complements(friction_cone(y, 1.0), y - 1)])) → affine sides without cones
solved(complements(friction_cone(y, 1.0), y - 1), relaxation=1) → takes no relaxation
""")
def test_what_is_no_model_over_cones_is_refused_in_words(call, words):
    """Saying what was given and what is needed."""
    assert_refused(call, words, globals())


def with_friction(rng: Any) -> tuple[Any, list[Any]]:
    """Five contacts that open, stick and slide; coefficients of three are one parameter, those of the others two."""
    J = rng.standard_normal((15, 24)) / 5.0
    r, b = cp.Variable(15, name="r"), cp.Parameter(15, value=rng.standard_normal(15))
    same = cp.Parameter(nonneg=True, value=0.4)
    each = cp.Parameter(2, nonneg=True, value=[0.2, 0.5])
    u = J @ J.T @ r + b
    pairs = [
        complements(friction_cone(r[:9], 2 * same), u[:9]),
        complements(friction_cone(r[9:], each**2), u[9:]),
    ]
    return cp.Problem(cp.Minimize(0), pairs), [b, same, each]


def with_boxes(rng: Any) -> tuple[Any, list[Any]]:
    """A cone of expressions beside one of variables, a box whose bounds are parameters, an equation and scales."""
    M, A = definite(7), definite(3)
    z, y, s = cp.Variable(4, name="z"), cp.Variable(3, name="y"), cp.Variable(3, name="s")
    q, scale = cp.Parameter(7, value=rng.standard_normal(7)), cp.Parameter(nonneg=True, value=1.3)
    low, high = cp.Parameter(3, value=[-0.1, -0.2, -9.0]), cp.Parameter(3, value=[9.0, 0.1, 9.0])
    F = scale**2 * (M @ cp.hstack([z, y])) + q
    side = A @ s + q[:3]
    return cp.Problem(
        cp.Minimize(0),
        [
            complements(cp.SOC(z[0], z[1:]), F[:4]),
            complements(box(y, low, high), F[4:]),
            complements(cp.SOC(side[0], side[1:]), scale * s - [2.0, 1.0, 0.0]),
        ],
    ), [q, scale, low, high]


@pytest.mark.quick(2)
@pytest.mark.parametrize("make", [with_friction, with_boxes])
@pytest.mark.parametrize("seed", range(5))
def test_gradients_over_cones_agree_with_differences_of_solves(make, seed):
    """By friction, by bounds, by what stands in F; of variables and of duals; vjp is jvp transposed."""
    rng = np.random.default_rng(seed)
    problem, parameters = make(rng)
    pair = problem.constraints[0]

    def solved():
        problem.solve(method="LCP", tolerance=1e-11)
        assert problem.status == "optimal"
        return np.concatenate(
            [*(np.ravel(one.value, order="F") for one in problem.variables()), pair.dual_value]
        )

    solved()
    values = [parameter.value for parameter in parameters]
    deltas = [rng.standard_normal(parameter.shape) for parameter in parameters]
    found, owners = derivative(problem), [*problem.variables(), pair]
    changed = found.jvp(dict(zip(parameters, deltas, strict=True)))
    pushed = np.concatenate([np.ravel(changed[one], order="F") for one in owners])
    weights = rng.standard_normal(pushed.size)
    parts = np.split(weights, np.cumsum([changed[one].size for one in owners])[:-1])
    gradients = found.vjp(
        {
            one: part.reshape(changed[one].shape, order="F")
            for one, part in zip(owners, parts, strict=True)
        }
    )
    pulled = sum(
        np.sum(gradients[parameter] * delta)
        for parameter, delta in zip(parameters, deltas, strict=True)
    )
    np.testing.assert_allclose(pulled, weights @ pushed, rtol=1e-7, atol=1e-9)
    ends = []
    for step in (1e-5, -1e-5):
        for parameter, value, delta in zip(parameters, values, deltas, strict=True):
            parameter.value = value + step * delta
        ends.append(solved())
    np.testing.assert_allclose(
        pushed, (ends[0] - ends[1]) / 2e-5, rtol=1e-5, atol=1e-5 * np.abs(pushed).max()
    )
