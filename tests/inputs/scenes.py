"""Every scene of the gallery at a size that takes no time, read off the list: a new scene is tested by being there."""

from __future__ import annotations

from lcp_plugin import gallery

# what a parameter of this name counts
FEW = {"size": 6, "n": 9, "blocks": 2, "goods": 4, "activities": 5, "steps": 3}


def small(name: str, parameters: dict[str, object]) -> str:
    """The scene as it is written on a command line, with few of everything."""
    settings = ",".join(f"{key}={FEW[key]}" for key in parameters if key in FEW)
    return f"{name}:{settings}" if settings else name


SMALL = [small(name, parameters) for name, _, parameters in gallery.describe()]
