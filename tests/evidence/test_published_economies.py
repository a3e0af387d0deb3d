"""Models of the literature stated in cvxpy, from their published figures and starting points."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from economies import OWNED, WANTED, by_goods, technique

from lcp_plugin import LCP, Status, complements, solve


def test_hansens_economy_has_prices_that_clear_all_markets() -> None:
    """From the published start: no profit, no excess demand, idle activities and free goods, and incomes spent."""
    A, owned, wanted = technique(), by_goods(OWNED), by_goods(WANTED)
    share = wanted / wanted.sum(axis=0)
    others, levels, incomes = cp.Variable(13), cp.Variable(26), cp.Variable(4)
    others.value, levels.value, incomes.value = np.ones(13), np.ones(26), np.ones(4)
    prices = cp.hstack([1.0, others])
    desired = np.flatnonzero(share.max(axis=1))
    spread = sp.csr_array(
        (np.ones(desired.size), (desired, np.arange(desired.size))), shape=(14, desired.size)
    )
    bought = spread @ ((share[desired] @ incomes) / prices[desired])
    left = A @ levels + owned.sum(axis=1) - bought
    floor = np.where(share.max(axis=1) > 0, 1e-5, 0.0)[1:]
    problem = cp.Problem(
        cp.Minimize(0),
        [
            complements(others >= floor, left[1:] >= 0),
            complements(levels >= 0, -A.T @ prices >= 0),
            incomes == owned.T @ prices,
        ],
    )
    problem.solve(method="LCP", tolerance=1e-12)
    assert problem.status == "optimal"
    p, y, i = np.append(1.0, others.value), levels.value, incomes.value
    surplus = (
        A @ y
        + owned.sum(axis=1)
        - np.divide(share @ i, p, out=np.zeros(14), where=share.max(axis=1) > 0)
    )
    assert abs(surplus[0]) < 1e-6  # by Walras' law: nobody stated it
    assert surplus.min() > -1e-6
    assert (A.T @ p).max() < 1e-8
    assert abs(surplus @ p) < 1e-6
    assert abs(y @ (A.T @ p)) < 1e-8


def test_the_elastic_transport_problem_returns_to_fixed_demands_at_its_own_prices() -> None:
    """Dantzig's transport: at the prices of fixed demands elastic buyers want the same amounts."""
    capacity, demand = np.array([350.0, 600.0]), np.array([325.0, 300.0, 275.0])
    cost = 0.09 * np.array([[2.5, 1.7, 1.8], [2.5, 1.8, 1.4]])
    flow, at_plant, at_market = cp.Variable((2, 3)), cp.Variable(2), cp.Variable(3)
    profit = (
        cp.reshape(at_plant, (2, 1), order="C") + cost - cp.reshape(at_market, (1, 3), order="C")
    )
    plants = [
        complements(flow >= 0, profit >= 0),
        complements(at_plant >= 0, capacity - cp.sum(flow, axis=1) >= 0),
    ]
    cp.Problem(
        cp.Minimize(0), [*plants, complements(at_market >= 0, cp.sum(flow, axis=0) - demand >= 0)]
    ).solve(method="LCP")
    # Dantzig's dual prices
    np.testing.assert_allclose(at_market.value, [0.225, 0.153, 0.126], atol=1e-9)
    assert np.sum(cost * flow.value) == pytest.approx(153.675)  # and his optimum
    usual, elasticity = at_market.value, (1.5, 1.2, 2.0)
    wanted = cp.hstack(
        [demand[j] * (usual[j] / at_market[j]) ** e for j, e in enumerate(elasticity)]
    )
    at_market.value = np.ones(3)
    problem = cp.Problem(
        cp.Minimize(0), [*plants, complements(at_market >= 0, cp.sum(flow, axis=0) - wanted >= 0)]
    )
    problem.solve(method="LCP", tolerance=1e-12)
    assert problem.status == "optimal"
    np.testing.assert_allclose(at_market.value, usual, rtol=1e-8)
    np.testing.assert_allclose(flow.value.sum(axis=0), demand, rtol=1e-6)


def test_a_bearing_whose_oil_thickens_under_pressure() -> None:
    """Viscosity e^(α p): the reduced pressure (1 − e^(−α p))/α solves the linear bearing, cavitation included."""
    n, alpha, eccentricity = 400, 0.5, 0.6
    x = np.linspace(0, 2 * np.pi, n + 2)
    film = (1 + eccentricity * np.cos(x[:-1] + np.pi / (n + 1))) ** 3  # h³ between the nodes
    A = (
        sp.diags_array([-film[1:-1], film[:-1] + film[1:], -film[1:-1]], offsets=[-1, 0, 1])
        / x[1] ** 2
    )
    load = -eccentricity * np.sin(x[1:-1])
    linear = solve(LCP(A, load), tolerance=1e-12)
    assert linear.status is Status.SOLVED
    assert alpha * linear.z.max() < 1
    p = cp.Variable(n)
    pair = complements(p >= 0, A @ ((1 - cp.exp(-alpha * p)) / alpha) + load >= 0)
    problem = cp.Problem(cp.Minimize(0), [pair])
    p.value = np.zeros(n)
    # Rounding errors of F are 1e-12 of the reference: no tolerance below them can be met.
    problem.solve(method="LCP", tolerance=1e-10)
    assert problem.status == "optimal"
    np.testing.assert_allclose(p.value, -np.log1p(-alpha * linear.z) / alpha, atol=1e-10)
    assert 0.2 < np.mean(p.value == 0.0) < 0.7  # cavitation
