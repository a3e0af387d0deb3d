"""The sign in which the equation of a free unknown is written decides nothing."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, Certificate, Status, solve, solve_batch
from lcp_plugin.core.matrix.matrix import Matrix
from lcp_plugin.core.matrix.row_signs import monotone_signs, why_not_monotone

METHODS = ("auto", "interior_point", "newton", "lemke")


def cournot(sign: float, nodes: int = 8, firms: int = 4) -> LCP:
    """Firms sell at nodes, prices p free: 0 ≤ x ⟂ slope x + cost − p ≥ 0, ±(Σ x − intercept + demand p) = 0."""
    rng = np.random.default_rng(0)
    sales, slope = nodes * firms, rng.uniform(0.5, 2.0, nodes)
    of_node = sp.csr_array(np.tile(np.eye(nodes), firms))
    M = sp.block_array(
        [
            [sp.diags_array(np.tile(1.0 / slope, firms)), -of_node.T],
            [sign * of_node, sign * sp.diags_array(slope)],
        ]
    )
    q = np.concatenate(
        [rng.uniform(1.0, 3.0, sales), -sign * rng.uniform(10.0, 20.0, nodes) * slope]
    )
    return LCP(sp.csr_array(M), q, lower=np.append(np.zeros(sales), np.full(nodes, -np.inf)))


def with_one_equation(sign: float, n: int = 60) -> LCP:
    """P x + c + a y ⟂ x ≥ 0, ±(aᵀx − 1) = 0."""
    rng = np.random.default_rng(0)
    B, a = rng.standard_normal((n, n)), np.ones((n, 1))
    M = np.block([[B @ B.T / n + np.eye(n), a], [sign * a.T, np.zeros((1, 1))]])
    return LCP(M, np.append(rng.standard_normal(n), -sign), lower=np.append(np.zeros(n), -np.inf))


@pytest.mark.parametrize("algorithm", METHODS)
@pytest.mark.parametrize("stated", [cournot, with_one_equation])
def test_a_method_does_the_same_however_an_equation_is_signed(stated, algorithm):
    """Either sign of the rows of free unknowns: the same stages, iterations and z, judged on the caller's rows."""
    one, other = (solve(stated(sign), algorithm) for sign in (1.0, -1.0))
    assert one.status is other.status is Status.SOLVED
    assert (one.algorithm, one.iterations) == (other.algorithm, other.iterations)
    np.testing.assert_allclose(one.z, other.z, rtol=1e-7, atol=1e-9)
    for sign, result in ((1.0, one), (-1.0, other)):
        assert Certificate.of(stated(sign), result.z).relative_residual <= 1e-8
        np.testing.assert_array_equal(result.w, stated(sign).slack(result.z))


def test_a_batch_of_several_components_takes_either_sign():
    """Problems of two components, whose equations have the wrong sign, are solved in a batch as alone."""
    M = np.array([[2.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    q, lower = np.array([[-3.0, -1.0, -1.0], [-1.0, -2.0, 3.0]]), np.array([0.0, -np.inf, 0.0])
    batch = solve_batch(M, q, lower=lower)
    assert batch.all_solved
    for z, row in zip(batch.z, q, strict=True):
        np.testing.assert_allclose(z, solve(LCP(M, row, lower=lower)).z, atol=1e-12)


def test_signs_are_found_through_rows_without_a_diagonal():
    """Free rows that meet bounded ones only through other free rows take their signs from those."""
    M = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    signs = monotone_signs(Matrix(M), np.array([False, True, True]).tobytes())
    np.testing.assert_array_equal(signs, [1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    "M",
    [
        [[2.0, 1.0], [-1.0, 0.0]],  # monotone as it is
        [[2.0, 1.0], [1.0, 2.0]],  # a positive diagonal
        [[-1.0, 1.0], [1.0, 0.0]],  # not monotone with either sign
    ],
)
def test_rows_stay_where_nothing_is_won(M):
    """No row changes its sign where M may be monotone already, or is not with any sign."""
    assert monotone_signs(Matrix(M), np.array([False, True]).tobytes()) is None


def test_infeasible_equations_of_the_wrong_sign_are_proved_so():
    """A proof found with turned rows holds of the caller's."""
    M = np.zeros((3, 3))
    M[0, 0], M[0, 1:], M[1:, 0] = 1.0, 1.0, 1.0  # z₀ = 1 and z₀ = 2
    result = solve(LCP(M, [0.0, -1.0, -2.0], lower=[0.0, -np.inf, -np.inf]))
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()


def test_a_run_without_end_names_the_rows_that_are_not_monotone():
    """STALLED says that M is not monotone, and where."""
    assert why_not_monotone(Matrix([[0.0, 1.0], [1.0, 0.0]])).startswith("M is not monotone")
    result = solve(
        LCP([[0.0, -1.0], [-1.0, 0.0]], [-1.0, -1.0]), "newton", prove_infeasibility=False
    )
    assert not result.is_solved
    assert "M is not monotone" in result.advice
