"""Interior points, and the active set that they lead to."""
