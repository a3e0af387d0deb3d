"""Small dense problems by numpy: sweeps, active-set iterations, pivots."""
