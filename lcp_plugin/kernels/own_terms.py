"""The rows of a small problem in their own terms, as :mod:`lcp_plugin.certificates.own_terms` has them."""

from __future__ import annotations

import numpy as np

from .compilation import compiled_into_others, compiled_part
from .floats import DIAGONAL_SPREAD, LARGEST_RATIO
from .workspace import LOWER, UPPER, Q, W, Z


@compiled_into_others
def is_right_in_terms(M, k, real, tolerance):  # type: ignore[no-untyped-def]
    """Return whether each row is right beside its own terms, or the entries of M are even: nothing is asked then."""
    root, share = np.sqrt(tolerance), np.sqrt(tolerance) * np.sqrt(np.sqrt(tolerance))
    for i in range(M.shape[1]):
        z, w = real[Z, i], real[W, i]
        distance = z - real[LOWER, i] if w > 0.0 else real[UPPER, i] - z
        size, terms = abs(w), abs(real[Q, i])
        if not (distance > 0.0 and size > share * terms and size > share * abs(M[k, i, i] * z)):
            continue
        for j in range(M.shape[1]):
            terms += abs(M[k, i, j] * real[Z, j])
        if size > share * terms and distance > root * abs(z):
            return _has_even_entries(M, k)
    return True


@compiled_part
def _has_even_entries(M, k):  # type: ignore[no-untyped-def]
    """Return whether no entry is far larger than the diagonal, nor a diagonal entry than another."""
    least, most, largest = np.inf, 0.0, 0.0
    for i in range(M.shape[1]):
        least, most = min(least, abs(M[k, i, i])), max(most, abs(M[k, i, i]))
        for j in range(M.shape[1]):
            largest = max(largest, abs(M[k, i, j]))
    return least > 0.0 and most <= least * 2.0**DIAGONAL_SPREAD and largest <= least * 2.0**LARGEST_RATIO
