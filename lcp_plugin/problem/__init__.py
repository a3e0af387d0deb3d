"""The linear complementarity problem, and its files."""
