"""Linear systems with a principal block of M: factors, the free unknowns, an algebraic multigrid hierarchy."""
