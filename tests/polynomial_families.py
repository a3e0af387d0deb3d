"""Polynomial nonlinear problems with exact rational solutions, and enclosures of them written by hand."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import NonlinearProblem

Interval = tuple[np.ndarray, np.ndarray]


def down(x: np.ndarray) -> np.ndarray:
    return np.nextafter(x, -np.inf)


def up(x: np.ndarray) -> np.ndarray:
    return np.nextafter(x, np.inf)


def plus(a: Interval, b: Interval) -> Interval:
    return down(a[0] + b[0]), up(a[1] + b[1])


def times(a: Interval, b: Interval) -> Interval:
    products = np.stack([a[i] * b[j] for i in (0, 1) for j in (0, 1)])
    return down(products.min(axis=0)), up(products.max(axis=0))


@dataclass(frozen=True)
class Polynomial:
    """F_i(x) = c_i + Σ_j a_ij x_j + b_ij x_j² + d_ij x_j³ + e_i x_i x_{i+1}: its own enclosure, and exact."""

    a: np.ndarray
    b: np.ndarray
    d: np.ndarray
    e: np.ndarray
    c: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    x: np.ndarray

    @property
    def problem(self) -> NonlinearProblem:
        return NonlinearProblem(self.F, self.jacobian, self.lower, self.upper, enclosure=self)

    def F(self, x: np.ndarray) -> np.ndarray:
        return self.c + self.a @ x + self.b @ x**2 + self.d @ x**3 + self.e * x * np.roll(x, -1)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        n = x.size
        derivative = self.a + 2 * self.b * x + 3 * self.d * x**2 + np.diag(self.e * np.roll(x, -1))
        derivative[np.arange(n), (np.arange(n) + 1) % n] += self.e * x
        return derivative

    def exact_F(self, x: np.ndarray) -> list[Fraction]:
        x = [Fraction(float(value)) for value in x]
        n = len(x)
        return [
            Fraction(float(self.c[i]))
            + Fraction(float(self.e[i])) * x[i] * x[(i + 1) % n]
            + sum(
                Fraction(float(self.a[i, j])) * x[j]
                + Fraction(float(self.b[i, j])) * x[j] ** 2
                + Fraction(float(self.d[i, j])) * x[j] ** 3
                for j in range(n)
            )
            for i in range(n)
        ]

    def interval_F(self, low: np.ndarray, high: np.ndarray) -> Interval:
        x = low, high
        square = times(x, x)
        total = self.c, self.c
        for coefficients, power in ((self.a, x), (self.b, square), (self.d, times(square, x))):
            for j in range(low.size):
                column = coefficients[:, j], coefficients[:, j]
                total = plus(
                    total,
                    times(column, (np.full(low.size, power[0][j]), np.full(low.size, power[1][j]))),
                )
        return plus(total, times((self.e, self.e), times(x, (np.roll(low, -1), np.roll(high, -1)))))

    def interval_jacobian(self, low: np.ndarray, high: np.ndarray) -> tuple[Any, Any]:
        n = low.size
        x = np.tile(low, (n, 1)), np.tile(high, (n, 1))
        square = times(x, x)
        total = plus((self.a, self.a), times((2 * self.b, 2 * self.b), x))
        total = plus(total, times((3 * self.d, 3 * self.d), square))
        i, j = np.arange(n), (np.arange(n) + 1) % n
        e = self.e, self.e
        for rows, columns, factor in ((i, i, (low[j], high[j])), (i, j, (low, high))):
            least, most = plus((total[0][rows, columns], total[1][rows, columns]), times(e, factor))
            total[0][rows, columns], total[1][rows, columns] = least, most
        return sp.csr_array(total[0]), sp.csr_array(total[1])


def polynomial(rng: np.random.Generator, *, is_dominant: bool) -> Polynomial:
    """A polynomial problem whose solution x is exact in doubles, the only one where it is dominant."""
    n = int(rng.integers(1, 9))

    def dyadic(*shape: int, scale: int = 4) -> np.ndarray:
        return rng.integers(-2 * scale, 2 * scale + 1, shape) / scale

    a, b, d, e = dyadic(n, n), dyadic(n, n) / 2, dyadic(n, n) / 4, dyadic(n) / 2
    if is_dominant:
        b, e = np.zeros((n, n)), np.zeros(n)
        d = np.diag(np.abs(d.diagonal()))
        a += np.diag(np.abs(a).sum(axis=1) + 0.25 - a.diagonal() * (1 + np.sign(a.diagonal())) / 2)
    x, state = dyadic(n, scale=8), rng.choice(4, n, p=[0.4, 0.3, 0.2, 0.1])
    lower = np.where(state == 1, x, np.where(state == 3, -np.inf, x - rng.integers(1, 17, n) / 8))
    upper = np.where(
        state == 2, x, np.where(rng.random(n) < 0.5, np.inf, x + rng.integers(1, 17, n) / 8)
    )
    w = rng.integers(1, 17, n) / 8 * np.where(state == 1, 1, np.where(state == 2, -1, 0))
    blank = Polynomial(a, b, d, e, np.zeros(n), lower, upper, x)
    c = np.array(
        [
            float(Fraction(float(slack)) - value)
            for slack, value in zip(w, blank.exact_F(x), strict=True)
        ]
    )
    return Polynomial(a, b, d, e, c, lower, upper, x)


def is_violated(one: Polynomial, z: np.ndarray, componentwise: np.ndarray) -> bool:
    """Whether the planted solution is farther from z than a bound says, in fractions."""
    return any(
        abs(Fraction(float(p)) - Fraction(float(q))) > Fraction(float(most))
        for p, q, most in zip(z, one.x, componentwise, strict=True)
        if most < np.inf
    )
