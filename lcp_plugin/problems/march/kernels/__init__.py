"""The kernels of march."""
