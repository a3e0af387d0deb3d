"""Small dense problems, solved by one compiled call: sweeps, rounds of active sets, pivots."""
