"""Feasibility and exhaustive search as stages of a run: they end it with a solution or with a proof."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...certificates.infeasibility import decide_feasibility
from ...certificates.no_solution import find_forced_contradiction
from ...checks import FloatVector
from ...crossovers import LINEAR_PROGRAM_UP_TO
from ...errors import UnsuitableProblem
from ...exact.simplex import QUANTUM
from ...problem.lcp import LCP
from ...settings import MEASURES
from ..base import Algorithm, Step, without_warnings
from . import LARGEST_CHOICES, LARGEST_SIZE, Effort, Found, NoSolution, explore

CASES_A_STEP = 50
MOST_CASES = 20_000
MOST_PRODUCTS = 300 * QUANTUM  # some seconds


@dataclass(frozen=True, kw_only=True)
class FeasibilityCheck(Algorithm):
    """Looks for a proof that no z satisfies the linear inequalities, or that complementarity contradicts itself."""

    name: ClassVar[str] = "feasibility"
    assumption: ClassVar[str] = "a linear program of that size can be solved"
    converges_on: ClassVar[str] = "–"
    cost: ClassVar[str] = "one linear program"
    reference: ClassVar[str] = "Farkas"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then once more with each proof that is found."""
        return without_warnings(self._steps(problem, z0))

    def _steps(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        yield Step(z0, work=0.0)
        effort = None if problem.n <= LINEAR_PROGRAM_UP_TO else 0
        # Where one contradiction is too small for the caller's measure and tolerance, another one may be large enough.
        for measure in MEASURES:
            proof = decide_feasibility(problem, effort_limit=effort, measure=measure).proof
            if proof is None:
                break
            yield Step(z0, proof=proof)
        chain = find_forced_contradiction(problem)
        if chain is not None:
            yield Step(z0, proof=chain)


@dataclass(frozen=True, kw_only=True)
class ExhaustiveSearch(Algorithm):
    """Branch and bound over z_i = bound, w_i = 0 in exact arithmetic; finds a solution or proves that there is none."""

    name: ClassVar[str] = "search"
    assumption: ClassVar[str] = f"at most {LARGEST_CHOICES} rows that leave a choice, n ≤ {LARGEST_SIZE}"
    converges_on: ClassVar[str] = "every matrix"
    cost: ClassVar[str] = f"at most {CASES_A_STEP} cases, each an exact linear program"
    reference: ClassVar[str] = "Cottle, Pang, Stone, §1.3"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z0 while it searches, then the solution, or z0 with the proof; end where that takes too much."""
        return without_warnings(self._steps(problem, z0))

    def _steps(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        yield Step(z0, work=0.0)
        effort, told = Effort(), Effort()
        for outcome in explore(problem, effort):
            is_due = effort.cases - told.cases >= CASES_A_STEP or effort.products - told.products >= QUANTUM
            if outcome is None and not is_due:
                continue
            step = Step(z0, work=(effort.entries - told.entries) / max(problem.nonzeros, 1))
            told = replace(effort)
            if isinstance(outcome, Found):
                try:
                    step.z = np.clip(outcome.solutions[0].z, problem.lower, problem.upper)
                except UnsuitableProblem as error:
                    step.remark = f"a search of all cases found a solution, but {error}"
            elif isinstance(outcome, NoSolution):
                step.proof = outcome.infeasibility or outcome
            elif effort.cases >= MOST_CASES or effort.products >= MOST_PRODUCTS:
                step.remark = f"not decided in {effort.cases} cases of an exact search; all_solutions goes on"
            yield step
            if step.remark:
                return

