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
from ..core.kernels.compilation import cache_folder
from ..core.lcp import LCP
from ..problems.batches.batch import solve_batch
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.cones.methods import METHODS
from ..problems.march.march_many import march
from ..problems.programs.stacked_programs import QuadraticProgramBatch
from ..problems.sensitivity import derivative
from ..proofs.bounds.error_bounds import error_bound

PARTS = ("multigrid", "banded", "newton", "batches", "lemke", "cones", "others")


def compile_everything() -> str:
    """Compile what is not in the cache yet; return a line with its place and the seconds."""
    began = time.perf_counter()
    for part in PARTS:
        compile_part(part)
    return f"kernels compiled in {time.perf_counter() - began:.1f} s; they lie in {cache_folder()}"


def compile_part(part: str) -> None:
    """Run what needs the kernels of one part."""
    sparse = gallery.build("obstacle_2d", size=20).problem
    dense = LCP(sparse.csr[:9, :9].toarray(), sparse.q[:9], lower=-1.0, upper=1.0)
    if part == "batches":
        solve_batch(QuadraticProgramBatch(np.eye(2), np.ones(2), [[1.0, 1.0]], [-3.0]))
        found = derivative(solve_batch([dense]))
        found.vjp(np.ones((1, 9)))
        found.jvp(dq=np.ones(9))
        return
    if part == "cones":
        contact = FrictionalContact(2.0 * np.eye(6), [-1.0, 3.0, 4.0, -1.0, 0.1, 0.2], 0.5)
        for name in METHODS:
            derivative(solve(contact, name)).vjp(np.ones(6))
        solve_batch([contact, contact])
        return
    for name in REGISTRY if part == "others" else (part,):
        for problem, record in product((sparse, dense), (False, True)):  # fused, and step by step
            with suppress(LCPError):  # not every algorithm takes every matrix
                solve(problem, name, record=record, max_iterations=20)
    if part == "banded":
        steps = derivative(march(sparse, np.zeros((2, sparse.n)), algorithm=part))
        steps.vjp(np.ones(sparse.n))
        steps.jvp(dz0=np.ones(sparse.n))
    else:
        for problem in (sparse, dense):
            error_bound(problem, solve(problem, "auto" if part == "others" else part).z)
    if part == "others":
        solve(gallery.build("bimatrix_game").problem)  # without a diagonal
        opposed = LCP(
            [[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0]
        )  # no solution: all cases are looked at
        solve(opposed)
        solve_batch([opposed, opposed], prove_infeasibility=False)
        program = LCP.from_qp(np.eye(2), np.ones(2), A=[[1.0, 1.0]], b=[1.0])
        program.origin.recover(solve(program)).is_stationary()
