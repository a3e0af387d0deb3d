"""Measured thresholds: the sizes from which one method is cheaper than another, and sizes that are too large to try.

Numbers that follow from a theorem or from double precision are next to their proofs.
"""

from __future__ import annotations

DIRECT_UP_TO = 1000  # rows of a sparse M above which multigrid is cheaper than a factorization
BANDED_PASSES = 150.0  # up to here a band comes before sweeps that nothing proves quick
PIVOTS_FIRST_UP_TO = 500  # rows of a sparse M up to which lemke's pivots come first

# Sizes that a plan never exceeds.
# rows: the gain of a dense factorization grows with n, and its loss on a band also
FULL_CHOLESKY_UP_TO = 1500
# rows of a linear program, whose fill-in is not known before: some seconds
LINEAR_PROGRAM_UP_TO = 5000
# a second, of LAPACK on one thread and of SuperLU, qdldl, our loops
DENSE_OPERATIONS, SPARSE_OPERATIONS = (2e10, 1e9)
# Σ count² over the columns of a Cholesky factor L: 5 to 10 seconds, a 3-D grid of 37³
FACTOR_OPERATIONS_UP_TO = 2e10
PIVOTED_UP_TO = 6000  # rows whose dense inverse or factorization is kept: 0.3 GB
# unknowns for which dense work, or another factorization, takes less than a second or two
CHEAP_UP_TO = 1000

# Inside methods.
SHARED_FROM = 65_536  # rows of one pass, for each thread: .1 to .2 ms of work, several times the start of a thread
