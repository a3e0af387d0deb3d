"""Small and medium problems: what a call costs, and auto beside compiled rivals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from paper_tables import iterated

from lcp_plugin.algorithms import create
from lcp_plugin.api import solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.settings import Status
from lcp_plugin.gallery import build
from lcp_plugin.problems.batches.batch import solve_batch
from lcp_plugin.problems.batches.batch_run import BatchResult
from lcp_plugin.problems.programs.stacked_programs import QuadraticProgramBatch
from lcp_plugin.problems.sensitivity import derivative

from .rivals import RIVALS, SEED, Case, Solver, contact, obstacle, spectrum
from .timing import medians

BEHIND = ("compiled Lemke", "PIQP dense", "DAQP", "compiled PGS")
ARRIVED = 1e-6  # natural residual beside that of z°: a rival that stays above has failed
REPEATS = 9


@dataclass(frozen=True)
class Row:
    """A line of the table: problems of one kind, solved one after the other."""

    name: str
    cases: Sequence[Case]
    rivals: Sequence[str] = ("compiled Lemke", "PIQP dense", "DAQP")

    def problems(self) -> list[LCP]:
        """Return them as LCPs."""
        return [LCP(case.M, case.q, lower=case.lower, upper=case.upper) for case in self.cases]


def friction(contacts: int, seed: int = SEED) -> Case:
    """Return contacts between bodies with Coulomb friction on a pyramid of four edges: 6 unknowns a contact.

    The matrix is copositive, neither symmetric nor semidefinite, and has rows without a diagonal entry.

    References
    ----------
    Stewart, Trinkle 1996, doi:10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I
    """
    rng = np.random.default_rng(seed)
    bodies, m = max(1, contacts // 2), 5 * contacts
    J = np.zeros((m, 6 * bodies))
    for c in range(contacts):
        normal = np.array([0.0, 0.0, 1.0]) + 0.2 * rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        first = np.cross(normal, [1.0, 0.0, 0.0])
        first /= np.linalg.norm(first)
        second, arm = np.cross(normal, first), rng.standard_normal(3)
        pairs = ((int(rng.integers(bodies)), 1.0), (int(rng.integers(bodies)), -1.0))
        for body, sign in pairs[: 1 if pairs[0][0] == pairs[1][0] else 2]:
            rows_of_contact = [c, *(contacts + 4 * c + np.arange(4))]
            for row, d in zip(
                rows_of_contact, (normal, first, second, -first, -second), strict=True
            ):
                J[row, 6 * body : 6 * body + 6] += sign * np.concatenate([d, np.cross(arm, d)])
    M = np.zeros((m + contacts, m + contacts))
    M[:m, :m] = (J * np.exp(0.5 * rng.standard_normal(6 * bodies))) @ J.T
    for c in range(contacts):
        edges = contacts + 4 * c + np.arange(4)
        M[m + c, c] = rng.uniform(0.1, 0.9)
        M[m + c, edges], M[edges, m + c] = -1.0, 1.0
    velocity = rng.standard_normal(6 * bodies)
    velocity[2::6] -= 2.0  # they fall
    return Case(
        f"friction n = {6 * contacts}", M, np.concatenate([J @ velocity, np.zeros(contacts)])
    )


def rows(*, quick: bool) -> Iterator[Row]:
    """Yield the lines of the table, smallest problems first."""
    few, scale = (2, 10) if quick else (20, 1)
    for n in (2, 10, 30) if quick else (2, 10, 30, 100):
        yield Row(f"dense SPD n = {n}, κ = 1e2", [spectrum(n, 1e2, 0.4, k) for k in range(few)])
    for condition in (1e6, 1e10):
        yield Row(
            f"dense SPD n = 30, κ = {condition:.0e}",
            [spectrum(30, condition, 0.4, k) for k in range(few)],
        )
    for contacts in (2, 5, 10):
        yield Row(
            f"friction n = {6 * contacts}",
            [friction(contacts, k) for k in range(few)],
            ("compiled Lemke",),
        )
    for contacts in (100 // scale, 200 // scale):
        yield Row(f"friction n = {6 * contacts}", [friction(contacts)], ("compiled Lemke",))
    for n in (152 // scale, 548 // scale):
        yield Row(f"contact n = {n}, rank-deficient", [contact(n)])
    yield Row("sparse H₊ n = 200", [obstacle(200)], BEHIND)
    for n in (200 // scale, 1000 // scale):
        yield Row(f"dense SPD n = {n}, κ = 1e8", [spectrum(n, 1e8, 0.4)])
    yield Row(f"PSD n = {200 // scale}, rank-deficient", [contact(200 // scale, 7)])
    if not quick:
        for scene, options in (("american_put", {"size": 10_000}), ("obstacle_3d", {"size": 31})):
            yield Row(scene, [_of_scene(scene, **options)], ("compiled PGS",))


def _of_scene(name: str, **options: Any) -> Case:
    problem = build(name, **options).problem
    return Case(name, problem.csr, np.array(problem.q), problem.lower, problem.upper)


def _lemke(case: Case, precision: float, limit: float) -> tuple[Any, str]:
    lemke: Any = import_module("quantecon.optimize.lcp_lemke")
    return lemke.lcp_lemke(case.dense, case.q).z, ""


COMPILED_LEMKE = Solver("quantecon", _lemke)


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield what a call costs, the table, and batches."""
    rivals = {"compiled Lemke": COMPILED_LEMKE} | RIVALS
    rivals = {
        name: one
        for name, one in rivals.items()
        if name in BEHIND and find_spec(one.package) is not None
    }
    for name in set(BEHIND) - rivals.keys():
        yield f"{name} is not installed and left out"
    repeats = 2 if quick else REPEATS
    yield from _calls(repeats)
    first, behind, count = 0, 0.0, 0
    for row in rows(quick=quick):
        seconds, failures = _measured(row, rivals, repeats)
        own = seconds["auto"]
        others = {name: seconds[name] / own for name in rivals if name in seconds}
        told = ", ".join(f"{name} {ratio:.2f}" for name, ratio in others.items())
        failed = (
            "; failed: " + ", ".join(f"{name} {k}" for name, k in failures.items())
            if failures
            else ""
        )
        yield f"{row.name:<32} auto {1e6 * own / len(row.cases):10.1f} µs; ÷ auto: {told}{failed} (of {len(row.cases)})"
        count += 1
        first += not others or min(others.values()) >= 1.0
        behind = max([behind, *(1.0 / ratio for ratio in others.values())])
    yield f"first on {first} of {count}, at most {behind:.2f} × behind a rival   target half, ≤ 2 ×"
    yield from _batches(repeats, rivals, 200 if quick else 10_000)
    yield _programs(repeats, 200 if quick else 10_000)


def _calls(repeats: int) -> Iterator[str]:
    """Yield what one warm call costs, from an LCP and from arrays."""
    example = build("paper_example_1", n=100)
    paper = create("npsor", {"scaling": None})
    case = spectrum(10, 1e2, 0.4)
    problem = LCP(case.M, case.q)
    calls: dict[str, Callable[[], Any]] = {
        f"{name}, dense n = 10": partial(solve, problem, name)
        for name in ("auto", "newton", "lemke", "psor")
    }
    calls["auto, dense n = 10, from arrays"] = lambda: solve(LCP(case.M, case.q))
    calls["npsor, Example 1, n = 100, to the paper's Res < 1e-5"] = partial(
        iterated, example.problem, example.start, paper
    )
    for name, seconds in medians(calls, 50 * repeats).items():
        yield f"{name}: {1e6 * seconds:.0f} µs"


def _measured(
    row: Row, rivals: dict[str, Solver], repeats: int
) -> tuple[dict[str, float], dict[str, int]]:
    """Return the median seconds of auto and of each rival that solves any, and how many are left unsolved."""
    problems = row.problems()
    calls: dict[str, Callable[[], Any]] = {"auto": partial(_solved, problems)}
    unsolved = sum(not solve(problem).is_solved for problem in problems)
    failures = {"auto": unsolved} if unsolved else {}
    for name in (name for name in row.rivals if name in rivals):
        unsolved = sum(not _arrives(rivals[name], case) for case in row.cases)
        if unsolved < len(row.cases):
            calls[name] = partial(_asked, rivals[name], row.cases)
        if unsolved:
            failures[name] = unsolved
    return medians(calls, repeats), failures


def _solved(problems: Sequence[LCP]) -> None:
    for problem in problems:
        solve(problem)


def _asked(solver: Solver, cases: Sequence[Case]) -> None:
    for case in cases:
        solver.ask(case, 1e-9, 20.0)


def _arrives(solver: Solver, case: Case) -> bool:
    try:
        z: FloatVector = solver.answer(case, 1e-9)[0]
    except Exception:  # a rival's own error, of whatever class, is a result
        return False
    start = np.clip(np.zeros(case.q.size), case.lower, case.upper)
    return case.residual(z) <= ARRIVED * case.residual(start)


def _batches(repeats: int, rivals: dict[str, Solver], count: int) -> Iterator[str]:
    """Yield what a problem of a batch costs, on one thread and on two, beside the compiled Lemke in a loop."""
    definite = [(f"SPD n = {n}", partial(spectrum, n, 1e2, 0.4)) for n in (10, 30, 100)]
    rough = [
        (f"friction n = {6 * contacts}", partial(friction, contacts)) for contacts in (2, 5, 10)
    ]
    for name, kind in (*definite, *rough):
        cases = [kind(k) for k in range(count if "100" not in name else count // 10)]
        M, q = np.array([case.M for case in cases]), np.array([case.q for case in cases])
        calls: dict[str, Callable[[], Any]] = {
            "one": partial(solve_batch, M, q, threads=1),
            "two": partial(solve_batch, M, q, threads=2),
        }
        if "compiled Lemke" in rivals:
            calls["rival"] = partial(_asked, COMPILED_LEMKE, cases)
        batch = solve_batch(M, q, threads=1)
        unsolved = sum(status is not Status.SOLVED for status in batch.status)
        if name.startswith("SPD"):  # others have rows at a kink, or no solution
            calls["gradients"] = partial(_gradients, batch)
            calls["matrices too"] = partial(_gradients, batch, of_matrices=True)
        seconds = medians(calls, max(repeats // 3, 1))
        told = (
            f"÷ compiled Lemke {seconds['one'] / seconds['rival']:.2f}, "
            if "rival" in seconds
            else ""
        )
        yield (
            f"batch of {len(cases)} {name}: {1e6 * seconds['one'] / len(cases):.2f} µs a problem, {told}"
            f"two threads {seconds['one'] / seconds['two']:.2f} × faster, {unsolved} unsolved"
        )
        if "gradients" in seconds:
            ratio, with_M = (
                seconds[name] / seconds["one"] for name in ("gradients", "matrices too")
            )
            yield f"their gradients by q and the bounds ÷ solving: {ratio:.2f}, by M too {with_M:.2f}   target ≤ 1 ×"


def _programs(repeats: int, count: int, n: int = 10, m: int = 20) -> str:
    """Return what a strictly convex program of a batch costs, on one thread and on two, beside loops over rivals."""
    rng = np.random.default_rng(SEED)
    factor, G, x = (
        rng.standard_normal(shape) for shape in ((count, n, n + 5), (count, m, n), (count, n))
    )
    P, c = (
        factor @ factor.transpose(0, 2, 1) / n + 0.01 * np.eye(n),
        rng.standard_normal((count, n)),
    )
    h = np.einsum("kij,kj->ki", G, x) + rng.random((count, m)) * (rng.random((count, m)) < 0.7)

    def ours(threads: int) -> Any:
        return solve_batch(QuadraticProgramBatch(P, c, G, h), threads=threads)

    def daqp() -> None:
        solver, none, sense = import_module("daqp"), np.full(m, -1e30), np.zeros(m, dtype=np.int32)
        for k in range(count):
            solver.solve(P[k], c[k], G[k], h[k], none, sense)

    def piqp() -> None:
        module, none = import_module("piqp"), np.full(m, -np.inf)
        for k in range(count):
            solver = module.DenseSolver()
            solver.setup(P[k], c[k], None, None, G[k], none, h[k], None, None)
            solver.solve()

    calls: dict[str, Callable[[], Any]] = {"one": partial(ours, 1), "two": partial(ours, 2)}
    calls |= {
        name: loop for name, loop in (("daqp", daqp), ("piqp", piqp)) if find_spec(name) is not None
    }
    seconds, answers = medians(calls, max(repeats // 3, 1)), ours(1)
    told = "".join(
        f"÷ {name} in a loop {seconds['one'] / seconds[name]:.2f}, "
        for name in calls
        if "qp" in name
    )
    return (
        f"batch of {count} programs n = {n}, m = {m}: {1e6 * seconds['one'] / count:.2f} µs a program, {told}"
        f"two threads {seconds['one'] / seconds['two']:.2f} × faster, "
        f"{int((answers.status != 'optimal').sum())} unsolved   target ≤ 10 µs"
    )


def _gradients(batch: BatchResult, *, of_matrices: bool = False) -> None:
    gradient = derivative(batch).vjp(np.ones(batch.z.shape))
    if of_matrices:
        gradient.M  # noqa: B018 - computed when it is looked at
