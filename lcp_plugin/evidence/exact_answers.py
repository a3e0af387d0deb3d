"""The exact answer of a problem whose active set is known, its condition, and whether a result tells the truth."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.certificates.criterion import rounding_of_data
from ..core.checks import FloatVector
from ..core.errors import UnsuitableProblem
from ..core.lcp import LCP
from ..core.matrix.scaling import scaled
from ..core.settings import Status
from ..core.solving.result import Result
from ..proofs.exact.linear_systems import solved_nearby
from ..proofs.exact.rational import (
    exact_residuals,
    exact_slack,
    is_exact_solution,
    power_of_two,
    rational_rows,
)
from ..proofs.no_solution.proof import exactly_weighted
from ..systems.equilibration import equilibrating_exponents

Answer = tuple[Fraction, ...]
States = list[int]

AT_LOWER, FREE, AT_UPPER = -1, 0, 1
LARGEST_DENSE = 400  # up to here a condition number comes from a dense inverse
SMALLEST_NORMAL = 2.0**-1022
EPSILON, SMALLEST = Fraction(1, 2**52), Fraction(1, 2**1074)
FLOORS_MEASURED = 5  # what double precision takes for 4 floors can be a little more
ALIKE = (1.0, 1.0, 1.0)  # passes of rows and columns that bring largest entries near 1


def exact_answer(problem: LCP, guess: Sequence[float]) -> Answer:
    """Return z* in fractions, verified without rounding, from the active set of a guess.

    Parameters
    ----------
    problem : LCP
    guess : sequence of float, shape (n,)
        A point on the right bounds; what lies strictly between its bounds is taken for free.

    Raises
    ------
    UnsuitableProblem
        Where its free block is singular, or gives no solution.

    Examples
    --------
    >>> exact_answer(LCP([[3, 0], [0, 1]], [-1, 1]), [0.33, 0])
    (Fraction(1, 3), Fraction(0, 1))
    """
    exact_guess = tuple(Fraction(value) for value in guess)
    if is_exact_solution(problem, exact_guess):
        return exact_guess
    z = _solved(problem, _states(problem, guess))
    if z is not None and is_exact_solution(problem, z):
        return tuple(z)
    raise UnsuitableProblem(
        f"no exact answer of {problem!r} found near the guess; give one on the right bounds"
    )


def _states(problem: LCP, guess: Sequence[float]) -> States:
    rows = zip(guess, problem.lower.tolist(), problem.upper.tolist(), strict=True)
    return [AT_LOWER if z <= low else AT_UPPER if z >= high else FREE for z, low, high in rows]


def _solved(problem: LCP, states: States) -> list[Fraction] | None:
    """Return z with its rows at their bounds and w = 0 on the free ones; None where their block is singular."""
    ends = {AT_LOWER: problem.lower, FREE: np.zeros(problem.n), AT_UPPER: problem.upper}
    z = [Fraction(float(ends[state][i])) for i, state in enumerate(states)]
    is_free = [state == FREE for state in states]
    right = [-w for w, free in zip(exact_slack(problem, z), is_free, strict=True) if free]
    column = equilibrating_exponents(problem.csr, ALIKE).column
    rows = [
        {j: entry * power_of_two(int(column[j])) for j, entry in row.items() if is_free[j]}
        for row, free in zip(rational_rows(problem.csr), is_free, strict=True)
        if free
    ]
    change = solved_nearby(rows, right, [Fraction(0)] * problem.n, is_free)
    return (
        None
        if change is None
        else [
            value + by * power_of_two(int(unit))
            for value, by, unit in zip(z, change, column, strict=True)
        ]
    )


# --- how sensitive the answer is ------------------------------------------------------------------------------------


def condition_of_answer(problem: LCP, exact: Answer, unit: FloatVector) -> float:
    """Return how much larger than the relative change of the entries of M and q that of z* can be, to first order.

    Parameters
    ----------
    problem : LCP
    exact : sequence of Fraction, shape (n,)
        z*.
    unit : ndarray, shape (n,)
        In which each component of z is measured.

    Returns
    -------
    float
        max_i (|M_FF⁻¹| (|M||z*| + |q|)_F)_i/unit_i over ‖z*/unit‖∞, at least 1; F are the rows with w* = 0, all of
        them or only those strictly between their bounds, whichever gives more. ∞ where M_FF is singular in double
        precision, NaN where n is too large to say.

    Notes
    -----
    Invariant under row scaling, and under column scaling where `unit` goes with it.

    References
    ----------
    R. D. Skeel, *Scaling for numerical stability in Gaussian elimination*, J. ACM 26 (1979),
    doi:10.1145/322139.322148.

    Examples
    --------
    >>> problem = LCP([[1, -0.875], [-0.875, 1]], [0, -0.234375])
    >>> round(condition_of_answer(problem, (Fraction(7, 8), Fraction(1)), np.ones(2)), 2)
    15.07
    """
    w = exact_slack(problem, exact)
    is_zero = np.array([value == 0 for value in w], dtype=bool)
    bounds = zip(exact, problem.lower.tolist(), problem.upper.tolist(), strict=True)
    is_between = np.array([low < value < high for value, low, high in bounds], dtype=bool)
    is_movable = is_zero & (problem.lower < problem.upper)
    sets = [is_movable] if np.array_equal(is_movable, is_between) else [is_movable, is_between]
    return float(
        np.max([1.0, *(_condition(problem, exact, unit, free) for free in sets)])
    )  # NaN wins


def _condition(problem: LCP, exact: Answer, unit: FloatVector, free: Any) -> float:
    rows = np.flatnonzero(free)
    exponents = row, column = equilibrating_exponents(problem.csr, ALIKE)
    sizes = problem.csr.copy()
    sizes.data = _ulps(sizes.data)
    M = scaled(problem.csr, exponents)
    z = np.array(
        [abs(float(value * power_of_two(-int(c)))) for value, c in zip(exact, column, strict=True)]
    )
    size = scaled(sizes, exponents) @ z + np.ldexp(_ulps(problem.q), row)
    block = M[rows][:, rows]
    inverse_times_size = _absolute_inverse_product(block, size[rows])
    with np.errstate(all="ignore"):
        per_unit = np.ldexp(unit, -column)
        largest = float(np.max(z / per_unit, initial=0.0))
        change = float(np.max(inverse_times_size / per_unit[rows], initial=0.0))
        finest = float(
            np.max(SMALLEST_NORMAL / unit)
        )  # subnormal answers have fewer digits themselves
        return max(change, finest) / largest if largest > 0.0 else 1.0


def _ulps(values: FloatVector) -> FloatVector:
    """Return the size of each number in the sense that its last digit is 2⁻⁵² of it: subnormals are coarser."""
    sizes: FloatVector = np.where(values == 0.0, 0.0, np.maximum(np.abs(values), SMALLEST_NORMAL))
    return sizes


def _absolute_inverse_product(block: Any, size: FloatVector) -> FloatVector:
    """Return |block⁻¹| size; ∞ where it is singular, NaN where it is too large to say."""
    n = block.shape[0]
    if n > LARGEST_DENSE:
        return np.full(n, np.nan)
    try:
        product: FloatVector = np.abs(np.linalg.inv(block.toarray())) @ size
    except np.linalg.LinAlgError:
        return np.full(n, np.inf)
    return product


# --- how far z is from it -------------------------------------------------------------------------------------------


def relative_error(
    z: FloatVector, exact: Answer, unit: FloatVector, *, has_line: bool = False
) -> float:
    """Return max_i |z_i − z*_i|/unit_i over max_i |z*_i|/unit_i, exact up to the last rounding; ∞ for x/0.

    Parameters
    ----------
    z : ndarray, shape (n,)
        Finite.
    exact : sequence of Fraction, shape (n,)
    unit : ndarray, shape (n,)
    has_line : bool
        All z* + t with t ≥ 0 solve the problem as well; the distance is that from the nearest.

    Examples
    --------
    >>> relative_error(np.array([1.0, 0.5]), (Fraction(1), Fraction(0)), np.ones(2))
    0.5
    """
    difference = [Fraction(value) - answer for value, answer in zip(z.tolist(), exact, strict=True)]
    if has_line and difference:
        along = max((max(difference) + min(difference)) / 2, Fraction(0))
        difference = [value - along for value in difference]
    units = [Fraction(value) for value in unit.tolist()]
    error = max(
        (abs(value) / u for value, u in zip(difference, units, strict=True)), default=Fraction(0)
    )
    largest = max(
        (abs(value) / u for value, u in zip(exact, units, strict=True)), default=Fraction(0)
    )
    if error == 0:
        return 0.0
    return nearest_double(error / largest) if largest else np.inf


def nearest_double(value: Fraction) -> float:
    """Return the double nearest to a fraction, ±∞ where it is beyond the range."""
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


# --- whether a result tells the truth --------------------------------------------------------------------------------


def rounding_floors(problem: LCP, z: FloatVector) -> list[Fraction]:
    """Return what rounding explains of each row's residual, k_i ε (|M||z| + |q|)_i/d_i and underflow, exactly."""
    M = problem.csr
    entries = [
        abs(Fraction(value) * Fraction(z[j]))
        for value, j in zip(M.data.tolist(), M.indices, strict=True)
    ]
    floors = []
    for i, (q, d) in enumerate(
        zip(problem.q.tolist(), problem.residual_scale.tolist(), strict=True)
    ):
        row = entries[M.indptr[i] : M.indptr[i + 1]]
        size = abs(Fraction(q)) + sum(row)
        floors.append((len(row) + 2) * (EPSILON * size + SMALLEST) / Fraction(d) + SMALLEST)
    return floors


def lie_in(result: Result, exact: Answer | None) -> str:
    """Return what is untrue in a result, or an empty text.

    Parameters
    ----------
    result : Result
        Of a run with the tolerance on the relative residual.
    exact : sequence of Fraction, shape (n,), optional
        The one solution, or None where it is not unique or does not exist.

    Notes
    -----
    A lie is a SOLVED whose exact residual exceeds tolerance · ‖r(z°)‖ in a component, both exact, a PRECISION_LIMIT
    with a row that rounding does not explain, a proof of no solution where there is one, a rigorous error bound that is
    exceeded, and a z that is not finite or not within its bounds.
    """
    problem, z = result.certificate.problem, result.z
    if not np.isfinite(z).all():
        return "z is not finite"
    if not np.array_equal(np.clip(z, problem.lower, problem.upper), z):
        return "z lies outside its bounds"
    if exact is not None:
        if result.status in (Status.INFEASIBLE, Status.NO_SOLUTION):
            return f"{result.status.name}, but there is a solution"
        if not _bound_holds(result, exact):
            return "|z − z*| exceeds its rigorous bound"
    return _lie_about_residual(result)


def _lie_about_residual(result: Result) -> str:
    if result.status not in (Status.SOLVED, Status.PRECISION_LIMIT):
        return ""
    problem = result.certificate.problem
    if result.status is Status.PRECISION_LIMIT:
        residuals = exact_residuals(problem, result.z)
        floors = rounding_floors(problem, result.z)
        explained = all(
            r <= FLOORS_MEASURED * floor for r, floor in zip(residuals, floors, strict=True)
        )
        if result.infeasibility is not None and result.infeasibility.is_rounding:
            explained |= max(exactly_weighted(problem, result.z)) <= Fraction(
                rounding_of_data(problem)
            ) * (1 + EPSILON)
        return "" if explained else "PRECISION_LIMIT, but rounding does not explain the residual"
    residuals = exactly_weighted(problem, result.z)
    references = _references(problem, exactly_weighted(problem, problem.nearest_to_zero))
    is_true = all(
        r <= Fraction(result.tolerance) * of for r, of in zip(residuals, references, strict=True)
    )
    return "" if is_true else "SOLVED, but the exact residual is above the tolerance"


def _references(problem: LCP, at_zero: Sequence[Any]) -> list[Any]:
    """Return the largest value of the component of each row."""
    from scipy.sparse.csgraph import (
        connected_components,
    )  # not our own components, which are judged here

    pattern = sp.csr_array(
        (np.ones(problem.csr.nnz), problem.csr.indices, problem.csr.indptr), shape=problem.csr.shape
    )
    labels = connected_components(pattern, directed=True, connection="weak")[1].tolist()
    largest: dict[int, Any] = {}
    for label, value in zip(labels, at_zero, strict=True):
        largest[label] = max(value, largest.get(label, value))
    return [largest[label] for label in labels]


def _bound_holds(result: Result, exact: Answer) -> bool:
    bound = result.error_bound
    if bound is None or bound.kind != "rigorous":
        return True
    rows = zip(result.z.tolist(), exact, bound.componentwise.tolist(), strict=True)
    return all(abs(Fraction(z) - answer) <= limit for z, answer, limit in rows)
