"""LCPs whose rows are spread over the ranks of an MPI job, for problems that do not fit one machine.

Install mpi4py and an MPI library: ``pip install '.[mpi]'``. Each rank passes its local rows::

    import numpy as np, scipy.sparse as sp
    from mpi4py import MPI
    from lcp_plugin import LCP

    comm, n = MPI.COMM_WORLD, 1_000
    first, last = n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size
    M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n), format="csr")
    problem = LCP.from_rows(comm, M[first:last], np.full(last - first, 1e-6), lower=-0.1)  # the local rows
    result = problem.solve()                              # z and w are local, all else agrees on every rank
    if comm.rank == 0:
        print(result)

All ranks call every method, in the same order. Vectors are the local parts, all other results are the same on every
rank. Algorithms: auto, multigrid, npsor, npaor, npgs, npj, psor, pgs. ``auto`` is multigrid; then rank 0 solves a
problem with at most 100 000 unknowns in one process, and a larger one continues with sweeps. Use
``LCP.from_petsc(A, q, lower=…, upper=…)`` for a matrix and vectors of petsc4py; z and w of its result are PETSc
vectors. ``certify(problem, x)`` measures a point from any solver. Run the script by ``mpiexec -n 2 python -m mpi4py
script.py``: then an exception on one rank ends all ranks.

The problem is in ``problem``, the loop and the criterion of SOLVED in ``solving``, sweeps and multigrid in ``methods``,
MPI in ``halo``, and PETSc in ``petsc``.
"""
