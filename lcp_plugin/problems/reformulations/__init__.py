"""Bimatrix games as linear complementarity problems, and back."""
