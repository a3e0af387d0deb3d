"""Doors: how the solver is reached from other packages."""
