"""Conflicts: HiGHS finds each set infeasible, and feasible without any one member; both proofs are exact."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from lcp_plugin import LCP, QuadraticProgram, solve
from lcp_plugin.core import deadline
from lcp_plugin.proofs.conflict import find_conflict


def planted(seed: int, rows: int, unknowns: int) -> tuple[QuadraticProgram, int]:
    """Return a feasible program of inequalities and equalities to which 2 to 6 conflicting rows are added."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 7))
    point = rng.integers(-5, 6, unknowns)
    A = rng.integers(-3, 4, (rows, unknowns)) * (rng.random((rows, unknowns)) < 0.3)
    b = A @ point + rng.integers(0, 10, rows)
    C = 1.0 * rng.integers(-3, 4, (count, unknowns)) * (rng.random((count, unknowns)) < 0.5)
    y = rng.integers(1, 4, count - 1)
    C[-1] = -(y @ C[:-1])
    d = C @ point + 1.0
    d[-1] = -(y @ d[:-1]) - 1.0
    order, equal = rng.permutation(rows + count), min(3, rows)
    G, h = np.vstack([A, C])[order], np.append(b, d)[order]
    E = rng.integers(-2, 3, (equal, unknowns))
    bounds = (-20.0, 20.0) if seed % 2 else (-np.inf, np.inf)
    return QuadraticProgram(None, np.zeros(unknowns), G, h, E, E @ point, *bounds), count


def is_feasible(program: QuadraticProgram, members: list[int], most: float = 1e6) -> bool:
    """Return whether HiGHS finds a point up to some size of some rows of ``program.constraints``."""
    rows = program.constraints
    C, d = rows.matrix[members], rows.limit[members]
    equal = rows.is_equality[members]
    parts = {"A_ub": C[~equal], "b_ub": d[~equal], "A_eq": C[equal], "b_eq": d[equal]}
    kept = {name: part for name, part in parts.items() if part.shape[0]}
    return linprog(np.zeros(program.n), bounds=(-most, most), method="highs", **kept).status == 0


def assert_irreducible(program: QuadraticProgram, conflict: Any) -> None:
    """Let HiGHS and the exact proofs judge a conflict."""
    members = conflict.members
    assert conflict.is_irreducible
    assert conflict.verify()
    assert not is_feasible(program, members)
    assert all(is_feasible(program, [i for i in members if i != k]) for k in members)


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(30))
def test_a_planted_conflict_is_found(seed):
    """Conflicts of 2 to 6 rows among 50 to 2000, with equalities and bounds or without."""
    program, count = planted(seed, int(50 * 40 ** (seed / 29)), 4 + seed)
    conflict = solve(program).conflict
    assert_irreducible(program, conflict)
    assert len(conflict.members) <= max(count, program.n + 1)


def planted_in_floats(seed: int, rows: int) -> tuple[QuadraticProgram, list[int]]:
    """Return rows that hold with slack at a point, to which 2 to 6 dense conflicting rows of doubles are added."""
    rng, n = np.random.default_rng(seed), 30
    count = int(rng.integers(2, 7))
    G, point = rng.standard_normal((rows, n)), rng.standard_normal(n)
    h = G @ point + rng.uniform(size=rows)
    C, y = rng.standard_normal((count, n)), rng.uniform(size=count) + 0.2
    C[-1] = -(y[:-1] @ C[:-1]) / y[-1]
    d = C @ point + 1.0
    d[-1] = (-0.5 - y[:-1] @ d[:-1]) / y[-1]
    order = rng.permutation(rows + count)
    program = QuadraticProgram(
        np.eye(n), np.zeros(n), np.vstack([G, C])[order], np.append(h, d)[order]
    )
    return program, np.flatnonzero(order >= rows).tolist()


@pytest.mark.quick(1)
@pytest.mark.parametrize("rows", [50, 200, 800, 1600])
def test_dense_conflicts_made_in_floats_are_found_to_rounding(rows):
    """The planted rows are named, not 31 rows that conflict exactly; HiGHS finds a point without each of them."""
    program, own = planted_in_floats(4, rows)
    conflict = solve(program).conflict
    assert conflict.members == own
    assert (conflict.is_exact, conflict.is_irreducible, conflict.verify()) == (False, True, False)
    assert not is_feasible(program, own)
    assert all(is_feasible(program, [i for i in own if i != k]) for k in own)


def test_a_conflict_within_a_radius_says_so():
    """A singular M in decimals contradicts its loads up to rounding: no infinite bound is named, no point is exact."""
    v = np.array([1.0, 0.1, 0.3])
    conflict = solve(LCP(np.outer(v, v), [1.0, 0.0, 0.0], lower=-np.inf)).conflict
    assert all(name.startswith("w = 0 in row") for name in conflict.names)
    assert "checked for all x up to" in str(conflict)
    assert (conflict.verify(), conflict.point(0), conflict.is_exact) == (False, None, False)
    assert 1e8 < conflict.radius < np.inf


def test_an_idle_bound_is_no_member():
    """The rows 3 x ≤ −2 and −x ≤ −3 conflict, whatever the bounds −1 ≤ x ≤ 2^58 are."""
    program = QuadraticProgram(None, [0.0], [[3.0], [-1.0]], [-2.0, -3.0], lower=-1, upper=2.0**58)
    conflict = solve(program).conflict
    assert conflict.names == ["row 0 of G", "row 1 of G"]
    assert_irreducible(program, conflict)
    rows, y = program.constraints.as_rows, {0: Fraction(2), 1: Fraction(7), 3: Fraction(1)}
    assert find_conflict(rows, program.name, y).members == [0, 1]


def test_random_conflicts_have_no_idle_member(draws):
    """Without any one member of a set, of integers, decimals or any doubles, HiGHS finds a point below 1e7."""
    for seed in draws(200, 20):
        rng = np.random.default_rng(seed)
        n, m = int(rng.integers(1, 6)), int(rng.integers(4, 12))
        G = rng.integers(-6, 7, (m, n)) * (rng.random((m, n)) < 0.7)
        unit = (1.0, 10.0, rng.uniform(0.5, 2.0, n))[seed % 3]
        upper = np.where(rng.random(n) < 0.3, 2.0 ** int(rng.integers(0, 60)), np.inf)
        lower = np.where(rng.random(n) < 0.5, 0.0, -np.inf)
        h = rng.integers(-6, 4, m) / 10.0
        program = QuadraticProgram(None, np.zeros(n), G / unit, h, lower=lower, upper=upper)
        if (conflict := solve(program).conflict) is None:
            continue
        members = conflict.members
        assert conflict.is_irreducible
        assert conflict.verify() == conflict.is_exact
        assert not is_feasible(program, members, 1e7)
        assert all(is_feasible(program, [i for i in members if i != k], 1e7) for k in members)


PUBLISHED = {  # G x ≤ h, bounds of x, the rows of the published set, and its bounds
    "SAS/OR, Finding an Irreducible Infeasible Set": (
        [[-1, -1, 0], [1, 0, 1], [0, 1, 1], [0, -1, -1]], [-10, 4, 5, -4],
        (0, [np.inf, np.inf, 3]), {"row 0 of G", "row 1 of G", "row 2 of G", "lower[2]"},
    ),
    "R. Pratt, contradictory constraints in SAS": (
        [[-1, -2]], [-220], (0, [60, 50]), {"row 0 of G", "upper[0]", "upper[1]"},
    ),
    "Mathematical Programming Glossary, IIS": (
        [[1, 1], [1, -1], [-1, 1], [-1, -1]], [1, 0, 0, -2],
        (-np.inf, np.inf), {"row 0 of G", "row 3 of G"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("source", PUBLISHED)
def test_the_published_set_is_found(source):
    """Each of these models of textbooks has one irreducible infeasible set."""
    G, h, bounds, members = PUBLISHED[source]
    program = QuadraticProgram(None, np.ones(len(G[0])), G, h, None, None, *bounds)
    conflict = solve(program).conflict
    assert set(conflict.names) == members
    assert_irreducible(program, conflict)


def test_dependent_equalities_are_reduced():
    """A proof by three rows, equalities that depend on one another among them, is reduced to two rows."""
    A = [[1.0, 1.0], [2.0, 2.0], [1.0, 1.0], [1.0, -1.0]]
    program = QuadraticProgram(None, [0, 0], A=A, b=[1, 2, 3, 0])
    rows = program.constraints.as_rows
    y = {0: Fraction(3), 1: Fraction(-1), 2: Fraction(-1)}
    conflict = find_conflict(rows, program.name, y)
    assert len(conflict.members) == 2
    assert_irreducible(program, conflict)
    with deadline.limit(-1.0):
        limited = find_conflict(rows, program.name, y)
    assert (limited.members, limited.is_irreducible) == ([0, 1, 2], False)


def test_a_proof_with_hundreds_of_rows_is_reduced():
    """The conflict of 1000 rows and 200 unknowns is irreducible."""
    program, _ = planted(3, 1000, 200)
    assert_irreducible(program, solve(program).conflict)


def test_an_lcp_without_signs_names_row_and_bound():
    """The row of w and the bound of z conflict; without one of them z exists, in a box and with w ≤ 0 also."""
    conflict = solve(LCP([[-1, 0], [0, 1]], [-1, 2], names=["market", "price"])).conflict
    assert conflict.names == ["w ≥ 0 in market", "market ≥ 0"]
    assert conflict.verify()
    upper = solve(LCP([[-1.0]], [1.0], lower=-np.inf, upper=0.0)).conflict
    assert upper.names == ["w ≤ 0 in row 0", "z[0] ≤ 0"]
    assert upper.verify()


def test_cvxpy_lists_what_conflicts_as_written():
    """A demand above a capacity: three constraints of the user, in the user's words."""
    ship = cp.Variable(4, name="ship", nonneg=True)
    stated = [
        cp.sum(ship) <= 10,
        ship[0] >= 4,
        cp.sum(ship[1:]) >= 7,
        ship <= 8,
        ship[3] <= ship[1],
    ]
    problem = cp.Problem(cp.Minimize(ship @ np.arange(4.0)), stated)
    problem.solve(method="LCP")
    result = problem.solver_stats.extra_stats
    assert "print(result.conflict)" in result.explain()
    assert sorted(result.conflict.names) == sorted(
        ["sum(ship) <= 10.0", "4.0 <= ship[0]", "7.0 <= sum(ship[1:4])"]
    )
