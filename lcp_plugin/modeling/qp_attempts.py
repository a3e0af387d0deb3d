"""A convex quadratic program solved to its own conditions: by one form of it, and by another where that does not do."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ..checks import FloatVector
from ..conversions.program import refuse_nonconvex
from ..conversions.qp_solution import QPSolution
from ..conversions.quadratic_program import QuadraticProgram, optimality_conditions
from ..conversions.substitution import Substitution, substitute_definitions
from ..errors import UnsuitableMatrix, UnsuitableProblem, UnsupportedModel
from ..problem.lcp import LCP
from ..settings import Status
from ..solving.driver import solve as solve_lcp
from ..solving.result import Result, Sample

KKT_TOLERANCE = 1e-6
TIGHTER = 1e-4
PROVES_ITSELF = "feasibility"  # the stage that looks for a proof on the complementarity problem
ANY_DIAGONAL = ("auto", "interior_point", "newton", "lemke")  # the algorithms that the zeros of a KKT form do not stop


def solve_quadratic_program(
    program: QuadraticProgram, algorithm: Any = "auto", *, tolerance: float = 1e-9, guess: FloatVector | None = None,
    **options: Any,
) -> tuple[Result, QPSolution]:
    """Return the run and the answer with the smallest residuals in the program's own terms.

    Parameters
    ----------
    program : QuadraticProgram
        Convex; merely convex and linear programs included.
    algorithm, tolerance, **options
        Of :func:`lcp_plugin.solve`. The tolerance is that of the complementarity problem; where the program's own
        residuals are above 1e-6 at it (or above ten times the tolerance, if that is larger), a smaller one is tried,
        and then the KKT form without substitutions. A limit of the caller holds for each trial and ends them all.
        As soon as a method has ended without a solution, ``program.refutation`` is looked for; where there is
        one, it ends them too, and the run is INTERRUPTED.

    guess : array, optional
        An earlier run's z: the start where it has the right length.

    Raises
    ------
    UnsupportedModel
        Where the program is not convex, or the named algorithm cannot run on a merely convex one.
    """
    refuse_nonconvex(program)
    best: tuple[Result, QPSolution] | None = None
    refusal: Exception | None = None
    own_callback = options.pop("callback", None)

    def callback(sample: Sample, z: FloatVector) -> bool:
        is_told = own_callback is not None and bool(own_callback(sample, z))
        return is_told or (sample.label == PROVES_ITSELF and program.refutation(kkt_goal(tolerance)) is not None)

    for problem, substitution in _forms(program, algorithm):
        for factor in (1.0, TIGHTER):
            start = {"z0": guess} if guess is not None and guess.size == problem.n else {}
            try:
                result = solve_lcp(
                    problem, algorithm, tolerance=factor * tolerance, callback=callback, **{**start, **options}
                )
            except (UnsuitableMatrix, UnsuitableProblem) as error:
                refusal = refusal or error
                break
            solution = problem.origin.recover(result)
            solution = solution if substitution is None else substitution.recover(solution)
            if best is None or _error(solution) < _error(best[1]):
                best = result, solution
            if solution.is_stationary(kkt_goal(tolerance)) or ended_by_caller(result, options):
                return best
            guess = result.z
            options.pop("z0", None)
            if not result.is_solved:  # a smaller tolerance would change nothing
                if program.refutation(kkt_goal(tolerance)) is not None:
                    return best
                break
    if best is None:
        raise UnsupportedModel(f"{refusal}; or leave it out: this program may be merely convex") from refusal
    return best


def kkt_goal(tolerance: float) -> float:
    """Return the size of a program's own residuals that is called optimal at this tolerance of the run."""
    return max(KKT_TOLERANCE, 10.0 * tolerance)


def ended_by_caller(result: Result, options: Mapping[str, Any]) -> bool:
    """Return whether a limit that the caller set, or the caller, ended the run."""
    limits = {Status.MAX_ITERATIONS: "max_iterations", Status.MAX_SECONDS: "max_seconds"}
    return result.status is Status.INTERRUPTED or limits.get(result.status) in options


def _forms(program: QuadraticProgram, algorithm: Any) -> Iterator[tuple[LCP, Substitution | None]]:
    """Yield problems and the substitution before each, the most promising first."""
    substitution = substitute_definitions(program)
    problem = _first_form(program if substitution is None else substitution.reduced, algorithm)
    yield problem, substitution
    if substitution is not None or problem.origin.form == "dual":
        yield optimality_conditions(program, "kkt"), None


def _first_form(program: QuadraticProgram, algorithm: Any) -> LCP:
    """Return the form that auto chooses; for an algorithm that needs a diagonal the dual one where P allows it."""
    problem = optimality_conditions(program)
    name = getattr(algorithm, "name", algorithm)
    if problem.origin.form == "kkt" and name not in ANY_DIAGONAL:
        try:
            return optimality_conditions(program, "dual")
        except UnsuitableMatrix:
            pass
    return problem


def _error(solution: QPSolution) -> float:
    error = max(solution.residual, solution.row_residual)
    return math.inf if math.isnan(error) else error
