"""Contact with exact friction cones: a batch; and the pile and Siconos, for ``piles``.

Siconos (Debian's python3-siconos), which ``piles`` compares with, runs in the system's Python, or in SICONOS_PYTHON,
if that has it: its block Gauss–Seidel and its Alart–Curnier Newton, each to the same tolerance of its own criterion.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from lcp_plugin import FrictionalContact, derivative, solve, solve_batch
from lcp_plugin.problems.cones.stack import ConeStack
from lcp_plugin.problems.cones.sweeps import sweep_blocks

from .timing import medians

TOLERANCE = 1e-8
SYSTEM_PYTHON, LIMIT = os.environ.get("SICONOS_PYTHON", "/usr/bin/python3"), 60.0  # s
SICONOS = ("NSGS", "NSN_AC")
#: Seconds, ∞ where it is not solved; and our relative residual.
Outcome = tuple[float, float]


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the line of a batch."""
    yield _batch(200 if quick else 4096)


@cache
def has_siconos() -> bool:
    """Return whether the system's Python has Siconos."""
    command = [SYSTEM_PYTHON, "-c", "import siconos.numerics, scipy"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
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


def fifty_sweeps(problem: FrictionalContact, start: Any, clock: Any) -> tuple[float, float]:
    """Return the seconds of 50 sweeps from a start, and the residual that they leave."""
    stack = ConeStack.of(problem)
    z = stack.pattern.wide(problem.project(start)[None])
    began = clock()
    z = sweep_blocks(stack, z, 50, 0.0)
    return clock() - began, stack.relative_residual(z)


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
        return FrictionalContact(contacts, b, 0.5), J, [*zip(one, other, strict=True)]

    def move(self, rows: Any, impulses: Any) -> None:
        """Take the step."""
        self.velocities = self.free + rows.T @ impulses / self.mass
        self.at = self.at + self.step * self.velocities.reshape(-1, 6)[:, :3]


def _batch(count: int) -> str:
    """Return what an item of a batch of 4 contacts costs from scratch, warm, and its gradient, on one thread."""
    rng = np.random.default_rng(0)
    J = rng.standard_normal((count, 12, 6))
    W, b = J @ np.swapaxes(J, 1, 2) + 0.05 * np.eye(12), rng.standard_normal((count, 12))
    b[:, ::3] -= 0.5
    mu = rng.uniform(0.0, 1.0, (count, 4))
    problems, moved = (FrictionalContact.worlds(W, t * b, mu) for t in (1.0, 1.001))
    start = solve_batch(problems).require_solved().z
    calls = {
        "from scratch": partial(solve_batch, problems, threads=1),
        "warm": partial(solve_batch, moved, z0=start, threads=1),
    }
    batch = solve_batch(moved, z0=start, threads=1)
    calls["gradient"] = lambda: derivative(batch).vjp(batch.z).M
    told = ", ".join(
        f"{name} {1e6 * seconds / count:.0f} µs" for name, seconds in medians(calls, 5).items()
    )
    return f"{count} problems of 4 contacts: {told} each"
