"""Upper bounds of the distance of z from the solution.

The stages are in `row_inequality` (v-certificate, reference point) and `solution_bounds`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ...core.certificates.criterion import row_data, scaled_residual
from ...core.checks import BoolVector, FloatVector, checked_vector
from ...core.errors import InvalidOption, InvalidProblem, UnsuitableMatrix
from ...core.lcp import LCP
from ...core.problem_classes import refusal
from ..exact.upward import quotient_above, sum_above
from .row_inequality import ActiveSetSteps, NearPoint, RowInequality, distance_above
from .solution_bounds import EigenvalueBound, Family, bound_of_error, bounds_of

SMALL = 1000  # up to here every stage is cheap
STEPS = 12  # each takes two digits off the bound, at the cost of a third of a linear solve
# possible improvement, relative to a lower bound of the error
SHARP_ENOUGH_SMALL, SHARP_ENOUGH_LARGE = 0.05, 0.5

NO_PROOF = (
    "an error bound needs an H₊-matrix (⟨M⟩v > 0 for some v > 0, positive diagonal) or a positive definite symmetric "
    "part, and M was not proven to have either; Certificate.of(problem, z) has the residuals"
)


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """A bound of |z − z*|, the distance from z to the solution.

    Attributes
    ----------
    componentwise : ndarray, shape (n,)
        |z_i − z*_i| ≤ componentwise_i, in the unit of z.
    infinity : float
        Their maximum, ‖z − z*‖∞ ≤ infinity.
    relative : float
        ‖z − z*‖∞ ≤ relative · ‖z‖∞, in every component of the problem by itself; ∞ if z = 0 there and z* = 0 is not
        proved.
    method : str
        "v-certificate", "reference point" or "2-norm, λ_min", whichever gave `infinity`.
    proven_active, proven_inactive : ndarray of bool, shape (n,)
        z*_i equals a bound; z*_i lies strictly between its bounds, so that w*_i = 0.
    residual : float
        ‖r(z)‖∞, the numerator of the relative residual: in the unit of z, as `infinity` is.
    near : NearPoint or None
        The point near z* at which most is known; None if nothing is.
    seconds : float
        Seconds that it took to compute.
    """

    componentwise: FloatVector = field(repr=False)
    infinity: float
    relative: float
    method: str
    proven_active: BoolVector = field(repr=False)
    proven_inactive: BoolVector = field(repr=False)
    residual: float = np.nan
    near: NearPoint | None = field(default=None, repr=False)
    seconds: float = field(default=0.0, repr=False)

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of rows that are proven active, and inactive."""
        return int(self.proven_active.sum()), int(self.proven_inactive.sum())

    def carried_to(self, z: FloatVector) -> FloatVector:
        """Return a bound of |z − z*|, componentwise, for any z of shape (n,): by its distance to `near`, in O(n).

        Examples
        --------
        >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
        >>> bound = error_bound(problem, [2.5 + 1e-6, 0])
        >>> bool(0.999e-3 <= bound.carried_to(np.array([2.5 + 1e-3, 0.0])).max() <= 1.001e-3)
        True
        """
        return np.full(z.shape, np.inf) if self.near is None else self.near.bound(z)

    def __str__(self) -> str:
        n, (active, inactive) = self.componentwise.size, self.counts
        return (
            f"‖z − z*‖∞ ≤ {self.infinity:.3e}, relative {self.relative:.3e} ({self.method})\n"
            f"proven: {active} active, {inactive} inactive, {n - active - inactive} of {n} undecided"
        )


@np.errstate(all="ignore")
def error_bound(problem: LCP, z: ArrayLike, *, sharp: bool = True) -> ErrorBound:
    """Return a bound of |z − z*|, componentwise, for the one solution z*.

    Parameters
    ----------
    problem : LCP
        M an H₊-matrix, or with a positive definite symmetric part: then z* exists and is unique.
    z : array, shape (n,)
        Any point, also outside the bounds. With NaN or infinite entries the bound is ∞.
    sharp : bool
        False: only the v-certificate (or the 2-norm bound), one pass over M once the matrix is known. True: also the
        stages that solve linear systems; the least of all counts.

    Raises
    ------
    InvalidProblem
        If `problem` is not an LCP or z not a real vector of length n.
    InvalidOption
        If `sharp` is neither True nor False.
    UnsuitableMatrix
        If M is neither proven H₊ nor proven positive definite.

    Notes
    -----
    Rigorous in floating point: the only assumption is that M, q and the bounds are the stored doubles.

    References
    ----------
    X. Chen, S. Xiang, *Computation of error bounds for P-matrix linear complementarity problems*, Math. Program. 106
    (2006), doi:10.1007/s10107-005-0645-9 (the classical bounds that these sharpen).

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> bound = error_bound(problem, [2.5 + 1e-6, 0])
    >>> 1e-6 <= bound.infinity < 1.001e-6, bound.proven_active.tolist()
    (True, [False, True])
    """
    if not isinstance(problem, LCP):
        raise InvalidProblem(refusal("error_bound", problem))
    if not isinstance(sharp, bool | np.bool_):
        raise InvalidOption(f"sharp must be True or False, got {sharp!r}")
    z, began = checked_vector(z, "z", problem.n, is_finite=False), time.perf_counter()
    family = bounds_of(problem.matrix)
    if family is None:
        raise UnsuitableMatrix(NO_PROOF)
    found = _bound(problem, z, family, sharp=sharp)
    return replace(found, seconds=time.perf_counter() - began)


def _bound(problem: LCP, z: FloatVector, family: Family, *, sharp: bool) -> ErrorBound:
    method = "2-norm, λ_min" if isinstance(family, EigenvalueBound) else "v-certificate"
    if not np.isfinite(z).all():
        is_free = (problem.lower == -np.inf) & (problem.upper == np.inf)
        y = np.full(problem.n, np.inf)
        return ErrorBound(y, np.inf, np.inf, method, problem.lower == problem.upper, is_free)
    at = RowInequality.at(problem, z)
    found = BestBound(z, at, bound_of_error(at, family), method)
    if sharp:
        _sharpen(found, family)
    return found.result()


class BestBound:
    """The best bound so far, and the point near z at which most is known of z*."""

    def __init__(self, z: FloatVector, at: RowInequality, y: FloatVector, method: str) -> None:
        self.z, self.at, self.y, self.method = z, at, y, method
        self.near, self.near_y = at, y

    def go_to(self, near: RowInequality, y: FloatVector) -> None:
        """Set the reference point and the bound y of its error; keep the least bound per row."""
        self.near, self.near_y = near, y
        by_way_of_it = sum_above(distance_above(near.high, near.low, self.z), y)
        if by_way_of_it.max(initial=0.0) < self.y.max(initial=0.0):
            self.method = "reference point"
        self.y = np.minimum(self.y, by_way_of_it)

    @property
    def is_sharp(self) -> bool:
        """True if the error is proved to be nearly as large as its bound."""
        enough = SHARP_ENOUGH_SMALL if self.z.size <= SMALL else SHARP_ENOUGH_LARGE
        distance = distance_above(self.near.high, self.near.low, self.z)
        error = float((distance - self.near_y).max(initial=0.0))
        return float(self.y.max(initial=0.0)) <= (1.0 + enough) * error

    def result(self) -> ErrorBound:
        """Return the bound."""
        problem, y = self.at.problem, np.where(np.isnan(self.y), np.inf, self.y)
        active, inactive = self.near.classified(self.near_y)
        if self.near is not self.at and not (active | inactive).all():
            more_active, more_inactive = self.at.classified(y)
            active, inactive = active | more_active, inactive | more_inactive
        w = 0.5 * (self.at.slack - self.at.negative_slack)
        residuals = scaled_residual(problem, self.at.high, w)
        infinity, residual = (float(np.abs(one).max(initial=0.0)) for one in (y, residuals))
        largest = row_data(problem).largest
        errors, sizes = (largest(np.abs(one)).tolist() for one in (y, self.z))
        relative = max(relative_to(*one) for one in {*zip(errors, sizes, strict=True)})
        is_active = active | (problem.lower == problem.upper)
        near = NearPoint(self.near.high, self.near.low, self.near_y)
        return ErrorBound(y, infinity, relative, self.method, is_active, inactive, residual, near)


def _sharpen(found: BestBound, family: Family) -> None:
    """Go to points nearer to the solution as long as that lowers the bound."""
    problem = found.at.problem
    steps = ActiveSetSteps(problem, 1.0 / problem.residual_scale)
    point = found.at
    for _ in range(STEPS):
        following = steps.next_point(point)
        if following is None:
            return
        point, y = following, bound_of_error(following, family)
        y = np.minimum(y, point.image(y))
        before = float(found.near_y.max(initial=0.0))
        if not float(y.max(initial=0.0)) < 0.5 * before:
            # A step of the active-set method may lead astray before it leads home.
            if problem.n > SMALL or before == 0.0 or found.is_sharp:
                return
            continue
        found.go_to(point, y)
        if found.is_sharp and problem.n > SMALL:
            return


def relative_to(infinity: float, size: float) -> float:
    """Return infinity/size, rounded up: 0 for 0/0, else ∞ if the size is 0."""
    if infinity == 0.0:
        return 0.0
    return float(quotient_above(np.float64(infinity), np.float64(size))) if size > 0.0 else np.inf
