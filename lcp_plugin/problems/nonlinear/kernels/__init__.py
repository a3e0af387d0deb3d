"""The kernels of nonlinear."""
