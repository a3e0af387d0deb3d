"""Warnings of the package's modules fail a test, and deprecations inside of dependencies are only printed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEST = """
import warnings
import pytest

@pytest.mark.parametrize("category", [DeprecationWarning, FutureWarning, UserWarning])
@pytest.mark.parametrize("module", ["lcp_plugin.core.lcp", "scipy.io._mmio"])
def test_warns(category, module):
    warnings.warn_explicit("old", category, "file.py", 1, module)
"""
PYTEST = [
    sys.executable,
    "-m",
    "pytest",
    "-q",
    "-c",
    str(ROOT / "pyproject.toml"),
    "-p",
    "no:cacheprovider",
]
OURS = [
    f"lcp_plugin.core.lcp-{name}" for name in ("DeprecationWarning", "FutureWarning", "UserWarning")
]


@pytest.mark.parametrize(
    ("options", "failed"),
    [
        ([], [*OURS, "scipy.io._mmio-UserWarning"]),
        (["-W", "error", "-W", "ignore:old:FutureWarning"], [*OURS[::2], "scipy.io._mmio-DeprecationWarning",
                                                              "scipy.io._mmio-UserWarning"]),
    ],
)  # fmt: skip
def test_a_deprecation_inside_of_a_dependency_fails_only_if_warnings_are_errors(
    options: list[str], failed: list[str], tmp_path: Path
) -> None:
    """README's command prints it; ``.ci/run`` fails on it, except for a known warning that follows ``-W error``."""
    file = tmp_path / "test_one.py"
    file.write_text(TEST)
    done = subprocess.run(
        [*PYTEST, *options, str(file)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert sorted(
        line.split("[")[1].split("]")[0]
        for line in done.stdout.splitlines()
        if line.startswith("FAILED")
    ) == sorted(failed), done.stdout
    assert "old" in done.stdout
