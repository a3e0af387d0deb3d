"""What a command works on: a file, a folder or a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import InvalidOption, did_you_mean
from ..problem import LCP


def read_target(target: str) -> tuple[LCP, Any]:
    """Return (problem, None) of a file or (problem, scene) of a scene's name."""
    from ..evidence import gallery

    name = target.partition(":")[0]
    if name in gallery.names():
        scene = gallery.parse(target)
        return scene.problem, scene
    looks_like_a_path = "/" in target or "\\" in target or "." in target
    if looks_like_a_path or Path(target).exists() or Path(f"{target}M.mtx").exists():
        return LCP.load(target), None
    raise InvalidOption(f"{target!r} is neither a file nor a scene{did_you_mean(name, gallery.names())}")
