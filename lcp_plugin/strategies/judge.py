"""assert_solves: test any solver on problems with known solutions, in exact arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as fixed_seed
from hypothesis import strategies as st
from hypothesis.errors import Flaky

from ..core.checks import FloatVector
from ..core.errors import InvalidOption
from ..core.lcp import LCP
from ..core.settings import whole_number
from ..proofs.exact.rational import exact_residuals, exact_slack, is_exact_solution
from ..proofs.verdicts import analyze
from .matrices import p_matrices
from .problems import ExactPoint, lcps, solved_lcps

Solver = Callable[[Any, FloatVector, FloatVector, FloatVector], Any]
Drawn = tuple[LCP, ExactPoint | None, Any]  # the problem, its exact solution, M in the drawn form

PHASES = (Phase.generate, Phase.shrink)


def assert_solves(
    solver: Solver,
    *,
    matrices: st.SearchStrategy[Any] | None = None,
    bounds: bool = False,
    may_give_up: bool = False,
    tolerance: float = 1e-6,
    error_tolerance: float = 1e-3,
    max_examples: int = 200,
    seed: int | None = 0,
) -> None:
    """Raise an AssertionError that shows the simplest problem found on which a solver is wrong, if there is one.

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
    >>> try:
    ...     assert_solves(diagonal, matrices=h_plus_matrices(2))
    ... except AssertionError as report:
    ...     print(str(report).splitlines()[0])
    diagonal: z is not complementary: w[1] = 1, but z[1] = 1.5 lies between its bounds
    """
    if not callable(solver):
        raise InvalidOption(
            f"solver must be callable as solver(M, q, lower, upper), got {solver!r}"
        )
    chosen: Any = p_matrices() if matrices is None else matrices
    if not isinstance(chosen, st.SearchStrategy):
        kind = type(chosen).__name__
        raise InvalidOption(f"matrices must be a strategy such as p_matrices(4), got {kind}")
    whole_number(max_examples, "max_examples", 1)
    for option, value in (("tolerance", tolerance), ("error_tolerance", error_tolerance)):
        if not value >= 0.0:
            raise InvalidOption(f"{option} must be a number ≥ 0, got {value!r}")
    problems = _drawn_problems(chosen, bounds)

    @settings(
        max_examples=max_examples,
        deadline=None,
        database=None,
        report_multiple_bugs=False,
        print_blob=False,
        suppress_health_check=[HealthCheck.too_slow],
        phases=PHASES,
    )
    @given(problems)
    def solver_is_right(drawn: Drawn) -> None:
        complaint, z = _verdict(solver, drawn, may_give_up, tolerance, error_tolerance)
        if complaint:
            name = getattr(solver, "__name__", type(solver).__name__)
            raise AssertionError(f"{name}: {complaint}\n{_shown(*drawn[:2], z)}")

    try:
        (solver_is_right if seed is None else fixed_seed(seed)(solver_is_right))()
    except Flaky as error:
        raise AssertionError("the solver gives the same problem two solutions") from error


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
    if may_give_up or (truth is None and not analyze(problem.M).is_p_matrix):
        return "", None
    return f"it gave up ({reason}) on a problem that has a solution", None


def check_solution(
    problem: LCP,
    given: Any,
    truth: ExactPoint | None,
    tolerance: float = 1e-6,
    error_tolerance: float = 1e-3,
) -> str:
    """Return the fault of z as a solution of the problem, "" if there is none; tolerances of `assert_solves`.

    Examples
    --------
    >>> check_solution(LCP([[2, 1], [1, 2]], [-5, 1]), [2.5, -1], None)
    'z is outside its bounds: z[1] = -1, but lower[1] = 0'
    >>> check_solution(LCP([[2, 1], [1, 2]], [-5, 1]), [2.5, 0], None)
    ''
    """
    try:
        z = np.asarray(given)
    except Exception:  # a pair (z, info), or an object that rejects in a way of its own
        z = np.array(None)
    if z.shape != (problem.n,) or z.dtype.kind not in "biuf":
        return (
            f"z must be {problem.n} real numbers in an array of shape ({problem.n},), got {given!r}"
        )
    z = z.astype(np.float64)
    if not np.isfinite(z).all():
        return "z is not finite"
    w = exact_slack(problem, z)
    residuals = exact_residuals(problem, z)
    at_start = max(exact_residuals(problem, problem.nearest_to_zero), default=0)
    allowed = Fraction(tolerance) * max(1, at_start) if math.isfinite(tolerance) else math.inf
    worst = max(range(problem.n), key=residuals.__getitem__, default=None)
    if worst is not None and residuals[worst] > allowed:
        return _named(problem, z, w, worst, allowed)
    if truth is None or not math.isfinite(error_tolerance) or is_exact_solution(problem, z):
        return ""
    distance = max(
        (abs(Fraction(value) - exact) for value, exact in zip(z.tolist(), truth, strict=True)),
        default=0,
    )
    size = 1 + max(map(abs, truth), default=Fraction(0))
    if distance <= Fraction(error_tolerance) * size or not analyze(problem.M).is_p_matrix:
        return ""
    return f"z is far from the exact answer: by {float(distance):g}, though its residual is small"


def _named(problem: LCP, z: FloatVector, w: list[Fraction], i: int, allowed: Any) -> str:
    """Return the name of the condition that row i violates; a z within `allowed` of a bound is at it."""
    low, high, here = problem.lower[i], problem.upper[i], z[i]
    for name, bound, excess in (("lower", low, low - here), ("upper", high, here - high)):
        if excess > allowed:
            return f"z is outside its bounds: z[{i}] = {here:g}, but {name}[{i}] = {bound:g}"
    for name, bound, gap in (("lower", low, here - low), ("upper", high, high - here)):
        if gap <= allowed:
            place = f"z[{i}] = {here:g} is at its {name} bound {bound:g}"
            return f"w has the wrong sign: w[{i}] = {float(w[i]):g}, but {place}"
    place = f"z[{i}] = {here:g} lies between its bounds"
    return f"z is not complementary: w[{i}] = {float(w[i]):g}, but {place}"


def _shown(problem: LCP, truth: ExactPoint | None, z: Any) -> str:
    """Return the call that makes the problem, the solver's z and the exact solution if it is known."""
    data = f"{problem.csr.toarray().tolist()}, {problem.q.tolist()}"
    if problem.lower.any() or np.isfinite(problem.upper).any():
        data += f", lower={problem.lower.tolist()}, upper={problem.upper.tolist()}"
    exact = "" if truth is None else f"\nthe exact answer is z = {[*map(float, truth)]}"
    return f"problem = LCP({data})\nz = {z!r}{exact}"
