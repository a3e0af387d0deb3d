"""The rule of SOLVED of a linear complementarity problem in rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from lcp_plugin import LCP

from .exact_components import component_of_rows

NEGLIGIBLE = Fraction(1, 2**42)
DIAGONAL = Fraction(1, 2**20)  # of the largest entry of its row, from which a diagonal entry is d


def failures(problem: LCP, z: Any, tolerance: float = 1e-8) -> list[str]:
    """Return a line for each row at which z, within its bounds, fails a clause of the rule; no line if z passes.

    The docstring of :mod:`lcp_plugin.core.certificates.criterion` states the clauses; rows at rounding level are not
    tolerated here. Powers of the tolerance are compared by their fourth powers: nothing is rounded.
    """
    at, start = _Rows(problem, z), _Rows(problem, problem.nearest_to_zero)
    goal = Fraction(tolerance)
    parts = component_of_rows(problem.csr)

    def largest(values: list[Fraction]) -> list[Fraction]:
        top: dict[int, Fraction] = {}
        for part, value in zip(parts, values, strict=True):
            top[part] = max(value, top.get(part, Fraction(0)))
        return [top[part] for part in parts]

    d, n = at.d, problem.n
    active = [
        t / s if on else Fraction(0) for t, s, on in zip(at.terms, d, at.is_active, strict=True)
    ]
    references = map(min, largest(list(map(abs, start.residual))), largest(active))
    w = [
        abs(v) if abs(v) > NEGLIGIBLE * t else Fraction(0)
        for v, t in zip(start.w, start.terms, strict=True)
    ]
    demand = [max([w[i], *(abs(m) * w[j] / d[j] for j, m in at.rows[i])]) for i in range(n)]
    lines = []
    for i, reference in enumerate(references):
        r, v, t, a = abs(at.residual[i]), at.violation[i], at.terms[i], demand[i]
        if not at.lower[i] <= at.z[i] <= at.upper[i]:
            lines.append(f"row {i}: outside its bounds")
        if r > goal * reference:
            lines.append(
                f"row {i}: residual {float(r / (goal * reference) if reference else r):.2g} × its limit"
            )
        if v > NEGLIGIBLE * t and v**4 > goal**3 * t**4:
            lines.append(f"row {i}: violation {float(v / t):.2g} of its terms")
        if v > NEGLIGIBLE * t and a and v**4 > goal * a**4:
            lines.append(f"row {i}: violation {float(v / a):.2g} of its demand")
    return lines


class _Rows:
    """The numbers of the rule at z, one entry per row."""

    def __init__(self, problem: LCP, z: Any) -> None:
        M = problem.csr
        self.z = [Fraction(value) for value in np.asarray(z, dtype=float).tolist()]
        self.rows = [
            [(int(j), Fraction(m)) for j, m in zip(M.indices[a:b], M.data[a:b].tolist(), strict=True)]
            for a, b in zip(M.indptr[:-1], M.indptr[1:], strict=True)
        ]  # fmt: skip
        q = [Fraction(value) for value in problem.q.tolist()]
        self.lower, self.upper = problem.lower.tolist(), problem.upper.tolist()
        self.w = [
            b + sum(m * self.z[j] for j, m in row) for b, row in zip(q, self.rows, strict=True)
        ]
        self.terms = [
            abs(b) + sum(abs(m * self.z[j]) for j, m in row)
            for b, row in zip(q, self.rows, strict=True)
        ]
        self.d, self.residual, self.violation, self.is_active = [], [], [], []
        for i, (row, x, w, low, high) in enumerate(
            zip(self.rows, self.z, self.w, self.lower, self.upper, strict=True)
        ):
            top = max((abs(m) for _, m in row), default=Fraction(0))
            own = dict(row).get(i, Fraction(0))
            d = own if own > 0 and own >= DIAGONAL * top else top or Fraction(1)
            target = x - w / d
            nearest = Fraction(low) if target < low else Fraction(high) if target > high else target
            violation = max(w if x > low else 0, -w if x < high else 0)
            self.d.append(d)
            self.residual.append(x - nearest)
            self.violation.append(violation)
            self.is_active.append(violation > 0 or low < x < high)
