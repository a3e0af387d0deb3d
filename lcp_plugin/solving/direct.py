"""Methods that factorize, pivot or search, ordered by priority.

| M | methods, in this order |
|---|---|
| a Z-matrix with positive diagonal | newton, then as below |
| symmetric up to rounding, diagonal > 0; or M + Mᵀ is PSD | interior_point, feasibility, newton, lemke, search |
| the same, full, diagonal not > 0: budget rows | some pivots of lemke, then as above |
| M + Mᵀ is PSD, full, diagonal > 0, M not symmetric | lemke, interior_point, feasibility, newton, search |
| the same, sparse, a factorization of M takes 10⁸ operations or more | newton, interior_point, feasibility, lemke |
| any other, diagonal > 0 | newton, lemke, interior_point, feasibility, search |
| any other: frictional contact | lemke from r > 0, interior_point, feasibility, newton, lemke, search |
| no row has a bound | newton, interior_point, feasibility, lemke, search |
| a zero-sum game | interior_point, and the methods of a bimatrix game |
| a bimatrix game | lemke, and the methods of any other |
| any other, sparse, n > 500, diagonal > 0 | newton, interior_point, feasibility, lemke |
| any other, sparse, n > 2000 | interior_point, newton, feasibility, lemke |

If no theorem guarantees termination, newton has 20 steps and lemke a budget of pivots; both continue after all other
methods. If the diagonal is negative throughout, newton is omitted for n > 5000. If a factorization is too large by the
counts of its columns, newton and interior_point are omitted, except for programs. A row that is inconsistent with its
bounds puts `feasibility` first (n ≤ 5000). lemke takes n ≤ 6000; beyond, psor comes at the end. `search` enumerates
the active sets in exact arithmetic (n ≤ 60, at most 24 rows with several pieces), up to a counted number of operations.
If M + Mᵀ is not PSD and at most 4096 active sets exist (n ≤ 24), `search` comes first: it closes most of them by a few
tableaus.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..core.deadline import OutOfTimeError
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..core.structure import is_nearly_symmetric
from ..core.sweep_data import has_positive_diagonal
from ..core.tuning import LINEAR_PROGRAM_UP_TO, PIVOTED_UP_TO, PIVOTS_FIRST_UP_TO
from ..engines import has_piqp
from ..methods.interior_point import InteriorPoint, ZeroSumGame, skew_border, with_signed_equations
from ..methods.lemke import Lemke, rows_of_components
from ..methods.lemke.pivoting_path import is_game
from ..methods.newton import Newton
from ..methods.search import ExhaustiveSearch, FeasibilityCheck, has_few_active_sets, is_searchable
from ..proofs.no_solution import contradictory_row
from ..proofs.verdicts import MatrixReport, is_negative
from ..systems.definiteness import is_semidefinite_to_rounding, symmetric_part
from ..systems.factors import factor_fits, sizes_of_factor
from .explanation import last_resort
from .run import SPENT, Budget, Stage

SEARCHED = "few enough unknowns to try every choice of bounds to the end"
AGAIN = "the other methods found no solution"
PIVOTING = "pivoting needs no property of M"
CHECK = FeasibilityCheck(), "is there a solution at all?"
NEWTON = Newton(), "guesses which unknowns are at a bound, solves for the others"
INTERIOR = (
    InteriorPoint(),
    "steps strictly between the bounds; they reach a solution if M is monotone",
)
# times n, if other methods are unlikely to succeed: random games take 3 n to 13 n
GAME_PIVOTS = 20.0


def direct_methods(
    problem: LCP, goal: float, *, prove_infeasibility: bool = True
) -> Iterator[Stage]:
    """Yield the methods that factorize, pivot or search, in the order of the table.

    Parameters
    ----------
    problem : LCP
    goal : float
        The relative residual that the run needs.
    prove_infeasibility : bool
        If False, no method looks for proofs.
    """
    is_searched = has_few_active_sets(problem) and not _seems_monotone(problem)
    if is_searched:
        yield Stage(ExhaustiveSearch(), SEARCHED)
    is_positive = bool(has_positive_diagonal(problem.matrix).all())
    if game := is_game(problem):
        if ZeroSumGame.of(problem) is not None:
            yield Stage(InteriorPoint(), "a zero-sum game: a linear program")
        budget = _pivot_budget(problem, GAME_PIVOTS)
        yield Stage(Lemke(), "a game: Lemke and Howson's paths, one a label", budget)
    unfit = _too_large(problem) | ({"lemke"} if game else set())
    unfit |= set() if prove_infeasibility else {"feasibility"}
    unfit |= set() if has_piqp() else {"interior_point"}
    row = contradictory_row(problem) if prove_infeasibility else None
    if row is not None and row.excludes(EPSILON):
        yield Stage(FeasibilityCheck(), "one row is inconsistent with its bounds")
    elif "newton" not in unfit and is_positive and MatrixReport(problem).is_z_matrix:
        yield Stage(*NEWTON)
        unfit.add("newton")
    order = [Stage(*row) for row in _order(problem, goal, is_positive=is_positive)]
    named = {stage.algorithm.name: stage for stage in order}  # the last of two
    newton, lemke = named["newton"], named["lemke"]
    fit = [stage for stage in order if stage.algorithm.name not in unfit]
    # A factorization that fills in is better than no result.
    fit = fit or [stage for stage in order if stage is newton or stage.algorithm is INTERIOR[0]]
    last = [fit.pop()] if fit[-1] is lemke else []
    yield from fit
    if newton.ending == SPENT:
        yield Stage(newton.algorithm, AGAIN)
    yield from last
    if lemke.ending == SPENT and not last:
        yield Stage(lemke.algorithm, AGAIN)
    if is_searchable(problem) and not is_searched:
        yield Stage(ExhaustiveSearch(), SEARCHED)
    if problem.n > PIVOTED_UP_TO and is_positive:
        yield Stage(last_resort(problem), "the direct methods failed: sweeps to the end")


def factor_passes(problem: LCP) -> float:
    """Return the work of the factorizations of an interior point, at most, in passes over a sparse M; ∞ if too large.

    An operation of a factorization counts as an entry of a sweep: it takes .15 (cubes) to 2.5 times as long (strips).
    """
    return 20 * sizes_of_factor(problem.matrix)[1] / max(problem.nonzeros, 1)


def _pivot_budget(problem: LCP, most: float) -> Budget:
    """Return the budget of most · n pivots of lemke; each touches 2 n² entries."""
    entries = 2.0 * most * problem.n**3
    return Budget(f"{most:.0f} n pivots", lambda stage: stage.work * problem.nonzeros > entries)


def _order(problem: LCP, goal: float, *, is_positive: bool) -> list[tuple[Any, ...]]:
    """Return the methods by priority: algorithm, reason, and a budget if it has one."""

    def exceeds_steps(stage: Stage) -> bool:  # as many factorizations as interior_point needs
        return stage.iterations >= 20 and stage.trend.steps_to_go(goal) > 20

    # For a convex program, a path from r > 0 ends in a solution if a solution exists: other starts do not help.
    restarts = 0 if getattr(problem.origin, "is_of_convex_program", False) else None
    lemke = Lemke(restarts=restarts), PIVOTING
    if _is_system(problem):
        return [NEWTON, INTERIOR, CHECK, lemke]
    is_symmetric = is_nearly_symmetric(problem.matrix)
    # The factorization of such an M is dense in any storage.
    is_full = problem.is_dense or problem.nonzeros > 0.25 * problem.n**2
    pivots = _pivot_budget(problem, 2.0 if is_positive else GAME_PIVOTS)
    some = (*lemke, pivots)
    last = some if not is_full and is_positive and problem.n > PIVOTS_FIRST_UP_TO else lemke
    newton = (*NEWTON, Budget("20 steps, if 20 more are not enough", exceeds_steps))
    if _seems_monotone(problem):
        if (skew_border(problem.matrix)[0] != 1.0).any():  # a program, after a scaling of rows
            return [INTERIOR, CHECK, NEWTON, last]
        if is_full and not is_positive:
            # A tenth of the work of an interior point on a dense M; a portfolio takes n/25 pivots.
            few = Lemke(max_pivots=10 + problem.n // 8, restarts=0)
            first = few, "some pivots, before a factorization of a dense M"
            return [first, INTERIOR, CHECK, NEWTON, last]
        if is_full and not is_symmetric:
            return [some, INTERIOR, CHECK, NEWTON]
        # Factorizing the program with M in its rows takes 4 to 11 times as many operations.
        if is_positive and not is_symmetric and sizes_of_factor(problem.matrix)[1] > 1e8:
            return [newton, INTERIOR, CHECK, last]
        return [INTERIOR, CHECK, NEWTON, last]
    # On frictional contact a path takes .1 (600 rows) to .4 (1 800 rows) of PIQP's time.
    up_to = PIVOTS_FIRST_UP_TO if is_positive else 2000
    if problem.is_dense or problem.n <= up_to:
        if is_positive:
            return [newton, some, INTERIOR, CHECK]
        # An arbitrary start takes an inverse: all of them take ten times as long as an interior point.
        path = Lemke(restarts=0), PIVOTING, pivots
        return [path, INTERIOR, CHECK, newton, last]
    return [newton, INTERIOR, CHECK, last] if is_positive else [INTERIOR, newton, CHECK, last]


def _too_large(problem: LCP) -> set[str]:
    """Return the names of the methods that take no problem as large.

    For a program, methods that factorize are the fastest, even with a large fill. If the diagonal is negative, newton's
    active sets change at random.
    """
    names = set()
    is_large = problem.n > LINEAR_PROGRAM_UP_TO
    if is_large:
        names.add("feasibility")
    if problem.n > PIVOTED_UP_TO < max(map(len, rows_of_components(problem))):
        names.add("lemke")
    if is_large and not (problem.is_kkt or problem.is_dense or factor_fits(problem.csr)):
        names |= {"newton", "interior_point"}
    if is_large and is_negative(problem.matrix) and not _is_system(problem):
        names.add("newton")
    return names


def _is_system(problem: LCP) -> bool:
    """Return whether no row has a bound, so that one factorization solves the problem."""
    return bool((problem.lower == -np.inf).all() and (problem.upper == np.inf).all())


def _seems_monotone(problem: LCP) -> bool:
    """Return whether the interior point method is likely to succeed; this is not a proof."""
    if problem.n == 0:
        return False
    if getattr(problem.origin, "is_of_convex_program", False):
        return True
    if bool(has_positive_diagonal(problem.matrix).all()) and is_nearly_symmetric(problem.matrix):
        return True
    twice = symmetric_part(with_signed_equations(problem).M)
    if bool((twice.diagonal() < 0.0).any()):
        return False
    # The multipliers of a quadratic program have empty rows and columns there.
    rows = np.flatnonzero((twice != 0.0).sum(axis=1))  # the magnitudes may overflow
    if rows.size > 20_000:  # a factorization for this question alone takes too long
        return False
    try:
        return not rows.size or is_semidefinite_to_rounding(twice[rows][:, rows]) is True
    except OutOfTimeError:  # a factor of fewer rows, the free ones, may fit
        return False
