"""What the wheels' tests are, how they are routed to this package, and what is not asked of it."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from io import StringIO
from typing import Any
from unittest import SkipTest

import numpy as np

from lcp_plugin import BoundedLeastSquares, QPSolver, QuadraticProgram, Status, solve

# The test: why it says nothing about this package.
OPTIONS, REFUSED = "scipy's own options and warnings", "refused as input: lower > upper"
SEVERAL = "there are several minimisers, and scipy's is another"
UNDECLARED = "asked of solvers that say they take bounds of variables"
NOT_ASKED = {
    "linprog.test_callback": OPTIONS,
    "linprog.test_disp": OPTIONS,
    "linprog.test_maxiter": OPTIONS,
    "linprog.test_optimize_result": "fields of scipy's result",
    "linprog.test_unknown_options": OPTIONS,
    "linprog.test_integrality_without_highs": OPTIONS,
    "linprog.test_bounds_infeasible": REFUSED,
    "linprog.test_bounds_infeasible_2": REFUSED,
    "nnls.test_maxiter": OPTIONS,
    "nnls.test_atol_deprecation_warning": OPTIONS,
    "nnls.test_2D_singleton_RHS_input": "b is a vector",
    "nnls.test_2D_not_singleton_RHS_input_2": "b is a vector",
    "nnls.test_gh_22791_32bit": SEVERAL,
    "nnls.test_nnls_gh21021_ex1": SEVERAL,
    "cvxpy.LPs.test_lp_bound_attr": UNDECLARED,
    "cvxpy.QPs.test_qp_bound_attr": UNDECLARED,
    "cvxpy.LPs.test_lp_7": "it needs sdpap",
}
STATUS = {Status.SOLVED: 0, Status.MAX_ITERATIONS: 1, Status.INFEASIBLE: 2, Status.UNBOUNDED: 3}


def run(name: str = "") -> int:
    """Run the tests whose names contain `name`; print those that fail, and the counts; return 1 where any fails."""
    counts = dict.fromkeys(("passed", "failed", "not asked"), 0)
    for test, call in tests():
        if name in test:
            what, reason = ("not asked", NOT_ASKED[test]) if test in NOT_ASKED else _outcome(call)
            counts[what] += 1
            if what != "passed":
                print(f"{test}: {what}: {reason}", flush=True)
    print(", ".join(f"{count} {what}" for what, count in counts.items()))
    return int(counts["failed"] > 0 or counts["passed"] == 0)


def _outcome(call: Callable[[], Any]) -> tuple[str, str]:
    """Return "passed", "failed" or "not asked", and why."""
    try:
        with warnings.catch_warnings(), redirect_stdout(StringIO()):
            warnings.simplefilter("ignore")
            call()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # what pytest raises is no Exception
        is_skipped = isinstance(error, SkipTest) or type(error).__name__ == "Skipped"
        words = " ".join(str(error).split())[:160]
        return (
            ("not asked", words) if is_skipped else ("failed", f"{type(error).__name__}: {words}")
        )
    return "passed", ""


def tests():
    """Yield the name of each test and what runs it."""
    yield from _of_cvxpy()
    linprog = import_module("scipy.optimize.tests.test_linprog")
    linprog.linprog = our_linprog
    common = linprog.LinprogCommonTests
    common.method, common.options = "highs", {}
    yield from _methods(common, "linprog")
    nnls = import_module("scipy.optimize.tests.test_nnls")
    nnls.nnls = our_nnls
    yield from _methods(nnls.TestNNLS, "nnls")
    least_squares = import_module("scipy.optimize.tests.test_lsq_linear")
    least_squares.lsq_linear = our_lsq_linear
    yield from _methods(least_squares.TestBVLS, "lsq_linear")


def _of_cvxpy() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield cvxpy's programs: those that it gives every QP solver, and its standard LPs, QPs and infeasible LPs."""
    programs = import_module("cvxpy.tests.test_qp_solvers")
    kind = next(
        one
        for one in vars(programs).values()
        if inspect.isclass(one)
        and hasattr(one, "test_all_solvers")
        and hasattr(one, "quad_over_lin")
    )
    for name, method in inspect.getmembers(kind, inspect.isfunction):
        if (
            list(inspect.signature(method).parameters)[:2] == ["self", "solver"]
            and "norm_2" not in name
        ):
            yield f"cvxpy.{name}", partial(_of_object, kind("test_all_solvers"), name, QPSolver())
    helpers = import_module("cvxpy.tests.solver_test_helpers")
    for group, prefix in (
        ("LPs", "test_lp"),
        ("QPs", "test_qp"),
        ("InfeasibleProblems", "test_lp"),
    ):
        standard = getattr(helpers, f"StandardTest{group}")
        for name in (name for name in dir(standard) if name.startswith(prefix)):
            yield f"cvxpy.{group}.{name}", partial(getattr(standard, name), solver=QPSolver())


def _methods(kind: Any, prefix: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield the tests of a class without parameters, each of an object of its own."""
    for name, method in inspect.getmembers(kind, inspect.isfunction):
        if name.startswith("test") and list(inspect.signature(method).parameters) == ["self"]:
            yield f"{prefix}.{name}", partial(_of_object, kind(), name)


def _of_object(one: Any, name: str, *given: Any) -> None:
    np.random.seed(1)  # noqa: NPY002 - what cvxpy's tests of one run have there
    getattr(one, "setUp", getattr(one, "setup_method", dict))()
    getattr(one, name)(*given)


# --- scipy's functions, answered by this package ------------------------------------------------------------------


def our_linprog(
    c: Any, A_ub: Any = None, b_ub: Any = None, A_eq: Any = None, b_eq: Any = None, bounds: Any = (0, None),
    method: str = "highs", callback: Any = None, options: Any = None, x0: Any = None, integrality: Any = None,
) -> Any:  # fmt: skip
    """scipy.optimize.linprog; its own reading of the arguments."""
    from scipy.optimize import OptimizeResult
    from scipy.optimize._linprog_util import _clean_inputs, _LPProblem

    if integrality is not None and np.any(integrality):
        raise SkipTest("integers")
    lp = _clean_inputs(_LPProblem(c, A_ub, b_ub, A_eq, b_eq, bounds, None, None))
    program = QuadraticProgram(
        np.zeros((lp.c.size, lp.c.size)),
        lp.c,
        lp.A_ub,
        lp.b_ub,
        lp.A_eq,
        lp.b_eq,
        lp.bounds[:, 0],
        lp.bounds[:, 1],
    )
    found = solve(program)
    x = found.x
    return OptimizeResult(
        x=x,
        fun=found.objective,
        status=STATUS.get(found.status, 4),
        success=found.is_solved,
        nit=0,
        message=str(found.status.value),
        slack=lp.b_ub - lp.A_ub @ x,
        con=lp.b_eq - lp.A_eq @ x,
    )


def our_nnls(A: Any, b: Any, maxiter: Any = None, **_: Any) -> tuple[Any, float]:
    """scipy.optimize.nnls."""
    found = solve(BoundedLeastSquares(A, b))
    return found.x, float(np.linalg.norm(np.asarray(A) @ found.x - b))


def our_lsq_linear(A: Any, b: Any, bounds: Any = (-np.inf, np.inf), **_: Any) -> Any:
    """scipy.optimize.lsq_linear."""
    from scipy.optimize import OptimizeResult

    lower, upper = (bounds.lb, bounds.ub) if hasattr(bounds, "lb") else bounds
    found = solve(BoundedLeastSquares(A, b, lower=lower, upper=upper))
    fun = np.ravel(A @ found.x) - b
    mask = np.where(found.x == lower, -1, np.where(found.x == upper, 1, 0))
    return OptimizeResult(
        x=found.x,
        fun=fun,
        cost=0.5 * float(fun @ fun),
        optimality=0.0,
        active_mask=mask,
        nit=1,
        status=1,
        message="",
        success=found.is_solved,
        unbounded_sol=np.linalg.lstsq(A, b, rcond=-1),
    )
