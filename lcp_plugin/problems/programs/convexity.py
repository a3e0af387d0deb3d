"""Convexity test of quadratic programs, and the error messages for nonconvex programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.errors import UnsupportedModel
from .program_matrices import ProgramMatrices, as_array

if TYPE_CHECKING:
    from .program import QuadraticProgram


LARGEST_SHOWN = 1000  # unknowns of a P whose eigenvalues are computed for a message
ROUNDED = 1e-2  # of the largest eigenvalue: a negative one that rounding to some digits may cause


def refuse_nonconvex(program: QuadraticProgram) -> None:
    """Raise if P is not convex to the rounding of single precision: P + n 2⁻²⁴ diag(P) is not semidefinite.

    Only the unknowns count that bounds, and rows of one unknown, do not fix.

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
    P, (lower, upper) = program.P, (program.folded.reduced.lower, program.folded.reduced.upper)
    free = np.flatnonzero(lower < upper)
    if free.size < program.n:
        none = np.zeros((0, free.size))
        if ProgramMatrices(P[free][:, free], none, none).is_nearly_semidefinite:
            return
    shown, repair = "P has a negative eigenvalue", ""
    if program.n <= LARGEST_SHOWN:
        values = np.linalg.eigvalsh(as_array(P))
        shown = f"the smallest eigenvalue of P is {values[0]:.3g}"
        if -values[0] <= ROUNDED * values[-1]:
            repair = (
                "if P is rounded, replace it by the nearest semidefinite matrix: w, V = numpy.linalg.eigh(P); "
                "P = V * w.clip(0) @ V.T; otherwise "
            )
    raise UnsupportedModel(
        f"the program is not convex: {shown}, so that a stationary point need not be a minimum; {repair}solve "
        "EquilibriumProgram(program, [], []), which searches for the global minimum with SCIP (pip install "
        "'.[global]')"
    )
