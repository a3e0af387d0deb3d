"""Measured thresholds: the sizes from which one method is cheaper than another, and sizes that are too large to try.

Numbers that follow from a theorem or from double precision are next to their proofs.
"""

from __future__ import annotations

# Work of a solution in passes over M, for the plan of ``auto``.
DIRECT_PASSES = 10.0  # interior_point on a dense symmetric M: a third of what is measured, as npsor promises too much
DIRECT_ROWS = 0.25  # by n: newton or interior_point where a dense M is not symmetric
DIRECT_ENTRIES = 12_500.0  # entries that the same touches for a row of a sparse M
DIRECT_CUBE = 0.06  # times n³ at most, if M is small
SWEEP_ENTRIES = 10_000.0  # cost of a driven sweep in addition to its pass, in entries of M
DIRECT_UP_TO = 1000  # rows of a sparse M above which multigrid is cheaper than a factorization
MULTIGRID_PASSES = 90.0  # on large grids
MULTIGRID_ROWS = 350_000.0  # additional cost of its calls on all levels, in rows of passes over M
BANDED_PASSES = 150.0  # up to here a band comes before sweeps that nothing proves quick
BANDED_ROUNDS = 5.0  # active sets that banded solves for on random bands
BOXED_ROUNDS = 3.0  # the same on tridiagonal M-matrices and boxes
PSOR_PASSES = 20.0  # psor with automatic relaxation, however near the answer is
PSOR_GAIN = (
    3.0  # sweeps of psor with automatic relaxation by the root of those that npsor still needs
)
INTERIOR_STEPS = 20  # factorizations that interior_point takes
PIVOTS_FIRST_UP_TO = 500  # rows of a sparse M from which on those are cheaper than lemke's pivots

# Up to where a sparse matrix is quicker shown to be definite as a dense one.
CHOLESKY_UP_TO = 150  # rows, with any entries
FULL_CHOLESKY_FROM = (
    0.02  # share of the entries that are not zero, in no order that a sparse factor could use
)

# Sizes that a plan never exceeds.
FULL_CHOLESKY_UP_TO = (
    1500  # rows: the gain of a dense factorization grows with n, and its loss on a band also
)
LINEAR_PROGRAM_UP_TO = (
    5000  # rows of a linear program, whose fill-in is not known before: some seconds
)
DENSE_OPERATIONS, SPARSE_OPERATIONS = (
    2e10,
    1e9,
)  # a second, of LAPACK on one thread and of SuperLU, qdldl, our loops
FACTOR_OPERATIONS_UP_TO = (
    2e10  # Σ count² over the columns of a Cholesky factor L: 5 to 10 seconds, a 3-D grid of 37³
)
PIVOTED_UP_TO = 6000  # rows whose inverse lemke keeps: 0.3 GB
SEMIDEFINITENESS_UP_TO = (
    20_000  # rows of a symmetric part that is factorised for the question alone
)

# Inside methods.
SHARED_FROM = 65_536  # rows of one pass, for each thread: .1 to .2 ms of work, several times the start of a thread
