"""Core: problem data, algorithms, stopping criterion, run loop, results.

Suggested reading order:

1. ``errors``, ``checks``, ``settings``: exceptions, input validation, options, and the termination ``Status``.
2. ``matrix`` and ``lcp``: the matrix with cached properties; the problem. ``rounding`` has bounds of rounding errors.
3. ``certificates``: residuals with rounding errors, and the stopping criterion.
4. ``algorithm`` and ``splittings``: the interface of algorithms; the sweeps of the paper and their relatives, with
   their compiled loops in ``kernels``.
5. ``solving``: ``stage`` is one method and its budget, ``run`` the loop, ``termination`` its test; ``result``.
6. ``deadline``: the clock of a run. ``tuning``: the sizes from which each method is cheaper; :mod:`lcp_plugin.auto`
   plans the stages of ``auto`` by them.
"""
