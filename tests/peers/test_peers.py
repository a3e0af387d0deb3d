"""The command that asks cvxpy's and scipy's own tests of this package."""

import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, str(Path(__file__).parent)]


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "code", "printed"),
    [
        ("cvxpy.InfeasibleProblems", 0, "2 passed, 0 failed, 0 not asked"),
        ("no such test", 1, "0 passed"),
    ],
)
def test_the_command_runs_what_is_named(name, code, printed):
    """Counts of what passed, failed and is not asked; exit code 1 where one fails, or none is named so."""
    done = subprocess.run([*COMMAND, name], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert printed in done.stdout


@pytest.mark.full
def test_the_tests_of_cvxpy_and_scipy_pass():
    """All of them, but those that say nothing about this package, each with its reason."""
    done = subprocess.run(COMMAND, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
