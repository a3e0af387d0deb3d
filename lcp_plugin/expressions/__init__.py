"""Expressions as programs: levels of elementary functions between sparse matrices; models stated in them."""
