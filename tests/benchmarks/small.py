"""Small problems in a loop, next to the solver that a user would call instead: processor time, ratio, goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from itertools import chain
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from inputs.contact_families import pyramids
from inputs.membranes import american_put
from inputs.published_problems import PROGRAMS, PublishedProgram
from inputs.small_families import spectrum
from scipy.linalg import solve_banded
from scipy.optimize import linprog, nnls, root

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    complements,
    march,
    optimal,
    prepare,
    solve,
    solve_batch,
    trace,
)

from .timing import rounds

Call = Callable[[], Any]
#: Name, goal as a ratio, our call, name of the rival, its call, problems in a call.
Row = tuple[str, float, Call, str, Call, int]
REPEATS, SECONDS = 7, 0.02  # of processor time in each repetition


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each row: microseconds of ours and of the rival, the ratio and its goal."""
    yield f"{'problem':44} {'ours':>9} {'instead':>9} µs  ratio   goal"
    for name, goal, ours, rival, instead, count in chain(
        _loops(quick), _cliffs(), _lcps(quick), _programs(quick), _models(quick), _published(quick)
    ):
        times = {}
        for key, call in (("ours", ours), ("instead", instead)):
            call()  # compiles and loads
            once = rounds({key: call}, 1 if quick else 3, _clock)[key]
            inner = max(1, int(SECONDS / max(min(one.seconds for one in once), 1e-6)))
            times[key] = partial(_repeated, call, 1 if quick else inner), 1 if quick else inner
        runs = rounds(
            {key: call for key, (call, _) in times.items()}, 1 if quick else REPEATS, _clock
        )
        least = {
            key: 1e6 * min(one.seconds for one in runs[key]) / (times[key][1] * count)
            for key in runs
        }
        ratio = least["ours"] / max(least["instead"], 1e-9)
        numbers = f"{least['ours']:9.1f} {least['instead']:9.1f}    {ratio:6.1f} {goal:6.1f}"
        yield f"{name:44} {numbers}  {rival}"


def _clock() -> float:
    from time import process_time

    return process_time()


def _repeated(call: Call, times: int) -> None:
    for _ in range(times):
        call()


def _loops(quick: bool) -> Iterator[Row]:
    """Yield the rows of one small problem, by `solve` and by a solver that `prepare` returns."""
    rng = np.random.default_rng(0)
    base = partial(np.linalg.solve, rng.normal(size=(10, 10)), rng.normal(size=10))
    rival = "numpy.linalg.solve, 10 × 10"
    for n in (10, 30):
        one = spectrum(n, 1e2, 0.4, 0)
        M, q, step = np.array(one.M), np.array(one.q), prepare(one)
        yield f"LCP of {n}", 32.0, partial(_solve_lcp, M, q), rival, base, 1
        yield f"LCP of {n}, lemke", 6.0, partial(_solve_lcp, M, q, "lemke"), rival, base, 1
        yield f"LCP of {n}, prepared", 2.0, partial(step.solve, q=q), rival, base, 1
    for k in range(1 if quick else 12):
        J, v = rng.normal(size=(15, 6)), rng.normal(size=15)
        W, mu = J @ J.T + np.eye(15), np.full(5, 0.5)
        step, name = prepare(FrictionalContact(W, v, mu)), f"5 contacts, exact cones, number {k}"
        yield name, 40.0, partial(_solve_contact, W, v, mu), rival, base, 1
        yield f"{name}, prepared", 12.0, partial(step.solve, b=v), rival, base, 1
    P, p = pyramids(W, v, mu)
    yield "5 contacts, pyramids", 12.0, partial(_solve_lcp, P, p), rival, base, 1
    yield (
        "5 contacts, pyramids, prepared",
        12.0,
        partial(prepare(LCP(P, p)).solve, q=p),
        rival,
        base,
        1,
    )
    if find_spec("daqp") is not None:
        G, c, h, eye = rng.normal(size=(11, 4)), rng.normal(size=4), np.ones(11), np.eye(4)
        rows = np.ascontiguousarray(G), h, np.full(11, -1e30), np.zeros(11, np.int32)
        other, step = (
            partial(import_module("daqp").solve, eye, c, *rows),
            prepare(QuadraticProgram(eye, c, G, h)),
        )
        yield "QP 4 × 11", 45.0, partial(_solve_program, eye, c, G, h), "daqp", other, 1
        yield "QP 4 × 11, prepared", 5.0, partial(step.solve, c=c, h=h), "daqp", other, 1
        x, y, a = cp.Variable(2), cp.Variable(), cp.Parameter(value=1.0)
        pair = cp.Problem(cp.Minimize(0), [complements(x >= 0, x - a >= 0), y == x[0]])
        square = cp.Problem(cp.Minimize(cp.sum_squares(x - a)), [x >= 0])
        ours, other = (
            partial(_change, pair, a, {"method": "LCP"}),
            partial(_change, square, a, {"solver": "DAQP"}),
        )
        yield "cvxpy, a pair, a parameter changed", 2.0, ours, "cvxpy with daqp", other, 1
    curved = NonlinearProblem(_F, lambda x: np.diag(np.exp(x)), lower=np.zeros(4))
    start = np.zeros(4)
    other, step = partial(root, lambda x: np.minimum(x, _F(x)), start), prepare(curved)
    yield "nonlinear, 4 unknowns", 15.0, partial(solve, curved, x0=start), "scipy's root", other, 1
    yield (
        "nonlinear, 4 unknowns, prepared",
        6.0,
        partial(step.solve, x0=start),
        "scipy's root",
        other,
        1,
    )
    A, b = rng.random((60, 30)), rng.random(60)
    other, step = partial(nnls, A, b), prepare(BoundedLeastSquares(A, b))
    yield "NNLS 60 × 30", 5.0, partial(_solve_fit, A, b), "scipy's nnls", other, 1
    yield "NNLS 60 × 30, prepared", 2.0, partial(step.solve, b=b), "scipy's nnls", other, 1


def _cliffs() -> Iterator[Row]:
    """Yield everyday conditions next to the plain call or step, and an infeasible step next to a feasible one."""
    rng = np.random.default_rng(0)
    one, (J, v) = spectrum(10, 1e2, 0.4, 0), (rng.normal(size=(15, 6)), rng.normal(size=15))
    G, c, A, b = (rng.normal(size=size) for size in ((11, 4), 4, (60, 30), 60))
    contacts = FrictionalContact(J @ J.T + np.eye(15), v, np.full(5, 0.5))
    fit, program = BoundedLeastSquares(A, b), QuadraticProgram(np.eye(4), c, G, np.ones(11))
    curved = NonlinearProblem(_F, lambda x: np.diag(np.exp(x)), lower=np.zeros(4))
    cases: list[tuple[str, Any, dict[str, Any], str]] = [
        ("LCP of 10", one, {"q": np.array(one.q)}, "z0"),
        ("5 contacts", contacts, {"b": v}, "z0"),
        ("NNLS 60 × 30", fit, {"b": b}, "x0"),
        ("QP 4 × 11", program, {"c": c}, "z0"),
        ("nonlinear, 4 unknowns", curved, {"q": np.zeros(4)}, "x0"),
    ]
    for name, problem, data, start in cases:
        plain, near = partial(solve, problem), {start: getattr(solve(problem), start[0])}
        for how in ({"max_seconds": 60.0}, {"verbose": False}, near):
            call = partial(solve, problem, **how)
            yield f"{name}, {min(how)}", 1.3, call, "the plain call", plain, 1
        step, limited = prepare(problem), prepare(problem, max_seconds=60.0)
        other = partial(step.solve, **data)
        for what, call in (
            ("max_seconds", partial(limited.solve, **data)),
            (start, partial(step.solve, **data, **near)),
        ):
            yield f"{name}, a step, {what}", 1.3, call, "the plain step", other, 1
    step = prepare(QuadraticProgram(np.eye(4), c, np.vstack([G, -G[0]]), np.full(12, 2.0)))
    calls = [partial(step.solve, h=np.append(np.ones(11), last)) for last in (-2.0, 2.0)]
    yield "QP 4 × 11, an infeasible step", 8.0, calls[0], "a feasible step", calls[1], 1


def _F(x: Any) -> Any:
    return np.exp(x) - 2.0


def _change(problem: Any, parameter: Any, how: dict[str, Any]) -> None:
    """Solve a model in cvxpy with another value of its parameter."""
    parameter.value = 3.0 - parameter.value
    problem.solve(**how)


def _lcps(quick: bool) -> Iterator[Row]:
    """Yield the rows of LCPs, contacts and marches whose rival is installed."""
    rng, many = np.random.default_rng(0), 50 if quick else 1000
    J = rng.normal(size=(15, 6))
    W, v, friction = J @ J.T + np.eye(15), rng.normal(size=15), np.full(5, 0.5)
    if find_spec("quantecon") is not None:
        lemke, rival = import_module("quantecon.optimize.lcp_lemke").lcp_lemke, "QuantEcon's Lemke"
        stack = [spectrum(10, 1e2, 0.4, k) for k in range(many)]
        Ms, qs = (np.array([getattr(one, name) for one in stack]) for name in ("M", "q"))
        for n in (10, 30, 100):
            one = spectrum(n, 1e2, 0.4, 0)
            M, q = np.array(one.M), np.array(one.q)
            other = partial(lemke, M, q)
            yield (
                f"LCP of {n} rows, lemke",
                17.0,
                partial(_solve_lcp, M, q, "lemke"),
                rival,
                other,
                1,
            )
            yield f"LCP of {n} rows, auto", 37.0, partial(_solve_lcp, M, q), rival, other, 1
        for count, goal in ((1, 40.0), (many, 2.0)):
            data = Ms[:count], qs[:count]
            batch = partial(solve_batch, *data, algorithm="lemke", threads=1)
            loop = partial(_each, lemke, *data)
            yield f"batch of {count}, 10 rows, per problem", goal, batch, rival, loop, count
        P, p = pyramids(W, v, friction)
        other = partial(lemke, P, p)
        yield "5 contacts, pyramids, as an LCP", 10.0, partial(_solve_lcp, P, p), rival, other, 1
    steps = 20 if quick else 200
    put = american_put(size=301, steps=steps)
    forcing = np.broadcast_to(put.advance(np.zeros(put.problem.n)), (steps, put.problem.n))
    priced = partial(march, put.problem, forcing, z0=put.problem.lower)
    tridiagonal = np.zeros((3, put.problem.n))
    for row, k in enumerate((1, 0, -1)):
        diagonal = put.problem.M.diagonal(k)
        tridiagonal[row, max(k, 0) : put.problem.n + min(k, 0)] = diagonal
    bare = partial(_repeated, partial(solve_banded, (1, 1), tridiagonal, forcing[0]), steps)
    yield f"put of 301 prices in {steps} steps", 1.0, priced, "solve_banded in each step", bare, 1


def _programs(quick: bool) -> Iterator[Row]:
    """Yield the rows of programs and least squares in arrays."""
    rng = np.random.default_rng(0)
    G, c = rng.normal(size=(11, 4)), rng.normal(size=4)
    A, B = rng.random((50, 200)), rng.random((40, 50))
    other = partial(_each, nnls, [A] * 40, B)
    yield "NNLS 50 × 200, per pixel", 2.0, partial(_solve_pixels, A, B), "scipy's nnls", other, 40
    K, k = np.vstack([G, -G]), -np.ones(22)
    other = partial(linprog, c, K, k, bounds=(None, None))
    no = partial(_solve_program, np.zeros((4, 4)), c, K, k)
    yield "infeasible LP, 4 unknowns, 22 rows", 4.0, no, "HiGHS by linprog", other, 1
    n = 10 if quick else 60
    none, costs, one = sp.csr_array((n * n, n * n)), rng.random(n * n), np.ones((1, n))
    E = sp.csr_array(sp.vstack([sp.kron(sp.eye_array(n), one), sp.kron(one, sp.eye_array(n))]))
    sums = np.ones(2 * n)
    assign = partial(_solve_program, none, costs, A=E, b=sums, lower=0.0)
    other = partial(linprog, costs, A_eq=E, b_eq=sums)
    yield f"assignment {n} × {n}", 3.0, assign, "HiGHS by linprog", other, 1
    A = rng.normal(size=(20, 40) if quick else (200, 400))
    b = A[:, :5].sum(1) + 0.1 * rng.normal(size=len(A))
    if find_spec("sklearn") is not None:
        lars = import_module("sklearn.linear_model").lars_path
        other = partial(lars, A, b, method="lasso")
        path = partial(_trace_lasso, A, b)
        yield f"lasso path {len(A)} × {A.shape[1]}", 8.0, path, "sklearn's lars_path", other, 1
    if find_spec("piqp") is not None:
        by_piqp = partial(_by_piqp, import_module("piqp"))
        S, ones = np.cov(rng.normal(size=(200, 50))), np.ones((1, 200))
        for name, one, end in (
            ("free", S, (-np.inf, np.inf)),
            ("long only", S, (0.0, np.inf)),
            ("float32, −1 ≤ x ≤ 1", S.astype(np.float32).astype(float), (-1.0, 1.0)),
        ):
            ends = np.full(200, end[0]), np.full(200, end[1])
            data = one, np.zeros(200), None, None, ones, np.ones(1), *ends
            ours, other = partial(_solve_program, *data), partial(by_piqp, *data)
            yield f"minimum variance, 200 assets, {name}", 3.0, ours, "PIQP", other, 1
        n = 50 if quick else 1500
        X = rng.normal(size=(n, 2))
        label = np.sign(X[:, 0] * X[:, 1])
        Q = np.exp(-((X[:, None] - X) ** 2).sum(2)) * np.outer(label, label)
        data = Q, -np.ones(n), None, None, label[None], np.zeros(1), np.zeros(n), np.ones(n)
        ours, other = partial(_solve_program, *data), partial(by_piqp, *data)
        yield f"SVM dual, {n} points", 1.5, ours, "PIQP", other, 1


def _models(quick: bool) -> Iterator[Row]:
    """Yield the rows of models in cvxpy."""
    rng = np.random.default_rng(5)
    R = rng.random((50 if quick else 1000, 40))
    apart, inlined = partial(_solve_shares, R, False), partial(_solve_shares, R, True)
    yield f"{len(R)} definitions d == A @ x, 40 pairs", 3.0, apart, "inlined", inlined, 1
    wealth, spent = cp.Variable(21), cp.Variable(20)
    utility = cp.Maximize(0.96 ** np.arange(20) @ cp.log(spent))
    saved = [wealth[0] == 1, wealth[1:] == 1.03 * wealth[:-1] + 1 - spent, wealth[20] >= 0]
    plan = cp.Problem(utility, saved)
    agent = cp.Problem(cp.Minimize(0), [optimal(plan, over=[wealth, spent])])
    ours, other = (
        partial(agent.solve, method="LCP", warm_start=False),
        partial(plan.solve, "CLARABEL"),
    )
    yield "log utility, 20 periods, through optimal", 5.0, ours, "Clarabel", other, 1


def _published(quick: bool) -> Iterator[Row]:
    """Yield the row of the published programs, all in one call, as arrays."""
    if find_spec("piqp") is None:
        return
    by_piqp, every = partial(_by_piqp, import_module("piqp")), list[Any]()
    for name, size in PROGRAMS.items():
        of = PublishedProgram.read(name)
        rows, low, high, lower, upper = of.split()
        is_equal, m = low == high, np.isfinite(high) & (low < high)
        k = np.isfinite(low) & (low < high)
        G, h = sp.vstack([rows[m], -rows[k]], "csr"), np.concatenate([high[m], -low[k]])
        if not quick or size < 100:
            every += [(of.P, of.q, G, h, rows[is_equal], high[is_equal], lower, upper)]
    ours, other = partial(_each_of, _solve_program, every), partial(_each_of, by_piqp, every)
    yield f"{len(every)} published programs, arrays", 2.5, ours, "PIQP", other, len(every)


def _solve_shares(R: Any, is_inlined: bool) -> None:
    """Solve the growth-optimal shares, with the returns as unknowns or inlined."""
    count, size = R.shape
    d, w, v = cp.Variable(count), cp.Variable(size), cp.Variable()
    w.value, v.value, d.value = np.full(size, 1.0 / size), 1.0, R.mean(1)
    returns = R @ w if is_inlined else d
    pairs = complements(w >= 0, v - R.T @ cp.power(returns, -1) / count >= 0)
    rows = [pairs, cp.sum(w) == 1, *([] if is_inlined else [d == R @ w])]
    cp.Problem(cp.Minimize(0), rows).solve(method="LCP")


def _trace_lasso(A: Any, b: Any) -> None:
    most = np.abs(A.T @ b).max()
    trace(BoundedLeastSquares(A, b, lower=-np.inf), {"l1": 1.0}, 1.1 * most, 1e-3 * most)


def _solve_lcp(M: Any, q: Any, algorithm: str = "auto") -> None:
    solve(LCP(M, q), algorithm)


def _solve_program(*data: Any, **named: Any) -> None:
    solve(QuadraticProgram(*data, **named))


def _solve_fit(A: Any, b: Any) -> None:
    solve(BoundedLeastSquares(A, b))


def _solve_pixels(A: Any, B: Any) -> None:
    solve_batch(BoundedLeastSquares(A, B[0]), B, threads=1)


def _solve_contact(W: Any, b: Any, friction: Any) -> None:
    solve(FrictionalContact(W, b, friction, dimension=3))


def _by_piqp(piqp: Any, P: Any, c: Any, G: Any, h: Any, A: Any, b: Any, *ends: Any) -> None:
    is_sparse = sp.issparse(P)
    solver = piqp.SparseSolver() if is_sparse else piqp.DenseSolver()
    P, G, A = (sp.csc_matrix(one) if is_sparse else one for one in (P, G, A))
    rows = (None, None, None) if h is None or not h.size else (G, None, h)
    solver.setup(P, c, *((A, b) if len(b) else (None, None)), *rows, *ends)
    solver.solve()


def _each_of(call: Any, arguments: list[Any]) -> None:
    for one in arguments:
        call(*one)


def _each(call: Any, first: Any, second: Any) -> None:
    for a, b in zip(first, second, strict=True):
        call(a, b)
