"""Compiled loops over plain arrays; how they are compiled and cached."""
