"""Reference answers that do not use the package: rational arithmetic, and relations between results."""
