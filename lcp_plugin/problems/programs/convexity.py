"""Convexity test of quadratic programs, and the error messages for nonconvex programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.errors import UnsupportedModel
from .program_matrices import as_array

if TYPE_CHECKING:
    from .program import QuadraticProgram


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
    shown = (
        f"the smallest eigenvalue of P is {np.linalg.eigvalsh(as_array(program.P))[0]:.3g}"
        if program.n <= 1000
        else "P has a negative eigenvalue"
    )
    raise UnsupportedModel(
        f"the program is not convex: {shown}, so that a stationary point need not be a minimum; solve "
        "EquilibriumProgram(program, [], []), which searches for the global minimum with SCIP (pip install "
        "'.[global]')"
    )
