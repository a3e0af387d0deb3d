"""The cvxpy side: complementarity constraints, models, registration."""
