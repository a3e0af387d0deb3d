"""Hypothesis strategies: matrices whose class is certain, problems whose answer is exact, and a test of any solver.

Everything drawn consists of small integers, so that its class holds in exact arithmetic,
not up to rounding, and it is right by construction: nothing is drawn only to be thrown away. All strategies shrink
towards the 1 × 1 identity, or the simplest matrix of their class, and small integers. Sizes up to about thirty rows are
practical: hypothesis draws every entry and rejects what is too much for it.

`lcps` draws problems, `solved_lcps` with the exact answer, `infeasible_lcps` with a Farkas proof, `convex_qps` with x
and multipliers; each matrix strategy is named after its class and draws arrays; `.map(scipy.sparse.csr_array)` makes
them CSR arrays.
`assert_solves` takes any callable (M, q, lower, upper) → z and reports the smallest problem on which it is wrong.

>>> from lcp_plugin import LCP, Status, solve
>>> def my_solver(M, q, lower, upper):
...     result = solve(LCP(M, q, lower=lower, upper=upper), tolerance=1e-10)
...     return result.z if result.status is Status.SOLVED else None
>>> assert_solves(my_solver, matrices=p_matrices(size=4), bounds=True, max_examples=50)
50

assert_solves: test any solver on problems with known solutions, in exact arithmetic.

Strategies for matrices of a certain class: by signs of xᵀM x, sums of rows, or principal minors.

Strategies for linear complementarity problems: any, solved exactly, and without solution.

A strategy for convex quadratic programs with exact solutions.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache, wraps
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

try:
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as fixed_seed
    from hypothesis import strategies as st
    from hypothesis.errors import Flaky
except ImportError:
    raise ImportError(
        "lcp_plugin.strategies needs hypothesis; install it with: pip install hypothesis (or lcp_plugin[test])"
    ) from None

from .core.checks import AnyMatrix, FloatMatrix, Vector, checked_vector, is_number
from .core.errors import InvalidOption, InvalidProblem
from .core.lcp import LCP
from .core.names import Names
from .core.settings import whole_number
from .judges.worst_rows import pair_text
from .problems.programs.conversion import QuadraticProgram
from .proofs.exact import exact_residuals, exact_slack, is_exact_solution, rational
from .proofs.no_solution import Infeasibility
from .proofs.verdicts import MatrixReport

__all__ = [
    "QPAnswer",
    "assert_solves",
    "convex_qps",
    "h_plus_matrices",
    "infeasible_lcps",
    "lcps",
    "p_matrices",
    "positive_definite_matrices",
    "positive_semidefinite_matrices",
    "solved_lcps",
    "strictly_dominant_matrices",
]

LARGEST_ENTRY = 9  # small integers: sums are exact, examples are short
LARGEST_SIZE = 8  # rows: all active sets can be enumerated

Sizes = int | st.SearchStrategy[int] | None
Matrices = st.SearchStrategy[Any] | None
Numbers = st.SearchStrategy[Any]


def sizes(size: Sizes, smallest: int = 0) -> st.SearchStrategy[int]:
    """Return a strategy for numbers of rows, none below `smallest`, or raise InvalidOption."""
    if size is None:
        return st.integers(max(1, smallest), LARGEST_SIZE)

    def checked(n: int) -> int:
        return whole_number(n, "size", smallest, " or a strategy of such")

    return size.map(checked) if isinstance(size, st.SearchStrategy) else st.just(checked(size))


def entries(density: float) -> Numbers:
    """Return integers up to 9 in absolute value of which the share `density` is nonzero."""
    if not (is_number(density) and 0.0 <= density <= 1.0):
        raise InvalidOption(f"density must lie in [0, 1], got {density!r}")
    values = 2 * LARGEST_ENTRY
    if density * 1e6 < values:
        return st.just(0)
    zeros = max(1, round(values * (1.0 - density) / density))
    # 1, −1, 2, −2 … for 1, 2, 3, 4 …, and 0 for 0 and all below it: simple entries come first.
    drawn = st.integers(1 - zeros, values)
    return drawn.map(lambda k: 0 if k <= 0 else (k + 1) // 2 if k % 2 else -(k // 2))


POSITIVE = st.integers(1, LARGEST_ENTRY)
SIGNED = st.integers(-LARGEST_ENTRY, LARGEST_ENTRY)
SIGNS = st.sampled_from([1, -1])
UNITS = st.sampled_from([1, 2, 4])


@lru_cache(maxsize=1000)
def rows(n: int, row: Numbers) -> st.SearchStrategy[list[Any]]:
    """Return a strategy for lists of n values.

    Up to 8 it always draws 8 and drops the last: shrinking can then lower n without a change of the later draws.
    """
    return st.tuples(*[row] * max(n, LARGEST_SIZE)).map(lambda drawn: list(drawn[:n]))


def vectors(n: int, values: Numbers) -> st.SearchStrategy[Vector]:
    """Return a strategy for arrays of shape (n,)."""
    return rows(n, values).map(lambda drawn: np.array(drawn, dtype=np.float64))


def orders(n: int) -> st.SearchStrategy[NDArray[np.intp]]:
    """Return a strategy for permutations of 0 … n − 1 that shrinks to the identity."""
    keys = vectors(n, st.integers(0, LARGEST_SIZE - 1))
    return keys.map(lambda drawn: np.argsort(drawn, kind="stable"))


@lru_cache(maxsize=1000)
def blocks(height: int, width: int, values: Numbers) -> st.SearchStrategy[FloatMatrix]:
    """Return a strategy for arrays of shape (height, width)."""
    entries = st.tuples(*[values] * (height * width))
    return entries.map(lambda drawn: np.array(drawn, dtype=np.float64).reshape(height, width))


# of a size, and of numbers of the requested density
Build = Callable[[st.DrawFn, int, Numbers], FloatMatrix]


def matrix_strategy(build: Build) -> Callable[..., st.SearchStrategy[Any]]:
    """Turn a function that draws a matrix of n rows into a strategy with checked size and density."""
    drawn = st.composite(lambda draw, rows, values: build(draw, draw(rows), values))

    @wraps(build)
    def strategy(size: Sizes = None, *, density: float = 1.0) -> st.SearchStrategy[Any]:
        return drawn(sizes(size), entries(density))

    del strategy.__wrapped__  # help and signature list size and density
    return strategy


@matrix_strategy
def positive_definite_matrices(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return a strategy for positive definite matrices, xᵀM x > 0 for x ≠ 0; usually they are not H₊-matrices.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the factor B, in [0, 1], roughly.

    Returns
    -------
    strategy of ndarray, shape (size, size)

    Raises
    ------
    InvalidOption
        If an option is out of its range.

    Notes
    -----
    M = B Bᵀ + E with B an integer matrix, E a diagonal of integers from 1 to 9.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(positive_definite_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    >>> find(positive_definite_matrices(2), lambda M: True, settings=quick)
    array([[1., 0.],
           [0., 1.]])
    """
    return _definite(draw, n, values)


@matrix_strategy
def positive_semidefinite_matrices(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return a strategy for symmetric positive semidefinite matrices of every rank from 0 to their size.

    Parameters
    ----------
    size, density
        As in :func:`positive_definite_matrices`.

    Notes
    -----
    M = L Lᵀ with L in some order of its rows unit lower trapezoidal with integer entries.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(positive_semidefinite_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    rank = n - draw(st.integers(0, n))
    order, A = draw(orders(n)), draw(blocks(n, n, values))
    L = (np.tril(A, -1) + np.eye(n))[order, :rank]
    return L @ L.T


@matrix_strategy
def h_plus_matrices(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return a strategy for H₊-matrices: positive diagonal, and ⟨M⟩v > 0 for some v > 0.

    Parameters
    ----------
    size, density
        As in :func:`positive_definite_matrices`; the density is the share of nonzeros off the diagonal.

    Notes
    -----
    M = A C with A an integer matrix of strictly dominant rows and C a diagonal of 1, 2 and 4; v = C⁻¹1.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(h_plus_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    return _h_plus(draw, n, values)


@matrix_strategy
def strictly_dominant_matrices(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return a strategy for matrices with m_ii > Σ_j≠i |m_ij| in every row.

    Parameters
    ----------
    size, density
        As in :func:`h_plus_matrices`.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(strictly_dominant_matrices(2), lambda M: M[0, 1] > 0, settings=shrunk)
    array([[2., 1.],
           [0., 1.]])
    """
    return _by_row_sums(draw, n, values)


@matrix_strategy
def p_matrices(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return a strategy for P-matrices, all principal minors positive: exactly one solution for every q and all bounds.

    Parameters
    ----------
    size, density
        As in :func:`h_plus_matrices`; the density is the share of nonzeros of the parts.

    Notes
    -----
    H₊-matrices, and in some order of the unknowns [[A, X], [0, C]] with A + Aᵀ and C + Cᵀ positive definite and X
    anything: a principal minor is the product of one of A and one of C. Most of the larger ones are neither H-matrices
    nor positive definite.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §3.3.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(p_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    if not draw(st.booleans()):
        return _h_plus(draw, n, values)
    cut, order = draw(st.integers(0, n)), draw(orders(n))
    K = np.tril(draw(blocks(n, n, values)), -1)
    A = _definite(draw, n, values) + K.T - K
    A[cut:, :cut] = 0.0
    A[:cut, cut:] = draw(blocks(cut, n - cut, values))
    return A[np.ix_(order, order)]


def _definite(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return B Bᵀ + E: symmetric positive definite."""
    E = np.diag(draw(vectors(n, POSITIVE)))
    B = draw(blocks(n, n, values))
    return np.asarray(B @ B.T + E)


def _by_row_sums(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    """Return a matrix whose diagonal entries exceed the sums of the others' sizes by integers from 1 to 9."""
    surplus = draw(vectors(n, POSITIVE))
    A = draw(blocks(n, n, values))
    np.fill_diagonal(A, 0.0)
    np.fill_diagonal(A, abs(A).sum(axis=1) + surplus)
    return A


def _h_plus(draw: st.DrawFn, n: int, values: Numbers) -> FloatMatrix:
    return np.asarray(_by_row_sums(draw, n, values) * draw(vectors(n, UNITS)))


ExactPoint = tuple[Fraction, ...]
#: Matrices with which every problem has exactly one solution.
DEFAULT_MATRICES = h_plus_matrices() | positive_definite_matrices()
DEFAULT_HESSIANS = positive_definite_matrices() | positive_semidefinite_matrices()
DISTANCES = st.sampled_from([*range(1, LARGEST_ENTRY + 1), *(math.inf,) * LARGEST_ENTRY])
INACTIVE, ACTIVE, DEGENERATE = range(3)
#: Whether a row is at its lower and at its upper bound, and the sign of the slack in this case.
BOUNDED = {
    INACTIVE: [(False, False, 0)],
    ACTIVE: [(True, False, 1), (False, True, -1), (True, True, 1), (True, True, -1)],
    DEGENERATE: [(True, False, 0), (False, True, 0), (True, True, 0)],
}


def lcps(matrices: Matrices = None, *, bounds: bool = False) -> st.SearchStrategy[LCP]:
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
    chosen, row = DEFAULT_MATRICES if matrices is None else matrices, complementary_rows(bounds)

    @st.composite
    def problem(draw: st.DrawFn) -> LCP:
        M = draw(chosen)
        _, _, lower, upper = columns_of(draw(rows(M.shape[0], row)))
        return LCP(M, draw(vectors(M.shape[0], SIGNED)), lower=lower, upper=upper)

    return problem()


def solved_lcps(
    matrices: Matrices = None, *, bounds: bool = False, huge_slacks: bool = False
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
    The solution is drawn first: z and w are complementary, with inactive rows (z between its bounds, w = 0),
    active ones (z at a bound, w ≠ 0 of the right sign) and degenerate ones (z at a bound, w = 0).

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> problem, z = find(solved_lcps(), lambda drawn: True, settings=quick)
    >>> problem.M, problem.q, z
    (array([[1.]]), array([-1.]), (Fraction(1, 1),))
    """
    chosen, row = DEFAULT_MATRICES if matrices is None else matrices, complementary_rows(bounds)

    @st.composite
    def solved(draw: st.DrawFn) -> tuple[LCP, ExactPoint]:
        M = draw(chosen)
        z, slack, lower, upper = columns_of(draw(rows(M.shape[0], row)))
        w = slack * 2.0 ** draw(vectors(z.size, st.integers(0, 24))) if huge_slacks else slack
        try:
            q = exact_offset(M, z, w)
        except InvalidProblem:  # no space for huge slacks with this M
            q = exact_offset(M, z, slack)
        return LCP(M, q, lower=lower, upper=upper), tuple(rational(z))

    return solved()


def infeasible_lcps(
    size: Sizes = None, *, bounds: bool = False
) -> st.SearchStrategy[tuple[LCP, Infeasibility]]:
    """Return a strategy for pairs (problem, proof): no z within its bounds gives w the signs that it needs.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows, at least 1; 1 to 8 by default.
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
        is_free = below & above
        # y ≥ 0 if w ≥ 0 is needed, ≤ 0 if w ≤ 0 is needed; 0 in boxes, ±1 in the pivot's row.
        y = draw(vectors(n, st.integers(0, 3)))
        y[pivot] = 1.0
        y *= np.where(is_free, draw(vectors(n, SIGNS)), above * 1.0 - below)
        # Mᵀy ≤ 0 if z can rise indefinitely, ≥ 0 if it can fall, = 0 if z is free
        drawn = draw(vectors(n, SIGNED))
        product = np.where(above, -abs(drawn), np.where(below, abs(drawn), drawn))
        product[is_free] = 0.0
        q, surplus = draw(vectors(n, SIGNED)), draw(POSITIVE)
        M = draw(blocks(n, n, SIGNED))
        M[pivot] = 0.0
        M[pivot] = y[pivot] * (product - y @ M)
        used = product != 0
        highest = float(np.where(product > 0, upper, lower)[used] @ product[used])
        q[pivot] = 0.0
        q[pivot] = y[pivot] * (-highest - y @ q - surplus)
        problem = LCP(M, q, lower=lower, upper=upper)
        return problem, Infeasibility.of(problem, dict(enumerate(rational(y))))

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


def exact_offset(matrix: AnyMatrix, z: Vector, w: Vector) -> Vector:
    """Return q = w − M z, shape (n,); raise InvalidProblem if it is not exact in float64."""
    M = sp.csr_array(matrix)
    products = exact_slack(LCP(M, np.zeros(z.size)), z)
    exact = [Fraction(left) - product for left, product in zip(w.tolist(), products, strict=True)]
    for i, value in enumerate(exact):
        if abs(value) > sys.float_info.max or Fraction(float(value)) != value:
            sizes = abs(M.data[M.indptr[i] : M.indptr[i + 1]])
            raise InvalidProblem(
                f"q = w − M z is not free of rounding in row {i} of M, whose entries lie between "
                f"{sizes.min(initial=np.inf):g} and {sizes.max(initial=0.0):g} in size; draw short entries of one size"
            )
    return np.array(exact, dtype=np.float64)


Solver = Callable[[Any, Vector, Vector, Vector], Any]
Drawn = tuple[LCP, ExactPoint | None, Any]  # the problem, its exact solution, M in the drawn form


def assert_solves(
    solver: Solver,
    *,
    matrices: Matrices = None,
    bounds: bool = False,
    may_give_up: bool = False,
    tolerance: float = 1e-6,
    error_tolerance: float = 1e-3,
    max_examples: int = 200,
    seed: int | None = 0,
) -> int:
    """Return the number of problems drawn, or raise an AssertionError that shows the simplest problem solved wrongly.

    Parameters
    ----------
    solver : callable (M, q, lower, upper) → z
        M of shape (n, n), an array or CSR array as `matrices` draws it; vectors of shape (n,), lower = 0 and upper = ∞
        without `bounds`. It returns z of shape (n,) if it claims that the problem is solved. Otherwise it returns None
        or raises an error: translate a status into that.
    matrices : strategy of (n, n) matrices, optional
        Matrices of the solver's class; P-matrices of size 1 to 8 by default.
    bounds : bool
        Draw other bounds than 0 and ∞.
    may_give_up : bool
        Whether the solver may give up on a problem that has a solution. If not, that is a failure on all problems
        drawn with their answer and, if M is a P-matrix, on all others.
    tolerance : float
        Allowed for each row's z − mid(lower, upper, z − w/d), d the diagonal entry (the row's largest if that is
        negligible), relative to max(1, its largest value at the point between the bounds nearest to 0).
    error_tolerance : float
        Allowed for ‖z − z*‖∞ relative to 1 + ‖z*‖∞, if the solution z* is known and unique (M is a P-matrix). On
        nearly singular matrices a small residual goes with a large error; ∞ leaves this out.
    max_examples : int
        Number of problems, at least 1.
    seed : int or None
        Seed of the problems drawn; None draws new problems each time.

    Raises
    ------
    AssertionError
        If the solver failed. The message names the fault. The solver gave up or raised. z is not a vector of finite
        numbers, is outside the bounds, or far from the exact solution; w has the wrong sign or is not complementary. M,
        q or a bound was modified. Or a second solve of the same problem gave another result.
    InvalidOption
        If an option is out of its range.

    Notes
    -----
    Half of the problems have an answer chosen beforehand, with inactive, active and degenerate rows and slacks up to
    10⁸; the others have any q. w = M z + q is computed in rational arithmetic, so that the test does not round.

    Examples
    --------
    A diagonal solver, and the problem on which it fails:

    >>> def diagonal(M, q, lower, upper):
    ...     return np.clip(-q / M.diagonal(), lower, upper)
    >>> from lcp_plugin.strategies import h_plus_matrices
    >>> assert_solves(diagonal, matrices=h_plus_matrices(density=0), bounds=True, max_examples=20)
    20
    >>> try:
    ...     assert_solves(diagonal, matrices=h_plus_matrices(2))
    ... except AssertionError as report:
    ...     print(str(report).splitlines()[0])
    diagonal: w[1] = 1 while z[1] = 1.5 > 0
    """
    if not callable(solver):
        raise InvalidOption(f"solver must be callable: (M, q, lower, upper) → z, got {solver!r}")
    chosen: Any = p_matrices() if matrices is None else matrices
    if not isinstance(chosen, st.SearchStrategy):
        kind = type(chosen).__name__
        raise InvalidOption(f"matrices must be a strategy such as p_matrices(4), got {kind}")
    whole_number(max_examples, "max_examples", 1)
    for option, value in (("tolerance", tolerance), ("error_tolerance", error_tolerance)):
        if not value >= 0.0:
            raise InvalidOption(f"{option} must be a number ≥ 0, got {value!r}")
    problems, drawn_so_far = _drawn_problems(chosen, bounds), count()

    quietly: dict[str, Any] = {"database": None, "report_multiple_bugs": False, "print_blob": False}
    quietly |= {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}

    @settings(max_examples=max_examples, phases=[Phase.generate, Phase.shrink], **quietly)
    @given(problems)
    def solver_is_right(drawn: Drawn) -> None:
        next(drawn_so_far)
        complaint, z = _verdict(solver, drawn, may_give_up, tolerance, error_tolerance)
        if complaint:
            name = getattr(solver, "__name__", type(solver).__name__)
            raise AssertionError(f"{name}: {complaint}\n{_shown(*drawn[:2], z)}")

    try:
        (solver_is_right if seed is None else fixed_seed(seed)(solver_is_right))()
    except Flaky as error:
        raise AssertionError("the solver gives the same problem two solutions") from error
    return next(drawn_so_far)


@st.composite
def _drawn_problems(draw: st.DrawFn, matrices: st.SearchStrategy[Any], bounds: bool) -> Drawn:
    """Return a problem, its exact solution or None, and M as drawn (an LCP may convert M)."""
    M, kind = draw(matrices), draw(st.integers(0, 3))
    if kind >= 2:
        return draw(lcps(st.just(M), bounds=bounds)), None, M
    return *draw(solved_lcps(st.just(M), bounds=bounds, huge_slacks=kind == 1)), M


def _verdict(
    solver: Solver, drawn: Drawn, may_give_up: bool, tolerance: float, error_tolerance: float
) -> tuple[str, Any]:
    """Return the fault of a solver, "" if there is none, and z; the solver gets copies, which it must not modify."""
    problem, truth, M = drawn
    stated = (M, problem.q, problem.lower, problem.upper)
    copies = [each.copy() for each in stated]
    reason = "returned None"
    try:
        z = solver(*copies)
    except Exception as error:  # any exception of a foreign solver means that it gave up
        z, reason = None, f"raised {type(error).__name__}: {error}"
    for name, now, before in zip(("M", "q", "lower", "upper"), copies, stated, strict=True):
        if (now != before).sum():
            return f"it modified its input {name}", None
    if z is not None:
        return check_solution(problem, z, truth, tolerance, error_tolerance), z
    if may_give_up or (truth is None and not MatrixReport(problem.M).is_p_matrix):
        return "", None
    return f"it gave up ({reason}) on a problem that has a solution", None


def check_solution(
    problem: LCP,
    point: object,
    truth: ExactPoint | None,
    tolerance: float = 1e-6,
    error_tolerance: float = 1e-3,
) -> str:
    """Return the fault of z as a solution of the problem, "" if there is none; tolerances of `assert_solves`.

    Examples
    --------
    >>> check_solution(LCP([[2, 1], [1, 2]], [-5, 1]), [2.5, -1], None)
    'z[1] = -1 is beyond its bound 0'
    >>> check_solution(LCP([[2, 1], [1, 2]], [-5, 1]), [2.5, 0], None)
    ''
    """
    try:
        z = checked_vector(point, "z", problem.n)
    except InvalidProblem as error:
        return str(error)
    w = exact_slack(problem, z)
    residuals = exact_residuals(problem, z)
    at_start = max(exact_residuals(problem, problem.nearest_to_zero), default=0)
    allowed = Fraction(tolerance) * max(1, at_start) if math.isfinite(tolerance) else math.inf
    if problem.n and max(residuals) > allowed:
        i = residuals.index(max(residuals))
        low, high = float(problem.lower[i]), float(problem.upper[i])
        value = min(max(low, float(z[i])), high)
        value = value if abs(value - z[i]) <= allowed else float(z[i])  # nearly at a bound
        return pair_text(
            Names([*map("w[{}]".format, range(problem.n))]), i, value, float(w[i]), low, high
        )
    if truth is None or not math.isfinite(error_tolerance) or is_exact_solution(problem, z):
        return ""
    pairs = zip(z.tolist(), truth, strict=True)
    distance = max(abs(Fraction(value) - exact) for value, exact in pairs)
    size = 1 + max(map(abs, truth))
    if distance <= Fraction(error_tolerance) * size or not MatrixReport(problem.M).is_p_matrix:
        return ""
    return f"z is far from the exact answer: by {float(distance):g}, though its residual is small"


def _shown(problem: LCP, truth: ExactPoint | None, z: Vector) -> str:
    """Return the call that makes the problem, the solver's z and the exact solution if it is known."""
    data = f"{problem.csr.toarray().tolist()}, {problem.q.tolist()}"
    if problem.lower.any() or np.isfinite(problem.upper).any():
        data += f", lower={problem.lower.tolist()}, upper={problem.upper.tolist()}"
    exact = "" if truth is None else f"\nthe exact answer is z = {[*map(float, truth)]}"
    return f"problem = LCP({data})\nz = {z!r}{exact}"


class QPAnswer(NamedTuple):
    """A minimum of a convex quadratic program and multipliers that prove it, all exact.

    P x + c + Gᵀ inequality + Aᵀ equality − lower + upper = 0. Each multiplier of an inequality or a bound is ≥ 0, and 0
    if this is not active. `x` is the only minimum if P is positive definite; `objective` is always the least value.
    """

    x: ExactPoint
    inequality: ExactPoint
    equality: ExactPoint
    lower: ExactPoint
    upper: ExactPoint
    objective: Fraction


def convex_qps(
    matrices: Matrices = None,
    *,
    inequalities: int | st.SearchStrategy[int] = st.integers(0, 4),  # noqa: B008 - strategies do not change
    equalities: int | st.SearchStrategy[int] = st.integers(0, 2),  # noqa: B008
    bounds: bool = True,
) -> st.SearchStrategy[tuple[QuadraticProgram, QPAnswer]]:
    """Return a strategy for pairs (program, answer), answer a minimum with its multipliers, exactly.

    Parameters
    ----------
    matrices : strategy of symmetric positive semidefinite (n, n) matrices, optional
        The Hessians P; definite and semidefinite ones of all sizes up to 8 by default.
    inequalities, equalities : int or strategy of int
        Rows of G and of A, up to 4 and 2 by default. Rows may depend on one another.
    bounds : bool
        Draw variables with bounds; otherwise they are free.

    Returns
    -------
    strategy of (QuadraticProgram, QPAnswer)

    Raises
    ------
    InvalidOption
        If an option is out of its range.
    InvalidProblem
        While drawing, if P is not symmetric or c is not free of rounding.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> program, answer = find(convex_qps(inequalities=1), lambda drawn: True, settings=quick)
    >>> program
    QuadraticProgram(n=1, 1 inequality, 0 equalities)
    >>> answer.x, answer.objective
    ((Fraction(0, 1),), Fraction(0, 1))
    """
    hessians = DEFAULT_HESSIANS if matrices is None else matrices
    inequality_count, equality_count = sizes(inequalities), sizes(equalities)
    variable, pair = complementary_rows(bounds, otherwise_free=True), complementary_rows()

    @st.composite
    def convex(draw: st.DrawFn) -> tuple[QuadraticProgram, QPAnswer]:
        P = draw(hessians)
        n, m, p = P.shape[0], draw(inequality_count), draw(equality_count)
        x, reduced, lower, upper = columns_of(draw(rows(n, variable)))
        gap, multiplier, _, _ = columns_of(draw(rows(m, pair)))
        equality = draw(vectors(p, SIGNED))
        G, A = np.split(draw(blocks(m + p, n, SIGNED)), [m])
        c = exact_offset(P, x, reduced - G.T @ multiplier - A.T @ equality)
        # ½xᵀP x + cᵀx = ½xᵀ((P x + c) + c)
        terms = zip(rational(x), exact_slack(LCP(P, c), x), rational(c), strict=True)
        least = sum((value * (slope + linear) / 2 for value, slope, linear in terms), Fraction(0))
        program = QuadraticProgram(P, c, G, G @ x + gap, A, A @ x, lower, upper)
        answers = (x, multiplier, equality, np.maximum(reduced, 0.0), np.maximum(-reduced, 0.0))
        return program, QPAnswer._make([*(tuple(rational(part)) for part in answers), least])

    return convex()
