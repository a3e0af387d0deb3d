"""Other problems as linear complementarity problems and back: pure functions, one kind of problem a file.

Every function ``lcp_from_…`` returns an :class:`~lcp_plugin.problem.lcp.LCP` whose ``origin`` remembers where it came
from: ``origin.recover(result)``, with a result of ``solve`` or any z, gives the answer in the terms of the problem
that was asked, together with a measure of how wrong it is there.
"""
