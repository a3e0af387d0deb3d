"""The best solution of a complementarity problem, by branch and bound with proofs."""
