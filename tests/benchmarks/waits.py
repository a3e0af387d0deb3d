"""Models on which users have waited, next to the solvers that they would take instead."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog, nnls
from scipy.sparse.linalg import spsolve

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    NonlinearProblem,
    QPSolver,
    QuadraticProgram,
    complements,
    gallery,
    solve,
)

from .timing import rounds

SEED = 5
Pair = tuple[str, Callable[[], Any], Callable[[], Any]]


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each model: the seconds of both solvers, the quickest of two runs, and the quotient."""
    scale = 10 if quick else 1
    rng = np.random.default_rng(SEED)
    for models in (dense_programs, quantile_regression, definitions, reactor, data, games, flows):
        for name, ours, rival in models(rng, scale):
            timed = rounds({"ours": ours, "rival": rival}, 2)
            own, other = (min(one.seconds for one in timed[who]) for who in ("ours", "rival"))
            yield f"{name:40s} {own:9.4f} s {other:9.4f} s {own / other:8.1f}"


def dense_programs(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield programs with dense data through cvxpy, next to Clarabel and to the same program by arrays."""
    import cvxpy as cp

    n = 500 // scale
    A, b, mu, F = (rng.normal(size=shape) for shape in ((n, n), n, n, (n, n)))
    S, x, y = F @ F.T / n + 0.1 * np.eye(n), cp.Variable(n), cp.Variable(n // 10)
    rows = [A @ x <= abs(b) + 1, x >= -1, x <= 1]
    few = A[: n // 10, : n // 10] @ y - b[: n // 10]
    models = {
        f"rows {n}": cp.Problem(cp.Minimize(cp.sum_squares(x) + mu @ x), rows),
        f"portfolio {n}": cp.Problem(
            cp.Minimize(cp.quad_form(x, cp.psd_wrap(S)) - mu @ x), [cp.sum(x) == 1, x >= 0]
        ),
        f"lasso {n}": cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b) + 0.5 * cp.norm1(x))),
        f"lasso {n // 10}": cp.Problem(cp.Minimize(cp.sum_squares(few) + 0.5 * cp.norm1(y))),
    }
    arrays = (
        QuadraticProgram(2 * np.eye(n), mu, A, abs(b) + 1, lower=-1.0, upper=1.0),
        QuadraticProgram(2 * S, -mu, A=np.ones((1, n)), b=[1.0], lower=0.0),
        BoundedLeastSquares(A, b, lower=-np.inf, l1=0.25),
        BoundedLeastSquares(A[: n // 10, : n // 10], b[: n // 10], lower=-np.inf, l1=0.25),
    )
    for (name, model), problem in zip(models.items(), arrays, strict=True):
        by_cvxpy = partial(model.solve, solver=QPSolver)
        yield f"{name}, cvxpy / Clarabel", by_cvxpy, partial(model.solve, solver=cp.CLARABEL)
        yield f"{name}, cvxpy / arrays", by_cvxpy, partial(solve, problem)


def quantile_regression(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield a regression with heavy-tailed noise."""
    import cvxpy as cp

    m = 20_000 // scale
    Z, t = np.c_[np.ones(m), rng.normal(size=m)], cp.Variable(2)
    misfit = Z @ [1, 2] + rng.standard_t(3, m) - Z @ t
    model = cp.Problem(cp.Minimize(cp.sum(0.3 * cp.pos(misfit) + 0.7 * cp.neg(misfit))))
    ours = partial(model.solve, solver=QPSolver)
    yield f"quantiles of {m} / Clarabel", ours, partial(model.solve, solver=cp.CLARABEL)


def definitions(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield a nonlinear model with a variable for each linear part, next to the model with these parts inline."""
    import cvxpy as cp

    k, m = 40, 1000 // scale
    R = rng.random((m, k))

    def shares(is_inline: bool) -> None:
        d, w, v = cp.Variable(m), cp.Variable(k), cp.Variable()
        w.value, v.value = np.full(k, 1 / k), 1.0
        d.value = R @ w.value
        price = v - R.T @ cp.power(R @ w if is_inline else d, -1) / m
        rows = [complements(w >= 0, price >= 0), cp.sum(w) == 1]
        rows += [] if is_inline else [d == R @ w]
        cp.Problem(cp.Minimize(0), rows).solve(method="LCP")

    yield f"{m} definitions / inline", partial(shares, False), partial(shares, True)


def reactor(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield a tubular reactor with axial mixing, two unknowns per node: a square smooth system without bounds."""
    N = 2500 // scale
    h, Pe, D, heat, g, beta = 1 / (N - 1), 5.0, 0.135, 0.5, 25.0, 2.0
    inside = np.arange(1, N - 1)
    mixing = sp.diags_array(
        [1 / Pe / h**2 + 1 / (2 * h), -2 / Pe / h**2, 1 / Pe / h**2 - 1 / (2 * h)],
        offsets=[-1, 0, 1],
        shape=(N, N),
    ).tolil()
    mixing[0, :2], mixing[-1, -2:] = [-1 / h - Pe, 1 / h], [-1.0, 1.0]
    linear = sp.block_diag([mixing, mixing], format="csr")
    sources = np.zeros(2 * N)
    sources[[0, N]], sources[N + inside] = Pe, beta

    def values(z: Any) -> Any:
        found, rate = linear @ z + sources, D * z[:N] * np.exp(g - g / z[N:])
        found[inside] -= rate[inside]
        found[N + inside] += heat * rate[inside] - beta * z[N + inside]
        return found

    def slopes(z: Any) -> Any:
        c, T = z[inside], z[N + inside]
        by_c = D * np.exp(g - g / T)
        by_T = by_c * c * g / T**2
        both = np.concatenate([inside, inside + N])
        rows, columns = np.tile(both, 2), np.repeat([inside, inside + N], 2, axis=0).ravel()
        entries = np.concatenate([-by_c, heat * by_c, -by_T, heat * by_T - beta])
        return sp.csr_array(linear + sp.csr_array((entries, (rows, columns)), linear.shape))

    def newton() -> None:
        z = np.ones(2 * N)
        for _ in range(6):
            z = z - spsolve(slopes(z).tocsc(), values(z))

    problem = NonlinearProblem(values, slopes, lower=-np.inf)
    yield f"square system {2 * N} / Newton", partial(solve, problem, x0=np.ones(2 * N)), newton


def data(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield least squares problems: ridge and lasso on a wide matrix, weights, nonnegative unknowns."""
    m, n = 500 // scale, 2000 // scale
    B = rng.normal(size=(m, n))
    c = B[:, :5] @ rng.normal(size=5) + 0.01 * rng.normal(size=m)
    ridge = BoundedLeastSquares(B, c, lower=-np.inf, ridge=1.0)
    closed = partial(lambda: B.T @ np.linalg.solve(B @ B.T + np.eye(m), c))
    yield f"ridge {m} x {n} / closed form", partial(solve, ridge), closed
    lasso = BoundedLeastSquares(B, c, lower=-np.inf, l1=0.1 * abs(B.T @ c).max())
    yield f"lasso {m} x {n} / closed form of ridge", partial(solve, lasso), closed
    C, u, weights = rng.random((n, 13)), rng.random(n), rng.random(n) + 0.1
    plain = partial(solve, BoundedLeastSquares(C, u))
    weighted = BoundedLeastSquares(C, u, weights=weights)
    yield f"weighted NNLS {n} x 13 / unweighted", partial(solve, weighted), plain
    yield f"NNLS {n} x 13 / scipy", plain, partial(nnls, C, u)


def games(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield zero-sum games, next to their linear programs."""
    for k in (300 // scale, 600 // scale):
        G = rng.integers(-5, 6, (k, k)).astype(float)
        program = partial(
            linprog,
            np.r_[np.zeros(k), -1],
            A_ub=np.c_[-G.T, np.ones(k)],
            b_ub=np.zeros(k),
            A_eq=[np.r_[np.ones(k), 0]],
            b_eq=[1],
            bounds=[(0, None)] * k + [(None, None)],
        )
        yield f"zero-sum game {k} / linear program", partial(solve, LCP.from_game(G, -G)), program


def flows(rng: np.random.Generator, scale: int) -> Iterator[Pair]:
    """Yield a flow with each unknown in another unit, next to the same flow in one unit."""
    own = gallery.build("convection_diffusion", size=300 // scale).problem
    units = 2.0 ** rng.integers(-10, 11, own.n)
    mixed = LCP(own.csr @ sp.diags_array(units), own.q)
    yield f"flow of {own.n} in mixed / own units", partial(solve, mixed), partial(solve, own)
