"""Verdicts on thousands of random matrices against truth by construction, and against exact rational arithmetic.

Truth by construction: with v > 0 and d_i = (|B|v)_i/(ρ v_i) the spectral radius of D⁻¹|B| is ρ up to some ulps.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import scipy.sparse as sp
from oracles.exact import has_positive_pivots, principal_minors

from lcp_plugin.proofs.verdicts import MatrixReport, analyze

EXACT_UP_TO = 6
DECIDED_FROM = 1e-10


@dataclass
class Case:
    """A matrix, whether it is an H-matrix (None: exact arithmetic says), and its distance to singular."""

    kind: str
    M: np.ndarray
    is_h: bool | None
    distance: float


def offdiagonal(rng: np.random.Generator, n: int, density: float) -> np.ndarray:
    """Return nonnegative entries beside the diagonal of an irreducible matrix: a random pattern and a cycle."""
    B = rng.uniform(0.1, 1.0, (n, n)) * (rng.random((n, n)) < density)
    order = rng.permutation(n)
    B[order, np.roll(order, 1)] = rng.uniform(0.1, 1.0, n)
    np.fill_diagonal(B, 0.0)
    return B


def with_radius(rng: np.random.Generator, B: np.ndarray, radius: float) -> np.ndarray:
    """Return a matrix of random signs with magnitudes B and ρ(D⁻¹B) = radius."""
    n = len(B)
    v = 10.0 ** rng.uniform(-2, 2, n)
    d = (B @ v) / (v * radius) if n > 1 else np.ones(1)
    return B * rng.choice([-1.0, 1.0], B.shape) + np.diag(d)


def draw_radius(rng: np.random.Generator, near: bool) -> float:
    """Return ρ on either side of 1; near: at a distance down to 1e-12."""
    if near:
        return 1.0 + float(rng.choice([-1.0, 1.0])) * 10.0 ** rng.uniform(-12, -4)
    return float(rng.choice([rng.uniform(0.1, 0.95), rng.uniform(1.05, 4.0)]))


def draw(rng: np.random.Generator, kind: str) -> Case:
    """Return a random case of that kind."""
    n = int(rng.integers(2, EXACT_UP_TO + 1)) if rng.random() < 0.5 else int(rng.integers(7, 41))
    radius = draw_radius(
        rng,
        near=kind == "near singular" or (kind in ("reducible", "scaled") and rng.random() < 0.3),
    )
    if kind == "H₊":
        radius = float(rng.uniform(0.1, 0.999))
    B = offdiagonal(rng, n, float(rng.uniform(0.1, 1.0)))
    M = with_radius(rng, B, radius)
    if kind == "wrong sign":
        flipped = rng.random(n) < 0.3
        flipped[rng.integers(n)] = True
        M[np.diag_indices(n)] *= np.where(flipped, -1.0, 1.0)
    elif kind == "reducible":
        M, radius = reducible(rng, radius)
    elif kind == "scaled":
        M = 10.0 ** rng.uniform(-100, 100, (n, 1)) * M * 10.0 ** rng.uniform(-100, 100, n)
    elif kind == "symmetric":
        return Case(kind, symmetric(rng, n), None, 0.0)
    elif kind == "extreme":
        return Case(kind, extreme(rng), None, 0.0)
    elif kind == "integer":
        n = min(n, EXACT_UP_TO)
        M = rng.integers(-3, 4, (n, n)).astype(float)
        M[np.diag_indices(n)] = rng.integers(0 if rng.random() < 0.2 else 2, 9, n)
        if rng.random() < 0.5:
            M = np.tril(M) + np.tril(M, -1).T
        return Case(kind, M, None, 0.0)
    return Case(kind, M, radius < 1.0, abs(1.0 - radius))


def reducible(rng: np.random.Generator, radius: float) -> tuple[np.ndarray, float]:
    """Return a permuted block triangular matrix of 2 to 4 blocks and its radius: that of one, others smaller."""
    sizes = rng.integers(1, 9, rng.integers(2, 5))
    n = int(sizes.sum())
    M, worst, start = np.zeros((n, n)), int(rng.integers(sizes.size)), 0
    if sizes[worst] == 1:
        sizes[worst] = 2
        n += 1
        M = np.zeros((n, n))
    for k, size in enumerate(sizes):
        own = radius if k == worst else min(radius, float(rng.uniform(0.1, 0.99)))
        block = slice(start, start + size)
        M[block, block] = (
            with_radius(rng, offdiagonal(rng, int(size), 0.7), own)
            if size > 1
            else rng.uniform(0.5, 2)
        )
        M[block, :start] = (
            rng.normal(size=(size, start)) * 10.0 ** rng.uniform(-3, 5) * (rng.random() < 0.8)
        )
        start += int(size)
    order = rng.permutation(n)
    return M[np.ix_(order, order)], radius


def symmetric(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a symmetric matrix with a smallest eigenvalue of either sign, or zero up to rounding, in random units."""
    n = min(n, EXACT_UP_TO)
    basis, _ = np.linalg.qr(rng.normal(size=(n, n)))
    values = np.r_[
        10.0 ** rng.uniform(-3, 0, n - 1),
        rng.choice([-1.0, 0.0, 1.0]) * 10.0 ** rng.uniform(-13, 0),
    ]
    S = (basis * values) @ basis.T
    units = 10.0 ** rng.uniform(-3, 3, n)
    S = units[:, None] * S * units
    return np.tril(S) + np.tril(S, -1).T


def extreme(rng: np.random.Generator) -> np.ndarray:
    """Return a small matrix with entries from both ends of the range of doubles."""
    n = int(rng.integers(1, 5))
    ends = [
        0,
        1,
        2,
        -1,
        -2,
        5e-324,
        1e-310,
        1.7e308,
        -1.7e308,
        1e300,
        1e-300,
        -1e-300,
        1e-160,
        1e160,
    ]
    M = rng.choice(ends, (n, n)).astype(float)
    if rng.random() < 0.7:
        M[np.diag_indices(n)] = np.abs(np.diag(M)) + (np.diag(M) == 0.0)
    return np.tril(M) + np.tril(M, -1).T if rng.random() < 0.4 else M


KINDS = (
    "H₊",
    "wrong sign",
    "near singular",
    "reducible",
    "scaled",
    "symmetric",
    "integer",
    "extreme",
)


def exact_truth(M: np.ndarray) -> dict[str, bool]:
    """Return the verdicts by rational arithmetic."""
    n = len(M)
    A = [[Fraction(float(entry)) for entry in row] for row in M]
    compared = [[abs(A[i][j]) * (1 if i == j else -1) for j in range(n)] for i in range(n)]
    doubled = [[A[i][j] + A[j][i] for j in range(n)] for i in range(n)]
    excess = [sum(row) for row in compared]
    is_h = has_positive_pivots(compared)
    positive = all(A[i][i] > 0 for i in range(n))
    is_z = all(A[i][j] <= 0 for i in range(n) for j in range(n) if i != j)
    return {
        "is_symmetric": all(A[i][j] == A[j][i] for i in range(n) for j in range(n)),
        "is_z_matrix": is_z,
        "is_m_matrix": is_z and is_h and positive,
        "is_strictly_dominant": all(e > 0 for e in excess),
        "is_h_matrix": is_h,
        "is_h_plus": is_h and positive,
        "is_positive_definite": has_positive_pivots(doubled),
        "is_positive_semidefinite": is_semidefinite(doubled),
        "is_p_matrix": all(minor > 0 for minor in principal_minors(A)),
    }


def is_semidefinite(A: list[list[Fraction]]) -> bool:
    """Return whether a symmetric matrix is semidefinite: a zero pivot has zeros beside it."""
    A = [row[:] for row in A]
    for k in range(len(A)):
        if A[k][k] < 0 or (A[k][k] == 0 and any(A[k][j] for j in range(k, len(A)))):
            return False
        for i in range(k + 1, len(A)):
            if A[k][k]:
                factor = A[i][k] / A[k][k]
                A[i] = [a - factor * b for a, b in zip(A[i], A[k], strict=True)]
    return True


def proofs_hold(report: MatrixReport, M: np.ndarray) -> bool:
    """Return whether ⟨M⟩v ≥ margin > 0 and ⟨M⟩y ≤ 0 hold in rational arithmetic."""
    compared = np.where(np.eye(len(M), dtype=bool), np.abs(M), -np.abs(M))
    rows = [[(j, Fraction(float(row[j]))) for j in np.flatnonzero(row)] for row in compared]
    if report.v is not None:
        v = [Fraction(float(entry)) for entry in report.v]
        for row, bound in zip(rows, report.margin, strict=True):
            if not 0 < Fraction(float(bound)) <= sum(entry * v[j] for j, entry in row):
                return False
    if report.not_h_vector is not None:
        y = [Fraction(float(entry)) for entry in report.not_h_vector]
        return (
            any(y)
            and min(y) >= 0
            and all(sum(entry * y[j] for j, entry in row) <= 0 for row in rows)
        )
    return True


def check(case: Case) -> list[str]:
    """Return what is wrong in the verdicts on a case, and what is undecided far from singular."""
    report = analyze(sp.csr_array(case.M) if len(case.M) % 2 else case.M)
    wrong, truth = [], {"is_h_matrix": case.is_h}
    if len(case.M) <= EXACT_UP_TO:
        truth = exact_truth(case.M)
        if case.is_h is not None and truth["is_h_matrix"] != case.is_h:
            wrong.append(f"{case.kind}: the construction is wrong, distance {case.distance:.1e}")
    for name, right in truth.items():
        value = getattr(report, name)
        is_far = name == "is_h_matrix" and case.distance >= DECIDED_FROM
        if value != right and (value is not None or is_far):
            what = "undecided" if value is None else "wrong"
            wrong.append(
                f"{case.kind} n={len(case.M)} {name}: {what} {value}, |1−ρ| = {case.distance:.1e}"
            )
    if not proofs_hold(report, case.M):
        wrong.append(f"{case.kind} n={len(case.M)}: a proof does not hold")
    return wrong
