"""The components of a problem and their references in rational arithmetic; shared by tests and campaigns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from scipy.sparse.csgraph import connected_components


def component_of_rows(M: Any) -> list[int]:
    """Which connected component of the graph of a CSR array each row belongs to, by scipy."""
    labels: list[int] = connected_components(abs(M) > 0, directed=True, connection="weak")[
        1
    ].tolist()
    return labels


def references_of_rows(at_zero: Sequence[Fraction], labels: Sequence[int]) -> list[Fraction]:
    """The reference of each row's component, from the residuals of z°."""
    largest: dict[int, Fraction] = {}
    for label, value in zip(labels, at_zero, strict=True):
        largest[label] = max(abs(value), largest.get(label, Fraction(0)))
    return [largest[label] for label in labels]


def relative_residual(
    residuals: Sequence[Fraction], at_zero: Sequence[Fraction], labels: Sequence[int]
) -> Any:
    """The largest ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ of all components; 0 for 0/0, ∞ for others over 0."""
    worst: Any = Fraction(0)
    for value, reference in zip(residuals, references_of_rows(at_zero, labels), strict=True):
        if value:
            worst = max(worst, abs(value) / reference if reference else math.inf)
    return worst
