"""The kernels of banded."""
