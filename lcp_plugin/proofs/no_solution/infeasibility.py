"""Search for a proof that a problem has no solution, by linear constraints or trees of cases.

The linear constraints require a z within the bounds with a w of permitted signs. A check of each row comes first, then
a linear program. A tree contains every case of the complementarity conditions, each closed by its Farkas vector.

The check of each row finds rows whose signs no point of a box has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import reference_residual, row_data
from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...systems.free_systems import FreeSystem
from ..exact.rational import Rational
from .linear_constraints import DECISIVE, LinearConstraints
from .proof import Choices, Infeasibility, Margins, NoSolutionProof, row_choices

DEFAULT_EFFORT = 20_000_000  # pivots times n: a minute or so of the linear program


def find_infeasibility(problem: LCP, *, effort_limit: int | None = None) -> Infeasibility | None:
    """Return the proof that the linear constraints cannot be satisfied; None if they can be, or none was found.

    A problem with infeasible linear constraints has no solution. A monotone problem (M positive semidefinite) that can
    satisfy them has one. The search prefers a proof with nearly the largest margin.

    Parameters
    ----------
    effort_limit : int, optional
        Pivots of the linear program, at least 0; by default 50 000 up to n = 400 and 2·10⁷/n above.

    Examples
    --------
    >>> find_infeasibility(LCP([[0, 1], [-1, 0]], [-1, 2])) is None
    True
    >>> proof = find_infeasibility(LCP([[-1, 0], [0, 1]], [-1, 2]))
    >>> print(proof)
    no z within its bounds gives w the signs it needs: row 0 contradicts its bounds; proof: exact
    >>> proof.verify(), round(proof.margin, 9)
    (True, 1.0)
    """
    if problem.n == 0:
        return None
    effort = DEFAULT_EFFORT // max(problem.n, 400) if effort_limit is None else effort_limit
    row = contradictory_row(problem)
    if row is not None and row.margin >= DECISIVE:
        return row
    proof = _by_linear_program(problem, effort) if effort else None
    return row if proof is None or (row is not None and proof.margin < row.margin) else proof


def is_proved_infeasible(problem: LCP, z: FloatVector) -> bool:
    """Return whether :func:`find_infeasibility` has a proof; it is not called if a point near z is feasible."""
    return not _is_feasible_near(problem, z) and find_infeasibility(problem) is not None


@np.errstate(all="ignore")
def _is_feasible_near(problem: LCP, z: FloatVector) -> bool:
    """Return whether w has its signs for certain where the active rows are raised by 4 times their rounding error."""
    data, needs_rise, needs_fall = (
        row_data(problem),
        problem.upper == np.inf,
        problem.lower == -np.inf,
    )
    sign, at = needs_rise * 1.0 - needs_fall, data.rows(z)
    if (needs_rise & needs_fall).any():
        return False  # an equation
    step = FreeSystem(problem.matrix, at.is_active).solve(4.0 * sign * at.rounding - at.w)
    if step is None:
        return False
    after = data.rows(np.clip(z + step, problem.lower, problem.upper))
    return bool(((sign == 0.0) | (sign * after.w >= after.rounding)).all())


def _by_linear_program(problem: LCP, effort: int) -> Infeasibility | None:
    """Return a proof by the multipliers of a linear program, in a scaling in which it detects the inconsistency."""
    from .farkas import FarkasProgram, best_proof

    reference = reference_residual(problem)
    constraints = replace(_linear_constraints(problem), reference=reference)
    is_usual = 0.0 < reference < np.inf  # then the optimum is minus the largest margin
    units = [reference] * is_usual + FarkasProgram(constraints).sizes

    def proven(y: Any) -> Infeasibility | None:
        return _proven(problem, {i: value for i, value in enumerate(y) if value})

    found: Infeasibility | None = best_proof(lambda _: constraints, units, proven, pivots=effort)
    return found


def _linear_constraints(problem: LCP, rows: Any = slice(None)) -> LinearConstraints:
    """Return the linear constraints of these rows, without complementarity; a violation implies a residual as large."""
    kept = np.zeros(problem.n)
    return LinearConstraints(
        sp.csr_array(problem.M[rows]),
        problem.q[rows],
        problem.upper[rows] == np.inf,
        problem.lower[rows] == -np.inf,
        problem.lower,
        problem.upper,
        problem.residual_scale[rows],
        (kept, kept),
    )


def _proven(problem: LCP, y: Mapping[int, Rational]) -> Infeasibility | None:
    """Return the proof by y itself, by row."""
    proof = Infeasibility.of(problem, y) if y else None
    return proof if proof is not None and proof.verify() else None


def contradictory_row(problem: LCP) -> Infeasibility | None:
    """Return the proof of the row that z within the bounds miss by most, or None if no single row is enough.

    Cost: one pass over the rows without a positive diagonal entry; in all other rows z_i can increase w_i.

    Examples
    --------
    >>> print(contradictory_row(LCP([[-1, 0], [0, 1]], [-1, 2])))
    no z within its bounds gives w the signs it needs: row 0 contradicts its bounds; proof: exact
    """
    rows = np.flatnonzero(
        (np.isinf(problem.upper) | np.isinf(problem.lower)) & ~(problem.diagonal > 0.0)
    )
    if not rows.size:
        return None
    for k, sign in _linear_constraints(problem, rows).contradictory_rows():
        proof = _proven(problem, {int(rows[k]): sign})
        if proof is not None:
            return proof
    return None


@dataclass(slots=True)
class Case:
    """Case of the tree: split by the choices of a row, or closed by a Farkas vector y."""

    row: int = -1
    branches: dict[str, Case] = field(default_factory=dict)
    y: Sequence[Rational] | None = None


@dataclass(frozen=True, eq=False)
class NoSolution(NoSolutionProof):
    """Proof that no z solves the problem: every leaf of a complete tree is exactly infeasible.

    Attributes
    ----------
    tree : Case
        Each split has a row and covers all choices of this row; each leaf has a Farkas vector of its constraints.
    nodes : int
        Number of nodes that the search visited.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.3
    (complementary cones: one per choice of every row).
    """

    problem: LCP = field(repr=False)
    tree: Case = field(repr=False)
    nodes: int = 0

    @property
    def leaves(self) -> int:
        """Number of closed cases."""
        return sum(case.row < 0 for case, _ in self._cases())

    @property
    def infeasibility(self) -> Infeasibility | None:
        """The Farkas certificate of the entire problem, if its linear constraints are inconsistent without a split."""
        if self.tree.y is None or not any(self.tree.y):
            return None
        return Infeasibility.of(self.problem, dict(enumerate(self.tree.y)))

    def closings(self) -> Iterator[Margins | None]:
        """Yield the margins of each leaf, in exact arithmetic; None for an open leaf, or a split with gaps."""
        for case, path in self._cases():
            if case.row >= 0:
                ends = float(self.problem.lower[case.row]), float(self.problem.upper[case.row])
                if case.row in path or set(case.branches) != set(row_choices(*ends)):
                    yield None
            elif case.y is None or case.branches:
                yield None
            else:
                yield Choices(self.problem, path).closed_by(dict(enumerate(case.y)))

    def __str__(self) -> str:
        leaves = self.leaves
        cases = "the only case" if leaves == 1 else f"each of the {leaves} cases"
        return f"no solution: {cases} of an exhaustive search contradicts, exactly"

    def __repr__(self) -> str:
        return f"NoSolution({self})"

    def _cases(self) -> Iterator[tuple[Case, dict[int, str]]]:
        stack: list[tuple[Case, dict[int, str]]] = [(self.tree, {})]
        while stack:
            case, path = stack.pop()
            yield case, path
            stack.extend(
                (branch, path | {case.row: choice}) for choice, branch in case.branches.items()
            )
