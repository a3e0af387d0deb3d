"""Feasibility and exhaustive search as stages of a run, which ends with a solution or with a proof."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...core.algorithm import Algorithm, Step
from ...core.checks import FloatVector
from ...core.errors import UnsuitableProblem
from ...core.lcp import LCP
from ...core.tuning import LINEAR_PROGRAM_UP_TO
from ...proofs.no_solution.infeasibility import find_infeasibility
from . import Effort, NoSolution, Solutions, explore
from .simplex import QUANTUM

MOST_PRODUCTS = 300 * QUANTUM  # some seconds


@dataclass(frozen=True, kw_only=True)
class FeasibilityCheck(Algorithm):
    """Looks for a proof that no z satisfies the linear inequalities."""

    name: ClassVar[str] = "feasibility"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then the start again with each new proof."""
        yield Step(z0, work=0.0)
        effort = None if problem.n <= LINEAR_PROGRAM_UP_TO else 0
        proof = find_infeasibility(problem, effort_limit=effort)
        if proof is not None:
            yield Step(z0, proof=proof)


@dataclass(frozen=True, kw_only=True)
class ExhaustiveSearch(Algorithm):
    """Branch and bound over z_i = bound, w_i = 0 in exact arithmetic (Cottle, Pang, Stone, §1.3).

    n ≤ 60, at most 24 rows that leave a choice. A step is at most 50 cases, each an exact linear program.

    Parameters
    ----------
    prove_infeasibility : bool
        If False, the method searches for a solution without a proof that none exists.
    """

    prove_infeasibility: bool = True

    name: ClassVar[str] = "search"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z0 during the search, then the solution, or z0 with the proof; end if that takes too much."""
        yield Step(z0, work=0.0)
        effort, reported = Effort(), Effort()
        for outcome in explore(problem, effort):
            is_due = (
                effort.cases - reported.cases >= 50
                or effort.products - reported.products >= QUANTUM
            )
            if outcome is None and not is_due:
                continue
            step = Step(z0, work=(effort.entries - reported.entries) / max(problem.nonzeros, 1))
            reported = replace(effort)
            if isinstance(outcome, Solutions):
                try:
                    step.z = np.clip(outcome.solutions[0].z, problem.lower, problem.upper)
                except UnsuitableProblem as error:
                    step.remark = f"an enumeration of all active sets found a solution, but {error}"
            elif isinstance(outcome, NoSolution) and self.prove_infeasibility:
                step.proof = outcome.infeasibility or outcome
            elif effort.cases >= 20_000 or effort.products >= MOST_PRODUCTS:
                step.remark = (
                    f"not decided in {effort.cases} cases of an exact search; all_solutions goes on"
                )
            yield step
            if step.remark:
                return
