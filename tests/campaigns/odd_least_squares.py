"""Small least squares problems with one odd number that users write; the least cost by rational arithmetic."""

from __future__ import annotations

import itertools
from fractions import Fraction
from typing import Any

import numpy as np
from oracles.exact import solve_fractions

ODD = (1e-17, float(np.cos(np.pi / 2)), 1e-9, 1e-5, 1e10, 1e15, 1e19)
MOST = 1e-2  # of the objective's terms: an error that is one
ZERO = Fraction(0)
LEAST_SQUARES = ("entry", "row", "weights", "ridge", "l1", "bound", "b", "column")


def fractions(values: Any) -> list[Any]:
    """Return numbers, or rows of numbers, as fractions."""
    return [fractions(value) if np.ndim(value) else Fraction(float(value)) for value in values]


def product(rows: Any, x: Any) -> list[Fraction]:
    """Return rows · x."""
    return [sum((a * v for a, v in zip(row, x, strict=True) if a), ZERO) for row in rows]


def least_squares(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """Return a small problem with one odd number of a kind, as `bounded_least_squares` takes it."""
    n, m, odd = int(rng.integers(1, 4)), int(rng.integers(1, 6)), float(rng.choice(ODD))
    A, b = rng.integers(-3, 4, (m, n)).astype(float), rng.integers(-3, 4, m).astype(float)
    if rng.random() < 0.5:
        A, b = rng.normal(size=(m, n)), rng.normal(size=m)
    lower, upper = (
        np.where(rng.random(n) < 0.5, 0.0, -np.inf),
        np.where(rng.random(n) < 0.3, 1.0, np.inf),
    )
    weights, ridge, l1 = np.ones(m), 0.0, np.zeros(n)
    i, j = int(rng.integers(m)), int(rng.integers(n))
    if kind == "entry":
        A[i, j] = odd
    elif kind == "row":
        A[i], b[i] = A[i] * odd, b[i] * odd
    elif kind == "column":
        A[:, j] *= odd
    elif kind == "weights":
        weights[i] = odd
    elif kind == "ridge":
        ridge = odd
    elif kind == "l1":
        l1[j] = odd
    elif kind == "b":
        b[i] = odd
    else:
        upper, lower = (
            np.where(rng.random(n) < 0.5, odd, upper),
            np.where(rng.random(n) < 0.3, -odd, lower),
        )
    return {
        "A": A,
        "b": b,
        "lower": lower,
        "upper": upper,
        "weights": weights,
        "ridge": ridge,
        "l1": l1,
    }


def cost(case: dict[str, Any], x: list[Fraction]) -> Fraction:
    """Return the cost without rounding."""
    rest = [
        v - b for v, b in zip(product(fractions(case["A"]), x), fractions(case["b"]), strict=True)
    ]
    squares = sum((w * r * r for w, r in zip(fractions(case["weights"]), rest, strict=True)), ZERO)
    curved = squares + Fraction(case["ridge"]) * sum((v * v for v in x), ZERO)
    return curved / 2 + sum(
        (a * abs(v) for a, v in zip(fractions(case["l1"]), x, strict=True)), ZERO
    )


def least_cost(case: dict[str, Any]) -> Fraction:
    """Return the least cost over all states: each column is free on a side of 0, at a bound or at 0."""
    A, b, w = fractions(case["A"]), fractions(case["b"]), fractions(case["weights"])
    n, ridge, l1 = len(A[0]), Fraction(case["ridge"]), fractions(case["l1"])
    gram = [
        [
            sum((v * r[i] * r[j] for r, v in zip(A, w, strict=True)), ridge * (i == j))
            for j in range(n)
        ]
        for i in range(n)
    ]
    pull = [sum((v * r[i] * e for r, v, e in zip(A, w, b, strict=True)), ZERO) for i in range(n)]
    states, best = [], None
    for j in range(n):
        ends = {float(end) for end in (case["lower"][j], case["upper"][j]) if abs(end) < 1e20}
        at = ends | ({0.0} if case["lower"][j] <= 0.0 <= case["upper"][j] else set())
        slants = (1, -1) if l1[j] else (1,)
        states.append(
            [(True, Fraction(sign)) for sign in slants] + [(False, Fraction(v)) for v in at]
        )
    for state in itertools.product(*states):
        free = [j for j in range(n) if state[j][0]]
        x = [ZERO if is_free else v for is_free, v in state]
        right = [pull[i] - product([gram[i]], x)[0] - state[i][1] * l1[i] for i in free]
        found = solve_fractions([[gram[i][j] for j in free] for i in free], right)
        if found is None:
            continue
        for j, v in zip(free, found, strict=True):
            x[j] = v
        if all(
            low <= v <= high for low, v, high in zip(case["lower"], x, case["upper"], strict=True)
        ):
            here = cost(case, x)
            best = here if best is None else min(best, here)
    assert best is not None
    return best


def excess(case: dict[str, Any], x: Any, least: Fraction | None = None) -> float:
    """Return the excess of the cost of x, relative to the least cost plus the cost of 1e-13 of each row's terms."""
    least = least_cost(case) if least is None else least
    terms = np.abs(case["A"]) @ np.abs(x) + np.abs(case["b"])
    unit = least + Fraction(float((case["weights"] * np.square(1e-13 * terms)).sum()))
    more = cost(case, fractions(x)) - least
    return 0.0 if more <= 0 else np.inf if more > unit * 10**300 else float(more / unit)
