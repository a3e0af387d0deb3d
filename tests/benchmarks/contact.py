"""Contact with friction on pyramids: single steps, trajectories whose contacts come and go, and batches."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from small_families import falling_bodies, spectrum

from lcp_plugin.api import solve
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.settings import Status
from lcp_plugin.problems.batches.batch import solve_batch

from .timing import medians

STEP, GRAVITY, FRICTION = 1e-3, 9.81, 0.5  # s, m/s², –
CLOSED = 1e-5  # m: a smaller gap is a contact


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each size, trajectory and batch."""
    for contacts in (4, 10) if quick else (4, 10, 30, 100):
        yield _steps(contacts, 2 if quick else 12 if contacts < 100 else 4)
    for boxes in (2,) if quick else (8, 25):
        for is_warm in (False, True):
            yield _trajectory(boxes, 5 if quick else 200 if boxes < 20 else 40, is_warm=is_warm)
    yield from _batches(50 if quick else 2000)


def _steps(contacts: int, count: int) -> str:
    """Return the milliseconds of a solve from arrays."""
    problems, seconds, unsolved = [falling_bodies(contacts, k) for k in range(count)], [], 0
    for problem in [problems[0], *problems]:  # the first compiles
        began = time.perf_counter()
        unsolved += not solve(LCP(problem.M, problem.q)).is_solved
        seconds.append(time.perf_counter() - began)
    return (
        f"{contacts} contacts from scratch: {1e3 * statistics.median(seconds[1:]):.2f} ms; "
        f"worst {1e3 * max(seconds[1:]):.2f} ms; {unsolved} unsolved"
    )


def tower(boxes: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return J, shape (4 boxes, 3, 6 boxes), and the masses, of boxes on each other that touch at four corners."""
    J = np.zeros((4 * boxes, 3, 6 * boxes))
    mass = np.repeat(rng.uniform(0.5, 2.0, boxes), 6)
    mass[3::6], mass[4::6], mass[5::6] = 0.02 * mass[3::6], 0.02 * mass[4::6], 0.03 * mass[5::6]
    for row in range(4 * boxes):
        box, corner = divmod(row, 4)
        signs = (1 - 2 * (corner // 2), 1 - 2 * (corner % 2), -1)
        arm = np.array([0.2, 0.2, 0.1]) * signs * rng.uniform(0.9, 1.0, 3)
        for k, d in enumerate(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])):
            J[row, k, 6 * box : 6 * box + 6] = [*d, *np.cross(arm, d)]
            if box:
                J[row, k, 6 * box - 6 : 6 * box] = [*-d, *-np.cross(arm * [1, 1, -1], d)]
    return J, mass


def trajectory(
    boxes: int, steps: int, *, is_warm: bool, seed: int = 0
) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield (problem, start, result, seconds) of a tower that is shaken: its corners lift and come down again."""
    rng = np.random.default_rng(seed)
    J, mass = tower(boxes, rng)
    velocity, gap, before, touched = (
        np.zeros(6 * boxes),
        np.zeros(4 * boxes),
        None,
        np.full(4 * boxes, -1),
    )
    for k in range(steps):
        force = np.zeros(6 * boxes)
        force[2::6] = -GRAVITY
        force[0::6] = 8.0 * np.sin(0.05 * k) * rng.uniform(0.0, 1.0, boxes)
        force[1::6], force[4::6] = 4.0 * np.cos(0.031 * k), 0.5 * rng.standard_normal(boxes)
        free, closed = velocity + STEP * force, np.flatnonzero(gap <= CLOSED)
        rows = J[closed].reshape(-1, 6 * boxes)
        without = (rows @ free).reshape(-1, 3)
        without[:, 0] += np.maximum(gap[closed], 0.0) / STEP
        problem = LCP.from_contacts((rows / mass) @ rows.T, FRICTION, without)
        start = None if before is None or not is_warm else _start(before, touched[closed])
        began = time.perf_counter()
        result = solve(problem, z0=start)
        yield problem, start, result, time.perf_counter() - began
        motion = problem.origin.recover(result)
        velocity = (
            free + rows.T @ np.column_stack([motion.normal, motion.tangential]).ravel() / mass
        )
        gap = np.maximum(gap + STEP * (J[:, 0] @ velocity), 0.0)
        before, touched = result, np.full(4 * boxes, -1)
        touched[closed] = np.arange(closed.size)


def _start(before: Any, same: Any) -> Any:
    """Return a start from the result before: `same` is the earlier number of each contact, −1 for a new one."""
    z, count = before.z, before.z.size // 6
    parts = z[:count, None], z[count : 5 * count].reshape(count, 4), z[5 * count :, None]
    if not count:
        return None
    is_old = (same >= 0)[:, None]
    return np.concatenate([np.where(is_old, part[same], 0.0).ravel() for part in parts])


def _trajectory(boxes: int, steps: int, *, is_warm: bool) -> str:
    seconds, unsolved, counts = [], 0, set()
    for problem, _, result, spent in trajectory(boxes, steps, is_warm=is_warm):
        seconds.append(spent)
        unsolved += not result.is_solved
        counts.add(problem.origin.friction.size)
    later = seconds[min(5, steps // 2) :]
    return (
        f"tower of {boxes}, {min(counts)} to {max(counts)} contacts, {'warm' if is_warm else 'from scratch'}: median "
        f"{1e3 * statistics.median(later):.2f} ms, worst {1e3 * max(later):.2f} ms, {unsolved} of {steps} unsolved"
    )


def _batches(count: int) -> Iterator[str]:
    """Yield what a problem of a batch costs on one thread."""
    kinds = [(f"{contacts} contacts", partial(falling_bodies, contacts)) for contacts in (2, 4, 10)]
    for name, kind in (*kinds, ("SPD n = 10", partial(spectrum, 10, 1e2, 0.4))):
        cases = [kind(k) for k in range(count)]
        M, q = np.array([case.M for case in cases]), np.array([case.q for case in cases])
        batch = solve_batch(M, q, threads=1)
        unsolved = sum(status is not Status.SOLVED for status in batch.status)
        calls = {
            "scratch": partial(solve_batch, M, q, threads=1),
            "warm": partial(solve_batch, M, q, z0=batch.z, threads=1),
        }
        seconds = medians(calls, 3)
        told = ", ".join(f"{name} {1e6 * each / count:.2f} µs" for name, each in seconds.items())
        yield f"batch of {count}, {name} each: {told} a problem, {unsolved} unsolved"
