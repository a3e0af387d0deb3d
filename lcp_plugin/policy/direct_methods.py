"""The methods that factorise, pivot or search, in the order of their prospects.

| M | direct methods, in this order |
|---|---|
| sparse, the diagonal positive and nothing else | newton, then as below |
| symmetric up to rounding, diagonal > 0; or M + Mᵀ is PSD | interior_point, feasibility, newton, lemke, search |
| any other | newton, feasibility, lemke and interior_point (the latter first where n > 1000), search |

They run on the presolved problem, each until it ends. Where a factor would fill in too much (n > 5000), newton and
interior_point are left out. A row that contradicts its bounds by itself brings `feasibility` to the front: it looks
for a proof that there is no solution (n ≤ 5000). lemke takes n ≤ 6000 (beyond, psor comes back at the end, until it
stalls), `search` looks at all cases of problems with at most 24 rows that leave a choice, until a counted number of
operations on long numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..algorithms import Algorithm, create
from ..algorithms.base import has_positive_diagonal
from ..certificates.infeasibility import contradictory_row
from ..conversions.presolve import presolve
from ..crossovers import DIRECT_UP_TO, LINEAR_PROGRAM_UP_TO, PIVOTED_UP_TO, SEMIDEFINITENESS_UP_TO
from ..problem.lcp import LCP
from .stages import Choice


def direct_methods(problem: LCP) -> Iterator[Choice]:
    """Yield the methods that factorise, pivot or search, in the order of the second table."""
    from ..algorithms.search import is_searchable
    from ..algorithms.search.stages import ExhaustiveSearch, FeasibilityCheck
    from ..matrix.factors import factor_fits

    reduced = presolve(problem)
    left = reduced.problem
    about = f" ({reduced})" if left is not problem else ""
    newton = Choice(create("newton", {}), f"the active set is guessed and its linear system solved{about}", reduced)
    interior = Choice(create("interior_point", {}), f"M is monotone, or may be{about}", reduced)
    check = Choice(FeasibilityCheck(), "is there a solution at all?")
    lemke = Choice(create("lemke", {}), f"pivoting needs no property of M{about}", reduced)
    left_out = [] if problem.n <= LINEAR_PROGRAM_UP_TO else [check]
    if not (left.is_dense or left.n <= LINEAR_PROGRAM_UP_TO or factor_fits(left.csr)):
        left_out += [newton, interior]
    if contradictory_row(problem) is not None:
        yield replace(check, because="one row contradicts its bounds by itself")
    elif newton not in left_out and not left.is_dense and _suits_newton(left):
        yield newton
        left_out.append(newton)
    if _seems_monotone(left, problem.origin):
        order = [interior, check, newton, lemke]
    else:
        order = [newton, check, interior, lemke] if left.n > DIRECT_UP_TO else [newton, check, lemke, interior]
    yield from (choice for choice in order if choice not in left_out)
    if is_searchable(problem):
        yield Choice(ExhaustiveSearch(), "few enough cases to look at all of them")
    if problem.n > PIVOTED_UP_TO and has_positive_diagonal(problem.matrix).all():
        yield Choice(last_resort(problem), "the direct methods failed: sweeps to the end")


def last_resort(problem: LCP) -> Algorithm:
    """Return the method that auto follows to its end where nothing before it arrives."""
    return create("lemke" if problem.n <= PIVOTED_UP_TO else "psor", {})


def _suits_newton(problem: LCP) -> bool:
    from ..matrix import analyze

    return bool(has_positive_diagonal(problem.matrix).all()) and bool(analyze(problem).is_z_matrix)


def _seems_monotone(problem: LCP, origin: Any) -> bool:
    """Return whether the interior point method has good prospects; proves nothing."""
    from ..conversions.qp_forms import QPOrigin
    from ..matrix.symmetry import is_nearly_symmetric

    if problem.n == 0:
        return False
    if isinstance(origin, QPOrigin):  # only convex programs are converted
        return True
    if bool(has_positive_diagonal(problem.matrix).all()) and is_nearly_symmetric(problem.matrix):
        return True
    from ..matrix.definiteness import is_semidefinite_to_rounding, symmetric_part

    twice = symmetric_part(problem.M)
    if bool((twice.diagonal() < 0.0).any()):
        return False
    # The multipliers of a quadratic program have empty rows and columns there.
    rows = np.flatnonzero((twice != 0.0).sum(axis=1))  # the magnitudes may overflow
    if rows.size > SEMIDEFINITENESS_UP_TO:
        return False
    return not rows.size or is_semidefinite_to_rounding(twice[rows][:, rows]) is True
