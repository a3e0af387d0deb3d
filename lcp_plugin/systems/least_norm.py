"""Generalised inverses of singular blocks: what a system without one solution has for an answer."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.checks import BoolVector

SINGULAR = 2.0**-43  # of the largest singular value: what rounding of the entries makes of 0


def pseudo_inverses(blocks: Any) -> tuple[Any, BoolVector]:
    """Return the Moore–Penrose inverses of square blocks, shape (k, f, f), and which of these are singular, shape (k,).

    Examples
    --------
    >>> inverses, is_singular = pseudo_inverses(np.array([[[2.0, 2.0], [2.0, 2.0]], [[4.0, 0.0], [0.0, 1.0]]]))
    >>> inverses.round(15).tolist(), is_singular
    ([[[0.125, 0.125], [0.125, 0.125]], [[0.25, 0.0], [0.0, 1.0]]], array([ True, False]))
    """
    left, sizes, right = np.linalg.svd(blocks)
    is_kept = sizes > SINGULAR * sizes[:, :1]
    reciprocal = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=is_kept)
    right, left = np.swapaxes(right, 1, 2), np.swapaxes(left, 1, 2)
    return (right * reciprocal[:, np.newaxis]) @ left, np.any(~is_kept, axis=1)
