"""Rows of interior points: signs and scales of a matrix that is to be factorised, residuals within a box."""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels.compilation import helper, kernel
from ....core.kernels.rows import residual_of_row

BADLY_SCALED = 10.0  # times as large as the largest entry of another row
NEGLIGIBLE = -10.0  # log₂ of an entry that beside others of about 1 has no say
MOST_BITS = 500.0


@kernel
def equilibrate(indptr, indices, data, signs, sweeps, passes, c):  # type: ignore[no-untyped-def]
    """Fill c with factors such that c_i m_ij c_j is about 1 (Curtis, Reid), at most 1 in each row and column (Ruiz).

    Sweeps bring the mean logarithm of each row's entries to 0, which undoes units of rows and columns whatever they
    were: those beside its own kind of unknown, by `signs`, and those beside the other have one half each. In the second
    half of the sweeps entries that are small beside the others count no longer. Then passes of Ruiz. Without sweeps,
    and where no row is far larger than another, Ruiz alone.
    """
    size, exponent = np.zeros(c.size), np.empty(data.size)
    for i in range(c.size):
        c[i] = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            size[i] = max(size[i], abs(data[k]))
            mantissa, power = math.frexp(abs(data[k]))
            exponent[k] = power + 2.0 * mantissa - 2.0 if mantissa > 0.0 else -np.inf  # log₂ to .09, exactly rounded
    least, most = _extremes(size)
    for sweep in range(sweeps if most > BADLY_SCALED * least else 0):
        negligible = -np.inf if 2 * sweep < sweeps else NEGLIGIBLE
        for i in range(c.size):
            own, others, of_own, of_others, twice = 0.0, 0.0, 0, 0, 0
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                now = exponent[k] + c[i] + c[j]
                if not now > negligible:
                    continue
                if signs[i] == signs[j]:
                    own, of_own, twice = own + now, of_own + 1, twice + (j == i)
                else:
                    others, of_others = others + now, of_others + 1
            if of_own + of_others > 0:
                mean = own / max(of_own, 1) + others / max(of_others, 1)
                c[i] -= mean / ((of_own > 0) + (of_others > 0) + twice / max(of_own, 1))
    for i in range(c.size):
        c[i] = math.ldexp(1.0, int(np.rint(min(max(c[i], -MOST_BITS), MOST_BITS))))
    for _ in range(passes):
        for i in range(c.size):
            size[i] = 0.0
        for i in range(c.size):
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                value = abs(data[k]) * c[i] * c[j]
                size[i], size[j] = max(size[i], value), max(size[j], value)
        for i in range(c.size):
            if size[i] > 0.0:
                c[i] /= np.sqrt(size[i])
        least, most = _extremes(size)
        if most <= 2.0 and least >= 0.5:
            break


@helper
def _extremes(size):  # type: ignore[no-untyped-def]
    """Return the smallest and the largest of the positive sizes."""
    least, most = np.inf, 0.0
    for i in range(size.size):
        if size[i] > 0.0:
            least, most = min(least, size[i]), max(most, size[i])
    return least, most


@kernel
def oppose(indptr, indices, data, same, signs):  # type: ignore[no-untyped-def]
    """Fill signs with −1 where a row before is the opposite of a column, else 1; rows sorted.

    Return 1 where diag(signs) M is symmetric then, 0 where other signs may do, −1 where none can: an entry is neither
    its mirror image nor the opposite, to the relative tolerance `same`.
    """
    for i in range(signs.size):
        signs[i] = 1.0
    fits, place = 1, np.empty(signs.size, np.int64)
    for is_checked in (False, True):
        for i in range(signs.size):
            place[i] = indptr[i]
        for i in range(signs.size):
            k, end = place[i], indptr[i + 1]
            if k < end and indices[k] < i:
                return -1
            for m in range(k, end):
                j = indices[m]
                if j == i:
                    continue
                p = place[j]
                if p >= indptr[j + 1] or indices[p] != i:
                    return -1
                place[j] = p + 1
                if data[m] == 0.0 and data[p] == 0.0:
                    continue
                size = same * abs(data[p])
                is_same = abs(data[m] - data[p]) <= size
                if is_checked:
                    fits = fits if is_same == (signs[i] == signs[j]) else 0
                elif not is_same:
                    if not abs(data[m] + data[p]) <= size:
                        return -1
                    signs[j] = -1.0
    return fits


@kernel
def box_residual(z, w, lower, upper, scale):  # type: ignore[no-untyped-def]
    """Return max |z − mid(lower, upper, z − w/scale)|, and the largest product of |w| and the finite distance it holds.

    ∞ where a w is not finite.
    """
    largest = product = 0.0
    for i in range(z.size):
        residual = residual_of_row(w[i] / scale[i], z[i], lower[i], upper[i])
        if not abs(residual) <= largest:
            largest = abs(residual) if np.isfinite(residual) else np.inf
        if np.isinf(w[i]):
            largest = np.inf
        distance = z[i] - lower[i] if w[i] > 0.0 else upper[i] - z[i]
        if distance < np.inf:
            product = max(product, abs(w[i]) * distance)
    return largest, product
