"""The plan of the automatic choice, and how its runs end."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from applications.table import Case
from small_families import falling_bodies
from textbook_scenes import murty

from lcp_plugin import LCP, Result, Status, gallery, solve
from lcp_plugin.auto import plan
from lcp_plugin.core.matrix.matrix import Matrix
from lcp_plugin.core.matrix.symmetry import mean_coupling
from lcp_plugin.core.representation import format_count
from lcp_plugin.gallery.stencil import stencil_matrix

TARGET = 1e-8


def names(result: Result) -> list[str]:
    return [stage.name for stage in result.stages]


# --- The first table ---------------------------------------------------------------------------------------------


def band(width: int, diagonal: float, coupling: float, n: int = 2000) -> LCP:
    """As many full diagonals on either side."""
    sides = [k for k in range(-width, width + 1) if k]
    M = sp.diags_array([coupling] * len(sides) + [diagonal], offsets=[*sides, 0], shape=(n, n))
    return LCP(M, -np.ones(n))


@pytest.mark.parametrize(
    ("problem", "first"),
    [
        (band(1, 2.0, -1.0), "banded"),
        (band(40, 1.0, 0.5), "npsor"),
        (band(15, 99.0, 0.5), "psor"),
        (band(1, 2.0, 1.0, n=128), "rounds"),
        (LCP(np.eye(300) - np.diag(np.ones(250), 50), -np.ones(300)), "pgs"),
    ],
)
def test_the_plan_begins_with_a_stage_that_suits_the_matrix(problem: LCP, first: str) -> None:
    """Narrow bands, triangles, dominated rows and small problems have a stage of their own; npsor begins otherwise."""
    assert next(plan(problem, TARGET)).algorithm.name == first


@pytest.mark.parametrize("orientation", ["upper", "lower"])
def test_murty_s_exponential_problem_takes_no_time(orientation: str) -> None:
    """Either orientation, n = 200, is solved by three sweeps."""
    result = solve(murty(n=200, orientation=orientation).problem)
    assert result.is_solved
    assert result.iterations <= 3


@pytest.mark.parametrize("seed", range(3))
def test_no_scaling_changes_the_mean_coupling(seed: int) -> None:
    """Rows and columns by powers of two: the same to rounding; beside √(a c) of a tridiagonal M, ρ(J) is no larger."""
    rng = np.random.default_rng(seed)
    M = (
        np.diag(rng.uniform(3, 4, 30))
        - np.diag(rng.uniform(0, 5, 29), 1)
        - np.diag(rng.uniform(0, 0.2, 29), -1)
    )
    R, C = np.exp2(rng.integers(-30, 31, (2, 30)))
    here = mean_coupling(Matrix(M))
    for unit in (2.0**-600, 1.0, 2.0**600):  # whose squares are no doubles
        assert here == pytest.approx(mean_coupling(Matrix(unit * R[:, None] * M * C)), rel=1e-12)
    J = np.eye(30) - M / M.diagonal()[:, None]
    assert np.abs(np.linalg.eigvals(J)).max() <= here * (1 + 1e-9)


# --- The second table --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("contacts", [25, 40, 80])
def test_frictional_contact_is_solved_by_pivots_alone(contacts: int) -> None:
    """Copositive, neither symmetric nor H₊: up to 500 rows a compiled path comes first, of at most 3 n pivots."""
    problem = falling_bodies(contacts)
    result = solve(problem)
    assert result.is_solved
    assert names(result)[-1] in ("lemke", "path")
    assert result.work * problem.nonzeros <= 3.0 * problem.n**3


def test_a_game_is_left_to_its_pivots() -> None:
    """Where no diagonal entry is positive lemke has 20 n pivots before others are tried: all that the game takes."""
    rng = np.random.default_rng(4)
    A, B = rng.random((2, 90, 90))
    zero = np.zeros((90, 90))
    game = LCP(np.block([[zero, A], [B.T, zero]]), -np.ones(180))
    auto, lemke = solve(game), solve(game, "lemke")
    assert auto.is_solved
    assert lemke.is_solved
    assert auto.work <= 1.1 * lemke.work + 10.0


@pytest.mark.parametrize("is_dense", [True, False])
def test_a_budget_row_is_pivoted_before_it_is_factorised(is_dense: bool) -> None:
    """A portfolio holds few of its assets: a tenth of an interior point's work, however its full M is stored."""
    stated = Case("portfolio", {"assets": 200}).in_units("own")[0]
    problem = (
        stated if is_dense else LCP(stated.csr, stated.q, lower=stated.lower, upper=stated.upper)
    )
    assert problem.is_dense == is_dense
    auto, interior = solve(problem), solve(problem, "interior_point")
    assert auto.is_solved
    assert auto.work <= interior.work


def test_what_a_stage_did_without_a_label_is_counted() -> None:
    """The works of the stages sum up to that of the run, also where only some steps are labelled."""
    rng = np.random.default_rng(4)
    A, B = rng.random((2, 60, 60))
    game = LCP(np.block([[np.zeros((60, 60)), A], [B.T, np.zeros((60, 60))]]), -np.ones(120))
    result = solve(game)
    assert sum(stage.work for stage in result.stages) == pytest.approx(
        result.work, abs=len(result.stages) + 1.0
    )


# --- What runs end with ------------------------------------------------------------------------------------------


def test_no_positive_diagonal_is_needed() -> None:
    """A rotation, on which every splitting circles, and a game are solved."""
    assert solve(LCP([[0.0, 1.0], [-1.0, 0.0]], [-1.0, 1.0])).is_solved
    assert solve(gallery.parse("bimatrix_game").problem).is_solved


def test_where_gauss_seidel_diverges_a_direct_method_solves() -> None:
    """A cyclic P-matrix on which the sweeps diverge is no obstacle."""
    M = np.array([[1.0, 3.0, 0.0], [0.0, 1.0, 3.0], [3.0, 0.0, 1.0]])
    result = solve(LCP(M, -M @ [1.0, 1.0, 1.0]))
    assert result.is_solved
    assert not solve(LCP(M, -M @ [1.0, 1.0, 1.0]), "pgs").is_solved


@pytest.mark.full
def test_a_grid_with_strong_flows_is_solved_by_newton() -> None:
    """K + S, S skew and between any two nodes: sweeps and cycles diverge, and as a program its factors fill."""
    rng, m = np.random.default_rng(0), 50
    n = m * m
    flows = sp.coo_array(
        (5.0 * rng.normal(size=2 * n), rng.integers(n, size=(2, 2 * n))), shape=(n, n)
    ).tocsr()
    M = sp.csr_array(stencil_matrix((m, m), 4.0, [-1.0, -1.0], [-1.0, -1.0]) + flows - flows.T)
    z = np.where(rng.random(n) < 0.5, 0.0, rng.random(n))
    w = np.where(z == 0.0, rng.random(n), 0.0)
    result = solve(LCP(M, w - M @ z), max_seconds=60.0)
    assert result.is_solved
    np.testing.assert_allclose(result.z, z, atol=1e-12)
    assert [stage.name for stage in result.stages][-1] == "newton"


def test_an_infeasible_problem_ends_with_its_proof() -> None:
    """z₁ − z₂ ≥ 1 and z₂ − z₁ ≥ 1 contradict: INFEASIBLE by auto and after a direct method, never after sweeps."""
    problem = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0])
    for name in ("auto", "newton", "lemke", "interior_point"):
        result = solve(problem, name)
        assert result.status is Status.INFEASIBLE
        assert result.infeasibility.verify()
        assert result.stages[-1].name == "feasibility"
        assert str(result.infeasibility) in result.explain()
    swept = solve(problem, "pgs")
    assert swept.status not in (Status.SOLVED, Status.INFEASIBLE)
    assert swept.infeasibility is None
    assert len(swept.stages) == 1


def test_a_feasible_problem_without_solution_ends_with_its_proof() -> None:
    """NO_SOLUTION: w = (z₂ − 1, 1) is nonnegative for z₂ ≥ 1, but complementarity asks for z₂ = 0."""
    problem = LCP([[0.0, 1.0], [0.0, 0.0]], [-1.0, 1.0])
    result = solve(problem)
    assert result.status is Status.NO_SOLUTION
    assert result.infeasibility.verify()
    assert problem.slack(np.array([0.0, 2.0])).min() >= 0.0


def test_the_story_names_every_stage_with_its_reason() -> None:
    """explain() tells what ran, how much of the work it was, and why it came."""
    result = solve(gallery.build("obstacle_2d", size=40).problem)
    assert result.is_solved
    assert names(result)[:2] == ["npsor", "psor"]
    assert result.algorithm == "auto: " + ", ".join(names(result))
    assert (
        0.9 * result.work <= sum(stage.work for stage in result.stages) <= result.work
    )  # the rest: measuring
    for stage in result.stages:
        assert f"  {stage.name}, {format_count(stage.iterations, 'iteration')}" in result.explain()
        assert stage.because in result.explain()
