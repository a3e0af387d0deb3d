"""The stability atlas: exact answers are exact, no status is false, and scaling by powers of two changes no bit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from stability_atlas import FAMILIES, grid, half_active, mostly_free
from test_stability import assert_honest

from lcp_plugin import LCP, UnsuitableMatrix, UnsuitableProblem, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.proofs.exact import is_exact_solution

SCALE_INVARIANT = [name for name in REGISTRY if name not in ("newton", "interior_point", "lemke")]
CASES = [(family, case) for family in FAMILIES for case in FAMILIES[family]()]


# --- exact answers ---------------------------------------------------------------------------------------------------


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("family", "case"), CASES, ids=[f"{family}: {case.stress}" for family, case in CASES]
)
def test_every_case_has_a_verified_answer_or_none(family, case):
    """The answers of all cases solve their problems without rounding."""
    assert (case.exact is None) == (
        (case.stress.startswith("singular M, ") and "one" not in case.stress)
        or case.stress == "the answer overflows"
    )
    assert case.exact is None or is_exact_solution(case.problem, case.exact)


# --- the atlas -------------------------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("name", ["auto", "npsor", "psor", "newton", "lemke", "multigrid"])
def test_no_status_of_the_atlas_is_false(name):
    """SOLVED and PRECISION_LIMIT hold in rational arithmetic, and no proof excludes a solution that there is."""
    for _, case in CASES:
        try:
            result = solve(case.problem, name, z0=case.start, max_iterations=3000)
        except (UnsuitableMatrix, UnsuitableProblem):
            continue
        is_normal = np.abs(case.problem.q).max() >= np.finfo(float).tiny  # else slacks count as 0
        if case.problem.n <= 2500 and is_normal:
            assert_honest(result)
        if case.exact is not None:
            assert not result.has_no_solution, case.stress


# --- powers of two ---------------------------------------------------------------------------------------------------

POWERS = (-900, -451, -52, -1, 1, 52, 451, 900)


def bases() -> Iterator[LCP]:
    yield half_active("", grid(4, 4.5)).problem
    yield mostly_free("", grid(4)).problem
    yield half_active("", grid(4, 4.0, (-1.5, -1.25), (-0.5, -0.75))).problem


BASES = list(bases())


def in_powers_of_two(problem: LCP, row: Any, column: int) -> LCP:
    """Return the problem with rows multiplied by 2^row and all columns by 2^column, exactly."""
    M = problem.csr.copy()
    row = np.broadcast_to(row, problem.n)
    M.data = np.ldexp(M.data, np.repeat(row, np.diff(M.indptr)) + column)
    return LCP(M, np.ldexp(problem.q, row))


def variants(problem: LCP, power: int) -> Iterator[tuple[str, LCP, int]]:
    """Yield (what is scaled, the scaled problem, k with z · 2^k the scaled answer)."""
    rows = np.random.default_rng(abs(power)).integers(-abs(power), abs(power) + 1, problem.n)
    yield "M and q", in_powers_of_two(problem, power, 0), 0
    yield "M", in_powers_of_two(problem, 0, power), -power
    yield "q", in_powers_of_two(problem, power, -power), power
    yield "rows", in_powers_of_two(problem, rows, 0), 0


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", SCALE_INVARIANT)
def test_powers_of_two_change_no_bit(name):
    """M, q and rows times 2^k, k from −900 to 900, give the same iterations and exactly scaled z.

    For multigrid this requires the same power of two for all rows, because its grids compare rows.
    """
    for problem in (*BASES, half_active("", grid(12, 4.5)).problem):
        plain = solve(problem, name)
        for power in POWERS:
            for what, scaled, exponent in variants(problem, power):
                if (name, what) == ("multigrid", "rows"):
                    continue
                result = solve(scaled, name)
                assert np.array_equal(result.z, np.ldexp(plain.z, exponent)), (what, power)
                assert (result.status, result.iterations) == (plain.status, plain.iterations), (
                    what,
                    power,
                )
