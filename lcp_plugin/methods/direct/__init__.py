"""In which order auto tries the methods that factorise, pivot or search."""
