"""Unknowns that other solutions change: named by explain() and by derivatives of results and of models."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import LCP, complements, derivative, solve

E = np.eye(2)
#: M, q, lower, and the unknowns that the data do not determine, by hand.
CASES: dict[str, tuple[Any, Any, Any, list[int]]] = {
    "an interval of prices": ([[1, 0, -1], [0, 1, 1], [1, -1, 0]], [10, -5, 0], 0, [2]),
    "shares of a load": ([[1, 1, 0], [1, 1, 0], [0, 0, 1]], [-2, -2, -1], 0, [0, 1]),
    "no data": (np.zeros((2, 2)), [0, 1], 0, [0]),
    "a unique corner": (E, [0, 0], 0, []),
    "a unique corner of a singular M": ([[1, 1], [1, 1]], [0, 0], 0, []),
    "a skew matrix": ([[0, 1], [-1, 0]], [0, 0], 0, [1]),
    "a free unknown without a row": ([[0, 0], [0, 1]], [0, -1], -np.inf, [0]),
    "a corner beside it": ([[0, 0, 0], [0, 4, 2], [0, 2, 1]], [0, 0, 0], 0, [0]),
    "a regular M": ([[2, 1], [1, 2]], [-5, 1], 0, []),
}


@pytest.mark.parametrize("name", CASES)
def test_unknowns_that_are_not_determined_are_named(name):
    """The names in explain(), and the mask of the derivative, are the unknowns that differ between solutions."""
    M, q, lower, expected = CASES[name]
    names = [f"unknown {k}" for k in range(len(q))]
    result = solve(LCP(np.array(M, dtype=float), q, lower=lower, names=names)).require_solved()
    text = ", ".join(names[k] for k in expected)
    assert ("several solutions" in result.explain()) == bool(expected)
    assert not expected or f"the data do not determine {text};" in result.explain() + ";"
    found = derivative(result)
    assert np.flatnonzero(~found.determined).tolist() == expected
    assert (f"other solutions differ in {text}" in found.advice) == bool(expected)
    assert not (expected and found.is_unique)


def test_a_price_that_is_not_unique_is_named_by_its_model():
    """Supply from 10, demand from 5, no trade: each price in [5, 10] is one; with trade it is unique."""
    s, y, p = (cp.Variable(name=name) for name in ("supply", "demand", "price"))
    c, cost = cp.Parameter(value=5.0, name="c"), cp.Parameter(value=10.0)
    pairs = [
        complements(s >= 0, cost + s - p >= 0),
        complements(y >= 0, p - c + y >= 0),
        complements(p >= 0, s - y >= 0),
    ]
    model = cp.Problem(cp.Minimize(0), pairs)
    for value, is_unique in ((10.0, False), (1.0, True)):
        cost.value = value
        model.solve(method="LCP")
        found = derivative(model)
        assert found.is_unique == is_unique
        assert ("differ in price" in found.advice) != is_unique
        assert ("do not determine price" in model.solver_stats.extra_stats.explain()) != is_unique
    assert str(found).startswith("ModelDerivative(3 variables by ")
