"""Derivatives of solutions by the data, of one problem and of batches."""
