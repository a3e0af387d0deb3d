"""Random small least squares problems in mixed units, the least cost by exact arithmetic, nnls and lsq_linear beside.

Rows, columns or both times 10^k, k in −6 … 6,
weights 10^±8, ranks below full, boxes, free columns, a ridge. Prints for each kind how many are solved, how many
not and with which status, and how many SOLVED cost more than the least by over tolerance times their cost: no more than
rounding explains, beside a least cost of 0 or another; where the least is out of reach; or else FALSE. For scipy it
counts how many answers are so.

The truth is an x* that satisfies the optimality conditions of the stored doubles exactly. With ρ(x) = ε (|A||x| + |b|),
rounding explains that ‖√W(A x − b)‖ exceeds what it may be by 8 (n + 4)‖√W ρ(x)‖. The least is out of reach where
‖√W ρ(x*)‖, which rounding of entries and of x* changes at x*, is more than x costs: columns that depended on others
before they were rounded to doubles, and an x* of 10¹⁶.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from oracles.exact_program import ExactProgram, dot, exact

from lcp_plugin import BoundedLeastSquares
from lcp_plugin.problems.least_squares.solving import LeastSquaresResult, solve_least_squares

from .outliers import COSINE, NONE, integers, some
from .outliers import ODD as OUTLIERS

INF = np.inf
EPSILON = float(np.finfo(float).eps)
TOLERANCE = 1e-8


KINDS = (
    "integers",
    "rows",
    "columns",
    "both",
    "weights",
    "rows and weights",
    "rank",
    "rank in units",
    "exact fit",
)


def bounded_least_squares(
    A: Any,
    b: Any,
    lower: Any = 0.0,
    upper: Any = INF,
    *,
    weights: Any = None,
    ridge: float = 0.0,
    l1: Any = 0.0,
    **options: Any,
) -> LeastSquaresResult:
    """Solve a problem, stated by its data, with the options of a run."""
    problem = BoundedLeastSquares(
        A, b, lower=lower, upper=upper, weights=weights, ridge=ridge, l1=l1
    )
    return solve_least_squares(problem, **options)


ODD = "odd numbers"


@dataclass(frozen=True)
class Case:
    """One problem."""

    kind: str
    A: np.ndarray
    b: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    weights: np.ndarray | None
    ridge: float


def draw(kind: str, rng: np.random.Generator) -> Case:
    """Return a random problem: integers in −3 … 3, up to 8 × 7, in units."""
    if kind == ODD:
        return odd(rng)
    m, n = int(rng.integers(1, 9)), int(rng.integers(1, 8))
    A, b = rng.integers(-3, 4, (m, n)).astype(float), rng.integers(-5, 6, m).astype(float)
    if kind.startswith("rank") and n > 1:
        rank = int(rng.integers(1, n))
        A = (rng.integers(-2, 3, (m, rank)) @ rng.integers(-2, 3, (rank, n))).astype(float)
    x = rng.integers(0, 4, n).astype(float)
    lower, upper = np.zeros(n), np.full(n, INF)
    shape = rng.integers(0, 3)
    if shape == 1:  # boxes
        lower, upper = -rng.integers(0, 3, n).astype(float), rng.integers(0, 4, n).astype(float)
    elif shape == 2:  # of every sort
        lower = np.where(rng.random(n) < 0.4, -INF, lower)
        upper = np.where(rng.random(n) < 0.4, rng.integers(0, 4, n), upper)
    if kind == "exact fit":
        b = A @ np.clip(x, lower, upper)
    rows, columns, weights = np.ones(m), np.ones(n), None
    if kind in ("rows", "both", "rows and weights", "exact fit"):
        rows = 10.0 ** rng.integers(-6, 7, m)
    if kind == "rank in units":  # exact ones: others would be of full rank by their rounding alone
        rows, columns = 2.0 ** rng.integers(-20, 21, m), 2.0 ** rng.integers(-20, 21, n)
    if kind in ("columns", "both"):
        columns = 10.0 ** rng.integers(-6, 7, n)
    if kind in ("weights", "rows and weights"):
        weights = 10.0 ** rng.integers(-8, 9, m)
    ridge = float(rng.choice([0.0, 0.0, 0.0, 0.5])) if kind != "exact fit" else 0.0
    return Case(
        kind,
        rows[:, None] * A * columns,
        rows * b,
        lower / columns,
        upper / columns,
        weights,
        ridge,
    )


def odd(rng: np.random.Generator) -> Case:
    """Return a problem of integers with one or two numbers of other sizes, up to 6 × 4."""
    n, m = int(rng.integers(1, 5)), int(rng.integers(1, 7))
    A, b = integers(rng, m, n), integers(rng, m)
    lower, upper, ridge = np.zeros(n), np.full(n, INF), 0.0
    for _ in range(int(rng.integers(1, 3))):
        i, j = int(rng.integers(0, m)), int(rng.integers(0, n))
        place = rng.choice(
            ["b", "entry", "row", "column", "noise", "upper", "free", "origin", "ridge", "unit"]
        )
        if place == "b":
            b[i] = rng.choice(OUTLIERS)
        elif place == "entry":
            A[i, j] = rng.choice((*OUTLIERS, 1e-9))
        elif place == "row":
            scale = rng.choice((1e-9, 1e6))
            A[i], b[i] = A[i] * scale, b[i] * scale
        elif place == "column":
            A[:, j] *= rng.choice((1e-9, 1e6))
        elif place == "noise":
            A = np.where(A == 0, COSINE, A)
        elif place == "upper":
            here, far = some(rng, (*NONE, 1.0), n, 0.6)
            upper = np.where(here & (far < 1e20), far, upper)
        elif place == "free":
            here, far = some(rng, NONE, n, 0.6)
            lower = np.where(here, np.where(far < 1e20, -far, -INF), lower)
        elif place == "origin":
            b = b + A @ np.full(n, 1e6)
        elif place == "ridge":
            ridge = 1e-9
        else:
            scale = 10.0 ** rng.choice([-120, -100, 100, 120])
            A, b, ridge = A * scale, b * scale, 0.0
    return Case(ODD, A, b, lower, upper, None, ridge)


class Exact:
    """A problem in rational arithmetic."""

    def __init__(self, case: Case) -> None:
        A, b = [exact(row) for row in case.A], exact(case.b)
        weights = exact(np.ones(len(b)) if case.weights is None else case.weights)
        columns = list(zip(*A, strict=True))
        pulled = [[w * a for w, a in zip(weights, column, strict=True)] for column in columns]
        P = [[dot(own, other) for other in columns] for own in pulled]
        for j in range(len(P)):
            P[j][j] += Fraction(case.ridge)
        none = np.zeros((0, len(P)))
        of_x = none, [], none, [], case.lower, case.upper
        self.program = ExactProgram(P, [-dot(own, b) for own in pulled], *of_x)
        self.constant = sum((w * v * v for w, v in zip(weights, b, strict=True)), Fraction(0)) / 2

    def cost(self, x: list[Fraction]) -> Fraction:
        """Return the cost."""
        return self.program.value(x) + self.constant

    @cached_property
    def least(self) -> Fraction:
        """The least cost."""
        return self.cost(self.answer)

    @cached_property
    def answer(self) -> list[Fraction]:
        """An x of least cost; there always is one."""
        found = self.program.optimum()
        assert found is not None
        return found


def complaint(case: Case, truth: Exact, x: Any, tolerance: float = TOLERANCE) -> str:
    """Return what is to be said of a SOLVED x; nothing where it costs no more than the least and tolerance · cost."""
    cost, least = truth.cost([Fraction(float(v)) for v in x]), truth.least
    if cost - least <= Fraction(tolerance) * cost:
        return ""
    root = np.ones(case.b.size) if case.weights is None else np.sqrt(case.weights)

    def rounding(x: Any) -> float:
        return float(np.linalg.norm(root * EPSILON * (np.abs(case.A) @ np.abs(x) + np.abs(case.b))))

    length = np.sqrt(2.0 * float(cost))
    shortest = np.sqrt(2.0 * float(least) / max(1.0 - tolerance, EPSILON))
    if length <= shortest + 8.0 * (case.A.shape[1] + 4) * rounding(x):
        return "above by rounding" if least else "attained 0"
    return "out of reach" if rounding([float(v) for v in truth.answer]) >= length else "FALSE"
