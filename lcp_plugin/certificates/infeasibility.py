"""Whether some z within the bounds has a w of the signs that they permit: a look at each row, then a linear program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from ..checks import FloatVector
from ..errors import InvalidOption
from ..exact.rational import Rational
from ..matrix.structure import compressed_rows
from ..problem.lcp import LCP
from ..problem.linear_constraints import DECISIVE, LinearConstraints
from .references import reference_residual
from .refutation import Infeasibility

Verdict = Literal["infeasible", "feasible", "undecided"]

DEFAULT_EFFORT = 20_000_000  # pivots times n: a minute or so of the linear program
UNITS_TRIED = 3


@dataclass(frozen=True, eq=False)
class Feasibility:
    """What is known about the linear constraints of a problem.

    Attributes
    ----------
    verdict : str
        "infeasible" (proven), "feasible" (up to the rounding of the linear program: `point`) or "undecided".
    proof : Infeasibility or None
    point : ndarray or None, shape (n,)
        Within the bounds, with w of the permitted signs up to rounding.
    reason : str
        A clause for the story of a run.
    """

    verdict: Verdict
    proof: Infeasibility | None = None
    point: FloatVector | None = field(default=None, repr=False)
    reason: str = ""


@np.errstate(all="ignore")
def decide_feasibility(
    problem: LCP, *, effort_limit: int | None = None, measure: str = "relative"
) -> Feasibility:
    """Return whether the linear constraints can be satisfied, with the proof that they cannot or a point that does.

    Without a solution of its linear constraints a problem has none; a monotone one (M positive semidefinite) that can
    satisfy them has one. Of the proofs, one with nearly the largest margin is looked for.

    Parameters
    ----------
    effort_limit : int, optional
        Pivots of the linear program, at least 0; by default 50 000 up to n = 400 and 2·10⁷/n above.
    measure : {"relative", "euclidean"}
        Whose margin a proof should have nearly the largest of.

    Raises
    ------
    InvalidOption
        Where the limit is no whole number ≥ 0.

    Examples
    --------
    >>> decide_feasibility(LCP([[0, 1], [-1, 0]], [-1, 2])).verdict
    'feasible'
    >>> proof = decide_feasibility(LCP([[-1, 0], [0, 1]], [-1, 2])).proof
    >>> print(proof)
    no z within its bounds gives w the signs it needs: 1 row (1 × row 0) contradict; proof: exact
    >>> proof.verify(), round(proof.margin, 9)
    (True, 1.0)
    """
    if effort_limit is None:
        effort_limit = DEFAULT_EFFORT // max(problem.n, 400)
    if isinstance(effort_limit, bool) or not isinstance(effort_limit, (int, np.integer)) or effort_limit < 0:
        raise InvalidOption(f"effort_limit must be a whole number of pivots, at least 0, got {effort_limit!r}")
    if problem.n == 0:
        return Feasibility("feasible", point=np.zeros(0), reason="nothing to satisfy")
    row = contradictory_row(problem)
    if row is not None and (row.margin >= DECISIVE or not effort_limit):
        return Feasibility("infeasible", row, reason="one row contradicts its bounds")
    if not effort_limit:
        return Feasibility("undecided", reason="no linear program was tried")
    known = _decided_by_program(problem, int(effort_limit), measure)
    if row is None or (known.proof is not None and known.proof.measured(measure) >= row.measured(measure)):
        return known
    return Feasibility("infeasible", row, reason="one row contradicts its bounds")


def _decided_by_program(problem: LCP, effort: int, measure: str) -> Feasibility:
    from ..problem.farkas import FarkasProgram

    constraints, unit = _linear_constraints(problem), None
    if measure == "relative":
        reference = reference_residual(problem)
        constraints = replace(constraints, reference=reference)
        unit = reference if 0.0 < reference < np.inf else None  # then the optimum is minus the largest margin
    else:  # within a factor √n, y is then best for that residual
        constraints = replace(constraints, weights=np.ones(problem.n))
    contradiction: Feasibility | None = None
    for _ in range(UNITS_TRIED):
        program = FarkasProgram(constraints, unit, effort)
        answer = program.solve()
        if answer is None:
            return contradiction or Feasibility(
                "undecided", reason=f"the linear program did not end within {effort} pivots"
            )
        if answer.is_contradiction:
            proof = program.proof(
                answer, lambda y: _proven(problem, {i: value for i, value in enumerate(y) if value}),
                lambda proof: proof.measured(measure),
            )
            if proof is not None:
                return Feasibility("infeasible", proof, reason="linear constraints contradict")
            contradiction = Feasibility(
                "undecided", reason="the linear constraints seem to contradict, which could not be proven"
            )
            if unit is None:
                return contradiction
            unit = None  # what this unit cuts off may matter
            continue
        point = np.clip(answer.point, problem.lower, problem.upper)
        unit = program.unit_of_violation(point)
        if unit is None:
            return Feasibility("feasible", point=point, reason="the linear constraints can be satisfied")
    return contradiction or Feasibility(
        "undecided", reason="the linear program is too badly scaled for double precision"
    )


def _linear_constraints(problem: LCP, rows: Any = slice(None)) -> LinearConstraints:
    """Return what z has to satisfy in these rows but for complementarity; what misses it has a residual as large."""
    kept = np.zeros(problem.n)
    return LinearConstraints(
        problem.csr[rows], problem.q[rows], problem.upper[rows] == np.inf, problem.lower[rows] == -np.inf,
        problem.lower, problem.upper, problem.residual_scale[rows], (kept, kept),
    )


def _proven(problem: LCP, y: Mapping[int, Rational]) -> Infeasibility | None:
    """Return the proof by y itself, by row."""
    proof = Infeasibility.of(problem, y) if y else None
    return proof if proof is not None and proof.verify() else None


def _may_miss(problem: LCP, rows: Any) -> bool:
    """Return whether z within the bounds miss one of the rows, to rounding; one pass."""
    from ..kernels.rows import is_missed  # numba, which `import lcp_plugin` must not load

    M = compressed_rows(problem.M)
    return bool(is_missed(*M, problem.q, problem.lower, problem.upper, rows))


def contradictory_row(problem: LCP) -> Infeasibility | None:
    """Return the proof of the row that z within the bounds miss by most, or None where no single row is enough.

    Cost: one look at each entry of the rows without a positive diagonal; in the others, their own unknown lets w grow.

    Examples
    --------
    >>> print(contradictory_row(LCP([[-1, 0], [0, 1]], [-1, 2])))
    no z within its bounds gives w the signs it needs: 1 row (1 × row 0) contradict; proof: exact
    """
    rows = np.flatnonzero((np.isinf(problem.upper) | np.isinf(problem.lower)) & ~(problem.diagonal > 0.0))
    if not rows.size or not _may_miss(problem, rows):
        return None
    for k, sign in _linear_constraints(problem, rows).contradictory_rows():
        proof = _proven(problem, {int(rows[k]): sign})
        if proof is not None:
            return proof
    return None
