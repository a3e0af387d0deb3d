"""Inputs that are solved with and without a mechanism: problems with reference solutions.

The inputs are applications at small and larger sizes, the collection, and published problems if they exist next to
the checkout. Small shares of the campaigns follow, and then methods and engines by name, each on suitable problems.
References are independent: exact arithmetic and third-party solvers, never a status.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from published_problems import FOLDER

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    QuadraticProgram,
    Status,
    certify,
    march,
    solve,
    solve_batch,
    trace,
)
from lcp_plugin.problems.equilibria.branch_and_bound import minimize_over_solutions
from lcp_plugin.problems.nonlinear.solving import solve_nonlinear

TESTS = Path(__file__).parents[1]
DATA = FOLDER  # published problems
SOLVED, PROVED, OPEN, FALSE = "solved", "proved", "open", "false"
ALIKE, LOOSE = (
    1e-6,
    1e-4,
)  # relative, of an objective or a residual by an external reference; of a program over a cone
SHARP = 1e-4  # of the largest entry: a proved distance, about the root of the error of the value
MOST_PUBLISHED = 2500  # rows and columns
SEED, SHARE = 70, 7


@dataclass(frozen=True)
class Input:
    """An input problem.

    Attributes
    ----------
    source, name : str
    state : callable
        Returns the problem, with empty caches.
    solve : callable, problem -> result
    judge : callable, (problem, result) -> str
        SOLVED or PROVED, OPEN, or FALSE.
    """

    source: str
    name: str
    state: Callable[[], Any]
    solve: Callable[[Any], Any]
    judge: Callable[[Any, Any], str]


def work_of(result: Any) -> float:
    """Return the work reported by a result: passes over M, else steps or nodes."""
    for name in ("work", "nodes", "nit"):
        if isinstance(found := getattr(result, name, None), (int, float, np.number)):
            return float(found)
    if stages := getattr(result, "stages", ()):
        return float(sum(stage.work for stage in stages))
    steps = getattr(result, "iterations", 0.0)
    return float(np.sum(steps))


# --- LCPs -----------------------------------------------------------------------------------------------------------


def applications() -> Iterator[Input]:
    """Yield applications, unscaled and scaled."""
    from applications.table import cases

    for case in cases(full=False):
        for units in ("own", "both"):
            yield Input(
                "applications",
                f"{case.name} {units}",
                partial(case.in_units, units),
                lambda stated: solve(stated[0]),
                partial(_as_application, case),
            )


def obstacles() -> Iterator[Input]:
    """Membranes over obstacles, for which grids are made."""
    from applications.table import Case

    for side in (150, 300):
        case = Case("obstacle_2d", {"side": side})
        for method in ("auto", "multigrid"):
            yield Input(
                "obstacles",
                f"{method}, {case.name}",
                partial(case.in_units, "own"),
                lambda stated, method=method: solve(stated[0], method),
                partial(_as_application, case),
            )


def _as_application(case: Any, stated: Any, result: Any) -> str:
    z = np.ldexp(result.z, stated[1])
    if not result.is_solved:
        return OPEN
    return SOLVED if case.error(z, [z]) < 1e-3 else FALSE


def collection() -> Iterator[Input]:
    from collection import all_entries
    from collection.judgement import false_claim, shortfall

    def judge(entry: Any, problem: Any, result: Any) -> str:
        if false_claim(problem, entry.truth, result, 1e-8):
            return FALSE
        is_short = shortfall(problem, entry.truth, result) or result.status.name == "STALLED"
        return OPEN if is_short else SOLVED if entry.truth == "solvable" else PROVED

    for entry in all_entries():
        yield Input(
            "collection", entry.name, partial(_fresh, entry.problem), solve, partial(judge, entry)
        )


def _fresh(one: LCP) -> LCP:
    return LCP(one.M, one.q, lower=one.lower, upper=one.upper)


def small_lcps(count: int = 120) -> Iterator[Input]:
    from campaigns.small_lcps import KINDS, random_problem
    from collection.judgement import false_claim, shortfall
    from collection.truth import SOLVABLE, decide

    @cache
    def truth(case: int) -> str:
        return str(decide(drawn(case)).verdict)

    def drawn(case: int) -> LCP:
        return random_problem([*KINDS][case % len(KINDS)], np.random.default_rng([SEED, case]))

    def judge(case: int, problem: Any, result: Any) -> str:
        if false_claim(problem, truth(case), result, 1e-8):
            return FALSE
        return (
            OPEN
            if shortfall(problem, truth(case), result)
            else SOLVED
            if truth(case) == SOLVABLE
            else PROVED
        )

    for case in range(count):
        yield Input("small LCPs", str(case), partial(drawn, case), solve, partial(judge, case))


def published_lcps() -> Iterator[Input]:
    for file in sorted(DATA.glob("*.npz")):
        if not file.name.startswith(("qp_", "fc3d_")):
            yield Input("published LCPs", file.stem, partial(_read_lcp, file), solve, _by_residual)


def _read_lcp(file: Path) -> LCP:
    with np.load(file) as f:
        M = sp.csr_array((f["data"], f["indices"], f["indptr"]), shape=tuple(f["shape"]))
        return LCP(M, f["q"], lower=f["lower"], upper=f["upper"])


def residual(problem: Any, z: Any) -> float:
    """Return the natural residual relative to its value at the bounds' point nearest to 0."""
    d = np.abs(problem.M).max(axis=1)
    d = d.toarray().ravel() if sp.issparse(d) else np.asarray(d)
    d = np.where(d > 0.0, d, 1.0)

    def size(x: Any) -> float:
        w = problem.M @ x + problem.q
        return float(np.abs(x - np.clip(x - w / d, problem.lower, problem.upper)).max(initial=0.0))

    here, there = size(z), size(np.clip(0.0, problem.lower, problem.upper))
    return here / there if there > 0.0 else here


def _by_residual(problem: Any, result: Any) -> str:
    return (
        OPEN if not result.is_solved else SOLVED if residual(problem, result.z) <= ALIKE else FALSE
    )


def plain_structures() -> Iterator[Input]:
    """Yield matrices whose rows select the method, and matrices with infeasible rows.

    For −L, L an M-matrix, every z with w = q − L z ≥ 0 is at most L⁻¹q, which has a negative entry. The other
    inconsistent row is w = −z − 1.
    """
    rng = np.random.default_rng(SEED)

    def random_rows(n: int, share: float) -> sp.csr_array:
        A = sp.csr_array(
            sp.random_array((n, n), density=6.0 / n, rng=rng, data_sampler=rng.standard_normal)
        )
        A = A - sp.diags_array(A.diagonal())
        return sp.csr_array(
            A + sp.diags_array(np.asarray(abs(A).sum(axis=1)).ravel() / share + 1e-3)
        )

    def stencil(side: int, flow: float) -> sp.csr_array:
        line = sp.diags_array(
            [-1.0 - flow, 2.0 + flow, -1.0], offsets=[-1, 0, 1], shape=(side, side)
        )
        return sp.csr_array(sp.kron(line, sp.eye_array(side)) + sp.kron(sp.eye_array(side), line))

    def upwind(side: int, flow: float) -> sp.csr_array:
        """Diffusion and a flow along one axis of that cell Péclet number."""
        line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
        along = line + flow * sp.diags_array([-1.0, 1.0], offsets=[-1, 0], shape=(side, side))
        return sp.csr_array(sp.kron(along, sp.eye_array(side)) + sp.kron(sp.eye_array(side), line))

    def by_proof(problem: Any, result: Any) -> str:
        return FALSE if result.is_solved else PROVED if result.has_no_solution else OPEN

    wrong, flow, contradictory = (
        stencil(40, 0.0),
        stencil(150, 10.0),
        random_rows(3000, 0.5).tolil(),
    )
    across = upwind(40, 20.0)
    scattered = rng.permutation(1600)
    contradictory[7, :], contradictory[7, 9] = 0.0, -1.0
    against = rng.standard_normal(3000)
    against[7] = -1.0
    stated = {
        "dominant rows": (random_rows(50_000, 0.7), rng.standard_normal(50_000), _by_residual),
        "lower triangle": (
            np.tril(rng.standard_normal((800, 800))) + 5.0 * np.eye(800),
            -np.ones(800),
            _by_residual,
        ),
        "flow": (flow, rng.standard_normal(22_500), _by_residual),
        "flow of convection": (upwind(120, 5.0), rng.standard_normal(14_400), _by_residual),
        "flow on a grid without order": (
            across[scattered][:, scattered],
            rng.standard_normal(1600),
            _by_residual,
        ),
        "wrong sign": (-wrong, wrong @ (rng.random(1600) - 0.1), by_proof),
        "contradictory row": (sp.csr_array(contradictory), against, by_proof),
    }
    for name, (M, q, judge) in stated.items():
        yield Input("plain structures", name, partial(LCP, M, q), solve, judge)


def marches() -> Iterator[Input]:
    import marches as made

    def judge(stated: Any, result: Any) -> str:
        if not result.all_solved:
            return OPEN
        z, worst = stated.z0, 0.0
        for forcing, answer in zip(stated.forcing, result.z, strict=True):
            worst = max(
                worst, residual(stated.problem.with_q(forcing + stated.propagator @ z), answer)
            )
            z = answer
        return SOLVED if worst <= ALIKE else FALSE

    def put() -> Any:
        """An American put on one asset, implicit steps."""
        n, steps = 2000, 20
        s = 2.0 * np.arange(1, n + 1) / (n + 1)
        dt, h = 0.5 / steps, s[0]
        diffusion, drift = 0.5 * 0.2**2 * s**2 / h**2, 0.5 * 0.05 * s / h
        A = made._line(n, drift - diffusion, 2.0 * diffusion + 0.05, -drift - diffusion)
        payoff = np.maximum(1.0 - s, 0.0)
        M, forcing = sp.csr_array(sp.eye_array(n) + dt * A), np.zeros((steps, n))
        forcing[:, 0] = dt * (drift - diffusion)[0]
        return made.Steps(
            LCP(M, np.zeros(n), lower=payoff), forcing, sp.csr_array(-sp.eye_array(n)), payoff
        )

    stated: dict[str, Callable[[], Any]] = {
        "Heston": lambda: made.heston(60, 30, 10)[0],
        "basket": lambda: made.basket(40, 10),
        "parabolic": lambda: made.parabolic(64, 10),
        "rolling contact": lambda: made.contact(40, 10),
        "put": put,
    }
    for name, state in stated.items():
        yield Input(
            "marches",
            name,
            state,
            lambda one: march(one.problem, one.forcing, one.propagator, z0=one.z0),
            judge,
        )


def _solved_together(stated: Any) -> Any:
    M, q, lower, upper = stated
    return solve_batch(M, q=q, lower=lower, upper=upper)


def batches() -> Iterator[Input]:
    from planted import planted

    def judge(stated: Any, result: Any) -> str:
        if any(status.name != "SOLVED" for status in result.status):
            return OPEN
        M, *vectors = stated
        worst = max(
            residual(LCP(M if M.ndim == 2 else M[k], q, lower=lower, upper=upper), result.z[k])
            for k, (q, lower, upper) in enumerate(zip(*vectors, strict=True))
        )
        return SOLVED if worst <= ALIKE else FALSE

    for n, count, is_shared in ((6, 300, False), (20, 100, True), (60, 30, False)):
        state = partial(planted, count, n, SEED, symmetric=n != 20, shared=is_shared)
        yield Input("batches", f"{count} of {n}", state, _solved_together, judge)


def paths() -> Iterator[Input]:
    """Yield paths of random families, a lasso and linear programs, checked between breakpoints."""
    from campaigns.paths import random_family

    rng = np.random.default_rng(SEED)

    def judge(stated: Any, path: Any) -> str:
        if not path.is_solved:
            return OPEN
        problem, along = stated[:2]
        for piece in path.pieces[:: max(len(path) // SHARE, 1)]:
            theta = 0.3 * piece.begin + 0.7 * piece.end
            moved = {
                name: getattr(problem, name) + theta * np.asarray(step)
                for name, step in along.items()
            }
            point, there = (
                path.at(theta),
                problem.with_q(**moved) if "q" in moved else problem.with_vectors(**moved),
            )
            if isinstance(problem, LCP) and residual(there, point.z) > ALIKE:
                return FALSE
            value = None if isinstance(problem, LCP) else solve(there).objective
            if value is not None and abs(point.objective - value) > ALIKE * (1.0 + abs(value)):
                return FALSE
        return SOLVED

    def lasso(m: int, n: int) -> Any:
        A = rng.standard_normal((m, n))
        b = A[:, :4].sum(axis=1) + rng.standard_normal(m)
        most = float(np.abs(A.T @ b).max())
        return BoundedLeastSquares(A, b, lower=-np.inf), {"l1": 1.0}, most, 1e-2 * most

    def linear(case: int) -> Any:
        drawn = np.random.default_rng([SEED, case])
        G, h = drawn.integers(-2, 4, (12, 20)).astype(float), drawn.integers(3, 9, 12).astype(float)
        program = QuadraticProgram(None, -drawn.integers(0, 4, 20), G=G, h=h, lower=0, upper=3)
        return program, {"c": drawn.integers(-2, 3, 20).astype(float)}, 0.0, 1.0

    def family(case: int) -> Any:
        problem, dq = random_family(np.random.default_rng([SEED, case]), 150)
        return problem, {"q": dq}, 0.0, 1.0

    stated = {f"lasso {m} × {n}": partial(lasso, m, n) for m, n in ((100, 60), (80, 300))}
    stated |= {f"linear {case}": partial(linear, case) for case in range(4)}

    def membrane() -> Any:
        n = 700
        M = np.linalg.inv(
            np.eye(n) + 0.1 * np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / n
        )
        M = M @ M.T
        return (
            LCP(M, -M @ rng.uniform(-0.2, 1.0, n)),
            {"q": M @ rng.uniform(-1.0, 1.0, n)},
            0.0,
            0.2,
        )

    stated["many free rows"] = membrane
    stated |= {f"family {case}": partial(family, case) for case in range(16)}
    for name, state in stated.items():
        yield Input("paths", name, state, lambda one: trace(*one), judge)


# --- programs -------------------------------------------------------------------------------------------------------


def planted_programs(count: int = 45) -> Iterator[Input]:
    """Yield programs with known minima or proofs, as drawn and with one change of scale each."""
    from campaigns.scaled_programs import WHAT, planted, rescaled

    def state(case: int, what: str) -> Any:
        rng = np.random.default_rng([SEED, case])
        drawn = planted(case, rng)
        return drawn, *(
            (drawn.program, 1.0) if what == WHAT[0] else rescaled(drawn.program, what, rng)
        )

    def judge(stated: Any, result: Any) -> str:
        drawn, program, size = stated
        if result.status is not drawn.status:
            return FALSE if result.is_solved or result.has_no_solution else OPEN
        if drawn.status is not Status.SOLVED:
            return PROVED
        x = np.abs(result.x)
        terms = float(np.abs(program.c) @ x + 0.5 * x @ (abs(program.P) @ x))
        return SOLVED if abs(result.objective - size * drawn.value) <= ALIKE * terms else FALSE

    for case in range(count):
        for what in (WHAT[0], WHAT[1 + case % (len(WHAT) - 1)]):
            yield Input(
                "planted programs",
                f"{case} {what}",
                partial(state, case, what),
                lambda stated: solve(stated[1]),
                judge,
            )


def published_programs() -> Iterator[Input]:
    for file in sorted(DATA.glob("qp_*.npz")):
        with np.load(file) as f:
            if sum(f["A_shape"]) > MOST_PUBLISHED:
                continue
            optimal = float(f["optimal_value"]) - float(f["r"])
        yield Input(
            "published programs",
            file.stem,
            partial(_read_program, file),
            solve,
            lambda program, result, optimal=optimal: _by_value(program, result, optimal),
        )


def _read_program(file: Path) -> QuadraticProgram:
    with np.load(file) as f:
        P, A = (
            sp.csr_array(
                sp.csc_array(
                    tuple(f[f"{one}_{part}"] for part in ("data", "indices", "indptr")),
                    shape=tuple(f[f"{one}_shape"]),
                )
            )
            for one in "PA"
        )
        c, low, high = f["q"], f["l"], f["u"]
    is_equality, has_low, has_high = low == high, low > -1e19, high < 1e19
    below, above = np.flatnonzero(has_low & ~is_equality), np.flatnonzero(has_high & ~is_equality)
    G = sp.csr_array(sp.vstack([-A[below], A[above]]))
    h = np.concatenate([-low[below], high[above]])
    equal = np.flatnonzero(is_equality)
    return QuadraticProgram(P, c, G, h, A[equal], low[equal])


def value_of_others(program: QuadraticProgram) -> float:
    """Return the minimum by Clarabel, which is the last engine of auto."""
    import qpsolvers

    matrices = [sp.csc_matrix(one) for one in (program.P, program.G, program.A)]
    stated = qpsolvers.Problem(
        matrices[0],
        program.c,
        *((matrices[1], program.h) if program.h.size else (None, None)),
        *((matrices[2], program.b) if program.b.size else (None, None)),
        program.lower,
        program.upper,
    )
    x = qpsolvers.solve_problem(
        stated, solver="clarabel", tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9
    ).x
    return float(0.5 * x @ (program.P @ x) + program.c @ x)


def _by_value(program: Any, result: Any, optimal: float) -> str:
    """Return the verdict on the value and on violations, relative to the terms of each row."""
    if not result.is_solved:
        return FALSE if result.has_no_solution else OPEN
    x = result.x
    value = float(0.5 * x @ (program.P @ x) + program.c @ x)
    missed = np.concatenate(
        [
            (program.G @ x - program.h) / (1.0 + abs(program.G) @ np.abs(x) + np.abs(program.h)),
            np.abs(program.A @ x - program.b)
            / (1.0 + abs(program.A) @ np.abs(x) + np.abs(program.b)),
            (program.lower - x) / (1.0 + np.abs(x)),
            (x - program.upper) / (1.0 + np.abs(x)),
        ]
    )
    is_optimal = abs(value - optimal) <= ALIKE * max(1.0, abs(optimal))
    return SOLVED if is_optimal and missed.max(initial=0.0) <= ALIKE else FALSE


def certified(count: int = 60) -> Iterator[Input]:
    """Yield claims for `certify` on right and on wrong solutions."""
    from campaigns.certify import KINDS, case, faults

    def state(number: int) -> Any:
        rng = np.random.default_rng([SEED, number])
        given = case(KINDS[number % len(KINDS)], rng, 8)
        step = rng.normal(size=given.x.size)
        x = given.x + (1e-2 * step / np.abs(step).max() if number % 3 == 2 else 0.0)
        return given, x, (None, given.solution, None)[number % 3]

    def ask(stated: Any) -> Any:
        given, x, multipliers = stated
        return (
            certify(given.program, x)
            if multipliers is None
            else certify(given.program, x, multipliers)
        )

    def judge(stated: Any, said: Any) -> str:
        given, x, _ = stated
        if faults(given, x, said):
            return FALSE
        if said.verdict != "proved":
            return PROVED if said.verdict == "disproved" else OPEN
        is_near = said.distance is not None and said.distance <= SHARP * (
            1.0 + float(np.abs(x).max(initial=0.0))
        )
        return SOLVED if not given.is_definite or is_near else OPEN

    for number in range(count):
        yield Input("certify", str(number), partial(state, number), ask, judge)


def equilibria(count: int = 40) -> Iterator[Input]:
    from campaigns.best_equilibria import complaints, random_problem, truth

    known = cache(lambda case: truth(drawn(case)))

    def drawn(case: int) -> Any:
        return random_problem(np.random.default_rng([SEED, case]), 12 if case % 2 else 6)

    def judge(case: int, problem: Any, result: Any) -> str:
        try:
            if [one for one in complaints(result, known(case)) if "verify" not in one]:
                return FALSE
        except ArithmeticError:  # not checked
            return OPEN
        return SOLVED if result.is_solved else PROVED if result.has_no_solution else OPEN

    for case in range(count):
        yield Input(
            "equilibria",
            str(case),
            partial(drawn, case),
            minimize_over_solutions,
            partial(judge, case),
        )


def outliers(count: int = 60) -> Iterator[Input]:
    """Yield small problems with outliers, checked with rationals; times include the checks."""
    from campaigns.outliers import FALSE as WRONG
    from campaigns.outliers import RIGHT, run

    verdicts = {RIGHT: SOLVED, WRONG: FALSE}
    for case in range(count):
        for kind in ("program", "lcp", "cones"):
            yield Input(
                "outliers",
                f"{kind} {case}",
                partial(partial, run, kind, SEED, case),
                lambda case: case(),
                lambda _, found: verdicts.get(found.what, OPEN),
            )


# --- others ---------------------------------------------------------------------------------------------------------


def least_squares(count: int = 108) -> Iterator[Input]:
    from campaigns.least_squares import KINDS, Exact, complaint, draw

    exact = cache(lambda number: Exact(small(number)))

    def small(number: int) -> Any:
        return draw(KINDS[number % len(KINDS)], np.random.default_rng([SEED, number]))

    def ask(case: Any) -> Any:
        kept = {"weights": case.weights, "ridge": case.ridge}
        return solve(BoundedLeastSquares(case.A, case.b, case.lower, case.upper, **kept))

    def judge(number: int, case: Any, result: Any) -> str:
        if not result.is_solved:
            return OPEN
        return FALSE if complaint(case, exact(number), result.x) == "FALSE" else SOLVED

    for number in range(count):
        yield Input(
            "least squares", str(number), partial(small, number), ask, partial(judge, number)
        )


def cones(count: int = 60) -> Iterator[Input]:
    """Yield contacts with friction and convex problems over cones, with known solutions."""
    from cone_families import exact_relative_residual, planted_cones, planted_contacts

    def state(case: int) -> Any:
        rng = np.random.default_rng([SEED, case])
        if case % 4 == 0:
            return planted_cones(int(rng.integers(1, 9)), rng, rank=float(rng.choice([0.4, 1.0])))[
                0
            ]
        contacts, bodies = ((1, 1), (4, 2), (10, 5))[rng.integers(3)]
        ratio = 10.0 ** rng.uniform(0.0, 5.0)
        return planted_contacts(contacts, bodies, ratio, rng, definite=rng.random() < 0.3)[0]

    def judge(problem: Any, result: Any) -> str:
        if not result.is_solved:
            return OPEN
        return (
            FALSE
            if problem.n <= 30 and exact_relative_residual(problem, result.z) > 1e-8
            else SOLVED
        )

    for case in range(count):
        yield Input("cones", str(case), partial(state, case), solve, judge)


def by_cones(problem: Any, result: Any) -> str:
    """Judge impulses by the projections of r − ρ (u + μ ‖u_T‖ n) on the cones of friction."""
    if not result.is_solved:
        return OPEN
    r, mu = result.z.reshape(-1, 3), np.broadcast_to(problem.friction, (result.z.size // 3,))
    u = (problem.W @ result.z + problem.q).reshape(-1, 3)
    rho = 1.0 / np.maximum(problem.W.diagonal().reshape(-1, 3).max(axis=1), 1e-300)
    pushed = r - rho[:, None] * np.column_stack(
        [u[:, 0] + mu * np.linalg.norm(u[:, 1:], axis=1), u[:, 1:]]
    )
    normal, tangent = pushed[:, 0], np.linalg.norm(pushed[:, 1:], axis=1)
    is_inside, is_polar = tangent <= mu * normal, mu * tangent <= -normal
    length = np.where(
        is_inside, normal, np.where(is_polar, 0.0, (normal + mu * tangent) / (1.0 + mu**2))
    )
    share = np.where(
        is_inside,
        1.0,
        np.divide(mu * length, tangent, out=np.zeros_like(tangent), where=tangent > 0),
    )
    nearest = np.column_stack([length, share[:, None] * pushed[:, 1:]])
    return SOLVED if np.abs(r - nearest).max() <= LOOSE * max(np.abs(r).max(), 1e-12) else FALSE


def published_contacts() -> Iterator[Input]:
    """Contacts with friction of the Siconos collection."""

    def state(file: Path) -> FrictionalContact:
        with np.load(file) as f:
            W = sp.csr_array((f["data"], f["indices"], f["indptr"]), shape=tuple(f["shape"]))
            return FrictionalContact(W, f["q"], f["mu"])

    for file in sorted(DATA.glob("fc3d_*.npz")):
        yield Input("published contacts", file.stem, partial(state, file), solve, by_cones)


def moving_piles(count: int = 30, steps: int = 90, every: int = 3) -> Iterator[Input]:
    """Yield steps of poured spheres from the previous impulses, checked by their projections."""
    from benchmarks.cones import Pile

    pile, kept = Pile(count), dict[Any, Any]()
    for step in range(steps):
        problem, rows, pairs = pile.contacts()
        start = np.concatenate([kept.get(pair, np.zeros(3)) for pair in pairs])
        result = solve(problem, z0=start)
        kept = dict(zip(pairs, result.z.reshape(-1, 3), strict=True))
        pile.move(rows, result.z)
        if step % every == 0:
            yield Input(
                "piles in time",
                str(step),
                partial(deepcopy, problem),
                lambda problem, start=start: solve(problem, z0=start),
                by_cones,
            )


def nonlinear(count: int = 30) -> Iterator[Input]:
    from nonlinear_families import KINDS, planted

    def state(case: int) -> Any:
        rng = np.random.default_rng([SEED, case])
        one = planted(rng, KINDS[case % len(KINDS)], round(2 * 15 ** rng.random()))
        return one, np.zeros(one.x.size) if rng.random() < 0.5 else rng.standard_normal(one.x.size)

    def judge(stated: Any, result: Any) -> str:
        if not result.is_solved:
            return OPEN
        left = stated[0].sharp_relative_residual(
            result.z, result.certificate.problem.residual_scale
        )
        return FALSE if left > 1e-8 else SOLVED

    for case in range(count):
        yield Input(
            "nonlinear",
            str(case),
            partial(state, case),
            lambda stated: solve_nonlinear(stated[0].problem, stated[1]),
            judge,
        )


SOURCES: dict[str, Callable[[], Iterator[Input]]] = {
    "applications": applications,
    "collection": collection,
    "published LCPs": published_lcps,
    "small LCPs": small_lcps,
    "plain structures": plain_structures,
    "obstacles": obstacles,
    "marches": marches,
    "paths": paths,
    "batches": batches,
    "published programs": published_programs,
    "planted programs": planted_programs,
    "outliers": outliers,
    "certify": certified,
    "equilibria": equilibria,
    "least squares": least_squares,
    "cones": cones,
    "published contacts": published_contacts,
    "piles in time": moving_piles,
    "nonlinear": nonlinear,
}


def inputs(sources: Container[str] = SOURCES) -> Iterator[Input]:
    """Yield all inputs of these sources, of all."""
    for source, made in SOURCES.items():
        if source in sources:
            yield from made()
