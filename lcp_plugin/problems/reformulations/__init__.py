"""Games and absolute value equations as linear complementarity problems, and back."""
