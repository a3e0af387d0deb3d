"""Feasibility and exhaustive search as stages of a run: they end it with a solution or with a proof."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...certificates.infeasibility import decide_feasibility
from ...certificates.no_solution import Case, find_forced_contradiction
from ...checks import FloatVector
from ...crossovers import LINEAR_PROGRAM_UP_TO
from ...errors import UnsuitableProblem
from ...exact.simplex import QUANTUM
from ...problem.lcp import LCP
from ...settings import MEASURES
from ..base import Algorithm, Step, without_warnings
from . import LARGEST_CHOICES, LARGEST_SIZE, Effort, Found, NoSolution, explore, is_searchable
from .outline import outline

CASES_A_STEP = 50
MOST_CASES = 20_000
MOST_PRODUCTS = 300 * QUANTUM  # some seconds
MOST_ENTRIES = 1e9  # about a second
FIRST_ENTRIES, FIRST_PRODUCTS = 1e7, QUANTUM  # some ten milliseconds: no more than the methods after it take


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
    """Branch and bound over z_i = bound, w_i = 0: in doubles, compiled; what these do not prove, in exact arithmetic.

    Parameters
    ----------
    is_first : bool
        A look before other methods, with less patience; what it leaves open is said by another one at the end.
    refutes : bool
        Where False, the pass in doubles looks for a solution and nothing is proved.
    """

    is_first: bool = False
    refutes: bool = True

    name: ClassVar[str] = "search"
    assumption: ClassVar[str] = f"n ≤ {LARGEST_SIZE}; exactly: at most {LARGEST_CHOICES} rows that leave a choice"
    converges_on: ClassVar[str] = "every matrix"
    cost: ClassVar[str] = "all cases in doubles; then at most 50, each an exact linear program"
    reference: ClassVar[str] = "Cottle, Pang, Stone, §1.3"
    is_monotone: ClassVar[bool] = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z0 while it searches, then the solution, or z0 with the proof; end where that takes too much."""
        return without_warnings(self._steps(problem, z0))

    def _steps(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        yield Step(z0, work=0.0)
        seen = outline(problem, FIRST_ENTRIES if self.is_first else MOST_ENTRIES)
        step = Step(z0 if seen.z is None else seen.z, work=seen.entries / max(problem.nonzeros, 1))
        if seen.tree is not None and self.refutes:
            proof = NoSolution(problem, seen.tree, seen.cases)
            step.proof = proof.infeasibility or proof
        elif seen.tree is not None:
            step.least_residual, step.remark = seen.least_residual, "in double precision every case contradicts"
        yield step
        is_proved = step.proof is not None and step.proof.exact  # but the contradiction is too small for the run
        if self.refutes and not is_proved and is_searchable(problem):
            yield from self._exactly(problem, z0, seen.tree)

    def _exactly(self, problem: LCP, z0: FloatVector, tree: Case | None) -> Iterator[Step]:
        """Yield z0 while exact arithmetic looks at all cases, or at those of a tree that are not closed."""
        effort, told = Effort(), Effort()
        for outcome in explore(problem, effort, tree=tree):
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
            elif effort.cases >= MOST_CASES or effort.products >= (FIRST_PRODUCTS if self.is_first else MOST_PRODUCTS):
                if self.is_first:
                    return
                step.remark = f"not decided in {effort.cases} cases of an exact search; all_solutions goes on"
            yield step
            if step.remark:
                return
