"""Active sets on a narrow band, compiled; on tridiagonal M-matrices the contacts are found directly."""
