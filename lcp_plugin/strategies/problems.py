"""Strategies for linear complementarity problems: any, solved exactly, and without solution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import InvalidProblem
from ..core.lcp import LCP
from ..proofs.exact.rational import exact_slack
from ..proofs.no_solution.proof import Infeasibility
from .matrices import (
    LARGEST_ENTRY,
    POSITIVE,
    SIGNED,
    SIGNS,
    Sizes,
    blocks,
    h_plus_matrices,
    positive_definite_matrices,
    rows,
    sizes,
    vectors,
)

ExactPoint = tuple[Fraction, ...]
DISTANCES = st.sampled_from([*range(1, LARGEST_ENTRY + 1), *(math.inf,) * LARGEST_ENTRY])
INACTIVE, ACTIVE, DEGENERATE = range(3)
#: Whether a row is at its lower and at its upper bound, and the sign of the slack in this case.
BOUNDED = {
    INACTIVE: [(False, False, 0)],
    ACTIVE: [(True, False, 1), (False, True, -1), (True, True, 1), (True, True, -1)],
    DEGENERATE: [(True, False, 0), (False, True, 0), (True, True, 0)],
}


def lcps(
    matrices: st.SearchStrategy[Any] | None = None, *, bounds: bool = False
) -> st.SearchStrategy[LCP]:
    """Return a strategy for problems with any q: whether there is a solution depends on M.

    Parameters
    ----------
    matrices
        As in :func:`solved_lcps`.
    bounds : bool
        Draw other bounds than 0 and ∞, as in :func:`solved_lcps`.

    Returns
    -------
    strategy of LCP

    Raises
    ------
    InvalidOption
        If an option is out of its range.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(lcps(h_plus_matrices(1)), lambda problem: True, settings=quick).q
    array([0.])
    """
    chosen, row = default_matrices() if matrices is None else matrices, complementary_rows(bounds)

    @st.composite
    def problem(draw: st.DrawFn) -> LCP:
        M = draw(chosen)
        _, _, lower, upper = columns_of(draw(rows(M.shape[0], row)))
        return LCP(M, draw(vectors(M.shape[0], SIGNED)), lower=lower, upper=upper)

    return problem()


def default_matrices() -> st.SearchStrategy[Any]:
    """Return a strategy for matrices with which every problem has exactly one solution."""
    return h_plus_matrices() | positive_definite_matrices()


def solved_lcps(
    matrices: st.SearchStrategy[Any] | None = None,
    *,
    bounds: bool = False,
    huge_slacks: bool = False,
) -> st.SearchStrategy[tuple[LCP, ExactPoint]]:
    """Return a strategy for pairs (problem, z) such that z solves the problem exactly.

    Parameters
    ----------
    matrices : strategy of (n, n) matrices, optional
        Matrices, by default H₊ or symmetric positive definite, so that z is the only solution. Entries must be short
        enough for M z + q to be free of rounding: within a row, integers times powers of two not far apart.
    bounds : bool
        Draw one-sided bounds below or above, boxes, fixed and free rows. Otherwise lower = 0, upper = ∞.
    huge_slacks : bool
        Slacks are multiplied by powers of two up to 2²⁴ if q stays free of rounding: active rows then have a
        huge q that has no influence on z.

    Returns
    -------
    strategy of (LCP, tuple of Fraction)
        The solution has one exact number per row, which is also a float64: ``np.array(z, dtype=float)`` is exact.

    Raises
    ------
    InvalidOption
        If an option is out of its range.
    InvalidProblem
        While drawing, if q = w − M z is not free of rounding.

    Notes
    -----
    The answer comes first: z and w are drawn complementary, with inactive rows (z between its bounds, w = 0),
    active ones (z at a bound, w ≠ 0 of the right sign) and degenerate ones (z at a bound, w = 0).

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> problem, z = find(solved_lcps(), lambda drawn: True, settings=quick)
    >>> problem.M, problem.q, z
    (array([[1.]]), array([-1.]), (Fraction(1, 1),))
    """
    chosen, row = default_matrices() if matrices is None else matrices, complementary_rows(bounds)

    @st.composite
    def solved(draw: st.DrawFn) -> tuple[LCP, ExactPoint]:
        M = draw(chosen)
        z, slack, lower, upper = columns_of(draw(rows(M.shape[0], row)))
        w = slack * 2.0 ** draw(vectors(z.size, st.integers(0, 24))) if huge_slacks else slack
        try:
            q = exact_offset(M, z, w)
        except InvalidProblem:  # no space for huge slacks with this M
            q = exact_offset(M, z, slack)
        return LCP(M, q, lower=lower, upper=upper), fractions_of(z)

    return solved()


def infeasible_lcps(
    size: Sizes = None, *, monotone: bool = False, bounds: bool = False
) -> st.SearchStrategy[tuple[LCP, Infeasibility]]:
    """Return a strategy for pairs (problem, proof): no z within its bounds gives w the signs that it needs.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows, at least 1; 1 to 8 by default.
    monotone : bool
        Draw M that is symmetric positive semidefinite, singular by necessity; otherwise anything.
    bounds : bool
        Draw other bounds than 0 and ∞: −∞ and u, l and ∞, l and u, or none.

    Returns
    -------
    strategy of (LCP, Infeasibility)
        ``proof.exact_y`` is the Farkas vector in fractions, its largest entry 1 in size; ``proof.verify()`` is True.

    Raises
    ------
    InvalidOption
        If an option is out of its range; while drawing, if a drawn size is 0.

    Notes
    -----
    The proof comes first: y with the signs that the bounds require, then all rows except the pivot's. The pivot's row
    gives Mᵀy the signs that keep (Mᵀy)ᵀz bounded, and q makes the sum negative. For z ≥ 0: y ≥ 0, Mᵀy ≤ 0, qᵀy < 0.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> problem, proof = find(infeasible_lcps(2), lambda drawn: True, settings=quick)
    >>> proof.exact_y, proof.verify()
    ((Fraction(1, 1), Fraction(0, 1)), True)
    """
    drawn_size, row = sizes(size, 1), complementary_rows(bounds)

    @st.composite
    def infeasible(draw: st.DrawFn) -> tuple[LCP, Infeasibility]:
        n = draw(drawn_size)
        pivot = draw(st.integers(0, n - 1))
        _, _, lower, upper = columns_of(draw(rows(n, row)))
        if np.isfinite(lower[pivot]) and np.isfinite(upper[pivot]):  # a box needs no sign of w
            upper[pivot] = math.inf
        below, above = np.isinf(lower), np.isinf(upper)
        # y ≥ 0 if w ≥ 0 is needed, ≤ 0 if w ≤ 0 is needed; 0 in boxes, ±1 in the pivot's row.
        y = draw(vectors(n, st.integers(0, 3)))
        y[pivot] = 1.0
        y *= np.where(below & above, draw(vectors(n, SIGNS)), above * 1.0 - below)
        product = np.zeros(n)
        if not monotone:  # Mᵀy ≤ 0 if z can rise indefinitely, ≥ 0 if it can fall, = 0 if z is free
            drawn = draw(vectors(n, SIGNED))
            product = np.where(above, -abs(drawn), np.where(below, abs(drawn), drawn))
            product[below & above] = 0.0
        q, surplus = draw(vectors(n, SIGNED)), draw(POSITIVE)
        M = draw(blocks(n, n, SIGNED))
        M[pivot] = 0.0
        M[pivot] = y[pivot] * (product - y @ M)
        highest = float(np.where(product > 0, upper, lower)[product != 0] @ product[product != 0])
        q[pivot] = 0.0
        q[pivot] = y[pivot] * (-highest - y @ q - surplus)
        problem = LCP(M @ M.T if monotone else M, q, lower=lower, upper=upper)
        return problem, Infeasibility.of(problem, dict(enumerate(fractions_of(y))))

    return infeasible()


# --- Complementary rows ------------------------------------------------------------------------------------------


@st.composite
def complementary_rows(
    draw: st.DrawFn, bounds: bool = False, otherwise_free: bool = False
) -> tuple[float, float, float, float]:
    """Return a strategy for complementary z, w, lower, upper of a row: small integers, or bounds that are infinite.

    Rows that get no bounds have 0 and ∞, or none at all.
    """
    group, size = draw(st.sampled_from([INACTIVE, ACTIVE, DEGENERATE])), draw(POSITIVE)
    if bounds:
        z, (at_lower, at_upper, sign) = draw(SIGNED), draw(st.sampled_from(BOUNDED[group]))
        below, above = 0 if at_lower else draw(DISTANCES), 0 if at_upper else draw(DISTANCES)
        return z, sign * size, z - below, z + above
    if otherwise_free:
        return draw(SIGNED), 0, -math.inf, math.inf
    return size * (group == INACTIVE), size * (group == ACTIVE), 0, math.inf


def columns_of(rows: Sequence[Any]) -> NDArray[np.float64]:
    """Return z, w, lower and upper of rows, shape (4, n)."""
    return np.array(rows, dtype=np.float64).reshape(-1, 4).T.copy()


def exact_offset(matrix: Any, z: FloatVector, w: FloatVector) -> FloatVector:
    """Return q = w − M z, shape (n,); raise InvalidProblem if it is not exact in float64."""
    M = sp.csr_array(matrix)
    products = exact_slack(LCP(M, np.zeros(z.size)), z)
    exact = [Fraction(left) - product for left, product in zip(w.tolist(), products, strict=True)]
    wrong = next((i for i, value in enumerate(exact) if not is_double(value)), None)
    if wrong is not None:
        sizes = abs(M.data[M.indptr[wrong] : M.indptr[wrong + 1]])
        raise InvalidProblem(
            f"q = w − M z is not free of rounding in row {wrong} of M, whose entries lie between "
            f"{sizes.min(initial=np.inf):g} and {sizes.max(initial=0.0):g} in size; draw short entries of one size"
        )
    return np.array(exact, dtype=np.float64)


def is_double(exact: Fraction) -> bool:
    """Return whether a double equals the fraction."""
    try:
        return Fraction(float(exact)) == exact
    except OverflowError:
        return False


def fractions_of(values: Any) -> tuple[Fraction, ...]:
    """Return an array of doubles as exact numbers."""
    return tuple(Fraction(float(value)) for value in values)
