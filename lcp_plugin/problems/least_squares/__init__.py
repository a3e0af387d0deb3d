"""Least squares within bounds: steps that find the face, and steps that solve on it."""
