"""Error bounds against exact rational arithmetic: random H₊ and definite problems, n ≤ 6, boxes and free rows too.

Counts bounds that are violated and rows that are classified wrongly (both compared as fractions, none allowed), and
prints the median of bound/error by ρ(D⁻¹|B|) and by how near z is to the solution. One case in ten more has a matrix
with a positive definite symmetric part instead, symmetric or not.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from oracles.exact import Exact, exact_solution

from lcp_plugin import LCP, UnsuitableMatrix
from lcp_plugin.proofs.bounds import ErrorBound, error_bound

RADII = (0.5, 0.9, 0.99, 0.999)
DEFINITE = "SPD"
CLASSES = (*RADII, DEFINITE)


def random_matrix(generator: np.random.Generator, radius: float) -> np.ndarray:
    """Return an H₊-matrix with ρ(D⁻¹|B|) = radius up to rounding, random signs, rows and columns scaled."""
    n = int(generator.integers(2, 7))
    while True:
        B = generator.standard_normal((n, n)) * (
            generator.random((n, n)) < generator.choice([0.4, 0.7, 1.0])
        )
        np.fill_diagonal(B, 0.0)
        largest = max(abs(np.linalg.eigvals(abs(B))))
        if largest > 1e-6:
            break
    spread = generator.choice([0.0, 1.0, 8.0])
    rows, columns = 10.0 ** generator.uniform(-spread, spread, size=(2, n))
    return rows[:, None] * (np.eye(n) + radius / largest * B) * columns


def random_definite(generator: np.random.Generator) -> np.ndarray:
    """Return a matrix with a positive definite symmetric part, every other one symmetric, in random units."""
    n = int(generator.integers(2, 7))
    B = generator.standard_normal((n, n))
    M = B @ B.T + 10.0 ** -generator.uniform(0, 6) * np.eye(n)
    skew = np.triu(generator.standard_normal((n, n)), 1) * (generator.random() < 0.5)
    unit = 10.0 ** (generator.choice([0.0, 4.0]) * generator.uniform(-1, 1, size=n))
    return unit[:, None] * (np.tril(M) + np.tril(M, -1).T + skew - skew.T) * unit


def random_problem(generator: np.random.Generator, kind: float | str) -> LCP:
    """Return a problem whose solution mixes active, inactive and degenerate rows; bounds in two of three cases."""
    M = random_definite(generator) if isinstance(kind, str) else random_matrix(generator, kind)
    n = M.shape[0]
    unit = 1.0 / np.sqrt(abs(M).max(axis=0))
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if generator.random() < 2 / 3:
        kind = generator.integers(0, 6, size=n)  # plain, one-sided below, above, boxed, free, fixed
        low, width = generator.standard_normal(n) * unit, generator.exponential(size=n) * unit
        lower = np.choose(kind, [lower, low, np.full(n, -np.inf), low, np.full(n, -np.inf), low])
        upper = np.choose(kind, [upper, upper, low + width, low + width, upper, low])
    z = np.clip(generator.standard_normal(n) * unit, lower, upper)
    ends = np.where(np.isfinite(upper) & (generator.random(n) < 0.5), upper, lower)
    z = np.where(np.isfinite(ends) & (generator.random(n) < 0.5), ends, z)
    w = np.where(z == lower, 1.0, np.where(z == upper, -1.0, 0.0)) * generator.exponential(size=n)
    w *= (generator.random(n) < 0.85) * np.diag(M) * unit
    return LCP(M, w - M @ z, lower=lower, upper=upper)


def points(
    generator: np.random.Generator, problem: LCP, exact: Exact
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield approximations of the solution by quality; some leave the bounds, some keep the active rows exact."""
    z = np.array([float(value) for value in exact.z])
    size = np.maximum(np.abs(z), generator.choice([0.0, 1.0]) * np.abs(z).max())
    active = (z == problem.lower) | (z == problem.upper)
    keep = active & (generator.random() < 0.5)
    noise = np.where(keep, 0.0, generator.standard_normal(z.size) * (size if size.any() else 1.0))
    yield "far", z + 10.0 * noise
    yield "1e-3", z + 1e-3 * noise
    yield "1e-8", z + 1e-8 * noise
    toward = np.where(generator.random(z.size) < 0.5, np.inf, -np.inf)
    yield "last bit", np.where(keep | (generator.random(z.size) < 0.3), z, np.nextafter(z, toward))


def violations(problem: LCP, z: np.ndarray, exact: Exact, bound: ErrorBound) -> tuple[int, int]:
    """Return how many rows violate the bound and how many are classified wrongly."""
    outside = wrong = 0
    for i, (truth, slack) in enumerate(zip(exact.z, exact.w, strict=True)):
        limit = bound.componentwise[i]
        outside += bool(np.isfinite(limit)) and abs(Fraction(float(z[i])) - truth) > Fraction(
            float(limit)
        )
        ends = [
            Fraction(float(end)) for end in (problem.lower[i], problem.upper[i]) if np.isfinite(end)
        ]
        wrong += bool(bound.proven_active[i]) and truth not in ends
        wrong += bool(bound.proven_inactive[i]) and (truth in ends or slack != 0)
    with np.errstate(over="ignore"):  # beside a z near the largest double
        others = (z, np.zeros_like(z), 1.0 - 3.0 * z)
    for other in others:
        limits = zip(other, exact.z, bound.carried_to(other), strict=True)
        outside += sum(
            bool(np.isfinite(y)) and abs(Fraction(float(a)) - b) > Fraction(float(y))
            for a, b, y in limits
        )
    error = max(abs(Fraction(float(a)) - b) for a, b in zip(z, exact.z, strict=True))
    size = Fraction(float(np.abs(z).max()))
    if np.isfinite(bound.relative):
        outside += error > Fraction(bound.relative) * size
    return outside + (np.isfinite(bound.infinity) and error > Fraction(bound.infinity)), wrong


def judged(kind: float | str, rng: np.random.Generator) -> list[tuple[int, int] | None]:
    """Return violations of the bounds, sharp and not, of several points of one problem; None if a bound is refused."""
    problem = random_problem(rng, kind)
    exact = exact_solution(problem)
    found: list[tuple[int, int] | None] = []
    for _, z in points(rng, problem, exact):
        for sharp in (True, False):
            try:
                bound = error_bound(problem, z, sharp=sharp)
            except UnsuitableMatrix:
                found.append(None)
            else:
                found.append(violations(problem, z, exact, bound))
    return found
