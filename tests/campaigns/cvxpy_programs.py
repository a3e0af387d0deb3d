"""Random convex programs in cvxpy, solved by QPSolver and compared with external solvers.

A program is a sum of atoms of affine expressions of several variables, with constraints. One in eight is made
infeasible, and one in eight may be unbounded. The references are Clarabel and SCS (OSQP if SCS fails). If the
results differ, the point with the smaller violation and the better value counts as right.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from lcp_plugin import QPSolver

RELATIVE = 1e-5  # an optimal value that differs by more is wrong
SOFT = 1e-6  # tolerated violation of constraints by the references
KINDS = ("free", "signed", "bounded", "parameterized")


Draw = np.random.Generator
Atom = Callable[[Any, Draw], Any]


def quadratic_form(e: Any, draw: Draw) -> Any:
    root = draw.integers(-2, 3, (e.size, int(draw.integers(1, e.size + 1)))).astype(float)
    return cp.quad_form(e, cp.psd_wrap(root @ root.T / 4))


def pinball(e: Any, draw: Draw) -> Any:
    slope = draw.uniform(0.1, 0.9)
    return cp.sum(cp.maximum(slope * e, (slope - 1) * e))


def dot_sort(e: Any, draw: Draw) -> Any:
    return cp.dotsort(e, np.sort(draw.uniform(0.0, 2.0, e.size)))


def regulariser(e: Any, draw: Draw) -> Any:
    """Return the square of something convex and nonnegative."""
    return cp.square(cp.pos(e[0] - draw.normal()) + cp.norm1(e))


def steps(e: Any, draw: Draw) -> Any:
    return cp.tv(e) if e.size > 1 else cp.abs(e[0])


def parametric_hinge(e: Any, draw: Draw) -> Any:
    weight = cp.Parameter(nonneg=True, value=draw.uniform(0.1, 2.0))
    return weight * cp.sum(cp.pos(1 - e))


#: Convex and no steeper than quadratic, each of a vector expression.
CONVEX: dict[str, Atom] = {
    "abs": lambda e, draw: cp.sum(cp.abs(e)),
    "pos": lambda e, draw: cp.sum(cp.pos(e - draw.normal())),
    "neg": lambda e, draw: cp.sum(cp.neg(e + draw.normal())),
    "max": lambda e, draw: cp.max(e),
    "maximum": lambda e, draw: cp.sum(cp.maximum(e, draw.normal(size=e.size), -2 * e)),
    "norm1": lambda e, draw: cp.norm1(e),
    "norm_inf": lambda e, draw: cp.norm_inf(e - draw.normal()),
    "sum_squares": lambda e, draw: cp.sum_squares(e - draw.normal(size=e.size)),
    "square": lambda e, draw: cp.sum(cp.square(e)),
    "power": lambda e, draw: cp.sum(cp.power(e, 2)),
    "quad_form": quadratic_form,
    "quad_over_lin": lambda e, draw: cp.quad_over_lin(e, draw.uniform(0.5, 3.0)),
    "huber": lambda e, draw: cp.sum(cp.huber(e, draw.uniform(0.2, 2.0))),
    "sum_largest": lambda e, draw: cp.sum_largest(e, int(draw.integers(1, e.size + 1))),
    "sum_smallest": lambda e, draw: (
        -cp.sum_smallest(e, int(draw.integers(1, e.size))) if e.size > 1 else -cp.min(e)
    ),
    "min": lambda e, draw: -cp.min(e),
    "minimum": lambda e, draw: -cp.sum(cp.minimum(e, draw.normal(size=e.size))),
    "tv": steps,
    "hinge": lambda e, draw: cp.sum(cp.pos(1 - cp.multiply(np.sign(draw.normal(size=e.size)), e))),
    "pinball": pinball,
    "cumsum": lambda e, draw: cp.sum(cp.abs(cp.cumsum(e))),
    "cummax": lambda e, draw: cp.sum(cp.cummax(e)),
    "cumulative squares": lambda e, draw: cp.sum_squares(cp.cumsum(e) - 1),
    "ptp": lambda e, draw: cp.ptp(e),
    "mean": lambda e, draw: cp.mean(cp.abs(e - 1)),
    "nested maximum": lambda e, draw: cp.maximum(cp.norm1(e) - 1, cp.max(e), 0),
    "square of convex": regulariser,
    "diff": lambda e, draw: cp.sum_squares(cp.diff(e)) if e.size > 1 else cp.square(e[0]),
    "weighted hinge": parametric_hinge,
    "scaled square": lambda e, draw: cp.sum_squares(e) / draw.uniform(0.5, 3.0),
    "dotsort": dot_sort,
    "linear": lambda e, draw: draw.normal(size=e.size) @ e,
}
PIECEWISE_LINEAR = (
    "abs", "pos", "neg", "max", "maximum", "norm1", "norm_inf", "sum_largest", "sum_smallest", "min", "minimum", "tv",
    "hinge", "pinball", "cumsum", "cummax", "ptp", "mean", "nested maximum", "weighted hinge",
    "dotsort",
)  # fmt: skip


def is_quadratic(name: str) -> bool:
    """Return whether this release of cvxpy writes the atom as a quadratic program; it learned some of them late."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            cp.Problem(
                cp.Minimize(CONVEX[name](cp.Variable(3), np.random.default_rng(0)))
            ).get_problem_data(QPSolver)
        except cp.error.SolverError:
            return False
    return True


CONVEX = {name: CONVEX[name] for name in CONVEX if is_quadratic(name)}
PIECEWISE_LINEAR = tuple(name for name in PIECEWISE_LINEAR if name in CONVEX)


def flat(e: Any) -> Any:
    return e if len(e.shape) == 1 else cp.reshape(e, (e.size,), order="F")


def stacked_rows(parts: list[Any], draw: Draw) -> Any:
    size = min(part.size for part in parts)
    return flat(cp.vstack([part[:size] for part in parts]))


def sliced(parts: list[Any], draw: Draw) -> Any:
    whole = cp.hstack(parts)
    step = int(draw.integers(1, 3))
    return whole[int(draw.integers(0, min(2, whole.size))) :: step]


def affine(parts: list[Any], draw: Draw) -> Any:
    rows = int(draw.integers(1, 5))
    return sum(draw.normal(size=(rows, part.size)) @ part for part in parts) + draw.normal(
        size=rows
    )


def added(parts: list[Any], draw: Draw) -> Any:
    size = min(part.size for part in parts)
    return sum((draw.normal() * part[:size] for part in parts[1:]), start=parts[0][:size])


def reshaped(parts: list[Any], draw: Draw) -> Any:
    part = parts[0]
    square = (
        cp.reshape(part[: part.size // 2 * 2], (2, part.size // 2), order="F")
        if part.size > 1
        else part
    )
    return flat(square.T if len(square.shape) == 2 else square)


def kronecker(parts: list[Any], draw: Draw) -> Any:
    return flat(
        cp.kron(draw.normal(size=(2, 1)), cp.reshape(parts[0], (parts[0].size, 1), order="F"))
    )


def diagonal(parts: list[Any], draw: Draw) -> Any:
    part = parts[0]
    return flat(cp.diag(part) @ draw.normal(size=(part.size, 1)))


def column_sums(parts: list[Any], draw: Draw) -> Any:
    return cp.sum(
        cp.multiply(draw.normal(size=(parts[0].size, 2)), cp.vstack([parts[0], parts[0]]).T), axis=0
    )


def convolved(parts: list[Any], draw: Draw) -> Any:
    return flat(cp.conv(draw.normal(size=2), parts[0]))


#: How variables become one vector expression.
COMBINATIONS: dict[str, Callable[[list[Any], Draw], Any]] = {
    "hstack": lambda parts, draw: cp.hstack(parts),
    "vstack": stacked_rows,
    "slicing": sliced,
    "affine": affine,
    "sum": added,
    "reshape": reshaped,
    "kron": kronecker,
    "diag": diagonal,
    "column sums": column_sums,
    "convolution": convolved,
}


def variable(kind: str, draw: Draw) -> Any:
    """Return a vector expression of a new variable, in [−9, 9] or so where the kind has bounds."""
    n = int(draw.integers(1, 5))
    if kind == "signed":
        return cp.Variable(n, **{str(draw.choice(["nonneg", "nonpos"])): True})
    if kind == "bounded":
        low = -draw.uniform(0.0, 3.0, n)
        return cp.Variable(n, bounds=[low, low + draw.uniform(0.5, 5.0, n)])
    if kind == "parameterized":
        scale, shift = cp.Parameter(n, value=draw.normal(size=n)), cp.Parameter(value=draw.normal())
        return cp.multiply(scale, cp.Variable(n)) + shift
    shape = draw.integers(0, 8)
    if shape == 0:
        return cp.hstack([cp.Variable() for _ in range(n)])
    if shape == 1:
        return flat(cp.Variable((2, 2), symmetric=True))
    if shape == 2:
        # The product, because vstack of a bare diag is compiled transposed by every cvxpy (1.6.0 … 1.9.3).
        return np.eye(2) @ cp.diag(cp.Variable((2, 2), diag=True))
    return cp.Variable(n)


@dataclass
class Case:
    """A program, and whether its constraints are known to be inconsistent."""

    problem: Any
    is_infeasible: bool
    atoms: list[str]


def program(draw: Draw) -> Case:
    """Return a random program."""
    parts = [variable(str(draw.choice(KINDS)), draw) for _ in range(int(draw.integers(1, 4)))]

    def expression() -> Any:
        chosen = [parts[i] for i in draw.permutation(len(parts))]
        e = COMBINATIONS[str(draw.choice(list(COMBINATIONS)))](chosen, draw)
        pick = draw.random()
        if pick < 0.3:
            e = cp.multiply(draw.integers(-2, 3, e.size), e)
        return draw.integers(-2, 3, (e.size, e.size)) @ e if 0.2 < pick < 0.5 else e

    def term(names: Any) -> tuple[str, Any]:
        name = str(draw.choice(names))
        return name, CONVEX[name](expression(), draw)

    fate = draw.random()
    names, terms = zip(*(term(list(CONVEX)) for _ in range(int(draw.integers(1, 4)))), strict=True)
    goal = sum(draw.uniform(0.1, 3.0) * t for t in terms) + draw.normal()
    used = list(names)
    everything = cp.hstack(parts)
    if draw.random() < 0.3:
        goal = goal + draw.normal(size=everything.size) @ everything
    if fate > 0.125 and draw.random() < 0.6:
        goal = goal + 0.05 * cp.sum_squares(everything)
    constraints = []
    for _ in range(int(draw.integers(0, 4))):
        pick = draw.random()
        e = expression()
        if pick < 0.25:
            rows = draw.normal(size=(1, e.size))
            constraints.append(rows @ e == draw.normal(size=1))
        elif pick < 0.6:
            constraints.append(e <= draw.uniform(0.5, 4.0, e.size))
        elif pick < 0.7:
            constraints.append(e >= -draw.uniform(0.5, 4.0, e.size))
        else:
            name, convex = term(PIECEWISE_LINEAR)
            used.append(name)
            constraints.append(convex <= draw.uniform(1.0, 8.0))
    is_infeasible = fate > 0.875
    if is_infeasible:
        name, convex = term(PIECEWISE_LINEAR)
        used.append(name)
        limit = draw.uniform(-1.0, 1.0)
        constraints.append(convex <= limit)
        e = expression()
        wanted = draw.normal(size=e.size)
        contradiction = [
            [cp.sum(e) >= 2.0, wanted * 0 + cp.sum(e) <= 1.0],
            [cp.norm1(e) <= -0.1],
            [cp.max(e) <= wanted.min() - 0.1, e >= wanted],
        ]
        constraints += contradiction[int(draw.integers(0, 3))]
    objective = cp.Minimize(goal) if draw.random() < 0.6 else cp.Maximize(-goal)
    return Case(cp.Problem(objective, constraints), is_infeasible, used)


@dataclass
class Opinion:
    """Status, value of the minimized objective, and largest violation of a solver's result."""

    status: str
    value: float = np.nan
    violation: float = np.inf

    def is_solved(self) -> bool:
        """Return whether there is a point."""
        return self.status in ("optimal", "optimal_inaccurate")


def opinion(problem: Any, solver: Any, **options: Any) -> Opinion:
    """Return the status, value and violation of a solver's result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=solver, **options)
        except cp.error.SolverError as error:
            return Opinion(f"SolverError: {error}")
        except (ValueError, ArithmeticError, RuntimeError) as error:
            return Opinion(f"{type(error).__name__}: {error}")
    if problem.status not in ("optimal", "optimal_inaccurate"):
        return Opinion(problem.status)
    violations = [np.max(constraint.violation(), initial=0.0) for constraint in problem.constraints]
    for v in problem.variables():
        # The values of diagonal variables are sparse.
        violations.append(np.abs(dense(v.project(v.value)) - dense(v.value)).max(initial=0.0))
    sign = 1.0 if isinstance(problem.objective, cp.Minimize) else -1.0
    return Opinion(problem.status, sign * float(problem.value), float(max(violations, default=0.0)))


def dense(value: Any) -> Any:
    return value.toarray() if sp.issparse(value) else value


def others(problem: Any) -> list[Opinion]:
    """Return the opinions of Clarabel and SCS, of OSQP where SCS has none."""
    clarabel = opinion(problem, cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    second = opinion(problem, cp.SCS, eps_abs=1e-7, eps_rel=1e-7, max_iters=20000)
    if "Error" in second.status:  # for instance without constraints
        second = opinion(problem, cp.OSQP, eps_abs=1e-8, eps_rel=1e-8, max_iter=20000)
    return [clarabel, second]


def verdict(case: Case, ours: Opinion, theirs: list[Opinion]) -> str:
    """Return the outcome of the comparison."""
    if ours.status not in ("optimal", "infeasible", "unbounded"):
        return "undecided"
    scale = 1.0 + abs(ours.value) if ours.is_solved() else 1.0
    solved = [other for other in theirs if other.is_solved() and other.violation <= SOFT * 10]
    if case.is_infeasible:
        return "agreed" if ours.status == "infeasible" else "wrong status"
    if ours.status == "optimal":
        if ours.violation > RELATIVE * scale:
            return "wrong value"
        better = [other for other in solved if other.value < ours.value - RELATIVE * scale]
        if better and min(other.violation for other in better) <= SOFT:
            return "wrong value"
        agreeing = [other for other in solved if abs(other.value - ours.value) <= RELATIVE * scale]
        # A feasible point with a smaller value than the references is right, because these stopped early.
        if agreeing or (solved and ours.violation <= SOFT):
            return "agreed"
        return (
            "wrong status"
            if all(other.status in ("infeasible", "unbounded") for other in theirs)
            else "not judged"
        )
    if any(other.status == ours.status for other in theirs) and not solved:
        return "agreed"
    if solved and all(other.is_solved() for other in theirs):
        return "wrong status"
    if any(other.status.startswith(ours.status) for other in theirs):
        return "agreed"
    return "not judged"


def judged(seed: int, k: int) -> tuple[str, Case, Opinion, list[Opinion]]:
    """Return the outcome of case k of a seed, the case and the opinions, ours on a fresh problem."""

    def drawn() -> Case:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return program(np.random.default_rng([seed, k]))

    case = drawn()
    ours, theirs = opinion(case.problem, QPSolver), others(drawn().problem)
    return verdict(case, ours, theirs), case, ours, theirs
