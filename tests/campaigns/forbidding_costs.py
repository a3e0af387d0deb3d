"""Transports and assignments in which a huge cost forbids pairs, checked by HiGHS without these pairs.

Costs are integers, and 10²⁰ … 10³⁶ on some pairs. The sums of a transport are equalities, or limits of supplies and
demands. All sums of supplies and of demands agree exactly, because a plan in which a forbidden pair repairs a rounding
error costs more. A program whose every plan needs a forbidden pair is not counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linprog

from lcp_plugin import QuadraticProgram

SHAPES = (3, 3), (3, 4), (4, 4)


def transport(
    costs: Any, supplies: Any, demands: Any, *, has_limits: bool = False
) -> QuadraticProgram:
    """Return the cheapest transport from sources to destinations; `has_limits`: at most all supplies, all demands."""
    m, n = np.shape(costs)
    sources, targets = np.kron(np.eye(m), np.ones(n)), np.kron(np.ones(m), np.eye(n))
    if has_limits:
        rows, right = np.vstack([sources, -targets]), np.concatenate([supplies, -demands])
        upper = np.minimum.outer(supplies, demands).ravel()
        return QuadraticProgram(None, np.ravel(costs), rows, right, lower=0.0, upper=upper)
    rows, right = np.vstack([sources, targets]), np.concatenate([supplies, demands])
    return QuadraticProgram(None, np.ravel(costs), A=rows, b=right, lower=0.0)


def draw(seed: int) -> tuple[QuadraticProgram, float] | None:
    """Return a program and its value without the forbidden pairs; None if it has no plan without them."""
    rng = np.random.default_rng([seed, 92])
    shape = SHAPES[rng.integers(3)]
    is_forbidden = rng.random(shape) < rng.choice([0.15, 0.3, 0.45])
    costs = rng.integers(1, 11, shape).astype(float)
    if shape[0] == shape[1] and rng.random() < 0.4:  # an assignment, in parts
        supplies = demands = np.full(shape[0], rng.choice([1.0, 1.0 / 3.0, 0.1]))
    else:
        flows = np.where(is_forbidden, 0, rng.integers(0, 6, shape)) / rng.choice([1, 4, 64])
        supplies, demands = flows.sum(1), flows.sum(0)
    has_limits = bool(rng.random() < 0.3)
    forbidding = 10.0 ** rng.integers(20, 37)
    program = transport(
        np.where(is_forbidden, forbidding, costs), supplies, demands, has_limits=has_limits
    )
    known = linprog(
        costs.ravel(),
        program.G if has_limits else None,
        program.h if has_limits else None,
        None if has_limits else program.A,
        None if has_limits else program.b,
        [(0.0, 0.0 if is_none else None) for is_none in is_forbidden.ravel()],
    )
    return (program, float(known.fun)) if known.status == 0 else None


def is_wrong(value: float, known: float) -> bool:
    """Return whether an objective differs from the cost of plans without forbidden pairs."""
    return not abs(value - known) <= 1e-6 * abs(known) + 1e-12
