"""Convex programs in rational arithmetic: values, terms, and an optimum from the optimality conditions."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import QuadraticProgram

from .truth import Search

INF = math.inf


def exact(values: Any) -> list[Any]:
    """Return numbers as fractions; infinities stay."""
    return [v if math.isinf(v) else Fraction(v) for v in np.asarray(values).tolist()]


def limits(values: Any) -> np.ndarray:
    """Return limits, of which those of 1e20 up to 1e-12 of it, and beyond, are none."""
    values = np.asarray(values, float)
    return np.where(abs(values) >= 1e20 * (1.0 - 1e-12), np.copysign(INF, values), values)


def dot(row: list[Fraction], x: list[Fraction]) -> Fraction:
    return sum((entry * value for entry, value in zip(row, x, strict=True)), Fraction(0))


class ExactProgram:
    """Minimize ½xᵀPx + cᵀx, G x ≤ h, A x = b, bounds, convex, in fractions."""

    def __init__(
        self, P: Any, c: Any, G: Any, h: Any, A: Any, b: Any, lower: Any, upper: Any
    ) -> None:
        P = np.zeros((len(c), len(c))) if P is None else P
        keep = limits(h) < INF
        self.P, self.G, self.A = (
            [exact(row) for row in rows] for rows in (P, np.asarray(G)[keep], A)
        )
        self.c, self.h, self.b = exact(c), exact(np.asarray(h)[keep]), exact(b)
        self.lower, self.upper = limits(lower).tolist(), limits(upper).tolist()

    @classmethod
    def of(cls, given: QuadraticProgram) -> ExactProgram:
        """Return a program of doubles in fractions."""
        P, G, A = (
            one.toarray() if sp.issparse(one) else one for one in (given.P, given.G, given.A)
        )
        return cls(P, given.c, G, given.h, A, given.b, given.lower, given.upper)

    def terms(self, x: list[Fraction]) -> tuple[Fraction, list[Fraction]]:
        """Return xᵀP x and the terms of cᵀx."""
        curved = dot(x, [dot(row, x) for row in self.P])
        return curved, [cost * v for cost, v in zip(self.c, x, strict=True)]

    def value(self, x: list[Fraction]) -> Fraction:
        curved, linear = self.terms(x)
        return curved / 2 + sum(linear, Fraction(0))

    def size(self, x: list[Fraction]) -> Fraction:
        """Return Σ|c_j x_j| + |xᵀP x|."""
        curved, linear = self.terms(x)
        return abs(curved) + sum(map(abs, linear), Fraction(0))

    def optimum(self) -> list[Fraction] | None:
        """Return an optimal x, by a search over the cases of the optimality conditions; None if there is none."""
        rows, m, n = [*self.G, *self.A], len(self.h), len(self.c)
        M = [[*own, *(row[j] for row in rows)] for j, own in enumerate(self.P)]
        M += [[*(-entry for entry in row), *[Fraction(0)] * len(rows)] for row in rows]
        free = [INF] * len(self.b)
        lower = [*self.lower, *[0.0] * m, *(-end for end in free)]
        upper = [*self.upper, *[INF] * m, *free]
        z = Search(M, [*self.c, *self.h, *self.b], lower, upper).run().z
        return None if z is None else list(z[:n])
