"""Reprs that can be pasted: of small problems the call that makes them again, bit for bit; counts in words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from .checks import FloatVector

REPR_UP_TO = 8  # unknowns: up to here a repr holds all data


def in_words(count: int, what: str) -> str:
    """Return how many there are.

    Examples
    --------
    >>> in_words(1, "iteration"), in_words(12, "iteration")
    ('1 iteration', '12 iterations')
    """
    return f"{count} {what}" + "s" * (count != 1)


def lcp_repr(problem: Any) -> str:
    """Return the call that makes a small LCP again; of an empty or a large one, what `str` says."""
    if problem.is_distributed or not 0 < problem.n <= REPR_UP_TO:
        return str(problem)
    bounds = bounds_repr(problem.lower, problem.upper, least=0.0)
    return f"LCP({', '.join([matrix_repr(problem.M), repr(problem.q.tolist()), *bounds])})"


def described_lcp(problem: Any) -> str:
    """Return how large an LCP is, and which bounds it has, or on how many ranks it lies."""
    last = (
        f"ranks={problem.matrix.processes}"
        if problem.is_distributed
        else f"bounds {_bounds_in_words(problem)}"
    )
    return f"LCP(n={problem.n}, nonzeros={problem.nonzeros}, {last})"


def _bounds_in_words(problem: Any) -> str:
    if problem.is_plain:
        return "0 ≤ z"
    is_below, is_above = np.isfinite(problem.lower), np.isfinite(problem.upper)
    boxed, free = int((is_below & is_above).sum()), int((~is_below & ~is_above).sum())
    parts = [(problem.n - free - boxed, "one-sided"), (boxed, "boxed"), (free, "free")]
    return ", ".join(f"{count} {kind}" for count, kind in parts if count)


def matrix_repr(M: Any) -> str:
    """Return what can be pasted for a matrix of floats, and is kept as this one is: a list of rows, or a CSR array.

    Examples
    --------
    >>> matrix_repr(np.eye(2)), matrix_repr(sp.csr_array([[0.5, 2.0]]))
    ('[[1.0, 0.0], [0.0, 1.0]]', 'csr_array([[0.5, 2.0]])')
    """
    return f"csr_array({M.toarray().tolist()})" if sp.issparse(M) else repr(M.tolist())


def bounds_repr(lower: FloatVector, upper: FloatVector, least: float) -> list[str]:
    """Return the bounds as keyword arguments; those that are `least` and ∞ throughout need none.

    Examples
    --------
    >>> bounds_repr(np.zeros(2), np.array([1.0, np.inf]), 0.0), bounds_repr(-np.ones(2), np.ones(2), 0.0)
    (['upper=[1.0, inf]'], ['lower=-1.0', 'upper=1.0'])
    """
    given = []
    for name, bound, default in (("lower", lower, least), ("upper", upper, np.inf)):
        values = bound.tolist()
        if len({value.hex() for value in values}) > 1:
            given.append(f"{name}={values}")
        elif values and values[0].hex() != float(default).hex():
            given.append(f"{name}={values[0]}")
    return given


def within(radius: float, what: str) -> str:
    """Return the words for the radius of a proof; none where it is ∞.

    Examples
    --------
    >>> within(2.5e12, "x"), within(math.inf, "x")
    ('; of all x up to 2e+12', '')
    """
    digits, exponent = f"{radius:.15e}".split("e") if radius < math.inf else ("", "")
    return f"; of all {what} up to {digits[0]}e{exponent}" if digits else ""
