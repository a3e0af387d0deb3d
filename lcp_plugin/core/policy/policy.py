"""What a policy is: it chooses which algorithm begins, and after each step whether another one takes over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..algorithm import Algorithm
from ..checks import FloatVector
from ..lcp import LCP
from .stages import Choice, Stage


class Policy:
    """Chooses the first algorithm, and after each step whether another one takes over.

    Attributes
    ----------
    name : str
    chosen : str or Algorithm
        What the caller asked for.
    algorithm : Algorithm or None
        The only one, where it is one.
    """

    name: str
    chosen: Any
    algorithm: Algorithm | None = None
    left_out: Sequence[str] = ()  # what it did not try and why, in words

    def first(self, problem: LCP) -> Choice:
        """Return the algorithm to begin with."""
        raise NotImplementedError

    def next_step(
        self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return the algorithm that takes over, or None to go on (where the present one failed: to end)."""
        return None

    def last_system(
        self, problem: LCP, z: FloatVector, work: float, is_solved: bool
    ) -> tuple[FloatVector, float] | None:
        """Return the solution of the linear system of the case that z shows, and its work; None where it is not solved.

        The case is which unknowns are at which bound; `work` is that of the run, and `is_solved` what it has reached.
        """
        return None


PARTS_IN_WORDS = {
    "newton": "guesses which unknowns are at a bound and solves for the others, until the guess proves right",
    "lemke": "pivots: brings one unknown at a time to its bound, or away from it",
}


def with_reasons(
    parts: Sequence[tuple[str, int, float]], algorithm: Algorithm, because: str
) -> list[tuple[str, str, int, float]]:
    """Return the parts of an algorithm with why each ran: in words of its own, or, of the first, as it was chosen.

    Parameters
    ----------
    parts : sequence of (name, iterations, work)
    """

    def reason(k: int, name: str) -> str:
        if name != algorithm.name and name in PARTS_IN_WORDS:
            return PARTS_IN_WORDS[name]
        return "" if k else because

    return [
        (name, reason(k, name), iterations, work)
        for k, (name, iterations, work) in enumerate(parts)
    ]


def name_of(policy: Policy, stages: Sequence[Any]) -> str:
    """Return what ran: the policy, and the chain of what it chose, as records of stages, where that says more."""
    chain = [stage.name for stage in stages]
    return (
        policy.name if "".join(chain) in ("", policy.name) else f"{policy.name}: {', '.join(chain)}"
    )
