"""What can be proved about an answer, from the data of the caller alone."""
