"""NumPy's floating point state is the caller's: whatever it says, no exception and no warning of NumPy's gets out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    FrictionalContact,
    LCPError,
    NonlinearProblem,
    QuadraticProgram,
    all_solutions,
    analyze,
    certify,
    convergence_guarantee,
    cross_validate,
    derivative,
    error_bound,
    march,
    prepare,
    solve,
    solve_batch,
    trace,
)

SIZES = (5e-310, 1e-200, 1e200, 1.7e308)  # of the largest entries: subnormal to nearly infinite
ONES = np.ones(3)
Calls = dict[str, Callable[[], Any]]


def scaled(values: Any, size: float) -> Any:
    """Values whose largest is of a size."""
    return values / np.abs(values).max() * size


def calls(size: float) -> Calls:
    """Every verb on data of a size."""
    rng = np.random.default_rng(0)
    plain = rng.normal(size=(6, 3))
    right = rng.normal(size=6)
    several = scaled(rng.normal(size=(4, 3)), size)
    A, b, P = scaled(plain, size), scaled(right, size), scaled(plain.T @ plain, size)
    c, opposite = A[0].copy(), np.stack([A[0], -A[0]])
    return {
        "least squares": lambda: solve(BoundedLeastSquares(A, b, lower=0.0)),
        "least squares, small A": lambda: solve(BoundedLeastSquares(plain, b, lower=0.0)),
        "least squares, small b": lambda: solve(BoundedLeastSquares(A, right, lower=0.0)),
        "lasso": lambda: solve(BoundedLeastSquares(A, b, l1=size)),
        "sparse least squares": lambda: solve(
            BoundedLeastSquares(sp.csr_array(A), b, lower=0.0, upper=1.0)
        ),
        "LCP": lambda: solve(LCP(P, c)).explain(),
        "npsor": lambda: solve(LCP(sp.csr_array(P), c), "npsor"),
        "lemke": lambda: solve(LCP(P, c), "lemke"),
        "interior point": lambda: solve(LCP(P, c), "interior_point"),
        "program": lambda: solve(QuadraticProgram(P, c, A[:2], b[:2])).explain(),
        "infeasible program": lambda: solve(QuadraticProgram(P, c, opposite, [-size, size / 2])),
        "errors of a recovered solution": lambda: (
            solution := LCP.from_qp(P, c, A[:2], b[:2]).origin.recover(np.full(5, size)),
            solution.explain(),
            str(solution.solution),
        ),
        "program by clarabel": lambda: solve(QuadraticProgram(P, c, A[:2], b[:2]), "clarabel"),
        "batch of programs": lambda: solve_batch([QuadraticProgram(P, c)] * 3),
        "batch of LCPs": lambda: solve_batch(LCP(P, ONES), several),
        "everything of a result": lambda: (
            solved := solve(LCP(P, c), record=True),
            str(solved.certificate),
            solved.certificate.is_at_rounding_level,
            solved.guarantee,
            solved.error_bound,
        ),
        "cones": lambda: solve(ConeProblem(P, c, [("second_order", 3)])).explain(),
        "contact": lambda: solve(FrictionalContact(P, c, 0.5)).explain(),
        "trace": lambda: trace(LCP(P, c), ONES, 0.0, 1.0),
        "guarantee": lambda: convergence_guarantee(LCP(P, c), "npsor"),
        "report": lambda: str(analyze(LCP(P, c))),
        "derivative of a batch": lambda: derivative(solve_batch(LCP(P, ONES), several)).vjp(
            several
        ),
        "derivative of a march": lambda: derivative(march(LCP(P, c), several)).vjp(several),
        "derivatives": lambda: (
            derivative(solve(LCP(P, c))).vjp(ONES),
            derivative(solve(LCP(P, c))).jvp(dq=ONES),
        ),
        "derivative of cones": lambda: derivative(solve(FrictionalContact(P, c, 0.5))).vjp(ONES),
        "cross-validation": lambda: str(cross_validate(LCP(P, c))),
        "certify": lambda: certify(QuadraticProgram(P, c), ONES),
        "nonlinear": lambda: solve(NonlinearProblem(lambda x: P @ x / 4.0 + c), x0=np.zeros(3)),
        "march": lambda: march(LCP(P, c), several),
        "error bound": lambda: error_bound(LCP(P, c), ONES),
        "analyze": lambda: analyze(LCP(P, c)),
        "prepare": lambda: prepare(LCP(P, c)),
        "prepared LCP": lambda: prepare(LCP(P, c), record=True).solve(q=c, z0=b[:3]),
        "prepared, without terms": lambda: prepare(LCP(0.0 * P, 0.0 * c), record=True).solve(
            z0=ONES
        ),
        "prepared program": lambda: prepare(QuadraticProgram(P, c, A[:2], b[:2])).solve(c=-c),
        "prepared, unbounded": lambda: prepare(QuadraticProgram(np.full((3, 3), size), c)).solve(),
        "derivative": lambda: derivative(solve(LCP(P, c))),
        "all solutions": lambda: all_solutions(LCP(P, c)),
    }


@pytest.mark.parametrize(
    "problem",
    [
        LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]),
        QuadraticProgram(np.eye(2), [-1.0, 1.0], A=[[1.0, 1.0]], b=[1.0]),
        NonlinearProblem(lambda x: x + x**3 - 1.0, lower=np.zeros(2)),
        BoundedLeastSquares(np.eye(2), [1.0, -1.0], lower=0.0),
        ConeProblem(np.eye(3), [-1.0, 2.0, 0.0], [("second_order", 3)]),
    ],
    ids=lambda problem: type(problem).__name__,
)
def test_a_callback_has_the_state_of_the_caller(problem):
    """NumPy raises, warns or is silent in a callback as it does where solve was called."""
    states = []
    with np.errstate(divide="raise", over="warn", under="ignore", invalid="raise"):
        solve(problem, callback=lambda sample, z: states.append(np.geterr()))
        assert states
        assert all(state == np.geterr() for state in states)


@pytest.mark.quick(4)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.quick] * name.startswith("prepared"))
        for name in calls(1.0)
    ],
)
def test_no_exception_of_numpy_gets_out(name, size):
    """With np.errstate(all="raise") every verb answers, or refuses in words of its own; warnings are errors here."""
    call = calls(size)[name]
    for mode in ("raise", "warn"):
        with np.errstate(all=mode):
            with suppress(LCPError):
                call()
            assert set(np.geterr().values()) == {mode}
