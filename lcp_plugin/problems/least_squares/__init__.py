"""Least squares within bounds by lstsq, nnls, PIQP or projected steps."""
