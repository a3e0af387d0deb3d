"""The kernels of interior."""
