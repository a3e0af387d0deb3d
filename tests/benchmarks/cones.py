"""Contact with exact friction cones: batches of problems with 4 contacts, and their gradient."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from lcp_plugin import FrictionalContact, derivative, solve_batch

from .timing import quickest


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line per batch: W = J Jᵀ + δ I of a body with 6 degrees of freedom."""
    for delta in (1.0,) if quick else (1.0, 0.1, 0.01):
        yield _batch(200 if quick else 4096, delta)


def _batch(count: int, delta: float) -> str:
    """Return the processor time of an item from zero, from a near start, and of its gradient, on one thread."""
    rng = np.random.default_rng(0)
    J = rng.standard_normal((count, 12, 6))
    W, b = J @ np.swapaxes(J, 1, 2) + delta * np.eye(12), rng.standard_normal((count, 12))
    b[:, ::3] -= 0.5
    mu = rng.uniform(0.0, 1.0, (count, 4))
    problems, moved = (FrictionalContact.worlds(W, t * b, mu) for t in (1.0, 1.001))
    start = solve_batch(problems).require_solved().z
    calls = {
        "from zero": partial(solve_batch, problems, threads=1),
        "warm": partial(solve_batch, moved, z0=start, threads=1),
    }
    batch = solve_batch(moved, z0=start, threads=1)
    calls["gradient"] = lambda: derivative(batch).vjp(batch.z).M
    told = ", ".join(
        f"{name} {1e6 * found.seconds / count:.0f} µs" for name, found in quickest(calls, 3).items()
    )
    return f"{count} problems of 4 contacts, δ = {delta}: {told} each"
