"""The tests that cvxpy and scipy bring in their wheels, asked of this package: ``python tests/peers``."""
