"""What is proved about the convergence of a method on a matrix."""
