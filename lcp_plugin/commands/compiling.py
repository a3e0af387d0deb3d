"""`lcp-plugin warm-up`: compile every kernel once."""

from __future__ import annotations

import time
from contextlib import suppress
from itertools import product

import numpy as np

from .. import gallery
from ..algorithms import REGISTRY
from ..api import solve
from ..core.errors import LCPError
from ..core.lcp import LCP
from ..problems.batches.batch import solve_batch
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.cones.methods import METHODS
from ..problems.march.march_many import march
from ..problems.programs.stacked_programs import QuadraticProgramBatch
from ..problems.sensitivity import derivative
from ..proofs.bounds.error_bounds import error_bound


def compile_everything() -> str:
    """Compile what is not in the cache yet; return a line with the seconds."""
    began = time.perf_counter()
    sparse = gallery.build("obstacle_2d", size=20).problem
    dense = LCP(sparse.csr[:9, :9].toarray(), sparse.q[:9], lower=-1.0, upper=1.0)
    for name, problem, record in product(REGISTRY, (sparse, dense), (False, True)):
        with suppress(LCPError):  # not every algorithm takes every matrix
            solve(problem, name, record=record, max_iterations=20)
    for problem in (sparse, dense):
        error_bound(problem, solve(problem).z)
    steps = derivative(march(sparse, np.zeros((2, sparse.n)), algorithm="banded"))
    steps.vjp(np.ones(sparse.n))
    steps.jvp(dz0=np.ones(sparse.n))
    contact = FrictionalContact(2.0 * np.eye(6), [-1.0, 3.0, 4.0, -1.0, 0.1, 0.2], 0.5)
    for name in METHODS:
        derivative(solve(contact, name)).vjp(np.ones(6))
    found = derivative(solve_batch([dense]))
    found.vjp(np.ones((1, 9)))
    found.jvp(dq=np.ones(9))
    no_solution = LCP(
        [[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0]
    )  # an exact search enumerates all pieces
    solve_batch([no_solution, no_solution], prove_infeasibility=False)
    for problem in (no_solution, gallery.build("bimatrix_game").problem):
        solve(problem)
    solve_batch([contact, contact])
    solve_batch(QuadraticProgramBatch(np.eye(2), np.ones(2), [[1.0, 1.0]], [-3.0]))
    program = LCP.from_qp(np.eye(2), np.ones(2), A=[[1.0, 1.0]], b=[1.0])
    program.origin.recover(solve(program)).is_optimal()
    return f"kernels compiled in {time.perf_counter() - began:.1f} s"
