"""Random markets and bilevel programs stated by agents' programs: no agent could gain, and the leader's value is right.

A market has 2 to 6 agents with quadratic objectives, a quarter of them with smooth terms also, and boxes, budgets and
shared constraints. Every agent's gap must be at most 1e-6 relative to its value; for every tenth market, each agent's
program with the others' values as numbers is solved by Clarabel. A bilevel program has 2 leading unknowns and 3
following ones. Its value is the least over the active sets of the follower's constraints, by Clarabel.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import cvxpy as cp
import numpy as np

from lcp_plugin import optimal

ACCURACY = 1e-6
CLARABEL_ACCURACY = 2e-5


def smooth_term(rng: np.random.Generator, x: Any) -> Any:
    """Return a convex term of a decision x ≥ 0."""
    return [
        lambda: cp.sum(cp.exp(0.3 * x)),
        lambda: -cp.sum(cp.log(x + 1)),
        lambda: -cp.sum(cp.entr(x + 0.1)),
        lambda: cp.sum(
            cp.power(x + 0.1, 1.5)
        ),  # at 0 the second derivative of x ** 1.5 is infinite
        lambda: cp.sum(cp.logistic(x)),
        lambda: cp.sum(cp.abs(x - 1)) + cp.max(x),
    ][rng.integers(6)]()


def market(seed: int) -> str:
    """Return the fault of a random market, or an empty text."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 4, rng.integers(2, 7))
    n, ends = int(sizes.sum()), np.cumsum(sizes)
    A, S = rng.standard_normal((2, n, n))
    J = A @ A.T / n + 0.5 * np.eye(n) + (S - S.T) / 2  # monotone: an equilibrium exists
    c = 3 * rng.standard_normal(n)
    is_smooth = rng.random() < 0.25
    x = [cp.Variable(int(k), nonneg=True) for k in sizes]
    for one in x:
        one.value = np.ones(one.shape)
    joint = sum(rng.uniform(0.5, 1.5, one.size) @ one for one in x) <= rng.uniform(0.5, 1.0) * n
    has_joint, agents, programs = rng.random() < 0.5, [], []
    for i, (own, end) in enumerate(zip(x, ends.tolist(), strict=True)):
        here = slice(end - own.size, end)
        Q = (J[here, here] + J[here, here].T) / 2
        others = sum(
            J[here, other - one.size : other] @ one
            for k, (one, other) in enumerate(zip(x, ends.tolist(), strict=True))
            if k != i
        )
        cost = cp.quad_form(own, cp.psd_wrap(Q)) / 2 + (c[here] + others) @ own
        if is_smooth:
            cost += smooth_term(rng, own)
        rows = [own <= rng.uniform(1.0, 4.0)] if rng.random() < 0.7 else []
        if rng.random() < 0.5:
            rows.append(rng.uniform(0.2, 1.0, own.size) @ own <= rng.uniform(0.5, 2.0))
        rows += [joint] if has_joint else []
        goal = cp.Minimize(cost) if rng.random() < 0.5 else cp.Maximize(-cost)
        programs.append(cp.Problem(goal, rows))
        shared = [joint] if has_joint else []
        agents.append(optimal(programs[-1], over=[own], shared=shared))
    problem = cp.Problem(cp.Minimize(0), agents)
    problem.solve(method="LCP")
    if problem.status != "optimal":
        return f"status {problem.status}"
    for agent, program in zip(agents, programs, strict=True):
        gap, value = agent.gap(), abs(float(program.objective.value))
        if gap is None or not 0.0 <= gap <= (CLARABEL_ACCURACY if is_smooth else ACCURACY) * (
            1 + value
        ):
            return f"gap {gap} of a program with value {value}"
    return restated(programs, x) if seed % 10 == 0 else ""


def restated(programs: list[Any], x: list[Any]) -> str:
    """Solve each program by Clarabel, the others' values as numbers; return the first difference of values."""
    values = [one.value for one in x]
    for i, program in enumerate(programs):
        before = float(program.objective.value)
        fixed = [
            one == value for k, (one, value) in enumerate(zip(x, values, strict=True)) if k != i
        ]
        sense = -1.0 if isinstance(program.objective, cp.Maximize) else 1.0
        twins = {
            id(one): cp.Parameter(one.shape, value=v)
            for k, (one, v) in enumerate(zip(x, values, strict=True))
            if k != i
        }
        goal = sense * program.objective.args[0].tree_copy(id_objects=twins)
        try:
            cp.Problem(cp.Minimize(goal), [*program.constraints, *fixed]).solve(solver=cp.CLARABEL)
            best = sense * float(goal.value)
        finally:
            for one, value in zip(x, values, strict=True):
                one.value = value
        if not abs(best - before) <= CLARABEL_ACCURACY * (1 + abs(before)):
            return f"Clarabel finds {best}, the agent has {before}"
    return ""


def bilevel(seed: int) -> str:
    """Return the fault of a random bilevel program, or an empty text."""
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((3, rng.integers(1, 4)))
    Q, C, c = half @ half.T, rng.standard_normal((3, 2)), rng.standard_normal(3)
    m = int(rng.integers(2, 5))
    A, B = rng.standard_normal((m, 3)), rng.standard_normal((m, 2))
    A, B = np.vstack([A, np.ones(3), -np.ones(3)]), np.vstack([B, np.zeros((2, 2))])
    b = np.append(rng.uniform(0.5, 2.0, m), [3.0, 3.0])
    target = 2 * rng.standard_normal(5)
    x, y = cp.Variable(2, bounds=[-2, 2]), cp.Variable(3, bounds=[-4, 4])
    follower = cp.Problem(
        cp.Minimize(cp.quad_form(y, cp.psd_wrap(Q)) / 2 + (c + C @ x) @ y), [A @ y + B @ x <= b]
    )
    best = optimal(follower, over=[y])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(cp.hstack([x, y]) - target)), [best])
    problem.solve(method="LCP", prove=True)
    value = least_over_active_sets(Q, C, c, A, B, b, target)
    if value is None:
        return (
            "" if problem.status == "infeasible" else f"status {problem.status} without solutions"
        )
    if (
        problem.status != "optimal"
        or not abs(problem.value - value) <= ACCURACY * (1 + abs(value)) + 1e-6
    ):
        return f"status {problem.status}, value {problem.value}; by active sets {value}"
    gap = best.gap()
    if gap is None or gap > ACCURACY:
        return f"gap {gap}"
    return "" if problem.solver_stats.extra_stats.verify() else "a proof that does not verify"


def least_over_active_sets(
    Q: Any, C: Any, c: Any, A: Any, B: Any, b: Any, target: Any
) -> float | None:
    """Return the leader's least value over all sets of active rows and bounds of the follower; None if it has none."""
    rows = np.vstack([A, np.eye(3), -np.eye(3)])
    of_x, right = np.vstack([B, np.zeros((6, 2))]), np.append(b, np.full(6, 4.0))
    found = None
    for size in range(4):  # some multipliers of independent rows
        for chosen in itertools.combinations(range(right.size), size):
            active = list(chosen)
            if size and np.linalg.matrix_rank(rows[active]) < size:
                continue
            x, y, m = cp.Variable(2), cp.Variable(3), cp.Variable(max(size, 1))
            slack = right - rows @ y - of_x @ x
            force = rows[active].T @ m if size else 0
            conditions = [Q @ y + c + C @ x + force == 0, slack >= 0, cp.abs(x) <= 2, m >= 0]
            conditions += [slack[active] == 0] if size else []
            problem = cp.Problem(
                cp.Minimize(cp.sum_squares(cp.hstack([x, y]) - target)), conditions
            )
            problem.solve(solver=cp.CLARABEL)
            if problem.status in ("optimal", "optimal_inaccurate"):
                found = problem.value if found is None else min(found, problem.value)
    return found


def faults(markets: range, programs: range) -> Iterator[str]:
    """Yield the faults of cases with these numbers."""
    for kind, numbers in ((market, markets), (bilevel, programs)):
        for number in numbers:
            try:
                fault = kind(number)
            except Exception as error:  # a crash is a fault
                fault = f"{type(error).__name__}: {error}"
            if fault:
                yield f"{kind.__name__} {number}: {fault}"
