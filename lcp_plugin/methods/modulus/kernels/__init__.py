"""Compiled sweeps of the modulus-based iterations."""
