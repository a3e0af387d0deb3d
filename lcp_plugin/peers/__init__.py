"""Who holds the other rows: nobody, or the ranks of an MPI job."""
