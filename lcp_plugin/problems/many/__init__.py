"""What batches, marches and derivatives share: data with an axis for the problems, and sequences of answers."""
