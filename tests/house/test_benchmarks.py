"""Benchmarks run; what they measure is read by people, not asserted here."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks import BENCHMARKS, load
from paper_tables import cells, published

QUICK = ("cones",)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.full) for name in BENCHMARKS],
)
def test_benchmark_runs(name):
    """A benchmark in its quick form prints lines with measured figures."""
    lines = list(load(name)(quick=True))
    assert any(re.search(r"\d+\.?\d* (µs|ms|s |× )", line) for line in lines)


def benchmarks(*arguments: str) -> subprocess.CompletedProcess[str]:
    """What ``python tests/benchmarks`` does with these arguments."""
    return subprocess.run(
        [sys.executable, str(Path(__file__).parents[1] / "benchmarks"), *arguments],
        capture_output=True,
        text=True,
    )


@pytest.mark.full
def test_a_benchmark_runs_by_its_name():
    """A named benchmark prints its lines and exits with 0."""
    done = benchmarks("small", "--quick")
    assert (done.returncode, done.stderr) == (0, "")
    assert "µs" in done.stdout


@pytest.mark.full
def test_paper_tables_are_reproduced():
    """All 48 iteration counts equal the paper's, and at least 44 residuals to the printed digits."""
    computed = list(cells())
    assert len(computed) == 48
    assert [cell for cell in computed if cell.iterations != cell.paper_iterations] == []
    assert sum(f"{one.residual:.1e}" == f"{one.paper_residual:.1e}" for one in computed) >= 44
    assert published()["n"] == sorted({cell.n for cell in computed})
