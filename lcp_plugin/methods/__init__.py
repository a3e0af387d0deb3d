"""Methods, a room each: an iterator with its kernels and its prediction of work."""
