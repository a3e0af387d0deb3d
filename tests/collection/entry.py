"""One problem of the collection: data, where it comes from, and what is true of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from oracles.truth import INFEASIBLE, NO_SOLUTION, SOLVABLE

from lcp_plugin import LCP

EXHAUSTIVE_UP_TO = 12  # unknowns; the search in truth.py decides these in well under a second

COTTLE_PANG_STONE = "Cottle, Pang, Stone, The Linear Complementarity Problem, SIAM 2009, doi:10.1137/1.9780898719000"
MURTY_BOOK = "Murty, Linear Complementarity, Linear and Nonlinear Programming, Heldermann 1988"
OWN = "made for this collection"


@dataclass(frozen=True, eq=False)
class Entry:
    """A problem whose answer is known.

    `truth` is "solvable", "infeasible" (the linear constraints contradict) or "no solution" (they do not, yet no z is
    complementary). `solution` is one solution without rounding, where we have one; a solvable entry without is small
    enough for exhaustive search, or names in `theorem` the theorem that gives its existence. `farkas` weights rows so
    that they contradict; an infeasible entry without is small.
    """

    name: str
    source: str
    problem: LCP = field(repr=False)
    truth: str = SOLVABLE
    solution: tuple[Fraction, ...] | None = field(default=None, repr=False)
    theorem: str = ""
    farkas: tuple[Fraction, ...] | None = field(default=None, repr=False)

    @property
    def is_small(self) -> bool:
        """Whether exhaustive search decides it."""
        return self.problem.n <= EXHAUSTIVE_UP_TO


def solvable(
    name: str,
    source: str,
    M: Any,
    q: Any,
    *,
    solution: Any = None,
    theorem: str = "",
    lower: Any = 0.0,
    upper: Any = np.inf,
) -> Entry:
    """Return a solvable entry; the solution may be given as numbers or as text such as "1/90"."""
    exact = None if solution is None else tuple(Fraction(x) for x in solution)
    problem = LCP(M, q, lower=lower, upper=upper)
    return Entry(name, source, problem, SOLVABLE, exact, theorem)


def planted(
    name: str, source: str, M: Any, z: Any, w: Any, *, lower: Any = 0.0, upper: Any = np.inf
) -> Entry:
    """Return the entry with q = w − M z, for data with few enough bits that this is exact."""
    z, w = np.asarray(z, dtype=float), np.asarray(w, dtype=float)
    return solvable(name, source, M, w - M @ z, solution=z.tolist(), lower=lower, upper=upper)


def infeasible(
    name: str,
    source: str,
    M: Any,
    q: Any,
    *,
    farkas: Any = None,
    lower: Any = 0.0,
    upper: Any = np.inf,
) -> Entry:
    """Return an entry whose linear constraints contradict each other."""
    weights = None if farkas is None else tuple(Fraction(int(y)) for y in farkas)
    problem = LCP(M, q, lower=lower, upper=upper)
    return Entry(name, source, problem, INFEASIBLE, farkas=weights)


def without_solution(
    name: str, source: str, M: Any, q: Any, *, lower: Any = 0.0, upper: Any = np.inf
) -> Entry:
    """Return an entry that is linearly feasible and has no solution."""
    return Entry(name, source, LCP(M, q, lower=lower, upper=upper), NO_SOLUTION)
