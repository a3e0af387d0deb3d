"""solve(): one verb for every class of problem."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from .core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from .core.lcp import LCP
from .core.problem_classes import class_of, refusal, with_article
from .core.solving.result import Result

if TYPE_CHECKING:
    from .problems.cones.data import ConeProblem
    from .problems.cones.frictional_contact import FrictionalContact
    from .problems.cones.solving import ConeResult
    from .problems.equilibria.equilibrium_program import EquilibriumProgram
    from .problems.equilibria.result import EquilibriumResult
    from .problems.least_squares.data import BoundedLeastSquares
    from .problems.least_squares.solving import LeastSquaresResult
    from .problems.nonlinear.data import NonlinearProblem
    from .problems.programs.program import QuadraticProgram
    from .problems.programs.solving import QuadraticProgramResult

# The function that solves each class of problem; the others need not be loaded.
SOLVERS = {
    "LCP": "auto:solve_lcp",
    "NonlinearProblem": "problems.nonlinear.solving:solve_nonlinear",
    "QuadraticProgram": "problems.programs.solving:solve_program",
    "EquilibriumProgram": "problems.equilibria.branch_and_bound:minimize_over_solutions",
    "BoundedLeastSquares": "problems.least_squares.solving:solve_least_squares",
    "ConeProblem": "problems.cones.solving:solve_cones",
    "FrictionalContact": "problems.cones.solving:solve_cones",
}


@overload
def solve(problem: LCP, algorithm: Any = "auto", **options: Any) -> Result: ...
@overload
def solve(problem: NonlinearProblem, algorithm: Any = "auto", **options: Any) -> Result: ...
@overload
def solve(
    problem: QuadraticProgram, algorithm: Any = "auto", **options: Any
) -> QuadraticProgramResult: ...
@overload
def solve(
    problem: EquilibriumProgram, algorithm: Any = "auto", **options: Any
) -> EquilibriumResult: ...
@overload
def solve(
    problem: BoundedLeastSquares, algorithm: Any = "auto", **options: Any
) -> LeastSquaresResult: ...
@overload
def solve(
    problem: ConeProblem | FrictionalContact, algorithm: Any = "auto", **options: Any
) -> ConeResult: ...
@overload
def solve(problem: Any, algorithm: Any = "auto", **options: Any) -> Any: ...
def solve(problem: Any, algorithm: Any = "auto", **options: Any) -> Any:
    """Return the solution of a problem, with its residual measured on the problem's own data.

    Parameters
    ----------
    problem : LCP, QuadraticProgram, EquilibriumProgram, NonlinearProblem, BoundedLeastSquares, or one over cones
        Never modified. What follows is said of an LCP; see Notes for the others.
    algorithm : str or Algorithm
        A registered name (see ``lcp-plugin list``), "auto", or an object such as ``NPSOR(relaxation=1.5)``.
    **options
        As follows, and those of the named algorithm.
    z0 : array, shape (n,), or a number for n = 1, optional
        Start, of every kind of problem; x0 is the same where the unknown is called x. It is projected onto the bounds;
        by default it is the point of [lower, upper] nearest to 0. ``interior_point`` and
        ``lemke`` begin with the active set of a z0 whose residual is at most a tenth of that of the default start;
        engines of programs begin anew. Where a start changes nothing, ``explain()`` says so.
    tolerance : float
        In [0, 1), relative: 1e-8 by default, of a QuadraticProgram and an EquilibriumProgram 1e-6 (the gap). Here
        SOLVED means that in every connected component of M's graph the residual of the returned z, rounding included,
        is at most this times that of the point of [lower, upper] nearest to 0, and that no row is violated by more
        than tolerance^(3/4) of its terms: ``help("lcp_plugin.core.certificates.criterion")``.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, with set-up and without compilation of kernels. It is obeyed at the end of the
        iteration under way, as Ctrl-C is, which raises KeyboardInterrupt before the first step; a long factorization
        is finished first. With a limit, none is begun that is predicted not to fit.
    absolute_tolerance : float
        In the unit of z: a component with ‖r‖∞ ≤ absolute_tolerance is solved in any case. Use it for contacts at rest,
        whose gaps are rounding. INFEASIBLE and NO_SOLUTION are proved by more than it.
    record : bool
        Keep samples of the run at geometric intervals in ``Result.history``; of an engine its start and its end.
    callback : callable, optional
        Called as ``callback(sample, z)`` at every step with a read-only view of z; a truthy return value ends the
        run with status INTERRUPTED. What it raises is passed on. External solvers show no steps: it is called with
        their point.
    error_bound : bool
        Bound |z − z*| in the result, computed when it is looked at. None where nothing about M allows a bound; see
        :func:`lcp_plugin.error_bound`.
    prove_infeasibility : bool
        Look for a proof that there is no solution where none is found. False saves the work: a run that finds no
        solution then ends STALLED.
    threads : int, optional
        How many threads this solve may use; by default all that the process may use. The answer is the same bit for
        bit for any number. BLAS has a number of its own, ``OMP_NUM_THREADS``.
    verbose : bool
        Print the problem, each stage, iterations at geometric intervals (iteration, work in passes over M, residual,
        seconds), the end, and that kernels are compiled where that takes long; nothing is printed otherwise.

    Returns
    -------
    Result
        For other kinds of problem a result class of their own; each is an
        :class:`~lcp_plugin.core.solving.answer.Answer`, with status, x, objective, advice and proof. Always, whatever
        the status, with the best iterate whose residual was measured (in-place methods are measured at intervals and
        at the end), also after Ctrl-C; before the first step that is the start. ``result.require_solved()`` raises
        instead.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        Before the first iteration.

    Notes
    -----
    For other kinds of problem, the functions and classes below say which options there are (others raise
    InvalidOption), what SOLVED means, and which tolerance is the default:

    - ``NonlinearProblem``, with ``x0=``: :func:`~lcp_plugin.problems.nonlinear.solving.solve_nonlinear`;
    - ``QuadraticProgram``, linear ones included: SOLVED (optimal) by the program's own residuals, INFEASIBLE and
      UNBOUNDED with a proof, see :class:`~lcp_plugin.problems.programs.solving.QuadraticProgramResult`; options as for
      an LCP, z0 is the ``result.z`` of an earlier run, a start where that has as many unknowns;
    - ``EquilibriumProgram``: :func:`~lcp_plugin.problems.equilibria.branch_and_bound.minimize_over_solutions`;
    - ``BoundedLeastSquares``: :func:`~lcp_plugin.problems.least_squares.solving.bounded_least_squares`;
    - ``ConeProblem`` and ``FrictionalContact``: :func:`~lcp_plugin.problems.cones.solving.solve_cones`.

    The first problem of its kind in an installation compiles for 2 to 10 s, once; ``lcp-plugin warm-up`` compiles
    everything.

    Examples
    --------
    >>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> result = solve(problem, "npsor", relaxation=1.7)
    >>> result.status.name, result.z.round(6)
    ('SOLVED', array([0.75, 0.  ]))

    >>> from lcp_plugin import QuadraticProgram
    >>> best = solve(QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2]))
    >>> best.status.name, best.x.round(6), round(best.objective, 6), best.duals["inequality"].round(6)
    ('SOLVED', array([0.5, 1.5]), -4.5, array([1.]))
    """
    name = class_of(problem)
    if name is None:
        raise InvalidOption(refusal("solve", problem))
    if isinstance(algorithm, (np.ndarray, list, tuple)):
        raise UnknownAlgorithm(
            f"algorithm must be a name or an object, got {algorithm!r}; a start is z0=…"
        )
    if not isinstance(algorithm, str) or algorithm != "auto":
        options["algorithm"] = algorithm
    known = options_of(name)
    if "z0" in options and "z0" not in known and "x0" in known:  # the unknown is called x
        options["x0"] = options.pop("z0")
    for option in () if "options" in known else options:
        if option not in known:
            hint = did_you_mean(option, known)
            raise InvalidOption(f"solve takes no {option} for {with_article(name)}{hint}")
    return solver_of(name)(problem, **options)


@cache
def solver_of(name: str) -> Callable[..., Any]:
    """Return the function that solves a class of problem."""
    module, _, function = SOLVERS[name].partition(":")
    solver: Callable[..., Any] = getattr(import_module(f".{module}", __package__), function)
    return solver


@cache
def options_of(name: str) -> Mapping[str, Any]:
    """Return the options of the solver of a class; "options" is one of them if it takes an algorithm's as well."""
    return {option: None for option in [*inspect.signature(solver_of(name)).parameters][1:]}
