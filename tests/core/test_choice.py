"""The plan of the automatic choice, and how its runs end."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from applications.table import Case
from inputs.small_families import falling_bodies

from lcp_plugin import LCP, QuadraticProgram, Result, Status, gallery, solve
from lcp_plugin.core.names import format_count
from lcp_plugin.gallery.problems import stencil_matrix


def names(result: Result) -> list[str]:
    return [stage.name for stage in result.stages]


# --- The first table ---------------------------------------------------------------------------------------------


# --- The second table --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("contacts", [25, 40, 80])
def test_frictional_contact_is_solved_by_pivots_alone(contacts):
    """Copositive, neither symmetric nor H₊: up to 500 rows a compiled path comes first, of at most 3 n pivots."""
    problem = falling_bodies(contacts)
    result = solve(problem)
    assert result.is_solved
    assert names(result)[-1] in ("lemke", "path")
    assert result.work * problem.nonzeros <= 3.0 * problem.n**3


@pytest.mark.parametrize("is_dense", [True, False])
def test_a_budget_row_is_pivoted_before_it_is_factorized(is_dense):
    """A portfolio holds few of its assets: pivots find them, for less than a factorization of M."""
    stated = Case("portfolio", {"assets": 200}).in_units("own")[0]
    problem = (
        stated if is_dense else LCP(stated.csr, stated.q, lower=stated.lower, upper=stated.upper)
    )
    assert problem.is_dense == is_dense
    result = solve(problem)
    assert result.is_solved
    assert names(result) == ["path" if is_dense else "lemke"]
    if not is_dense:  # the work of a compiled path is a constant, not the number of its pivots
        assert result.work * problem.nonzeros <= problem.n**3 / 3.0


# --- What runs end with ------------------------------------------------------------------------------------------


@pytest.mark.full
def test_a_grid_with_strong_flows_is_solved_by_newton():
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


def test_an_infeasible_problem_ends_with_its_proof():
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


def test_the_story_names_every_stage_with_its_reason():
    """explain() tells what ran, how much of the work it was, and why it came."""
    result = solve(gallery.build("obstacle_2d", size=40).problem)
    assert result.is_solved
    assert names(result)[:2] == ["npsor", "psor"]
    assert result.algorithm == "auto: " + ", ".join(names(result))
    # the rest: measuring
    assert 0.9 * result.work <= sum(stage.work for stage in result.stages) <= result.work
    for stage in result.stages:
        assert f"  {stage.name}, {format_count(stage.iterations, 'iteration')}" in result.explain()
        assert stage.because in result.explain()


@pytest.mark.parametrize("as_stored", [np.asarray, sp.csr_array])
def test_auto_equations_with_the_other_sign_take_the_same_methods(as_stored):
    """A program's equations may be typed with either sign: auto runs the same methods, and x is Clarabel's."""
    rng = np.random.default_rng(0)
    n, m = 90, 45
    B, A = rng.normal(size=(n, n)), rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.5)
    P, c, b = B @ B.T / n + 0.1 * np.eye(n), rng.normal(size=n), A @ np.abs(rng.normal(size=n))
    found = []
    for sign in (1.0, -1.0):
        M = np.block([[P, -A.T], [sign * A, np.zeros((m, m))]])
        lower = np.append(np.zeros(n), np.full(m, -np.inf))
        found.append(solve(LCP(as_stored(M), np.append(c, -sign * b), lower=lower)))
    assert all(result.is_solved for result in found)
    one, other = ([stage.name for stage in result.stages] for result in found)
    assert one == other
    program = QuadraticProgram(P, c, A=A, b=b, lower=0.0)
    x = solve(program, "clarabel").x
    for result in found:
        assert np.allclose(result.z[:n], x, atol=1e-5 * np.abs(x).max())
