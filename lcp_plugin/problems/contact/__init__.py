"""Contact with friction: pyramids as complementarity problems, and impulses, slip and stick from their answers."""
