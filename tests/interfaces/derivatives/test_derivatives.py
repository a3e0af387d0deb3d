"""Nonlinear problems of JAX and CasADi: their Jacobians equal hand-written formulas."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
import scipy.sparse as sp
from tools.refusals import assert_refused, refusals

import lcp_plugin.interfaces.derivatives as doors
from lcp_plugin import NonlinearProblem, solve
from lcp_plugin.gallery.problems import five_point_matrix

SIDE = 12  # nodes of a membrane between two walls, which is heated and reacts: A x − 0.06 e^(x/(1 + x/9))
GRID = five_point_matrix(SIDE, 4.0)
ROOM = {"lower": 0.0, "upper": np.full(SIDE**2, 0.25)}


def reaction(x, exp):
    """The source at every node; `exp` is of numpy or another package."""
    return 0.06 * exp(x / (1.0 + x / 9.0))


def derivative_by_hand(x):
    inner = 1.0 + x / 9.0
    return (GRID - sp.diags_array(reaction(x, np.exp) / inner**2)).toarray()


@pytest.fixture
def jax():
    package = pytest.importorskip("jax")
    before = package.config.jax_enable_x64
    package.config.update("jax_enable_x64", True)
    yield package
    package.config.update("jax_enable_x64", before)


def by_jax(jax, **options):
    A = jax.numpy.array(GRID.toarray())
    return NonlinearProblem.from_jax(
        lambda x: A @ x - reaction(x, jax.numpy.exp), **ROOM, **options
    )


def by_casadi(name):
    casadi = pytest.importorskip("casadi")
    x = getattr(casadi, name).sym("x", SIDE**2)
    return NonlinearProblem.from_casadi(
        x, casadi.DM(sp.csc_matrix(GRID)) @ x - reaction(x, casadi.exp), **ROOM
    )


PROBLEMS = {
    "jax": by_jax,
    "jax, sparse": lambda jax: by_jax(jax, sparsity=GRID),
    "SX": lambda _: by_casadi("SX"),
    "MX": lambda _: by_casadi("MX"),
}


@pytest.mark.parametrize("way", PROBLEMS)
def test_the_jacobian_of_a_door_is_exact(way, request):
    """F and F′ equal the formulas to rounding, F′ is sparse as its pattern, and x solves the problem."""
    problem = PROBLEMS[way](request.getfixturevalue("jax") if way.startswith("jax") else None)
    x = np.random.default_rng(0).uniform(0.0, 0.25, SIDE**2)
    np.testing.assert_allclose(problem.value(x), GRID @ x - reaction(x, np.exp), rtol=0, atol=1e-15)
    slopes = problem.derivative(x)
    assert sp.issparse(slopes) == (way != "jax")
    if sp.issparse(slopes):
        assert slopes.nnz == GRID.nnz
        slopes = slopes.toarray()
    np.testing.assert_allclose(slopes, derivative_by_hand(x), rtol=0, atol=1e-14)
    result = solve(problem)
    assert result.is_solved
    assert "jacobian disagrees" not in result.explain()
    step = GRID @ result.x - reaction(result.x, np.exp)
    np.testing.assert_allclose(np.clip(result.x - step, 0.0, 0.25), result.x, rtol=0, atol=1e-9)
    assert 0 < np.sum(result.x == 0.25) < SIDE**2


def test_the_examples_of_the_doors(jax):
    """The doctests of the module, which others leave out."""
    pytest.importorskip("casadi")
    assert doctest.testmod(doors).failed == 0
    assert doctest.testmod(doors).attempted > 8


def test_single_precision_of_jax_is_refused(jax):
    """A problem in single precision names the setting; so does an F that returns float32, or a setting taken back."""
    numpy = jax.numpy
    code = {
        "single": lambda: NonlinearProblem.from_jax(lambda x: x.astype(numpy.float32), lower=[0.0]),
        "double": lambda: NonlinearProblem.from_jax(numpy.exp, lower=[0.0]),
    }
    with pytest.raises(doors.InvalidProblem, match=r"float64, got float32.*jax_enable_x64"):
        solve(code["single"]())
    problem = code["double"]()
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(doors.InvalidProblem, match=r"float64, got float32.*jax_enable_x64"):
        solve(problem)
    with pytest.raises(doors.InvalidOption, match=r"from_jax works in double.*jax_enable_x64"):
        code["double"]()


REFUSED = r"""
NonlinearProblem.from_casadi(2 * x, x) → InvalidProblem: x must be symbols of CasADi, as MX.sym\("x", n\), got SX
NonlinearProblem.from_casadi([1.0], x) → InvalidProblem: x must be symbols of CasADi, .*, got \[1.0\]
NonlinearProblem.from_casadi(x, 2.0) → InvalidProblem: F must have one row per unknown, got \(1, 1\)
NonlinearProblem.from_casadi(x, casadi.sin(x)[:1])
    → InvalidProblem: F must have one row per unknown, got \(1, 1\) for x of \(2, 1\)
NonlinearProblem.from_casadi(x.T, x.T)
    → InvalidProblem: F must have one row per unknown, got \(1, 2\) for x of \(1, 2\)
NonlinearProblem.from_casadi(x, p * x) → InvalidProblem: F contains p; insert numbers
"""


@refusals(REFUSED)
def test_an_expression_that_is_no_problem_is_refused(call, words):
    """Other symbols, other numbers of rows than of unknowns, and no symbols."""
    casadi = pytest.importorskip("casadi")
    x, p = casadi.SX.sym("x", 2), casadi.SX.sym("p")
    assert_refused(call, words, vars(doors) | {"casadi": casadi, "x": x, "p": p})


def test_rows_of_casadi_may_be_a_list_with_constants():
    """A row without unknowns, and an empty column: 2 and x₁² − 4 for x ≥ 0."""
    casadi = pytest.importorskip("casadi")
    x = casadi.SX.sym("x", 2)
    problem = NonlinearProblem.from_casadi(x, [2.0, x[1] ** 2 - 4.0])
    assert problem.derivative([3.0, 3.0]).nnz == 1
    np.testing.assert_allclose(solve(problem, x0=[1.0, 1.0]).x, [0.0, 2.0], atol=1e-8)
