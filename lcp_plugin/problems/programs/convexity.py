"""Convexity test of quadratic programs, and the error messages for nonconvex programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.errors import UnsupportedModel
from ...systems.definiteness import factorised, scaled_to

if TYPE_CHECKING:
    from .program import QuadraticProgram

LARGEST_MEASURED = 1000  # variables up to which the error message contains the smallest eigenvalue
SINGLE_PRECISION = 2.0**-24


def refuse_nonconvex(program: QuadraticProgram) -> None:
    """Raise if P is not convex to the rounding of single precision: P + n 2⁻²⁴ diag(P) is not semidefinite.

    Cost: one factorization, if no row decides and the factorization fits into memory.

    Raises
    ------
    UnsupportedModel
        With the eigenvalue that shows it.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> refuse_nonconvex(QuadraticProgram([[1, 2], [2, 1]], [0, 0]))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    lcp_plugin.core.errors.UnsupportedModel: the program is not convex: the smallest eigenvalue of P is -1, ...
    """
    if program.matrices.is_nearly_semidefinite:
        return
    P = program.P
    shown = (
        f"the smallest eigenvalue of P is {smallest_eigenvalue(P):.3g}"
        if program.n <= LARGEST_MEASURED
        else "P has a negative eigenvalue"
    )
    raise UnsupportedModel(
        f"the program is not convex: {shown}, so that a stationary point need not be a minimum; solve "
        "EquilibriumProgram(program, [], []), which searches for the global minimum with SCIP (pip install "
        "'lcp_plugin[global]')"
    )


def is_nearly_semidefinite(P: Any) -> bool:
    """Return whether P + n 2⁻²⁴ diag(P) is semidefinite, with the largest entry of a row for a diagonal entry of 0."""
    d, n = P.diagonal(), P.shape[0]
    if (d < 0.0).any():
        return False
    sizes = abs(P)
    largest = np.asarray(sizes.max(axis=1).toarray()).ravel() if sp.issparse(P) else sizes.max(1)
    d = np.where(d > 0.0, d, largest)
    unit = scaled_to(P, 1.0 / np.sqrt(np.where(d > 0.0, d, 1.0)))
    return unit is None or factorised(unit, n * SINGLE_PRECISION) is not None


def smallest_eigenvalue(P: Any) -> float:
    """Return the smallest eigenvalue of a dense copy of P."""
    return float(np.linalg.eigvalsh(P.toarray() if sp.issparse(P) else P)[0])
