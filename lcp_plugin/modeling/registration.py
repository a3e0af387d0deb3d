"""From cvxpy problems to LCPs and back: problem.solve(method="LCP"), and what cvxpy users find after a solve."""

from __future__ import annotations

import warnings
import weakref
from collections.abc import Mapping
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.constraints.constraint import Constraint
from cvxpy.constraints.zero import Equality, Zero
from cvxpy.error import SolverError
from cvxpy.problems.problem import SolverStats
from cvxpy.reductions.solution import Solution

from ..core.errors import NotSquare, UnsupportedModel
from ..core.lcp import LCP
from ..core.solving.result import Result
from ._compat import (
    CVXPY_STATUS,
    answer_derivatives,
    clear_answering,
    name_of,
    refuse_without_derivatives,
    set_answering,
    solver_errors,
    statistics,
)
from .assembly import solve_from
from .builder import Builder, warn
from .constraint import Complements, box, complements
from .model import Model, ModelBatch, contradiction, solve_for
from .model_derivative import (
    Differentiable,
    ModelDerivative,
    differentiable_parameters,
    values_of_parameters,
)
from .program_derivative import ProgramDerivative, refuse_undisciplined
from .qp_solver import QPSolver
from .stated_terms import refusal

METHODS = ("LCP", "lcp")
CVXPY_FLAGS = ("gp", "qcp", "nlp", "enforce_dpp", "ignore_dpp", "canon_backend", "bibtex")


def register() -> None:
    """Make ``problem.solve(method="LCP")`` known to cvxpy; done on the first use of any modelling name.

    ``import lcp_plugin`` and ``import cvxpy`` do, in either order; this is for a cvxpy that came from no file.
    """
    for name in METHODS:
        cp.Problem.register_solve(name, solve_model)
    answer_derivatives()


def is_complementarity_problem(problem: Any) -> bool:
    """Return whether a cvxpy problem has a complementarity among its constraints.

    Parameters
    ----------
    problem : cvxpy.Problem

    Examples
    --------
    >>> import cvxpy as cp
    >>> is_complementarity_problem(cp.Problem(cp.Minimize(0)))
    False
    """
    return isinstance(problem, cp.Problem) and any(
        isinstance(c, Complements) for c in problem.constraints
    )


class ComplementarityProblem(cp.Problem):  # type: ignore[misc]
    """A cvxpy problem that is nothing but complementarities and equalities.

    Parameters
    ----------
    constraints : list
        Of :func:`complements` and equalities; a single one need not stand in a list.

    Raises
    ------
    UnsupportedModel
        Where something in the list is no constraint.

    Examples
    --------
    >>> import cvxpy as cp
    >>> from lcp_plugin import complements
    >>> x = cp.Variable()
    >>> problem = ComplementarityProblem([complements(x >= 0, 2 * x - 3 >= 0)])
    >>> problem.solve(tolerance=1e-12), problem.status, float(x.value)
    (0.0, 'optimal', 1.5)
    """

    def __init__(self, constraints: Any) -> None:
        super().__init__(cp.Minimize(0), _listed(constraints))

    def solve(self, algorithm: Any = "auto", **options: Any) -> Any:
        """Solve as ``cp.Problem.solve(method="LCP")`` does; see :func:`solve_model`."""
        if options.pop("method", "LCP") not in METHODS:
            raise UnsupportedModel(
                'a ComplementarityProblem is solved by method="LCP" only; leave the method out'
            )
        return solve_model(self, algorithm=algorithm, **options)

    def solve_batch(self, parameters: Mapping[cp.Parameter, Any], **options: Any) -> ModelBatch:
        """Solve for many values of the parameters at once; parameters and variables keep their values.

        Parameters
        ----------
        parameters : dict
            From a parameter to its stacked values, shape (B, *its shape).
        **options
            As for :func:`lcp_plugin.solve_batch`.

        Returns
        -------
        ModelBatch
            ``value(x)`` are the stacked values of the variable x, ``batch`` has status and residuals.

        Examples
        --------
        >>> import cvxpy as cp
        >>> from lcp_plugin import complements
        >>> x, load = cp.Variable(), cp.Parameter()
        >>> problem = ComplementarityProblem(complements(x >= 0, 2 * x - load >= 0))
        >>> problem.solve_batch({load: [3.0, -1.0, 5.0]}).value(x).tolist()
        [1.5, 0.0, 2.5]
        """
        return solve_for(self, parameters, build_from, options)

    def copy(self, args: Any = None, id_objects: Any = None) -> ComplementarityProblem:
        """Return a problem with the same constraints."""
        return ComplementarityProblem(list(self.constraints if args is None else args[1]))


def _listed(constraints: Any) -> list[Any]:
    """Return the constraints as a list, or raise naming what is none."""
    if isinstance(constraints, Constraint):
        return [constraints]
    try:
        if isinstance(constraints, (str, cp.Expression)):
            raise TypeError("it can be looped over, but is no list")
        listed = list(constraints)
    except TypeError as error:
        raise UnsupportedModel(
            f"a ComplementarityProblem needs a list of constraints, got {constraints!r}; write "
            "[complements(x >= 0, F >= 0)]"
        ) from error
    for constraint in listed:
        if not isinstance(constraint, Constraint):
            raise UnsupportedModel(
                f"a ComplementarityProblem needs constraints, and its list holds {constraint!r}; write complements(…) "
                "or an equality of expressions"
            )
    return listed


def build(constraints: list[Any], memo: dict[Any, Any] | None = None) -> Model:
    """Return the LCP that a list of complementarities and equalities states.

    Raises
    ------
    UnsupportedModel
        Naming the constraint or variable that stands in the way, and the remedy.
    """
    builder = Builder(constraints, {} if memo is None else memo)
    for constraint in constraints:
        if isinstance(constraint, (Equality, Zero)):
            builder.add_equation(constraint)
    for constraint in constraints:
        if isinstance(constraint, Complements):
            builder.add_pair(constraint)
        elif not isinstance(constraint, (Equality, Zero)):
            raise NotSquare(
                f"the constraint {constraint} stands alone beside complementarities; make it part of a pair, as in "
                f"complements({constraint}, F >= 0)"
            )
    warn(builder.remarks)
    return builder.finished()


_memos: weakref.WeakKeyDictionary[Any, dict[int, tuple[Any, Any]]] = weakref.WeakKeyDictionary()


def build_from(problem: Any) -> Model:
    """Return the model of a cvxpy problem; what depends on no parameter is kept for the next call."""
    if not isinstance(problem, cp.Problem):
        kind = type(problem).__name__
        raise UnsupportedModel(
            f"a cvxpy problem is needed, got {kind}; write ComplementarityProblem([…])"
        )
    if not problem.objective.args[0].is_constant():
        raise UnsupportedModel(
            f"the objective {name_of(problem.objective.args[0])} beside complementarity asks for the best of all "
            'solutions, which no single LCP states: problem.solve(method="LCP") finds it; write cp.Minimize(0) for '
            "any of them"
        )
    return build(problem.constraints, _memos.setdefault(problem, {}))


def lcp_stated_by(problem: Any) -> LCP:
    """Return the LCP of a cvxpy problem, with the model as its origin."""
    model = build_from(problem)
    stated = model.lcp("LCP.from_cvxpy")
    stated.origin = model
    return stated


def stated_in_cvxpy(problem: LCP) -> Any:
    """Return the ComplementarityProblem in one variable z that states an LCP."""
    if problem.n == 0:  # older versions of cvxpy have no empty variables
        return ComplementarityProblem([])
    z = cp.Variable(problem.n, name="z")
    F = problem.csr @ z + problem.q
    return ComplementarityProblem([complements(box(z, problem.lower, problem.upper), F)])


def solve_model(
    problem: Any,
    algorithm: Any = "auto",
    *,
    warm_start: bool = True,
    verbose: bool = False,
    solver: Any = None,
    requires_grad: bool = False,
    **options: Any,
) -> Any:
    """Solve a complementarity problem, or an ordinary quadratic program, stated in cvxpy.

    Parameters
    ----------
    problem : cvxpy.Problem
    algorithm : str or Algorithm
        As in :func:`lcp_plugin.solve`.
    warm_start : bool
        Begin with the present values of the variables where all have one.
    verbose : bool
        Print the run as :func:`lcp_plugin.solve` does, then tell its story through cvxpy's logger.
    solver : None
        There because cvxpy passes it; there is no other solver to choose.
    requires_grad : bool
        Let ``problem.backward()`` and ``problem.derivative()`` differentiate this solution afterwards.
    **options
        Options of :func:`lcp_plugin.solve` and of the algorithm.

    Returns
    -------
    float
        The value of the objective: 0 for a complementarity problem, ∞ where it is proved to have no solution.

    Raises
    ------
    UnsupportedModel
        Where the model is none of the two; the message names what stands in the way. It is a SolverError as well.
    cvxpy.error.SolverError
        Where the run diverged.
    """
    with solver_errors():
        if solver is not None:
            raise UnsupportedModel(
                f'method="LCP" chooses no cvxpy solver, got solver={solver!r}; write algorithm=…'
            )
        clear_answering(problem)
        if requires_grad:
            refuse_without_derivatives()
        return _solve_model(problem, algorithm, warm_start, bool(verbose), requires_grad, options)


def _solve_model(
    problem: Any,
    algorithm: Any,
    warm_start: bool,
    verbose: bool,
    requires_grad: bool,
    options: dict[str, Any],
) -> Any:
    """Solve what is a complementarity problem as one, and else a program."""
    if not is_complementarity_problem(problem) and not isinstance(problem, ComplementarityProblem):
        run = _differentiable_program if requires_grad else _program
        return run(problem, warm_start, verbose, {"algorithm": algorithm, **options})
    _refuse_flags(options)
    if not problem.objective.args[0].is_constant():
        return _best(problem, algorithm, verbose, warm_start, requires_grad, options)
    parameters = differentiable_parameters(problem) if requires_grad else []
    known = values_of_parameters(parameters) if requires_grad else {}
    try:
        model = build_from(problem)
    except NotSquare as error:
        if algorithm != "auto" or requires_grad:
            raise
        return _any(problem, error, bool(verbose), warm_start, options)
    start = model.start() if warm_start and "z0" not in options else None
    result = solve_from(
        model.problem, start, {"algorithm": algorithm, "verbose": verbose, **options}
    )
    if verbose:
        settings.LOGGER.info(result.explain())
    write_back(problem, model, result)
    answering = None
    if requires_grad:
        constraints = [report.constraint for report in model.reports]
        answering = Differentiable(ModelDerivative(model, result, known), parameters, constraints)
    set_answering(problem, answering)
    return problem.value


def _any(
    problem: Any, refusal: NotSquare, verbose: bool, warm_start: bool, options: dict[str, Any]
) -> Any:
    """Find any solution of a model with more rows and bounds than an LCP has, by a search for the best; or raise."""
    from .best_equilibrium import solve_for_the_best

    if _has_cones(problem):
        raise refusal
    try:
        return solve_for_the_best(problem, verbose, warm_start, options)
    except UnsupportedModel as error:
        raise refusal from error


def _best(
    problem: Any,
    algorithm: Any,
    verbose: bool,
    warm_start: bool,
    requires_grad: bool,
    options: dict[str, Any],
) -> Any:
    """Find the best of all solutions."""
    from .best_equilibrium import solve_for_the_best

    if _has_cones(problem):
        raise UnsupportedModel(
            f"the objective {name_of(problem.objective.args[0])} stands beside a complementarity over cones, and "
            "nothing searches for the best of its solutions; write cp.Minimize(0) for any of them"
        )
    if algorithm != "auto" or requires_grad:
        what = "requires_grad=True" if requires_grad else f"algorithm={algorithm!r}"
        rest = "; for a local search leave out the objective" if requires_grad else "; leave it out"
        raise UnsupportedModel(f"{what} does not go with an objective beside complementarity{rest}")
    return solve_for_the_best(problem, verbose, warm_start, options)


def _has_cones(problem: Any) -> bool:
    pairs = [one for one in problem.constraints if isinstance(one, Complements)]
    return any(side.kind == "cone" for pair in pairs for side in (pair.first, pair.second))


def _program(problem: Any, warm_start: bool, verbose: bool, options: dict[str, Any]) -> Any:
    """Solve a quadratic program."""
    try:
        value = cp.Problem._solve(
            problem, solver=QPSolver, warm_start=warm_start, verbose=verbose, **options
        )
    except SolverError as error:
        if (refused := refusal(problem)) is None:
            raise
        raise refused from error
    set_answering(problem, None)
    return value


def _differentiable_program(
    problem: Any, warm_start: bool, verbose: bool, options: dict[str, Any]
) -> Any:
    """Solve a quadratic program by cvxpy's three public steps, and keep what its derivatives need."""
    _refuse_flags(options)
    parameters = differentiable_parameters(problem)
    known = values_of_parameters(parameters)
    data, chain, inverse_data = problem.get_problem_data(QPSolver, verbose=verbose)
    refuse_undisciplined(chain)
    answer = chain.solve_via_data(problem, data, warm_start, verbose, options)
    solution = ProgramDerivative(problem, data, chain, inverse_data, answer, known)
    problem.unpack_results(answer, chain, inverse_data)
    solution.confirm(problem)
    set_answering(problem, Differentiable(solution, parameters, solution.constraints))
    return problem.value


def _refuse_flags(options: Mapping[str, Any]) -> None:
    foreign = [name for name in CVXPY_FLAGS if name in options]
    if foreign:
        raise UnsupportedModel(f'{", ".join(foreign)} means nothing to method="LCP"; leave it out')


def write_back(problem: Any, model: Model, result: Result) -> None:
    """Give the cvxpy problem its status, values, duals and statistics."""
    status = CVXPY_STATUS[result.status]
    if status == settings.SOLVER_ERROR:
        raise SolverError(f"{result.status.name}: {result.advice}")
    attributes, duals = statistics(result), model.duals(result.z, result.w)
    own = {constraint.id for constraint in problem.constraints}
    if status == settings.INFEASIBLE:
        problem.unpack(Solution(status, np.inf, {}, {}, attributes))
    else:
        known = {constraint.id: value for constraint, value in duals if constraint.id in own}
        problem.unpack(Solution(status, 0.0, model.values(result.z), known, attributes))
    for constraint, value in duals:
        if constraint.id not in own:  # the inequality inside a pair, which cvxpy does not know
            if status == settings.INFEASIBLE:
                for dual in constraint.dual_variables:
                    dual.save_value(None)
            else:
                constraint.save_dual_value(value)
    problem._solver_stats = SolverStats.from_dict(attributes, "LCP")
    if (
        status != settings.INFEASIBLE
        and (what := contradiction(model, result.z, result.w)) is not None
    ):
        problem._clear_solution()
        raise SolverError(
            f"the problem contradicts its own answer: {what}; write the expression in another way"
        )
    if status in settings.INACCURATE:
        warnings.warn(
            f"the solution may be inaccurate ({result.status.name}): {result.advice}",
            UserWarning,
            stacklevel=4,
        )
