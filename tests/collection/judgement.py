"""What a result of the solver is worth, held against what is known of the problem."""

from __future__ import annotations

from typing import Any

from oracles.truth import INFEASIBLE, NO_SOLUTION, SOLVABLE, ExactData, is_farkas

from .entry import Entry

LARGEST_EXHAUSTIVE = 20  # above, NO_SOLUTION cannot be asked for


def false_claim(problem: Any, truth: str, result: Any, tolerance: float) -> str:
    """Return what the result claims wrongly, or nothing."""
    status = result.status.name
    if status == "SOLVED" and ExactData(problem).is_lie(result.z, tolerance):
        return "lie: the exact residual is above the tolerance"
    if status == "SOLVED" and truth != SOLVABLE:
        return "false SOLVED"
    data, has_no_solution = ExactData(problem), result.infeasibility is not None
    if status == "PRECISION_LIMIT" and not (
        data.is_at_rounding_level(result.z)
        or (has_no_solution and data.misses_by_rounding_of_q(result.z))
    ):
        return "PRECISION_LIMIT, but rounding does not explain the residual"
    if status == "INFEASIBLE" and truth != INFEASIBLE:
        return "false INFEASIBLE"
    if status == "INFEASIBLE" and not is_proven(problem, result):
        return "INFEASIBLE without a proof that holds"
    if status == "NO_SOLUTION" and truth == SOLVABLE:
        return "false NO_SOLUTION"
    return ""


def shortfall(problem: Any, truth: str, result: Any) -> str:
    """Return what the result should have said and did not, or nothing."""
    status = result.status.name
    wanted = {
        SOLVABLE: ("SOLVED", "PRECISION_LIMIT"),
        INFEASIBLE: ("INFEASIBLE",),
        NO_SOLUTION: ("NO_SOLUTION",),
    }[truth]
    if truth == NO_SOLUTION and problem.n > LARGEST_EXHAUSTIVE:
        wanted = ("NO_SOLUTION", "STALLED")
    if status in wanted:
        return ""
    return f"{truth}, got {status} (relative residual {result.certificate.relative_residual:.1e})"


def is_proven(problem: Any, result: Any) -> bool:
    """Whether the proof of infeasibility verifies itself, and its fractions also by our own arithmetic."""
    proof = result.infeasibility
    if proof is None or not proof.verify():
        return False
    return is_farkas(problem, proof.exact_y)


def judge(entry: Entry, result: Any, tolerance: float) -> str:
    """Return everything wrong with a result on an entry of the collection, or nothing."""
    truth = entry.truth
    return false_claim(entry.problem, truth, result, tolerance) or shortfall(
        entry.problem, truth, result
    )
