"""Small dense problems by numpy: sweeps, rounds of active sets, pivots."""
