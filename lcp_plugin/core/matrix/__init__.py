"""The matrix, and what is known of it: each fact once, computed when it is first asked for."""
