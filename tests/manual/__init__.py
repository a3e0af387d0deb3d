"""The manual as static pages, made from the docstrings, the examples and nothing else."""
