"""Marches whose bounds or matrix change from step to step: option prices, derivatives, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.interpolate import CubicSpline

from lcp_plugin import (
    LCP,
    FrictionalContact,
    InvalidOption,
    InvalidProblem,
    derivative,
    march,
    solve,
)

STRIKE, RATE = 40.0, 0.06
SPOTS = np.array([36.0, 38.0, 40.0, 42.0, 44.0])
# Longstaff, Schwartz 2001, doi:10.1093/rfs/14.1.113, Table 1: σ = .2, T = 1, 50 dates, finite differences
PUBLISHED = [4.478, 3.250, 2.314, 1.617, 1.110]


def black_scholes(x: Any, volatility: Any) -> sp.csr_array:
    """Return the negative generator in log prices x, with zero rows at both ends."""
    h = x[1] - x[0]
    variance = np.broadcast_to(volatility, x.shape) ** 2
    diffusion, drift = 0.5 * variance / h**2, (RATE - 0.5 * variance) / (2.0 * h)
    rows = np.stack([drift - diffusion, 2.0 * diffusion + RATE, -drift - diffusion])
    rows[:, [0, -1]] = 0.0
    return sp.diags_array([rows[0, 1:], rows[1], rows[2, :-1]], offsets=[-1, 0, 1], format="csr")


def binomial(spot: float, dates: int, each: int) -> float:
    """Return the value of a Bermudan put on a binomial tree with so many steps for each date."""
    steps = dates * each
    dt = 1.0 / steps
    up = np.exp(0.2 * np.sqrt(dt))
    p, discount = (np.exp(RATE * dt) - 1.0 / up) / (up - 1.0 / up), np.exp(-RATE * dt)
    value = np.maximum(STRIKE - spot * up ** (2.0 * np.arange(steps + 1) - steps), 0.0)
    for i in range(steps - 1, -1, -1):
        value = discount * (p * value[1:] + (1.0 - p) * value[:-1])
        if i % each == 0:
            value = np.maximum(value, STRIKE - spot * up ** (2.0 * np.arange(i + 1) - i))
    return float(value[0])


def test_bermudan_puts_have_their_published_values():
    """In one call, within 2e-3 of Longstaff and Schwartz, and within 1e-3 of a binomial tree with 50 dates."""
    x, dates, each = np.linspace(np.log(STRIKE) - 1.5, np.log(STRIKE) + 1.5, 401), 50, 20
    k, payoff = dates * each, np.maximum(STRIKE - np.exp(x), 0.0)
    A, dt = black_scholes(x, 0.2), 1.0 / (dates * each)
    M, C = sp.eye_array(x.size) + 0.5 * dt * A, 0.5 * dt * A - sp.eye_array(x.size)
    lower_at = np.full((k, x.size), -np.inf)
    lower_at[each - 1 :: each] = payoff
    done = march(LCP(M, np.zeros(x.size)), np.zeros((k, x.size)), C, lower_at=lower_at, z0=payoff)
    assert done.all_solved
    found = CubicSpline(x, done.z[-1])(np.log(SPOTS))
    np.testing.assert_allclose(found, PUBLISHED, rtol=0.0, atol=2e-3)
    trees = [binomial(spot, dates, 40) for spot in SPOTS]
    np.testing.assert_allclose(found, trees, rtol=0.0, atol=1e-3)


def local(x: Any, to_maturity: float) -> Any:
    """Return a local volatility, larger at low prices and early."""
    return 0.2 + 0.1 * np.exp(-((x - np.log(30.0)) ** 2) / 0.1) * (0.5 + to_maturity)


def moving(n: int = 6, k: int = 5) -> dict[str, Any]:
    """Return the arguments of a march with matrices and bounds of each step, some of which are active."""
    rng = np.random.default_rng(12)
    M_at = 0.2 * rng.normal(size=(k, n, n)) + 3.0 * np.eye(n)
    data = {"problem": LCP(M_at[0], np.zeros(n)), "M_at": M_at, "z0": rng.normal(size=n)}
    forcing, lower, upper = rng.normal(size=(3, k, n))
    return data | {"forcing": forcing, "lower_at": lower - 0.3, "upper_at": upper + 3.0}


@pytest.mark.parametrize("is_sparse", [False, True])
def test_changes_of_the_data_of_steps_are_those_of_differences(is_sparse):
    """Jvp of all data at once, and vjp along the same changes, within 1e-5; steps are those of solve."""
    data = moving()
    if is_sparse:
        data["M_at"] = [*map(sp.csr_array, data["M_at"])]
    names = ("lower_at", "upper_at", "M_at", "forcing", "z0")
    rng, moved = np.random.default_rng(3), {name: np.array(moving()[name]) for name in names}
    d = {name: rng.normal(size=value.shape) for name, value in moved.items()}
    done, z = march(**data), data["z0"]
    assert done.all_solved
    for step, at in enumerate(done.z):
        bounds = {name[:5]: data[name][step] for name in names[:2]}
        z = solve(LCP(data["M_at"][step], data["forcing"][step] - z, **bounds)).z
        np.testing.assert_allclose(at, z, rtol=1e-7, atol=1e-8)

    def shifted(step):
        now = {name: value + step * d[name] for name, value in moved.items()}
        return march(data["problem"], tolerance=1e-13, **now).z

    dz = (shifted(1e-6) - shifted(-1e-6)) / 2e-6
    found = derivative(done)
    changes = {f"d{name}": d[name] for name in names}
    np.testing.assert_allclose(found.jvp(**changes), dz, rtol=0.0, atol=1e-5)
    by_step = changes | {"dM_at": lambda step: d["M_at"][step]}
    np.testing.assert_allclose(found.jvp(**by_step, only_last=True), dz[-1], rtol=0.0, atol=1e-5)
    g = rng.normal(size=dz.shape)
    gradient = found.vjp(g)
    total = sum((by.toarray() * d["M_at"][k]).sum() for k, by in enumerate(gradient.M))
    total += sum((getattr(gradient, name) * d[name]).sum() for name in names if name != "M_at")
    assert total == pytest.approx((g * dz).sum(), abs=1e-5 * np.abs(g).sum())
    np.testing.assert_allclose(gradient.lower, gradient.lower_at.sum(axis=0))


def test_a_band_has_the_derivative_by_the_bounds_of_each_step():
    """Constant bounds given as lower_at agree with the march in one loop, and its gradients."""
    n, k = 40, 70
    M = sp.diags_array([[-1.0] * (n - 1), [3.0] * n, [-1.0] * (n - 1)], offsets=[-1, 0, 1])
    lower = np.where(np.arange(n) < 15, 0.5, -9.0)
    forcing = np.broadcast_to(np.sin(np.arange(n)), (k, n))
    plain = march(LCP(M, np.zeros(n), lower=lower), forcing)
    each = march(LCP(M, np.zeros(n)), forcing, lower_at=np.broadcast_to(lower, (k, n)), z0=plain.z0)
    np.testing.assert_array_equal(each.z, plain.z)
    one, other = (derivative(done).vjp(np.ones(n)) for done in (plain, each))
    np.testing.assert_allclose(one.lower_at, other.lower_at, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(one.M.toarray(), other.M.toarray(), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("has_upper", [False, True])
def test_moving_bounds_on_a_band_have_the_derivative_of_differences(has_upper):
    """Steps with bounds of their own run in the loop on the band, forwards and backwards."""
    n, k, rng = 30, 70, np.random.default_rng(5)
    M = sp.diags_array([[-1.0] * (n - 1), [3.0] * n, [-1.0] * (n - 1)], offsets=[-1, 0, 1])
    problem, forcing = LCP(M, np.zeros(n)), rng.normal(size=(k, n))
    bounds = {"lower_at": rng.normal(size=(k, n)) - 0.5}
    if has_upper:
        bounds["upper_at"] = bounds["lower_at"] + 1.0
    d = {name: rng.normal(size=(k, n)) for name in bounds}
    done = march(problem, forcing, **bounds)
    assert all("many steps in one loop" in result.stages[0].because for result in done)
    for step in (0, 33, 69):
        own = {name[:5]: values[step] for name, values in bounds.items()}
        alone = solve(LCP(M, done[step].certificate.problem.q, **own), tolerance=1e-12)
        np.testing.assert_allclose(done.z[step], alone.z, rtol=1e-9, atol=1e-9)

    def shifted(step):
        return march(
            problem, forcing, **{name: at + step * d[name] for name, at in bounds.items()}
        ).z

    dz, found = (shifted(1e-7) - shifted(-1e-7)) / 2e-7, derivative(done)
    assert found.band is not None
    np.testing.assert_allclose(found.jvp(**{f"d{name}": d[name] for name in d}), dz, atol=1e-6)
    gradient = found.vjp(np.ones((k, n)))
    total = sum((getattr(gradient, name) * d[name]).sum() for name in d)
    assert total == pytest.approx(dz.sum(), abs=1e-4)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"lower_at": np.zeros((4, 6))},
            "lower_at must have one entry per step, 5 .*step 4 has none",
        ),
        ({"upper_at": np.full((7, 6), 9.0)}, "upper_at must have .*got 7: step 5 does not exist"),
        ({"M_at": [np.eye(6)] * 4}, "M_at must have one entry per step.*step 4 has none"),
        ({"M_at": [np.eye(6)] * 4 + [np.eye(5)]}, r"M_at of step 4 must be .*shape \(6, 6\), got"),
        ({"M_at": 3.0}, r"M_at must be a sequence of 5 matrices.*\[M\] \* 5"),
        ({"M_at": np.eye(6)}, r"sequence of 5 matrices.*\[M\] \* 5"),
        ({"M_at": sp.eye_array(6)}, r"sequence of 5 matrices.*\[M\] \* 5"),
        ({"M_at": (np.eye(6) for _ in range(5))}, "sequence of 5 matrices, .* got generator"),
        ({"M_at": lambda step: np.eye(6) * (np.nan if step == 0 else 1.0)}, "M_at of step 0.*nan"),
        (
            {"lower_at": np.full((5, 6), 9.0)},
            r"step 0: bounds must satisfy lower ≤ upper.*lower_at\[0\]",
        ),
        ({"lower_at": np.where(np.arange(30).reshape(5, 6) == 20, np.nan, 0.0)}, "step 3: .*nan"),
        ({"lower_at": np.zeros(6)}, r"lower_at must be an array of shape \(5, 6\)"),
    ],
)
def test_data_of_a_step_that_do_not_fit_name_the_step(changed, message):
    """Wrong numbers of steps, NaN, crossed bounds, a matrix of another size."""
    data = moving() | {"upper_at": np.full((5, 6), 3.0)} | changed
    with pytest.raises(InvalidProblem, match=message):
        march(**data)


@pytest.mark.parametrize("convert", [np.asarray, sp.csr_array])
def test_a_function_that_uses_one_array_again_has_its_own_steps(convert):
    """An array that a callable overwrites is read in each step."""
    data = moving()
    buffer = np.zeros((6, 6))

    def matrix(step):
        buffer[:] = data["M_at"][step]
        return convert(buffer)

    same = march(**data | {"M_at": matrix})
    np.testing.assert_allclose(same.z, march(**data).z, rtol=1e-9, atol=1e-9)


def test_an_invalid_matrix_of_a_later_step_ends_the_march():
    """The steps before it are kept, and the error names the step."""
    done = march(**moving() | {"M_at": lambda step: np.eye(6) * (np.nan if step == 3 else 3.0)})
    assert len(done) == 3
    assert "M_at of step 3" in str(done.error)


def test_data_of_steps_exclude_those_of_all_steps():
    """Lower with lower_at, cones, and a wrong number of changes are refused."""
    data = moving()
    with pytest.raises(InvalidOption, match="lower and lower_at exclude each other"):
        march(**data, lower=0.0)
    contact = FrictionalContact(np.eye(3), [-1.0, 0.0, 0.0], 0.5)
    with pytest.raises(InvalidOption, match="has no M_at in a march"):
        march(contact, np.zeros((2, 3)), M_at=[np.eye(3)] * 2)
    with pytest.raises(InvalidProblem, match="dM_at must have one entry per step"):
        derivative(march(**data)).jvp(dM_at=[np.eye(6)])
    many = march(
        data["problem"],
        np.stack([data["forcing"]] * 2),
        M_at=data["M_at"],
        lower_at=data["lower_at"],
    )
    assert [len(one) for one in many] == [5, 5]


def test_bounds_of_a_step_that_cross_the_bounds_of_the_problem_name_both():
    """The problem's own bound has its own name."""
    problem = LCP(np.eye(2), [1.0, 1.0], lower=0.0, upper=1.0)
    with pytest.raises(InvalidProblem, match=r"step 0: .*lower_at\[0\] = 2.0 and upper\[0\] = 1.0"):
        march(problem, np.zeros((3, 2)), lower_at=np.full((3, 2), 2.0))
