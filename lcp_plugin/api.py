"""The function solve(), for all problem classes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

from .core.lcp import LCP
from .solving import dispatch
from .solving.result import Result

if TYPE_CHECKING:
    from typing import Unpack

    from .core.algorithm import Algorithm
    from .core.settings import EngineName, Options
    from .engines.engine import Engine
    from .problems.cones.data import ConeProblem
    from .problems.cones.frictional_contact import FrictionalContact
    from .problems.cones.methods import ConeAlgorithm
    from .problems.cones.solving import ConeResult
    from .problems.equilibria.equilibrium_program import EquilibriumProgram
    from .problems.equilibria.relaxations import EquilibriumResult
    from .problems.least_squares.data import BoundedLeastSquares
    from .problems.least_squares.solving import LeastSquaresResult
    from .problems.nonlinear.data import NonlinearProblem
    from .problems.programs.program import QuadraticProgram
    from .problems.programs.result import QuadraticProgramResult

    Method = str | Algorithm


@overload
def solve(
    problem: LCP | NonlinearProblem, algorithm: Method = "auto", **options: Unpack[Options]
) -> Result: ...
@overload
def solve(
    problem: QuadraticProgram, algorithm: EngineName, **options: Any
) -> QuadraticProgramResult: ...
@overload
def solve(
    problem: QuadraticProgram, algorithm: Method | Engine = "auto", **options: Unpack[Options]
) -> QuadraticProgramResult: ...
@overload
def solve(problem: EquilibriumProgram, **options: Unpack[Options]) -> EquilibriumResult: ...
@overload
def solve(problem: BoundedLeastSquares, **options: Unpack[Options]) -> LeastSquaresResult: ...
@overload
def solve(
    problem: ConeProblem | FrictionalContact,
    algorithm: str | ConeAlgorithm = "auto",
    **options: Unpack[Options],
) -> ConeResult: ...
def solve(problem: object, algorithm: object = "auto", **options: Any) -> Any:
    """Return the solution of a problem, with its residual measured on the problem's own data.

    Parameters
    ----------
    problem : LCP, or another problem class
        QuadraticProgram, EquilibriumProgram, NonlinearProblem, BoundedLeastSquares, ConeProblem, FrictionalContact.
        Never modified. The descriptions below refer to an LCP; see Notes for the other classes.
    algorithm : str or Algorithm
        A registered name (see ``lcp-plugin list``), "auto", or an object such as ``NPSOR(relaxation=1.5)``.
    **options
        The options below, and the options of the named algorithm.
    z0 : array, shape (n,), or a number for n = 1, optional
        Starting point, projected onto the bounds; a NonlinearProblem and BoundedLeastSquares call it x0. Default: the
        point of [lower, upper] nearest to 0. ``lemke`` tries the active set of z0 first; so does ``interior_point`` if
        the residual of z0 is at most a tenth of the default start's residual. Otherwise both ignore z0, as external
        solvers of programs do.
    tolerance : float
        Relative tolerance in [0, 1). Default 1e-8; for a QuadraticProgram and an EquilibriumProgram 1e-6 (duality gap).
        SOLVED means that in every connected component of M's graph the residual of the returned z, rounding included,
        is at most this times the residual of the point of [lower, upper] nearest to 0, and that no row is violated by
        more than tolerance^(3/4) of its terms: ``help("lcp_plugin.judges.lcp")``.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, with set-up and without compilation of kernels. It is obeyed at the end of the
        iteration under way, as Ctrl-C is, which raises KeyboardInterrupt before the first step; a long factorization
        is finished first. With a limit, no factorization is begun that is predicted to end after it.
    absolute_tolerance : float
        In the unit of z: a component with ‖r‖∞ ≤ absolute_tolerance also counts as solved. Use it for contacts at rest,
        whose gaps are rounding errors. INFEASIBLE and NO_SOLUTION are proved by a larger margin.
    record : bool
        Keep samples of the run at geometric intervals in ``Result.history``; an external solver has a first and a last.
    callback : callable, optional
        Called as ``callback(sample, z)`` at every step with a read-only view of z; a truthy return value ends the
        run with status INTERRUPTED. Its exceptions propagate. For an external solver it is called with the first and
        the last point.
    prove_infeasibility : bool
        If no solution is found, search for a proof that none exists. False saves this work: such a run then ends
        STALLED.
    polish : bool
        Whether a last sweep of the np methods and a linear solve on the active set may replace the last iterate. The
        linear solve is made if its predicted work is at most a tenth of the run's, or if "auto" has not solved the
        problem. False returns the iterate.
    threads : int, optional
        Number of threads of this solve; by default all that the process may use. The result is the same bit for bit
        for any number. ``OMP_NUM_THREADS`` sets the threads of BLAS.
    verbose : bool
        Print the problem, each stage, iterations at geometric intervals (iteration, work in passes over M, residual,
        seconds), the end, and a line when kernels are compiled. By default nothing is printed.

    Returns
    -------
    Result
        Other problem classes have their own result classes; each is an
        :class:`~lcp_plugin.solving.result.BaseResult`, with status, x, objective, advice and proof. For every
        status, also after Ctrl-C, it holds the best iterate whose residual was measured (in-place methods are measured
        at intervals and at the end); before the first step this is the start. ``result.require_solved()`` raises
        NotConverged if the status is not SOLVED.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        Before the first iteration.
    UnsupportedModel
        If a QuadraticProgram is not convex.
    InvalidProblem
        If the functions of a NonlinearProblem return no usable values.

    Notes
    -----
    For other problem classes, the functions and classes below describe the options (others raise InvalidOption), the
    meaning of SOLVED, and the default tolerance:

    - ``NonlinearProblem``, with ``x0=``: :func:`~lcp_plugin.problems.nonlinear.solving.solve_nonlinear`;
    - ``QuadraticProgram``, linear ones included: SOLVED (optimal) by the program's own residuals, INFEASIBLE and
      UNBOUNDED with a proof, see :class:`~lcp_plugin.problems.programs.result.QuadraticProgramResult`; options as for
      an LCP, z0 is the ``result.z`` of an earlier run, a start where that has as many unknowns;
    - ``EquilibriumProgram``: :func:`~lcp_plugin.problems.equilibria.branch_and_bound.minimize_over_solutions`;
    - ``BoundedLeastSquares``: :func:`~lcp_plugin.problems.least_squares.solving.solve_least_squares`;
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
    return dispatch.solve(problem, algorithm, **options)
