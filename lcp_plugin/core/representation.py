"""Short texts for messages: problems, counts, radii of proofs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def format_count(count: int, what: str) -> str:
    """Return a count with its noun, in the singular or the plural.

    Examples
    --------
    >>> format_count(1, "iteration"), format_count(12, "iteration")
    ('1 iteration', '12 iterations')
    """
    return f"{count} {what}" + "s" * (count != 1)


def describe_lcp(problem: Any) -> str:
    """Return the text of ``repr`` for an LCP: its size and its kinds of bounds."""
    return f"LCP(n={problem.n}, nonzeros={problem.nonzeros}, bounds {_bounds_in_words(problem)})"


def _bounds_in_words(problem: Any) -> str:
    if problem.is_plain:
        return "0 ≤ z"
    is_below, is_above = np.isfinite(problem.lower), np.isfinite(problem.upper)
    boxed, free = int((is_below & is_above).sum()), int((~is_below & ~is_above).sum())
    parts = [(problem.n - free - boxed, "one-sided"), (boxed, "boxed"), (free, "free")]
    return ", ".join(f"{count} {kind}" for count, kind in parts if count)


def three_digits_below(value: float) -> str:
    """Return three digits of a lower bound that are at most the bound.

    Examples
    --------
    >>> three_digits_below(0.25), three_digits_below(1 / 1.5)
    ('0.25', '0.663')
    """
    text = f"{value:.3g}"
    return text if float(text) <= value else f"{value * (1.0 - 0.005):.3g}"


def describe_radius(radius: float, what: str) -> str:
    """Return the points up to a radius, rounded down, to which a proof is restricted; an empty text if it is ∞.

    Examples
    --------
    >>> describe_radius(2.5e12, "x"), describe_radius(math.inf, "x")
    ('all x up to 2e+12', '')
    """
    digits, exponent = f"{radius:.15e}".split("e") if radius < math.inf else ("", "")
    return f"all {what} up to {digits[0]}e{exponent}" if digits else ""
