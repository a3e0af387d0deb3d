"""Two public methods of cvxpy.Problem that QPSolver accompanies: on the way in for reasons, on the way out to judge.

A solver inside cvxpy never sees the user's problem. ``get_problem_data`` and ``unpack_results`` do, in every release;
all roads to QPSolver lead through them. Whatever is not for our solver passes untouched.
"""

from __future__ import annotations

import warnings
from functools import wraps
from typing import Any

import cvxpy as cp
from cvxpy.error import SolverError

from .user_terms import disagreement, valued, values_of, why_not

METHODS = ("LCP", "lcp")
#: What atoms of cvxpy raise at values that they do not expect, for instance sparse ones of diagonal variables.
CANNOT_BE_EVALUATED = (ValueError, TypeError, IndexError, NotImplementedError, ArithmeticError)


def accompany(solver_class: type) -> None:
    """Wrap the two methods for the solvers of this class; once, however often this is called."""
    if getattr(cp.Problem.unpack_results, "accompanies_lcp_plugin", False):
        return
    compiled, unpacked = cp.Problem.get_problem_data, cp.Problem.unpack_results

    @wraps(compiled)
    def get_problem_data(self: Any, solver: Any, *args: Any, **kwargs: Any) -> Any:
        if isinstance(solver, str) and solver in METHODS:
            raise SolverError(
                f"solver={solver!r}: cvxpy looks for names among its own solvers only; write "
                'solver=lcp_plugin.QPSolver, or method="LCP"'
            )
        if not isinstance(solver, solver_class):
            return compiled(self, solver, *args, **kwargs)
        try:
            # Values of an earlier solve would start auxiliary variables that nobody needs, and cvxpy fails at some.
            with valued(self, {}):
                return compiled(self, solver, *args, **kwargs)
        except SolverError as error:
            reasons = why_not(self)
            if not reasons:
                raise
            raise SolverError(
                f"QPSolver takes programs with a convex quadratic objective and linear constraints, and what can be "
                f"written so; here {'; '.join(reasons)}. Choose a solver for cones or integers, as solver=cp.CLARABEL "
                "or cp.HIGHS"
            ) from error

    @wraps(unpacked)
    def unpack_results(self: Any, solution: Any, chain: Any, inverse_data: Any) -> None:
        solver = getattr(chain, "solver", None)
        if not isinstance(solver, solver_class):
            unpacked(self, solution, chain, inverse_data)
            return
        before = values_of(self)
        unpacked(self, solution, chain, inverse_data)
        claim = solution.claim(self.solution, lambda answer: chain.invert(answer, inverse_data))
        try:
            what = None if claim is None else disagreement(self, claim, before)
        except CANNOT_BE_EVALUATED as error:
            what = None
            warnings.warn(
                "QPSolver's answer is that of the program which cvxpy made; it could not be judged on the problem "
                f"itself, because cvxpy fails to evaluate it: {error}",
                stacklevel=2,
            )
        if what is not None:
            status = self.status
            self._clear_solution()
            raise SolverError(
                f"QPSolver's answer to the program that cvxpy {cp.__version__} made of this problem is {status!r}, but "
                f"the problem itself contradicts: {what}. The program is not the problem, or too ill-conditioned; "
                "write the expression in another way, or compare with another solver"
            )

    unpack_results.accompanies_lcp_plugin = True  # type: ignore[attr-defined]
    cp.Problem.get_problem_data, cp.Problem.unpack_results = get_problem_data, unpack_results
