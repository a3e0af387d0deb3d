"""What an .nl file of a linear complementarity problem holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.interfaces.nl.content import NLContent, Trees


def content_of(M: Any, q: Any, **changes: Any) -> NLContent:
    """Rows M x + q complementary to x ≥ 0."""
    n = len(q)
    ones, none = np.ones(n, dtype=np.int64), np.zeros(0, dtype=np.int64)

    def numbers(values: Any) -> Trees:
        k = len(values)
        return Trees(np.zeros(k, np.uint8), np.asarray(values, float), np.zeros(k, np.int64), np.arange(k + 1))

    content = dict(
        lower=np.zeros(n), upper=np.full(n, np.inf), row_lower=np.full(n, -np.inf), row_upper=np.full(n, np.inf),
        partners=np.arange(n), partner_bounds=ones, linear=sp.csr_array(np.asarray(M, float)), trees=numbers(q),
        is_maximized=none.astype(bool), objective_linear=sp.csr_array((0, n)), objective_trees=numbers([]),
        defined_linear=sp.csr_array((0, n)), defined_trees=numbers([]), is_integer=np.zeros(n, dtype=bool),
        logical_rows=0, functions=(), start=np.zeros(n), dual_start=np.zeros(n), has_start=np.zeros(n, dtype=bool),
        suffixes=[],
    )  # fmt: skip
    if "objective" in changes:
        changes |= dict(objective_linear=sp.csr_array([changes.pop("objective")]), objective_trees=numbers([0.0]),
                        is_maximized=np.zeros(1, dtype=bool))  # fmt: skip
    return NLContent(**content | changes)
