"""An algebraic multigrid hierarchy of one matrix, and its truncation to the unknowns that are free."""
