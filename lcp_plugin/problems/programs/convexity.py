"""Whether a quadratic program is convex, and what is said where it is not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.errors import UnsupportedModel
from ...core.kernels.floats import EPSILON
from ...systems.definiteness import is_semidefinite_to_rounding

if TYPE_CHECKING:
    from .program import QuadraticProgram

LARGEST_CHECKED = 5000  # variables of a program that is factorised for the question of convexity alone
LARGEST_MEASURED = 1000  # variables up to which a refusal names the smallest eigenvalue
CLEAR = 1e-6  # by how much an entry must exceed the mean of its diagonal entries where nothing is factorised


def refuse_nonconvex(program: QuadraticProgram) -> None:
    """Raise where P has an eigenvalue that is negative beyond the rounding of its largest entries.

    One factorisation up to n = 5000; beyond, a look at each entry beside its diagonal ones.

    Raises
    ------
    UnsupportedModel
        With the eigenvalue or the entries that show it.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> refuse_nonconvex(QuadraticProgram([[1, 2], [2, 1]], [0, 0]))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    lcp_plugin.core.errors.UnsupportedModel: the program is not convex: the smallest eigenvalue of P is -1, ...
    """
    P = program.P
    if program.n <= LARGEST_CHECKED:
        if program.is_convex is not False or is_semidefinite_beside_its_largest(P):
            return
        dense = P.toarray() if sp.issparse(P) else P
        what = f"the smallest eigenvalue of P is {np.linalg.eigvalsh(dense)[0]:.3g}" if program.n <= LARGEST_MEASURED \
            else "P has a negative eigenvalue"
    else:
        place = clearly_indefinite_at(P)
        if place is None:
            return
        i, j = place
        entries = dict.fromkeys(((i, i), (j, j), (i, j)))
        what = f"{', '.join(f'P[{k}, {m}] = {P[k, m]:.3g}' for k, m in entries)} shows it"
    raise UnsupportedModel(
        f"the program is not convex: {what}, so that a stationary point need not be a minimum; state a convex "
        "objective, use a solver for nonconvex programs, or state its stationarity conditions as complementarities"
    )


def is_semidefinite_beside_its_largest(P: Any) -> bool:
    """Return whether P is positive semidefinite up to the rounding of its largest entries.

    A row that should be zero may hold rounding errors of the others, which a scale of its own would magnify.
    """
    n = P.shape[0]
    shift = n * (n + 4) * EPSILON * float(abs(P).max())
    return is_semidefinite_to_rounding(sp.csr_array(sp.csr_array(P) + shift * sp.eye_array(n))) is not False


def clearly_indefinite_at(P: Any) -> tuple[int, int] | None:
    """Return i, j with |p_ij| clearly above √(p_ii p_jj), or i, i with a negative p_ii; None where there are none."""
    listed, d = sp.coo_array(P), P.diagonal()
    scale = float(abs(d).max(initial=0.0)) * CLEAR
    if d.min(initial=0.0) < -scale:
        return int(d.argmin()), int(d.argmin())
    root = np.sqrt(np.maximum(d, 0.0))
    excess = np.abs(listed.data) - (1.0 + CLEAR) * root[listed.row] * root[listed.col]
    worst = int(excess.argmax()) if excess.size else 0
    return (int(listed.row[worst]), int(listed.col[worst])) if excess.size and excess[worst] > scale else None
