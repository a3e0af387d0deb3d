"""The linear program whose answer may be a Farkas vector, and vectors near it that may prove exactly."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..deadline import seconds_left
from ..exact.linear_systems import solved_nearby
from ..exact.rational import ZERO, Rational, rational_rows, short
from ..matrix.equilibration import evened
from ..problem.exactly import slack_bounds
from ..problem.lcp import LCP
from .residuals import reference_residual

AIMS = (0.5, 0.5, 0.5, 0.5, 1.0)  # smallest and largest entries alike, and the largest near 1
NEGLIGIBLE = 1e-12
VIOLATED = 1e-6  # of the terms of its row
LARGEST_REPAIR = 300  # unknowns of one exact solve: seconds
LARGEST_DENOMINATORS = (1, 100, 100_000)
TIGHT = (1e-9, 1e-7)
LP_TOLERANCE = 1e-9
WEIGHTS = (1e-6, 1e6)  # smallest and largest: entries of one row of the linear program
MOST = 1e5  # times the unit: what a linear program in double precision can tell from the rest
LARGEST_EXPONENT = 1023  # of a power of two that is a double


@dataclass(frozen=True)
class FarkasAnswer:
    """Optimum and y in the scale of the program, the multipliers z in the scale of the problem."""

    optimum: float
    y: FloatVector
    z: FloatVector


@dataclass(frozen=True, eq=False)
class FarkasProgram:
    """min qᵀy + Σ sup over the bounds of (Mᵀy)_j z_j, y of the signs that a Farkas vector needs, Σ|y_i| d_i ≤ 1.

    This is the dual of min t over lower ≤ z ≤ upper with every w_i of its sign up to d_i t: minus the optimum is the
    smallest scaled residual that the signs allow, and y proves it. y = 0 is always allowed; where the constraints can
    be satisfied the optimum is 0, and its multipliers are such a z. Rows and columns are scaled by powers of two first.

    Attributes
    ----------
    unit : float or None
        What q and the bounds are divided by, in the scale of the program; their largest entry by default. With a
        smaller one, what is huge beside it is cut off: the answer must be checked, as every answer here is.
    measure : {"relative", "euclidean"}
        With "euclidean", d = 1: within a factor √n, y is then best for that residual.
    weights : ndarray, shape (n,)
        d in the scale of the program's rows, no smaller than 1e-6 and no larger than 1e6.
    """

    problem: LCP
    unit: float | None = None
    measure: str = "relative"
    rows: FloatVector = field(init=False)
    columns: FloatVector = field(init=False)
    matrix: sp.csr_array = field(init=False)
    weights: FloatVector = field(init=False)

    def __post_init__(self) -> None:
        rows, columns = (np.ldexp(1.0, np.clip(side, -500, 500)) for side in evened(self.problem.csr, AIMS))
        scaled = sp.diags_array(rows) @ self.problem.csr @ sp.diags_array(columns)
        with np.errstate(over="ignore"):
            scale = self.problem.residual_scale if self.measure == "relative" else np.ones(self.problem.n)
            weights = np.clip(rows * scale, *WEIGHTS)
        made = (("rows", rows), ("columns", columns), ("matrix", sp.csr_array(scaled)), ("weights", weights))
        for name, value in made:
            object.__setattr__(self, name, value)

    @cached_property
    def _costs(self) -> tuple[FloatVector, FloatVector, FloatVector, float]:
        """q, lower and upper in the scale of the program, and the unit they were divided by."""
        q = self.rows * self.problem.q
        lower, upper = self.problem.lower / self.columns, self.problem.upper / self.columns
        sizes = np.abs(np.concatenate([q, lower, upper]))
        largest = float(sizes[np.isfinite(sizes)].max(initial=0.0)) if self.unit is None else self.unit
        unit = _power_of_two_near(max(largest, 2.0**-900))
        q, lower, upper = (_cut_off(side, unit) for side in (q, lower, upper))
        return q, lower, upper, unit

    def margin_of(self, optimum: float) -> float:
        """Return the residual in the measure that every z has, as far as an optimum of the program can be trusted."""
        reference = reference_residual(self.problem) if self.measure == "relative" else 1.0
        with np.errstate(all="ignore"):
            margin = float(-optimum * self._costs[3] / np.float64(reference))
        return margin if np.isfinite(margin) else 0.0

    def solve(self, pivots: int) -> FarkasAnswer | None:
        """Return the optimum, or None where it took more pivots."""
        form = self._form
        right = np.zeros(form.equations.shape[0])
        result = _linear_program(form.cost, form.equations, right, form.bounds, pivots, (form.norm, np.ones(1)))
        if result is None:
            return None
        unit = self._costs[3]
        return FarkasAnswer(float(result.fun), form.vector(result.x), -result.eqlin.marginals * unit * self.columns)

    def with_margin(self, optimum: float, pivots: int) -> FloatVector | None:
        """Return a y that keeps half of the optimum and satisfies its inequalities with room, or None."""
        has_upper, has_lower = np.isfinite(self.problem.upper), np.isfinite(self.problem.lower)
        if np.all(has_upper == has_lower):
            return None
        form = self._form
        room = sp.csc_array((has_lower.astype(float) - has_upper)[:, None])
        cost = np.zeros(form.cost.size + 1)
        cost[-1] = -1.0
        result = _linear_program(
            cost, sp.hstack([form.equations, room], format="csc"), np.zeros(self.problem.n),
            np.vstack([form.bounds, [0.0, 1.0]]), pivots,
            (np.column_stack([np.vstack([form.norm, form.cost]), [0.0, 0.0]]), np.array([1.0, 0.5 * optimum])),
        )
        return None if result is None or result.fun > -LP_TOLERANCE else form.vector(result.x)

    @cached_property
    def _form(self) -> _StandardForm:
        """The program in nonnegative parts of y and multipliers of finite bounds."""
        q, lower, upper, _ = self._costs
        n = self.problem.n
        has_upper, has_lower = np.isfinite(upper), np.isfinite(lower)
        slack_lower, slack_upper = slack_bounds(self.problem)
        plus, minus = np.flatnonzero(slack_lower == 0.0), np.flatnonzero(slack_upper == 0.0)
        identity, transposed = sp.eye_array(n, format="csc"), sp.csc_array(self.matrix.T)
        cost = np.concatenate([q[plus], -q[minus], upper[has_upper], -lower[has_lower]])
        equations = sp.hstack(
            [transposed[:, plus], -transposed[:, minus], -identity[:, has_upper], identity[:, has_lower]], format="csc"
        )
        norm = np.zeros((1, cost.size))
        norm[0, : plus.size + minus.size] = np.concatenate([self.weights[plus], self.weights[minus]])
        bounds = np.column_stack([np.zeros(cost.size), np.full(cost.size, np.inf)])
        return _StandardForm(n, plus, minus, cost, equations, norm, bounds)

    def unit_of_violation(self, z: FloatVector) -> float | None:
        """Return the largest size, in the scale of the program, of a row that z leaves violated; None if none is."""
        problem = self.problem
        slack_lower, slack_upper = slack_bounds(problem)
        with np.errstate(all="ignore"):
            w = problem.slack(z)
            size = abs(problem.csr) @ np.abs(z) + np.abs(problem.q)
            violated = np.maximum(slack_lower - w, w - slack_upper) > VIOLATED * size
            size *= self.rows
        if not np.isfinite(size).all():  # a sum that overflows has no sign: nothing can be called feasible
            return float(np.finfo(np.float64).max)
        return float(size[violated].max()) if violated.any() else None

    def nearest(self, y: FloatVector) -> FloatVector:
        """Return y in the scale of the problem, its signs and negligible entries put right; the largest entry is 1."""
        slack_lower, slack_upper = slack_bounds(self.problem)
        y = np.where(np.abs(y) <= 1e-14 * np.abs(y).max(), 0.0, y)
        y = np.clip(y, np.where(slack_upper == 0.0, -np.inf, 0.0), np.where(slack_lower == 0.0, np.inf, 0.0))
        y = y / (np.abs(y).max(initial=0.0) or 1.0) * self.rows
        unscaled: FloatVector = y / (np.abs(y).max() or 1.0)
        return unscaled

    def candidates(self, y: FloatVector) -> Iterator[Sequence[Rational]]:
        """Yield vectors near y that may be Farkas vectors exactly: rounded to few digits, then solved for."""
        kept = np.flatnonzero(np.abs(y) > NEGLIGIBLE * np.abs(y).max(initial=0.0)).tolist()
        if not kept:
            return
        sizes = np.abs(y[kept])
        for base in dict.fromkeys((float(sizes.max()), float(sizes.min()))):
            for denominator in LARGEST_DENOMINATORS:
                near = {i: Fraction(float(y[i]) / base).limit_denominator(denominator) for i in kept}
                if any(near.values()):
                    yield self._unscaled(near)
        for tight in TIGHT:
            repaired = self._repaired(y, tight)
            if repaired is not None:
                yield self._unscaled(repaired)

    def _unscaled(self, entries: dict[int, Fraction]) -> list[Fraction]:
        y = [Fraction(0)] * self.problem.n
        for i, value in entries.items():
            y[i] = value * Fraction(float(self.rows[i]))
        return y

    def _repaired(self, y: FloatVector, tight: float) -> dict[int, Fraction] | None:
        """Return the vector beside y that satisfies exactly the (in)equalities which y satisfies without room."""
        y = y / np.abs(y).max()
        support = np.flatnonzero(np.abs(y) > tight).tolist()
        size = abs(self.matrix).T @ np.abs(y)
        is_unbounded = np.isinf(self.problem.lower) | np.isinf(self.problem.upper)
        is_tight = is_unbounded & (np.abs(self.matrix.T @ y) <= tight * size) & (size > 0.0)
        if min(len(support), int(is_tight.sum())) > LARGEST_REPAIR:
            return None
        columns = rational_rows(self.matrix.T.tocsr()[np.flatnonzero(is_tight)][:, support])
        # Any nearby value will do: short ones keep the exact solve short.
        exact = solved_nearby(columns, [ZERO] * len(columns), short(y[support], 1 << 50), [True] * len(support))
        return None if exact is None else dict(zip(support, exact, strict=True))


@dataclass(frozen=True)
class _StandardForm:
    """min costᵀv, equations · v = 0, norm · v ≤ 1, v within bounds; v begins with the positive parts of y."""

    n: int
    plus: Any
    minus: Any
    cost: FloatVector
    equations: Any
    norm: FloatVector
    bounds: FloatVector

    def vector(self, v: FloatVector) -> FloatVector:
        """Return y, shape (n,)."""
        y = np.zeros(self.n)
        y[self.plus] = v[: self.plus.size]
        y[self.minus] -= v[self.plus.size : self.plus.size + self.minus.size]
        return y


def _cut_off(values: FloatVector, unit: float) -> FloatVector:
    """Return values / unit, finite ones at most MOST in size."""
    with np.errstate(over="ignore"):
        cut: FloatVector = np.where(np.isinf(values), values, np.clip(values / unit, -MOST, MOST))
    return cut


def _power_of_two_near(value: float) -> float:
    return float(np.ldexp(1.0, min(int(np.frexp(value)[1]), LARGEST_EXPONENT)))


def _linear_program(
    cost: FloatVector, equations: Any, right: FloatVector, bounds: Any, pivots: int, rows: tuple[Any, FloatVector]
) -> Any:
    from scipy.optimize import linprog

    options = {
        "presolve": True, "maxiter": pivots,
        "primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE,
    }
    if not np.isfinite(cost).all() or not np.isfinite(equations.data).all():
        return None
    if math.isfinite(left := seconds_left()):
        options["time_limit"] = left
    result = linprog(
        cost, A_ub=rows[0], b_ub=rows[1], A_eq=equations, b_eq=right, bounds=bounds, method="highs", options=options
    )
    return result if result.status == 0 else None
