"""Changes of the free rows: regular, least change if singular, one-sided at a kink."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ...auto import solve_lcp
from ...core.checks import FloatVector
from ...core.errors import UnsuitableProblem
from ...core.lcp import LCP
from ...proofs.bounds.active_rows import ActiveRows, settled_rows
from ...systems.free_systems import CONSISTENT, FreeSystem

SINGULAR = (
    "the block of M on the free rows is singular to working precision, too large for a generalised inverse or for a "
    "factor where multigrid fails: z has no derivative that could be computed; regularise M, or fix what is not "
    "determined"
)


def words_on_singular(system: FreeSystem) -> str:
    """Return a warning about a derivative if M is singular on the free rows."""
    inverse = system.pseudo_inverse
    if inverse is None:
        return SINGULAR
    same, rank = system.determined_slack, round(float(np.trace(inverse @ system.block)))
    is_same = same is not None and bool(same.all())
    return (
        f"M has rank {rank} on the {system.rows.size} free rows: z is one of several "
        f"solutions, w {'the same' if is_same else 'not the same'} for all of them, and this the derivative of the "
        "least change"
    )


def solution(system: FreeSystem, right: FloatVector, *, transposed: bool = False) -> FloatVector:
    """Return the solution, with least norm if the block is singular."""
    x = system.solve(right, transposed=transposed)
    if x is not None:
        return x
    inverse = system.pseudo_inverse
    if inverse is None:
        raise UnsuitableProblem(SINGULAR)
    x, right = np.zeros(right.size), right[system.rows]
    part = (inverse.T if transposed else inverse) @ right
    left = np.abs(right - system.block @ part)
    if (
        not transposed
        and (left > CONSISTENT * (abs(system.block) @ np.abs(part) + np.abs(right))).any()
    ):
        raise UnsuitableProblem(
            f"M is singular on the {part.size} free rows, and after this change no z solves them: there is no "
            "derivative in this direction; regularise M, or change q within what M z can give"
        )
    x[system.rows] = part
    return x


def one_sided(problem: LCP, rows: ActiveRows, h: FloatVector, moved: FloatVector) -> FloatVector:
    """Return the one-sided derivative: the solution of an LCP on the free and the degenerate rows.

    Rows fixed at a bound have d = db, which is `moved`, and free rows have (M d + h)_i = 0. Degenerate rows at a lower
    bound have d ≥ db and (M d + h) ≥ 0, complementary, and the mirror image at an upper bound.
    """
    lower = np.where(rows.free | (rows.degenerate & rows.is_upper), -np.inf, moved)
    upper = np.where(rows.free | (rows.degenerate & ~rows.is_upper), np.inf, moved)
    part = np.flatnonzero(rows.free | rows.degenerate)
    dz = np.where(rows.at_lower | rows.at_upper, moved, 0.0)
    M = problem.M
    block = M[part][:, part] if sp.issparse(M) else M[np.ix_(part, part)]
    small = LCP(block, (h + M @ dz)[part], lower=lower[part], upper=upper[part])
    result = solve_lcp(small)
    if not result.is_solved:
        raise UnsuitableProblem(
            f"{part.size} free and degenerate rows have no one-sided derivative that could be found: their LCP ended "
            f"{result.status.name}; the block of M on them is no P-matrix, and z may jump or have branches"
        )
    dz[part] = settled_rows(small, result.z, result.w).z
    return dz
