"""Exhaustive search: every solution, or a proof of none, against an enumeration written for the campaign."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from campaigns.search import Enumeration, random_problem, violations

from lcp_plugin import LCP, InvalidOption, InvalidProblem, UnsuitableProblem
from lcp_plugin.certificates.exact import is_exact_solution
from lcp_plugin.certificates.no_solution import Case, NoSolution
from lcp_plugin.certificates.refutation import row_choices
from lcp_plugin.conversions.bimatrix_game import lcp_from_bimatrix_game
from lcp_plugin.search import Found, GaveUp, all_solutions, explore, search


@pytest.mark.parametrize("block", range(8))
def test_random_problems_agree_with_an_enumeration(block: int) -> None:
    """Verdicts, solutions, faces, flags and proofs agree with Fourier–Motzkin over all patterns."""
    for case in range(10):
        bad, *_ = violations(*random_problem(np.random.default_rng([7, block, case]), largest=3))
        assert not bad


@pytest.mark.parametrize("n", [6, 8])
def test_isolated_solutions_agree_with_plain_enumeration(n: int) -> None:
    """On nondegenerate integer problems the solutions are those of all 2ⁿ nonsingular bases."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        M = rng.integers(-9, 10, (n, n)) + 9 * np.eye(n, dtype=int)
        q = rng.integers(-9, 10, n)
        expected = set()
        for mask in range(2**n):
            F = [i for i in range(n) if mask >> i & 1]
            block = M[np.ix_(F, F)]
            if round(np.linalg.det(block)) == 0:
                continue
            z = np.zeros(n)
            z[F] = np.linalg.solve(block, -q[F])
            if np.all(z >= -1e-9) and np.all(M @ z + q >= -1e-9):
                expected.add(tuple(np.round(z, 7) + 0.0))
        found = all_solutions(LCP(M, q))
        assert {tuple(np.round(s.z, 7) + 0.0) for s in found} == expected
        assert all(is_exact_solution(LCP(M, q), s.exact_z) for s in found)


GAMES = {
    "battle of the sexes": ([[2, 0], [0, 1]], [[1, 0], [0, 2]], 3),
    "matching pennies": ([[1, -1], [-1, 1]], [[-1, 1], [1, -1]], 1),
    "prisoner's dilemma": ([[3, 0], [5, 1]], [[3, 5], [0, 1]], 1),
    "rock paper scissors": ([[0, -1, 1], [1, 0, -1], [-1, 1, 0]], [[0, 1, -1], [-1, 0, 1], [1, -1, 0]], 1),
    "coordination of three": (np.eye(3), np.eye(3), 7),
    "chicken": ([[0, 7], [2, 6]], [[0, 2], [7, 6]], 3),
}


@pytest.mark.parametrize("name", GAMES)
def test_known_games_have_their_equilibria(name: str) -> None:
    """Textbook games have as many equilibria as the textbooks say, each without regret."""
    A, B, count = GAMES[name]
    problem = lcp_from_bimatrix_game(A, B)
    solutions = all_solutions(problem)
    assert len(solutions) == count
    for solution in solutions:
        assert solution.is_isolated
        assert problem.origin.recover(solution.z).regret < 1e-14


def test_a_degenerate_game_reports_a_face() -> None:
    """In a game without any payoff every pair of strategies is an equilibrium: one face of dimension 2."""
    problem = lcp_from_bimatrix_game(np.zeros((2, 2)), np.zeros((2, 2)))
    (face,) = all_solutions(problem)
    assert face.dimension == 2
    assert not face.is_isolated
    assert "face of dimension 2" in str(face)
    assert problem.origin.recover(face.z).regret == 0.0


def test_an_isolated_solution_beside_a_continuum_is_told_apart() -> None:
    """A block with a ray of solutions and a block with two points give two faces, in lexicographic order."""
    M = np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    found = all_solutions(LCP(M, [0.0, 1.0, -1.0]))
    assert [s.exact_z for s in found] == [(0, 0, 1), (0, 1, 1)]
    assert [s.dimension for s in found] == [1, 1]


def test_a_feasible_problem_without_solution_is_proven() -> None:
    """Feasible constraints, no solution: the tree covers all cases, verifies, and a damaged tree does not."""
    problem = LCP([[1.0, -2.0, 1.0], [-3.0, 2.0, -2.0], [1.0, -2.0, 0.0]], [-1.0, 2.0, 2.0])
    truth = Enumeration(problem.csr.toarray(), problem.q, problem.lower, problem.upper)
    proof = search(problem)
    assert truth.solvable_patterns() == []
    assert isinstance(proof, NoSolution)
    assert truth.is_linearly_feasible()
    assert proof.infeasibility is None
    assert proof.leaves > 1
    assert proof.verify()
    assert f"{proof.leaves} cases" in str(proof)
    branch = next(iter(proof.tree.branches))
    shortened = {key: case for key, case in proof.tree.branches.items() if key != branch}
    assert not NoSolution(problem, Case(proof.tree.row, shortened)).verify()
    assert not NoSolution(problem, Case(y=[Fraction(1)] * 3)).verify()
    assert not NoSolution(problem.with_q([1.0, 1.0, 1.0]), proof.tree).verify()


def test_a_linear_contradiction_is_found_by_the_search_too() -> None:
    """Where the linear constraints contradict, the proof is one Farkas vector."""
    proof = search(LCP([[0.0]], [-1.0]))
    assert isinstance(proof, NoSolution)
    assert proof.leaves == 1
    assert proof.infeasibility is not None
    assert proof.infeasibility.verify()


def test_the_answer_is_the_rounding_of_the_exact_one() -> None:
    """The answer is a third where 3 z = 1: exact in fractions, nearest in doubles."""
    (solution,) = all_solutions(LCP([[3.0]], [-1.0]))
    assert solution.exact_z == (Fraction(1, 3),)
    assert solution.z.tolist() == [1 / 3]
    assert solution.exact_w == (0,)
    assert solution.pattern == ("zero",)


def test_boxes_free_and_fixed_rows_take_part() -> None:
    """Three points on a box with M = −1; equations and fixed entries keep their place."""
    box = all_solutions(LCP([[-1.0]], [0.5], lower=[0.0], upper=[1.0]))
    assert [s.exact_z for s in box] == [(0,), (Fraction(1, 2),), (1,)]
    mixed = LCP([[2.0, 1.0], [0.0, 0.0]], [1.0, -7.0], lower=[-np.inf, 3.0], upper=[np.inf, 3.0])
    (solution,) = all_solutions(mixed)
    assert solution.exact_z == (-2, 3)
    assert solution.pattern == ("zero", "fixed")


def test_results_do_not_depend_on_the_run() -> None:
    """Two runs give the same solutions in the same order; `limit` keeps the first."""
    problem = lcp_from_bimatrix_game(np.eye(3), np.eye(3))
    first, second = all_solutions(problem), all_solutions(problem)
    assert [s.exact_z for s in first] == [s.exact_z for s in second] == sorted(s.exact_z for s in first)
    assert [s.exact_z for s in all_solutions(problem, limit=2)] == [s.exact_z for s in first[:2]]


def test_limits_end_the_search_honestly() -> None:
    """Too few nodes decide nothing; a problem too large is refused with its size."""
    problem = lcp_from_bimatrix_game(np.eye(3), np.eye(3))
    assert search(problem, first_only=False, max_nodes=3) == GaveUp(3)
    with pytest.raises(UnsuitableProblem, match="max_nodes=3"):
        all_solutions(problem, max_nodes=3)
    with pytest.raises(UnsuitableProblem, match=r"got 30 and n = 30"):
        search(LCP(np.eye(30), np.ones(30)))
    with pytest.raises(UnsuitableProblem, match=r"got 0 and n = 80"):
        search(LCP(np.eye(80), np.ones(80), lower=-np.inf))
    with pytest.raises(InvalidOption, match="limit"):
        all_solutions(problem, limit=0)
    with pytest.raises(InvalidProblem, match="LCP"):
        search(np.eye(2))  # type: ignore[arg-type]


def test_the_search_can_be_stopped_between_cases() -> None:
    """`explore` gives the clock back after each case and the outcome last."""
    steps = list(explore(LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])))
    assert steps[:-1] == [None] * (len(steps) - 1)
    assert isinstance(steps[-1], Found)


@pytest.mark.parametrize(
    ("bounds", "choices"),
    [((0.0, np.inf), 2), ((-np.inf, 0.0), 2), ((0.0, 1.0), 3), ((-np.inf, np.inf), 1), ((1.0, 1.0), 1)],
)
def test_every_row_has_its_choices(bounds: tuple[float, float], choices: int) -> None:
    """One-sided rows have two choices, boxes three, free and fixed rows one."""
    assert len(row_choices(*bounds)) == choices
