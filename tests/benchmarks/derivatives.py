"""What a gradient costs beside the solve it belongs to, and beside cvxpy's own differentiation of a cone program.

Times are processor seconds of this process. The solve begins at (M, q); the gradient is that of a random linear
function of z by q, the bounds and the entries of M, with the settling of the free rows, from the solve's result.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from importlib.util import find_spec
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin.api import solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery import Scene, parse
from lcp_plugin.problems.sensitivity import Derivative, derivative

from .timing import timed

REPEATS = 3
LIMIT = 600.0  # seconds for cvxpy's solve and backward, compilation included


class Row(NamedTuple):
    """One scene of the table, how it is written, and what is asked of gradient ÷ solve."""

    title: str
    scene: str
    quick: str
    target: str = ""


ROWS = [
    Row("obstacle, sphere", "obstacle_2d:size=1024", "obstacle_2d:size=60", "≤ 1.0"),
    Row("obstacle 3-D", "obstacle_3d:size=100", "obstacle_3d:size=12", "≤ 1.0"),
    Row("bearing 0.9", "journal_bearing:size=1000,eccentricity=0.9", "journal_bearing:size=50"),
    Row(
        "wind, ε = 1e-2",
        "convection_diffusion:size=1000,diffusion=1e-2",
        "convection_diffusion:size=50",
    ),
    Row(
        "wind, ε = 1e-5",
        "convection_diffusion:size=1000,diffusion=1e-5",
        "convection_diffusion:size=50",
    ),
]


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield gradient ÷ solve for large scenes, then ÷ cvxpy's backward at n = 25 600."""
    warm_up = fresh(parse(ROWS[0].quick).problem)
    derivative(solve(warm_up)).vjp(np.ones(warm_up.n))
    for row in ROWS:
        yield _line(row, quick)
    yield from beside_cvxpy(20 if quick else 160, LIMIT)


def direction(n: int, seed: int = 0) -> FloatVector:
    """Return a random vector, shape (n,)."""
    return np.random.default_rng(seed).standard_normal(n)


def _line(row: Row, quick: bool) -> str:
    scene = parse(row.quick if quick else row.scene)
    n, solves, gradients, settling = scene.n, [], [], []
    for _ in range(REPEATS):
        problem = fresh(scene.problem)
        gc.collect()
        forward = timed(lambda: solve(problem), time.process_time)  # noqa: B023
        found = derivative(forward.answer)
        settled = timed(lambda: found.z, time.process_time)  # noqa: B023
        adjoint = timed(lambda: found.vjp(direction(n)), time.process_time)  # noqa: B023
        solves.append(forward.seconds)
        settling.append(settled.seconds)
        gradients.append(settled.seconds + adjoint.seconds)
    ratio = min(gradients) / min(solves)
    return (
        f"{row.title:<18} n = {n:<8} {forward.answer.status.name} in {min(solves):.3f} s   gradient "
        f"{min(gradients):.3f} s, of which the rows are settled in {min(settling):.3f} s   gradient ÷ solve {ratio:.2f}"
        f"{'   target ' + row.target if row.target else ''}   ⟨vjp(g), h⟩ differs from ⟨g, jvp(h)⟩ by "
        f"{identity_error(found):.1e}"
    )


def identity_error(found: Derivative) -> float:
    """Return |⟨vjp(g), h⟩ − ⟨g, jvp(h)⟩| ÷ ‖g‖ ‖jvp(h)‖ for a change h of q."""
    g, h = direction(found.z.size), direction(found.z.size, 1)
    dz = found.jvp(dq=h)
    return float(abs(found.vjp(g).q @ h - g @ dz) / (np.linalg.norm(g) * np.linalg.norm(dz)))


def beside_cvxpy(size: int, limit: float) -> Iterator[str]:
    """Yield our solve and gradient of the sphere beside those of cvxpy, which runs in a process of its own."""
    scene = parse(f"obstacle_2d:size={size}")
    found = timed(lambda: solve(fresh(scene.problem)))
    ours = timed(lambda: derivative(found.answer).vjp(direction(scene.n)))
    told = f"sphere n = {scene.n}: solve {found.seconds:.3f} s, gradient {ours.seconds:.3f} s; cvxpy's own"
    if find_spec("cvxpy") is None or find_spec("diffcp") is None:
        yield f"{told} backward is skipped, as it needs cvxpy and diffcp: pip install cvxpy diffcp"
        return
    theirs = _limited(scene, limit)
    if theirs is None:
        yield f"{told} solve and backward are not done after {limit:g} s   target: backward ≥ 100 × ours"
        return
    forward, backward, gradient = theirs
    off = np.abs(gradient - ours.answer.q).max() / np.abs(ours.answer.q).max()
    yield (
        f"{told} solve {forward:.2f} s, backward {backward:.2f} s = {backward / ours.seconds:.0f} × ours, "
        f"its gradient off by {off:.0e} of the largest entry   target ≥ 100 ×"
    )


def _limited(scene: Scene, limit: float) -> tuple[float, float, FloatVector] | None:
    """Return what cvxpy needs and finds, None where the limit is over."""
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_by_cvxpy, args=(scene, there), daemon=True)
    process.start()
    there.close()
    try:
        return here.recv() if here.poll(limit) else None
    except EOFError:  # it ended without an answer: out of memory
        return None
    finally:
        process.kill()
        process.join()


def _by_cvxpy(scene: Scene, answer: Any) -> None:
    """Send seconds of solve and backward, and the gradient by q, of min ½‖D z‖² + qᵀz, z ≥ lower, where M = DᵀD."""
    import cvxpy as cp

    size = round(scene.n**0.5)
    along = sp.diags_array([1.0, -1.0], offsets=[0, -1], shape=(size + 1, size))
    D = sp.vstack(
        [sp.kron(along, sp.eye_array(size)), sp.kron(sp.eye_array(size), along)], format="csc"
    )
    D = D * np.sqrt(scene.problem.diagonal[0] / 4.0)
    z, q = cp.Variable(scene.n), cp.Parameter(scene.n, value=np.array(scene.problem.q))
    problem = cp.Problem(
        cp.Minimize(0.5 * cp.sum_squares(D @ z) + q @ z), [z >= scene.problem.lower]
    )
    forward = timed(lambda: problem.solve(requires_grad=True))
    z.gradient = direction(scene.n)
    backward = timed(problem.backward)
    answer.send((forward.seconds, backward.seconds, q.gradient))
