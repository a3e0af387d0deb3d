"""These tests start mpiexec themselves; they are skipped, with the reason, if it or mpi4py is missing."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
from launch import missing

HERE = Path(__file__).parent
#: Scripts that import what is missing cannot be searched for doctests.
NEEDS = {"claims.py": "mpi4py", "petsc_claims.py": "petsc4py", "petsc_times.py": "petsc4py"}
collect_ignore = [name for name, package in NEEDS.items() if find_spec(package) is None]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip every test of this folder if something is missing."""
    if lack := missing():
        skip = pytest.mark.skip(reason=f"several ranks need {lack}")
        for item in items:
            if HERE in item.path.parents:
                item.add_marker(skip)
