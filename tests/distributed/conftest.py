"""These tests start mpiexec themselves; where it or a package is missing they are skipped with the reason."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
from launch import missing

HERE = Path(__file__).parent
# What imports mpi4py or petsc4py at its top cannot even be collected without them.
collect_ignore_glob = [] if all(map(find_spec, ("mpi4py", "petsc4py"))) else ["*_on_ranks.py"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip every test of this folder where something is missing."""
    if lack := missing():
        skip = pytest.mark.skip(
            reason=f"several ranks need {lack}; see the extra petsc of pyproject.toml"
        )
        for item in items:
            if HERE in item.path.parents:
                item.add_marker(skip)
