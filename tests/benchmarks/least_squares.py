"""Bounded least squares compared with scipy on every kind of A, and with accelerated gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.core.checks import FloatVector
from lcp_plugin.problems.least_squares.solving import bounded_least_squares

from .rivals import SEED
from .timing import medians, rounds, timed

OVERHEAD = 60e-6  # seconds that a call may cost beside scipy's
ALLOWED = 2.0  # times scipy's seconds, and the overhead
LONG_ENOUGH = (
    0.003  # seconds, which shorter calls are repeated for: a slice that one process has for itself
)
UPPER = 0.5  # of boxes: about half the positive entries of the planted x exceed it
SOLVED = 1e-8  # optimality of a rival that counts
ROUNDS = 15
UNSCALED = 20_000  # places of A that a quick table leaves as they are
LONG = 1.0  # seconds; a rival that takes longer is timed once
SUBSPACE_UP_TO = 100  # columns up to which scipy's bvls is asked, which takes seconds beyond
SPARSE_AS_DENSE = 1000  # columns of a sparse A up to which scipy is asked, by dense methods as well
REFLECTIVE_UP_TO = 400  # the same for its trf on dense A
RIVAL_TOLERANCE = 1e-12


def planted(A: Any, seed: int = SEED) -> tuple[FloatVector, FloatVector]:
    """Return b and the x ≥ 0 that minimises ‖A x − b‖, A of full rank: half of it is 0, multipliers are in (0, 1)."""
    from scipy.sparse.linalg import lsmr

    rng = np.random.default_rng(seed)
    is_free = rng.random(A.shape[1]) < 0.5
    x = np.where(is_free, 0.1 + rng.random(is_free.size), 0.0)
    residual = lsmr(A.T, np.where(is_free, 0.0, rng.random(is_free.size)), atol=1e-15, btol=1e-15)[
        0
    ]
    return A @ x - residual, x


def random_rows(m: int, n: int, per_row: int = 10, seed: int = SEED) -> sp.csr_array:
    """Return a sparse A with so many entries in (0, 1) a row."""
    rng = np.random.default_rng(seed)
    rows = np.repeat(np.arange(m), per_row)
    return sp.csr_array(
        (rng.random(m * per_row), (rows, rng.integers(0, n, m * per_row))), shape=(m, n)
    )


def accelerated_gradients(A: Any, b: FloatVector, tolerance: float) -> FloatVector:
    """Return x of FISTA with restarts, the rival, at that relative optimality."""
    back, reference, v = A.T, np.abs(A.T @ b).max(), np.ones(A.shape[1])
    for _ in range(10):
        v = back @ (A @ (v / np.linalg.norm(v)))
    length, t = 0.95 / np.linalg.norm(v), 1.0
    x = y = np.zeros(A.shape[1])
    Ax = Ay = A @ x
    while True:
        gradient = back @ (Ay - b)
        if np.abs(np.minimum(y, gradient)).max() <= tolerance * reference:
            return y
        after = np.maximum(y - length * gradient, 0.0)
        t = 1.0 if (y - after) @ (after - x) > 0.0 else t
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
        product, share = A @ after, (t - 1.0) / following
        y, Ay = after + share * (after - x), product + share * (product - Ax)
        x, Ax, t = after, product, following


def of_condition(m: int, n: int, condition: float, rng: np.random.Generator) -> FloatVector:
    """Return a dense A with singular values from 1 to 1/condition, in even ratios."""
    k = min(m, n)
    left, right = (
        np.linalg.qr(rng.standard_normal((m, k)))[0],
        np.linalg.qr(rng.standard_normal((n, k)))[0],
    )
    product: FloatVector = (left * np.logspace(0.0, -np.log10(condition), k)) @ right.T
    return product


def cases(*, quick: bool = False) -> Iterator[tuple[str, Any, FloatVector]]:
    """Yield a name, A and b of each row of the table: b = A x and a tenth of noise, half of x ≥ 0 is 0."""
    rng, scale = np.random.default_rng(SEED), 10 if quick else 1
    kinds: dict[str, Callable[[int, int], Any]] = {
        "normal": lambda m, n: rng.standard_normal((m, n)),
        "positive": lambda m, n: rng.random((m, n)),
        "condition 1e8": lambda m, n: of_condition(m, n, 1e8, rng),
        "sparse": lambda m, n: random_rows(m, n, 8),
    }
    shapes = {
        "normal": ((8, 5), (40, 20), (200, 100), (2000, 400), (2000, 1000), (300, 800)),
        "positive": (
            (8, 5),
            (40, 20),
            (200, 100),
            (2000, 400),
            (20_000, 100),
            (2000, 1000),
            (300, 800),
        ),
        "condition 1e8": ((60, 30), (600, 300), (400, 400)),
        "sparse": ((3000, 600), (40_000, 8000)),
    }
    for kind, sizes in shapes.items():
        for small in dict.fromkeys(
            (-(-m // scale), -(-n // scale)) if m * n > UNSCALED else (m, n) for m, n in sizes
        ):
            A = kinds[kind](*small)
            exact = A @ np.where(rng.random(small[1]) < 0.5, rng.random(small[1]), 0.0)
            b = exact + 0.1 * np.abs(exact).mean() * rng.standard_normal(small[0])
            yield f"{kind} {small[0]} × {small[1]}", A, b


def _table(*, quick: bool) -> Iterator[str]:
    for name, A, b in cases(quick=quick):
        for upper in (np.inf, UPPER):
            bound = "0 ≤ x" if upper == np.inf else f"0 ≤ x ≤ {upper}"
            yield f"{name}, {bound}: {_beside_scipy(A, b, upper, 1 if quick else ROUNDS)}"


def _beside_scipy(A: Any, b: FloatVector, upper: float, repeats: int) -> str:
    """Return the seconds of both, and how they stand to what is allowed; a rival counts that has the answer."""
    result, seconds = bounded_least_squares(A, b, 0.0, upper), {}
    calls: dict[str, Callable[[], Any]] = {"ours": lambda: bounded_least_squares(A, b, 0.0, upper)}
    for rival, call in _scipy_calls(A, b, upper).items():
        once = timed(call)
        if _optimality(A, b, once.answer, upper) <= SOLVED:
            seconds[rival] = once.seconds
            if once.seconds < LONG:
                calls[rival] = call
    counts = {name: max(1, int(LONG_ENOUGH / timed(call).seconds)) for name, call in calls.items()}
    many = {name: lambda name=name: [calls[name]() for _ in range(counts[name])] for name in calls}
    for name, runs in rounds(
        many, repeats
    ).items():  # the quickest, as scipy's microseconds drown in others' work
        seconds[name] = min(one.seconds for one in runs) / counts[name]
    ours = seconds.pop("ours")
    said = f"{1e3 * ours:.3f} ms, {result.status.name} to {result.optimality:.0e}"
    if not seconds:
        return f"{said}; no rival at this size"
    best = min(seconds, key=lambda rival: seconds[rival])
    allowed = ALLOWED * seconds[best] + OVERHEAD
    return f"{said}; {best} {1e3 * seconds[best]:.3f} ms; {ours / allowed:.2f} of what is allowed"


def _scipy_calls(A: Any, b: FloatVector, upper: float) -> dict[str, Callable[[], FloatVector]]:
    from scipy.optimize import lsq_linear, nnls

    n, box = A.shape[1], (0.0, upper)
    dense = A.toarray() if sp.issparse(A) and n <= SPARSE_AS_DENSE else A
    calls: dict[str, Callable[[], FloatVector]] = {}
    if upper == np.inf and not sp.issparse(dense):
        calls["nnls"] = lambda: nnls(dense, b, maxiter=30 * n)[0]
    if n <= SUBSPACE_UP_TO:
        calls["bvls"] = lambda: lsq_linear(dense, b, box, method="bvls", tol=RIVAL_TOLERANCE).x
    if n <= REFLECTIVE_UP_TO:
        calls["trf"] = lambda: lsq_linear(dense, b, box, method="trf", tol=RIVAL_TOLERANCE).x
    if sp.issparse(A) and n <= SPARSE_AS_DENSE:
        calls["sparse trf"] = lambda: lsq_linear(A, b, box, tol=RIVAL_TOLERANCE, lsmr_tol="auto").x
    return calls


def _optimality(A: Any, b: FloatVector, x: FloatVector, upper: float) -> float:
    gradient = A.T @ (A @ x - b)
    return float(np.abs(np.clip(gradient, x - upper, x)).max() / np.abs(A.T @ b).max())


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the table compared with scipy, and the speed on large sparse problems."""
    scale, repeats = (10, 1) if quick else (1, 5)
    yield from _table(quick=quick)
    for m, n in ((40_000 // scale, 8000 // scale), (200_000 // scale, 100_000 // scale)):
        A = random_rows(m, n)
        b, x = planted(A)
        yield from _sparse(A, b, x, repeats)


def _sparse(A: Any, b: FloatVector, x: FloatVector, repeats: int) -> Iterator[str]:
    result = bounded_least_squares(A, b)
    calls: dict[str, Callable[[], Any]] = {
        "ours": lambda: bounded_least_squares(A, b),
        "rival": lambda: accelerated_gradients(A, b, 1e-6),
        "pair": lambda: A.T @ (A @ x),
    }
    seconds = medians(calls, repeats)
    yield (
        f"sparse NNLS {A.shape[0]} × {A.shape[1]}: {seconds['ours']:.3f} s to {result.optimality:.0e} in {result.nit} "
        f"steps, {seconds['ours'] / seconds['pair']:.0f} pairs of products, ÷ accelerated gradients to 1e-6 "
        f"{seconds['ours'] / seconds['rival']:.2f}; proved gap {result.gap / result.cost:.0e} of the cost"
    )
