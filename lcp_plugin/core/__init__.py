"""Core: problem data, algorithms, files.

Suggested reading order:

1. ``errors``, ``checks``, ``settings``: exceptions, input validation, options, and the termination ``Status``.
2. ``matrix`` and ``lcp``: the matrix with cached properties; the problem. ``entries`` are functions of an array or CSR
   array, ``structure`` and ``sweep_data`` cached properties. ``rounding`` bounds rounding errors.
3. ``algorithm`` and ``splittings``: the interface of algorithms; the sweeps of the paper and their relatives, with
   their compiled loops in ``kernels``.
4. ``deadline``: the clock of a run. ``tuning``: the sizes from which each method is cheaper; ``files``;
   ``problem_classes``: the tables of classes, and of functions of higher floors that the classes here offer.

The loop of a run, its stages and its result are in :mod:`lcp_plugin.solving`.
"""
