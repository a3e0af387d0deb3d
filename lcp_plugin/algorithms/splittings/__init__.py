"""Splitting methods: projected-type, projected relaxation, modulus-based."""
