"""Exhaustive search: every solution, or a proof of none, against an enumeration written for the campaign."""

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.games import game, missed, wrong_equilibria
from campaigns.search import Enumeration, random_problem, violations
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, Status, UnsuitableProblem, all_solutions, solve
from lcp_plugin.methods.search import search
from lcp_plugin.proofs.exact import is_exact_solution
from lcp_plugin.proofs.no_solution import NoSolution


@pytest.mark.quick(1)
@pytest.mark.parametrize("block", range(8))
def test_random_problems_agree_with_an_enumeration(block, draws):
    """Verdicts, solutions, faces, flags and proofs agree with linear inequalities over all patterns."""
    for case in draws(10, 3):
        assert not violations(random_problem(np.random.default_rng([7, block, case]), largest=3))


GAMES = {
    "battle of the sexes": ([[2, 0], [0, 1]], [[1, 0], [0, 2]], 3),
    "prisoner's dilemma": ([[3, 0], [5, 1]], [[3, 5], [0, 1]], 1),
    "coordination of three": (np.eye(3), np.eye(3), 7),
}


@pytest.mark.parametrize("name", GAMES)
def test_known_games_have_their_equilibria(name):
    """Textbook games have as many equilibria as the textbooks say, each without regret."""
    A, B, count = GAMES[name]
    problem = LCP.from_game(A, B)
    solutions = all_solutions(problem)
    assert len(solutions) == count
    for solution in solutions:
        assert solution.is_isolated
        assert problem.origin.recover(solution.z).regret < 1e-14


def test_ties_of_integer_payoffs_are_kept():
    """Rows 0 and a half of 1 and 2 tie for the column player: the equilibria are a segment, as in the game itself."""
    problem = LCP.from_game([[7, 7], [13, 4], [3, 9]], [[1, 1], [0, 3], [3, 0]])
    (face,) = all_solutions(problem)
    ends = [problem.origin.recover(vertex) for vertex in face.vertices]
    np.testing.assert_allclose(
        [end.row_strategy for end in ends], [[0, 0.5, 0.5], [1, 0, 0]], rtol=1e-15
    )
    np.testing.assert_allclose(
        [end.column_strategy for end in ends], [[1 / 3, 2 / 3]] * 2, rtol=1e-15
    )


@pytest.mark.quick(1)
@pytest.mark.parametrize("odd", [None, 1e19, -1e19, 1e10, 1e-9, 1e-17])
def test_equilibria_are_those_of_the_payoffs(odd):
    """Extreme equilibria, ties included, agree with an exact enumeration of vertices."""
    rng = np.random.default_rng(7)
    for _ in range(12):
        A, B = game(rng, odd)
        assert not wrong_equilibria(A, B)
        if odd is None:
            assert not missed(A, B)


def test_a_degenerate_game_reports_a_face():
    """Every pair of strategies of a game with zero payoffs is an equilibrium: a face."""
    problem = LCP.from_game(np.zeros((2, 2)), np.zeros((2, 2)))
    (face,) = all_solutions(problem)
    assert face.dimension == 2
    assert not face.is_isolated
    assert "face of dimension 2" in str(face)
    assert problem.origin.recover(face.z).regret == 0.0


def test_every_pure_equilibrium_is_a_vertex_of_a_face():
    """If the row player's payoffs are equal, both pure equilibria are vertices of segments."""
    problem = LCP.from_game([[1, 1], [1, 1]], [[1, 0], [0, 1]])
    faces = all_solutions(problem)
    assert [face.dimension for face in faces] == [1, 1, 1]
    assert all(tuple(face.exact_z) in face.exact_vertices for face in faces)
    assert all(
        is_exact_solution(problem, vertex) for face in faces for vertex in face.exact_vertices
    )
    equilibria = [problem.origin.recover(vertex) for face in faces for vertex in face.vertices]
    assert all(equilibrium.regret == 0.0 for equilibrium in equilibria)
    strategies = {(*e.row_strategy.tolist(), *e.column_strategy.tolist()) for e in equilibria}
    assert strategies == {(1, 0, 1, 0), (0, 1, 0, 1), (0.5, 0.5, 1, 0), (0.5, 0.5, 0, 1)}
    assert str(faces[0]) == "z = (1/3, 1/3, 0, 1), a vertex of a face of dimension 1"


def test_vertices_of_faces_without_and_with_an_end():
    """A line has no vertex, as its text states, a ray one, a cube 2⁵, and an isolated solution is its own."""
    (line,) = all_solutions(LCP([[0, 0], [0, 1]], [0, -1], lower=[-np.inf, 0]))
    assert line.exact_vertices == ()
    assert line.vertices.shape == (0, 2)
    assert str(line) == "z = (0, 1), on a face of dimension 1 that contains a line"
    (ray,) = all_solutions(LCP([[0.0]], [0.0]))
    assert ray.exact_vertices == ((0,),)
    assert str(ray) == "z = (0), a vertex of a face of dimension 1"
    (cube,) = all_solutions(LCP(np.zeros((5, 5)), np.zeros(5), upper=1.0))
    assert cube.vertices.shape == (32, 5)
    (point,) = all_solutions(LCP([[3.0]], [-1.0]))
    assert point.exact_vertices == ((Fraction(1, 3),),)


def test_an_isolated_solution_beside_a_continuum_is_told_apart():
    """A block with a ray of solutions and a block with two points give two faces, in lexicographic order."""
    M = np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    found = all_solutions(LCP(M, [0.0, 1.0, -1.0]))
    assert [s.exact_z for s in found] == [(0, 0, 1), (0, 1, 1)]
    assert [s.dimension for s in found] == [1, 1]


def test_a_feasible_problem_without_solution_is_proven():
    """For feasible constraints without a solution, the tree verifies, but not for another q."""
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
    assert not NoSolution(problem.with_q([1.0, 1.0, 1.0]), proof.tree).verify()


def test_a_linear_contradiction_is_found_by_the_search_too():
    """If the linear constraints are inconsistent, the proof is one Farkas vector."""
    proof = search(LCP([[0.0]], [-1.0]))
    assert isinstance(proof, NoSolution)
    assert proof.leaves == 1
    assert proof.infeasibility is not None
    assert proof.infeasibility.verify()


def test_boxes_free_and_fixed_rows_take_part():
    """Three points on a box with M = −1; equations and fixed entries keep their place."""
    box = all_solutions(LCP([[-1.0]], [0.5], lower=[0.0], upper=[1.0]))
    assert [s.exact_z for s in box] == [(0,), (Fraction(1, 2),), (1,)]
    mixed = LCP([[2.0, 1.0], [0.0, 0.0]], [1.0, -7.0], lower=[-np.inf, 3.0], upper=[np.inf, 3.0])
    (solution,) = all_solutions(mixed)
    assert solution.exact_z == (-2, 3)
    assert solution.pattern == ("zero", "fixed")


GAME = LCP.from_game(np.eye(3), np.eye(3))


@refusals(r"""
all_solutions(GAME, max_nodes=3) → UnsuitableProblem: max_nodes=3
all_solutions(GAME, max_nodes=0) → InvalidOption: max_nodes
search(LCP(np.eye(30), np.ones(30))) → UnsuitableProblem: got 30 and n = 30
search(LCP(np.eye(80), np.ones(80), lower=-np.inf)) → UnsuitableProblem: got 0 and n = 80
search(np.eye(2)) → InvalidProblem: LCP
""")
def test_limits_end_the_search_honestly(call, words):
    """Too few nodes decide nothing; a problem that is too large raises an error with its size."""
    assert_refused(call, words, globals())
    assert search(GAME, first_only=False, max_nodes=3) is None


@pytest.mark.parametrize("seed", [14, 45, 52])
def test_more_pivots_than_twice_the_rows_end_within_all_bounds(seed):
    """Then Bland's rule chooses the row: one that is out of its bounds is never passed over."""
    rng = np.random.default_rng(seed)
    M, q = rng.integers(-3, 4, (15, 15)).astype(float), rng.integers(-3, 2, 15).astype(float)
    proof = search(LCP(M, q), max_nodes=200)
    assert isinstance(proof, NoSolution)
    assert proof.verify()


BEYOND_DOUBLES = LCP([[0.0, -1e-145], [1.0, 0.0]], [1e278, -1.0])  # its solution: (1, 1e423)


def test_a_solution_beyond_the_doubles_is_exact_and_never_infinite():
    """If z exceeds the range of doubles, exact_z is rational, and the rounded z raises an error."""
    (solution,) = all_solutions(BEYOND_DOUBLES)
    assert is_exact_solution(BEYOND_DOUBLES, solution.exact_z)
    assert solution.exact_z == (1, Fraction(1e278) / Fraction(1e-145))
    with pytest.raises(
        UnsuitableProblem, match=r"z\[1\] of the exact solution is about 2\^140[56], .* exact_z"
    ):
        solution.z  # noqa: B018
    assert solution.w.tolist() == [0.0, 0.0]


def test_auto_names_a_solution_beyond_double_precision():
    """A run whose only solution exceeds the range of doubles ends STALLED, with a message."""
    result = solve(BEYOND_DOUBLES)
    assert result.status is Status.STALLED
    assert np.isfinite(result.z).all()
    assert (
        "an enumeration of all active sets found a solution, but z[1] of the exact solution"
        in result.advice
    )


def test_energy_that_falls_for_ever_does_not_keep_the_run_from_a_proof():
    """The energy of a singular M without a solution is unbounded, and INFEASIBLE is proved."""
    line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20)).tolil()
    line[0, 0] = line[-1, -1] = 1.0
    M = sp.kronsum(line, line, format="csr")
    result = solve(LCP(M, np.full(400, -1e-3)), "multigrid")
    assert result.status is Status.INFEASIBLE
    assert result.iterations < 10_000
