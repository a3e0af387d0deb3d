"""Random small problems of all kinds: search, infeasibility proofs and enumeration against an independent enumeration.

The truth comes from linear inequalities for each of the 3ⁿ patterns, which an exact simplex method decides that is no
code of the package.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
from oracles.truth import Simplex

from lcp_plugin import LCP
from lcp_plugin.methods.search import NoSolution, Solution, search
from lcp_plugin.proofs.no_solution import find_infeasibility

from . import small_lcps

# An inequality is (coefficients, constant, strict): coefficients·z + constant ≥ 0, or > 0.
Inequality = tuple[tuple[Fraction, ...], Fraction, bool]


def is_satisfiable(system: list[Inequality]) -> bool:
    """Whether inequalities have a common point: s·z and s ≥ 1 exist with rows ≥ 0, and ≥ 1 where they are strict."""
    if not system:
        return True
    simplex, n = Simplex([[*a, c] for a, c, _ in system]), len(system[0][0])
    simplex.low[n:] = [Fraction(1), *(Fraction(strict) for *_, strict in system)]
    return simplex.settle()


class Enumeration:
    """All patterns of a problem, each as a system of inequalities."""

    def __init__(self, M, q, lower, upper):
        n = self.n = len(q)
        self.lower, self.upper = lower.tolist(), upper.tolist()
        self.z = [(tuple(Fraction(int(i == j)) for j in range(n)), Fraction(0)) for i in range(n)]
        self.w = [
            (tuple(Fraction(float(x)) for x in M[i]), Fraction(float(q[i]))) for i in range(n)
        ]
        self.choices = [self.row_choices(i) for i in range(n)]

    def row_choices(self, i):
        if self.lower[i] == self.upper[i]:
            return ["fixed"]
        return (
            ["lower"] * (self.lower[i] > -np.inf) + ["zero"] + ["upper"] * (self.upper[i] < np.inf)
        )

    def at_least(self, form, bound, sign=1, strict=False):
        """sign·(form − bound) ≥ 0 (or > 0); nothing for an infinite bound."""
        if np.isinf(float(bound)):
            return []
        return [(tuple(sign * x for x in form[0]), sign * (form[1] - Fraction(bound)), strict)]

    def row(self, i, choice):
        z, w, low, high = self.z[i], self.w[i], float(self.lower[i]), float(self.upper[i])
        box = self.at_least(z, low) + self.at_least(z, high, -1)
        if choice == "zero":
            return box + self.at_least(w, 0) + self.at_least(w, 0, -1)
        if choice == "lower":
            return box + self.at_least(z, low, -1) + self.at_least(w, 0)
        return box + (self.at_least(z, high) + self.at_least(w, 0, -1) if choice == "upper" else [])

    def system(self, pattern):
        return [
            inequality for i, choice in enumerate(pattern) for inequality in self.row(i, choice)
        ]

    def solvable_patterns(self):
        return [
            pattern for pattern in product(*self.choices) if is_satisfiable(self.system(pattern))
        ]

    def is_linearly_feasible(self):
        system = []
        for i in range(self.n):
            low, high = float(self.lower[i]), float(self.upper[i])
            system += self.at_least(self.z[i], low) + self.at_least(self.z[i], high, -1)
            system += self.at_least(self.w[i], 0) if np.isinf(high) else []
            system += self.at_least(self.w[i], 0, -1) if np.isinf(low) else []
        return is_satisfiable(system)

    def lies_in(self, inner, outer):
        """Whether each point of one pattern satisfies the other."""
        system = self.system(inner)
        opposite = [
            (tuple(-x for x in a), -c, True)
            for i, choice in enumerate(outer)
            if choice != inner[i]
            for a, c, _ in self.row(i, choice)
        ]
        return not any(is_satisfiable([*system, row]) for row in opposite)

    def is_a_point(self, pattern, z):
        system = self.system(pattern)
        moved = [
            self.at_least(self.z[i], z[i], sign, True) for i in range(self.n) for sign in (1, -1)
        ]
        return not any(is_satisfiable(system + row) for row in moved)

    def satisfies(self, pattern, z):
        return all(
            sum((x * y for x, y in zip(a, z, strict=True)), c) >= 0
            for a, c, _ in self.system(pattern)
        )


def random_problem(rng, largest=4):
    """Small integers or doubles; degenerate, singular, skew, with zero rows, boxes, free rows."""
    return small_lcps.random_problem(str(rng.choice([*small_lcps.KINDS])), rng, largest)


def violations(problem: LCP) -> list[str]:
    """Compare everything claimed about one problem with the enumeration; return complaints."""
    truth = Enumeration(problem.csr.toarray(), problem.q, problem.lower, problem.upper)
    patterns = truth.solvable_patterns()
    bad: list[str] = []
    first, every = search(problem), search(problem, first_only=False)
    for outcome in (first, every):
        if isinstance(outcome, NoSolution) != (not patterns):
            bad.append(f"{type(outcome).__name__}, but {len(patterns)} patterns have solutions")
        if isinstance(outcome, NoSolution) and not outcome.verify():
            bad.append("proof of no solution does not verify")
        if isinstance(outcome, list):
            bad += [
                complaint for s in outcome for complaint in wrong_with(truth, s, outcome is every)
            ]
    if isinstance(every, list):
        listed = [s.pattern for s in every]
        bad += [
            f"{p} is not covered"
            for p in patterns
            if not any(truth.lies_in(p, other) for other in listed)
        ]
        bad += [
            f"{p} lies in {o}" for p in listed for o in listed if p != o and truth.lies_in(p, o)
        ]
    proof, is_feasible = find_infeasibility(problem), truth.is_linearly_feasible()
    if proof is not None and (is_feasible or not proof.verify()):
        bad.append("false INFEASIBLE")
    return bad


def wrong_with(truth: Enumeration, s: Solution, is_listed: bool) -> list[str]:
    bad = []
    if not truth.satisfies(s.pattern, s.exact_z):
        bad.append(f"{s} does not solve the problem")
    if any(Fraction(float(v)) != Fraction(float(e)) for v, e in zip(s.z, s.exact_z, strict=True)):
        bad.append(f"{s} is rounded wrongly")
    if is_listed and truth.is_a_point(s.pattern, s.exact_z) != s.is_isolated:
        bad.append(f"{s}: wrong flag")
    return bad
