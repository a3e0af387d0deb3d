"""The kernels of small."""
