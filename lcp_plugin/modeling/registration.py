"""Registration with cvxpy: problem.solve(method="LCP"), and the attributes that it sets."""

from __future__ import annotations

import weakref
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.error import DCPError, SolverError

from ..core.errors import InvalidProblem, NotSquare, UnsupportedModel, warn
from ..core.lcp import LCP
from ..core.names import Names, listed
from ..problems.programs.certification import Certification, certify_point, with_side_conditions
from ..problems.statement import MissingPair, solve_from
from . import _compat as compat
from ._compat import EQUATIONS, name_of
from .agents import Optimal, without_agents
from .best_equilibrium import solve_for_the_best
from .constraint import Complements, Condition, box, complements
from .model import Model
from .qp_solver import NamesOnDemand, QPSolver, certify_problem
from .reading import Memo, Reader

FLAGS = "gp qcp nlp requires_grad"  # of cvxpy's solve
OF_COMPILATION = "enforce_dpp ignore_dpp canon_backend bibtex"  # by cvxpy, which only programs need
NOT_BY_RULES = (
    "cvxpy's rules do not see whether a quadratic objective in this form is convex. If it is, solve its optimality "
    "conditions, cp.Problem(cp.Minimize(0), [lcp_plugin.optimal(problem, over=problem.variables())]), by "
    'method="LCP"; or write cp.quad_form(x, P) or cp.sum_squares, or pass arrays: lcp_plugin.QuadraticProgram(P, c, …)'
)


def is_complementarity_problem(problem: cp.Problem) -> bool:
    """Return whether a cvxpy problem has a complementarity among its constraints, or states smooth equations only.

    Parameters
    ----------
    problem : cvxpy.Problem

    Examples
    --------
    >>> import cvxpy as cp
    >>> is_complementarity_problem(cp.Problem(cp.Minimize(0)))
    False
    """
    _require_problem(problem)
    constraints, goal = problem.constraints, problem.objective.args[0]
    if any(isinstance(c, Condition) for c in constraints):
        return True
    are_equations = goal.is_constant() and all(isinstance(c, EQUATIONS) for c in constraints)
    return are_equations and not all(c.is_dcp() for c in constraints)


def _require_problem(problem: object) -> None:
    if not isinstance(problem, cp.Problem):
        raise UnsupportedModel(
            f"a cvxpy problem is needed, got {type(problem).__name__}; write cp.Problem(cp.Minimize(0), […])"
        )


def model_of_constraints(constraints: list[Any], memo: Memo | None = None) -> Model:
    """Return the model of complementarities and equalities.

    Raises
    ------
    UnsupportedModel
        The message names the unsuitable constraint or variable, and the remedy.
    """
    stated, constraints = constraints, without_agents(constraints)
    equations = [constraint for constraint in constraints if isinstance(constraint, EQUATIONS)]
    pairs = [constraint for constraint in constraints if isinstance(constraint, Complements)]
    for constraint in constraints:
        if not isinstance(constraint, (*EQUATIONS, Complements)):
            raise NotSquare(f"{constraint} has no pair; write complements({constraint}, F >= 0)")
    model = Model(constraints, Reader(memo), stated)
    model.add_equations(equations)
    model.add_pairs(pairs)
    return model


_memos: weakref.WeakKeyDictionary[Any, Memo] = weakref.WeakKeyDictionary()


def build_from(problem: cp.Problem) -> Model:
    """Return the model of a cvxpy problem; parts that depend on no parameter are cached for the next call."""
    _require_problem(problem)
    if not problem.objective.args[0].is_constant():
        raise UnsupportedModel(
            f"the objective {name_of(problem.objective.args[0])} with complementarity is not a single LCP: "
            'problem.solve(method="LCP") finds the best of all solutions; write cp.Minimize(0) for any solution'
        )
    return model_of_constraints(problem.constraints, _memos.setdefault(problem, {}))


def lcp_stated_by(problem: cp.Problem) -> LCP:
    """Return the LCP that a cvxpy problem of complementarities states; its ``origin`` leads back to variables.

    Parameters
    ----------
    problem : cvxpy.Problem
        Model that consists of :func:`lcp_plugin.complements` and equalities.

    Raises
    ------
    UnsupportedModel
        If it states another problem.
    """
    model = build_from(problem)
    return model.lcp("LCP.from_cvxpy").with_origin(model)


def stated_in_cvxpy(problem: LCP) -> Any:
    """Return the cvxpy problem in one variable z that states an LCP.

    Parameters
    ----------
    problem : LCP
    """
    if problem.n == 0:  # cvxpy 1.8 has no empty variables
        return cp.Problem(cp.Minimize(0))
    z = cp.Variable(problem.n, name="z")
    pair = complements(box(z, problem.lower, problem.upper), problem.csr @ z + problem.q)
    return cp.Problem(cp.Minimize(0), [pair])


def solve_model(
    problem: cp.Problem,
    algorithm: object = "auto",
    *,
    warm_start: bool = True,
    verbose: bool = False,
    solver: object = None,
    **options: Any,
) -> Any:
    """Solve a complementarity problem, or an ordinary quadratic program, stated in cvxpy.

    Parameters
    ----------
    problem : cvxpy.Problem
    algorithm : str or Algorithm
        As in :func:`lcp_plugin.solve`.
    warm_start : bool
        Begin with the present values of the variables if all have one.
    verbose : bool
        Print the run as :func:`lcp_plugin.solve` does, then print a summary through cvxpy's logger.
    solver : None
        Must be None; it exists because cvxpy passes it.
    **options
        Options of :func:`lcp_plugin.solve` and of the algorithm; also cvxpy's enforce_dpp, ignore_dpp, canon_backend
        and bibtex, which have no effect on a complementarity problem, because cvxpy does not compile it.

    Returns
    -------
    float
        The value of the objective: 0 for a complementarity problem, ∞ if it is proved to have no solution.

    Raises
    ------
    UnsupportedModel
        If the model belongs to neither class; the message names the unsuitable part. It is also a SolverError.
    cvxpy.error.SolverError
        If the run diverged.
    """
    with compat.solver_errors(), np.errstate(all="ignore"):
        compilation = {k: options.pop(k) for k in OF_COMPILATION.split() if k in options}
        foreign = [name for name in FLAGS.split() if name in options]
        if solver is not None or foreign:
            what = ", ".join(foreign) or f"solver={solver!r}"
            raise UnsupportedModel(
                f'method="LCP" has no option {what}; leave it out; derivatives: lcp_plugin.derivative(problem)'
            )
        if not is_complementarity_problem(problem):
            options |= {"algorithm": algorithm, **compilation}
            return _solve_qp(problem, warm_start, bool(verbose), options)
        options |= {"algorithm": algorithm, "verbose": bool(verbose)}
        if not problem.objective.args[0].is_constant():
            return _best(problem, warm_start, options)
        try:
            return _square(problem, warm_start, options)
        except NotSquare as error:  # the best of all solutions has any rows and bounds
            if algorithm != "auto" or _has_cones(problem):
                raise
            try:
                value = _best(problem, warm_start, options)
            except UnsupportedModel:
                raise error from None
            loose = listed(_undetermined(problem.constraints))
            if isinstance(error, MissingPair):
                warn(f"{problem.status}: {error}")
            elif loose:
                warn(
                    f"{problem.status}: no pair, equation or agent determines {loose}, so that the value is arbitrary; "
                    "if it is the price of an inequality, write complements(inequality, price)"
                )
            return value


def _undetermined(constraints: list[Any]) -> list[str]:
    """Return the names of the variables that are in no equation, no decision of an agent and no variable of a pair."""
    known: set[int] = set()
    for constraint in constraints:
        sides = [constraint] if isinstance(constraint, EQUATIONS) else []
        if isinstance(constraint, Optimal):
            sides = [variable for variable, _ in constraint.entries]
        if isinstance(constraint, Complements):
            sides = [side.expression for side in (constraint.first, constraint.second)]
            sides = [side for side in sides if isinstance(side, cp.Variable)] or sides
        known.update(variable.id for side in sides for variable in side.variables())
    found = {v.id: v.name() for constraint in constraints for v in constraint.variables()}
    return [name for key, name in found.items() if key not in known]


def certify_model(problem: cp.Problem, tolerance: float, _pairs: object = None) -> Certification:
    """Return the proved facts about the values of a cvxpy problem, with or without complementarities."""
    if not is_complementarity_problem(problem):
        return certify_problem(problem, tolerance)
    model = build_from(problem)
    if (z := model.present()) is None:
        raise InvalidProblem("a variable has no value; solve the problem, or set the values first")
    name_of = model.statement.name_of
    for k in np.flatnonzero(~np.isfinite(z))[:1].tolist():
        raise InvalidProblem(f"the value of {name_of(k)} must be finite, got {z[k]}; set another")
    stated, point, violated = model.square.at_values(z, tolerance, name_of)
    violated += model.statement.violated_bounds(z, model.square.dropped, tolerance)
    return with_side_conditions(certify_point(stated, point, tolerance), violated)


def _square(problem: cp.Problem, warm_start: bool, options: dict[str, Any]) -> Any:
    """Solve a complementarity problem."""
    model = build_from(problem)
    start = model.present() if warm_start and "z0" not in options else None
    elimination = model.square.elimination
    start = None if start is None else start[elimination.kept]
    result = solve_from(model.square, start, options)
    if model.square.dropped.size and result.is_solved:
        model.refuse_violated_bounds(result.z)
    if options["verbose"]:
        settings.LOGGER.info(result.explain())
    status, point = compat.CVXPY_STATUS[result.status], None
    if status == settings.SOLVER_ERROR:
        raise SolverError(f"{result.status.name}: {result.advice}")
    if status != settings.INFEASIBLE:
        point = elimination.expand(result.z), elimination.expand_slack(result.w), 0.0
    model.write_back(problem, result, point)
    if point is not None and (wrong := model.consistency_error(result.z, result.w)):
        warn(f"cvxpy evaluates the model to other values: {wrong}; check or rewrite it")
    if status in settings.INACCURATE:
        remark = f"the solution may be inaccurate ({result.status.name}): {result.advice}"
        warn(remark, UserWarning)
    return problem.value


def _best(problem: cp.Problem, warm_start: bool, options: dict[str, Any]) -> Any:
    """Find the best of all solutions."""
    if _has_cones(problem):
        raise UnsupportedModel(
            f"the objective {name_of(problem.objective.args[0])} occurs with a complementarity over cones, and "
            "the best of its solutions cannot be computed; write cp.Minimize(0) for any of them"
        )
    if options["algorithm"] != "auto":
        raise UnsupportedModel(
            f"algorithm={options['algorithm']!r} cannot be combined with an objective and complementarity; leave it out"
        )
    return solve_for_the_best(problem, without_agents(problem.constraints), warm_start, options)


def _has_cones(problem: cp.Problem) -> bool:
    pairs = (pair for pair in problem.constraints if isinstance(pair, Complements))
    return any("cone" in (pair.first.form, pair.second.form) for pair in pairs)


def _solve_qp(problem: cp.Problem, warm_start: bool, verbose: bool, options: dict[str, Any]) -> Any:
    """Solve a quadratic program."""
    names = NamesOnDemand(problem)
    options |= {"solver": QPSolver, "warm_start": warm_start, "verbose": verbose}
    options |= {"sense": compat.sense_of(problem), "names": Names(names.row, names.unknown)}
    try:
        return cp.Problem._solve(problem, **options)
    except DCPError as error:
        goal = problem.objective.args[0]
        if goal.is_quadratic() and not goal.is_constant():
            raise DCPError(f"{error}\n{NOT_BY_RULES}") from error
        raise
    except SolverError as error:
        if not (reasons := compat.why_not(problem)):
            raise
        raise compat.UnsolvableModel(
            'QPSolver and method="LCP" support convex quadratic programs, and problems that cvxpy compiles to them; '
            f"here {'; '.join(reasons)}. Choose a solver for cones or integers, as solver=cp.CLARABEL "
            "or cp.HIGHS; or solve the optimality conditions of a smooth convex program, cp.Problem(cp.Minimize(0), "
            "[lcp_plugin.optimal(problem, over=problem.variables())])"
        ) from error
