"""The kernels of least_squares."""
