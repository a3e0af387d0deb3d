"""Polynomial nonlinear problems with exact rational solutions."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from lcp_plugin import NonlinearProblem


@dataclass(frozen=True)
class Polynomial:
    """F_i(x) = c_i + Σ_j a_ij x_j + b_ij x_j² + d_ij x_j³ + e_i x_i x_{i+1}."""

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
        return NonlinearProblem(self.F, self.jacobian, self.lower, self.upper)

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
