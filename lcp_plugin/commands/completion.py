"""The words that the shell offers."""

from __future__ import annotations


def scene_names(incomplete: str) -> list[str]:
    """Return the scenes that begin so."""
    from ..evidence import gallery

    return [name for name in gallery.names() if name.startswith(incomplete)]  # none of them: the shell tries files


def algorithm_names(incomplete: str) -> list[str]:
    """Return the algorithms that begin so, those of other packages too."""
    from ..algorithms import REGISTRY, from_other_packages

    return [name for name in ("auto", *REGISTRY, *from_other_packages()) if name.startswith(incomplete)]


def benchmark_names(incomplete: str) -> list[str]:
    """Return the benchmarks that begin so."""
    from ..evidence.benchmarks import BENCHMARKS

    return [name for name in BENCHMARKS if name.startswith(incomplete)]
