"""Random nonlinear problems whose derivatives vanish or blow up, with and without solutions, judged in sixty digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from nonlinear_families import DIGITS, exact

from lcp_plugin import NonlinearProblem

OWN_TERMS = Decimal("1e-6")  # of the sum of its terms a row that must vanish may be
BESIDE = 1e-8  # of the unit of x
ULPS = 16  # of the sizes of the terms that F adds up, and of what an ulp of x/u changes: what rounding makes of F
SMALLEST = 5e-324
DECADES = (-5, 5)  # of the starts, in the unit of x
BOUNDS = ("zero", "tiny", "free", "box")


class Operations(NamedTuple):
    """exp and log of one kind of numbers."""

    exp: Callable[[Any], Any]
    log: Callable[[Any], Any]


DOUBLES = Operations(np.exp, np.log)
EXACT = Operations(Decimal.exp, Decimal.ln)
Shape = Callable[[Any, int, Operations], tuple[Any, Any]]


def _power(t: Any, a: int, by: Operations) -> tuple[Any, Any]:
    return t**-a, -a * t ** (-a - 1)


def _exponential(t: Any, a: int, by: Operations) -> tuple[Any, Any]:
    return by.exp(-t), -by.exp(-t)


def _logistic(t: Any, a: int, by: Operations) -> tuple[Any, Any]:
    e = by.exp(-t)
    return 1 / (1 + e), 1 / ((1 + e) * (1 + 1 / e))


def _logarithm(t: Any, a: int, by: Operations) -> tuple[Any, Any]:
    return by.log(t), 1 / t


def _rational(t: Any, a: int, by: Operations) -> tuple[Any, Any]:
    flat, value = 1 / (1 + t * t), t / (1 + t * t)
    return value, flat - 2 * value * value


def _bump(t: Any, a: int, by: Operations) -> tuple[Any, Any]:
    flat = 1 / (1 + t * t)
    return flat, -2 * (t * flat) * flat


SHAPES: dict[str, Shape] = {
    "power": _power,
    "exponential": _exponential,
    "logistic": _logistic,
    "logarithm": _logarithm,
    "rational": _rational,
    "bump": _bump,
}
STRUCTURES = ("scalar", "coupled", "two units")


@dataclass(frozen=True)
class Vanishing:
    """F_i(x) = s_i (c_i φ_i(t_i) + (A t)_i − d_i), t = x/u, φ the named shapes: t^−a, exp(−t), logistic, log, rational.

    `t` is a solution in the unit u, or None where there is none.
    """

    shapes: tuple[str, ...]
    a: np.ndarray
    c: np.ndarray
    A: np.ndarray
    d: np.ndarray
    s: np.ndarray
    u: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    start: np.ndarray
    has_jacobian: bool
    t: np.ndarray | None

    @cached_property
    def problem(self) -> NonlinearProblem:
        return NonlinearProblem(
            self.F,
            self.jacobian if self.has_jacobian else None,
            self.lower,
            self.upper,
            None if self.has_jacobian else np.abs(self.A) + np.eye(self.c.size),
        )

    def _shaped(self, t: np.ndarray, by: Operations) -> tuple[np.ndarray, np.ndarray]:
        pairs = [
            SHAPES[name](value, int(a), by)
            for name, value, a in zip(self.shapes, t, self.a, strict=True)
        ]
        values, slopes = zip(*pairs, strict=True)
        return np.array(values), np.array(slopes)

    def F(self, x: np.ndarray) -> np.ndarray:
        t = x / self.u
        return self.s * (self.c * self._shaped(t, DOUBLES)[0] + self.A @ t - self.d)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        slopes = np.diag(self.c * self._shaped(x / self.u, DOUBLES)[1])
        return self.s[:, None] * (slopes + self.A) / self.u

    def sharp(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """F(x), the terms |F′_ij x_j| + |F_i − Σ F′_ij x_j| of each row and the sizes that F adds up, in sixty digits.

        In `localcontext(wide())`.
        """
        A, c, d, s, u, x = (exact(array) for array in (self.A, self.c, self.d, self.s, self.u, x))
        t = x / u
        values, slopes = self._shaped(t, EXACT)
        F = s * (c * values + A.dot(t) - d)
        moved = s * (c * slopes * t + A.dot(t))  # F′(x) x
        by_column = s * (
            abs(c * slopes + np.diagonal(A)) * abs(t) + abs(A - np.diag(np.diagonal(A))).dot(abs(t))
        )
        added = s * (abs(c * values) + abs(c * slopes * t) + abs(A).dot(abs(t)) + abs(d))
        return F, by_column + abs(F - moved), added

    def wrong_rows(self, x: np.ndarray) -> list[tuple[int, float, float]]:
        """The rows that must vanish and do not, each with |F_i| and its terms, in sixty digits.

        Beside a bound, in the unit of the unknowns that are coupled, no row must vanish whose sign is right on it.
        """
        found = []
        coupled = (
            np.abs(x / self.u) if self.is_uncoupled else np.full(x.size, np.abs(x / self.u).max())
        )
        near = BESIDE * self.u * np.maximum(coupled, 1.0)
        with localcontext(wide()):
            values, terms, added = self.sharp(x)
            bound = np.where([value > 0 for value in values], self.lower, self.upper)
            on_bounds = self.sharp(np.where(np.abs(x - bound) <= near, bound, x))[0]
            for i in range(x.size):
                is_there = abs(x[i] - bound[i]) <= near[i] and not on_bounds[i] * values[i] < 0
                allowed = ULPS * Decimal(2.0**-52) * added[i] + Decimal(SMALLEST) * (
                    1 + exact(self.s)[i]
                )
                if not is_there and not abs(values[i]) <= OWN_TERMS * terms[i] + allowed:
                    found.append((i, float(abs(values[i])), float(terms[i])))
        return found

    @property
    def is_uncoupled(self) -> bool:
        return not np.any(self.A - np.diag(np.diagonal(self.A)))


def wide() -> Context:
    """Sixty digits, and exponents that nothing leaves."""
    return Context(prec=DIGITS, Emax=MAX_EMAX, Emin=MIN_EMIN, traps=[])


def vanishing(rng: np.random.Generator, shape: str, structure: str) -> Vanishing:
    """A random problem; about a quarter of the uncoupled ones have no solution."""
    n = {"scalar": 1, "coupled": int(rng.integers(2, 6)), "two units": 2}[structure]
    shapes = (shape, *(str(name) for name in rng.choice(list(SHAPES), n - 1)))
    kinds = rng.choice(BOUNDS, n)
    t, w = _planted(rng, shapes, kinds)
    box = np.where(
        np.isin(shapes, ("power", "logarithm")), t / 10.0 ** rng.uniform(0, 3, n), t / 10.0**2 - 1.0
    )
    lower = np.select(
        [kinds == "zero", kinds == "tiny", kinds == "free"], [0.0, 1e-9, -np.inf], box
    )
    upper = np.where(kinds == "box", t + 10.0 ** rng.uniform(-2, 3, n), np.inf)
    lower, upper = np.where(w > 0.0, t, lower), np.where(w < 0.0, t, upper)
    a, c = rng.integers(1, 5, n), rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(-2, 2, n)
    A = np.zeros((n, n))
    if structure == "coupled":
        A = np.where(
            rng.random((n, n)) < 0.6, rng.standard_normal((n, n)), 0.0
        ) * 10.0 ** rng.uniform(-3, 0)
        A += np.diag(
            np.where(rng.random(n) < 0.5, 2.0 * np.abs(A).sum(axis=1), 0.0) - np.diagonal(A)
        )
        c = np.where(
            (rng.random(n) < 0.7) & np.isin(shapes, ("power", "exponential")), -np.abs(c), c
        )
    decade = rng.uniform(*DECADES)
    u, s = (
        10.0 ** rng.uniform(-10, 10, n) if structure == "two units" else np.ones(n)
        for _ in range(2)
    )
    is_defined_above_0 = np.isin(shapes, ("power", "logarithm"))
    sign = np.where((kinds == "free") & ~is_defined_above_0, rng.choice([-1.0, 1.0], n), 1.0)
    blank = Vanishing(
        shapes,
        a,
        c,
        A,
        np.zeros(n),
        np.ones(n),
        np.ones(n),
        lower,
        upper,
        sign * 10.0**decade,
        bool(rng.random() < 0.5),
        t,
    )
    d = blank.F(t) - w
    is_empty = np.zeros(n, bool)
    if structure != "coupled" and rng.random() < 0.35:  # −c φ − d < 0 all along, with c and d > 0
        is_empty = (
            np.isin(kinds, ("zero", "tiny")) & (np.array(shapes) != "logarithm") & (upper == np.inf)
        )
        lower = np.where(is_empty & (kinds == "zero"), 0.0, np.where(is_empty, 1e-9, lower))
        c = np.where(is_empty, -np.abs(c), c)
        gap = np.where(
            np.isin(shapes, "rational"), 1.0, rng.choice([0.0, 1.0])
        )  # t/(1 + t²) is 0 at 0
        d = np.where(is_empty, gap * 10.0 ** rng.uniform(-3, 1, n), d)
    return _started(
        Vanishing(
            shapes,
            a,
            c,
            A,
            d,
            s,
            u,
            lower * u,
            upper * u,
            blank.start * u,
            blank.has_jacobian,
            None if is_empty.any() else t,
        )
    )


def _planted(
    rng: np.random.Generator, shapes: tuple[str, ...], kinds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A solution in its unit, and its slack: 0, or at a bound as large as 10 at most."""
    n = len(shapes)
    t = 10.0 ** rng.uniform(-2, 2, n)
    may_be_negative = (kinds == "free") & ~np.isin(shapes, ("power", "logarithm"))
    t *= np.where(may_be_negative & (np.abs(t) < 30.0), rng.choice([-1.0, 1.0], n), 1.0)
    at_bound = (kinds == "box") & (rng.random(n) < 0.4)
    return t, np.where(at_bound, rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(-2, 1, n), 0.0)


def _started(one: Vanishing) -> Vanishing:
    """The problem with its start as near to 0 as F must be to be finite there."""
    start = one.start.copy()
    for _ in range(20):
        x = np.clip(start, one.lower, one.upper)
        with np.errstate(all="ignore"):
            if np.isfinite(one.F(x)).all() and np.isfinite(one.F(x) - one.jacobian(x) @ x).all():
                break
        start /= 10.0
    return Vanishing(**{**vars_of(one), "start": start})


def vars_of(one: Vanishing) -> dict[str, Any]:
    return {name: getattr(one, name) for name in one.__dataclass_fields__}


def decade_of(one: Vanishing) -> int:
    """The decade of the start in the unit of x."""
    return math.floor(math.log10(float(np.abs(one.start / one.u).max())))
