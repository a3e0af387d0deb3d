"""Marches whose bounds or matrix change from step to step: option prices, derivatives, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.interpolate import CubicSpline

from lcp_plugin import LCP, InvalidProblem, derivative, march, solve
from lcp_plugin.problems.march import March

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
    between = LCP(M, np.zeros(x.size), lower=-np.inf)
    date = between.with_data(lower=payoff)
    steps = [*[between] * (each - 1), date] * dates
    done = march(steps, np.zeros((k, x.size)), C, z0=payoff)
    assert "many steps in one loop" in done[-1].stages[0].because
    assert done.all_solved
    found = CubicSpline(x, done.z[-1])(np.log(SPOTS))
    np.testing.assert_allclose(found, PUBLISHED, rtol=0.0, atol=2e-3)
    trees = [binomial(spot, dates, 40) for spot in SPOTS]
    np.testing.assert_allclose(found, trees, rtol=0.0, atol=1e-3)


def local(x: Any, to_maturity: float) -> Any:
    """Return a local volatility, larger at low prices and early."""
    return 0.2 + 0.1 * np.exp(-((x - np.log(30.0)) ** 2) / 0.1) * (0.5 + to_maturity)


def moving(n: int = 6, k: int = 5) -> dict[str, Any]:
    """Return M and bounds of each step, some of which are active, forcing and state before the first step."""
    rng = np.random.default_rng(12)
    data = {"M_at": 0.2 * rng.normal(size=(k, n, n)) + 3.0 * np.eye(n), "z0": rng.normal(size=n)}
    forcing, lower, upper = rng.normal(size=(3, k, n))
    return data | {"forcing": forcing, "lower_at": lower - 0.3, "upper_at": upper + 3.0}


def marched(data: dict[str, Any], convert: Any = np.asarray, **options: Any) -> March:
    """Return the march of the data by steps."""
    each = zip(*(data[name] for name in ("M_at", "lower_at", "upper_at")), strict=True)
    problems = [LCP(convert(M), np.zeros(len(M)), lower=low, upper=high) for M, low, high in each]
    return march(problems, data["forcing"], z0=data["z0"], **options)


@pytest.mark.parametrize("convert", [np.asarray, sp.csr_array])
def test_changes_of_the_data_of_steps_are_those_of_differences(convert):
    """Jvp of all data at once, and vjp along the same changes, within 1e-5; steps are those of solve."""
    data, rng = moving(), np.random.default_rng(3)
    d = {name: rng.normal(size=value.shape) for name, value in data.items()}
    done, z = marched(data, convert), data["z0"]
    assert done.all_solved
    for step, at in enumerate(done.z):
        bounds = {name: data[f"{name}_at"][step] for name in ("lower", "upper")}
        z = solve(LCP(data["M_at"][step], data["forcing"][step] - z, **bounds)).z
        np.testing.assert_allclose(at, z, rtol=1e-7, atol=1e-8)

    def shifted(step):
        now = {name: value + step * d[name] for name, value in data.items()}
        return marched(now, convert, tolerance=1e-13).z

    dz = (shifted(1e-6) - shifted(-1e-6)) / 2e-6
    found = derivative(done)
    changes = {f"d{name.removesuffix('_at')}": d[name] for name in data}
    np.testing.assert_allclose(found.jvp(**changes), dz, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(found.jvp(**changes, only_last=True), dz[-1], rtol=0.0, atol=1e-5)
    g = rng.normal(size=dz.shape)
    gradient = found.vjp(g)
    total = sum((by.toarray() * d["M_at"][k]).sum() for k, by in enumerate(gradient.M))
    total += sum((getattr(gradient, name) * d[name]).sum() for name in data if name != "M_at")
    assert total == pytest.approx((g * dz).sum(), abs=1e-5 * np.abs(g).sum())
    np.testing.assert_allclose(gradient.lower, gradient.lower_at.sum(axis=0))
    with pytest.raises(InvalidProblem, match="dM must have one entry per step"):
        found.jvp(dM=[np.eye(6)])


def test_a_band_has_the_derivative_by_the_bounds_of_each_step():
    """Constant bounds of a problem per step agree with the march of one problem, and its gradients."""
    n, k = 40, 70
    M = sp.diags_array([[-1.0] * (n - 1), [3.0] * n, [-1.0] * (n - 1)], offsets=[-1, 0, 1])
    lower = np.where(np.arange(n) < 15, 0.5, -9.0)
    forcing = np.broadcast_to(np.sin(np.arange(n)), (k, n))
    plain = march(LCP(M, np.zeros(n), lower=lower), forcing)
    each = march([plain.problem.with_data(lower=lower) for _ in range(k)], forcing)
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
    bounds = {"lower": rng.normal(size=(k, n)) - 0.5}
    if has_upper:
        bounds["upper"] = bounds["lower"] + 1.0
    d = {name: rng.normal(size=(k, n)) for name in bounds}

    def shifted(step):
        now = [at + step * d[name] for name, at in bounds.items()]
        problems = [
            problem.with_data(**dict(zip(d, rows, strict=True))) for rows in zip(*now, strict=True)
        ]
        return march(problems, forcing, z0=np.zeros(n))

    done = shifted(0.0)
    assert all("many steps in one loop" in result.stages[0].because for result in done)
    for step in (0, 33, 69):
        own = {name: values[step] for name, values in bounds.items()}
        alone = solve(LCP(M, done[step].certificate.problem.q, **own), tolerance=1e-12)
        np.testing.assert_allclose(done.z[step], alone.z, rtol=1e-9, atol=1e-9)

    dz, found = (shifted(1e-7).z - shifted(-1e-7).z) / 2e-7, derivative(done)
    assert found.band is not None
    np.testing.assert_allclose(found.jvp(**{f"d{name}": d[name] for name in d}), dz, atol=1e-6)
    gradient = found.vjp(np.ones((k, n)))
    total = sum((getattr(gradient, f"{name}_at") * d[name]).sum() for name in d)
    assert total == pytest.approx(dz.sum(), abs=1e-4)
