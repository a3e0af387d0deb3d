"""Print the table of examples/manual/nonlinear.md: ``PYTHONPATH=tests python tests/published/nonlinear/table.py``.

Each cell has the starts that were solved, as the outsider's residual shows, and the median process time of these in
milliseconds. The floor is a Fischer–Burmeister semismooth Newton method (De Luca, Facchinei, Kanzow 1996) with steepest
descent where its direction is none of descent.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import scipy.sparse as sp
from published_problems import PUBLISHED, Published, outsiders_residual
from scipy.sparse.linalg import spsolve

from lcp_plugin import NonlinearProblem, solve
from lcp_plugin.methods.newton import fischer_burmeister

SECONDS = 4.0


def by_floor(problem: NonlinearProblem, x: np.ndarray) -> np.ndarray:
    """The floor: monotone steps until Φ is below 1e-10 or nothing falls."""
    begun, x = time.process_time(), np.clip(x, problem.lower, problem.upper)
    phi = fischer_burmeister(problem, x, problem.value(x), np.ones(x.size))
    while np.abs(phi.value).max() > 1e-10 and time.process_time() < begun + SECONDS:
        M = problem.derivative(x)
        if sp.issparse(M):
            H: Any = sp.csc_array(sp.diags_array(phi.by_w) @ M + sp.diags_array(phi.by_z))
        else:
            H = M * phi.by_w[:, None] + np.diag(phi.by_z)
        gradient = H.T @ phi.value
        try:
            step = -(spsolve(H, phi.value) if sp.issparse(H) else np.linalg.solve(H, phi.value))
        except np.linalg.LinAlgError:
            step = -gradient
        if not gradient @ step < -1e-8 * np.linalg.norm(step) ** 2.1:
            step = -gradient
        for k in range(60):
            there = x + 0.5**k * step
            new = fischer_burmeister(problem, there, problem.value(there), np.ones(x.size))
            slope = 1e-4 * 0.5**k * float(gradient @ step)
            if 0.5 * new.norm**2 <= 0.5 * phi.norm**2 + slope:
                break
        else:
            return x
        x, phi = there, new
    return x


def by_us(problem: NonlinearProblem, x: np.ndarray) -> np.ndarray:
    """The plugin; a result that is not SOLVED is no claim."""
    result = solve(problem, x0=x, max_seconds=SECONDS)
    return result.x if result.is_solved else np.full(x.size, np.nan)


def cell(one: Published, method: Callable[..., Any]) -> tuple[int, str]:
    """Return how many starts a method solves, and the cell's text."""
    times, problem = [], one.problem
    for start in one.starts:
        begun = time.process_time()
        x = method(problem, np.array(start, dtype=float))
        seconds = time.process_time() - begun
        if np.isfinite(x).all() and outsiders_residual(problem, x) < 1e-6:
            times.append(1e3 * seconds)
    return len(times), f"{len(times)}, {format_ms(median(times))} ms" if times else "0"


def format_ms(time: float) -> str:
    """Return two digits, without an exponent."""
    return f"{time:.0f}" if time >= 10 else f"{time:.2g}"


def main() -> None:
    """Print one row per problem and the sums."""
    total = np.zeros(3, dtype=int)
    print("| problem | n | starts | lcp_plugin | floor |\n|---|---|---|---|---|")
    with np.errstate(all="ignore"):
        by_us(PUBLISHED["kojima_shindo"].problem, np.ones(4))  # loads what the first call loads
        for name, one in PUBLISHED.items():
            if one.is_solvable:
                cells, count = [cell(one, method) for method in (by_us, by_floor)], len(one.starts)
                total += [count, *(solved for solved, _ in cells)]
                size, texts = len(one.starts[0]), " | ".join(text for _, text in cells)
                print(f"| {name} | {size} | {count} | {texts} |")
    print(f"| all | | {total[0]} | {total[1]} | {total[2]} |")


if __name__ == "__main__":
    main()
