"""How far z is from the solution: rows of inequalities, curvature, and when a run is worth a bound."""
