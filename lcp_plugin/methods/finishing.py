"""Last linear solves for rows that pass the residual test, but whose violation is large next to their terms.

A linear solve or a cycle leaves errors of 10⁻¹⁶ of the largest unknown everywhere. Next to the terms of a row in the
far field, or of a row without load, such an error is large. The stopping criterion does not tolerate it. So unknowns at
rounding level are set to 0; if the point still fails, all rows as small as the failing ones are solved again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.matrix import Matrix
from ..judges.lcp import Measured, RowData, times
from ..systems.factors import factor_operations
from ..systems.free_systems import FreeSystem


def measure_finished(data: RowData, z: Any, tolerance: float, absolute: float = 0.0) -> Measured:
    """Return the measure of z, snapped; of a single point after solves of the rows that fail next to their terms.

    Parameters and result as of :meth:`.RowData.measure_at`.
    """
    measured = data.measure(z, tolerance, absolute)
    if measured.z.ndim > 1 or measured.passes or measured.residual > tolerance:
        return measured
    z, lower, upper = np.array(measured.z), data.lower, data.upper
    matrix, again, joined = Matrix(data.M), measured, np.zeros(z.shape, np.bool_)
    most, system = 500.0 * matrix.nonzeros, None  # a factorization may take 500 passes over M
    for k in range(5):  # rounds of linear solves
        fails, sizes = again.by_row.componentwise > tolerance, again.rows.terms / data.scale
        before = joined
        # Rows join whose size is at most 2⁸ times that of the rows before
        joined = joined | (sizes <= 256.0**k * data.largest(fails * sizes))
        if k and (joined == before).all():
            break
        for _ in range(2):
            w = times(data.M, z) + data.q
            is_held = ((z <= lower) & (w > 0.0)) | ((z >= upper) & (w < 0.0))
            free = joined & ~is_held
            if system is None or not np.array_equal(free, system.free):
                system = FreeSystem(matrix, free, by_factor=True)
                if factor_operations(system.principal, most) > most:
                    return measured
            step = system.solve_near(-w, 0.0 * z)
            if step is None:
                return measured
            z = np.clip(z + step, lower, upper)
        again = data.measure(z, tolerance, absolute)
        if again.passes:
            return again
        if not again.residual <= tolerance:
            break
    return measured
