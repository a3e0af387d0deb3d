"""Methods, a subpackage each: an iterator with its kernels and its prediction of work."""
