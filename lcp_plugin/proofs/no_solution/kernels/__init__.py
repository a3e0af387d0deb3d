"""The kernels of no_solution."""
