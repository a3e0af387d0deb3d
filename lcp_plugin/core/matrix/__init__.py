"""The matrix and its properties, each computed once, at first use."""
