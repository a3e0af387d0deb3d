"""The kernels of sensitivity."""
