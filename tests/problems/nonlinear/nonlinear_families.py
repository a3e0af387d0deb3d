"""Random monotone and P₀ nonlinear problems with a planted solution, and their residual in extended precision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lcp_plugin import NonlinearProblem

KINDS = (
    "monotone polynomial",
    "monotone exponential",
    "scaled rows",
    "triangular polynomial",
    "triangular exponential",
    "far exponential",
)
FAR = 20.0  # below 0, where an exponential has become flat: ‖r(z°)‖ is huge there and no reference
DOUBLES = 1e-9  # far above what rounding does to the sums of positive terms in the reference


@dataclass(frozen=True)
class Planted:
    """F(x) = s (M x + Bᵀ g(B x) + L g(x) + c), by rows, with a solution x.

    g is t + t³ or exp t, increasing. M positive semidefinite and L = 0: F is monotone; s > 0 by rows: P₀ as before. M
    and L lower triangular, the diagonals ≥ 0: F is P₀. "far": M = 0 and x is FAR below 0.
    """

    M: np.ndarray
    B: np.ndarray
    L: np.ndarray
    c: np.ndarray
    s: np.ndarray
    is_exponential: bool
    lower: np.ndarray
    upper: np.ndarray
    x: np.ndarray

    @cached_property
    def problem(self) -> NonlinearProblem:
        return NonlinearProblem(self.F, self.jacobian, self.lower, self.upper)

    def F(self, x: np.ndarray) -> np.ndarray:
        g = np.exp if self.is_exponential else lambda t: t + t**3
        return self.s * (self.M @ x + self.B.T @ g(self.B @ x) + self.L @ g(x) + self.c)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        dg = np.exp if self.is_exponential else lambda t: 1 + 3 * t**2
        return self.s[:, None] * (self.M + (self.B.T * dg(self.B @ x)) @ self.B + self.L * dg(x))

    def rounding(self, x: np.ndarray) -> np.ndarray:
        """What doubles may make of F(x), by rows: that many roundings of the sum of its terms' sizes."""
        inner, size = self.B @ x, np.abs(x)
        g, dg = (
            (np.exp, np.exp)
            if self.is_exponential
            else (lambda t: t + t**3, lambda t: 1 + 3 * t**2)
        )
        terms = np.abs(self.M) @ size + np.abs(self.L) @ np.abs(g(x)) + np.abs(self.c)
        terms += np.abs(self.B.T) @ (np.abs(g(inner)) + dg(inner) * (np.abs(self.B) @ size))
        return 4 * x.size * np.finfo(float).eps * np.abs(self.s) * terms

    def sharp_relative_residual(self, x: np.ndarray, scale: np.ndarray) -> float:
        """‖r(x)‖∞ relative to its reference in the given scale d, F in extended precision, but for rounding of F.

        The reference is ‖r(z°)‖∞, or where that is less ‖r(x)‖∞ + max_i (|x − z°|_i + (|F′(x)| |x − z°|)_i / d_i), the
        most that an affine F with this derivative has there.
        """
        origin = np.clip(0.0, self.lower, self.upper)
        distance = np.abs(x - origin)
        reach = (distance + np.abs(self.jacobian(x)) @ distance / scale).max(initial=0.0)
        left = np.maximum(self.residual(x, scale) - self.rounding(x) / scale, 0.0).max(initial=0.0)
        there = self.residual(origin, scale).max(initial=0.0)
        return float(left / min(there, left + reach * (1.0 + DOUBLES))) if left else 0.0

    def residual(self, x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """|x − mid(lower, upper, x − F(x) / d)|, in extended precision."""
        at = x.astype(np.longdouble)
        return abs(np.maximum(np.minimum(self.F(at) / scale, at - self.lower), at - self.upper))


def planted(rng: np.random.Generator, kind: str, n: int) -> Planted:
    """A random problem of that kind and size."""
    is_exponential = "exp" in kind or ("scaled" in kind and rng.random() < 0.5)
    is_far = "far" in kind
    is_triangular = is_far or "triangular" in kind
    density = min(1.0, 5.0 / n)
    with np.errstate(invalid="ignore"):
        lower, upper, x, w = _bounds(rng, n)
        lower, upper, x = (points - FAR * is_far for points in (lower, upper, x))
    rank = int(rng.integers(max(1, n // 2), n + 1))
    B = np.where(rng.random((rank, n)) < density, rng.standard_normal((rank, n)), 0.0) / np.sqrt(
        density * n
    )
    L = np.zeros((n, n))
    if is_triangular:
        M = (
            np.tril(np.where(rng.random((n, n)) < density, rng.standard_normal((n, n)), 0.0), -1)
            * 0.3
        )
        L = (
            np.tril(np.where(rng.random((n, n)) < density, rng.standard_normal((n, n)), 0.0), -1)
            * 0.1
        )
        M += np.diag(np.where(rng.random(n) < 0.2, 0.0, rng.uniform(0.1, 2.0, n)))
        M *= not is_far
        L += np.diag(
            np.where((rng.random(n) < 0.2) & (M.diagonal() > 0.0), 0.0, rng.uniform(0.1, 1.0, n))
        )
        is_flat = (w != 0.0) & (rng.random(n) < 0.3)  # F_i does not depend on x_i: P₀ and no more
        M[is_flat, is_flat] = L[is_flat, is_flat] = 0.0
        B[:] = 0.0
    else:
        A = np.where(rng.random((n, rank)) < density, rng.standard_normal((n, rank)), 0.0)
        skew = np.where(rng.random((n, n)) < density, rng.standard_normal((n, n)), 0.0)
        M = A @ A.T * rng.choice([0.0, 1.0]) + skew - skew.T
    s = 10.0 ** rng.uniform(-3, 3, n) if "scaled" in kind else np.ones(n)
    blank = Planted(M, B, L, np.zeros(n), s, is_exponential, lower, upper, x)
    return Planted(M, B, L, w / s - blank.F(x) / s, s, is_exponential, lower, upper, x)


def _bounds(rng: np.random.Generator, n: int) -> tuple[Any, ...]:
    """Bounds of all kinds, and a solution with its slack: at a bound, inside, a few degenerate."""
    kind = rng.choice(5, n, p=rng.dirichlet(np.ones(5)))
    lower = np.where(
        np.isin(kind, (0, 1, 2)), np.where(kind == 0, 0.0, rng.uniform(-2, 1, n)), -np.inf
    )
    upper = np.where(
        np.isin(kind, (1, 3)),
        np.where(np.isfinite(lower), lower, 0.0) + rng.uniform(0.1, 3, n),
        np.inf,
    )
    state = rng.choice(4, n, p=[0.4, 0.25, 0.3, 0.05])
    middle = rng.uniform(0.05, 0.95, n)
    inside = np.where(
        np.isfinite(lower) & np.isfinite(upper), lower + middle * (upper - lower), np.nan
    )
    inside = np.where(np.isnan(inside) & np.isfinite(lower), lower + 2 * middle, inside)
    inside = np.where(np.isnan(inside) & np.isfinite(upper), upper - 2 * middle, inside)
    inside = np.where(np.isnan(inside), rng.uniform(-2, 2, n), inside)
    at_lower = np.isin(state, (1, 3)) & np.isfinite(lower)
    at_upper = (state == 2) & np.isfinite(upper)
    x = np.where(at_lower, lower, np.where(at_upper, upper, inside))
    size = rng.uniform(0.01, 2, n) * (state != 3)
    return lower, upper, x, np.where(at_lower, size, np.where(at_upper, -size, 0.0))
