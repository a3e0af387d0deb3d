"""The pictures of the package: subpackages, where they lie, and arrows and layers in the manual."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "lcp_plugin"
GROUPS = ("methods", "problems", "interfaces")  # folders of subpackages


def _section() -> str:
    page = ROOT / "examples" / "manual" / "developing.md"
    return page.read_text(encoding="utf-8").split("# How it is built")[1].split("\n## ")[0]


def _arrows(line: str) -> dict[str, set[str]]:
    """Return what the subpackages of a line may import: "a, b → c, d · e" says that a and b may import c and d."""
    found: dict[str, set[str]] = {}
    for part in line.split(" · "):
        subpackages, _, targets = part.partition("→")
        found |= {subpackage: _named(targets) for subpackage in re.findall(r"\w+", subpackages)}
    return found


def _named(targets: str) -> set[str]:
    """Return the subpackages of a list; a folder stands for all that lie in it."""
    names = set(re.findall(r"\w+", targets))
    for group in names & {*GROUPS}:
        names |= {one.stem for one in (PACKAGE / group).iterdir() if not one.name.startswith("_")}
    return names - {*GROUPS}


_picture = re.search(r"```text\n(.*?)```", _section(), re.S)
LINES = _picture[1].splitlines() if _picture else []
# beside those to the core
ARROWS = {name: targets for line in LINES for name, targets in _arrows(line).items()}
DRAWN = set(ARROWS)
# A method of one file that imports the core alone need not be drawn.
ARROWS |= {
    one.stem: set()
    for one in (PACKAGE / "methods").glob("*.py")
    if one.stem not in {*DRAWN, "__init__"}
}
PLACES = [PACKAGE / group for group in ("", *GROUPS)]
_storeys = re.findall(r"```\n(core\n.*?)```", _section(), re.S)
STOREYS = [_named(line) for line in _storeys[-1].splitlines()] if _storeys else []
FOLDERS = {  # or the file of one that is one
    name: next((one for one in [*(place / name for place in PLACES), *(place / f"{name}.py" for place in PLACES)]
                if one.exists()), PACKAGE / name)
    for name in ARROWS
}  # fmt: skip


def explained() -> list[str]:
    """The subpackages that the table below the picture explains."""
    rows = _section().split("| subpackage | contents |")[1].split("\n\n")[0].splitlines()[2:]
    return [subpackage for row in rows for subpackage in re.findall(r"`(\w+)`", row.split("|")[1])]


def subpackage_of(file: Path) -> str:
    """The subpackage of a file."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return parts[1] if parts[0] in GROUPS and len(parts) > 1 else parts[0]


def above(subpackage: str) -> set[str]:
    """Those that need it, by one arrow or several."""
    found: set[str] = set()
    while (
        more := {other for other, targets in ARROWS.items() if targets & {subpackage, *found}}
        - found
    ):
        found |= more
    return set(ARROWS) - {"core"} if subpackage == "core" else found
