"""What is proved about anybody's answer to a convex program: `certify`.

Everything that is said holds for the stored doubles, rounding included; the solver is never believed. A lower bound of
the optimal value comes from weak duality (:mod:`lcp_plugin.problems.programs.dual_bounds`), with the multipliers that
came with the answer and with those of a solution of our own; an upper bound from a point that is proved to be feasible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.checks import FloatVector, checked_vector, is_number
from ...core.deadline import time_limit
from ...core.errors import InvalidOption, InvalidProblem, did_you_mean
from ...core.kind import kind_of, refusal
from ...core.solving.answer import Answer
from .convexity import refuse_nonconvex
from .program import QuadraticProgram
from .program_proofs import Certification, ProgramProofs
from .qp_solution import QPSolution
from .solving import QuadraticProgramResult

CLAIMS = ("optimal", "infeasible", "unbounded")


@np.errstate(all="ignore")  # what overflows proves nothing
def certify(
    problem: Any, x: Any = None, multipliers: Any = None, *, claim: str | None = None, tolerance: float = 1e-6,
    max_seconds: float | None = None,
) -> Certification:
    """Return what is proved about an answer to a convex quadratic or linear program, whoever found it.

    Parameters
    ----------
    problem : cvxpy.Problem or QuadraticProgram
        A cvxpy problem that some solver has filled; it is left as it is.
    x : array, shape (n,), QPSolution or QuadraticProgramResult, optional
        The answer to a `QuadraticProgram`; ``certify(result)`` is ``certify(result.program, result)``.
    multipliers : array, pair of arrays or QPSolution, optional
        Those of G and A that came with x: one array of them, with those of the lower and upper bounds behind them if
        you like, or a pair, or all four. Shapes (rows of G,), (rows of A,), (n,), (n,), signs as in
        :class:`~lcp_plugin.problems.programs.qp_solution.QPSolution`. They are a part of the answer: wrong ones are
        never proved. Without them those of a solution of our own serve.
    claim : str, optional
        What is to be proved of a `QuadraticProgram`: "optimal", "infeasible" or "unbounded". By default "optimal",
        and of a result or a cvxpy problem what its status says.
    tolerance : float
        "proved" means: no constraint is violated by more than this, |f(x) − lower| ≤ tolerance (u + |f(x)|), and
        neither is x proved to be farther than 10 · tolerance max(v, ‖x‖∞) from every optimal one, nor are multipliers
        that came with it wrong by more than 10 · tolerance beside the terms of their conditions: sign, gradient, and 0
        where x leaves room. Of "infeasible": that every x violates a constraint by more than this, so that no x can be
        proved to be optimal.
    max_seconds : float, optional
        About how many seconds may be spent; what is not done by then stays unproved.

    Returns
    -------
    Certification

    Raises
    ------
    UnsupportedModel
        Where the problem is no convex quadratic or linear program: cones, integers, a P that is not semidefinite.
    InvalidProblem
        Where it has not been solved, or x or the multipliers do not fit it. Of other kinds it names the right call.
    InvalidOption
        For another claim, a tolerance that is no positive number, a limit that is none.

    Notes
    -----
    Refuted is: x that is proved to violate a constraint by more than the tolerance; a feasible point with an objective
    lower by more than tolerance (u + |f|), or for ever; a lower bound above f(x) by as much; x that is proved to be
    farther than 10 · tolerance max(v, ‖x‖∞) from every optimal one; "infeasible" beside a feasible point; "unbounded"
    beside a finite lower bound. "infeasible" and "unbounded" are proved by a Farkas vector and by a direction of
    descent, checked in rational arithmetic. A P that is positive semidefinite only to rounding gives bounds where the
    constraints bound x. Constraints that contradict by less than the tolerance may be
    met to it: neither is such an x refuted nor "infeasible" proved. u is a power of two that most coefficients of the
    objective are near, v is 1 where nothing shows another unit of x: no verdict depends on the unit of the objective.

    An optimal value does not show errors of x below √tolerance: an x that is off by 1e-4 often has it to 1e-8, as have
    answers of interior points where a constraint is active without a multiplier. That is why "proved" asks for more.
    A violation, however small, may buy any objective where units are small: unless a feasible point shows that it does
    not, the bound by multipliers of our own has to agree with f(x).

    Of a cvxpy problem the values, the objective and the constraints are yours, in double precision; bounds are those
    of the program that cvxpy makes of it.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> answer = certify(program, [0.5, 1.5])
    >>> answer.verdict, round(answer.lower, 12), round(answer.upper, 12), answer.distance < 1e-6
    ('proved', -4.5, -4.5, True)
    >>> certify(program, [0.5, 1.51]).reason
    'a constraint is violated by 0.01'
    >>> certify(program, claim="infeasible").verdict
    'refuted'
    """
    _check_options(tolerance, max_seconds)
    with time_limit(math.inf if max_seconds is None else float(max_seconds)):
        if isinstance(problem, QuadraticProgramResult) and x is None:
            problem, x = problem.program, problem
        if isinstance(x, QuadraticProgramResult) and claim is None and x.is_refuted:
            claim = str(x.status.name).lower()
        if not isinstance(problem, QuadraticProgram):
            if kind_of(problem) is not None or isinstance(problem, (Answer, QPSolution)):
                raise InvalidProblem(refusal("certify", problem))
            if x is not None or multipliers is not None or claim is not None:
                raise InvalidOption("x, multipliers and claim go with a QuadraticProgram; a cvxpy problem has its own")
            from ...modeling.certified_problem import certify_problem

            return certify_problem(problem, float(tolerance))
        if claim not in (None, *CLAIMS):
            raise InvalidOption(f"claim={claim!r} is not offered{did_you_mean(claim, CLAIMS)}")
        refuse_nonconvex(problem)
        # What a time limit cut short is not kept.
        proofs = ProgramProofs.of(problem) if max_seconds is None else ProgramProofs(problem)
        if claim in ("infeasible", "unbounded"):
            return proofs.of_claim(str(claim), float(tolerance))
        answer = _answer(problem, x, multipliers)
        return proofs.of_answer(*answer, float(tolerance))


def _answer(program: QuadraticProgram, x: Any, multipliers: Any) -> tuple[FloatVector, list[FloatVector] | None]:
    """Return x and the checked multipliers, of G and A or of all constraints."""
    if x is None:
        raise InvalidProblem("certify needs the x that is claimed to be optimal; give certify(program, x), or a claim")
    if isinstance(x, QuadraticProgramResult):
        x = x.solution
    if isinstance(x, QPSolution):
        x, multipliers = x.x, x if multipliers is None else multipliers
    point = checked_vector(x, "x", program.n)
    if multipliers is None:
        return point, None
    sizes = {"inequality": program.h.size, "equality": program.b.size, "lower": program.n, "upper": program.n}
    if isinstance(multipliers, QPSolution):
        parts: Sequence[Any] = [getattr(multipliers, name) for name in sizes]
    elif isinstance(multipliers, Mapping):
        if unknown := [name for name in multipliers if name not in sizes]:
            raise InvalidProblem(f"unknown multipliers {unknown[0]!r}{did_you_mean(unknown[0], sizes)}")
        last = 4 if {"lower", "upper"} & set(multipliers) else 2
        parts = [multipliers.get(name, np.zeros(size)) for name, size in list(sizes.items())[:last]]
    elif isinstance(multipliers, (tuple, list)) and len(multipliers) in (2, 4) and not is_number(multipliers[0]):
        parts = multipliers
    else:
        parts = _split(checked_vector(multipliers, "multipliers", None), list(sizes.values()))
    return point, [checked_vector(part, name, size) for part, (name, size) in zip(parts, sizes.items(), strict=False)]


def _split(values: FloatVector, sizes: list[int]) -> list[FloatVector]:
    ends = np.cumsum(sizes).tolist()
    if values.size not in (ends[1], ends[3]):
        raise InvalidProblem(
            f"multipliers must have length {ends[1]}, one a row of G and A, or {ends[3]} with those of the bounds, got "
            f"{values.size}"
        )
    return [part for part, end in zip(np.split(values, ends[:3]), ends, strict=True) if end <= values.size]


def _check_options(tolerance: Any, max_seconds: Any) -> None:
    if not is_number(tolerance) or not 0.0 < tolerance < math.inf:
        raise InvalidOption(f"tolerance must be a number > 0, got {tolerance!r}")
    if max_seconds is not None and (not is_number(max_seconds) or not max_seconds > 0.0):
        raise InvalidOption(f"max_seconds must be a number > 0 or None, got {max_seconds!r}")
