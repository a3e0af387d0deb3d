"""Benchmarks: each yields lines of text with ratios measured in one run. ``python tests/benchmarks`` lists them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "examples"))  # paper_tables is an example

BENCHMARKS = {
    "multigrid": "multigrid and auto on obstacle, bearing, wind, jumps … against a linear solve by pyamg",
    "small": "small dense problems, one by one and in batches, next to a compiled Lemke",
    "cones": "contact with exact friction cones: a batch, from scratch, warm, and its gradient",
    "public": "published problems by several packages: solved, wrong, unsolved, time; FILE gets all outcomes as JSON",
}


def load(name: str) -> Callable[..., Iterator[str]]:
    """Return the benchmark of that name: a callable with the keyword `quick` that yields lines."""
    run: Callable[..., Iterator[str]] = import_module(f"{__name__}.{name.replace('-', '_')}").run
    return run
