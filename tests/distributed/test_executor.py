"""A batch on mpi4py's MPIPoolExecutor has the solutions of one process."""

from __future__ import annotations

from pathlib import Path

from launch import run

SCRIPT = """
import numpy as np
from mpi4py.futures import MPIPoolExecutor
from lcp_plugin import solve_batch

if __name__ == "__main__":
    A = np.random.default_rng(0).normal(size=(30, 4, 4))
    M, q = A @ A.transpose(0, 2, 1) + np.eye(4), A[:, 0]
    with MPIPoolExecutor() as executor:
        found = solve_batch(M, q, executor=executor)
    print(found.counts(), np.abs(found.x - solve_batch(M, q).x).max() < 1e-8)
"""


def test_a_batch_on_mpi_has_the_solutions_of_one_process(tmp_path: Path) -> None:
    """Rank 0 submits the chunks, rank 1 solves them."""
    script = tmp_path / "batch.py"
    script.write_text(SCRIPT)
    done = run(2, "-m", "mpi4py.futures", str(script))
    assert done.stdout.split() == ["30", "SOLVED", "True"], done.stderr
