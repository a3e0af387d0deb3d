"""What ranks gain: ``python tests/distributed/benchmark.py`` runs itself under mpiexec and prints ratios.

Every time is wall-clock from (M, q) on the ranks to the verified result, the least of some runs in turn; the first run
of each process compiles and is not counted. Memory is the most that a rank held at any time.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from launch import run

TOLERANCE = 1e-8
RUNS = 5
SERIAL_RUNS = 5
LARGE = 4000
FETCHES = 300


def main(arguments: list[str]) -> None:
    """Measure one task on the present ranks, or without a task run all of them under mpiexec."""
    if arguments:
        task, size = arguments[0], int(arguments[1])
        _report(TASKS[task](size))
        return
    for line in table():
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


def table(size: int = 1000, small: int = 500, large: int = LARGE) -> Iterator[str]:
    """Yield the lines of the benchmark."""
    serial, one, two = (
        _run(ranks, task, size)
        for ranks, task in ((1, "serial"), (1, "multigrid"), (2, "multigrid"))
    )
    yield f"2-D obstacle, n = {size**2}: one process {serial['seconds']:.2f} s, {serial['iterations']} cycles"
    for name, found in (("1 rank", one), ("2 ranks", two)):
        yield (
            f"2-D obstacle, n = {size**2}: {name} {found['seconds']:.2f} s, {found['iterations']} cycles, "
            f"{found['megabytes']:.0f} MB a rank, {found['status']}"
        )
    yield f"1 rank ÷ one process {one['seconds'] / serial['seconds']:.2f}   target ≤ 2.5"
    yield f"1 rank ÷ 2 ranks {one['seconds'] / two['seconds']:.2f}   target ≥ 1.5"
    ours, theirs = _run(2, "multigrid", small), _run(2, "snesvi", small)
    yield (
        f"2-D obstacle, n = {small**2}, 2 ranks: ours {ours['seconds']:.2f} s, SNESVI with CG and GAMG from 0 "
        f"{theirs['seconds']:.2f} s ({theirs['iterations']} Newton steps, {theirs['status']}): "
        f"{theirs['seconds'] / ours['seconds']:.1f}   target ≥ 3"
    )
    found = _run(2, "anatomy", size)
    yield (
        f"2-D obstacle, n = {size**2}, 2 ranks: a fetch {found['fetch'] * 1e6:.0f} µs, a V-cycle "
        f"{found['cycle'] * 1e3:.0f} ms; foreign values {found['foreign'][0]}, on all grids {sum(found['foreign'])}"
    )
    found = _run(2, "once", large)
    yield (
        f"2-D obstacle, n = {large**2}, 2 ranks: {found['seconds']:.1f} s, {found['iterations']} cycles, "
        f"{found['status']}, {found['megabytes'] / 1024:.1f} GB a rank at the peak   target 24 GB in all"
    )


def _anatomy(size: int) -> dict[str, Any]:
    """Time a fetch of foreign values and a cycle over all grids; count the foreign values of each grid."""
    from mpi4py import MPI

    from lcp_plugin.commands.distributed import scene_on_ranks as build
    from lcp_plugin.systems.hierarchy.levels import hierarchy_of
    from lcp_plugin.systems.hierarchy.truncation import Truncation

    problem = build("obstacle_2d", MPI.COMM_WORLD, {"size": size}).problem
    hierarchy = hierarchy_of(problem.matrix, 60)
    truncation, grids = Truncation(hierarchy), hierarchy.grids

    def fetches() -> None:
        for _ in range(FETCHES):
            grids[0].communicator.fetch(truncation.grids[0].x)

    truncation.correct(0)  # compiles
    fetch, _ = _least(fetches, RUNS)
    cycle, _ = _least(lambda: truncation.correct(0), RUNS)
    return {
        "fetch": fetch / FETCHES,
        "cycle": cycle,
        "foreign": [grid.communicator.foreign for grid in grids],
    }


def _run(ranks: int, task: str, size: int) -> dict[str, Any]:
    done = run(ranks, str(Path(__file__)), task, str(size), timeout=900.0)
    if done.returncode:
        sys.exit(f"{task} on {ranks} ranks ended with {done.returncode}:\n{done.stderr}")
    answer: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return answer


def _report(content: dict[str, Any]) -> None:
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    content["megabytes"] = max(comm.allgather(peak))
    if comm.rank == 0:
        sys.stdout.write(json.dumps(content) + "\n")


def _least(call: Callable[[], Any], runs: int) -> tuple[float, Any]:
    """Return the least of the seconds that all ranks need for the call, and what it gave last."""
    from mpi4py import MPI

    seconds, answer = [], None
    for _ in range(runs):
        answer = None  # what the run before held is free again
        MPI.COMM_WORLD.Barrier()
        began = time.perf_counter()
        answer = call()
        seconds.append(max(MPI.COMM_WORLD.allgather(time.perf_counter() - began)))
    return min(seconds), answer


def _multigrid(size: int, runs: int = RUNS) -> dict[str, Any]:
    from mpi4py import MPI

    from lcp_plugin import solve
    from lcp_plugin.commands.distributed import scene_on_ranks as build

    solve(build("obstacle_2d", MPI.COMM_WORLD, {"size": 60}).problem, "multigrid")
    problem = build("obstacle_2d", MPI.COMM_WORLD, {"size": size}).problem
    seconds, result = _least(lambda: solve(problem, "multigrid", tolerance=TOLERANCE), runs)
    return {"seconds": seconds, "iterations": result.iterations, "status": result.status.name}


def _serial(size: int) -> dict[str, Any]:
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from benchmarks.multigrid import from_scratch

    from lcp_plugin.gallery import build

    from_scratch(build("obstacle_2d", size=60).problem)
    problem = build("obstacle_2d", size=size).problem
    seconds, result = _least(lambda: from_scratch(problem), SERIAL_RUNS)
    return {"seconds": seconds, "iterations": result.iterations, "status": result.status.name}


def _snesvi(size: int) -> dict[str, Any]:
    """Solve by PETSc's reduced-space Newton method with conjugate gradients and GAMG, from z = 0 within the bounds."""
    from mpi4py import MPI
    from petsc4py import PETSc

    from lcp_plugin.commands.distributed import scene_on_ranks as build
    from lcp_plugin.core.certificates.criterion import reference_residual
    from lcp_plugin.core.certificates.row_residuals import measured_residual
    from lcp_plugin.ranks.petsc.halo import numbered_over_all

    problem = build("obstacle_2d", MPI.COMM_WORLD, {"size": size}).problem
    layout, rows = (
        problem.matrix.communicator,
        numbered_over_all(problem.matrix.csr_rows, problem.matrix.communicator),
    )
    matrix = PETSc.Mat().create(comm=layout.comm)
    matrix.setSizes(((layout.own, layout.n), (layout.own, layout.n)))
    matrix.setType("aij")
    matrix.setPreallocationNNZ((5, 2))
    matrix.setValuesIJV(
        rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data
    )
    matrix.assemble()
    q, lower, upper = (
        _petsc_vector(layout.comm, part)
        for part in (problem.q, problem.lower, np.full(layout.own, PETSc.INFINITY))
    )

    def newton() -> Any:
        z = q.duplicate()
        z.set(0.0)
        snes = PETSc.SNES().create(layout.comm)
        snes.setType("vinewtonrsls")
        residual = q.duplicate()
        snes.setFunction(lambda _, x, f: (matrix.mult(x, f), f.axpy(1.0, q))[0], residual)
        snes.setJacobian(lambda *_: True, matrix)
        snes.setVariableBounds(lower, upper)
        snes.setTolerances(rtol=TOLERANCE, atol=0.0, stol=0.0, max_it=1000)
        snes.ksp.setType("cg")
        snes.ksp.setTolerances(rtol=1e-5)
        snes.ksp.pc.setType("gamg")
        snes.setFromOptions()
        snes.solve(None, z)
        return snes.getIterationNumber(), snes.getConvergedReason(), z

    seconds, (steps, reason, z) = _least(newton, 1)
    reached = measured_residual(problem, z.getArray().copy()) / reference_residual(problem)
    return {
        "seconds": seconds,
        "iterations": steps,
        "status": f"reason {reason}, relative residual {reached:.1e}",
    }


def _petsc_vector(comm: Any, values: Any) -> Any:
    from petsc4py import PETSc

    return PETSc.Vec().createWithArray(np.array(values), size=(values.size, None), comm=comm)


TASKS: dict[str, Callable[[int], dict[str, Any]]] = {
    "anatomy": _anatomy,
    "multigrid": _multigrid,
    "once": lambda size: _multigrid(size, 1),
    "serial": _serial,
    "snesvi": _snesvi,
}

if __name__ == "__main__":
    main(sys.argv[1:])
