"""Quadratic programs, conversion and recovery included, next to PIQP and Clarabel on data in their own format.

Geometric means are printed for up to 2000 unknowns and constraints, and above. `run` takes files too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import solve
from lcp_plugin.interfaces.program_files import load_program
from lcp_plugin.problems.programs.criterion import QPSolution
from lcp_plugin.problems.programs.program import QuadraticProgram

from .timing import rounds, timed

SEED = 5
SMALL = 2000  # unknowns and constraints
OPTIMAL = 1e-6
SECONDS, MOST_ROUNDS = 0.5, 15  # of each call, about
RIVALS = ("piqp", "clarabel")
Outcome = tuple[str, float, dict[str, float]]  # name, size and the quickest run of each solver


@dataclass(frozen=True)
class Case:
    """A program by its data: every run begins with nothing known of it."""

    name: str
    data: tuple[Any, ...]
    is_dense: bool = False

    @property
    def size(self) -> int:
        """Unknowns and constraints."""
        program = self.program()
        return int(program.n + program.h.size + program.b.size)

    def program(self) -> QuadraticProgram:
        """Return the program, freshly made."""
        return QuadraticProgram(*self.data)


def cases(*, quick: bool) -> Iterator[Case]:
    """Yield random programs of every kind, from 20 unknowns to some thousands."""
    rng = np.random.default_rng(SEED)
    for n in (20,) if quick else (20, 100, 500, 3000):
        yield sparse(n, rng)
        yield linear(n, rng)
    for n in (30,) if quick else (30, 100, 300):
        yield dense(n, rng)
        yield support_vectors(n, rng)
    for assets, factors in ((50, 5),) if quick else ((50, 5), (300, 15), (2000, 40)):
        yield portfolio(assets, factors, rng)
    for horizon, growth in ((5, 1.0),) if quick else ((10, 0.9), (20, 1.0), (40, 1.1), (150, 1.0)):
        yield controller(horizon, growth, rng)
    for n in (20,) if quick else (200, 5000):
        yield chain(n, rng)


def sparse(n: int, rng: np.random.Generator) -> Case:
    """Return a sparse program with equations, inequalities and bounds, P of half the rank."""
    factor = sp.random_array((n, n // 2), density=min(1.0, 3.0 / n), rng=rng)
    G, A = (
        sp.random_array((m, n), density=min(1.0, 4.0 / n), rng=rng, format="csr")
        for m in (n // 2, n // 4)
    )
    x = rng.random(n)
    h = G @ x + rng.random(n // 2) * (rng.random(n // 2) < 0.5)
    return Case(
        f"sparse {n}",
        (sp.csr_array(factor @ factor.T), rng.standard_normal(n), G, h, A, A @ x, 0.0, 1.0),
    )


def linear(n: int, rng: np.random.Generator) -> Case:
    """Return a linear program."""
    G = sp.random_array((n // 2, n), density=min(1.0, 5.0 / n), rng=rng, format="csr")
    h = G @ rng.random(n) + 0.1
    return Case(
        f"linear {n}", (sp.csr_array((n, n)), rng.standard_normal(n), G, h, None, None, 0.0, 2.0)
    )


def dense(n: int, rng: np.random.Generator) -> Case:
    """Return a dense, strictly convex program with n/2 inequalities, n/10 equations and lower bounds."""
    factor, G, A = (rng.standard_normal(shape) for shape in ((n, n + 5), (n // 2, n), (n // 10, n)))
    x = rng.random(n)
    P = factor @ factor.T / n + 0.01 * np.eye(n)
    return Case(
        f"dense {n}",
        (P, rng.standard_normal(n), G, G @ x + 0.1, A, A @ x, 0.0, np.inf),
        is_dense=True,
    )


def support_vectors(n: int, rng: np.random.Generator) -> Case:
    """Return the dual of a support vector machine with n points, a Gaussian kernel of their distances."""
    points, label = rng.standard_normal((n, 5)), np.where(rng.random(n) < 0.5, -1.0, 1.0)
    distance = ((points[:, None] - points) ** 2).sum(axis=2)
    P = label[:, None] * np.exp(-0.1 * distance) * label
    return Case(
        f"SVM {n}", (P, -np.ones(n), None, None, label[None], [0.0], 0.0, 1.0), is_dense=True
    )


def portfolio(assets: int, factors: int, rng: np.random.Generator) -> Case:
    """Return a portfolio of least risk and most return in a factor model, the factors' shares unknowns."""
    loads = sp.random_array(
        (factors, assets), density=0.5, rng=rng, data_sampler=rng.standard_normal
    )
    P = sp.block_diag([sp.diags_array(rng.random(assets) * factors**0.5), sp.eye_array(factors)])
    A = sp.vstack(
        [
            sp.hstack([loads, -sp.eye_array(factors)]),
            sp.csr_array(np.append(np.ones(assets), np.zeros(factors))[None]),
        ]
    )
    c = np.append(-rng.standard_normal(assets), np.zeros(factors))
    b = np.append(np.zeros(factors), 1.0)
    lower = np.append(np.zeros(assets), np.full(factors, -np.inf))
    return Case(
        f"portfolio {assets}", (sp.csr_array(P), c, None, None, sp.csr_array(A), b, lower, np.inf)
    )


def dynamics(
    growth: float, rng: np.random.Generator, states: int = 6, inputs: int = 2
) -> tuple[Any, Any]:
    """Return x' = F x + B u with a spectral radius of that size."""
    F = rng.standard_normal((states, states))
    return F * (growth / np.abs(np.linalg.eigvals(F)).max()), rng.standard_normal((states, inputs))


def controller(horizon: int, growth: float, rng: np.random.Generator) -> Case:
    """Return the plan of a controller: states and inputs over the horizon, inputs bounded."""
    F, B = dynamics(growth, rng)
    (states, inputs), steps = B.shape, np.eye(horizon)
    A = sp.hstack(
        [
            sp.kron(steps, sp.eye_array(states)) - sp.kron(sp.eye_array(horizon, k=-1), F),
            -sp.kron(steps, sp.csr_array(B)),
        ]
    )
    b = np.append(F @ rng.standard_normal(states), np.zeros((horizon - 1) * states))
    P = sp.diags_array(np.repeat([1.0, 0.1], [horizon * states, horizon * inputs]))
    bound = np.repeat([10.0 if growth <= 1.0 else 1e3, 0.5], [horizon * states, horizon * inputs])
    return Case(
        f"control {horizon}",
        (sp.csr_array(P), np.zeros(bound.size), None, None, sp.csr_array(A), b, -bound, bound),
    )


def chain(n: int, rng: np.random.Generator) -> Case:
    """Return the convex sequence nearest to a noisy one."""
    x = np.linspace(-1.0, 1.0, n) ** 2 + 0.1 * rng.standard_normal(n)
    G = -sp.diags_array(
        [np.ones(n), np.full(n, -2.0), np.ones(n)], offsets=[0, 1, 2], shape=(n - 2, n)
    )
    return Case(
        f"convex sequence {n}",
        (sp.eye_array(n, format="csr"), -x, sp.csr_array(G), np.zeros(n - 2)),
    )


def from_file(path: str | Path) -> Case:
    """Return the program of a file."""
    one = load_program(path)[0]
    return Case(Path(path).stem, (one.P, one.c, one.G, one.h, one.A, one.b, one.lower, one.upper))


def ours(case: Case) -> QPSolution:
    """Return our answer, in README's way."""
    return solve(case.program()).solution  # type: ignore[no-any-return]


def run(*, quick: bool = False, files: Sequence[str | Path] = ()) -> Iterator[str]:
    """Yield a line a program, then the geometric means; of the files where there are any, else of random ones."""
    present = [name for name in RIVALS if find_spec(name) is not None]
    yield from (f"{name} is not installed and left out" for name in RIVALS if name not in present)
    outcomes: list[Outcome] = []
    for case in map(from_file, files) if files else cases(quick=quick):
        seconds, error = _measured(case, present, quick=quick)
        outcomes.append((case.name, case.size, seconds))
        ratios = "".join(f"   ÷ {name} {seconds['ours'] / seconds[name]:7.2f}" for name in present)
        note = "" if error <= OPTIMAL else f"   not solved: residual {error:.0e}"
        yield f"{case.name:<22} {case.size:>6} {seconds['ours']:>10.5f} s{ratios}{note}"
    yield from _means(outcomes, present)


def _means(outcomes: list[Outcome], present: Sequence[str]) -> Iterator[str]:
    for is_small, title in ((True, f"up to {SMALL} unknowns and constraints"), (False, "above")):
        chosen = [seconds for _, size, seconds in outcomes if (size <= SMALL) == is_small]
        for name in present if chosen else ():
            mean = np.exp(np.mean([np.log(one["ours"] / one[name]) for one in chosen]))
            yield f"{title}, {len(chosen)} programs: {mean:.2f} × {name}, geometric mean"


def _measured(case: Case, present: Sequence[str], *, quick: bool) -> tuple[dict[str, float], float]:
    """Return the quickest of some rounds, and the residual of our answer."""
    call, program = partial(ours, case), case.program()
    first = timed(call)
    repeats = 1 if quick else int(np.clip(SECONDS / first.seconds, 2, MOST_ROUNDS))
    every = rounds(
        {"ours": call} | {name: SETUPS[name](program, case.is_dense) for name in present},
        repeats,
        time.process_time,
    )
    seconds = {name: min(one.seconds for one in runs) for name, runs in every.items()}
    return seconds, first.answer.error


def _piqp(program: QuadraticProgram, is_dense: bool) -> Callable[[], Any]:
    """Return its set-up and solution, of data in its own format."""
    piqp: Any = import_module("piqp")
    kept: Callable[[Any], Any] = _as_dense if is_dense else sp.csc_matrix
    P, A, G = (kept(matrix) for matrix in (program.P, program.A, program.G))

    def call() -> Any:
        solver = piqp.DenseSolver() if is_dense else piqp.SparseSolver()
        solver.setup(
            P,
            program.c,
            A,
            program.b,
            G,
            np.full(program.h.size, -np.inf),
            program.h,
            program.lower,
            program.upper,
        )
        solver.solve()
        return solver.result.x

    return call


def _as_dense(matrix: Any) -> Any:
    return np.asfortranarray(matrix.toarray() if sp.issparse(matrix) else matrix)


def _clarabel(program: QuadraticProgram, is_dense: bool) -> Callable[[], Any]:
    """Return its set-up and solution, of data in its own format."""
    clarabel: Any = import_module("clarabel")
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    rows, (equal, most) = program.constraints, _finite_rows(program)
    listed = np.concatenate([equal, most])
    P, A = sp.triu(sp.csc_matrix(program.P), format="csc"), sp.csc_matrix(rows.matrix[listed])
    cones = [clarabel.ZeroConeT(equal.size), clarabel.NonnegativeConeT(most.size)]
    return lambda: (
        clarabel.DefaultSolver(P, program.c, A, rows.limit[listed], cones, settings).solve().x
    )


SETUPS: dict[str, Callable[[QuadraticProgram, bool], Callable[[], Any]]] = {
    "piqp": _piqp,
    "clarabel": _clarabel,
}


def _finite_rows(program: QuadraticProgram) -> tuple[Any, Any]:
    rows = program.constraints
    is_equality = rows.is_equality[rows.finite]
    return rows.finite[is_equality], rows.finite[~is_equality]
