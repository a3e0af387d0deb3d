"""Marches of nonlinear problems: B ẋ + F(x, t), complementary to bounds, and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, InvalidProblem, NonlinearProblem, derivative, march

N = 12
LINE = (N + 1) ** 2 * sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(N, N))
X = np.arange(1, N + 1) / (N + 1)
MASS = sp.diags_array(1.0 + X)


def reacting(t):
    """F of a rod that reacts and is heated in turns."""
    return lambda u: LINE @ u + u**3 + np.exp(u) - 20.0 * np.sin(6.0 * t) * X


def reacting_slopes(u):
    return LINE + sp.diags_array(3.0 * u**2 + np.exp(u))


def implicit_euler(k, lower=-np.inf):
    """The march of the rod from 0 to 1 in k steps."""
    dt = 1.0 / k

    def step(number):
        F = reacting((number + 1) * dt)
        return NonlinearProblem(
            lambda u: MASS @ u + dt * F(u),
            lambda u: sp.csr_array(MASS + dt * reacting_slopes(u)),
            np.full(N, lower),
        )

    return march([*map(step, range(k))], np.zeros((k, N)), -MASS, tolerance=1e-12)


def test_a_march_without_active_bounds_converges_to_the_differential_equation():
    """Against scipy's Radau, implicit Euler is of order 1, and its extrapolation of order 2."""
    exact = solve_ivp(
        lambda t, u: -reacting(t)(u) / MASS.diagonal(),
        *((0.0, 1.0), np.zeros(N), "Radau"), rtol=1e-10, atol=1e-12,
    ).y[:, -1]  # fmt: skip
    ends = [implicit_euler(k).require_solved().z[-1] for k in (40, 80)]
    errors = [np.abs(end - exact).max() for end in ends]
    assert errors[0] < 0.05 * np.abs(exact).max()
    assert 1.9 < errors[0] / errors[1] < 2.1
    assert np.abs(2.0 * ends[1] - ends[0] - exact).max() < 0.04 * errors[1]


def test_each_step_over_an_obstacle_solves_its_own_complementarity_problem():
    """The residual of every step, from the formulas: u − mid(lower, u − F(u)) is 0 up to the tolerance."""
    done, before = implicit_euler(50, lower=-0.2), np.zeros(N)
    touching = 0
    for k, u in enumerate(done.z):
        w = MASS @ (u - before) + reacting((k + 1) / 50)(u) / 50
        assert np.abs(u - np.maximum(u - w, -0.2)).max() < 1e-10
        touching += np.sum(u == -0.2)
        before = u
    assert done.all_solved
    assert 0 < touching < done.z.size


@pytest.mark.parametrize("h", [0.5, 0.01])
def test_a_decay_above_a_floor_is_the_scalar_recursion(h):
    """ẋ = −x³ for x ≥ 0.6: each step is a scalar root or the floor; as h → 0 it is max(0.6, (1 + 2t)^(−1/2))."""
    k = round(2.0 / h)
    done = march(
        NonlinearProblem(lambda x: x + h * x**3, lower=0.6), np.zeros((k, 1)), z0=[1.0], keep=1
    )
    x = 1.0
    for step in done.require_solved():
        x = max(brentq(lambda y, x=x: y + h * y**3 - x, 0.0, 1.0, xtol=1e-14), 0.6)
        assert step.x[0] == pytest.approx(x, abs=1e-9)
    times = h * np.arange(1, k + 1)
    exact = np.maximum((1.0 + 2.0 * times) ** -0.5, 0.6)
    assert np.abs(done.z[:, 0] - exact).max() < h
    assert done[-1].w[0] == pytest.approx(h * 0.6**3, rel=1e-9)


def diode(v):
    """Current of a diode in mA at v volts."""
    return 1e-9 * np.expm1(v / 0.026)


def test_a_clipper_of_diodes_follows_its_circuit():
    """A resistor, a capacitor, a diode, and a source that cannot push below 0 V, against scipy's Radau."""
    k, dt = 200, 2.0 / 200  # ms; 1 kΩ, 0.3 µF

    def source(t):
        return 3.0 * np.sin(2.0 * np.pi * t)

    F = NonlinearProblem(lambda v: 0.3 * v + dt * (v + diode(v)), lower=[-np.inf])
    forcing = -dt * source(dt * np.arange(1, k + 1))[:, np.newaxis]
    free = march(F, forcing, -0.3, z0=[0.0]).require_solved()
    exact = solve_ivp(
        lambda t, v: (source(t) - v - diode(v)) / 0.3,
        *((0.0, 2.0), [0.0], "Radau", dt * np.arange(1, k + 1)), rtol=1e-9, atol=1e-10,
    ).y[0]  # fmt: skip
    assert np.abs(free.z[:, 0] - exact).max() < 0.05
    held = march(F.with_data(lower=0.0), forcing, -0.3, z0=[0.0]).require_solved()
    assert held.z.min() == 0.0
    assert held.z.max() == pytest.approx(free.z.max(), abs=0.01)
    w = np.array([one.w[0] for one in held])
    assert (w[held.z[:, 0] == 0.0] > 0.0).sum() > k / 4


def linear(seed=0):
    """An LCP with its march, and the same M as a function F."""
    rng = np.random.default_rng(seed)
    M = sp.csr_array(sp.eye_array(N) + LINE / 400.0 + sp.diags_array(0.1 * rng.random(N)))
    data = {"forcing": rng.normal(size=(6, N)), "propagator": -sp.eye_array(N) - 0.1 * LINE / 400.0}
    data |= {"z0": rng.normal(size=N), "tolerance": 1e-12}
    lower_at = -0.2 - 0.1 * rng.random((6, N))
    problems = (
        LCP(M, np.zeros(N), upper=0.4),
        NonlinearProblem(lambda z: M @ z, lambda z: M, np.zeros(N), 0.4),
    )
    each = [[one.with_data(lower=lower) for lower in lower_at] for one in problems]
    return each, lower_at, data


def test_an_affine_function_marches_as_its_matrix():
    """Solutions, jvp and vjp of M z + q as a function equal the ones of the LCP."""
    problems, lower_at, data = linear()
    one, other = (march(each, **data) for each in problems)
    np.testing.assert_allclose(other.z, one.z, rtol=0, atol=1e-9)
    assert 0 < np.sum(one.z == lower_at) < one.z.size
    rng = np.random.default_rng(1)
    change = {"dforcing": rng.normal(size=(6, N)), "dz0": rng.normal(size=N), "dlower": 0.3}
    change |= {"dM": sp.eye_array(N), "dpropagator": rng.normal(size=(N, N))}
    ahead = [derivative(done).jvp(**change) for done in (one, other)]
    np.testing.assert_allclose(ahead[1], ahead[0], rtol=0, atol=1e-8)
    g = rng.normal(size=(6, N))
    back = [derivative(done).vjp(g) for done in (one, other)]
    for name in ("z0", "lower", "upper", "forcing", "lower_at", "upper_at"):
        np.testing.assert_allclose(getattr(back[1], name), getattr(back[0], name), atol=1e-8)
    np.testing.assert_allclose(
        back[1].propagator.toarray(), back[0].propagator.toarray(), atol=1e-8
    )
    assert back[1].M.nnz == 0


def test_the_derivative_of_a_nonlinear_march_is_its_difference():
    """The change by z0 and forcing equals central differences of the march; `vjp` is its transpose."""
    F = NonlinearProblem(
        lambda x: x + 0.2 * np.sinh(x), lambda x: np.diag(1.0 + 0.2 * np.cosh(x)), np.full(2, -0.3)
    )
    forcing, z0, rng = np.array([[-0.2, 0.5]] * 5), np.array([0.8, 0.5]), np.random.default_rng(2)
    C = np.array([[-0.9, -0.1], [0.2, -0.8]])
    dz0, df = rng.normal(size=2), rng.normal(size=(5, 2))

    def moved(h):
        return march(F, forcing + h * df, C, z0=z0 + h * dz0, tolerance=1e-14)

    found = derivative(moved(0.0))
    expected = (moved(1e-5).z - moved(-1e-5).z) / 2e-5
    assert np.any(moved(0.0).z == -0.3)
    change = found.jvp(dz0=dz0, dforcing=df)
    np.testing.assert_allclose(change, expected, rtol=0, atol=1e-7)
    g = rng.normal(size=(5, 2))
    gradient = found.vjp(g)
    assert np.sum(g * change) == pytest.approx(gradient.z0 @ dz0 + np.sum(gradient.forcing * df))


def test_a_function_for_any_number_of_unknowns_has_that_of_the_forcing():
    """One function, and one per step, for as many unknowns as forcing has columns."""
    decay, faster = NonlinearProblem(lambda x: x + x**3), NonlinearProblem(lambda x: x + 2 * x**3)
    done = march(decay, np.zeros((2, 3)), z0=[1.0, 2.0, 0.0])
    np.testing.assert_allclose(done.z[0] + done.z[0] ** 3, [1.0, 2.0, 0.0], atol=1e-8)
    each = march([decay, faster], np.zeros((2, 3)), z0=[1.0, 2.0, 0.0], check_jacobian=False)
    np.testing.assert_allclose(each.z[1] + 2.0 * each.z[1] ** 3, done.z[0], atol=1e-8)


def test_a_function_that_loses_its_domain_ends_a_march():
    """The steps before it are kept, and `error` names the row; in the first step the error is raised."""

    def at(step):
        return NonlinearProblem(lambda x: x + (np.nan if step == 2 else 0.0), lower=[0.0])

    done = march([*map(at, range(4))], np.zeros((4, 1)), z0=[1.0])
    assert len(done) == 2
    assert "F must be finite" in str(done.error)
    with pytest.raises(InvalidProblem, match="F must be finite"):
        march(at(2), np.zeros((4, 1)))


@refusals(r"""
march(F, [[0.0]], F_at=lambda step: F) → InvalidOption: march has no option 'F_at'
march([F, np.exp], [[0.0], [0.0]])
    → InvalidProblem: problem\[1\] must be a NonlinearProblem, n = 1, got ufunc
march(F, [[0.0, 1.0], [2.0, 3.0]], z0=[0.0]) → InvalidProblem: z0 must be
march(F, 0.0) → InvalidProblem: forcing must be a finite array of shape \(k, n\)
march(F, [[0.0]], x0=[1.0]) → InvalidOption: march has no option 'x0'
march(F, [[0.0]], search="best") → InvalidOption: search must be "monotone", "nonmonotone" or None
""")
def test_what_a_nonlinear_march_refuses(call, words):
    """Data of other classes, wrong shapes and wrong options raise errors before the first step."""
    assert_refused(call, words, {"F": NonlinearProblem(lambda x: x)})
