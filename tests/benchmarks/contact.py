"""Contact with friction: single steps, trajectories whose contacts come and go, and batches, beside what engines do.

Beside are quantecon's compiled Lemke on the same pyramids, and two solvers of physics engines on boxes in their place
(|f| ≤ μ p along each tangent), which answer another, easier question: Dantzig's pivots with friction bounds fixed as
they are met, as in ODE and DART, and 50 sweeps of projected Gauss–Seidel. What these leave is told as the largest
overlap: a velocity into a contact, beside the largest velocity without impulses.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from lcp_plugin.api import solve
from lcp_plugin.core.kernels.compilation import kernel
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.settings import Status
from lcp_plugin.problems.batches.batch import solve_batch

from .small import COMPILED_LEMKE, friction, spectrum
from .timing import medians

STEP, GRAVITY, FRICTION = 1e-3, 9.81, 0.5  # s, m/s², –
CLOSED = 1e-5  # m: a smaller gap is a contact
SWEEPS, SOFTNESS = 50, 1e-6


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each size, trajectory and batch."""
    for contacts in (4, 10) if quick else (4, 10, 30, 100):
        yield _steps(contacts, 2 if quick else 12 if contacts < 100 else 4)
    for boxes in (2,) if quick else (8, 25):
        for is_warm in (False, True):
            yield _trajectory(boxes, 5 if quick else 200 if boxes < 20 else 40, is_warm=is_warm)
    yield from _batches(50 if quick else 2000)


def _steps(contacts: int, count: int) -> str:
    """Return what an answer costs from scratch, from a stated problem with a new M and from arrays."""
    cases = [friction(contacts, k) for k in range(count)]
    seconds: dict[str, list[float]] = {}
    unsolved = 0
    for k, case in enumerate([*cases[:1], *cases]):  # the first compiles
        for name, make in (
            ("arrays", lambda: LCP(case.M, case.q)),  # noqa: B023
            ("stated", partial(_given, LCP(case.M, case.q))),
        ):
            began = time.perf_counter()
            result = solve(make())
            seconds.setdefault(name, []).append(time.perf_counter() - began)
            unsolved += not result.is_solved
        if find_spec("quantecon") is not None:
            began = time.perf_counter()
            COMPILED_LEMKE.ask(case, 1e-9, 20.0)
            seconds.setdefault("compiled Lemke", []).append(time.perf_counter() - began)
        if k == 0:
            seconds = {}
    told = ", ".join(
        f"{name} {1e3 * statistics.median(values):.2f} ms" for name, values in seconds.items()
    )
    return f"{contacts} contacts from scratch: {told}; worst {1e3 * max(seconds['stated']):.2f} ms; {unsolved} unsolved"


def _given(problem: LCP) -> LCP:
    return problem


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
        start = (
            None
            if before is None or not is_warm
            else problem.origin.start_from(before, touched[closed])
        )
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


def _trajectory(boxes: int, steps: int, *, is_warm: bool) -> str:
    seconds, unsolved, counts = [], 0, set()
    others: dict[str, list[float]] = {"Dantzig": [], "PGS": []}
    overlaps = dict.fromkeys(others, 0.0)
    for problem, _, result, spent in trajectory(boxes, steps, is_warm=is_warm):
        seconds.append(spent)
        unsolved += not result.is_solved
        origin = problem.origin
        counts.add(origin.count)
        for name, solver in (("Dantzig", dantzig), ("PGS", gauss_seidel)):
            free = origin.velocities.ravel()
            began = time.perf_counter()
            x = solver(origin.W, free, FRICTION)
            others[name].append(time.perf_counter() - began)
            overlap = -(origin.W @ x + free)[::3].min() / np.abs(free).max()
            overlaps[name] = max(overlaps[name], overlap)
    later = seconds[min(5, steps // 2) :]
    told = ", ".join(
        f"{name} {1e3 * statistics.median(values):.2f} ms with overlaps up to {overlaps[name]:.0e}"
        for name, values in others.items()
    )
    return (
        f"tower of {boxes}, {min(counts)} to {max(counts)} contacts, {'warm' if is_warm else 'from scratch'}: median "
        f"{1e3 * statistics.median(later):.2f} ms, worst {1e3 * max(later):.2f} ms, {unsolved} of {steps} unsolved; "
        f"{told}"
    )


@kernel
def gauss_seidel(W, free, mu):  # type: ignore[no-untyped-def]
    """Return impulses after some sweeps over rows, friction within ±μ p."""
    x, n = np.zeros(free.size), free.size
    for _ in range(SWEEPS):
        for i in range(n):
            total = free[i]
            for j in range(n):
                total += W[i, j] * x[j]
            limit = np.inf if i % 3 == 0 else mu * x[i - i % 3]
            x[i] = min(max(x[i] - total / W[i, i], 0.0 if i % 3 == 0 else -limit), limit)
    return x


@kernel
def dantzig(W, free, mu):  # type: ignore[no-untyped-def]
    """Return impulses by Dantzig's pivots row after row, normals first, friction within ±μ p of the p then found.

    The inverse of the clamped block is kept and bordered; a small softness keeps it from being singular.
    """
    n, W = free.size, W.copy()
    for i in range(n):
        W[i, i] *= 1.0 + SOFTNESS
    x, w, side = (
        np.zeros(n),
        free.copy(),
        np.zeros(n, np.int64),
    )  # 1: clamped (w = 0), 0 at lower, 2 at upper, 3 later
    inverse, members = np.zeros((n, n)), np.zeros(n, np.int64)
    count = 0
    side[:] = 3
    for turn in range(n):
        k = n // 3
        i = 3 * turn if turn < k else 3 * ((turn - k) // 2) + 1 + (turn - k) % 2
        high = np.inf if i % 3 == 0 else mu * x[i - i % 3]
        low = 0.0 if i % 3 == 0 else -high
        if (w[i] >= 0.0 and low == 0.0) or high == low:
            side[i] = 0
            continue
        direction = 1.0 if w[i] < 0.0 else -1.0
        for _ in range(4 * n):
            change = np.zeros(n)
            change[i] = direction
            for a in range(count):
                total = 0.0
                for b in range(count):
                    total += inverse[a, b] * W[members[b], i]
                change[members[a]] = -direction * total
            speed = W @ change
            least, at, becomes = np.inf, -1, 0
            if speed[i] * direction > 0.0:
                least, at, becomes = -w[i] / speed[i], i, 1
            bound = (high if direction > 0.0 else low) - x[i]
            if bound / direction < least:
                least, at, becomes = bound / direction, i, 2 if direction > 0.0 else 0
            for j in range(n):
                top = np.inf if j % 3 == 0 else mu * x[j - j % 3]
                bottom = 0.0 if j % 3 == 0 else -top
                if side[j] == 1 and change[j] < 0.0 and (bottom - x[j]) / change[j] < least:
                    least, at, becomes = (bottom - x[j]) / change[j], j, 0
                elif side[j] == 1 and change[j] > 0.0 and (top - x[j]) / change[j] < least:
                    least, at, becomes = (top - x[j]) / change[j], j, 2
                else:
                    is_turning = (side[j] == 0 and speed[j] < 0.0) or (
                        side[j] == 2 and speed[j] > 0.0
                    )
                    if is_turning and -w[j] / speed[j] < least:
                        least, at, becomes = -w[j] / speed[j], j, 1
            if at < 0:
                break
            least = max(least, 0.0)
            x += least * change
            w += least * speed
            if becomes == 1:
                w[at] = 0.0
                column = np.zeros(count)
                for a in range(count):
                    for b in range(count):
                        column[a] += inverse[a, b] * W[members[b], at]
                pivot = W[at, at]
                for a in range(count):
                    pivot -= W[at, members[a]] * column[a]
                for a in range(count):
                    for b in range(count):
                        inverse[a, b] += column[a] * column[b] / pivot
                    inverse[a, count] = inverse[count, a] = -column[a] / pivot
                inverse[count, count] = 1.0 / pivot
                members[count], side[at] = at, 1
                count += 1
            elif side[at] == 1:
                place = 0
                while members[place] != at:
                    place += 1
                count -= 1
                for a in range(count + 1):  # to the end, and out
                    inverse[a, place], inverse[a, count] = inverse[a, count], inverse[a, place]
                for a in range(count + 1):
                    inverse[place, a], inverse[count, a] = inverse[count, a], inverse[place, a]
                members[place] = members[count]
                for a in range(count):
                    for b in range(count):
                        inverse[a, b] -= (
                            inverse[a, count] * inverse[count, b] / inverse[count, count]
                        )
                side[at] = becomes
            else:
                side[at] = becomes
            if at == i:
                break
    return x


def _batches(count: int) -> Iterator[str]:
    """Yield what a problem of a batch costs on one thread."""
    kinds = [(f"{contacts} contacts", partial(friction, contacts)) for contacts in (2, 4, 10)]
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
