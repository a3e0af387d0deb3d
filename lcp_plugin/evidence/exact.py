"""The exact solution of a problem whose active set is known, and the error of a point."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from ..core.checks import FloatVector
from ..core.errors import UnsuitableProblem
from ..core.lcp import LCP
from ..proofs.exact.linear_systems import solved_nearby
from ..proofs.exact.rational import (
    exact_slack,
    is_exact_solution,
    power_of_two,
    rational_rows,
)
from ..systems.equilibration import equilibrating_exponents

ExactPoint = tuple[Fraction, ...]
States = list[int]

AT_LOWER, FREE, AT_UPPER = -1, 0, 1
ALIKE = (1.0, 1.0, 1.0)  # passes of rows and columns that bring largest entries near 1


def exact_answer(problem: LCP, guess: Sequence[float]) -> ExactPoint:
    """Return z* in fractions, verified without rounding, from the active set of a guess.

    Parameters
    ----------
    problem : LCP
    guess : sequence of float, shape (n,)
        A point on the right bounds; unknowns strictly between their bounds are taken as free.

    Raises
    ------
    UnsuitableProblem
        If its free block is singular, or gives no solution.

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
    """Return z at the bounds, with w = 0 on the free rows; None if their block is singular."""
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


# --- how far z is from it -------------------------------------------------------------------------------------------


def relative_error(
    z: FloatVector, exact: ExactPoint, unit: float | FloatVector, *, has_line: bool = False
) -> float:
    """Return max_i |z_i − z*_i|/unit_i over max_i |z*_i|/unit_i, exact up to the last rounding; ∞ for x/0.

    Parameters
    ----------
    z : ndarray, shape (n,)
        Finite.
    exact : sequence of Fraction, shape (n,)
    unit : number or ndarray, shape (n,)
    has_line : bool
        All z* + t with t ≥ 0 are also solutions; the distance is to the nearest one.

    Examples
    --------
    >>> relative_error(np.array([1.0, 0.5]), (Fraction(1), Fraction(0)), np.ones(2))
    0.5
    """
    difference = [Fraction(value) - answer for value, answer in zip(z.tolist(), exact, strict=True)]
    if has_line and difference:
        along = max((max(difference) + min(difference)) / 2, Fraction(0))
        difference = [value - along for value in difference]
    units = [Fraction(value) for value in np.broadcast_to(unit, z.shape).tolist()]
    error, largest = (
        max((abs(value) / u for value, u in zip(side, units, strict=True)), default=Fraction(0))
        for side in (difference, exact)
    )
    if error == 0:
        return 0.0
    return nearest_double(error / largest) if largest else np.inf


def nearest_double(value: Fraction) -> float:
    """Return the float64 nearest to a fraction, ±∞ if it is beyond the range."""
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf
