"""A proof that a nonlinear problem has a solution near x, the only one in a box.

The rows that x seems to hold at a bound are put there: A. Of f, F on the other rows with x_A fixed, the Krawczyk
operator K(X) = x̃ − Y f(x̃) + (I − Y f′(X))(X − x̃), Y ≈ f′(x̃)⁻¹, maps the box X = x̃ ± radius into its interior: then
f has exactly one zero in X, and it lies in K(X). It is a solution if X lies strictly between the bounds, and if over
K(X) F_A > 0 at lower and F_A < 0 at upper bounds. There is no other one within the bound of |x − x*| that comes of it
if X holds all these points, and if these signs hold over all of them, x_A off its bounds included. (Without the
condition on the bounds x² = 1e-4 with the lower bound 0.05 is "proved" at 0.01.) All of it is computed with intervals
of the caller's, and rounded outwards.

Where Y, which is dense, would be too large, another test takes its place, which needs dominance (Miranda): with C the
comparison matrix of f′(X), v > 0 and X = x̃ ± t v, t C v > |f(x̃)| gives f_i opposite signs on opposite faces of X, and
so a zero in it; a second one cannot be, since every matrix in f′(X) is an H-matrix.

References
----------
R. Krawczyk, *Newton-Algorithmen zur Bestimmung von Nullstellen mit Fehlerschranken*, Computing 4 (1969),
doi:10.1007/BF02234767.
R. E. Moore, *A test for existence of solutions to nonlinear systems*, SIAM J. Numer. Anal. 14 (1977),
doi:10.1137/0714040.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.certificates.row_residuals import scaled_residual
from ...core.checks import BoolVector, FloatVector
from ...core.kernels.floats import TINY
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix
from ...core.rounding import gamma, lower_end
from ...proofs.bounds.error_bounds import ErrorBound, relative_to
from ...proofs.bounds.row_inequality import NearPoint
from ...proofs.exact.upward import quotient_above, sum_above
from ...proofs.verdicts import comparison_certificate
from ...systems.comparison_sums import comparison_product
from .data import Enclosure

DENSE_UP_TO = 1000  # free rows
NEWTON_STEPS = 3
TRIALS = 12
INFLATION = 1.2


class _Point(NamedTuple):
    """x̃ with its held rows at their bounds, and which those are."""

    x: FloatVector
    free: BoolVector
    is_upper: BoolVector


def krawczyk_bound(problem: LCP, x: FloatVector, enclosure: Enclosure) -> ErrorBound | None:
    """Return a bound of the distance from x to a solution that is proved to exist nearby; None where no proof succeeds.

    Parameters
    ----------
    problem : LCP
        The linearisation of the nonlinear problem at x: its bounds, and what its rows seem to do.
    x : array, shape (n,)
        Near a solution.
    enclosure : Enclosure
        ``interval_F(low, high)`` and ``interval_jacobian(low, high)``, rounding included; low = high is a point.

    Returns
    -------
    ErrorBound or None
        ``componentwise`` bounds |x − x*| for the only solution x* within it; ``proven_active`` are the rows that x*
        holds at a bound, with F_i(x*) ≠ 0 where the bounds differ. Nothing is said of solutions elsewhere.

    Notes
    -----
    Up to 1000 free rows a dense inverse is made, and some products with it; beyond, F′ has to be an H-matrix on the
    free rows. Solutions with F_i = 0 at a bound, or with a singular block of F′, cannot be proved.

    Examples
    --------
    >>> from lcp_plugin.problems.nonlinear.data import NonlinearProblem
    >>> class Square:  # F(x) = x² − 2, on x > 0
    ...     def interval_F(self, low, high):
    ...         return np.nextafter(low * low, -1) - 2 - 1e-15, np.nextafter(high * high, 9) - 2 + 1e-15
    ...     def interval_jacobian(self, low, high):
    ...         return sp.csr_array(np.diag(2 * low)), sp.csr_array(np.diag(2 * high))
    >>> problem = NonlinearProblem(lambda x: x * x - 2, lambda x: np.diag(2 * x), lower=[0.0])
    >>> x = np.array([1.4142])
    >>> bound = krawczyk_bound(problem.linearised(x), x, Square())
    >>> print(bound)
    ‖z − z*‖∞ ≤ 1.356e-05, relative 9.590e-06 (rigorous, Krawczyk)
    proven: 0 active, 1 inactive, 0 of 1 undecided
    """
    began = time.perf_counter()
    with np.errstate(all="ignore"):  # what overflows proves nothing
        at = _held(problem, x)
        small = np.count_nonzero(at.free) <= DENSE_UP_TO
        found = (_by_krawczyk if small else _by_dominance)(problem, at, enclosure)
        if found is None:
            return None
        bound = _bound(problem, x, *found, "Krawczyk" if small else "dominance", began)
        is_proved = bound is not None and _has_right_signs(
            problem, found[0], x, bound.componentwise, enclosure
        )
        return bound if is_proved else None


def _held(problem: LCP, x: FloatVector) -> _Point:
    """Return x with those rows put to a bound that its residual puts there."""
    target = x - problem.slack(x) / problem.residual_scale
    is_upper = (target >= problem.upper) & (problem.lower < problem.upper)
    at_lower = (target <= problem.lower) | (problem.lower == problem.upper)
    held = np.where(at_lower, problem.lower, np.where(is_upper, problem.upper, x))
    return _Point(held, ~(at_lower | is_upper), is_upper & ~at_lower)


def _by_krawczyk(
    problem: LCP, at: _Point, enclosure: Enclosure
) -> tuple[_Point, FloatVector] | None:
    """Return a point x̃ and the radii of a box around it that holds exactly one zero of F on the free rows."""
    rows = np.flatnonzero(at.free)
    if not rows.size:
        return at, np.zeros(at.x.size)
    inverse = _inverse(problem, rows)
    if inverse is None:
        return None
    x, at = at.x, _refined(at, rows, inverse, enclosure)
    offset = np.abs(at.x - x)[rows]
    centre, rough = _middle(*_values(enclosure, at.x, at.x))
    distance = _product_above(inverse, centre[rows], rough[rows])
    radius = 2.0 * distance + 4.0 * offset + TINY
    for _ in range(TRIALS):
        box = _box(at, rows, radius)
        if not _is_inside(problem, rows, *box):
            return None
        least, most = _derivative(enclosure, *box, rows)
        contraction = _distance_from_identity(inverse, least.toarray(), most.toarray())
        image = _raised(contraction @ radius + distance, rows.size)
        needed = _raised(
            image + 2.0 * offset, 2
        )  # for the image, and for all that is as near to x as it is
        if bool((needed < radius).all()):
            image = np.minimum(
                image, _raised(contraction @ image + distance, rows.size)
            )  # the zero lies in K(X), too
            found = np.zeros(at.x.size)
            found[rows] = image
            return at, found
        if not np.isfinite(image).all():
            return None
        radius = INFLATION * needed + TINY
    return None


def _refined(at: _Point, rows: Any, inverse: FloatVector, enclosure: Enclosure) -> _Point:
    """Return the point after simplified Newton steps, as long as these shrink."""
    last = np.inf
    for _ in range(NEWTON_STEPS):
        step = inverse @ _middle(*_values(enclosure, at.x, at.x))[0][rows]
        size = float(np.abs(step).max())
        if not size < 0.5 * last:
            break
        moved = at.x.copy()
        moved[rows] -= step
        at, last = at._replace(x=moved), size
    return at


def _by_dominance(
    problem: LCP, at: _Point, enclosure: Enclosure
) -> tuple[_Point, FloatVector] | None:
    """Return the same where the derivative is an H-matrix with a positive diagonal."""
    rows = np.flatnonzero(at.free)
    low, high = _values(enclosure, at.x, at.x)
    size = np.maximum(np.abs(low), np.abs(high))[rows]
    v: FloatVector | None = None
    length = 0.0
    radius = np.zeros(at.x.size)
    for _ in range(TRIALS):
        box = _box(at, rows, radius[rows])
        if not _is_inside(problem, rows, *box):
            return None
        comparison = _comparison(enclosure, *box, rows)
        if comparison is None:
            return None
        if v is None:
            certificate = comparison_certificate(Matrix(comparison))
            if certificate is None:
                return None
            v = certificate.v
        margin = lower_end(*comparison_product(comparison, v))
        if not bool((margin > 0.0).all()):
            return None
        needed = float(quotient_above(size, margin).max())
        if needed < length:
            return at, radius
        length = INFLATION * needed + TINY
        radius[rows] = np.nextafter(length * v, np.inf)
        length = float(np.nextafter((radius[rows] / v).min(), 0.0))
    return None


def _comparison(
    enclosure: Enclosure, low: FloatVector, high: FloatVector, rows: Any
) -> sp.csr_array | None:
    """Return the comparison matrix of all derivatives over the box: the least diagonal, −1 × the largest others."""
    least, most = _derivative(enclosure, low, high, rows)
    diagonal = least.diagonal()
    if (
        not bool((diagonal > 0.0).all())
        or not np.isfinite(least.data).all()
        or not np.isfinite(most.data).all()
    ):
        return None
    largest = sp.csr_array(abs(least).maximum(abs(most)))
    return sp.csr_array(sp.diags_array(diagonal + largest.diagonal()) - largest)


# --- what intervals say ----------------------------------------------------------------------------------------


def _values(
    enclosure: Enclosure, low: FloatVector, high: FloatVector
) -> tuple[FloatVector, FloatVector]:
    least, most = (np.asarray(end, dtype=np.float64) for end in enclosure.interval_F(low, high))
    return least, most


def _derivative(
    enclosure: Enclosure, low: FloatVector, high: FloatVector, rows: Any
) -> tuple[Any, Any]:
    """Return the ends of the block of F′ on these rows, CSR arrays."""
    least, most = (
        sp.csr_array(end)[rows][:, rows] for end in enclosure.interval_jacobian(low, high)
    )
    return least, most


def _middle(low: FloatVector, high: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return a centre and a radius that hold the interval."""
    centre = 0.5 * low + 0.5 * high
    return centre, np.maximum(sum_above(high, -centre), sum_above(centre, -low))


def _box(at: _Point, rows: Any, radius: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return the ends of x̃ ± radius, rounded outwards; held rows are points."""
    low, high = at.x.copy(), at.x.copy()
    low[rows] = -sum_above(-low[rows], radius)
    high[rows] = sum_above(high[rows], radius)
    return low, high


def _is_inside(problem: LCP, rows: Any, low: FloatVector, high: FloatVector) -> bool:
    """Return whether the box lies strictly between the bounds on the free rows."""
    return bool(((low[rows] > problem.lower[rows]) & (high[rows] < problem.upper[rows])).all())


def _has_right_signs(
    problem: LCP, at: _Point, x: FloatVector, radius: FloatVector, enclosure: Enclosure
) -> bool:
    """Return whether F has the sign that its bound asks for on every held row, wherever x* or another may be."""
    box = np.clip([-sum_above(-x, radius), sum_above(x, radius)], problem.lower, problem.upper)
    low, high = _values(enclosure, *box)
    is_right = (
        at.free | (problem.lower == problem.upper) | np.where(at.is_upper, high < 0.0, low > 0.0)
    )
    return bool(is_right.all())


def _inverse(problem: LCP, rows: Any) -> FloatVector | None:
    """Return about the inverse of the block of M on these rows."""
    block = problem.M[rows][:, rows]
    try:
        inverse: FloatVector = np.linalg.inv(block.toarray() if sp.issparse(block) else block)
    except np.linalg.LinAlgError:
        return None
    return inverse if np.isfinite(inverse).all() else None


# --- rounded upwards -------------------------------------------------------------------------------------------


def _product_above(Y: FloatVector, centre: FloatVector, radius: FloatVector) -> FloatVector:
    """Return an upper bound of |Y f| for every f in centre ± radius."""
    k = Y.shape[0]
    size = np.abs(Y)
    return _raised(np.abs(Y @ centre) + size @ (radius + gamma(k + 2) * np.abs(centre)), k)


def _distance_from_identity(Y: FloatVector, low: FloatVector, high: FloatVector) -> FloatVector:
    """Return an upper bound of |I − Y J| for every J between low and high, entry by entry."""
    k = Y.shape[0]
    centre, radius = _middle(low, high)
    size, rest = np.abs(Y), np.abs(np.eye(k) - Y @ centre)
    return _raised(rest + gamma(k + 3) * (size @ np.abs(centre) + np.eye(k)) + size @ radius, k)


def _raised(value: FloatVector, terms: int) -> FloatVector:
    """Return an upper bound of what sums of that many products ≥ 0, and a few more operations, were rounded from."""
    bound: FloatVector = value * (1.0 + 4.0 * gamma(terms + 8)) + (8 * terms + 8) * TINY
    return bound


def _bound(
    problem: LCP, x: FloatVector, at: _Point, radius: FloatVector, method: str, began: float
) -> ErrorBound | None:
    near = NearPoint(at.x, np.zeros(x.size), radius)
    componentwise = near.bound(x)
    infinity = float(componentwise.max(initial=0.0))
    if not np.isfinite(infinity):
        return None
    residual = float(np.abs(scaled_residual(problem, x, problem.slack(x))).max(initial=0.0))
    held = ~at.free
    return ErrorBound(
        componentwise,
        infinity,
        relative_to(infinity, float(np.abs(x).max(initial=0.0))),
        "rigorous",
        method,
        held,
        at.free.copy(),
        x.size,
        int(held.sum()),
        int(at.free.sum()),
        residual,
        near,
        time.perf_counter() - began,
    )
