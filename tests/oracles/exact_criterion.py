"""The rule of SOLVED of a linear complementarity problem in rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from lcp_plugin import LCP

from .truth import ExactData, component_of_rows, references_of_rows

NEGLIGIBLE = Fraction(1, 2**42)


def failures(problem: LCP, z: Any, tolerance: float = 1e-8) -> list[str]:
    """Return a line for each row at which z fails a clause of the rule; no line if z passes.

    The docstring of :mod:`lcp_plugin.judges.lcp` states the clauses. Powers of the tolerance are
    compared by their fourth powers: nothing is rounded.
    """
    at, start = _Rows(problem, z), _Rows(problem, problem.nearest_to_zero)
    counted = ExactData(problem).counted(at.z)
    goal, d, n = Fraction(tolerance), at.d, problem.n
    w = [
        abs(v) if abs(v) > NEGLIGIBLE * t else Fraction(0)
        for v, t in zip(start.w, start.terms, strict=True)
    ]
    demand = [max([w[i], *(abs(m) * w[j] / d[j] for j, m in at.rows[i])]) for i in range(n)]
    lines = []
    for i, reference in enumerate(references(problem, z)):
        r, v, t, a = counted[i], at.violation[i], at.terms[i], demand[i]
        if r > goal * reference:
            lines.append(
                f"row {i}: residual {float(r / (goal * reference) if reference else r):.2g} × its limit"
            )
        if v > NEGLIGIBLE * t and v**4 > goal**3 * t**4:
            lines.append(f"row {i}: violation {float(v / t):.2g} of its terms")
        if v > NEGLIGIBLE * t and a and v**4 > goal * a**4:
            lines.append(f"row {i}: violation {float(v / a):.2g} of its demand")
    return lines


def references(problem: LCP, z: Any) -> list[Fraction]:
    """Return the reference of each row: the residual ≠ 0 at z° or the active terms at z, largest of the component."""
    at, start = _Rows(problem, z), _Rows(problem, problem.nearest_to_zero)
    zips = zip(at.terms, at.d, at.is_active, strict=True)
    active = [t / d if is_active else Fraction(0) for t, d, is_active in zips]
    parts = component_of_rows(problem.csr)
    begun = ExactData(problem).counted(start.z)
    both = references_of_rows(begun, parts), references_of_rows(active, parts)
    slack = [
        abs(v) / d if abs(v) > NEGLIGIBLE * t else Fraction(0)
        for v, t, d in zip(start.w, start.terms, start.d, strict=True)
    ]
    solved = references_of_rows(slack, parts)
    return [min(r or w, end) for r, end, w in zip(*both, solved, strict=True)]


class _Rows:
    """The numbers of the rule at z, one entry per row."""

    def __init__(self, problem: LCP, z: Any) -> None:
        data = ExactData(problem)
        self.z = [Fraction(value) for value in np.asarray(z, dtype=float).tolist()]
        self.rows = [[(j, Fraction(m, data.scale)) for j, m in row] for row in data.rows]
        self.lower, self.upper = problem.lower.tolist(), problem.upper.tolist()
        self.w, self.terms, self.d = data.slack(self.z), data.terms(self.z), data.divisor
        self.residual = data.steps(self.z, data.divisor)
        ends = list(zip(self.z, self.w, self.lower, self.upper, strict=True))
        self.violation = [d * abs(r) for d, r in zip(self.d, self.residual, strict=True)]
        self.is_active = [
            violation > 0 or low < x < high
            for violation, (x, _, low, high) in zip(self.violation, ends, strict=True)
        ]
