"""The ranks of an MPI job, on PETSc; whoever imports this room needs both."""
