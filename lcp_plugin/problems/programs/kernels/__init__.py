"""The kernels of programs."""
