"""Projected full multigrid: projected sweeps, truncated V-cycles on the free unknowns, nested iteration."""
