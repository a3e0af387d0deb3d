"""The kinds of problems, in the order of README's table, and what solves each."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from .auto import solve_lcp
from .core.errors import InvalidOption, did_you_mean
from .core.kind import LINEAR_COMPLEMENTARITY_PROBLEM, Kind, kind_of, refusal, with_article
from .core.settings import Status
from .problems.cones import CONE_PROBLEM, FRICTIONAL_CONTACT
from .problems.equilibria import EQUILIBRIUM_PROGRAM
from .problems.least_squares import BOUNDED_LEAST_SQUARES
from .problems.nonlinear import NONLINEAR_PROBLEM
from .problems.programs.kind import QUADRATIC_PROGRAM

NO_TIME = 1e-9  # seconds: a run ends at its start
KINDS = (
    LINEAR_COMPLEMENTARITY_PROBLEM,
    NONLINEAR_PROBLEM,
    QUADRATIC_PROGRAM,
    EQUILIBRIUM_PROGRAM,
    BOUNDED_LEAST_SQUARES,
    CONE_PROBLEM,
    FRICTIONAL_CONTACT,
)


@cache
def solver_of(kind: Kind) -> Callable[..., Any]:
    """Return the function that solves a kind of problem; the other kinds need not be loaded."""
    if kind is NONLINEAR_PROBLEM:
        from .problems.nonlinear.solving import solve_nonlinear

        return solve_nonlinear
    if kind is QUADRATIC_PROGRAM:
        from .problems.programs.solving import solve_program

        return solve_program
    if kind is EQUILIBRIUM_PROGRAM:
        from .problems.equilibria.branch_and_bound import minimize_over_solutions

        return minimize_over_solutions
    if kind is BOUNDED_LEAST_SQUARES:
        from .problems.least_squares.solving import solve_least_squares

        return solve_least_squares
    if kind in (CONE_PROBLEM, FRICTIONAL_CONTACT):
        from .problems.cones.solving import solve_cones

        return solve_cones
    return solve_lcp


@cache
def options_of(kind: Kind) -> Mapping[str, Any] | None:
    """Return the options of what solves a kind, with their defaults; None where it takes an algorithm's as well."""
    parameters = list(inspect.signature(solver_of(kind)).parameters.values())[1:]
    if any(one.kind is one.VAR_KEYWORD for one in parameters):
        return None
    return {one.name: one.default for one in parameters}


def solve_any(problem: Any, algorithm: Any, wishes: Mapping[str, Any]) -> Any:
    """Return the answer to a problem of any kind.

    Raises
    ------
    InvalidOption
        Where it is none, is asked for what its kind does not take, or lacks what that needs.
    """
    kind = kind_of(problem)
    if kind is None:
        raise InvalidOption(refusal("solve", problem))
    is_ended = False
    try:
        options = options_of(kind)
    except KeyboardInterrupt:  # in the import of what solves it, which begins anew
        is_ended, options = True, options_of(kind)
    if (
        "z0" in wishes and "x0" in (options or {}) and "x0" not in wishes
    ):  # the same, of an unknown that is called x
        wishes = {"x0" if name == "z0" else name: wish for name, wish in wishes.items()}
    if options is None or "algorithm" in options or algorithm != "auto":
        wishes = {"algorithm": algorithm, **wishes}
    kind.refuse(wishes)
    for name in wishes:
        if options is not None and name not in options:
            raise InvalidOption(
                f"solve takes no {name} for {with_article(kind.word)}{did_you_mean(name, options)}"
            )
    for name, default in (options or {}).items():
        if default is inspect.Parameter.empty and name not in wishes:
            article = with_article(kind.word)
            raise InvalidOption(f"solve needs {name} for {article}: write solve(problem, {name}=…)")
    if not is_ended:
        try:
            return solver_of(kind)(problem, **wishes)
        except KeyboardInterrupt:  # before a run that keeps it for itself, as in a first value of F
            pass
    result = solver_of(kind)(problem, **{**wishes, "max_seconds": NO_TIME})
    return (
        replace(result, status=Status.INTERRUPTED)
        if result.status is Status.MAX_SECONDS
        else result
    )
