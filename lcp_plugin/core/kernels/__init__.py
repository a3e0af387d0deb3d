"""Compiled loops over arrays, and the one way to compile and keep them; they know no problem and no class."""
