"""What a program's matrices say is computed once, and says the same of every program that shares them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.convex_programs import SOLVABLE, case

from lcp_plugin.core.errors import InvalidProblem
from lcp_plugin.problems.programs.conversion import QuadraticProgram, lcp_from_qp
from lcp_plugin.problems.programs.reductions import FoldedRows
from lcp_plugin.problems.programs.solution import QPSolution

NAMES = ("P", "c", "G", "h", "A", "b", "lower", "upper")
VECTORS = ("c", "h", "b", "lower", "upper")


def afresh(given: QuadraticProgram) -> QuadraticProgram:
    """Return the program of the same data that shares nothing."""
    return QuadraticProgram(**{name: getattr(given, name) for name in NAMES})


def moved(given: QuadraticProgram, rng: np.random.Generator) -> dict[str, Any]:
    """Return other vectors, some bounds and limits of which come or go."""
    slack = np.where(
        rng.random(given.h.size) < 0.2, np.inf, given.h + rng.uniform(0.0, 1.0, given.h.size)
    )
    return {
        "c": given.c + rng.normal(size=given.n),
        "h": slack,
        "b": given.b + rng.integers(0, 2, given.b.size),
        "lower": np.where(rng.random(given.n) < 0.2, -np.inf, given.lower - 0.5),
        "upper": given.upper + 0.25,
    }


@pytest.mark.parametrize("kind", SOLVABLE)
@pytest.mark.parametrize("seed", range(6))
def test_a_program_with_other_vectors_is_the_program_of_these_data(kind: str, seed: int) -> None:
    """Its complementarity problem, and what is recovered and measured, are those of a fresh program, bit by bit."""
    rng = np.random.default_rng([seed, SOLVABLE.index(kind)])
    first, _ = case(kind, seed, 0, 12)
    lcp_from_qp(first)
    shared = first.with_vectors(**moved(first, rng))
    ours, theirs = lcp_from_qp(shared), lcp_from_qp(afresh(shared))
    assert ours.origin.form == theirs.origin.form
    np.testing.assert_array_equal(ours.csr.toarray(), theirs.csr.toarray())
    for name in ("q", "lower", "upper"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    z = rng.normal(size=ours.n)
    left, right = (one.origin.recover(z) for one in (ours, theirs))
    for name in ("x", "multipliers"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    for name in ("primal_residual", "duality_gap", "objective"):
        assert getattr(left, name) == getattr(right, name)


def test_rows_that_contradict_their_bounds_come_and_go() -> None:
    """A row that is a bound in one program, and no bound in the next as it contradicts another, is seen as such."""
    first = QuadraticProgram(
        np.eye(2), [1.0, 1.0], G=[[1.0, 0.0], [-1.0, 0.0], [1.0, 1.0]], h=[1.0, 0.0, 5.0]
    )
    assert lcp_from_qp(first).n == lcp_from_qp(afresh(first)).n
    crossed = first.with_vectors(h=[1.0, -2.0, 5.0])
    assert FoldedRows.of(crossed).left.tolist() == [0, 1, 2]
    assert FoldedRows.of(crossed.with_vectors(h=first.h)).left.tolist() == [2]
    assert crossed.facts.accepted_proof() is not None


@pytest.mark.parametrize("name", VECTORS)
@pytest.mark.parametrize("wrong", [[np.nan, 0.0], [0.0], "two"])
def test_other_vectors_are_checked(name: str, wrong: Any) -> None:
    """A vector of another length, of text or with a NaN is refused in words."""
    first = QuadraticProgram(np.eye(2), [1, 1], G=np.eye(2), h=[1, 1], A=np.eye(2), b=[1, 1])
    with pytest.raises(InvalidProblem, match=name):
        first.with_vectors(**{name: wrong})


def exactly(row: Any, x: Any) -> Fraction:
    """Return a sum of products without rounding."""
    return sum(
        (Fraction(a) * Fraction(v) for a, v in zip(row.tolist(), x.tolist(), strict=True)),
        Fraction(0),
    )


@pytest.mark.parametrize("kind", [np.asarray, sp.csr_array])
def test_residuals_of_a_program_are_bounds(kind: Any) -> None:
    """If terms cancel, the primal residual is the exact one."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        P, G, A = (
            np.ldexp(rng.normal(size=(4, 4)), rng.integers(-20, 21, (4, 4))) for _ in range(3)
        )
        P, (x, equality, lower, upper), inequality = P + P.T, rng.normal(size=(4, 4)), rng.random(4)
        lower, upper, h, b = np.abs(lower), np.abs(upper), G @ x, A @ x
        c = -(P @ x + G.T @ inequality + A.T @ equality - lower + upper)
        program = QuadraticProgram(kind(P), c, kind(G), h, kind(A), b, x - 1.0, x)
        solution = QPSolution(program, x, inequality, equality, lower, upper)
        rows, at = np.vstack([np.column_stack([G, -h]), np.column_stack([A, -b])]), np.append(x, 1)
        exact = max(
            abs(exactly(row, at)) / Fraction(float(np.abs(row * at).max()))
            for i, row in enumerate(rows)
            if i >= 4 or exactly(row, at) > 0
        )
        assert abs(Fraction(solution.primal_residual) - exact) <= exact * Fraction(1, 2**40)
