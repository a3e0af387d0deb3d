"""The example's algorithm becomes one of the package by a file in methods/, its test and a line in two tables."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEST = """from lcp_plugin import LCP, solve


def test_extragradient() -> None:
    assert solve(LCP([[4.0, -1.0], [-1.0, 4.0]], [-3.0, 5.0]), "extragradient").z.round(6).tolist() == [0.75, 0.0]
"""
ROW = (
    "| `extragradient` | predictor and corrector | two projected steps | monotone M "
    "| PSD, symmetric or not, for step < 1 | 2 products with M | step, looks_ahead |"
)
BAD_VALUES = '    "step": NO_POSITIVE_NUMBER,\n    "looks_ahead": [None, 1, "yes"],\n'
TESTS = (
    "tests/methods/test_extragradient.py",
    "tests/house/test_architecture.py",
    "tests/core/test_convergence.py",
    "tests/core/test_rejections.py",
    "tests/core/test_equivalences.py",
    "tests/house/test_docstrings.py",
)


@pytest.mark.full
def test_an_algorithm_is_a_file_and_a_line(tmp_path):
    """A copy of the package with these has it by its name, and the tests of all algorithms take it."""
    for name in (
        "lcp_plugin",
        "tests",
        "examples",
        "README.md",
        "pyproject.toml",
        "CITATION.cff",
        "LICENSE",
    ):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, tmp_path / name)
    source = (ROOT / "examples" / "add_an_algorithm.py").read_text(encoding="utf-8")
    start, end = source.index("@dataclass"), source.index("\n\ndef worst_of_random_problems")
    head = (
        '"""The extragradient method, which looks ahead."""\n\nfrom collections.abc import Iterator\n'
        "from dataclasses import dataclass\nfrom typing import ClassVar\n\nimport numpy as np\n"
        "import scipy.sparse.linalg\n\n"
        "from ..core.algorithm import Algorithm, Step, check_flag, check_positive\nfrom ..core.lcp import LCP\n\n\n"
    )
    (tmp_path / "lcp_plugin" / "methods" / "extragradient.py").write_text(
        head + source[start:end], encoding="utf-8"
    )
    table = tmp_path / "lcp_plugin" / "algorithms.py"
    before, after = table.read_text(encoding="utf-8").split("REGISTRY = {\n")
    line = '    "extragradient": "methods.extragradient:Extragradient",\n'
    table.write_text(f"{before}REGISTRY = {{\n{line}{after}", encoding="utf-8")
    manual = tmp_path / "examples" / "manual" / "algorithms.md"
    text = manual.read_text(encoding="utf-8")
    assert "\n| `lemke` |" in text
    manual.write_text(text.replace("\n| `lemke` |", f"\n{ROW}\n| `lemke` |"), encoding="utf-8")
    values = tmp_path / "tests" / "core" / "test_rejections.py"
    head, tail = values.read_text(encoding="utf-8").split("BAD_VALUES: dict[str, list[Any]] = {\n")
    values.write_text(
        f"{head}BAD_VALUES: dict[str, list[Any]] = {{\n{BAD_VALUES}{tail}", encoding="utf-8"
    )
    (tmp_path / TESTS[0]).write_text(TEST, encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *TESTS],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout[-5000:]
