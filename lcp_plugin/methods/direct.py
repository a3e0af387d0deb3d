"""The methods that factorise, pivot or search, in the order of their prospects.

| M | direct methods, in this order |
|---|---|
| the diagonal positive and nothing else | newton, then as below |
| symmetric up to rounding, diagonal > 0; or M + Mᵀ is PSD | interior_point, feasibility, newton, lemke, search |
| the same, full, diagonal not > 0: budget rows | some pivots of lemke, then as above |
| M + Mᵀ is PSD, full, diagonal > 0, M not symmetric | lemke, interior_point, feasibility, newton, search |
| the same, sparse, a factor of M takes 10⁸ operations or more | newton, interior_point, feasibility, lemke, search |
| any other, diagonal > 0 | newton, lemke, interior_point, feasibility, search |
| a bimatrix game | lemke, and what any other has |
| any other: frictional contact | lemke, interior_point, feasibility, newton, search |
| any other, sparse, n > 500, diagonal > 0 | newton, interior_point, feasibility, lemke |
| any other, sparse, n > 2000 | interior_point, newton, feasibility, lemke |

Where the diagonal is negative throughout, as where M has the wrong sign, newton is left out beyond n = 5000. Each
runs until it ends; but where no theorem promises an end, newton and lemke have a turn of so many steps or pivots, and
wait, where they need more, until all others have had theirs (:class:`FallbackOrder`). Where a factor is too large by
the counts of its columns, newton and interior_point are left out, but not of programs. A row that contradicts its
bounds by itself brings `feasibility` to the front: it looks for a proof that there is no solution (n ≤ 5000); so does
a factor of a sparse symmetric M that meets a pivot of 0, of a structure that nothing holds, at any n. lemke takes n ≤
6000 (beyond, psor comes back at the end, until it stalls), `search` enumerates the cases in exact arithmetic (n ≤ 60,
at most 24 rows that leave a choice), up to a counted number of operations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.algorithm import Algorithm
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..core.matrix.row_sums import has_positive_diagonal
from ..core.matrix.symmetry import is_nearly_symmetric
from ..core.policy.stages import Choice, Stage
from ..core.splittings.projected_relaxation import PSOR
from ..core.tuning import (
    INTERIOR_STEPS,
    LINEAR_PROGRAM_UP_TO,
    PIVOTED_UP_TO,
    PIVOTS_FIRST_UP_TO,
    SEMIDEFINITENESS_UP_TO,
)
from ..proofs.no_solution.infeasibility import contradictory_row
from ..proofs.verdicts.report import is_negative
from ..systems.factors import sizes_of_factor
from .interior_point import InteriorPoint
from .lemke import Lemke, has_components_that_fit
from .lemke.games import is_game
from .newton.semismooth_newton import Newton

# Turns of lemke, in pivots by n, and of newton, in steps.
FIRST_PIVOTS = 8  # n by these come before an interior point on a dense M: a tenth of its work; a portfolio takes n/25
FULL_SHARE = 0.25  # of n² entries: however it is stored, a factor of such an M is a dense one
PIVOTS = 2.0
PIVOTS_BEFORE_PIQP_UP_TO = (
    2000  # rows: of frictional contact a path takes .1 (600 rows) to .4 (1 800) of PIQP's time
)
LARGE_FACTOR = (
    1e8  # operations; a factor of the program that has M in its rows takes 4 to 11 times as many
)
GAME_PIVOTS = (
    20.0  # where nothing else has good prospects: paths of random bimatrix games take 3 n to 13 n
)


def direct_methods(problem: LCP) -> Iterator[Choice]:
    """Yield the methods that factorise, pivot or search, in the order of the table."""
    left_out: list[str] = []
    yield from _by_prospects(problem, True, left_out)
    yield from _at_last(problem, True, left_out)


class FallbackOrder:
    """The direct methods one after the other; those whose turn is over go on where all others have failed.

    Each has at most two turns, so that there is an end. Where `prove_infeasibility` is False, nothing looks for proofs.

    Attributes
    ----------
    left_out : list of str
        What has been left out so far because it takes no problem as large, and up to where it goes.
    """

    def __init__(self, problem: LCP, *, prove_infeasibility: bool = True) -> None:
        self._problem, self._waiting = problem, list[Choice]()
        self.left_out: list[str] = []
        self._coming = _by_prospects(problem, prove_infeasibility, self.left_out)
        self._last = _at_last(problem, prove_infeasibility, self.left_out)
        self._now: Choice | None = None

    def first(self) -> Choice | None:
        """Return the method with the best prospects."""
        self._now = next(self._coming, None) or next(self._last, None)
        return self._now

    def after(self, stages: Sequence[Stage], goal: float, *, failed: bool) -> Choice | None:
        """Return what takes over from the last stage, or None to go on (where that failed: to end)."""
        stage = stages[-1]
        if failed and stage.least_residual > goal:  # all cases were looked at
            return None
        is_overdue = self._now is not None and has_had_its_turn(
            stage, self._now.turn, self._problem, goal
        )
        if not (failed or is_overdue):
            return None
        following = next(self._coming, None)
        if following is None and self._waiting:
            following = self._waiting.pop(0)
        if following is not None:
            if self._now is not None and not failed:
                self._waiting.append(
                    replace(self._now, because="the others have had their turn", turn=math.inf)
                )
        elif failed:
            following = next(self._last, None)
        self._now = following or self._now
        return following


def factor_passes(problem: LCP) -> float:
    """Return about how many passes over a sparse M factors take at the most; ∞ where one is too large.

    Of an interior point, twice what it takes as a rule. An operation of a factor is
    reckoned as an entry of a sweep: it takes .15 (cubes) to 2.5 times as long (strips).
    """
    return INTERIOR_STEPS * sizes_of_factor(problem.matrix)[1] / max(problem.nonzeros, 1)


def has_had_its_turn(stage: Stage, turn: float, problem: LCP, goal: float) -> bool:
    """Return whether a method has taken so many steps, or pivots by n, and shows no end; a pivot touches 2 n² entries.

    Newton's steps are factorisations, as those of interior_point.
    """
    if stage.algorithm.name == "lemke":
        return stage.work * problem.nonzeros > 2.0 * turn * problem.n**3
    return stage.iterations >= turn and stage.steps_to_go(goal) > turn


def is_of_convex_program(origin: Any) -> bool:
    """Return whether a problem of this origin states a convex program: only such are converted."""
    return bool(getattr(origin, "is_of_convex_program", False))


def _by_prospects(problem: LCP, prove_infeasibility: bool, words: list[str]) -> Iterator[Choice]:
    """Yield the methods in the order of the table; add to the words what is left out for its size."""
    from .search.stages import FeasibilityCheck

    lemke = Choice(Lemke(), "pivoting needs no property of M")
    if is_game(problem):
        yield replace(
            lemke, because="a game: Lemke and Howson's paths, one a label", turn=GAME_PIVOTS
        )
    is_kkt = getattr(problem.origin, "form", "") == "kkt"
    newton = Choice(Newton(), "guesses what is at a bound, solves for the rest")
    why = "steps strictly between the bounds; suits M, which is monotone or may be"
    interior = Choice(InteriorPoint(), why)
    check = Choice(FeasibilityCheck(), "is there a solution at all?")
    too_large = _too_large(problem, is_kkt=is_kkt)
    left_out = [
        one.algorithm for one in (check, lemke, newton, interior) if one.algorithm.name in too_large
    ]
    left_out += ([] if prove_infeasibility else [check.algorithm]) + (
        [lemke.algorithm] if is_game(problem) else []
    )
    row = contradictory_row(problem) if prove_infeasibility else None
    is_contradictory = row is not None and row.excludes(EPSILON)
    if is_contradictory:
        yield replace(check, because="one row contradicts its bounds by itself")
    elif newton.algorithm not in left_out and _suits_newton(problem):
        yield newton
        left_out.append(newton.algorithm)
    order = _order(problem, newton, lemke, interior, check)
    chosen = [choice for choice in order if choice.algorithm not in left_out]
    # A factor that fills in is better than no answer.
    chosen = chosen or [
        choice for choice in order if choice.algorithm in (newton.algorithm, interior.algorithm)
    ]
    runs = {choice.algorithm.name for choice in chosen} | (
        {check.algorithm.name} if not prove_infeasibility else set()
    )
    words += [said for name, said in too_large.items() if name not in runs]
    yield from chosen


def _order(
    problem: LCP, newton: Choice, lemke: Choice, interior: Choice, check: Choice
) -> list[Choice]:
    """Return them by their prospects, with their turns: what M seems to be, and whether its diagonal is positive."""
    is_positive, is_symmetric = (
        bool(has_positive_diagonal(problem.matrix).all()),
        is_nearly_symmetric(problem.matrix),
    )
    if _seems_monotone(problem):
        if problem.is_dense or problem.nonzeros > FULL_SHARE * problem.n**2:
            if not is_positive:
                few = Lemke(max_pivots=10 + problem.n // FIRST_PIVOTS, restarts=0)
                return [
                    Choice(few, "some pivots, before a factor of a dense M"),
                    interior,
                    check,
                    newton,
                    lemke,
                ]
            if not is_symmetric:
                return [replace(lemke, turn=PIVOTS), interior, check, newton]
        elif is_positive and not is_symmetric and sizes_of_factor(problem.matrix)[1] > LARGE_FACTOR:
            return [replace(newton, turn=INTERIOR_STEPS), interior, check, lemke]
        return [interior, check, newton, lemke]
    interior = replace(
        interior, because="M is not shown to be monotone, but interior points may do"
    )
    newton = replace(newton, turn=INTERIOR_STEPS)
    lemke = replace(lemke, turn=PIVOTS if is_positive else GAME_PIVOTS)
    if problem.is_dense or problem.n <= (
        PIVOTS_FIRST_UP_TO if is_positive else PIVOTS_BEFORE_PIQP_UP_TO
    ):
        return [newton, lemke, interior, check] if is_positive else [lemke, interior, check, newton]
    return [newton, interior, check, lemke] if is_positive else [interior, newton, check, lemke]


def _too_large(problem: LCP, *, is_kkt: bool) -> dict[str, str]:
    """Return the methods that take no problem as large, by their names, and what to say of each.

    A program has no other method that would be quicker than these of a factor, whatever it fills. Where the diagonal is
    negative newton's active sets change at random.
    """
    from ..systems.factors import factor_fits

    found = {}
    if problem.n > LINEAR_PROGRAM_UP_TO:
        found["feasibility"] = _up_to(
            "a look for a proof that there is no solution", LINEAR_PROGRAM_UP_TO, problem
        )
    if not has_components_that_fit(problem):
        found["lemke"] = _up_to("lemke", PIVOTED_UP_TO, problem)
    if not (
        is_kkt or problem.is_dense or problem.n <= LINEAR_PROGRAM_UP_TO or factor_fits(problem.csr)
    ):
        found |= {
            name: f"{name} (a factor of M is predicted to be too large)"
            for name in ("newton", "interior_point")
        }
    if is_negative(problem.matrix) and problem.n > LINEAR_PROGRAM_UP_TO:
        found.setdefault(
            "newton",
            _up_to("newton, where the diagonal is negative,", LINEAR_PROGRAM_UP_TO, problem),
        )
    return found


def _up_to(what: str, most: int, problem: LCP) -> str:
    return f"{what} (up to n = {most}; n = {problem.n} here)"


def _at_last(problem: LCP, prove_infeasibility: bool, words: list[str]) -> Iterator[Choice]:
    """Yield what is tried where all else has failed; add to the words as `_by_prospects` does."""
    from .search import LARGEST_CHOICES, is_searchable
    from .search.stages import ExhaustiveSearch

    if is_searchable(problem):
        search = ExhaustiveSearch(prove_infeasibility=prove_infeasibility)
        yield Choice(search, "few enough unknowns to try every choice of bounds to the end")
    else:
        words.append(f"the exhaustive search (up to {LARGEST_CHOICES} rows that leave a choice)")
    if problem.n > PIVOTED_UP_TO and has_positive_diagonal(problem.matrix).all():
        yield Choice(last_resort(problem), "the direct methods failed: sweeps to the end")


def last_resort(problem: LCP) -> Algorithm:
    """Return the method that auto follows to its end where nothing before it converges."""
    return Lemke() if problem.n <= PIVOTED_UP_TO else PSOR()


def _suits_newton(problem: LCP) -> bool:
    from ..proofs.verdicts import analyze

    return bool(has_positive_diagonal(problem.matrix).all()) and bool(analyze(problem).is_z_matrix)


def _seems_monotone(problem: LCP) -> bool:
    """Return whether the interior point method has good prospects; proves nothing."""
    if problem.n == 0:
        return False
    if is_of_convex_program(problem.origin):
        return True
    if bool(has_positive_diagonal(problem.matrix).all()) and is_nearly_symmetric(problem.matrix):
        return True
    from ..systems.definiteness import is_semidefinite_to_rounding, symmetric_part

    twice = symmetric_part(problem.M)
    if bool((twice.diagonal() < 0.0).any()):
        return False
    # The multipliers of a quadratic program have empty rows and columns there.
    rows = np.flatnonzero((twice != 0.0).sum(axis=1))  # the magnitudes may overflow
    if rows.size > SEMIDEFINITENESS_UP_TO:
        return False
    return not rows.size or is_semidefinite_to_rounding(twice[rows][:, rows]) is True
