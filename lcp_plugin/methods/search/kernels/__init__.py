"""The kernels of search."""
