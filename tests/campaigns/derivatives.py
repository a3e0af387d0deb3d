"""Derivatives of random small problems compared with rational arithmetic.

The active set of each problem is drawn beforehand, and rational arithmetic decides whether it belongs to the exact
solution. In this case jvp (by M, q and the bounds) and vjp (to M, q and the bounds, from z and w) must equal the
exact products to 1e-12 κ(M_FF) relative. ⟨vjp(g), h⟩ must be ⟨g, jvp(h)⟩ to 1e-13 of its terms, times κ(M_FF) if
that is above 100.

Degenerate problems have short numbers, so that they are exactly degenerate. `is_unique` must not be True,
`degenerate` must be the degenerate rows, jvp the exact one-sided derivative, and vjp the gradient of the piece of
`free`. The exit code is 0 only if no other fault was found and `is_unique` is True for 90 % of the nondegenerate
problems with H₊-matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse as sp
from exact import FREE, LOWER, UPPER
from exact_derivatives import Change, ExactGradient, Piece, distance, piece_at

from lcp_plugin import LCP, derivative, solve
from lcp_plugin.problems.sensitivity import Derivative

Generator = np.random.Generator
ACCURACY, ADJOINT, WELL_CONDITIONED = 1e-12, 1e-13, 100.0
EPSILON = 2.0**-52
SHARE = 0.9
COARSE = 1e-3  # a z from which steps of the active-set method may cycle; then nothing is proven
SECONDS = 20.0
KINDS = ("plain", "box", "mixed")


def h_plus(n: int, rng: Generator) -> np.ndarray:
    """Dominant after a scaling of columns, signs arbitrary, half of the entries zero."""
    M = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5)
    np.fill_diagonal(M, 0.0)
    np.fill_diagonal(M, abs(M).sum(axis=1) * rng.uniform(1.01, 2.0, n) + 0.1)
    return M * 2.0 ** rng.integers(-3, 4, n)


def definite(n: int, rng: Generator, digits: float = 3.0) -> np.ndarray:
    """Symmetric positive definite."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    M = (Q * np.geomspace(1.0, 10.0**-digits, n)) @ Q.T
    return 0.5 * (M + M.T)


def p_matrix(n: int, rng: Generator) -> np.ndarray:
    """Return a P-matrix: a permuted triangle, or a cycle of odd length."""
    if n % 2:
        return np.eye(n) + rng.uniform(0.5, 3.0) * np.roll(np.eye(n), -1, axis=0)
    order, M = rng.permutation(n), np.triu(2.0 * rng.normal(size=(n, n)), 1)
    return (M + np.diag(rng.uniform(0.5, 2.0, n)))[np.ix_(order, order)]


def nonsymmetric(n: int, rng: Generator) -> np.ndarray:
    """Positive definite symmetric part, and a skew one as large."""
    K = rng.normal(size=(n, n))
    return definite(n, rng, 1.0) + 0.5 * (K - K.T)


def ill_conditioned(n: int, rng: Generator) -> np.ndarray:
    """Symmetric positive definite, condition 1e4 … 1e10."""
    return definite(n, rng, rng.uniform(4.0, 10.0))


def scaled(n: int, rng: Generator) -> np.ndarray:
    """Return an H₊-matrix with random scaling of rows and columns."""
    return h_plus(n, rng) * 10.0 ** rng.integers(-6, 7, n)[:, None] * 10.0 ** rng.integers(-6, 7, n)


def chain(n: int, rng: Generator) -> np.ndarray:
    """A tridiagonal M-matrix."""
    upper, lower = -rng.random((2, n - 1))
    return np.diag(rng.uniform(2.0, 3.0, n)) + np.diag(upper, 1) + np.diag(lower, -1)


def nearly_degenerate(n: int, rng: Generator) -> np.ndarray:
    """Any of these; `drawn` makes slacks of it as small as rounding, or smaller."""
    kinds = (h_plus, definite, nonsymmetric, scaled, chain)
    return kinds[rng.integers(len(kinds))](n, rng)


FAMILIES: dict[str, Callable[[int, Generator], np.ndarray]] = {
    one.__name__: one
    for one in (
        h_plus,
        definite,
        p_matrix,
        nonsymmetric,
        ill_conditioned,
        scaled,
        chain,
        nearly_degenerate,
    )
}


def rows(
    kind: str, states: np.ndarray, z: np.ndarray, rng: Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds that give each row of z its state; −1, 0, 1 as in `exact`."""
    n = states.size
    away = rng.integers(1, 5, (2, n)).astype(float)
    lower = np.where(states == LOWER, z, z - away[0])
    upper = np.where(states == UPPER, z, z + away[1])
    if kind == "plain":
        return lower, np.full(n, np.inf)
    if kind == "mixed":
        open_end = rng.random(n)
        lower = np.where((open_end < 0.5) & (states != LOWER), -np.inf, lower)
        upper = np.where((open_end > 0.25) & (open_end < 0.75) & (states != UPPER), np.inf, upper)
        is_fixed = (states != FREE) & (rng.random(n) < 0.2)
        lower, upper = np.where(is_fixed, z, lower), np.where(is_fixed, z, upper)
    return lower, upper


def drawn_states(kind: str, n: int, rng: Generator) -> np.ndarray:
    """Return the state of each row."""
    return rng.choice([LOWER, FREE] if kind == "plain" else [LOWER, FREE, FREE, UPPER], n)


def delivered(M: np.ndarray, rng: Generator) -> object:
    """Return M dense or sparse."""
    return M if rng.random() < 0.5 else sp.csr_array(M)


def drawn(family: str, kind: str, largest: int, rng: Generator) -> LCP:
    """Return a problem whose solution was drawn, up to the rounding error of q."""
    n = int(rng.integers(2, largest + 1))
    M, states = FAMILIES[family](n, rng), drawn_states(kind, n, rng)
    z = rng.normal(size=n)
    w = -states * (0.1 + rng.random(n)) * abs(M).max(axis=1)
    if family == "nearly_degenerate":
        w *= 10.0 ** -rng.choice([0.0, 8.0, 12.0, 14.0, 15.0, 16.0, 18.0, 30.0], size=n)
    if kind == "plain":
        z = np.where(states == LOWER, 0.0, abs(z))
    if family == "scaled":
        z = z / abs(M).max(axis=0)
    lower, upper = rows(kind, states, z, rng)
    if kind == "plain":
        lower = np.zeros(n)
    return LCP(delivered(M, rng), w - M @ z, lower=lower, upper=upper)


def degenerate(kind: str, largest: int, rng: Generator) -> tuple[LCP, np.ndarray, np.ndarray]:
    """Return a problem of integers, its solution and the degenerate rows."""
    n = int(rng.integers(2, largest + 1))
    M = rng.integers(-3, 4, (n, n)).astype(float)
    if rng.random() < 0.5:
        M = M @ M.T + np.diag(rng.integers(1, 4, n))
    else:
        np.fill_diagonal(M, 0.0)
        np.fill_diagonal(M, abs(M).sum(axis=1) + rng.integers(1, 4, n))
    states, z = drawn_states(kind, n, rng), rng.integers(-3, 4, n).astype(float)
    if kind == "plain":
        z = np.where(states == LOWER, 0.0, abs(z) + 1.0)
    lower, upper = rows(kind, states, z, rng)
    lower = np.zeros(n) if kind == "plain" else lower
    if not ((states != FREE) & (lower != upper)).any():
        return degenerate(kind, largest, rng)
    held = np.flatnonzero((states != FREE) & (lower != upper))
    planted = np.sort(rng.permutation(held)[: rng.integers(1, 4)])
    w = -states * rng.integers(1, 5, n).astype(float)
    w[planted] = 0.0
    return LCP(delivered(M, rng), w - M @ z, lower=lower, upper=upper), z, planted


class Judged:
    """Errors of the derivative of one problem."""

    def __init__(self, found: Derivative, piece: Piece, rng: Generator) -> None:
        self.found, self.piece, self.wrong = found, piece, list[str]()
        n, M, F = piece.problem.n, piece.problem.csr.toarray(), piece.free
        self.condition = float(np.linalg.cond(M[np.ix_(F, F)], np.inf)) if F else 1.0
        self.change, self.g, self.gw = Change.drawn(n, rng), *rng.normal(size=(2, n))
        self.gradient = found.vjp(self.g, self.gw)

    def near(self, what: str, found: object, true: object) -> None:
        """Note what is not within 1e-12 κ of the exact one."""
        error = distance(found, true)
        if not error <= ACCURACY * max(self.condition, 1.0):
            self.wrong.append(f"{what.upper()} off by {error:.1e}, condition {self.condition:.1e}")

    def pushes_forward(self, true: list) -> None:
        """Judge jvp in all data at once."""
        self.near("jvp", self.found.jvp(**self.change.arguments), true)

    def pulls_back(self, true: ExactGradient) -> None:
        """Judge vjp to all data."""
        found = self.gradient
        self.near("vjp to q", found.q, true.q)
        self.near("vjp to the bounds", np.r_[found.lower, found.upper], true.lower + true.upper)
        pattern = self.piece.problem.csr.tocoo()
        by_entry = [true.M[i][j] for i, j in zip(pattern.row, pattern.col, strict=True)]
        self.near("vjp to M", found.M.data, by_entry)

    def is_adjoint(self) -> None:
        """Judge ⟨vjp(g, gw), h⟩ = ⟨g, dz⟩ + ⟨gw, dw⟩ for a change h on M's pattern."""
        found, change, M = self.gradient, self.change, self.piece.problem.csr
        dM = M.copy()
        dM.data = np.random.default_rng(0).normal(size=dM.nnz)
        dz = self.found.jvp(dM=dM, dq=change.dq, dlower=change.dlower, dupper=change.dupper)
        dw = self.found.dw(dz, dM=dM, dq=change.dq)
        inner = np.r_[
            found.q * change.dq,
            found.lower * change.dlower,
            found.upper * change.dupper,
            found.M.data * dM.data,
            -self.g * dz,
            -self.gw * dw,
        ]
        parts = abs(inner).sum() + abs(self.gw) @ (
            abs(M) @ abs(dz) + abs(dM) @ abs(self.found.z) + abs(change.dq)
        )
        allowed = ADJOINT * max(1.0, self.condition / WELL_CONDITIONED)
        error = abs(inner.sum()) / parts
        if not error <= allowed:
            self.wrong.append(f"ADJOINT off by {error:.1e}, condition {self.condition:.1e}")


def judge_strict(
    family: str, kind: str, largest: int, rng: Generator
) -> Iterator[tuple[str, bool]]:
    """Yield (outcome, whether it is wrong) for one nondegenerate problem."""
    problem = drawn(family, kind, largest, rng)
    tolerance = rng.choice([1e-8, 1e-8, COARSE])
    result = solve(problem, tolerance=tolerance, max_seconds=SECONDS)
    if not result.is_solved:
        yield f"{result.status.name}", False
        return
    found = derivative(result)
    piece = piece_at(problem, found.z, found.free)
    yield f"is_unique {found.is_unique}", False
    if found.degenerate.size:
        return
    if not piece.is_strict:
        is_lost = tolerance == COARSE and found.is_unique is None
        yield (
            "not settled from a coarse z" if is_lost else "ROWS of no solution, or degenerate",
            not is_lost,
        )
        return
    judged = Judged(found, piece, rng)
    judged.near("z", found.z, piece.z)
    judged.pushes_forward(piece.jvp(judged.change))
    judged.pulls_back(piece.vjp(judged.g, judged.gw))
    judged.is_adjoint()
    yield from ((one, True) for one in judged.wrong)


def judge_degenerate(kind: str, largest: int, rng: Generator) -> Iterator[tuple[str, bool]]:
    """Yield (outcome, whether it is wrong) for one degenerate problem."""
    problem, z, planted = degenerate(kind, largest, rng)
    result = solve(problem, max_seconds=SECONDS)
    if not result.is_solved:
        yield f"{result.status.name}", True
        return
    found = derivative(result)
    yield (
        f"{planted.size} planted rows, is_unique {found.is_unique}",
        bool(found.is_unique and planted.size),
    )
    if not np.array_equal(found.degenerate, planted):
        yield f"DEGENERATE {found.degenerate} for {planted}", True
    piece = piece_at(problem, z, found.free)
    if not piece.is_solution or piece.degenerate != [i for i in planted if i not in piece.free]:
        yield "ROWS that are free of no piece that meets here", True
        return
    at = piece_at(problem, z, found.free & ~np.isin(np.arange(z.size), planted))
    judged = Judged(found, piece, rng)
    judged.pushes_forward(at.one_sided(judged.change))
    judged.pulls_back(piece.vjp(judged.g, judged.gw))
    yield from ((one, True) for one in judged.wrong)


def judge(arguments: tuple[int, int, int, bool]) -> list[tuple[str, str, str]]:
    """Return (family, what happened, where if it is wrong) of problem k."""
    seed, k, largest, is_planted = arguments
    rng = np.random.default_rng((seed, k, is_planted))
    kind, family = KINDS[k % 3], "planted" if is_planted else list(FAMILIES)[k // 3 % len(FAMILIES)]
    where = f"{family} {kind} --only {k}" + (" --planted" if is_planted else "")
    try:
        found = (
            judge_degenerate(kind, largest, rng)
            if is_planted
            else judge_strict(family, kind, largest, rng)
        )
        return [(family, what, where if is_wrong else "") for what, is_wrong in found]
    except Exception as error:  # a campaign counts all exceptions that a user would see
        return [(family, f"EXCEPTION {type(error).__name__}: {error}", where)]
