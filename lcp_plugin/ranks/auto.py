"""What ``auto`` does where no process holds all rows."""

from __future__ import annotations

from collections.abc import Sequence

from ..core.lcp import LCP
from ..core.policy.policy import Policy
from ..core.policy.stages import Choice, Stage
from ..core.splittings.projected_relaxation import PSOR
from ..methods.multigrid import Multigrid


class AutoOnRanks(Policy):
    """What is left of the tables where no process holds all rows: multigrid, then sweeps."""

    name = chosen = "auto"

    def first(self, problem: LCP) -> Choice:
        """Return multigrid, which needs about as many cycles whatever n is."""
        return Choice(Multigrid(hands_over=True))

    def next_step(
        self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return PSOR where multigrid came to an end."""
        return (
            Choice(PSOR(), "multigrid came to an end: projected sweeps")
            if failed and len(stages) == 1
            else None
        )
