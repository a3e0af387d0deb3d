"""The paper's Theorem 4.1, certified for any splitting of a small matrix."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..checks import FloatVector
from ..exact.rounding import TINY

POWER_STEPS = 60
Matrix = np.ndarray[Any, np.dtype[np.float64]]


def theorem_4_1(M: Matrix, splitting: Matrix) -> tuple[float, FloatVector] | None:
    """Return (c, v) with T v ≤ c v, c < 1, v > 0 for the T of Method 3.1, or None where no such v was found.

    Parameters
    ----------
    M, splitting : arrays, shape (n, n)
        SM and S𝓜, dense, each entry right to two units in the last place.

    Notes
    -----
    T = |(𝓜 + 2I + D)⁻¹| (|𝓝 + I + D| + |M − I|), 𝓝 = 𝓜 − M. The error of one step is multiplied by a matrix that T
    bounds in every entry: (𝓜 + 2I + D)⁻¹ ((𝓝 + I + D) + (2τ − 1)(I − M)), τ_i in [0, 1]. So with boxes, free rows
    and the projection after the step ‖z⁺ − z*‖_v ≤ c ‖z − z*‖_v. The inverse X is LAPACK's; with PX = I − E,
    |P⁻¹| b ≤ |X| (I − |E|)⁻¹ b, all rounding counted.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, Theorem 4.1.

    Examples
    --------
    >>> rate, v = theorem_4_1(np.array([[1.0, -0.5], [-0.5, 1.0]]), np.eye(2))
    >>> round(rate, 6), v.size
    (0.75, 2)
    """
    n = M.shape[0]
    if not (np.isfinite(M).all() and np.isfinite(splitting).all()):
        return None
    identity, D = np.eye(n), np.diag(np.diag(M))
    unit = (n + 16) * 2.0**-52
    with np.errstate(all="ignore"):
        P = splitting + 2.0 * identity + D
        try:
            X = np.linalg.inv(P)
        except np.linalg.LinAlgError:
            return None
        sizes = np.abs(splitting) + np.abs(M) + identity + np.abs(D)
        right = np.abs(splitting - M + identity + D) + np.abs(M - identity) + 16.0 * 2.0**-52 * sizes + 8.0 * TINY
        uncertain = np.abs(P) + np.abs(splitting) + np.abs(D)
        error = np.abs(identity - P @ X) + unit * ((uncertain + TINY) @ np.abs(X) + identity) + n * TINY
        spread = float(error.sum(axis=1).max(initial=0.0))
        if not spread < 0.5:
            return None
        v = np.ones(n)
        for _ in range(POWER_STEPS):
            grown = np.abs(X) @ (right @ v)
            v = 0.5 * (v + grown / grown.max(initial=1e-300)) if np.isfinite(grown).all() else v
        bounded = _inverse_bound(np.abs(X), error, spread, (right @ v) * (1.0 + unit)) * (1.0 + 4.0 * unit)
        rate = float(np.max(bounded / v, initial=0.0))
    return (float(np.nextafter(rate, 2.0)), v) if rate < 1.0 - 2.0**-52 else None


def _inverse_bound(size_of_inverse: Matrix, error: Matrix, spread: float, b: FloatVector) -> FloatVector:
    """Return |X|(b + |E|b + …), the tail of the series bounded by its norm."""
    tail = spread * spread / (1.0 - spread) * b.max(initial=0.0)
    bound: FloatVector = size_of_inverse @ (b + error @ b + tail)
    return bound
