"""A strategy for convex quadratic programs with exact solutions."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st

from ..core.lcp import LCP
from ..problems.programs.conversion import QuadraticProgram
from ..proofs.exact.rational import exact_slack
from .matrices import (
    SIGNED,
    blocks,
    positive_definite_matrices,
    positive_semidefinite_matrices,
    rows,
    sizes,
    vectors,
)
from .problems import ExactPoint, columns_of, complementary_rows, exact_offset, fractions_of


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
    matrices: st.SearchStrategy[Any] | None = None,
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
    hessians = matrices
    if hessians is None:
        hessians = positive_definite_matrices() | positive_semidefinite_matrices()
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
        terms = zip(fractions_of(x), exact_slack(LCP(P, c), x), fractions_of(c), strict=True)
        least = sum(
            (value * (gradient + linear) / 2 for value, gradient, linear in terms), Fraction(0)
        )
        program = QuadraticProgram(P, c, G, G @ x + gap, A, A @ x, lower, upper)
        answers = (x, multiplier, equality, np.maximum(reduced, 0.0), np.maximum(-reduced, 0.0))
        return program, QPAnswer._make([*map(fractions_of, answers), least])

    return convex()
