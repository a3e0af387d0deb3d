"""The plan of the automatic choice, and how its runs end."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, QuadraticProgram, Status, solve

# --- The trial of sweeps ------------------------------------------------------------------------------------------


def dominant(n: int, excess: float) -> LCP:
    """Return a sparse H₊-matrix that is not symmetric, with a known solution."""
    rng = np.random.default_rng(0)
    M = sp.random(n, n, density=5 / n, random_state=rng, data_rvs=rng.standard_normal).tolil()
    M.setdiag(0.0)
    M.setdiag(excess * np.maximum(np.asarray(abs(M.tocsr()).sum(1)).ravel(), 1.0))
    z = np.maximum(rng.standard_normal(n), 0.0)
    w = np.where(z > 0.0, 0.0, np.abs(rng.standard_normal(n)))
    return LCP(M.tocsr(), w - M @ z)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("n", "excess"), [(10_000, 1.05), (2000, 1.5)])
def test_auto_keeps_sweeping_over_a_dominant_matrix(n, excess):
    """A few sweeps forecast nothing if M is not symmetric: auto has no more than four times the work of psor."""
    problem = dominant(n, excess)
    result = solve(problem)
    assert result.is_solved
    assert result.work <= 4.0 * solve(problem, "psor").work


def test_auto_on_a_flow_has_twice_the_work_of_the_better_method_at_most():
    """Slow diffusion suits multigrid, fast convection psor; auto does not know, and its trial is bounded."""
    for speed in (1.0, 100.0):
        one = sp.diags_array([-1.0 - speed, 2.0 + speed, -1.0], offsets=[-1, 0, 1], shape=(60, 60))
        M = sp.kron(one, sp.eye_array(60)) + sp.kron(sp.eye_array(60), one)
        problem = LCP(M, np.random.default_rng(0).standard_normal(3600) - 0.2)
        works = [solve(problem, name).work for name in ("auto", "psor", "multigrid")]
        assert works[0] <= 2.0 * min(works[1:]) + 10.0


# --- What runs end with ------------------------------------------------------------------------------------------


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
