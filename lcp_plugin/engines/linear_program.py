"""Linear programs by HiGHS, as `scipy.optimize.linprog` brings it, without slack columns.

HiGHS 1.8 to 1.12 (scipy 1.15 to 1.17) write beyond their memory if banded equations have slack columns next to full
rows, and the process dies. Without its slack such an equation is an inequality.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Array, Vector

FEASIBLE = 1e-7  # of the terms of a row: the largest violation by a solution of a linear program


def highs(
    cost: Vector,
    rows: Array,
    limits: Vector,
    equations: AnyMatrix,
    right: Vector,
    bounds: tuple[Vector, Vector],
    **options: Any,
) -> Any:
    """Return the result of min costᵀv, rows · v ≤ limits, equations · v = right, lower ≤ v ≤ upper.

    A slack is a column of one equation that costs nothing and has no bound but 0 ≤ v.
    """
    from scipy.optimize import linprog

    (lower, upper), both = bounds, np.stack(bounds, axis=1)
    settings: Any = {"method": "highs", "options": options}
    is_free = (cost == 0.0) & (lower == 0.0) & (upper == np.inf)
    is_alone = ((equations != 0).sum(axis=0) == 1) & ((rows != 0).sum(axis=0) == 0)
    slack = np.flatnonzero(is_free & is_alone)
    if slack.size in (0, cost.size):
        return linprog(cost, rows, limits, equations, right, both, **settings)
    by_column = sp.csc_array(equations)[:, slack]
    by_column.eliminate_zeros()
    relaxed, first = np.unique(by_column.indices, return_index=True)
    slack, sizes = slack[first], by_column.data[first]
    signs = np.sign(sizes)
    is_column, is_equation = np.ones(cost.size, dtype=bool), np.ones(right.size, dtype=bool)
    is_column[slack] = is_equation[relaxed] = False
    by_row = sp.csr_array(equations)[:, is_column]
    result = linprog(
        cost[is_column],
        sp.vstack([sp.csr_array(rows)[:, is_column], by_row[relaxed] * signs[:, np.newaxis]]),
        np.append(limits, signs * right[relaxed]),
        by_row[is_equation],
        right[is_equation],
        both[is_column],
        **settings,
    )
    if result.x is not None:
        v, multipliers = np.zeros(cost.size), np.zeros(right.size)
        v[is_column] = result.x
        v[slack] = np.maximum(0.0, (right[relaxed] - by_row[relaxed] @ result.x) / sizes)
        multipliers[is_equation] = result.eqlin.marginals
        multipliers[relaxed] = signs * result.ineqlin.marginals[len(limits) :]
        result.x, result.eqlin.marginals = v, multipliers
        result.ineqlin.marginals = result.ineqlin.marginals[: len(limits)]
    return result
