"""Contact with exact friction cones: a batch of problems with 4 contacts, and its gradient."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from lcp_plugin import FrictionalContact, derivative, solve_batch

from .timing import medians


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the line of a batch."""
    yield _batch(200 if quick else 4096)


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
