"""analyze() of every problem class: verdicts on its matrix, and the plan of auto without a solve."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    EquilibriumProgram,
    FrictionalContact,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    analyze,
    gallery,
    solve,
)
from lcp_plugin.core.problem_classes import CLASSES

PROBLEMS = {
    "LCP": lambda: gallery.build("obstacle_2d", size=40).problem,
    "NonlinearProblem": lambda: NonlinearProblem(
        lambda x: np.exp(x) + x[::-1] - 3.0, lower=[0.0, 0.0]
    ),
    "QuadraticProgram": lambda: QuadraticProgram(
        2.0 * np.eye(2), [-2.0, -4.0], G=[[1.0, 1.0]], h=[2.0]
    ),
    "EquilibriumProgram": lambda: EquilibriumProgram.of_rows(
        QuadraticProgram([[2.0, 0.0], [0.0, 0.0]], [-2.0, 1.0], lower=[-np.inf, 0.0]),
        [1],
        [[-1.0, 1.0]],
        [0.5],
    ),
    "BoundedLeastSquares": lambda: BoundedLeastSquares(
        [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [2.0, 1.0, -1.0]
    ),
    "ConeProblem": lambda: ConeProblem(2.0 * np.eye(3), [1.0, -1.0, 3.0], [("second_order", 3)]),
    "FrictionalContact": lambda: FrictionalContact(
        2.0 * np.eye(6), [[-1.0, 3.0, 4.0], [-1.0, 0.1, 0.2]], 0.5
    ),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", CLASSES)
def test_the_plan_begins_as_auto_does(name):
    """The first stage of the plan, with its reason, is the first stage of the run; the text has every stage."""
    problem = PROBLEMS[name]()
    report, text = analyze(problem), str(analyze(problem))
    stages = getattr(solve(problem), "stages", ())
    if stages and stages[0].name != "start":
        assert report.plan[0].name == stages[0].name
    assert repr(problem) == text.splitlines()[0]
    assert all(f"{k:>3} {stage.name}" in text for k, stage in enumerate(report.plan, 1))


@pytest.mark.quick
def test_a_plan_shows_the_budgets_of_its_stages():
    """A sparse M with many rows: npsor, psor, multigrid and the direct methods, each with its limit."""
    plan = analyze(PROBLEMS["LCP"]()).plan
    assert [stage.name for stage in plan[:3]] == ["npsor", "psor", "multigrid"]
    assert all(stage.because and stage.until for stage in plan[:3])


@pytest.mark.quick
@pytest.mark.parametrize(("skew", "passes"), [(0.0, 40), (0.5, 265)])
def test_the_budget_of_psor_is_the_work_before_which_it_is_not_left(skew, passes):
    """With a forecast, of a symmetric M, psor may be left after 40 sweeps; else after the work of the next stage."""
    ring = sp.csr_array(
        sp.diags_array([-1.0 - skew, 3.0, -1.0], offsets=[-7, 0, 7], shape=(2000, 2000))
    )
    M = ring + sp.diags_array([-0.1, -0.1], offsets=[-900, 900], shape=(2000, 2000))
    plan = {stage.name: stage for stage in analyze(LCP(M, np.ones(2000))).plan}
    assert plan["psor"].until.startswith(f"{passes} passes")


@pytest.mark.quick
@pytest.mark.parametrize(("corner", "is_convex"), [(1.0, True), (0.0, True), (-1.0, False)])
def test_convexity_of_a_program_is_proved_or_disproved(corner, is_convex):
    """P is semidefinite exactly if its diagonal is; of a program that is not convex no stage runs."""
    report = analyze(QuadraticProgram(np.diag([1.0, corner]), [1.0, 2.0], lower=0.0, upper=1.0))
    assert report.is_positive_semidefinite is is_convex
    evidence = report.evidence["is_positive_semidefinite"]
    assert evidence.startswith("λ_min ≥ 0" if is_convex else "P[1, 1] = -1")
    assert bool(report.plan) is is_convex
    assert ("solve raises an error" in str(report)) is not is_convex


@pytest.mark.quick
@pytest.mark.parametrize("curvature", [1.0, -1.0])
def test_the_plan_of_a_program_with_pairs_begins_as_solve_does(curvature):
    """Branch and bound proves the bound of a convex objective; of another one only SCIP gives a bound."""
    pytest.importorskip("pyscipopt")
    program = QuadraticProgram(
        curvature * np.eye(2), [1.0, 2.0], A=[[1.0, 1.0]], b=[1.0], lower=0.0
    )
    problem = EquilibriumProgram(program, [0], [1])
    plan = analyze(problem).plan
    assert plan[0].name == solve(problem).algorithm.split(", ")[0]
    assert all(stage.because and stage.until != "0 nodes" for stage in plan)


@pytest.mark.quick
def test_a_nonlinear_problem_is_analyzed_at_one_point():
    """F is called once, and once for each of its differences."""
    calls = []

    def F(x):
        calls.append(x)
        return 2.0 * np.exp(x) + x[::-1] - 3.0

    report = analyze(NonlinearProblem(F, lower=[0.0, 0.0]))
    assert report.is_p_matrix
    assert len(calls) <= 4
    assert analyze(NonlinearProblem(F)).n == 0  # without a start n is not known


@pytest.mark.quick
@pytest.mark.parametrize("wrong", ["problem.npz", None, [[1.0, 2.0]], [[np.nan]]])
def test_other_arguments_are_refused(wrong):
    """A name, None, a matrix that is not square, and NaN."""
    with pytest.raises(InvalidProblem):
        analyze(wrong)
    assert type(analyze(LCP([[1.0]], [1.0]))).__name__ == "ProblemReport"
