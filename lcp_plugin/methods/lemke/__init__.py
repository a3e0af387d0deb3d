"""Complementary pivoting: Lemke's method for bounds and free rows."""
