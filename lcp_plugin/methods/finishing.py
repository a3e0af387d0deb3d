"""Last linear solves for rows that pass the residual test, but whose violation is large next to their terms.

A linear solve or a cycle leaves errors of 10⁻¹⁶ of the largest unknown everywhere. Next to the terms of a row in the
far field, or of a row without load, such an error is large. The stopping criterion does not tolerate it. So unknowns at
rounding level are set to 0; if the point still fails, all rows as small as the failing ones are solved again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.deadline import is_over
from ..core.kernels.floats import NEGLIGIBLE
from ..core.matrix import Matrix
from ..judges.lcp import Measured, RowData, times
from ..systems.factors import factor_operations
from ..systems.free_systems import FreeSystem


def measure_finished(data: RowData, z: Any, tolerance: float, absolute: float = 0.0) -> Measured:
    """Return the measure of z, snapped, with its small rows finished; for a stack of each point.

    Parameters and result as of :meth:`.RowData.measure_at`.
    """
    found = data.measure(z, tolerance, absolute)
    if np.all(found.passes | (found.residual > tolerance)):
        return found
    if found.z.ndim == 1:
        return _finished(data, found, tolerance, absolute)
    z, residual, passes = np.array(found.z), np.array(found.residual), np.array(found.passes)
    fails = ~passes & (residual <= tolerance)
    # Entries of the matrices that are solved in one call
    if data.M.ndim == 3 and fails.sum() * data.M[0].size <= 10**7:
        tried = np.where(fails[:, np.newaxis], _solved_again(data, z, fails), z)
        again = data.measure_at(tried, None, tolerance, absolute)
        is_better = fails & again.passes
        z[is_better], residual[is_better] = tried[is_better], again.residual[is_better]
        passes |= is_better
    for k in np.flatnonzero(~passes & (residual <= tolerance)):
        if is_over():
            break
        one = measure_finished(_item(data, z.shape, int(k)), z[k], tolerance, absolute)
        z[k], residual[k], passes[k] = one[:3]
    # Rows and residuals belong to the points before
    return found._replace(z=z, residual=residual, passes=passes, rows=None, by_row=None)


def _solved_again(data: RowData, z: Any, rows: Any) -> Any:
    """Return z with these problems of a dense stack solved again on their active sets; z itself if one is singular."""
    M = data.M if len(data.M) == 1 else data.M[rows]
    q, lower, upper = (
        np.broadcast_to(one, z.shape)[rows] for one in (data.q, data.lower, data.upper)
    )
    found, x = z.copy(), z[rows]
    for _ in range(2):
        w = times(M, x) + q
        is_held = ((x <= lower) & (w > 0.0)) | ((x >= upper) & (w < 0.0))
        free = ~is_held
        block = np.where(free[..., np.newaxis] & free[:, np.newaxis], M, 0.0)
        block[:, range(x.shape[1]), range(x.shape[1])] += is_held
        try:
            step = np.linalg.solve(block, np.where(free, -w, 0.0)[..., np.newaxis])[..., 0]
        except np.linalg.LinAlgError:
            return z
        x = np.clip(x + step, lower, upper)
    found[rows] = x
    return found


def _item(data: RowData, shape: tuple[int, ...], k: int) -> RowData:
    """Return the data of problem k of a stack."""
    M, absolute = (one[k % len(one)] if one.ndim > 2 else one for one in (data.M, data.absolute))
    vectors = (data.q, data.lower, data.upper, data.scale, data.start)
    q, lower, upper, scale, start = (np.broadcast_to(one, shape)[k] for one in vectors)
    labels = None if data.labels is None else np.broadcast_to(data.labels, shape)[k]
    return RowData(M, absolute, q, lower, upper, scale, labels, start)


def _finished(data: RowData, found: Measured, tolerance: float, absolute: float) -> Measured:
    """Return the measure after solves of the rows that fail next to their terms, or `found` if that fails too."""
    z, lower, upper = np.array(found.z), data.lower, data.upper
    is_noise = np.abs(z) <= NEGLIGIBLE * data.largest(np.abs(z))
    flushed = np.where(is_noise & (lower <= 0.0) & (upper >= 0.0), 0.0, z)
    again = data.measure_at(flushed, None, tolerance, absolute)
    if again.passes:
        return again
    matrix, again, joined = Matrix(data.M), found, np.zeros(z.shape, np.bool_)
    most, system = 500.0 * matrix.nonzeros, None  # a factorization may take 500 passes over M
    for k in range(5):  # rounds of linear solves
        fails, sizes = again.by_row.terms > tolerance, again.rows.terms / data.scale
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
                    return found
            step = system.solve_near(-w, 0.0 * z)
            if step is None:
                return found
            z = np.clip(z + step, lower, upper)
        again = data.measure_at(z, None, tolerance, absolute)
        if again.passes:
            return again
        if not again.residual <= tolerance:
            break
    return found
