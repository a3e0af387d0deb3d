"""Active sets: semismooth Newton, and unknowns without bounds eliminated before it (static condensation)."""
