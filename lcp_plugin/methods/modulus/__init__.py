"""Modulus-based splittings, in which complementarity holds by construction."""
