"""Whether a quadratic program is convex, and what is said where it is not."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.errors import UnsupportedModel
from ...core.kernels.floats import TINY
from ...core.matrix.matrix import largest_in_rows
from ...systems.definiteness import is_semidefinite_to_rounding

if TYPE_CHECKING:
    from .program import QuadraticProgram

LARGEST_CHECKED = (
    5000  # variables of a program that is factorised for the question of convexity alone
)
LARGEST_MEASURED = 1000  # variables up to which a refusal names the smallest eigenvalue
ROUNDING = 2.0**-46  # what doubles cannot tell from 0 beside a sum of some dozens
ROUNDED = 1e-7  # of the largest entry: entries of single precision, or of seven digits
CLEAR = 1e-6  # by how much an entry must exceed the mean of its diagonal entries where nothing is factorised


def refuse_nonconvex(program: QuadraticProgram) -> None:
    """Raise where P has an eigenvalue that is negative beyond 1e-7 of its largest entry.

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
        if program.matrices.negative_curvature < math.inf:
            return
        what = (
            f"the smallest eigenvalue of P is {smallest_eigenvalue(P):.3g}"
            if program.n <= LARGEST_MEASURED
            else "P has a negative eigenvalue"
        )
    else:
        place = clearly_indefinite_at(P)
        if place is None:
            return
        i, j = place
        entries = dict.fromkeys(((i, i), (j, j), (i, j)))
        what = f"{', '.join(f'P[{k}, {m}] = {P[k, m]:.3g}' for k, m in entries)} shows it"
    raise UnsupportedModel(
        f"the program is not convex: {what}, so that a stationary point need not be a minimum; solve "
        "EquilibriumProgram(program, [], []), which searches for the global minimum with SCIP (pip install "
        "'lcp_plugin[global]')"
    )


def negative_curvature(P: Any, is_semidefinite: bool | None) -> float:
    """Return how far the smallest eigenvalue of P is below 0, or a bound of it; 0 where that is rounding of its rows.

    ∞ where that is more than 1e-7 of its largest entry: P is clearly not semidefinite. In between the data may have
    been rounded to seven digits, or rows that should be zero hold errors of others; whether it acts is a question to an
    answer.
    """
    if is_semidefinite is not False:
        return 0.0
    shift = ROUNDED * float(abs(P).max())
    if (
        is_semidefinite_to_rounding(
            sp.csr_array(sp.csr_array(P) + shift * sp.eye_array(P.shape[0]))
        )
        is False
    ):
        return math.inf
    if P.shape[0] > LARGEST_MEASURED:
        return shift
    return max(-smallest_eigenvalue(P), TINY)  # which in doubles may be 0 beside the largest entry


def bends(program: QuadraticProgram, x: FloatVector, tolerance: float) -> bool:
    """Return whether negative curvature acts at x: a stationary x is then no minimiser of a convex program.

    It does not where P + E is positive semidefinite for a diagonal E ≥ 0 so small that x minimises a convex program
    close by: each e_j changes no component of the gradient at x by more than the tolerance beside its own terms,
    e_j |x_j| ≤ tolerance · max(|c_j|, |(P x)_j|), and is at most 1e-7 of the largest entry of its connected component;
    or, between bounds, all of them change the objective by no more than the tolerance of the terms of its component at
    x. Terms and entries of other components excuse what is rounding beside both: an e_j below 2⁻⁴⁶ of the largest entry
    that changes the objective by no more than 2⁻⁴⁶ of all its terms.
    """
    if not program.matrices.negative_curvature:
        return False
    from scipy.sparse.csgraph import connected_components

    P = sp.csr_array(program.P)
    _, component = connected_components(P, directed=False)
    largest = np.zeros(component.size)
    np.maximum.at(largest, component, largest_in_rows(P))
    farthest = np.maximum(np.abs(program.lower), np.abs(program.upper))
    with np.errstate(all="ignore"):
        pull = P @ x
        forces = np.maximum(np.abs(program.c), np.abs(pull))
        by_gradient = np.where(
            forces > 0.0, tolerance * forces / np.abs(x), tolerance * np.abs(P.diagonal())
        )
        terms = np.bincount(component, np.abs(program.c * x) + np.abs(x * pull))
        of_all = np.minimum(
            ROUNDING * terms.sum() / (x.size * farthest**2), ROUNDING * largest.max()
        )
        by_objective = np.fmax(tolerance * terms[component] / (x.size * farthest**2), of_all)
    by_gradient = np.minimum(by_gradient, ROUNDED * largest[component])
    allowed = np.fmax(by_gradient, np.where(farthest > 0.0, by_objective, 0.0))
    return is_semidefinite_to_rounding(sp.csr_array(P + sp.diags_array(allowed))) is False


def smallest_eigenvalue(P: Any) -> float:
    """Return that of a dense copy of P."""
    return float(np.linalg.eigvalsh(P.toarray() if sp.issparse(P) else P)[0])


def clearly_indefinite_at(P: Any) -> tuple[int, int] | None:
    """Return i, j with |p_ij| clearly above √(p_ii p_jj), or i, i with a negative p_ii; None where there are none."""
    listed, d = sp.coo_array(P), P.diagonal()
    scale = float(abs(d).max(initial=0.0)) * CLEAR
    if d.min(initial=0.0) < -scale:
        return int(d.argmin()), int(d.argmin())
    root = np.sqrt(np.maximum(d, 0.0))
    excess = np.abs(listed.data) - (1.0 + CLEAR) * root[listed.row] * root[listed.col]
    worst = int(excess.argmax()) if excess.size else 0
    return (
        (int(listed.row[worst]), int(listed.col[worst]))
        if excess.size and excess[worst] > scale
        else None
    )
