"""qpsolvers: ``solve_qp(…, solver="lcp_plugin")`` after ``lcp_plugin.interfaces.qpsolvers.register_with_qpsolvers()``.

Only the tables of qpsolvers are changed: ``solve_function``, from a name to a function of a problem, and the
lists ``available_solvers``, ``dense_solvers`` and ``sparse_solvers``, the objects that it shows everywhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import errors
from ..core.checks import checked_bound, checked_vector, vector_option
from ..core.deadline import Clock
from ..core.settings import Status
from ..problems.programs.program import QuadraticProgram
from ..problems.programs.solving import solve_program

if TYPE_CHECKING:
    from qpsolvers import Problem, Solution

NAME = "lcp_plugin"


def register_with_qpsolvers() -> None:
    """Register the solver "lcp_plugin" with qpsolvers; a second call changes nothing.

    Raises
    ------
    ImportError
        If qpsolvers is not installed: ``pip install '.[qpsolvers]'``.

    Examples
    --------
    >>> import numpy as np
    >>> from qpsolvers import solve_qp
    >>> register_with_qpsolvers()
    >>> solve_qp(2 * np.eye(2), np.array([-2.0, -4.0]), np.array([[1.0, 1.0]]), np.array([2.0]), solver="lcp_plugin")
    array([0.5, 1.5])
    """
    package = errors.imported("qpsolvers", "register_with_qpsolvers needs qpsolvers", "qpsolvers")
    # The table that solve_problem reads: up to qpsolvers 4.9, not the table of qpsolvers.solvers.
    from qpsolvers.solve_problem import solve_function

    solve_function[NAME] = solve_problem
    for names in (package.available_solvers, package.dense_solvers, package.sparse_solvers):
        if NAME not in names:
            names.append(NAME)


def solve_problem(
    problem: Problem, initvals: object = None, verbose: bool = False, **options: Any
) -> Solution:
    """Return a solution of qpsolvers, found if the residuals of the program are optimal.

    Parameters
    ----------
    problem : qpsolvers.Problem
        Dense or sparse; P positive semidefinite, zero for a linear program.
    initvals : array, shape (n,), optional
        An x to start from, which a program with bounds alone can use; of any other only the length is checked.
    verbose : bool
        Prints the run.
    **options
        Options of :func:`lcp_plugin.solve`: ``algorithm``, ``tolerance``, ``max_iterations``, ``max_seconds``, …

    Returns
    -------
    qpsolvers.Solution
        ``extras["status"]`` is the :class:`~lcp_plugin.Status`, ``extras["result"]`` the
        :class:`~lcp_plugin.problems.programs.result.QuadraticProgramResult`: its ``solution`` has x, the multipliers
        and their residuals, its ``proof`` the proof of infeasibility. Not found: x is None, and the best x is in the
        result.

    Raises
    ------
    qpsolvers.ParamError
        For an option that does not exist or cannot be used.
    qpsolvers.ProblemError
        If the data state no convex program, the named algorithm cannot run on it, or it is proved to be unbounded.
    qpsolvers.SolverError
        For all other rejected input.
    """
    from qpsolvers import ParamError, ProblemError, Solution, SolverError

    clock = Clock()
    try:
        P, q, G, h, A, b, lower, upper = problem.unpack()
        q = checked_vector(q, "q", None)  # with qpsolvers' names of the vectors in error messages
        ends = (lower, "lb", -np.inf), (upper, "ub", np.inf)
        low, high = (far if x is None else checked_bound(x, name, q.size) for x, name, far in ends)
        program = QuadraticProgram(P, q, G, h, A, b, low, high)
        built = clock.read()
        start = None if initvals is None else vector_option(initvals, "initvals", program.n)
        # A start would cost steps in a program with rows
        guess = None if program.h.size + program.b.size else start
        result = solve_program(program, z0=guess, verbose=verbose, **options)
    except (errors.InvalidOption, errors.UnknownAlgorithm) as error:
        raise ParamError(str(error)) from error
    except (errors.InvalidProblem, errors.UnsupportedModel) as error:
        raise ProblemError(str(error)) from error
    except errors.LCPError as error:
        raise SolverError(str(error)) from error
    if result.status is Status.UNBOUNDED:
        raise ProblemError(f"the program is {result.proof}; bound x where the objective falls")
    answer, solution = result.solution, Solution(problem)
    solution.extras = {"status": result.status, "result": result}
    solution.build_time, solution.solve_time = built, clock.read() - built
    solution.found = result.is_solved
    if solution.found:
        is_bounded = problem.lb is not None or problem.ub is not None
        solution.x, solution.obj = answer.x.copy(), answer.objective
        solution.z, solution.y = answer.inequality.copy(), answer.equality.copy()
        solution.z_box = answer.upper - answer.lower if is_bounded else np.empty(0)
    return solution
