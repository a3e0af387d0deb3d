"""What every solve needs: problem, algorithms, certificate, driver, result.

Read it in this order:

1. ``errors``, ``checks``, ``settings``: what is refused, what may be asked, how a run may end (``Status``).
2. ``matrix`` and ``lcp``: M with its facts, each computed once; the problem. ``rounding`` has the margins of rounding.
3. ``certificates``: the residual of z, rounding included, after which scaling, beside what: the criterion.
4. ``algorithm`` and ``splittings``: what an algorithm is, and the sweeps of the paper and their relatives, with their
   loops in ``kernels``.
5. ``solving``: ``driver`` begins a run, ``run`` drives it, ``judge`` says when it is done, ``result`` what is given
   back.
6. ``policy``: what chooses the algorithms of a run; :mod:`lcp_plugin.auto` is the one behind ``auto``. ``kind``: a kind
   of problem, and what takes it. ``deadline``: the clock of a run. ``tuning``: up to where each way is the cheaper.

To be looked up: ``written``, reprs that can be pasted.
"""
