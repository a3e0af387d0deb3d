"""Rows of M spread over the ranks of an MPI job.

Once PETSc is there (see `examples/manual/many_machines.md`), run a command or a script on so many ranks::

    mpiexec -n 2 lcp-plugin solve obstacle-2d --size 500 --backend petsc --out answer
    mpiexec -n 2 python membrane.py

where each rank of ``membrane.py`` gives the rows it has, counted from 0 over all ranks::

    import numpy as np, scipy.sparse as sp
    from mpi4py import MPI
    from lcp_plugin import LCP, solve

    comm, n = MPI.COMM_WORLD, 10_000
    first, last = n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size
    M = sp.diags_array([-np.ones(n - 1), np.full(n, 2.0), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr")
    rows = M[first:last]                                  # shape (last − first, n); build only these in earnest
    problem = LCP.from_rows(comm, rows, np.full(last - first, 1e-8), lower=-0.1)
    result = solve(problem, error_bound=True)             # z and w are the own parts, all else agrees on every rank
    if comm.rank == 0:
        print(result)

**Which methods:** "auto" (multigrid, then psor), npj npgs npsor npaor, pgs psor, with all their options. A sweep runs
on all ranks at once, with what the others had before it. The proof for the projected-type methods covers that; the
in-place ones converge on H₊-matrices with a relaxation ≤ 1, and on symmetric positive definite ones, where pivots next
to other ranks are made larger. Whatever else needs all rows on one machine (newton, lemke, ``analyze``, conversions)
says so.

**Multigrid** is the one of a single process. Each rank chooses the coarse ones among its own unknowns; interpolation,
Galerkin products and truncation are exact across ranks. Where the coarse unknowns of neighbouring ranks meet badly, it
takes 10 to 22 cycles instead of 8. Aggregates as PETSc's GAMG makes them were tried and left: a coarse unknown covers
many rows, and more is lost near a free boundary.

**Proofs:** ``error_bound=True`` finds v > 0 with ⟨M⟩v > 0, verifies it on every rank, and makes it a rigorous bound.
``Certificate.of`` and ``error_bound`` take such a problem as any other.

**Files:** ``problem.save(folder)`` writes a chunk a rank, ``LCP.load(folder, comm)`` reads it on any number of ranks.
``LCP.from_problem`` cuts a whole problem into equal parts.

**Failures:** bad input is refused on every rank and reported once; a rank that dies or raises ends the job.

Measured on the two cores of one machine, 2-D obstacle (``python tests/distributed/benchmark.py``):

| n | what | measured |
|---|---|---|
| 10⁶ | one process · 1 rank · 2 ranks | 0.84 s · 0.98 s · 0.66 s, the least of four runs, and 8 · 8 · 10 cycles |
| 2.5·10⁵ | PETSc's SNESVI with CG and GAMG from z = 0 ÷ ours, 2 ranks | 14.9 s ÷ 0.17 s, 63 Newton steps |
| 1.6·10⁷ | 2 ranks | 29–31 s, 10 cycles, 5.5 GB a rank at the peak (5.9 GB from the command line) |

Coarsening ends at 60 unknowns in all, and no rank gives up its last one. From about a hundred ranks on (reckoned, not
run) the coarsest grid has as many unknowns as ranks, which its 21 sweeps no longer solve, so that the cycles will grow.
"""
