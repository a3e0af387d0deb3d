"""What a solver says, judged on the problem as its user stated it: before cvxpy rewrote anything.

The solver only sees a program that cvxpy derived. An error in the derivation is invisible in it, however exact the
answer is. What shows it are the user's own expressions:

- the objective at the returned values is the value that the solver claims, and no constraint is violated;
- with the returned multipliers λ the Lagrangian f + Σ λ g is nowhere below that value (weak duality; a few points);
- "infeasible": Σ λ g of the proof is above its contradiction c > 0 at every point, for the same reason;
- "unbounded": the user's objective falls along the proof's direction as the program's does, and his constraints hold.

Each of these is necessary, none sufficient: a few points are no proof, but they cost a few products with the data.

A solver inside cvxpy never sees the user's problem. ``get_problem_data`` and ``unpack_results`` do, in every release;
all roads to QPSolver lead through them. The first is wrapped, and passes on what is for other solvers; the second is
replaced in a problem that was compiled for QPSolver, until it is compiled for another solver.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any
from weakref import WeakKeyDictionary

import cvxpy as cp
import numpy as np
from cvxpy import settings
from cvxpy.constraints import Equality, Inequality, NonNeg, NonPos, Zero
from cvxpy.error import SolverError
from cvxpy.reductions.solution import Solution
from numpy.typing import NDArray

from ._compat import attribute_bounds, clear_answering, leaf_value, name_of, postorder
from .stated_terms import StatedTerms, Terms, Values, dense_value, entries_of, expression_of, nearest, sense_of

EQUATIONS = (Equality, Zero)
INEQUALITIES = (Inequality, NonPos, NonNeg)
METHODS = ("LCP", "lcp")
#: What atoms of cvxpy raise at values that they do not expect, for instance sparse ones of diagonal variables.
CANNOT_BE_EVALUATED = (ValueError, TypeError, IndexError, NotImplementedError, ArithmeticError)

ROUNDING = 1e-9  # of the terms of an exact statement that is evaluated in doubles
FAR = 10.0  # of 1 + |point|, along a direction without end
ORDINARY = (1e-100, 1e100)  # numbers whose products are doubles
FAR_NUMBERS = "lcp_plugin.far_numbers"  # the key of the program's data under which they are asked for


@dataclass(frozen=True)
class UserAnswer:
    """A solver's answer in the variables and constraints of the user.

    Parameters
    ----------
    solution : cvxpy Solution
        As it was unpacked.
    tolerance : float
        What the solver itself calls optimal, relative to 1 + the terms.
    contradiction : cvxpy Solution, float
        Of "infeasible": the multipliers of the proof, as duals, and the c > 0 that they prove.
    points : list of cvxpy Solution
        Of "unbounded": three points with equal steps between them along the ray, with the values that the program has.
    """

    solution: Solution
    tolerance: float
    contradiction: tuple[Solution, float] | None = None
    points: tuple[Solution, ...] = ()


def disagreement(problem: Any, claim: UserAnswer, stated: StatedTerms) -> str | None:
    """Return what the problem itself says against the claim, or None.

    Parameters
    ----------
    problem : cvxpy.Problem
        With the values that the claim left in its variables; it is left with them.
    stated : StatedTerms
        Of the problem.
    """
    if claim.contradiction is not None:
        duals, least = claim.contradiction
        if any(np.any(np.greater(*attribute_bounds(variable))) for variable in problem.variables()):
            return None  # a parameter crosses the bounds: no point at all has these attributes
        zero = {variable.id: np.zeros(variable.shape) for variable in problem.variables()}
        for value, size in _weighed(problem, duals, stated.lines(stated.points_around(zero)), 0.0):
            if value < least - ROUNDING * (least + size):
                return (
                    f"the combination of its constraints that should be at least {least:.3g} everywhere is "
                    f"{value:.3g} at a point"
                )
    elif claim.points:
        return _against_unboundedness(problem, stated, claim)
    elif claim.solution.status in settings.SOLUTION_PRESENT:
        values, claimed = values_of(problem), sense_of(problem) * float(claim.solution.opt_val)
        against = _against_values(problem, stated.at(values), values, claimed, claim.tolerance)
        if against:
            return against
        for value, size in _weighed(problem, claim.solution, stated.lines_around(values), 1.0):
            if value < claimed - claim.tolerance * (1.0 + abs(claimed) + size):
                return (
                    f"its Lagrangian is {value:.9g} at another point, below {claimed:.9g}, which is said to be the "
                    "minimum"
                )
    return None


def _against_values(problem: Any, terms: Terms, values: Values, claimed: float, limit: float) -> str | None:
    miss = abs(terms.goal - claimed)
    if not miss <= limit and not miss <= limit * terms.size(0):
        return f"its objective is {terms.goal:.9g} at the values of its variables, not {claimed:.9g}"
    if (violated := _violated(problem, terms, limit, limit)) is not None:
        return violated
    for variable in problem.variables():
        entries = values[variable.id]
        miss = float(np.abs(nearest(variable, entries) - entries).max(initial=0.0))
        if not miss <= limit * (1.0 + np.abs(entries).max(initial=0.0)):
            return f"its variable {variable.name()} misses its own attributes by {miss:.3g}"
    return None


def _weighed(
    problem: Any, solution: Solution, lines: NDArray[np.float64], weight: float
) -> Iterator[tuple[float, float]]:
    """Yield weight · goal + Σ λ g and |weight · goal| + Σ |λ g| of each line; nothing where a λ is missing."""
    duals = solution.dual_vars or {}
    if any(constraint.id not in duals for constraint in problem.constraints):
        return
    every = (np.ravel(dense_value(duals[constraint.id]), order="F") for constraint in problem.constraints)
    multipliers = np.concatenate([[weight], *every])
    yield from zip((lines @ multipliers).tolist(), (np.abs(lines) @ np.abs(multipliers)).tolist(), strict=True)


def _against_unboundedness(problem: Any, stated: StatedTerms, claim: UserAnswer) -> str | None:
    """Hold the points of the ray against the constraints and the objective."""
    for point in claim.points:
        terms = stated.at({key: dense_value(value) for key, value in point.primal_vars.items()})
        claimed = sense_of(problem) * float(point.opt_val)
        if terms.goal > claimed and not terms.goal - claimed <= claim.tolerance * terms.size(0):
            return f"its objective is {terms.goal:.9g} at a point of the ray, not {claimed:.9g}"
        if (violated := _violated(problem, terms, ROUNDING, claim.tolerance)) is not None:
            return f"{violated} on the ray"
    return None


def _violated(problem: Any, terms: Terms, least: float, tolerance: float) -> str | None:
    """Return the first constraint that is violated by more than `least`, and than the tolerance times its terms."""
    for k, (constraint, slack) in enumerate(zip(problem.constraints, terms.slacks, strict=True)):
        violation = float(violation_of(constraint, slack).max(initial=0.0))
        if not violation <= least and not violation <= tolerance * terms.size(k + 1):
            return f"its constraint {name_of(constraint)} is violated by {violation:.3g}"
    return None


def values_of(problem: Any) -> Values:
    """Return each variable's value by its id, dense, or None."""
    values = {variable.id: leaf_value(variable) for variable in problem.variables()}
    return {key: None if value is None else dense_value(value) for key, value in values.items()}


def violation_of(constraint: Any, slack: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much each entry of a constraint is violated."""
    if not isinstance(constraint, (*EQUATIONS, *INEQUALITIES)):
        return np.atleast_1d(dense_value(constraint.violation()))
    return np.abs(slack) if isinstance(constraint, EQUATIONS) else np.maximum(slack, 0.0)


def why_not(problem: Any) -> list[str]:
    """Return what in the problem is not of a quadratic program, in the user's words."""
    reasons = []
    for variable in problem.variables():
        for attribute in ("boolean", "integer", "PSD", "NSD", "hermitian"):
            if np.size(variable.attributes[attribute]) and np.any(variable.attributes[attribute]):
                reasons.append(f"variable {variable.name()} is {attribute}")
    for constraint in problem.constraints:
        if isinstance(constraint, INEQUALITIES):
            if not expression_of(constraint).is_pwl():
                reasons.append(f"constraint {name_of(constraint)} is not piecewise linear")
        elif not isinstance(constraint, EQUATIONS):
            reasons.append(f"constraint {name_of(constraint)} is a {type(constraint).__name__}")
    if not problem.objective.args[0].is_qpwa():
        reasons.append(f"the objective {name_of(problem.objective.args[0])} is not quadratic or piecewise linear")
    return reasons


def far_numbers(problem: Any) -> list[str]:
    """Return which expressions of the user's hold numbers whose products may overflow or vanish, and which numbers."""
    stated = [(f"the objective {name_of(problem.objective.args[0])}", problem.objective.args)]
    stated += [(f"the constraint {name_of(constraint)}", constraint.args) for constraint in problem.constraints]
    found = []
    for what, arguments in stated:
        nodes = [node for argument in arguments for node in postorder(argument, ()) if not node.args]
        sizes = np.concatenate([entries_of(node.value).ravel() for node in nodes if not isinstance(node, cp.Variable)])
        far = sizes[(sizes > ORDINARY[1]) | ((sizes > 0.0) & (sizes < ORDINARY[0]))]
        if far.size:
            found.append(f"{what} holds {' and '.join(f'{size:.3g}' for size in {far.max(): 0, far.min(): 0})}")
    return found


def accompany(solver_class: type) -> None:
    """Wrap the first method for the solvers of this class; once, however often this is called."""
    compiled = cp.Problem.get_problem_data
    if getattr(compiled, "accompanies_lcp_plugin", False):
        return

    @wraps(compiled)
    def get_problem_data(self: Any, solver: Any, *args: Any, **kwargs: Any) -> Any:
        clear_answering(self)
        if isinstance(solver, str) and solver in METHODS:
            raise SolverError(
                f"solver={solver!r}: cvxpy looks for names among its own solvers only; write "
                'solver=lcp_plugin.QPSolver, or method="LCP"'
            )
        self.__dict__.pop("unpack_results", None)
        if not isinstance(solver, solver_class):
            return compiled(self, solver, *args, **kwargs)
        # Values of an earlier solve would start auxiliary variables that nobody needs, and cvxpy fails at some.
        kept = {variable: variable._value for variable in self.variables()}
        try:
            for variable in kept:
                variable.save_value(None)
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
        finally:
            for variable, value in kept.items():
                variable._value = value
        self.unpack_results = partial(_judged, self, data[0].get(settings.PARAM_PROB))
        data[0][FAR_NUMBERS] = partial(far_numbers, self)
        return data

    get_problem_data.accompanies_lcp_plugin = True  # type: ignore[attr-defined]
    cp.Problem.get_problem_data = get_problem_data


#: By the problem: what cvxpy compiled it to, and its terms at the points of the last judgement.
_known: WeakKeyDictionary[Any, tuple[Any, StatedTerms]] = WeakKeyDictionary()


def _judged(problem: Any, compiled: Any, solution: Any, chain: Any, inverse_data: Any) -> None:
    """Unpack as cvxpy does; what answers for itself with a claim is held against the problem."""
    type(problem).unpack_results(problem, solution, chain, inverse_data)
    if not hasattr(solution, "claim"):  # another solver's, kept from before
        return
    claim = solution.claim(problem.solution, lambda answer: chain.invert(answer, inverse_data))
    if claim is None or any(variable.is_complex() for variable in problem.variables()):
        return
    try:
        what = _against(problem, compiled, claim)
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


def _against(problem: Any, compiled: Any, claim: UserAnswer) -> str | None:
    """Return what the problem says against a claim; keep its terms for the next claim while it stays compiled."""
    known, stated = _known.pop(problem, (None, None))
    with np.errstate(all="ignore"):
        if stated is None or compiled is None or known is not compiled:
            stated = StatedTerms(problem)
        else:
            stated.take_parameters()
        what = disagreement(problem, claim, stated)
    if what is None:
        _known[problem] = compiled, stated
    return what
