"""Bounds of rounding errors hold against rational arithmetic, and are zero where nothing was rounded."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_plugin.core.kernels.floats import TINY, UNIT
from lcp_plugin.core.rounding import (
    compensated_pair,
    compensated_product,
    gamma,
    lower_end,
    upper_end,
)

SUBNORMAL = 2.0**-1060
NUMBERS = st.one_of(
    st.integers(-9, 9).map(float),
    st.floats(-1.0, 1.0, allow_subnormal=True),
    st.sampled_from(
        [1e150, -1e150, 1e-150, -1e-150, SUBNORMAL, -SUBNORMAL, TINY, 1.0 + 2 * UNIT, 1e16, 3e-300]
    ),
    st.floats(-1e200, 1e200),
)


@st.composite
def products(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A matrix, a vector, an offset – half of the offsets cancel the rounded product."""
    n = draw(st.integers(1, 5))
    A = np.array(draw(st.lists(NUMBERS, min_size=n * n, max_size=n * n))).reshape(n, n)
    x = np.array(draw(st.lists(NUMBERS, min_size=n, max_size=n)))
    q = np.array(draw(st.lists(NUMBERS, min_size=n, max_size=n)))
    with np.errstate(all="ignore"):
        cancelling = -np.sum(A * x, axis=1)
    if draw(st.booleans()) and np.isfinite(cancelling).all():
        q = cancelling
    return A, x, q


def exact(A: np.ndarray, x: np.ndarray, q: np.ndarray) -> list[Fraction]:
    """A x + q in rational arithmetic."""
    return [
        sum((Fraction(a) * Fraction(b) for a, b in zip(row, x, strict=True)), Fraction(c))
        for row, c in zip(A.tolist(), q, strict=True)
    ]


@settings.get_profile("many")
@given(products())
def test_products_are_enclosed(data):
    """The exact M x + q lies within the radius of both forms, and an infinite radius means overflow is near."""
    A, x, q = data
    M = sp.csr_array(A)
    value, radius = compensated_product(M, x, q)
    high, low, small = compensated_pair(M, x, q)
    for i, truth in enumerate(exact(A, x, q)):
        decades = np.log10(max(np.abs(A[i]).max(), TINY)) + np.log10(max(np.abs(x).max(), TINY))
        assert np.isfinite(radius[i]) or decades > 300.0
        if np.isfinite(radius[i]):
            assert abs(truth - Fraction(value[i])) <= Fraction(radius[i])
            assert abs(truth - Fraction(high[i]) - Fraction(low[i])) <= Fraction(small[i])


@settings.get_profile("many")
@given(
    st.lists(st.integers(-(2**40), 2**40), min_size=16, max_size=16),
    st.lists(st.integers(-9, 9), min_size=4, max_size=4),
)
def test_integers_are_exact(entries, x):
    """Where no operation rounds, the radius is 0 and the value is the truth, ties included."""
    A = np.array(entries, dtype=float).reshape(4, 4)
    A[3] = [1.0, -1.0, 1.0, -1.0]
    x = np.array(x, dtype=float)
    value, radius = compensated_product(sp.csr_array(A), x, -(A @ x))
    assert not value.any()
    assert not radius.any()


def test_overflow_is_an_infinite_radius():
    """Overflow and a non-finite vector give an infinite radius, never a bound."""
    M = sp.csr_array(np.array([[1e200, 0.0], [1.7e308, 1.0], [1.0, 1.0]]))
    for x in (np.array([1e200, 1e-300]), np.array([np.inf, 1.0]), np.array([np.nan, 1.0])):
        value, radius = compensated_product(M, x)
        assert (radius[:2] == np.inf).all()
        assert lower_end(value, radius)[0] == -np.inf
        assert upper_end(value, radius)[0] == np.inf


@pytest.mark.parametrize("terms", [0, 1, 7, 10**6, 2**52])
def test_gamma_is_an_upper_bound(terms):
    """gamma(k) ≥ k u/(1 − k u) in rational arithmetic."""
    bound = gamma(terms)
    ku = terms * Fraction(UNIT)
    assert bound == np.inf or Fraction(bound) >= ku / (1 - ku)
