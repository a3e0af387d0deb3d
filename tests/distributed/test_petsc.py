"""The claims of `petsc_claims.py` hold on one and on two ranks."""

from importlib.util import find_spec
from pathlib import Path

import pytest
from launch import run

SCRIPT = Path(__file__).with_name("petsc_claims.py")


@pytest.mark.skipif(find_spec("petsc4py") is None, reason="PETSc's matrices need petsc4py")
@pytest.mark.parametrize("ranks", [1, 2])
def test_claims_about_petsc_hold_on_ranks(ranks):
    """All claims hold, and each one is printed once."""
    done = run(ranks, str(SCRIPT), timeout=500.0)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 4
