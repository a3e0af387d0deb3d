"""The best of the solutions of a complementarity problem, by branch and bound with rigorous bounds."""
