"""Checks of arrays with an axis for the problems."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import real_array
from ...core.errors import InvalidProblem


def rows_of_a_batch(values: ArrayLike, name: str, n: int) -> Any:
    """Return the values as an array of shape (B, n), or (1, n) if all problems share them."""
    is_bound = name in ("lower", "upper", "dlower", "dupper")
    size = {"h": "m", "b": "p"}.get(name, "n")
    need = f"{name} must have shape (B, {size}) or ({size},), {size} = {n}{', or be a number' if is_bound else ''}"
    array = real_array(values, need)
    if array.ndim == 0 and is_bound:
        array = np.full(n, float(array))
    if array.ndim not in (1, 2) or array.shape[-1] != n:
        hint = "; give its transpose" if array.ndim == 2 and array.shape[0] == n else ""
        hint = (
            "; for one number a problem write it as a column, shape (B, 1), times np.ones(n)"
            if is_bound
            else hint
        )
        raise InvalidProblem(f"{need}, got shape {array.shape}{hint}")
    return np.array(np.atleast_2d(array), order="C")


def length_of_all(counts: dict[str, int]) -> int:
    """Return the number of problems, the common length of the batch axes; 1 without any.

    Raises
    ------
    InvalidProblem
        If the lengths differ.
    """
    if len(set(counts.values())) > 1:
        found = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise InvalidProblem(
            f"all arrays with an axis for the problems must be equally long, got {found}"
        )
    return next(iter(counts.values()), 1)
