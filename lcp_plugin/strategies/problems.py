"""Strategies for linear complementarity problems: any, solved exactly, and without solution."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from ..core.checks import FloatVector
from ..core.errors import InvalidProblem
from ..core.lcp import LCP
from ..proofs.no_solution.refutation import Infeasibility
from .definite import positive_definite_matrices
from .dominant import h_plus_matrices
from .options import (
    POSITIVE,
    SIGNED,
    SIGNS,
    Matrix,
    Numbers,
    Options,
    Sizes,
    by_share,
    checked_options,
    checked_scale,
    checked_share,
    drawn_number,
    drawn_units,
    in_units,
    integer_vectors,
    square,
    vectors,
)
from .rows import RowKinds, checked_kinds, drawn_rows, exact_offset, fractions_of, row_units

Answer = tuple[Fraction, ...]


def lcps(
    matrices: st.SearchStrategy[Any] | None = None,
    *,
    active: float | None = None,
    degenerate: float | None = None,
    bounds: float = False,
    row_scale: int = 0,
    column_scale: int = 0,
) -> st.SearchStrategy[LCP]:
    """Return a strategy for problems, with any q or with an answer of the kind asked for.

    Parameters
    ----------
    matrices, row_scale, column_scale
        As in :func:`solved_lcps`.
    active, degenerate : float, optional
        As in :func:`solved_lcps`, one that is left out being 0. Where both are, q is anything, and whether there is
        a solution depends on M.
    bounds : bool or float
        Share of rows with other bounds than 0 and ∞, as in :func:`solved_lcps`.

    Returns
    -------
    strategy of LCP

    Raises
    ------
    InvalidOption
        Where an option is out of its range.
    InvalidProblem
        While drawing, as in :func:`solved_lcps`.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(lcps(h_plus_matrices(1)), lambda problem: True, settings=quick).q
    array([0.])
    >>> problem = find(lcps(h_plus_matrices(2), active=1), lambda problem: True, settings=quick)
    >>> problem.M, problem.q
    (array([[1., 0.],
           [0., 1.]]), array([1., 1.]))
    """
    is_any = active is None and degenerate is None
    kinds = checked_kinds(*((1 / 3, 1 / 3) if is_any else (active or 0.0, degenerate or 0.0)), bounds)
    return _without_answer(_problems(matrices, kinds, row_scale, column_scale, None if is_any else 0))


@st.composite
def _without_answer(draw: st.DrawFn, solved: st.SearchStrategy[tuple[LCP, Answer]]) -> LCP:  # unlike `map`, printed
    return draw(solved)[0]


def solved_lcps(
    matrices: st.SearchStrategy[Any] | None = None,
    *,
    active: float = 1 / 3,
    degenerate: float = 1 / 3,
    bounds: float = False,
    row_scale: int = 0,
    column_scale: int = 0,
    slack_scale: int = 0,
) -> st.SearchStrategy[tuple[LCP, Answer]]:
    """Return a strategy for pairs (problem, z) where z solves the problem exactly.

    Parameters
    ----------
    matrices : strategy of (n, n) matrices, optional
        By default H₊ or symmetric positive definite ones, so that z is the only solution. Entries must be short
        enough for M z + q to be free of rounding: within a row, integers times powers of two not far apart.
    active, degenerate : float
        Shares of rows with z at a bound and w ≠ 0, and with z at a bound and w = 0, roughly, each in [0, 1]; in the
        others z lies between its bounds.
    bounds : bool or float
        True draws bounds too: one-sided below or above, boxed, fixed and free rows. Otherwise lower = 0, upper = ∞. A
        number is the share of rows that get such bounds.
    row_scale, column_scale : int
        Rows of (M, q) are multiplied, and components of z are measured, in powers of two with exponents from −scale
        to scale, 0 to 400. Prefer these to scaled `matrices`: they keep the answer exact whatever the exponents.
    slack_scale : int
        Slacks are multiplied by powers of two with exponents from 0 to scale, as far as q stays free of rounding:
        active rows then have a q that is huge, but says nothing.

    Returns
    -------
    strategy of (LCP, tuple of Fraction)
        The answer has one exact number a row; each is a double as well: ``np.array(z, dtype=float)`` is exact.

    Raises
    ------
    InvalidOption
        Where an option is out of its range.
    InvalidProblem
        While drawing, where q = w − M z is not free of rounding, or scales leave the range of doubles.

    Notes
    -----
    The answer comes first: z and w are drawn complementary, with inactive rows (z between its bounds, w = 0),
    active ones (z at a bound, w ≠ 0 of the right sign) and degenerate ones (z at a bound, w = 0).

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> problem, z = find(solved_lcps(), lambda drawn: True, settings=quick)
    >>> problem, z
    (LCP([[1.0]], [-1.0]), (Fraction(1, 1),))
    """
    kinds = checked_kinds(active, degenerate, bounds)
    return _problems(matrices, kinds, row_scale, column_scale, checked_scale("slack_scale", slack_scale))


def _problems(
    matrices: st.SearchStrategy[Any] | None, kinds: RowKinds, row_scale: int, column_scale: int, slack_scale: int | None
) -> st.SearchStrategy[tuple[LCP, Answer]]:
    scales = checked_scale("row_scale", row_scale), checked_scale("column_scale", column_scale)
    chosen = h_plus_matrices() | positive_definite_matrices() if matrices is None else matrices
    return _drawn(chosen, kinds, *scales, slack_scale)


@st.composite
def _drawn(
    draw: st.DrawFn, matrices: st.SearchStrategy[Any], kinds: RowKinds,
    row_scale: int, column_scale: int, slack_scale: int | None,
) -> tuple[LCP, Answer]:
    """Return a problem and the z that solves it; without a scale of the slacks q is anything, and z means nothing."""
    given = draw(matrices)
    n = given.shape[0]
    z, slack, lower, upper = drawn_rows(draw, n, kinds)
    if slack_scale is None:
        q = row_units(given) * draw(vectors(n, SIGNED))
    else:
        q = exact_offset(given, z, slack, draw(integer_vectors(n, Numbers(0, slack_scale))))
    row, column = drawn_units(draw, n, row_scale, column_scale)
    return _in_units(given, q, lower, upper, row, column), fractions_of(np.ldexp(z, -column))


def _in_units(given: Any, q: FloatVector, lower: FloatVector, upper: FloatVector, row: Any, column: Any) -> LCP:
    """Return the problem with rows multiplied by 2^row and unknowns measured in 2^−column, as dense as given."""
    M = _array(given)
    with np.errstate(over="ignore"):
        moved, offset = in_units(M, row, column, dense=True), np.ldexp(q, row)
        back = in_units(moved, -row, -column, dense=True)
        is_exact = np.array_equal(back, M) and np.array_equal(np.ldexp(offset, -row), q)
    if not is_exact:
        raise InvalidProblem(
            "row_scale and column_scale move an entry of M or q beyond the range of doubles, given entries up to "
            f"{abs(M).max(initial=0.0):g} in size; draw matrices or use options with smaller scales"
        )
    form = sp.csr_array(moved) if sp.issparse(given) else moved
    return LCP(form, offset, lower=np.ldexp(lower, -column), upper=np.ldexp(upper, -column))


def _array(given: Any) -> Matrix:
    matrix: Matrix = given.toarray() if sp.issparse(given) else np.asarray(given, dtype=np.float64)
    return matrix


def infeasible_lcps(
    size: Sizes = None,
    *,
    monotone: bool = False,
    bounds: float = False,
    density: float = 1.0,
    row_scale: int = 0,
    column_scale: int = 0,
    margin: float = 1.0,
    dense: bool = True,
) -> st.SearchStrategy[tuple[LCP, Infeasibility]]:
    """Return a strategy for pairs (problem, proof): no z within its bounds gives w the signs that it needs.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows, at least 1; 1 to 8 by default.
    monotone : bool
        Draw M that is symmetric positive semidefinite before it is scaled, singular by necessity; otherwise anything.
    bounds : bool or float
        Share of rows with other bounds than 0 and ∞: −∞ and u, l and ∞, l and u, or none.
    density : float
        Share of nonzeros, in [0, 1], roughly; one row is a combination of the others.
    row_scale, column_scale : int
        As in :func:`solved_lcps`.
    margin : float
        A power of two in [2⁻³⁰, 1]: the constraints contradict each other by 1 to 9 margins.
    dense : bool
        Arrays; otherwise CSR arrays.

    Returns
    -------
    strategy of (LCP, Infeasibility)
        ``proof.exact_y`` is the Farkas vector in fractions, its largest entry 1 in size; ``proof.verify()`` is True.

    Raises
    ------
    InvalidOption
        Where an option is out of its range; where a drawn size is 0, while drawing.

    Notes
    -----
    The proof comes first: y with the signs that the bounds ask for, then all rows but one, and that one so that Mᵀy
    has the signs that keep (Mᵀy)ᵀz bounded, and q so that the sum is negative. For z ≥ 0: y ≥ 0, Mᵀy ≤ 0, qᵀy < 0.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> problem, proof = find(infeasible_lcps(2), lambda drawn: True, settings=quick)
    >>> proof.exact_y, proof.verify()
    ((Fraction(1, 1), Fraction(0, 1)), True)
    """
    options = checked_options(
        size, density=density, row_scale=row_scale, column_scale=column_scale, margin=margin, dense=dense, smallest=1
    )
    return _infeasible(options, monotone, checked_share("bounds", bounds))


# Which bounds are infinite, below and above; the last is for boxes only.
SIDES = np.array([(0, 1), (1, 0), (1, 1), (0, 0)])


@st.composite
def _infeasible(draw: st.DrawFn, options: Options, monotone: bool, share: float) -> tuple[LCP, Infeasibility]:
    n = draw(options.sizes)
    pivot = draw(st.integers(0, n - 1))
    lower, upper = _drawn_bounds(draw, n, pivot, share)
    y = _drawn_multipliers(draw, pivot, lower, upper)
    product = np.zeros(n) if monotone else _drawn_product(draw, options, lower, upper)
    q = draw(vectors(n, SIGNED))
    surplus = options.margin * drawn_number(draw, POSITIVE)
    row, column = drawn_units(draw, n, options.row_scale, options.column_scale)
    M = draw(square(n, options.entries))
    M[pivot] = 0.0
    M[pivot] = y[pivot] * (product - y @ M)
    highest = float(np.where(product > 0, upper, lower)[product != 0] @ product[product != 0])
    q[pivot] = 0.0
    q[pivot] = y[pivot] * (-highest - y @ q - surplus)
    given = M @ M.T if monotone else M
    problem = _in_units(given if options.dense else sp.csr_array(given), q, lower, upper, row, column)
    return problem, Infeasibility.of(problem, dict(enumerate(fractions_of(np.ldexp(y, -row)))))


def _drawn_bounds(draw: st.DrawFn, n: int, pivot: int, share: float) -> tuple[FloatVector, FloatVector]:
    """Return lower and upper, each of shape (n,); those of the pivot's row are no box."""
    lower, upper = np.zeros(n), np.full(n, math.inf)
    if not share:
        return lower, upper
    which = draw(integer_vectors(n, Numbers(0, 11)))
    is_open = SIDES[which % np.where(np.arange(n) == pivot, 3, 4)]
    low, length = draw(vectors(n, SIGNED)), draw(vectors(n, Numbers(0, 9)))
    chosen = draw(vectors(n, by_share(1.0 - share, share))) > 0
    lower[chosen] = np.where(is_open[:, 0], -math.inf, low)[chosen]
    upper[chosen] = np.where(is_open[:, 1], math.inf, low + length)[chosen]
    return lower, upper


def _drawn_multipliers(draw: st.DrawFn, pivot: int, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return y, shape (n,): ≥ 0 where w ≥ 0 is needed, ≤ 0 where w ≤ 0, 0 in boxes, ±1 in the pivot's row."""
    sizes, sides = draw(vectors(lower.size, Numbers(0, 3))), draw(vectors(lower.size, SIGNS))
    sizes[pivot] = 1.0
    below, above = np.isinf(lower), np.isinf(upper)
    y: FloatVector = sizes * np.where(below & above, sides, above * 1.0 - below)
    return y


def _drawn_product(draw: st.DrawFn, options: Options, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return Mᵀy, shape (n,): ≤ 0 where z can rise without end, ≥ 0 where it can fall, 0 where it is free."""
    values = draw(vectors(lower.size, options.entries))
    below, above = np.isinf(lower), np.isinf(upper)
    one_sided = np.where(above, -abs(values), np.where(below, abs(values), values))
    product: FloatVector = np.where(below & above, 0.0, one_sided)
    return product
