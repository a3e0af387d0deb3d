"""What a warm call costs on a small problem: the price of the driver, the certificate and the clean-up."""

from __future__ import annotations

from collections.abc import Iterator

from ...solving.driver import solve
from ..gallery import build
from ..paper_tables import TOLERANCE
from .timing import medians

TARGET_MICROSECONDS = 400


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the median of a warm ``solve`` on Example 1 with n = 100, in both measures."""
    scene = build("paper_example_1", n=100)
    measures = {
        "the paper's Res < 1e-5": {"tolerance": TOLERANCE, "measure": "euclidean", "scaling": None},
        "relative residual 1e-8": {"tolerance": 1e-8, "measure": "relative"},
    }
    calls = {
        name: lambda settings=settings: solve(scene.problem, "npsor", z0=scene.start, **settings)
        for name, settings in measures.items()
    }
    for name, seconds in medians(calls, repeats=50 if quick else 1000).items():
        yield f"npsor to {name}: {1e6 * seconds:.0f} µs   target ≤ {TARGET_MICROSECONDS} µs"
