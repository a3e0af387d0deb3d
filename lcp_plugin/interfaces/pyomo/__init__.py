"""Pyomo: models with complementarities, programs and equilibria, and their answers."""
