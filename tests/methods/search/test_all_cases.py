"""The look at all cases in doubles, and what it gives: solutions, proofs, or neither (prove_infeasibility=False)."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from campaigns.search import random_problem

from lcp_plugin import LCP, InvalidOption, Status, solve, solve_batch
from lcp_plugin.methods.search import NoSolution, Solutions, all_solutions, explore, search
from lcp_plugin.methods.search.outlines import outline, whole_tree
from lcp_plugin.methods.search.stages import FIRST_ENTRIES
from lcp_plugin.proofs.exact.simplex import Effort
from lcp_plugin.proofs.no_solution.infeasibility import Case
from lcp_plugin.proofs.no_solution.proof import Choices

PROVEN = (Status.INFEASIBLE, Status.NO_SOLUTION)


def solved_exactly(A: list[list[Fraction]], b: list[Fraction]) -> list[Fraction] | None:
    """The solution of A x = b by elimination in fractions; None where A is singular."""
    n = len(b)
    rows = [[*row, value] for row, value in zip(A, b, strict=True)]
    for k in range(n):
        pivot = next((i for i in range(k, n) if rows[i][k]), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k and rows[i][k]:
                rows[i] = [a - rows[i][k] * p for a, p in zip(rows[i], rows[k], strict=True)]
    return [row[n] for row in rows]


def has_solution(M: np.ndarray, q: np.ndarray) -> bool:
    """Whether one of the 2ⁿ complementary bases has a nonnegative solution, in fractions; none may be singular."""
    n = q.size
    exact = [[Fraction(float(value)) for value in row] for row in M]
    right = [Fraction(float(value)) for value in q]
    for is_free in product((False, True), repeat=n):
        columns = [
            [-exact[i][j] if is_free[j] else Fraction(int(i == j)) for j in range(n)]
            for i in range(n)
        ]
        x = solved_exactly(columns, right)
        assert x is not None
        if min(x) >= 0:
            return True
    return False


def drawn(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Standard normal M and q."""
    rng = np.random.default_rng([31, seed, n])
    return rng.standard_normal((n, n)), rng.standard_normal(n)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_the_status_agrees_with_all_complementary_bases(n: int) -> None:
    """SOLVED where one of the 2ⁿ bases solves in exact arithmetic, else a proof that verifies; never neither."""
    for seed in range(60 if n < 5 else 25):
        M, q = drawn(seed, n)
        problem = LCP(M, q)
        result = solve(problem)
        if has_solution(M, q):
            assert result.is_solved
        else:
            assert result.status in PROVEN
            assert result.infeasibility.verify()
        assert solve(problem, prove_infeasibility=False).is_solved is result.is_solved


@pytest.mark.sampled(3)
@pytest.mark.parametrize("block", range(6))
def test_what_doubles_exclude_is_never_believed_unverified(block: int) -> None:
    """Degenerate problems with boxes, free and fixed rows: the tree, repaired exactly, ends as the search does."""
    for case in range(60):
        M, q, lower, upper = random_problem(np.random.default_rng([31, block, case]), largest=4)
        problem = LCP(M, q, lower=lower, upper=upper)
        seen, truth = outline(problem, FIRST_ENTRIES), search(problem)
        if seen.tree is not None and NoSolution(problem, seen.tree).verify():
            assert isinstance(truth, NoSolution)
        repaired = [
            outcome for outcome in explore(problem, Effort(), tree=seen.tree) if outcome is not None
        ][-1]
        assert type(repaired) is type(truth)
        if isinstance(repaired, NoSolution):
            assert repaired.verify()


@pytest.mark.parametrize("n", [3, 6, 8, 12])
def test_planted_problems_are_never_infeasible(n: int) -> None:
    """Integer data, a solution with active, inactive and degenerate rows: solved, with a look for proofs or without."""
    for seed in range(40):
        rng = np.random.default_rng([32, seed, n])
        M = rng.integers(-4, 5, (n, n)).astype(float)
        z = np.where(rng.random(n) < 0.5, rng.integers(1, 4, n), 0).astype(float)
        w = np.where((z == 0) & (rng.random(n) < 0.7), rng.integers(1, 4, n), 0).astype(float)
        problem = LCP(M, w - M @ z)
        seen = outline(problem, FIRST_ENTRIES)
        assert seen.tree is None or not NoSolution(problem, seen.tree).verify()
        for prove_infeasibility in (True, False):
            result = solve(problem, prove_infeasibility=prove_infeasibility)
            assert result.is_solved
            assert result.infeasibility is None


def test_random_problems_are_decided() -> None:
    """Of 200 standard normal 8×8 each is SOLVED or proved to have no solution, and every proof verifies."""
    rng = np.random.default_rng(7)
    batch = solve_batch(rng.standard_normal((200, 8, 8)), rng.standard_normal((200, 8)))
    assert set(batch.status) <= {Status.SOLVED, *PROVEN}
    assert all(batch[k].infeasibility.verify() for k in range(200) if batch.status[k] in PROVEN)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["auto", "newton", "lemke", "interior_point"])
def test_without_prove_infeasibility_nothing_is_proved(name: str) -> None:
    """STALLED with words that say why, and no proof, where prove_infeasibility=True ends INFEASIBLE."""
    problem = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0])
    assert solve(problem, name).status is Status.INFEASIBLE
    result = solve(problem, name, prove_infeasibility=False)
    assert result.status is Status.STALLED
    assert result.infeasibility is None
    assert "not proved infeasible: you asked for no proof" in result.advice


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_solutions_are_looked_for_where_no_proof_is(seed: int) -> None:
    """What the search of all cases finds with proofs, it finds with prove_infeasibility=False: it saves no answers."""
    rng, n = np.random.default_rng(seed), 40
    M, z = rng.standard_normal((n, n)), np.where(rng.random(n) < 0.5, rng.random(n), 0.0)
    problem = LCP(M, np.where(z > 0.0, 0.0, rng.random(n)) - M @ z)
    assert solve(problem, prove_infeasibility=False).status is Status.SOLVED


def test_a_watched_run_without_prove_infeasibility_ends_alike() -> None:
    """With a record of the steps the run is driven, and ends after the look at all cases as well."""
    problem = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0])
    result = solve(problem, prove_infeasibility=False, record=True)
    assert np.array_equal(result.z, solve(problem, prove_infeasibility=False).z)
    assert result.status is Status.STALLED
    assert result.stages[-1].name == "search"
    assert "not proved infeasible: you asked for no proof" in result.advice
    assert "in double precision every case contradicts" in result.advice


@pytest.mark.sampled(1)
@pytest.mark.parametrize("prove_infeasibility", [True, False])
def test_a_batch_answers_as_solve_does(prove_infeasibility: bool) -> None:
    """Status, z and iterations, bit for bit; of boxes and warm starts too."""
    rng = np.random.default_rng(5)
    M, q, upper, z0 = (
        *(rng.standard_normal(s) for s in ((40, 5, 5), (40, 5))),
        rng.random((40, 5)),
        rng.random((40, 5)),
    )
    for more in ({}, {"upper": upper}, {"upper": upper, "z0": z0}):
        batch = solve_batch(M, q, prove_infeasibility=prove_infeasibility, **more)
        for k in range(40):
            bounds = {"upper": upper[k]} if more else {}
            start: Any = z0[k] if "z0" in more else None
            alone = solve(
                LCP(M[k], q[k], **bounds), prove_infeasibility=prove_infeasibility, z0=start
            )
            assert alone.status is batch.status[k] is batch[k].status
            assert np.array_equal(alone.z, batch.z[k])
            assert alone.iterations == batch.iterations[k]


def test_a_contradiction_within_the_tolerance_ends_nothing() -> None:
    """What contradicts by 5e-7 in every case is excluded at 1e-8, and solved at 1e-5, a proof looked for or not."""
    problem = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, 1.0 - 1e-6])
    assert solve(problem, prove_infeasibility=False).status is Status.STALLED
    assert solve(problem, prove_infeasibility=False, tolerance=1e-5).is_solved


def test_the_look_ends_by_counted_work() -> None:
    """No case is begun after so many entries of the tableau, and nothing is concluded then."""
    rng = np.random.default_rng(0)
    problem = LCP(rng.standard_normal((24, 24)), rng.standard_normal(24))
    assert outline(problem, FIRST_ENTRIES).entries > 1e4
    cut = outline(problem, 1.0)
    assert (cut.z, cut.tree, cut.least_residual, cut.cases) == (None, None, 0.0, 2)


def test_prove_infeasibility_is_true_or_false() -> None:
    """Anything else is refused by name."""
    for call in (
        lambda: solve(LCP([[1.0]], [1.0]), prove_infeasibility="no"),
        lambda: solve_batch([[[1.0]]], [[1.0]], prove_infeasibility=1),
    ):
        with pytest.raises(InvalidOption, match="prove_infeasibility must be True or False"):
            call()


@pytest.mark.full
def test_beyond_the_exact_search_what_doubles_exclude_is_proved_or_left_open() -> None:
    """More than 24 rows with a choice: a tree of doubles that cannot be verified is no proof, and nothing is raised."""
    n, random = 40, np.random.default_rng(40)
    M = random.standard_normal((n, n))
    M[:2] = 0.0
    M[0, 0], M[1, 0] = 1.0, -1.0  # z₀ ≥ 1, z₀ ≤ 1 − ε
    for gap in (1e-3, 1e-16, 1e-18):
        q = random.standard_normal(n)
        q[:2] = -1.0, 1.0 - gap
        result = solve(LCP(M, q))
        assert not result.has_no_solution or result.infeasibility.verify()


@pytest.mark.parametrize("seed", range(3))
def test_all_cases_of_a_game_but_its_equilibria_are_closed_in_doubles(seed: int) -> None:
    """Of 8 × 8 normal payoffs; each Farkas vector holds exactly, and what is left open are the solutions."""
    rng = np.random.default_rng(seed)
    problem = LCP.from_game(rng.standard_normal((8, 8)), rng.standard_normal((8, 8)))

    def open_leaves(case: Case, path: dict[int, str]) -> int:
        if case.branches:
            return sum(
                open_leaves(branch, {**path, case.row: choice})
                for choice, branch in case.branches.items()
            )
        return (
            1
            if case.y is None
            else int(not Choices(problem, path).excluded_by(dict(enumerate(case.y))))
        )

    assert open_leaves(whole_tree(problem), {}) == len(all_solutions(problem))


@pytest.mark.parametrize("seed", range(60))
def test_all_solutions_with_the_pass_in_doubles_are_those_without(seed: int) -> None:
    """Of small integers, with ties, boxes and free rows: the same faces, by their vertices, or no solution."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    M, q, chances = rng.integers(-2, 3, (n, n)), rng.integers(-2, 3, n), rng.random((2, n))
    lower, upper = np.where(chances[0] < 0.2, -np.inf, 0.0), np.where(chances[1] < 0.3, 2.0, np.inf)
    problem = LCP(M, q, lower=lower, upper=upper)
    plain = next(
        one for one in explore(problem, Effort(), first_only=False, tree=Case()) if one is not None
    )
    found = []
    for outcome in (search(problem, first_only=False), plain):
        solutions = outcome.solutions if isinstance(outcome, Solutions) else ()
        found.append(sorted((one.exact_vertices, one.dimension) for one in solutions))
    assert found[0] == found[1]


def test_an_exact_search_for_all_is_left_the_open_cases() -> None:
    """Of a game of 8 × 8 the exact simplex method multiplies less than a quarter of what it does with all cases."""
    rng = np.random.default_rng(0)
    problem = LCP.from_game(rng.standard_normal((8, 8)), rng.standard_normal((8, 8)))
    efforts = []
    for tree in (None, Case()):
        effort = Effort()
        list(explore(problem, effort, first_only=False, tree=tree))
        efforts.append(effort.products)
    assert efforts[0] < efforts[1] / 4
