"""Convergence guarantees against actual runs: random matrices, problems with a planted answer, every family and sweep.

A rate must be respected by every step: ‖z_{k+1} − z*‖_v ≤ c ‖z_k − z*‖_v up to rounding (a modulus method:
‖z_k − z*‖_v ≤ cᵏ ‖x_0 − x*‖_v), its contraction bound must hold, a guaranteed iteration must converge, and a
matrix that is no H₊-matrix must get no rate.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, convergence_guarantee, solve
from lcp_plugin.algorithms import Algorithm, create

STEPS = 12
ROUNDING = 1e-11
FAMILIES = ("np", "splitting", "relaxation", "modulus")
MATRICES = ("H₊", "H₊", "H₊", "nearly H₊", "not H₊", "SPD")


class Outcome(NamedTuple):
    """What happened in one case: a label for the summary, and what was violated."""

    label: str
    violations: list[str]


def random_matrix(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Return a matrix of 1 to 12 rows: ρ(D⁻¹|B|) below or above 1 by construction, or symmetric positive definite."""
    n = int(rng.integers(1, 13))
    if kind == "SPD":
        B = rng.normal(size=(n, n))
        unit = np.exp2(rng.integers(-3, 4, size=n))
        return unit[:, None] * (B @ B.T + 0.1 * np.eye(n)) * unit
    B = abs(rng.normal(size=(n, n))) * (rng.random((n, n)) < rng.choice([0.3, 0.6, 1.0]))
    B[np.arange(n), np.roll(np.arange(n), 1)] = 1.0
    np.fill_diagonal(B, 0.0)
    radius = {
        "H₊": rng.uniform(0.05, 0.95),
        "nearly H₊": rng.uniform(0.95, 0.9999),
        "not H₊": rng.uniform(1.01, 3.0),
    }
    v = np.exp(rng.choice([0.0, 0.5, 2.0]) * rng.normal(size=n))
    d = (B @ v) / (v * radius[kind]) if n > 1 else np.ones(1)
    M = (B * rng.choice([-1.0, 1.0], B.shape) if rng.random() < 0.6 else -B) + np.diag(d)
    rows = rng.choice(
        [np.ones(n), np.exp2(rng.integers(-4, 5, size=n)), 1.0 / d, rng.uniform(0.2, 2.2, n) / d]
    )
    return np.asarray(rows)[:, None] * M


def planted(rng: np.random.Generator, M: np.ndarray, *, plain: bool) -> tuple[LCP, np.ndarray]:
    """Return (problem, z*): active, inactive and degenerate rows; unless plain, boxes, one-sided and free rows."""
    n = M.shape[0]
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if not plain:
        kind = rng.integers(0, 6, size=n)  # plain, above, below, boxed, free, fixed
        low, width = rng.normal(size=n), rng.exponential(size=n)
        lower = np.choose(kind, [lower, low, np.full(n, -np.inf), low, np.full(n, -np.inf), low])
        upper = np.choose(kind, [upper, upper, low + width, low + width, upper, low])
    z = np.clip(rng.normal(size=n) * 10.0 ** rng.uniform(-3, 1, size=n), lower, upper)
    at_lower = np.isfinite(lower) & (rng.random(n) < 0.4)
    z = np.where(at_lower, lower, z)
    w = (
        rng.exponential(size=n)
        * 10.0 ** rng.uniform(-3, 1, size=n)
        * np.diag(M)
        * (rng.random(n) < 0.8)
    )
    w = np.where(z == lower, abs(w), np.where(z == upper, -abs(w), 0.0))
    return LCP(sp.csr_array(M), w - M @ z, lower=lower, upper=upper), z


def random_algorithm(rng: np.random.Generator, family: str, n: int) -> Algorithm:
    """Return an algorithm of the family with options in and beyond the range of its theorems."""
    sweep = str(rng.choice(["forward", "backward", "symmetric"]))
    alpha = float(rng.choice([0.3, 0.7, 1.0, 1.0, 1.2, 1.7, 2.5, 10.0]))
    beta = alpha * float(rng.choice([-0.5, 0.0, 0.5, 1.0, 1.0, 1.0, 1.7]))
    if family == "relaxation":
        omega = float(rng.uniform(0.1, 1.99))
        name = str(rng.choice(["pj", "pgs", "psor", "psor", "paor", "paor", "gfp"]))
        options = {"psor": {"relaxation": omega}, "gfp": {"relaxation": omega * 1.1}}
        options["paor"] = {
            "relaxation": omega * 1.1,
            "acceleration": omega * float(rng.uniform(-0.2, 1.3)),
        }
        return create(name, {"sweep": sweep, **options.get(name, {})})
    if family == "modulus":
        Omega = (
            float(rng.uniform(0.3, 3.0)) if rng.random() < 0.6 else rng.uniform(0.1, 4.0, size=n)
        )
        alpha = min(alpha, 1.9)
        return create(
            "maor",
            {"relaxation": alpha, "acceleration": beta * 0.7, "omega": Omega, "sweep": sweep},
        )
    scaling = {
        "scaling": rng.choice([None, "auto", "diagonal"]),
        "momentum": rng.choice([None, "auto"]),
    }
    if scaling["scaling"] == "diagonal":
        scaling["scaling_factor"] = float(rng.choice([0.3, 1.0, 1.5, 2.5]))
    if family == "splitting":
        inner = str(rng.choice(["diagonal", "tridiagonal", "lower"]))
        return create("npsplitting", {"splitting": inner, **scaling})
    return create("npaor", {"relaxation": alpha, "acceleration": beta, "sweep": sweep, **scaling})


def weighted(x: np.ndarray, v: np.ndarray) -> float:
    return float(np.max(abs(x) / v))


def rate_violations(
    rng: np.random.Generator, problem: LCP, exact: np.ndarray, algorithm: Algorithm
) -> list[str]:
    """Return in which steps of a run, from a start that is far in every row, rate or bound fails."""
    guarantee = convergence_guarantee(problem, algorithm)
    v, rate = guarantee.v, guarantee.rate
    assert v is not None
    assert rate is not None
    far = (
        10.0 ** rng.uniform(-2, 1)
        * v
        * rng.choice([-1.0, 1.0], size=v.size)
        * rng.uniform(0.9, 1.0, size=v.size)
    )
    start = np.clip(exact + far, problem.lower, problem.upper)
    path = [step.z.copy() for step in islice(algorithm.iterates(problem, start.copy()), STEPS + 1)]
    # What rounding q = w* − M z* and the steps may do.
    unit = weighted(
        abs(exact)
        + abs(start)
        + (abs(problem.csr) @ abs(exact) + abs(problem.q)) / problem.diagonal,
        v,
    )
    noise = ROUNDING * unit / (1.0 - rate)
    found = []
    if guarantee.speaks_of == "x":
        Omega = algorithm.facts(problem).omega
        x_start = start - problem.lower
        x_exact = exact - problem.lower - problem.slack(exact) / Omega
        first = weighted(x_start - x_exact, v)
        found += [
            f"step {k}: modulus error above cᵏ"
            for k, z in enumerate(path)
            if k and weighted(z - exact, v) > rate**k * first + noise
        ]
        return found
    for k, (old, new) in enumerate(pairwise(path)):
        if weighted(new - exact, v) > rate * weighted(old - exact, v) + noise:
            found.append(
                f"step {k + 1}: {weighted(new - exact, v):.3e} > {rate} · {weighted(old - exact, v):.3e}"
            )
        if weighted(new - exact, v) > rate / (1.0 - rate) * weighted(new - old, v) + noise:
            found.append(f"step {k + 1}: contraction bound violated")
    return found


def converged(problem: LCP, algorithm: Algorithm, exact: np.ndarray) -> bool:
    """Return whether a run ends at z*; where z° is z* up to rounding, no residual can tell, but the error does."""
    result = solve(problem, algorithm, z0=exact + 1.0, max_iterations=50_000)
    return result.is_solved or float(np.max(abs(result.z - exact))) <= 1e-7 * (
        1.0 + float(np.max(abs(exact)))
    )


def run_case(rng: np.random.Generator) -> Outcome:
    """Draw matrix, problem and algorithm; return the verdict and everything that contradicts it."""
    kind, family = str(rng.choice(MATRICES)), str(rng.choice(FAMILIES))
    M = random_matrix(rng, kind)
    problem, exact = planted(rng, M, plain=family == "modulus")
    algorithm = random_algorithm(rng, family, problem.n)
    if family == "splitting" and rng.random() < 0.4:
        algorithm = replace(algorithm, splitting=np.tril(M) + 0.1 * rng.normal(size=M.shape))
    try:
        guarantee = convergence_guarantee(problem, algorithm)
    except ValueError as error:
        return Outcome(f"{family}: {type(error).__name__}", [])
    found = []
    if guarantee.rate is not None:
        found += rate_violations(rng, problem, exact, algorithm)
        if kind == "not H₊" and problem.n > 1 and family != "splitting":
            found.append("a rate, though M is no H₊-matrix")
    if (
        guarantee.is_guaranteed
        and (guarantee.rate is None or guarantee.rate < 0.999)
        and rng.random() < 0.3
    ):
        found += (
            []
            if converged(problem, algorithm, exact)
            else ["guaranteed, but the run did not converge"]
        )
    rated = " with rate" if guarantee.rate is not None else ""
    return Outcome(
        f"{family}: {guarantee.verdict}{rated}", [f"{kind} {algorithm}: {text}" for text in found]
    )
