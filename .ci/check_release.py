"""Refuse a release with a placeholder, or with several versions or dates: ``python .ci/check_release.py v0.1.0``.

The address of the project is written once, in ``[project.urls]``; until the project has one, it ends with ``.invalid``.
"""

import re
import sys
import tomllib
from pathlib import Path


def find_faults(root: Path, tag: str) -> list[str]:
    """Return the reasons against a release of a checkout by a tag."""
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    faults = [
        f"pyproject.toml: {name} = {url} is a placeholder; write the address of the project"
        for name, url in project["urls"].items()
        if ".invalid" in url
    ]
    version = re.escape(tag.removeprefix("v"))
    cited = re.search(r"^date-released: (\S+)", (root / "CITATION.cff").read_text("utf-8"), re.M)
    for name, line in (
        ("lcp_plugin/__init__.py", f'^__version__ = "{version}"$'),
        ("CITATION.cff", f"^version: {version}$"),
        (".ci/conda/recipe.yaml", f'^  version: "{version}"$'),
        ("examples/manual/CHANGELOG.md", rf"^## \[{version}\] - {cited and cited[1]}$"),
    ):
        if not re.search(line, (root / name).read_text("utf-8"), re.M):
            faults.append(f"{name} has no line {line} for the tag {tag}")
    return faults


if __name__ == "__main__":
    sys.exit("\n".join(find_faults(Path(__file__).parents[1], *sys.argv[1:])) or 0)
