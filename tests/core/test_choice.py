"""The two decision tables of the automatic choice, row by row, and what its runs end with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from applications.table import Case
from small_families import falling_bodies
from textbook_scenes import murty

from lcp_plugin import LCP, Result, Status, gallery, solve
from lcp_plugin.algorithms import Algorithm, create
from lcp_plugin.auto import Auto
from lcp_plugin.core.matrix.matrix import Matrix
from lcp_plugin.core.matrix.symmetry import mean_coupling
from lcp_plugin.core.policy.stages import Stage
from lcp_plugin.gallery.stencil import stencil_matrix
from lcp_plugin.methods.direct import direct_methods, factor_passes

TARGET = 1e-8


def scattered(M: sp.sparray) -> sp.csr_array:
    """The matrix with its rows numbered without any order: no narrow band."""
    order = np.random.default_rng(0).permutation(M.shape[0])
    return sp.csr_array(M)[order][:, order]


def chain(n: int, *, dense: bool = False) -> LCP:
    """The Laplacian of a scattered string, or, dense, its inverse but for the scale: symmetric, slow for sweeps."""
    if dense:
        k = np.arange(1.0, n + 1.0)
        return LCP(np.minimum.outer(k, k) * (n + 1.0 - np.maximum.outer(k, k)), -k)
    M = sp.diags_array(
        [-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    return LCP(scattered(M), -np.ones(n))


def cycle(n: int, diagonal: float) -> LCP:
    """Row i: diagonal z_i + 2 z_{i+1} − 1; nonsymmetric, and far from monotone."""
    M = sp.diags_array(
        [[2.0], diagonal * np.ones(n), 2.0 * np.ones(n - 1)],
        offsets=[1 - n, 0, 1],
        format="csr",
        shape=(n, n),
    )
    return LCP(M, -np.ones(n))


def after(algorithm: Algorithm, iterations: int, rate: float) -> Stage:
    """A stage so many iterations old whose residual fell from 1 by that rate an iteration."""
    residuals = [(k, rate**k) for k in range(iterations + 1)]
    return Stage(algorithm, iterations=iterations, residuals=residuals)


def following(problem: LCP, stage: Stage, *, failed: bool = False) -> str | None:
    choice = Auto().next_step(problem, [stage], TARGET, failed)
    return None if choice is None else choice.algorithm.name


def names(result: Result) -> list[str]:
    return [stage.name for stage in result.stages]


# --- The first table ---------------------------------------------------------------------------------------------


def test_the_projected_type_iteration_comes_first() -> None:
    """Where nothing is proved about M, auto begins with npsor, and stays with it where it is quick."""
    for M in (cycle(2000, 2.0).M,):
        n = np.shape(M)[0]
        assert solve(LCP(M, -np.ones(n)), max_iterations=1).stages[0].name == "npsor"
    quick = sp.diags_array([-np.ones(199), 8.0 * np.ones(200), -np.ones(199)], offsets=[-1, 0, 1])
    assert names(solve(LCP(scattered(quick), -np.ones(200)), tolerance=1e-4)) == ["npsor"]
    without_diagonal = LCP([[2.0, 1.0], [-1.0, 0.0]], [-1.0, 1.0])  # no sweep on the second row
    assert names(solve(without_diagonal)) == ["path"]


def band(width: int, diagonal: float, coupling: float, n: int = 2000) -> LCP:
    """As many full diagonals on either side."""
    sides = [k for k in range(-width, width + 1) if k]
    M = sp.diags_array([coupling] * len(sides) + [diagonal], offsets=[*sides, 0], shape=(n, n))
    return LCP(M, -np.ones(n))


@pytest.mark.parametrize(
    ("problem", "first"),
    [
        (band(1, 2.0, -1.0), "banded"),
        (band(1, 2.0, 1.0), "banded"),
        (band(15, 1.0, 0.5), "banded"),
        (band(40, 1.0, 0.5), "npsor"),
        (band(15, 99.0, 0.5), "psor"),
        (band(1, 2.0, 1.0, n=128), "rounds"),
    ],
)
def test_what_comes_first(problem: LCP, first: str) -> None:
    """Narrow bands; psor where diagonal entries clearly outweigh rows; a small problem in one call; else npsor."""
    assert Auto().first(problem).algorithm.name == first


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ("obstacle_2d:size=100", ["npsor", "multigrid"]),
        ("obstacle_2d:size=40", ["npsor", "psor"]),
        ("paper_example_1:n=10000,delta=0.003", ["npsor", "multigrid"]),
        ("paper_example_1:n=10000,delta=0.03", ["npsor", "psor"]),
    ],
)
def test_large_free_regions_are_not_swept(scene: str, expected: list[str]) -> None:
    """The first sweeps are quick, yet no trial of psor comes where errors constant on what is free are slow."""
    assert names(solve(gallery.parse(scene).problem)) == expected


def test_few_points_off_the_contact_are_swept() -> None:
    """After one sweep almost all is off its bound by rounding's breadth, which is no free region."""
    problem = gallery.build("obstacle_2d", size=100).problem
    q = np.ones(problem.n)
    q[np.random.default_rng(3).integers(0, problem.n, 20)] = -3.0
    assert names(solve(LCP(problem.csr, q))) == ["npsor"]


def test_from_a_start_near_the_answer_sweeps_go_on() -> None:
    """Where the residual has little to fall, a local error is swept away, however large the free region is."""
    problem = gallery.build("obstacle_2d", size=100).problem
    z = solve(problem, tolerance=1e-12).z.copy()
    z[5050] += 1e-7 * np.abs(z).max()
    assert names(solve(problem, z0=z)) == ["npsor"]


@pytest.mark.parametrize("orientation", ["upper", "lower"])
def test_murty_s_exponential_problem_takes_no_time(orientation: str) -> None:
    """Either orientation, n = 200, is solved by three sweeps."""
    result = solve(murty(n=200, orientation=orientation).problem)
    assert result.is_solved
    assert result.iterations <= 3


def test_a_wall_at_rest_is_left_to_psor() -> None:
    """12 courses of 12 bricks, semidefinite: psor, whose first trial of a relaxation lasts 33 sweeps, converges."""
    result = solve(Case("brick_wall", {"courses": 12, "width": 12}).in_units("own")[0])
    assert result.is_solved
    assert names(result) == ["npsor", "psor"]


def test_sweeps_follow_multigrid_where_a_factor_is_too_large() -> None:
    """Where a factor is predicted to be too large psor comes after multigrid, and says so."""
    rng = np.random.default_rng(0)
    n = 12_000
    B = sp.csr_array(sp.random_array((n, n), density=3.0 / n, rng=rng))
    problem = LCP(sp.csr_array(B + B.T + 20.0 * sp.eye_array(n)), -np.ones(n))
    choice = Auto().next_step(problem, [after(create("multigrid", {}), 9, 1.0)], TARGET, True)
    assert choice is not None
    assert choice.algorithm.name == "psor"
    assert "predicted to be too large" in choice.because


def upwind(side: int, flow: float) -> LCP:
    """Diffusion and an upwind flow of that cell Péclet number, on a grid without any order."""
    M = scattered(
        stencil_matrix((side, side), 4.0 + 2.0 * flow, (-1.0, -1.0), (-1.0 - flow, -1.0 - flow))
    )
    return LCP(M, np.where(np.arange(side**2) % 3 == 0, 1.0, -1.0))


def asymmetric(n: int) -> LCP:
    """Dense, dominated by 1/1.2, and not symmetric."""
    rng = np.random.default_rng(0)
    M = -rng.random((n, n))
    np.fill_diagonal(M, 0.0)
    np.fill_diagonal(M, -1.2 * M.sum(1))
    z = np.maximum(rng.normal(size=n), 0.0)
    return LCP(M, np.where(z > 0, 0.0, rng.random(n)) - M @ z)


@pytest.mark.parametrize(
    ("problem", "slow", "second"),
    [
        (chain(1001), "npsor", "multigrid"),
        (chain(1000), "npsor", "newton"),
        (chain(1001, dense=True), "npsor", "interior_point"),
        (cycle(1001, -1.0), "npsor", "lemke"),
        (upwind(40, 0.0), "npsor", "multigrid"),
        (upwind(40, 20.0), "npsor", "psor"),
        (LCP([[0.0, 1.0], [0.0, 1.0]], [-1.0, -1.0]), "npsor", "lemke"),
        (chain(1001), "psor", "multigrid"),
        (asymmetric(400), "psor", "newton"),
    ],
)
def test_what_follows_slow_sweeps(problem: LCP, slow: str, second: str) -> None:
    """Multigrid on large sparse M, psor along a flow, newton for Z-matrices; others where no diagonal allows sweeps."""
    assert (
        following(problem, after(create(slow, {}), {"npsor": 10, "psor": 40}[slow], 0.9999))
        == second
    )


@pytest.mark.parametrize(
    ("problem", "failed", "second"),
    [
        (band(1, 2.0, 1.0), "banded", "npsor"),
        (chain(1001), "pgs", "newton"),
        (chain(1001), "psor", "multigrid"),
        (chain(20_001), "multigrid", "newton"),
    ],
)
def test_what_follows_a_method_that_fails(problem: LCP, failed: str, second: str) -> None:
    """Whatever fails hands over, however many rows there are."""
    assert following(problem, after(create(failed, {}), 9, 1.0), failed=True) == second


@pytest.mark.parametrize(
    ("share", "moves", "second"),
    [
        (0.6, [], "newton"),
        (0.4, [], None),
        (0.4, [50, 60, 58], "newton"),
        (0.4, [60, 60, 12], None),
        (0.4, [60, 60], None),
    ],
)
def test_slow_multigrid_hands_over(share: float, moves: list[int], second: str | None) -> None:
    """At half of what factors are predicted to cost; sooner where in each 20 steps as many unknowns come and go."""
    problem = LCP(stencil_matrix((150, 150), 4.0, (-1.0, -1.0), (-1.0, -1.0)), -np.ones(150**2))
    work = share * factor_passes(problem)
    stage = replace(after(create("multigrid", {}), 40, 0.9999), work=work, moves=moves)
    assert following(problem, stage) == second


def test_a_stage_counts_what_comes_to_bounds_and_leaves_them() -> None:
    """Window by window; nothing before there are two iterates."""
    problem, stage = LCP(np.eye(3), -np.ones(3)), Stage(create("multigrid", {}))
    for stage.iterations, z in enumerate(([0, 1, 1], [0, 0, 1], [1, 0, 1], [1, 0, 0])):
        stage.z = np.array(z, float)
        stage.watch_bounds(problem, 2)
    assert stage.moves == [2, 1]


def test_quick_sweeps_go_on_where_factors_are_dear() -> None:
    """Dense and not symmetric: a factor costs a hundred passes, and auto takes less than twenty."""
    assert solve(asymmetric(400)).work < 20


def test_one_sweep_solves_a_triangular_problem() -> None:
    """On a triangle of 200 rows one pgs sweep in the order of the triangle is exact."""
    result = solve(LCP(np.eye(200) - np.diag(np.ones(150), 50), -np.ones(200)))
    assert result.is_solved
    assert [(stage.name, stage.iterations) for stage in result.stages] == [("npsor", 1), ("pgs", 2)]


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


def order(problem: LCP) -> list[str]:
    """Names of the direct methods in their order."""
    return [choice.algorithm.name for choice in direct_methods(problem)]


MONOTONE = ["interior_point", "feasibility", "newton"]


@pytest.mark.parametrize(
    ("problem", "expected"),
    [
        (
            LCP([[2.0, -1.0], [-1.0 - 1e-13, 2.0]], [-1.0, 1.0]),
            ["newton", "interior_point", "feasibility", "lemke", "search"],
        ),
        (LCP([[2.0, 1.0], [1.0, 2.0]], [-1.0, 1.0]), [*MONOTONE, "lemke", "search"]),
        (
            LCP(sp.csr_array(np.kron(np.eye(4), [[1.0, 2.0], [-2.0, 1.0]])), -np.ones(8)),
            [*MONOTONE, "lemke", "search"],
        ),
        (
            LCP([[1.0, 2.0], [-2.0, 1.0]], [-1.0, 1.0]),
            ["lemke", *MONOTONE, "search"],
        ),  # paths are quicker there
        (
            LCP([[0.0, 1.0], [-1.0, 0.0]], [-1.0, 1.0]),
            ["lemke", *MONOTONE, "lemke", "search"],
        ),  # some pivots: a budget row
        (cycle(24, 1.0), ["newton", "lemke", "interior_point", "feasibility", "search"]),
        (cycle(501, 1.0), ["newton", "interior_point", "feasibility", "lemke"]),
        (cycle(24, -1.0), ["lemke", *MONOTONE, "search"]),
        (cycle(501, 0.0), ["lemke", *MONOTONE]),
        (cycle(2001, 0.0), ["interior_point", "newton", "feasibility", "lemke"]),
        (cycle(6001, 1.0), ["newton", "interior_point", "psor"]),
        (cycle(6001, -1.0), ["interior_point"]),
    ],
)
def test_the_order_of_direct_methods(problem: LCP, expected: list[str]) -> None:
    """By what M seems to be, whether its diagonal is positive, and what is too large to be tried."""
    assert order(problem) == expected


def test_a_method_without_an_end_in_sight_waits_for_the_others() -> None:
    """Newton after 20 steps, lemke after two paths' work: they come back at the end; each ends by itself."""
    problem, policy = cycle(25, 1.0), Auto()
    stages = [after(policy.first(problem).algorithm, 10, 1.0)]
    found, failed = [], True
    while (choice := policy.next_step(problem, stages, TARGET, failed)) is not None:
        found.append(choice.algorithm.name)
        failed = found.count(choice.algorithm.name) > 1 or choice.algorithm.name not in (
            "newton",
            "lemke",
        )
        stages.append(
            replace(after(choice.algorithm, 20, 1.0), work=4.0 * 25**3 / problem.nonzeros + 1.0)
        )
    assert found == [
        "newton",
        "lemke",
        "interior_point",
        "feasibility",
        "newton",
        "lemke",
    ]


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


def test_a_singular_wall_is_soon_left_by_rounds_on_its_band() -> None:
    """Rounds that swap the same rows again end, and an interior point follows: no lots are drawn before others try."""
    case = Case("brick_wall", {"courses": 8, "width": 6})
    result = solve(case.in_units("own")[0])
    assert result.is_solved
    assert result.stages[0].name == "banded"
    assert result.stages[0].iterations <= 60


def test_what_a_stage_did_without_a_label_is_counted() -> None:
    """The works of the stages sum up to that of the run, also where only some steps are labelled."""
    rng = np.random.default_rng(4)
    A, B = rng.random((2, 60, 60))
    game = LCP(np.block([[np.zeros((60, 60)), A], [B.T, np.zeros((60, 60))]]), -np.ones(120))
    result = solve(game)
    assert sum(stage.work for stage in result.stages) == pytest.approx(
        result.work, abs=len(result.stages) + 1.0
    )


# --- Few rows with a bound -------------------------------------------------------------------------------------------


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
        assert f"  {stage.name}, {stage.iterations} iterations" in result.explain()
        assert stage.because in result.explain()


def test_a_stage_that_gains_nothing_is_told_in_words() -> None:
    """Where npsor has no rate to reckon with, the next stage says so, and names no infinite number."""
    choice = Auto().next_step(
        cycle(24, 1.0), [after(create("npsor", {"scaling": "diagonal"}), 10, 1.0)], TARGET, False
    )
    assert choice is not None
    assert choice.because.startswith("npsor was not converging; ")


def test_a_large_program_begins_with_an_interior_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no factor of a large linear program is predicted to fit, it is factorised by the method that suits it."""
    monkeypatch.setattr("lcp_plugin.systems.factors.factor_fits", lambda matrix: False)
    m = 80
    A = sp.vstack(
        [sp.kron(sp.eye_array(m), np.ones((1, m))), sp.kron(np.ones((1, m)), sp.eye_array(m))]
    )
    costs = np.arange(m * m) % 7 + 1.0
    problem = LCP.from_qp(None, costs, A=sp.csr_array(A), b=np.ones(2 * m), lower=0.0)
    assert next(iter(direct_methods(problem))).algorithm.name == "interior_point"
