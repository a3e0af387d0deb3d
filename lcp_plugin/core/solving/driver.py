"""What `solve` does with an LCP once its algorithm and its options are known."""

from __future__ import annotations

from ..checks import FloatVector
from ..deadline import Clock
from ..kernels.threads import threads_for
from ..lcp import LCP
from ..policy.policy import Policy
from ..settings import Settings
from .judge import End
from .result import Result
from .run import Callback, Run
from .run_log import Header


def solved_by(
    policy: Policy,
    problem: LCP,
    settings: Settings,
    start: FloatVector,
    clock: Clock,
    callback: Callback | None,
    *,
    header: Header | None = None,
) -> Result:
    """Return the result of the algorithms that a policy chooses.

    Parameters
    ----------
    policy : Policy
    problem : LCP
    settings : Settings
    start : ndarray, shape (n,)
        Within the bounds.
    clock : Clock
        Running.
    callback : callable or None
    header : callable, optional
        The line on M that ``verbose=True`` prints.
    """
    with threads_for(settings.threads):
        run = Run(problem, policy, settings, callback, clock, header=header)
        try:
            return run.judged(start, run.drive(start, policy.first(problem)))
        except KeyboardInterrupt:
            if run.state.iteration < 0:  # no step is made yet
                raise
            return run.judged(start, End.INTERRUPTED)
