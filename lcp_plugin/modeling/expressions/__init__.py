"""Expressions as programs: levels of elementary functions between sparse matrices, whatever language they came from."""
