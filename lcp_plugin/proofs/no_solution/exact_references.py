"""What residuals are compared with, in fractions: they reach beyond the range of doubles."""

from __future__ import annotations

from fractions import Fraction
from weakref import WeakKeyDictionary

import numpy as np

from ...core.certificates.criterion import RowUnits, references_of_parts
from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.matrix.structure import parts
from ..exact.exactly import exact_residuals

_exact: WeakKeyDictionary[LCP, list[Fraction]] = WeakKeyDictionary()
SAFE_RANGE = (1e-290, 1e290)


def exact_reference(problem: LCP, row: int) -> Fraction:
    """Return an upper bound of what r_i of an own row is compared with; fractions reach beyond the range of doubles.

    That is ‖r̂_P(z°)‖∞, P its part, in the caller's unit of z_i.
    """
    units = RowUnits.of(problem)
    reference = _exact_reference(problem, row)
    return reference if units is None else reference * Fraction(2) ** int(units.column[row])


def exactly_weighted(problem: LCP, z: FloatVector) -> list[Fraction]:
    """Return |r̂_i(z)| of every row without any rounding, for a finite z."""
    units = RowUnits.of(problem)
    if units is None:
        return exact_residuals(problem, z)
    residuals = exact_residuals(problem, z, units.scale)
    return [r / Fraction(2) ** k for r, k in zip(residuals, units.column.tolist(), strict=True)]


def _exact_reference(problem: LCP, row: int) -> Fraction:
    several = parts(problem.matrix)
    part = 0 if several is None else int(several.labels[row])
    most = float(references_of_parts(problem)[1][part])
    if most == 0.0 or SAFE_RANGE[0] < most < SAFE_RANGE[1]:
        return Fraction(most)
    if problem not in _exact:
        _exact[problem] = exactly_weighted(problem, problem.nearest_to_zero)
    rows = range(problem.own) if several is None else np.flatnonzero(several.labels == part).tolist()
    return max(_exact[problem][i] for i in rows)
