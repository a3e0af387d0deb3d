"""Core: problem data, algorithms, stopping criterion, run loop, results.

Suggested reading order:

1. ``errors``, ``checks``, ``settings``: exceptions, input validation, options, and the termination ``Status``.
2. ``matrix`` and ``lcp``: the matrix with cached properties; the problem. ``rounding`` has bounds of rounding errors.
3. ``certificates``: residuals with rounding errors, and the stopping criterion.
4. ``algorithm`` and ``splittings``: the interface of algorithms; the sweeps of the paper and their relatives, with
   their compiled loops in ``kernels``.
5. ``solving``: ``driver`` begins a run, ``run`` drives it, ``judge`` says when it is done, ``result`` what is given
   back.
6. ``policy``: what chooses the algorithms of a run; :mod:`lcp_plugin.auto` is the one behind ``auto``. ``kind``: a kind
   of problem, and what takes it. ``deadline``: the clock of a run. ``tuning``: up to where each way is the cheaper.

To be looked up: ``written``, reprs that can be pasted.
"""
