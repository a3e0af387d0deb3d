"""Distance of z from the solution, bounded by inequalities of rows and by curvature."""
