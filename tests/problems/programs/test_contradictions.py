"""Constraints that contradict: proved by what engines and least squares see, whatever the objective is; by how much."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import QPSolver, QuadraticProgram, Status, UnsupportedModel, certify, solve
from lcp_plugin.problems.programs import no_minimum, solving
from lcp_plugin.problems.programs.contradictions import contradicting_multipliers, with_few_digits

INF = np.inf
N = 401  # nodes of a graph


def differences(parents: Any) -> sp.csr_array:
    """One row an arc of a tree: 1 at its node, −1 at the node before."""
    nodes, ones = np.arange(1, N), np.ones(N - 1)
    rows = np.concatenate([nodes, nodes]) - 1
    return sp.csr_array(
        (np.concatenate([-ones, ones]), (rows, np.concatenate([parents, nodes]))), shape=(N - 1, N)
    )


def graphs() -> dict[str, QuadraticProgram]:
    """Potentials and flows on a path and on a tree, whose limits and supplies contradict."""
    rng = np.random.default_rng(1)
    path, tree = differences(np.arange(N - 1)), differences([rng.integers(k) for k in range(1, N)])
    potentials, flows = sp.eye_array(N, format="csr"), sp.eye_array(N - 1, format="csr")
    ends = np.zeros(N)
    ends[[0, -1]] = -1.0, 1.5
    supplies = rng.integers(-3, 4, N).astype(float)
    supplies[-1] += 1.0 - supplies.sum()
    return {
        "potentials": QuadraticProgram(
            potentials, np.zeros(N), -path, -np.ones(N - 1), lower=0.0, upper=N - 2.5
        ),
        "flow on a path": QuadraticProgram(flows, np.zeros(N - 1), A=path.T, b=ends),
        "cheapest flow": QuadraticProgram(None, np.ones(N - 1), A=path.T, b=ends, lower=0.0),
        "flow on a tree": QuadraticProgram(flows, np.zeros(N - 1), A=tree.T, b=supplies),
    }


@pytest.mark.parametrize(("name", "program"), graphs().items())
def test_contradictions_on_graphs_take_no_linear_program(
    name: str, program: QuadraticProgram, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an interior point hands back is near small integers, and these are the proof."""

    def never(*given: Any) -> Any:
        raise AssertionError("a linear program was asked")

    monkeypatch.setattr(no_minimum, "linear_program", never)
    result = solve(program)
    assert result.status is Status.INFEASIBLE, name
    assert result.proof.verify()
    assert result.proof.is_exact
    assert not result.lcp_result.stages[1:], "no run was begun"


@pytest.mark.parametrize("algorithm", ["auto", "daqp", "lemke"])
def test_rows_that_contradict_are_infeasible_for_every_objective(algorithm: str) -> None:
    """A Farkas vector speaks of the rows alone; where they have a point, a nonconvex program is refused as before."""
    P, c, rows = np.diag([1.0, -1.0]), np.zeros(2), [[1.0, 1.0], [-1.0, -1.0]]
    program = QuadraticProgram(P, c, rows, [1.0, -2.0])
    result = solve(program, algorithm)
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()
    assert certify(result).verdict == certify(program, claim="infeasible").verdict == "proved"
    for other in (
        QuadraticProgram(P, c, rows, [1.0, 2.0]),
        QuadraticProgram(P, c, rows, [1.0, -1.0 - 1e-9]),
    ):
        with pytest.raises(UnsupportedModel, match="not convex"):
            solve(other, algorithm)
    with pytest.raises(UnsupportedModel, match="not convex"):
        solve(program, algorithm, prove_infeasibility=False)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("n", [2, 5, 20])
@pytest.mark.parametrize(("by", "status"), [(1e-9, Status.SOLVED), (1e-3, Status.INFEASIBLE)])
def test_nearly_parallel_rows_contradict_by_what_the_tolerance_allows(
    sign: float, n: int, by: float, status: Status
) -> None:
    """Rows parallel to the last bit: 1e-9 beside limits of 1 is rounding, 1e-3 is a contradiction; no run is begun."""
    rng = np.random.default_rng(n)
    row = rng.normal(size=n)
    other = np.nextafter(row, row + rng.choice([-1.0, 1.0], n))
    result = solve(
        QuadraticProgram(np.eye(n), np.zeros(n), [sign * row, -sign * other], [1.0, -1.0 - by])
    )
    assert result.status is status
    assert len(result.stages) == 1
    if result.is_solved:
        assert abs(sign * row @ result.x - 1.0) <= 1e-6


TINY = 1e-13


@pytest.mark.parametrize("lower", [0.0, -INF])
@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("others", [0, 3])
def test_a_limit_of_rounding_size_is_met_or_refuted_at_once(
    lower: float, signs: tuple[int, int], others: int
) -> None:
    """d·x + (1 + d)·y ≤ −d with d = 1e-13, in all signs, bounded and free: an answer that meets it, or a proof."""
    n = 2 + others
    row = np.concatenate([np.multiply(signs, [TINY, 1.0 + TINY]), np.zeros(others)])
    result = solve(QuadraticProgram(np.eye(n), np.ones(n), row[None], [-TINY], lower=lower))
    assert len(result.stages) == 1
    if lower == 0.0 and signs == (1, 1):
        assert result.status is Status.INFEASIBLE
        assert result.proof.verify()
    else:
        assert result.is_solved
        assert row @ result.x <= 1e-6 * TINY + 1e-12 * np.abs(row * result.x).max()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("slope", [0.0, 1.0])
@pytest.mark.parametrize("P", [np.eye(2), np.zeros((2, 2))])
def test_rounding_in_the_place_of_0_is_named_at_once(P: np.ndarray, slope: float) -> None:
    """X + y ≤ −1e-17 over x, y ≥ 0: neither met nor a contradiction that counts, and no run finds anything else."""
    for row, limit in (([1.0, 1.0], -1e-17), ([1e-14, 1.0], -1e-14)):
        result = solve(QuadraticProgram(P, np.full(2, slope), [row], [limit], lower=0.0, upper=3.0))
        assert result.status is Status.PRECISION_LIMIT
        assert "rounding beside their coefficients" in result.explain()
        assert len(result.stages) == 1
        np.testing.assert_array_equal(result.x, 0.0)


@pytest.mark.full
@pytest.mark.filterwarnings(
    "ignore:Solution may be inaccurate"
)  # where the interval is as wide as rounding
def test_dqcp_is_bisected(monkeypatch: pytest.MonkeyPatch) -> None:
    """(v₀ + 2 v₁ + 1)/(v₀ + v₁ + 1) over [0, 3]² is 1 at v₁ = 0: each of cvxpy's feasibility problems is decided."""

    def never(*given: Any, **options: Any) -> Any:
        raise AssertionError("a run was begun")

    monkeypatch.setattr(solving, "_by_run", never)
    v = cp.Variable(2, nonneg=True)
    problem = cp.Problem(cp.Minimize((v[0] + 2 * v[1] + 1) / (v[0] + v[1] + 1)), [v <= 3])
    problem.solve(qcp=True, solver=QPSolver())
    assert problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
    assert abs(problem.value - 1.0) <= 1e-5
    best = cp.Problem(cp.Maximize((v[0] + 2 * v[1] + 1) / (v[0] + v[1] + 1)), [v <= 3])
    best.solve(qcp=True, solver=QPSolver())
    assert abs(best.value - 7.0 / 4.0) <= 1e-5


def test_few_digits_are_found_in_multipliers() -> None:
    """Ratios of small integers are; others stay, without what is negligible."""
    np.testing.assert_array_equal(
        with_few_digits(np.array([0.3, -0.45 + 1e-7, 1e-14])), [2.0, -3.0, 0.0]
    )
    odd = np.array([1.0, np.sqrt(2.0), 1e-14])
    np.testing.assert_array_equal(with_few_digits(odd), [1.0, np.sqrt(2.0), 0.0])


def test_constraints_with_a_point_show_no_contradiction() -> None:
    """Drawn rows around a drawn point, equations among them, bounded and free: nothing is seen."""
    rng = np.random.default_rng(0)
    for k in range(50):
        C, x = rng.normal(size=(8, 4)), rng.normal(size=4)
        d = C @ x + np.where(np.arange(8) < 6, rng.random(8) * (k % 2), 0.0)
        for reach in (INF, 1.0):
            assert contradicting_multipliers(C, d, 6, x - reach, x + reach, 1e-6) is None


def test_what_an_engine_says_of_a_program_without_its_zero_rows_is_read_as_of_that() -> None:
    """The least x² with 2 + 2e-8 ≤ x ≤ 2 − 2e-8 and 0 x ≤ −6e-9: the engine is asked with fewer rows."""
    program = QuadraticProgram(
        [[2.0]], [0.0], G=[[-1.0], [2.0], [0.0], [1.0]], h=[-2.00000002, 10, -6e-9, 1.99999998]
    )
    assert not solve(program).is_solved
