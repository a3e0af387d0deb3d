"""Common parts of batches, time stepping and derivatives: batch data, and sequences of results."""
