"""Calls of every public function with each usual mistake, for ``tests/house/test_wrong_calls.py``.

Each call has the data of a small right call, of which one
argument is a list, a table, a column, whole numbers, of another shape, NaN, text or None, or the bounds are swapped or
passed by position, or an argument is missing or superfluous.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cvxpy as cp
import numpy as np

import lcp_plugin
from lcp_plugin import LCP, QuadraticProgram, solve

M, Q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
PROBLEM, PROGRAM = LCP(M, Q), QuadraticProgram(M, Q)
RESULT, OF_PROGRAM = solve(PROBLEM), solve(PROGRAM)
X = cp.Variable(2, name="x", nonneg=True)
GOAL = cp.Problem(cp.Minimize(cp.sum_squares(X - 1)))
SPACE = np.eye(3), np.array([[0.0, 0.0, 1.0]]), np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
BOUNDS = {"lower": np.zeros(2), "upper": np.ones(2)}
PUSH = np.array([-1.0, 3.0, 4.0])


def value(x: Any) -> Any:
    """Return F(x) of a linear problem."""
    return M @ x + Q


def slopes(x: Any) -> Any:
    """Return the Jacobian."""
    return M


#: Right calls: positional arguments and arguments by name of each public function.
CALLS: dict[str, tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]] = {
    "LCP": (LCP, (M, Q), {**BOUNDS, "names": ["a", "b"]}),
    "QuadraticProgram": (
        QuadraticProgram,
        (M, Q, np.ones((1, 2)), np.ones(1), np.ones((1, 2)), np.ones(1)),
        {**BOUNDS, "constant": 1.0, "names": ["a", "b"]},
    ),
    "BoundedLeastSquares": (
        lcp_plugin.BoundedLeastSquares,
        (np.ones((3, 2)), np.ones(3)),
        {**BOUNDS, "weights": np.ones(3), "ridge": 0.1, "l1": 0.1},
    ),
    "NonlinearProblem": (lcp_plugin.NonlinearProblem, (value, slopes), dict(BOUNDS)),
    "ConeProblem": (lcp_plugin.ConeProblem, (np.eye(3), PUSH, [("second_order", 3)]), {}),
    "FrictionalContact": (lcp_plugin.FrictionalContact, (np.eye(3), PUSH, 0.5), {"dimension": 3}),
    "FrictionalContact of bodies": (lcp_plugin.FrictionalContact, (SPACE, PUSH, 0.5), {}),
    "FrictionalContact.worlds": (
        lcp_plugin.FrictionalContact.worlds,
        (np.eye(3), np.tile(PUSH, (4, 1)), 0.5),
        {"dimension": 3},
    ),
    "LCP.from_qp": (LCP.from_qp, (M, Q), dict(BOUNDS)),
    "LCP.from_game": (LCP.from_game, (M, M), {}),
    "LCP.from_contacts": (LCP.from_contacts, (SPACE, 0.5, PUSH), {"directions": 4}),
    "LCP.from_cvxpy": (LCP.from_cvxpy, (cp.Problem(cp.Minimize(0), [lcp_plugin.complements(X, M @ X + Q)]),), {}),
    "LCP.with_q": (PROBLEM.with_q, (Q,), dict(BOUNDS)),
    "solve": (solve, (PROBLEM,), {"algorithm": "psor", "z0": Q, "tolerance": 1e-8, "max_seconds": 1.0}),
    "solve a program": (solve, (PROGRAM,), {"tolerance": 1e-6, "max_seconds": 1.0}),
    "solve_batch": (lcp_plugin.solve_batch, (PROBLEM, np.ones((3, 2))), dict(BOUNDS)),
    "prepare": (lcp_plugin.prepare, (PROBLEM,), {"algorithm": "auto", "tolerance": 1e-8}),
    "step.solve": (lcp_plugin.prepare(PROBLEM).solve, (), {"q": Q, **BOUNDS}),
    "step.solve of a program": (lcp_plugin.prepare(PROGRAM).solve, (), {"c": Q, **BOUNDS}),
    "march": (lcp_plugin.march, (PROBLEM, np.ones((3, 2))), {"propagator": -1.0, **BOUNDS}),
    "trace": (lcp_plugin.trace, (PROBLEM, Q), {"start": 0.0, "stop": 1.0}),
    "derivative": (lcp_plugin.derivative, (RESULT,), {}),
    "derivative.jvp": (lcp_plugin.derivative(RESULT).jvp, (), {"dq": Q}),
    "derivative.vjp": (lcp_plugin.derivative(RESULT).vjp, (Q,), {}),
    "certify": (lcp_plugin.certify, (PROGRAM, Q), {"tolerance": 1e-6}),
    "certify an LCP": (lcp_plugin.certify, (PROBLEM, Q), {"tolerance": 1e-6}),
    "analyze": (lcp_plugin.analyze, (M,), {}),
    "convergence_guarantee": (lcp_plugin.convergence_guarantee, (PROBLEM, "psor"), {}),
    "error_bound": (lcp_plugin.error_bound, (PROBLEM, Q), {}),
    "all_solutions": (lcp_plugin.all_solutions, (PROBLEM,), {"max_nodes": 100}),
    "exact": (lcp_plugin.exact, (RESULT,), {}),
    "check_proof": (lcp_plugin.check_proof, ("no such file.json", PROBLEM), {}),
    "load_problem": (lcp_plugin.load_problem, ("no such file.npz",), {}),
    "cross_validate": (lcp_plugin.cross_validate, (PROBLEM, RESULT), {"reference": "CLARABEL"}),
    "variational": (lcp_plugin.variational, (value,), {"G": np.ones((1, 2)), "h": np.ones(1), **BOUNDS}),
    "complements": (lcp_plugin.complements, (X, M @ X + Q), {}),
    "box": (lcp_plugin.box, (X,), dict(BOUNDS)),
    "friction_cone": (lcp_plugin.friction_cone, (cp.Variable(3), 0.5), {"dimension": 3}),
    "optimal": (lcp_plugin.optimal, (GOAL,), {"over": [X]}),
    "study": (lcp_plugin.study, ([PROBLEM], ["psor"]), {"repeats": 1}),
    "error_against_time": (lcp_plugin.error_against_time, (PROBLEM, ["psor"]), {}),
}  # fmt: skip


def mistakes(argument: Any) -> Iterator[tuple[str, Any]]:
    """Yield the wrong or unusual forms of an argument, each with its name."""
    yield "None", None
    yield "text", "three"
    yield "an object", object()
    if isinstance(argument, float):
        yield from {"NaN": np.nan, "an infinite number": np.inf, "a negative number": -1.0}.items()
    if not isinstance(argument, np.ndarray):
        yield "an array", np.ones((2, 3))
        return
    yield "a list", argument.tolist()
    yield "a column", argument.reshape(-1, 1)
    yield "a row", argument.reshape(1, -1)
    yield "whole numbers", argument.astype(int)
    yield "float32", argument.astype(np.float32)
    yield "another shape", np.ones((5, 7))
    yield "one too many", np.ones(argument.size + 1)
    yield "NaN", np.full(argument.shape, np.nan)
    yield "infinite", np.full(argument.shape, np.inf)
    yield "complex", argument * 1j
    yield "array of text", np.full(argument.shape, "a")
    try:
        import pandas
    except ImportError:
        return
    if argument.ndim <= 2:
        form = pandas.DataFrame if argument.ndim == 2 else pandas.Series
        yield "a table", form(argument)
        yield "a table with NA", form(np.where(argument == argument.flat[0], None, argument))
        yield "a table of text", form(np.full(argument.shape, "a", dtype=object))


def calls() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield the description and the call of each combination."""
    for name, (function, args, named) in CALLS.items():
        for k, argument in enumerate(args):
            for what, wrong in mistakes(argument):
                changed = (*args[:k], wrong, *args[k + 1 :])
                yield (
                    f"{name}, argument {k} {what}",
                    lambda f=function, a=changed, n=named: f(*a, **n),
                )
            left = args[:k]
            yield (
                f"{name}, from argument {k} on missing",
                lambda f=function, a=left, n=named: f(*a, **n),
            )
        for key, argument in named.items():
            for what, wrong in mistakes(argument):
                changed = {**named, key: wrong}
                yield f"{name}, {key} {what}", lambda f=function, a=args, n=changed: f(*a, **n)
        more = {**named, "surplus": 1}
        yield f"{name}, a superfluous keyword", lambda f=function, a=args, n=more: f(*a, **n)
        many = (*args, *named.values(), 1, 2, 3, 4, 5, 6, 7, 8)
        yield f"{name}, everything by position", lambda f=function, a=many: f(*a)
        if "lower" in named:
            swapped = {**named, "lower": named["upper"], "upper": named["lower"]}
            yield f"{name}, swapped bounds", lambda f=function, a=args, n=swapped: f(*a, **n)
