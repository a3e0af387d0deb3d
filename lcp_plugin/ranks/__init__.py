"""LCPs whose rows are spread over the ranks of an MPI job, for problems that do not fit one machine.

``pip install mpi4py mpich`` (or an MPI library of the machine) is all that it needs. Each rank gives its own rows::

    import numpy as np, scipy.sparse as sp
    from mpi4py import MPI
    from lcp_plugin import LCP

    comm, n = MPI.COMM_WORLD, 10_000
    first, last = n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size
    M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n), format="csr")
    problem = LCP.from_rows(comm, M[first:last], np.full(last - first, 1e-8), lower=-0.1)  # the own rows
    result = problem.solve(error_bound=True)              # z and w are the own parts, all else agrees on every rank
    if comm.rank == 0:
        print(result)

All ranks call every method, in the same order; vectors are the own parts, everything else agrees. Algorithms: auto
(multigrid, then sweeps), multigrid, npsor, npaor, npgs, npj, psor, pgs. There are ``problem.save(folder)``, one chunk
per rank, ``RowsOnRanks.load(folder, comm)`` on any number of ranks, and ``RowsOnRanks.from_problem(lcp, comm)``. Run
the script by ``mpiexec -n 2 python -m mpi4py script.py``: then an exception on one rank ends all of them.

The classes are in ``problem``, the criterion of SOLVED in ``certificate``, the loop in ``solving``, sweeps and
multigrid in ``methods``, the distributed hierarchy in ``hierarchy``, MPI in ``collective`` and ``halo``.
"""
