"""What an .nl file of a linear complementarity problem holds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.interfaces.nl.content import NLContent, Trees


def content_of(M: Any, q: Any, **changes: Any) -> NLContent:
    """Rows M x + q complementary to x ≥ 0."""
    n, goal = len(q), changes.pop("objective", None)
    free = np.full(n, np.inf)
    own = None if goal is None else sp.csr_array([goal])
    content = NLContent.of_rows(
        np.zeros(n),
        free,
        sp.csr_array(np.asarray(M, float)),
        Trees.of_numbers(np.asarray(q, float)),
        (-free, free),
        np.arange(n),
        np.ones(n, dtype=np.int64),
        None if goal is None else Trees.of_numbers(np.zeros(1)),
        own,
    )
    return replace(content, **changes)
