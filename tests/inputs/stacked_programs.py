"""Lists of programs from arrays with an axis for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lcp_plugin import QuadraticProgram

AXES = {"P": 2, "c": 1, "G": 2, "h": 1, "A": 2, "b": 1, "lower": 1, "upper": 1, "constant": 0}


def programs_of(
    P: Any, c: Any, G: Any = None, h: Any = None, **rest: Any
) -> list[QuadraticProgram]:
    """Return a program for each item of the first axis of the stacked arrays; other arrays are the same for all."""
    given = {"P": P, "c": c, "G": G, "h": h, **rest}
    stacked = {name for name, one in given.items() if np.ndim(one) > AXES[name]}
    count = max((len(given[name]) for name in stacked), default=1)
    return [
        QuadraticProgram(
            **{name: one[k] if name in stacked else one for name, one in given.items()}
        )
        for k in range(count)
    ]


def differentiable_program(seed: int, *, is_degenerate: bool = False) -> dict[str, Any]:
    """Return the data of a random program with equations, inequalities and bounds, some of which are active.

    A degenerate one has an active inequality, or bound, with multiplier 0.
    """
    rng = np.random.default_rng([31, seed])
    n, m, p = int(rng.integers(6, 10)), int(rng.integers(1, 6)), int(rng.integers(0, 3))
    root, x = rng.normal(size=(n, n)), rng.normal(size=n)
    G, A = rng.normal(size=(m, n)), rng.normal(size=(p, n))
    lower, upper = x - rng.uniform(0.5, 2.0, n), x + rng.uniform(0.5, 2.0, n)
    lower[0] = x[0]
    is_active = (rng.random(m) < 0.5) & (np.arange(m) < 2)  # no more than unknowns
    y = np.where(is_active, rng.uniform(0.5, 2.0, m), 0.0)
    force = rng.uniform(0.5, 2.0)
    if is_degenerate and seed % 2:
        force = 0.0
    elif is_degenerate:
        is_active[0], y[0] = True, 0.0
    P = root @ root.T + 0.1 * np.eye(n)
    c = -P @ x - G.T @ y - A.T @ rng.normal(size=p)
    c[0] += force
    h = G @ x + np.where(is_active, 0.0, rng.uniform(0.5, 2.0, m))
    return {"P": P, "c": c, "G": G, "h": h, "A": A, "b": A @ x, "lower": lower, "upper": upper}


def differentiable_programs(seed: int, names: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the data of such programs, with two rows of each kind, where the named data have an axis for three."""
    seeds = (k for k in range(100 * seed, 100 * seed + 99))
    one = next(
        data
        for data in map(differentiable_program, seeds)
        if min(data["b"].size, data["h"].size - 1) > 1
    )
    scale = np.array([1.0, 1.01, 1.02])
    return {
        name: scale.reshape(3, *(1 for _ in value.shape)) * value if name in names else value
        for name, value in one.items()
    }
