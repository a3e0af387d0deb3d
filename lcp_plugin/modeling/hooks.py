"""Two public methods of cvxpy.Problem that QPSolver accompanies: on the way in for reasons, on the way out to judge.

A solver inside cvxpy never sees the user's problem. ``get_problem_data`` and ``unpack_results`` do, in every release;
all roads to QPSolver lead through them. The first is wrapped, and passes on what is for other solvers; the second is
replaced in a problem that was compiled for QPSolver, until it is compiled for another solver.
"""

from __future__ import annotations

import warnings
from functools import partial, wraps
from typing import Any

import cvxpy as cp
from cvxpy.error import SolverError

from .user_terms import disagreement, valued, values_of, why_not

METHODS = ("LCP", "lcp")
#: What atoms of cvxpy raise at values that they do not expect, for instance sparse ones of diagonal variables.
CANNOT_BE_EVALUATED = (ValueError, TypeError, IndexError, NotImplementedError, ArithmeticError)


def accompany(solver_class: type) -> None:
    """Wrap the first method for the solvers of this class; once, however often this is called."""
    compiled = cp.Problem.get_problem_data
    if getattr(compiled, "accompanies_lcp_plugin", False):
        return

    @wraps(compiled)
    def get_problem_data(self: Any, solver: Any, *args: Any, **kwargs: Any) -> Any:
        if isinstance(solver, str) and solver in METHODS:
            raise SolverError(
                f"solver={solver!r}: cvxpy looks for names among its own solvers only; write "
                'solver=lcp_plugin.QPSolver, or method="LCP"'
            )
        self.__dict__.pop("unpack_results", None)
        if not isinstance(solver, solver_class):
            return compiled(self, solver, *args, **kwargs)
        try:
            # Values of an earlier solve would start auxiliary variables that nobody needs, and cvxpy fails at some.
            with valued(self, {}):
                data = compiled(self, solver, *args, **kwargs)
        except SolverError as error:
            reasons = why_not(self)
            if not reasons:
                raise
            raise SolverError(
                f"QPSolver takes programs with a convex quadratic objective and linear constraints, and what can be "
                f"written so; here {'; '.join(reasons)}. Choose a solver for cones or integers, as solver=cp.CLARABEL "
                "or cp.HIGHS"
            ) from error
        self.unpack_results = partial(_judged, self)
        return data

    get_problem_data.accompanies_lcp_plugin = True  # type: ignore[attr-defined]
    cp.Problem.get_problem_data = get_problem_data


def _judged(problem: Any, solution: Any, chain: Any, inverse_data: Any) -> None:
    """Unpack as cvxpy does; what answers for itself with a claim is held against the problem."""
    before = values_of(problem)
    type(problem).unpack_results(problem, solution, chain, inverse_data)
    if not hasattr(solution, "claim"):  # another solver's, kept from before
        return
    claim = solution.claim(problem.solution, lambda answer: chain.invert(answer, inverse_data))
    try:
        what = None if claim is None else disagreement(problem, claim, before)
    except CANNOT_BE_EVALUATED as error:
        what = None
        warnings.warn(
            "QPSolver's answer is that of the program which cvxpy made; it could not be judged on the problem "
            f"itself, because cvxpy fails to evaluate it: {error}",
            stacklevel=2,
        )
    if what is not None:
        status = problem.status
        problem._clear_solution()
        raise SolverError(
            f"QPSolver's answer to the program that cvxpy {cp.__version__} made of this problem is {status!r}, but "
            f"the problem itself contradicts: {what}. The program is not the problem, or too ill-conditioned; "
            "write the expression in another way, or compare with another solver"
        )
