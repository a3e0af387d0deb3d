"""What can be taken out of a problem before it is solved, and put back into its solution."""
