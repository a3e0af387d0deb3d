"""Last linear solves for rows that pass the residual test, but whose violation is large next to their terms.

A linear solve or a cycle leaves errors of 10⁻¹⁶ of the largest unknown everywhere. Next to the terms of a row in the
far field, or of a row without load, such an error is large. The stopping criterion does not tolerate it. So unknowns at
rounding level are set to 0; if the point still fails, all rows as small as the failing ones are solved again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.certificates.criterion import POWER, RowData, times
from ..core.certificates.measured import Measured
from ..core.deadline import is_over
from ..core.kernels.floats import NEGLIGIBLE
from ..core.matrix import Matrix
from ..systems.factors import factor_operations
from ..systems.free_systems import FreeSystem

ROUNDS = 5  # of linear solves
GROWTH = 2.0**8  # of the size of the rows that are solved, from round to round
MOST_PASSES = 500.0  # over M, which a factorization may take


def measure_finished(
    data: RowData, z: Any, tolerance: float, power: float = POWER, absolute: float = 0.0
) -> Measured:
    """Return the measure of z, snapped, with its small rows finished; for a stack of each point.

    Parameters and result as of :meth:`.RowData.measure_at`.
    """
    found = data.measure(z, tolerance, power, absolute)
    if np.all(found.passes | (found.residual > tolerance) | found.is_rejected):
        return found
    if found.z.ndim == 1:
        return _finished(data, found, tolerance, power, absolute)
    z, residual, passes = np.array(found.z), np.array(found.residual), np.array(found.passes)
    for k in np.flatnonzero(~passes & (residual <= tolerance)):
        if is_over():
            break
        one = measure_finished(_item(data, z.shape, int(k)), z[k], tolerance, power, absolute)
        z[k], residual[k], passes[k] = one[:3]
    return found._replace(z=z, residual=residual, passes=passes)


def _item(data: RowData, shape: tuple[int, ...], k: int) -> RowData:
    """Return the data of problem k of a stack."""
    M, absolute = (one[k % len(one)] if one.ndim > 2 else one for one in (data.M, data.absolute))
    vectors = (data.q, data.lower, data.upper, data.scale, data.start)
    q, lower, upper, scale, start = (np.broadcast_to(one, shape)[k] for one in vectors)
    labels = None if data.labels is None else np.broadcast_to(data.labels, shape)[k]
    return RowData(M, absolute, q, lower, upper, scale, labels, start)


def _finished(
    data: RowData, found: Measured, tolerance: float, power: float, absolute: float
) -> Measured:
    """Return the measure after solves of the rows that fail next to their terms, or `found` if that fails too."""
    z, lower, upper = np.array(found.z), data.lower, data.upper
    is_noise = np.abs(z) <= NEGLIGIBLE * data.largest(np.abs(z))
    flushed = np.where(is_noise & (lower <= 0.0) & (upper >= 0.0), 0.0, z)
    again = data.measure_at(flushed, None, tolerance, power, absolute)
    if again.passes:
        return again
    matrix, again, joined = Matrix(data.M), found, np.zeros(z.shape, np.bool_)
    most, system = MOST_PASSES * matrix.nonzeros, None
    for k in range(ROUNDS):
        fails, sizes = again.by_row.terms > tolerance, again.rows.terms / data.scale
        before = joined
        joined = joined | (sizes <= GROWTH**k * data.largest(fails * sizes))
        if k and (joined == before).all():
            break
        for _ in range(2):
            w = times(data.M, z) + data.q
            is_held = ((z <= lower) & (w > 0.0)) | ((z >= upper) & (w < 0.0))
            free = joined & ~is_held
            if system is None or not np.array_equal(free, system.free):
                system = FreeSystem(matrix, free, by_factor=True)
                if factor_operations(system.principal, most) > most:
                    return found
            step = system.solve_near(-w, 0.0 * z)
            if step is None:
                return found
            z = np.clip(z + step, lower, upper)
        again = data.measure_at(z, None, tolerance, power, absolute)
        if again.passes:
            return again
        if not again.residual <= tolerance:
            break
    return found
