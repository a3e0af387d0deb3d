"""Processes, and the contents of files, for several folders of tests."""
