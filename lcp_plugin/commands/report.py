"""What `lcp-plugin report` does: plan, compute with a progress bar, write; go on after an interruption."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from ..errors import UnreadableFile
from .target import scene_or_file
from .terminal import PartsBar

PARTS = "parts"


def make(scenes: Sequence[str], out: Path, *, quick: bool) -> tuple[bool, str]:
    """Write the report; return whether it is complete, and a line that says what was done.

    Raises
    ------
    InvalidOption
        Where something is neither a scene nor a file.
    UnreadableFile
        Where a file holds no problem, or the folder cannot be made.
    LCPError
        Where matplotlib or jinja2 is not installed: before anything is computed.
    """
    from ..evidence.drawing import require_matplotlib
    from ..evidence.report.page import collect, require_jinja, write_report
    from ..evidence.report.section import plan

    require_matplotlib()
    require_jinja()
    if out.exists() and not out.is_dir():
        raise UnreadableFile(f"cannot write {out}: it is a file; --out names a folder")
    began = time.perf_counter()
    parts = plan([scene_or_file(scene) for scene in scenes], quick=quick)
    with PartsBar(len(parts)) as bar:
        collected = collect(parts, out / PARTS, bar)
    try:
        page = write_report(collected, out, is_quick=quick)
    except KeyboardInterrupt:
        return False, (
            f"interrupted while the page was written: {len(parts) - len(collected.missing)} of {len(parts)} parts are "
            f"kept in {out / PARTS}; the same command goes on from here"
        )
    took = f"{time.perf_counter() - began:.0f} s"
    if collected.is_complete:
        again = f", {collected.found} of {len(parts)} parts found from a former run" if collected.found else ""
        return True, f"{page}: {len(parts)} parts, {took}{again}"
    return False, (
        f"interrupted after {took}: {page} holds {len(parts) - len(collected.missing)} of {len(parts)} parts; "
        "the same command goes on from here"
    )
