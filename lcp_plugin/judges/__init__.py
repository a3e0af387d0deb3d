"""Stopping criteria: whether a point is SOLVED, as a function of arrays and a tolerance only.

One file has one rule: `lcp` for complementarity problems, `program` for quadratic programs, `cones` for contacts.
`certificate` and `worst_rows` read the numbers of a rule for a user. A rule does not know which algorithm found the
point, from which problem the data were converted, or which other problems are in the batch. It searches and factorizes
nothing. A compiled form of a rule accepts only points that the rule accepts; the proof is in its docstring.
"""
