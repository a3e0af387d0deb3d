"""What all strategies share: checked sizes and shares, and the small strategies of numbers and arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import InvalidOption

LARGEST_ENTRY = 9
LARGEST_SIZE = 8

Sizes = int | st.SearchStrategy[int] | None
Numbers = st.SearchStrategy[Any]
Matrix = NDArray[np.float64]


def sizes(size: Sizes, smallest: int = 0) -> st.SearchStrategy[int]:
    """Return a strategy for numbers of rows, none below `smallest`, or raise InvalidOption."""
    if size is None:
        return st.integers(max(1, smallest), LARGEST_SIZE)
    need = f"size must be a whole number ≥ {smallest} or a strategy of such"
    if isinstance(size, st.SearchStrategy):
        return size.map(lambda n: whole_number(n, need, smallest))
    return st.just(whole_number(size, need, smallest))


def whole_number(value: Any, need: str, low: int) -> int:
    """Return the value as an int, or raise InvalidOption with what is needed where it is none from low on."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < low:
        raise InvalidOption(f"{need}, got {value!r}")
    return int(value)


def entries(density: float) -> Numbers:
    """Return integers up to 9 in absolute value of which the share `density` is nonzero."""
    if not isinstance(density, (int, float, np.integer, np.floating)) or not 0.0 <= density <= 1.0:
        raise InvalidOption(f"density must lie in [0, 1], got {density!r}")
    values = 2 * LARGEST_ENTRY
    if density * 1e6 < values:
        return st.just(0)
    zeros = max(1, round(values * (1.0 - density) / density))
    # 1, −1, 2, −2 … for 1, 2, 3, 4 …, and 0 for 0 and all below it: simple entries come first.
    return st.integers(1 - zeros, values).map(lambda k: 0 if k <= 0 else (k + 1) // 2 if k % 2 else -(k // 2))


POSITIVE = st.integers(1, LARGEST_ENTRY)
SIGNED = st.integers(-LARGEST_ENTRY, LARGEST_ENTRY)
ONE_FIRST = st.sampled_from([*range(1, LARGEST_ENTRY + 1), 0, *range(-1, -LARGEST_ENTRY - 1, -1)])
SIGNS = st.sampled_from([1, -1])


@lru_cache(maxsize=1000)
def rows(n: int, row: Numbers) -> st.SearchStrategy[list[Any]]:
    """Return a strategy for lists of n values.

    Up to 8 it always draws 8 and drops the last: shrinking can then lower n without a change of what follows.
    """
    return st.tuples(*[row] * max(n, LARGEST_SIZE)).map(lambda drawn: list(drawn[:n]))


def vectors(n: int, values: Numbers) -> st.SearchStrategy[FloatVector]:
    """Return a strategy for arrays of shape (n,)."""
    return rows(n, values).map(lambda drawn: np.array(drawn, dtype=np.float64))


def orders(n: int) -> st.SearchStrategy[NDArray[np.intp]]:
    """Return a strategy for permutations of 0 … n − 1 that shrinks to the identity."""
    return vectors(n, st.integers(0, LARGEST_SIZE - 1)).map(lambda keys: np.argsort(keys, kind="stable"))


@lru_cache(maxsize=1000)
def blocks(height: int, width: int, values: Numbers) -> st.SearchStrategy[Matrix]:
    """Return a strategy for arrays of shape (height, width)."""
    entries = st.tuples(*[values] * (height * width))
    return entries.map(lambda drawn: np.array(drawn, dtype=np.float64).reshape(height, width))


def skew_matrices(n: int, values: Numbers) -> st.SearchStrategy[Matrix]:
    """Return a strategy for K = −Kᵀ."""
    return blocks(n, n, values).map(lambda A: np.tril(A, -1).T - np.tril(A, -1))


def unit_lower(n: int, values: Numbers) -> st.SearchStrategy[Matrix]:
    """Return a strategy for lower triangular matrices with ones on the diagonal."""
    return blocks(n, n, values).map(lambda A: np.tril(A, -1) + np.eye(n))


def reordered(A: Matrix, order: NDArray[np.intp]) -> Matrix:
    """Return P A Pᵀ."""
    return A[np.ix_(order, order)]


def matrices(
    build: Callable[[st.DrawFn, int, Numbers], Matrix], size: Sizes, density: float, dense: bool, smallest: int = 0
) -> st.SearchStrategy[Any]:
    """Return a strategy for what `build` draws of a size and of numbers of that density, as arrays or CSR arrays."""
    return _drawn(build, sizes(size, smallest), entries(density), dense)


@st.composite
def _drawn(draw: st.DrawFn, build: Any, sizes: st.SearchStrategy[int], values: Numbers, dense: bool) -> Any:
    A = build(draw, draw(sizes), values)
    return A if dense else sp.csr_array(A)
