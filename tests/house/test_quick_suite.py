"""What the suite without --full leaves out is chosen as tests/conftest.py says, and runs with it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fresh_process import printed_by

HERE = Path(__file__).parents[1]


class Row:
    """One row of a test with the parameters a and b."""

    def __init__(self, mark: pytest.Mark | None, a: str, b: str) -> None:
        self.mark, self.callspec = mark, SimpleNamespace(params={"a": a, "b": b})

    def get_closest_marker(self, name: str) -> Any:
        return self.mark


def rows(mark: pytest.MarkDecorator | None = None) -> list[Any]:
    """Rows with three values of one and four of the other."""
    return [Row(mark and mark.mark, a, b) for a in "xyz" for b in "1234"]


def test_sampled_rows_touch_every_value(request: pytest.FixtureRequest) -> None:
    """Four rows touch three values and four; with a number, so many rows in even steps, and four without a mark."""
    sample = request.config.pluginmanager.get_plugin(str(HERE / "conftest.py")).sample
    chosen = [row.callspec.params for row in sample(rows(pytest.mark.sampled))]
    assert len(chosen) == 4
    assert {row["a"] for row in chosen} == {*"xyz"}
    assert {row["b"] for row in chosen} == {*"1234"}
    assert [row.callspec.params["b"] for row in sample(rows(pytest.mark.sampled(3)))] == [
        "1",
        "1",
        "1",
    ]
    assert len(sample(rows(pytest.mark.sampled(100)))) == 12
    assert [row.callspec.params["b"] for row in sample(rows())] == ["1", "4", "3", "2"]


def test_ci_runs_everything_after_the_readme_s_command() -> None:
    """Nothing that the quick suite leaves out is left out altogether."""
    script = HERE.parent / ".ci" / "run"
    if not script.exists():
        pytest.skip("a source archive has no .ci")
    lines = [
        line
        for line in script.read_text(encoding="utf-8").splitlines()
        if line.startswith(("bash", "python -m"))
    ]
    assert [line.partition(" </dev/null")[0] for line in lines] == [
        'bash -euo pipefail -c "$command"', "python -m pytest --full -n 2",
    ]  # fmt: skip


def test_blas_of_the_tests_has_one_thread() -> None:
    """Where the environment names no number, tests/conftest.py does, before numpy is loaded; a user's number stays."""
    code = (
        "import os, sys\n"
        "os.environ.pop('OMP_NUM_THREADS', None)\n"
        f"sys.path.insert(0, {str(HERE)!r})\n"
        "import conftest, importlib\n"
        "print(os.environ['OMP_NUM_THREADS'], 'numpy' in sys.modules)\n"
        "os.environ['OMP_NUM_THREADS'] = '3'\n"
        "importlib.reload(conftest)\n"
        "print(os.environ['OMP_NUM_THREADS'])"
    )
    assert printed_by(code).splitlines() == ["1 False", "3"]


@pytest.mark.full
def test_every_campaign_starts_outside_of_pytest() -> None:
    """What a campaign imports needs nothing that tests/conftest.py sets up."""
    names = sorted(file.stem for file in HERE.joinpath("campaigns").glob("*.py"))
    script = f"""
import importlib, sys
sys.path[:0] = [{str(HERE / "campaigns")!r}, {str(HERE)!r}]
print(*(importlib.import_module(name).__name__ for name in {names}))
"""
    assert printed_by(script).split() == names
