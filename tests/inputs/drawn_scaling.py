"""Strategies made of those of the package: data in units of powers of two, and nearly singular matrices."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from lcp_plugin import LCP
from lcp_plugin.proofs.exact import exact_slack
from lcp_plugin.strategies import strictly_dominant_matrices

Solved = tuple[LCP, tuple[Fraction, ...]]


def _exponents(draw: st.DrawFn, n: int, largest: int) -> np.ndarray:
    drawn = draw(st.lists(st.integers(-largest, largest), min_size=n, max_size=n))
    return np.array(drawn, dtype=np.int64)


def _scaled(M: Any, row: np.ndarray, column: np.ndarray) -> Any:
    moved = np.ldexp(M.toarray() if sp.issparse(M) else M, row[:, None] + column)
    return sp.csr_array(moved) if sp.issparse(M) else moved


@st.composite
def scaled_matrices(
    draw: st.DrawFn, matrices: st.SearchStrategy[Any], row: int = 0, column: int = 0
) -> Any:
    """R M C with R and C of powers of two, exponents up to `row` and `column` in size."""
    M = draw(matrices)
    n = M.shape[0]
    return _scaled(M, _exponents(draw, n, row), _exponents(draw, n, column))


@st.composite
def scaled_solved(
    draw: st.DrawFn, solved: st.SearchStrategy[Solved], row: int, column: int = 0
) -> Solved:
    """Rows of (M, q) multiplied, components of z measured, in powers of two; the answer stays exact."""
    problem, z = draw(solved)
    units = _exponents(draw, problem.n, column)
    exact = tuple(value / Fraction(2) ** int(unit) for value, unit in zip(z, units, strict=True))
    return moved(problem, _exponents(draw, problem.n, row), units), exact


def moved(problem: LCP, row: np.ndarray, column: np.ndarray) -> LCP:
    """Return the problem with rows and columns times powers of two."""
    lower, upper = np.ldexp(problem.lower, -column), np.ldexp(problem.upper, -column)
    return LCP(_scaled(problem.M, row, column), np.ldexp(problem.q, row), lower=lower, upper=upper)


def nearly_singular(margin: float = 2.0**-20) -> st.SearchStrategy[np.ndarray]:
    """H₊-matrices of dominant rows whose diagonal entries exceed the sums of the others by a small margin."""

    def slimmed(M: np.ndarray) -> np.ndarray:
        others = abs(M).sum(axis=1) - M.diagonal()
        return M + np.diag((margin - 1.0) * (M.diagonal() - others))

    return strictly_dominant_matrices().map(slimmed)


def strict(solved: st.SearchStrategy[Solved]) -> st.SearchStrategy[Solved]:
    """The same problems with w = ±1 where z is at a bound and w was 0: no row is degenerate."""

    def without_degenerate_rows(drawn: Solved) -> Solved:
        problem, z = drawn
        at_lower = np.array(z, dtype=float) == problem.lower
        at_upper = np.array(z, dtype=float) == problem.upper
        idle = np.array(
            [value == 0 for value in exact_slack(problem, np.array(z, dtype=float))], dtype=bool
        )
        return problem.with_q(problem.q + idle * np.where(at_lower, 1.0, -1.0 * at_upper)), z

    return solved.map(without_degenerate_rows)


def skewed(matrices: st.SearchStrategy[np.ndarray]) -> st.SearchStrategy[np.ndarray]:
    """M + K with K = −Kᵀ: xᵀM x stays as it is."""
    return matrices.map(lambda M: M + np.triu(M, 1) - np.tril(M, -1))
