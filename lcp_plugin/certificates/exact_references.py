"""What residuals are compared with, in fractions: they reach beyond the range of doubles."""

from __future__ import annotations

from fractions import Fraction
from weakref import WeakKeyDictionary

import numpy as np

from ..matrix.structure import parts
from ..problem.exactly import exact_residuals
from ..problem.lcp import LCP
from .references import references_of_parts

_exact: WeakKeyDictionary[LCP, list[Fraction]] = WeakKeyDictionary()
SAFE_RANGE = (1e-290, 1e290)


def exact_reference(problem: LCP, row: int) -> Fraction:
    """Return an upper bound of ‖r_P(z°)‖∞, P the part of an own row; fractions reach beyond the range of doubles."""
    several = parts(problem.matrix)
    part = 0 if several is None else int(several.labels[row])
    most = float(references_of_parts(problem)[1][part])
    if most == 0.0 or SAFE_RANGE[0] < most < SAFE_RANGE[1]:
        return Fraction(most)
    if problem not in _exact:
        _exact[problem] = exact_residuals(problem, problem.nearest_to_zero)
    rows = range(problem.own) if several is None else np.flatnonzero(several.labels == part).tolist()
    return max(_exact[problem][i] for i in rows)
