"""Problems that are infeasible or feasible by margins of 1e-16 … 1e-1.

The margin is known by construction: a Farkas vector y and a z̄ that attains its violation. Independent rational
arithmetic bounds the smallest residual of any z from below (by y) and from above (by z̄). The campaign checks these
claims at the default tolerance:

- auto proves 99 % of the margins of at least ten times the tolerance and the rounding error of q, and the proofs
  verify.
- No method calls a margin below the tolerance infeasible.
- No problem is SOLVED by one run and infeasible by another.
- No proof claims a larger margin than the residual of z̄, or of the z of any method.

Problems that z° solves up to the rounding error of their data are drawn again, because their reference is too
small.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from oracles.truth import ExactData, references_of_rows

from lcp_plugin import LCP, Status, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem

TOLERANCE = 1e-8  # of a run
PROVED = (Status.INFEASIBLE, Status.NO_SOLUTION)
DIRECT = ("newton", "interior_point", "lemke")
ALL_METHODS_EVERY = 10  # the others: auto in both measures, and a direct method in one
MOST_STEPS = 300  # of a named method


class Margin(NamedTuple):
    """Bounds of the smallest residual of any z, relative to the residual of z°; 0 if feasible."""

    low: float
    high: float


class Planted(NamedTuple):
    """A problem with its properties and its margin."""

    problem: LCP
    relative: Margin
    is_linear: bool  # the linear constraints are inconsistent, without complementarity
    is_data: bool  # the margin is more than rounding of the largest number in q


# --- complementarity problems ------------------------------------------------------------------------------------


def planted_lcp(rng: np.random.Generator) -> Planted:
    """Return a problem with known least residual: every w_i of y has the violation d_i t at z̄."""
    n = int(rng.integers(2, 9))
    is_whole = bool(rng.random() < 0.6)
    kinds = rng.choice(
        ["lower", "upper", "free", "box"], n, p=[0.55, 0.15, 0.15 * is_whole, 0.3 - 0.15 * is_whole]
    )
    pivot = int(rng.integers(n))
    kinds[pivot] = rng.choice(["lower", "upper"])
    start = rng.integers(-2, 3, n) * (rng.random(n) < 0.4)
    lower = np.where(np.isin(kinds, ["lower", "box"]), start, -np.inf)
    upper = np.where(
        kinds == "upper", start, np.where(kinds == "box", start + rng.integers(1, 4, n), np.inf)
    )
    y = np.where(
        rng.random(n) < 0.5, rng.integers(1, 4, n) if is_whole else rng.uniform(0.3, 3.0, n), 0.0
    )
    turned = np.where(kinds == "upper", -1, np.where(kinds == "free", rng.choice([-1, 1], n), 1))
    y = np.where(kinds == "box", 0.0, turned * y)
    y[pivot] = 1.0 if kinds[pivot] == "lower" else -1.0
    size = rng.integers(1, 3, n) if is_whole else rng.uniform(0.5, 2.0, n)
    is_slack = (rng.random(n) < 0.3) & is_whole
    product = np.where(is_slack | (kinds == "free"), 0.0, np.where(kinds == "upper", size, -size))
    at_top = (kinds == "box") & (rng.random(n) < 0.5)
    product = np.where(at_top, np.abs(product), product)
    z = np.where(
        at_top, upper, np.where(kinds == "upper", upper, np.where(kinds == "free", 1.0, lower))
    )
    z = z + is_slack * np.where(kinds == "lower", 2.0, np.where(kinds == "upper", -2.0, 0.0))
    M = (rng.integers(-3, 4, (n, n)) if is_whole else rng.standard_normal((n, n))) * (
        rng.random((n, n)) < 0.7
    )
    M = M + np.diag(rng.integers(1, 5, n) * (rng.random(n) < 0.6))
    M[pivot] = 0.0
    M[pivot] = y[pivot] * (product - y @ M)
    rows, columns = (
        2.0 ** rng.integers(-8, 9, n) if rng.random() < 0.3 else np.ones(n) for _ in range(2)
    )
    M, y = rows[:, None] * M * columns, y / rows
    lower, upper, z = lower / columns, upper / columns, z / columns
    scale = divisors(LCP(M, np.zeros(n)))
    ok = (
        rng.integers(0, 3, n)
        * np.where(kinds == "upper", -1.0, np.where(kinds == "free", 0.0, 1.0))
        * rows
    )
    sign = rng.choice([1.0, 1.0, 1.0, -1.0])  # −1: feasible by that margin

    def with_margin(t: float) -> LCP:
        w = np.where(y != 0.0, -np.sign(y) * scale * t * sign, ok)
        return LCP(M, w - M @ z, lower=lower, upper=upper)

    plain = with_margin(0.0)
    reference = float(max(references(plain)))
    if not reference:
        return planted_lcp(rng)
    problem = with_margin(10.0 ** rng.uniform(-16, -1) * reference)
    return measured(problem, y, z) if all(references(problem)) else planted_lcp(rng)


def measured(problem: LCP, y: Any, z: Any) -> Planted:
    """Return the exact margins that y and z̄ prove for the stored problem."""
    of_rows = references(problem)
    d = [Fraction(float(v)) for v in divisors(problem)]
    exact_y = [Fraction(float(v)) for v in y]
    missing = wrong_signs(
        problem, [Fraction(float(v)) for v in np.clip(z, problem.lower, problem.upper)]
    )
    c = max(contradiction(problem, exact_y), Fraction(0))
    weight = sum(abs(v) * s * of for v, s, of in zip(exact_y, d, of_rows, strict=True))
    absolute = c / sum(abs(v) * s for v, s in zip(exact_y, d, strict=True))
    high = max(v / s / of for v, s, of in zip(missing, d, of_rows, strict=True))
    return Planted(
        problem, Margin(float(c / weight), float(high)), True, is_data(problem, absolute)
    )


def divisors(problem: LCP) -> Any:
    """Return the divisors of w in the residual of the stopping criterion."""
    return problem.residual_scale


def is_data(problem: LCP, absolute: Fraction) -> bool:
    """Return whether a margin exceeds ten times the rounding error of the largest number in q."""
    return float(absolute) > 10.0 * 2.0**-44 * float(
        np.abs(problem.q / problem.residual_scale).max()
    )


def forced(rng: np.random.Generator) -> Planted:
    """w_a = 1 forces z_a = 0, where w_b = s (z_a − t) is negative: relative to the rest, by t/2 and no more."""
    n = int(rng.integers(1, 5))
    M, z = rng.integers(-1, 2, (n, n)) + 0.0, rng.integers(0, 3, n)
    M[np.arange(n), np.arange(n)] = np.abs(M).sum(axis=1) + 1.0
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n + 1] = M, rng.integers(-1, 2, n)
    whole[:n, n] = 1.0  # all is one component, if M is
    s = 2.0 ** rng.integers(-3, 4)
    whole[n + 1, n] = s
    t = 10.0 ** rng.uniform(-16, -1)
    q = np.concatenate([np.where(z > 0, 0.0, 1.0) - M @ z, [1.0, -s * t]])
    problem = LCP(whole, q)
    reference, absolute = references(problem)[-1], Fraction(-q[-1]) / Fraction(s) / 2
    margin = float(absolute / reference)
    return Planted(problem, Margin(margin, margin), False, is_data(problem, absolute))


def references(problem: LCP) -> list[Fraction]:
    """Return the exact reference of each row: the largest residual of z° in its component."""
    data = ExactData(problem)
    return references_of_rows(data.at_zero(), data.components)


def wrong_signs(problem: LCP, z: list[Fraction]) -> list[Fraction]:
    """Return the size of each w with a sign that the bounds of its row never permit."""
    w = ExactData(problem).slack(z)
    return [
        max(
            -value if np.isinf(high) else Fraction(0),
            value if np.isinf(low) else Fraction(0),
            Fraction(0),
        )
        for value, low, high in zip(w, problem.lower, problem.upper, strict=True)
    ]


def contradiction(problem: LCP, y: list[Fraction]) -> Fraction:
    """−sup of yᵀ(M z + q) over the bounds; −1 where that is infinite."""
    dense = problem.csr.toarray()
    total = sum((a * Fraction(b) for a, b in zip(y, problem.q.tolist(), strict=True)), Fraction(0))
    for j in range(problem.n):
        slope = sum(
            (a * Fraction(float(b)) for a, b in zip(y, dense[:, j], strict=True)), Fraction(0)
        )
        bound = float(problem.upper[j] if slope > 0 else problem.lower[j])
        if slope:
            if np.isinf(bound):
                return Fraction(-1)
            total += slope * Fraction(bound)
    return -total


# --- judging -----------------------------------------------------------------------------------------------------


def runs(case: Planted, number: int) -> Iterator[tuple[str, Any]]:
    """Run the methods."""
    few = ("auto", DIRECT[number // 2 % 3])
    for name in few if number % ALL_METHODS_EVERY else ("auto", *REGISTRY):
        try:
            yield (
                name,
                solve(case.problem, name, max_iterations=None if name == "auto" else MOST_STEPS),
            )
        except (UnsuitableMatrix, UnsuitableProblem):
            continue


def violations(case: Planted, number: int) -> tuple[list[str], Status]:
    """Return violations of the claims, and the status of auto; `number` selects further runs."""
    bad, told, margin = [], Status.STALLED, case.relative
    seen: set[Status] = set()
    reached, claimed = np.inf, 0.0
    for name, result in runs(case, number):
        seen.add(result.status)
        if name == "auto":
            told = result.status
        proof = result.infeasibility
        # z̄ meets the linear constraints only; a row of zeros is compared with its own q_i.
        is_bounded = (
            result.status is Status.INFEASIBLE or not case.is_linear
        ) and not rests_on_zeros(proof)
        if result.status in PROVED and is_bounded and margin.high <= TOLERANCE:
            bad.append(f"{name}: {result.status.name} at a margin of {margin.high:.3e}")
        if result.status in PROVED and not (proof.verify() and proof.excludes(TOLERANCE)):
            bad.append(f"{name}: {result.status.name} without a proof that counts")
        if proof is not None and is_bounded and proof.margin > margin.high * (1.0 + 1e-12):
            bad.append(f"{name}: margin {proof.margin:.3e} claimed of {margin.high:.3e}")
        reached = min(reached, result.residual)
        claimed = max(claimed, 0.0 if proof is None else proof.margin)
    if claimed > max(TOLERANCE, reached * (1.0 + 1e-6)):
        bad.append(f"a residual of {reached:.3e} where {claimed:.3e} is claimed to be the least")
    bad += ["SOLVED and infeasible"] * (Status.SOLVED in seen and bool(seen & set(PROVED)))
    return bad, told


def rests_on_zeros(proof: Any) -> bool:
    """Return whether a Farkas vector uses only rows of M without entries."""
    y = getattr(proof, "y", None)
    return y is not None and not np.diff(proof.problem.csr.indptr)[y != 0.0].any()


def one(seed: int, case: int) -> tuple[list[str], bool]:
    """Return the errors of a case, and whether auto left a clear contradiction of an LCP unproved."""
    rng = np.random.default_rng([seed, case])
    planted = forced(rng) if case % 12 == 0 else planted_lcp(rng)
    bad, told = violations(planted, case)
    is_clear = planted.is_data and planted.relative.low >= 10.0 * TOLERANCE
    return bad, is_clear and told not in PROVED
