"""Contact with friction as it is: answers from scratch and warm steps in time, beside pyramids and Siconos.

Siconos (Debian's python3-siconos) runs in the system's Python, or in SICONOS_PYTHON, where that has it: its block
Gauss–Seidel on a sparse W, and its Alart–Curnier Newton on a sparse or a dense one, whichever serves it better, each to
the same tolerance of its own criterion. Whether its answers hold is what it says itself; beside that stands how large
their residual is here.
``FILE.npz …`` in place of planted problems; ``--plot FILE.png`` draws the performance profile.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import scipy.sparse as sp
from cone_families import planted_contacts, wall
from scipy.spatial import cKDTree

from lcp_plugin import LCP, FrictionalContact, derivative, load_problem, solve, solve_batch
from lcp_plugin.core.errors import UnreadableFile
from lcp_plugin.problems.cones.stack import ConeStack
from lcp_plugin.problems.cones.sweeps import sweeps
from lcp_plugin.problems.contact import contact_data

TOLERANCE, RATIOS = 1e-8, (1.0, 2.0, 5.0, 10.0)
SYSTEM_PYTHON, LIMIT = os.environ.get("SICONOS_PYTHON", "/usr/bin/python3"), 60.0  # s
SICONOS = ("NSGS", "NSN_AC")
#: Seconds, ∞ where it is not solved; and our relative residual.
Outcome = tuple[float, float]


def run(
    *, quick: bool = False, files: Sequence[str] = (), plot: str | None = None
) -> Iterator[str]:
    """Yield a line for each size or file, for the profile, and for a pile in time."""
    ways: dict[str, Callable[[FrictionalContact], Outcome]] = {"auto": _ours}
    if not files:
        ways["pyramids of 8 edges"] = _pyramids
    if has_siconos():
        ways |= {f"Siconos {name}": partial(siconos_answer, name) for name in SICONOS}
    else:
        yield f"without Siconos: {SYSTEM_PYTHON} has no siconos; apt-get install python3-siconos"
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for label, problems in _of_files(files) if files else _planted(quick=quick):
        found = {name: [way(problem) for problem in problems] for name, way in ways.items()}
        told = []
        for name, outcomes in found.items():
            own = [taken for taken, _ in outcomes]
            seconds[name] += own
            worst = max(one for _, one in outcomes)
            told.append(f"{name} {1e3 * statistics.median(own):.2f} ms (residual {worst:.0e})")
        yield f"{label}: {', '.join(told)}"
    least = [min(own) for own in zip(*seconds.values(), strict=True)]
    for name, own in seconds.items():
        shares = [
            np.mean([mine <= ratio * best < np.inf for mine, best in zip(own, least, strict=True)])
            for ratio in RATIOS
        ]
        within = ", ".join(
            f"{ratio:g} × {share:.0%}" for ratio, share in zip(RATIOS, shares, strict=True)
        )
        solved = np.isfinite(own)
        yield f"{name}: solved {solved.sum()} of {solved.size}, within so many times the quickest: {within}"
    rivals = [own for name, own in seconds.items() if name.startswith("Siconos")]
    if rivals:
        beside = [
            mine / min(one)
            for mine, *one in zip(seconds["auto"], *rivals, strict=True)
            if mine < np.inf and min(one) < np.inf
        ]
        yield (
            f"geometric mean of auto / the quicker of Siconos's two, where both have an answer ({len(beside)}): "
            f"{float(np.exp(np.mean(np.log(beside)))):.2f}"
        )
    if plot is not None:
        _draw(seconds, least, plot)
        yield f"performance profile: {plot}"
    if not files:
        for count, steps in ((8, 10),) if quick else ((30, 1000), (100, 200)):
            yield _pile(count, steps)
        yield _walls((2,) if quick else (4, 8, 10))
        yield _batch(200 if quick else 10_000)


def _planted(*, quick: bool) -> Iterator[tuple[str, list[FrictionalContact]]]:
    for count, bodies in ((4, 2), (10, 5)) if quick else ((4, 2), (10, 5), (30, 15), (100, 50)):
        yield (
            f"{count} contacts",
            [
                planted_contacts(count, bodies, 10.0, np.random.default_rng(seed), most=1.0)[0]
                for seed in range(2 if quick else 10)
            ],
        )


def _of_files(files: Sequence[str]) -> Iterator[tuple[str, list[FrictionalContact]]]:
    for name in files:
        if not Path(name).is_file():
            raise UnreadableFile(
                f"{name} is no file; give .npz files of contacts, or none for planted problems"
            )
        problem: Any = load_problem(name)
        yield f"{Path(name).stem} ({problem.slope.size} contacts)", [problem]


def _timed(made: Callable[[], Any]) -> Outcome:
    """Return the least seconds of three solutions, of a long one those of one, after one that loads.

    Each is of a problem made anew, before the clock runs, as Siconos' are.
    """
    seconds: list[float] = []
    solve(made(), tolerance=TOLERANCE)
    while len(seconds) < 3 and not any(one > 0.5 for one in seconds):
        problem = made()
        began = time.perf_counter()
        result = solve(problem, tolerance=TOLERANCE)
        seconds.append(time.perf_counter() - began)
    return (min(seconds) if result.is_solved else np.inf), result.certificate.relative_residual


def _ours(problem: FrictionalContact) -> Outcome:
    return _timed(partial(FrictionalContact, problem.W, problem.b, problem.friction))


def _pyramids(problem: FrictionalContact) -> Outcome:
    b = problem.b.reshape(-1, 3)
    return _timed(partial(LCP.from_contacts, problem.W, problem.friction, b, directions=8))


@cache
def has_siconos() -> bool:
    """Return whether the system's Python has Siconos."""
    asked = [SYSTEM_PYTHON, "-c", "import siconos.numerics, scipy"]
    try:
        return subprocess.run(asked, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def siconos_answer(name: str, problem: FrictionalContact, start: Any = None) -> Outcome:
    """Return what Siconos makes of a problem, from a start or from 0, in a process of its own."""
    with TemporaryDirectory() as folder:
        source, target = Path(folder) / "problem.npz", Path(folder) / "answer.npz"
        W = sp.csc_array(problem.rows.csr)
        matrix = {"data": W.data, "indices": W.indices, "indptr": W.indptr, "shape": W.shape}
        start = np.zeros(problem.n) if start is None else start
        np.savez(source, **matrix, b=problem.b, mu=problem.friction, start=start)
        script = str(Path(__file__).with_name("siconos_contacts.py"))
        try:
            subprocess.run(
                [SYSTEM_PYTHON, script, str(source), name, str(TOLERANCE), str(target)],
                capture_output=True,
                check=True,
                timeout=LIMIT,
            )
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
            return np.inf, np.nan
        answer = np.load(target)
    r = answer["r"]
    if not np.isfinite(r).all():
        return np.inf, np.nan
    judged = solve(problem, z0=r, max_iterations=0, tolerance=TOLERANCE).certificate
    return (float(answer["seconds"]) if answer["is_solved"] else np.inf), judged.relative_residual


def _draw(seconds: dict[str, list[float]], least: list[float], target: str) -> None:
    """Draw which share of the problems each way solves within a multiple of the quickest's time."""
    import matplotlib.pyplot as plt

    from lcp_plugin.evidence.drawing import STYLE

    plt.style.use(STYLE)
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    ratios = {
        name: [
            mine / best if best < np.inf else np.inf for mine, best in zip(own, least, strict=True)
        ]
        for name, own in seconds.items()
    }
    end = 1.3 * max((one for own in ratios.values() for one in own if one < np.inf), default=1.0)
    for name, own in ratios.items():
        steps = np.sort(own)
        shares = np.arange(1, steps.size + 1) / steps.size
        is_in = steps < np.inf
        x = np.concatenate([[1.0], steps[is_in], [end]])
        y = np.concatenate([[0.0], shares[is_in], [shares[is_in][-1] if is_in.any() else 0.0]])
        axes.step(x, y, where="post", label=name)
    axes.set(
        xscale="log",
        xlim=(1.0, end),
        ylim=(0.0, 1.03),
        xlabel="seconds ÷ those of the quickest",
        ylabel="share of the problems solved",
        title=f"Contact with friction, tolerance {TOLERANCE:g}",
    )
    axes.legend(loc="lower right")
    figure.savefig(target, dpi=150)
    plt.close(figure)


def _pile(count: int, steps: int) -> str:
    """Return what a step of 10 ms costs of spheres that are poured into a box, each begun where the last one ended.

    Beside it stand 50 sweeps of projected Gauss–Seidel from the same start, as engines for games take them.
    """
    pile, seconds, unsolved, kept = Pile(count), list[float](), 0, dict[Any, Any]()
    swept = list[tuple[float, float]]()
    for _ in range(steps):
        problem, rows, pairs = pile.contacts()
        start = np.concatenate([kept.get(pair, np.zeros(3)) for pair in pairs])
        began = time.perf_counter()
        result = solve(problem, z0=start, max_seconds=2.0)
        seconds.append(time.perf_counter() - began)
        unsolved += not result.is_solved
        swept.append(fifty_sweeps(problem, start, time.perf_counter))
        kept = dict(zip(pairs, result.z.reshape(-1, 3), strict=True))
        pile.move(rows, result.z)
    slow = sum(one > Pile.step for one in seconds)
    median = statistics.median(seconds)
    late = sum(one > 3.0 * median for one in seconds)
    sweep, residual = map(statistics.median, zip(*swept, strict=True))
    return (
        f"{count} spheres poured into a box, {steps} steps of 10 ms, {len(pairs)} contacts at the end: "
        f"{1e3 * median:.2f} ms a warm step, {max(seconds):.2g} s at the most, {late} later than 3 × the median, "
        f"{slow} than 10 ms, {unsolved} unsolved; 50 sweeps {1e3 * sweep:.2f} ms, to a residual of {residual:.0e}"
    )


def _walls(sizes: Sequence[int]) -> str:
    """Return what walls of bricks cost from nothing: four contacts a face, many times what the bricks determine."""
    told = []
    for size in sizes:
        problem = wall(size, size)[0]
        seconds, residual = _ours(problem)
        told.append(
            f"{problem.slope.size} contacts {1e3 * seconds:.0f} ms (residual {residual:.0e})"
        )
    return f"walls of bricks from nothing: {', '.join(told)}"


def fifty_sweeps(problem: FrictionalContact, start: Any, clock: Any) -> tuple[float, float]:
    """Return the seconds of 50 sweeps from a start, and the residual that they leave."""
    stack = ConeStack.of(problem)
    z = stack.pattern.wide(problem.projected(start)[None])
    began = clock()
    *_, z = sweeps(stack, z, 50, 0.0)
    return clock() - began, float(stack.measured(z)[2][0])


class Pile:
    """Spheres of 10 cm in a box with friction, in steps of 10 ms (Moreau, Jean), their contacts by a tree."""

    step, radius, slop = 0.01, 0.1, 1e-5  # s, m, m: what is nearer is closed

    def __init__(self, count: int) -> None:
        side = max(2, round(count ** (1 / 3) * 0.9))
        place = np.arange(count)
        grid = np.column_stack(
            [
                place % side - 0.5 * (side - 1),
                place // side % side - 0.5 * (side - 1),
                place // side**2 + 0.7,
            ]
        )
        noise = np.random.default_rng(0).uniform(-0.08, 0.08, grid.shape)
        self.at, self.half = self.radius * (2.2 * grid + noise), 1.25 * self.radius * side
        mass = 4000.0 / 3.0 * np.pi * self.radius**3
        self.mass = np.tile(mass * np.repeat([1.0, 0.4 * self.radius**2], 3), count)
        self.velocities = np.zeros(6 * count)

    @property
    def free(self) -> Any:
        """Velocities without contacts."""
        return self.velocities - np.tile(9.81 * self.step * np.eye(6)[2], len(self.at))

    def contacts(self) -> tuple[FrictionalContact, Any, list[Any]]:
        """Return the problem, its rows J, and which bodies touch: of walls negative numbers."""
        reach = min(0.06, 0.02 + 2.0 * self.step * np.abs(self.velocities).max())
        pairs = cKDTree(self.at).query_pairs(2.0 * self.radius + reach, output_type="ndarray")
        apart = self.at[pairs[:, 0]] - self.at[pairs[:, 1]]
        length = np.linalg.norm(apart, axis=1)
        parts = [(pairs[:, 0], pairs[:, 1], apart / length[:, None], length - 2.0 * self.radius)]
        walls = np.vstack([np.eye(3)[[2, 0, 1]], -np.eye(3)[:2]])
        for number, (normal, away) in enumerate(zip(walls, [0.0, *[self.half] * 4], strict=True)):
            gap = self.at @ normal + away - self.radius
            near = np.flatnonzero(gap < reach)
            parts.append(
                (near, np.full(near.size, -1 - number), np.tile(normal, (near.size, 1)), gap[near])
            )
        one, other, n, gaps = (np.concatenate(part) for part in zip(*parts, strict=True))
        t = np.cross(n, np.where(np.abs(n[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
        t /= np.linalg.norm(t, axis=1)[:, None]
        ways = np.stack([n, t, np.cross(n, t)], axis=1)
        arms = np.cross(-self.radius * n[:, None], ways)  # of both spheres the same
        sides = np.where(other >= 0, 1.0, 0.0)[:, None, None]
        rows = np.concatenate([ways, arms, -sides * ways, sides * arms], axis=2)
        places = 6 * np.stack([one, np.maximum(other, 0)], axis=1)[:, None, :, None] + np.arange(6)
        columns = np.broadcast_to(places, (len(n), 3, 2, 6))
        J = sp.csr_array(
            (rows.ravel(), columns.ravel(), np.arange(0, rows.size + 1, 12)),
            shape=(3 * len(n), self.mass.size),
        )
        J.sum_duplicates()  # of walls
        b = (J @ self.free).reshape(-1, 3)
        b[:, 0] += np.where(gaps > self.slop, gaps, 0.0) / self.step
        tangents = np.arange(J.shape[0]) % 3 > 0
        contacts = sp.csr_array(sp.diags_array(self.mass)), J[~tangents], J[tangents]
        return FrictionalContact.from_contacts(contacts, 0.5, b), J, [*zip(one, other, strict=True)]

    def move(self, rows: Any, impulses: Any) -> None:
        """Take the step."""
        self.velocities = self.free + rows.T @ impulses / self.mass
        self.at = self.at + self.step * self.velocities.reshape(-1, 6)[:, :3]


def _batch(count: int) -> str:
    """Return what an item of a batch of 4 contacts costs, beside pyramids of 4 and of 8 edges, on one thread."""
    rng = np.random.default_rng(0)
    J = rng.standard_normal((count, 12, 6))
    W, b = J @ np.swapaxes(J, 1, 2) + 0.05 * np.eye(12), rng.standard_normal((count, 4, 3))
    mu = rng.uniform(0.0, 1.0, (count, 4))
    b[:, :, 0] -= 0.5
    problems = [FrictionalContact(*one) for one in zip(W, b, mu, strict=True)]
    pyramids = [contact_data(W, mu, b, directions=edges).arrays for edges in (4, 8)]
    ways = [partial(solve_batch, problems), *(partial(solve_batch, *arrays) for arrays in pyramids)]
    seconds: list[list[float]] = [[], [], []]
    for _ in range(4):  # the first loads
        for own, way in zip(seconds, ways, strict=True):
            began = time.perf_counter()
            found = way(threads=1)
            own.append(time.perf_counter() - began)
            assert found.all_solved
    cones, four, eight = (min(own[1:]) for own in seconds)
    return (
        f"{count} problems of 4 contacts: {1e6 * cones / count:.0f} µs each, {cones / four:.1f} times pyramids of "
        f"4 edges, {cones / eight:.1f} of 8\n{_worlds(W, b.reshape(count, -1), mu)}"
    )


def _worlds(W: Any, b: Any, mu: Any) -> str:
    """Return what a warm solve of worlds in arrays costs and their gradient, on one thread and on two, medians of five.

    Turns alternate, so that what else runs strikes both alike.
    """
    worlds, moved = FrictionalContact(W, b, mu), FrictionalContact(W, 1.001 * b, mu)
    start = solve_batch(worlds).require_solved().z
    seconds: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
    for _ in range(6):  # the first loads
        for threads, own in seconds.items():
            began = time.perf_counter()
            batch = solve_batch(moved, z0=start, threads=threads)
            solved = time.perf_counter()
            assert derivative(batch).vjp(batch.z).M.shape == W.shape
            own.append((solved - began, time.perf_counter() - solved))
    told = []
    for threads, own in seconds.items():
        solve_ms, gradient_ms = 1e3 * np.median(own[1:], axis=0)
        told.append(f"{threads} thread(s) {solve_ms:.0f} ms, gradient {gradient_ms:.0f} ms")
    return f"{len(W)} worlds in arrays, warm: {'; '.join(told)}"
