"""The manual as static pages, made from guides, the docstrings, the examples and nothing else."""
