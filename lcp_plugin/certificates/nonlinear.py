"""How wrong an x is for a nonlinear problem: the residuals of its linearisation at x, with F(x) for w.

The scale d of the residual r_i(x) = x_i − mid(lower_i, upper_i, x_i − F_i(x)/d_i) comes from F′(x) as it does from M
(the diagonal, or where that is negligible the row's largest entry), and so does that of the reference r(z°), F(z°) for
w: both change alike with the units of F and of x. On an affine F these are the residuals of the LCP. A row with an
infinite slope (√x at 0) counts with d = 1.

No affine F with the derivative F′(x) has a larger ‖r(z°)‖∞ than

    ‖r(x)‖∞ + max_i (|x − z°|_i + (|F′(x)| |x − z°|)_i / d_i),

and so none is taken for the reference: where F is undefined at z°, or p^−σ is astronomically large there, or where
d → 0 as x runs away from an F without a root, r(x) would otherwise be small beside it anywhere.

F(x) is taken as F returns it. What rounding does in there is estimated where progress stops: F is asked at a few points
so near x that its curvature does not show, and what is left of F(x + δ) − F(x) − F′(x) δ is rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, read_only
from ..errors import InvalidProblem
from ..kernels.floats import EPSILON
from ..problem.lcp import LCP
from ..problem.nonlinear import Linearisation, NonlinearProblem
from .residuals import Certificate, Ends
from .row_residuals import residual_ends_of, scaled_residual

NEARBY = 2.0**-6  # of the step to the projected point: a derivative that is wrong by a half explains no residual
ASKED = 4  # points
ROUNDED = 1.0 + 2.0**-40  # of sums of nonnegative terms: below it an affine F may not come


@dataclass(frozen=True)
class Reference:
    """What residuals are compared with: z°, the point of the bounds nearest to 0, and F there.

    Attributes
    ----------
    x, value : ndarray, shape (n,)
        z° and F(z°), which need not be defined.
    """

    x: FloatVector
    value: FloatVector

    @classmethod
    def of(cls, problem: NonlinearProblem, start: FloatVector) -> Reference:
        """Return that of a problem.

        Raises
        ------
        InvalidProblem
            Where F is not defined at the start.
        """
        value = problem.value(start)
        if not np.isfinite(value).all():
            i = int(np.flatnonzero(~np.isfinite(value))[0])
            raise InvalidProblem(
                f"F must be finite at the start, but F(x0)[{i}] = {value[i]} with x0[{i}] = {start[i]} after "
                "projection onto the bounds; start where F is defined, or tighten the bounds"
            )
        origin = read_only(np.clip(0.0, problem.lower, problem.upper))
        return cls(origin, value if np.array_equal(origin, start) else problem.value(origin))

    def ends(self, problem: LCP, x: FloatVector, value: FloatVector) -> Ends:
        """Return bounds of the reference, where `problem` is the linearisation at x and `value` is F(x)."""
        least, most = self._ends_of_f(problem)
        limit = self._limit(problem, x, value)
        return min(least, limit), min(most, limit)

    def is_limited(self, problem: LCP, x: FloatVector, value: FloatVector) -> bool:
        """Return whether ‖r(z°)‖∞ is too large to be the reference at x."""
        return self._ends_of_f(problem)[1] > self._limit(problem, x, value)

    def _ends_of_f(self, problem: LCP) -> Ends:
        if not np.isfinite(self.value).all():
            return np.inf, np.inf
        smallest, largest = _ends(problem, self.x, self.value, problem.residual_scale)
        return float(smallest.max(initial=0.0)), float(largest.max(initial=0.0))

    def _limit(self, problem: LCP, x: FloatVector, value: FloatVector) -> float:
        """Return what ‖r(z°)‖∞ is at most for an affine F that has the value and the derivative of this one at x."""
        with np.errstate(all="ignore"):
            distance = np.abs(x - self.x)
            reached = distance + abs(problem.M) @ distance / problem.residual_scale
            here = np.abs(scaled_residual(problem, x, value))
            return ROUNDED * float(here.max(initial=0.0) + reached.max(initial=0.0))


@dataclass(frozen=True, eq=False)
class NonlinearCertificate(Certificate):
    """Every measure of how far x is from solving a nonlinear problem.

    Attributes
    ----------
    problem : LCP
        The linearisation at x; ``derivative`` and ``explain`` look at it.
    z : ndarray, shape (n,)
        The point x.
    nonlinear : NonlinearProblem
        The problem.
    value : ndarray, shape (n,)
        F(x), which is w.
    reference : Reference
        F at z°.
    relative_to : str
        What the relative residual is relative to: that, or the limit above.

    Examples
    --------
    >>> problem = NonlinearProblem(lambda x: x**2 - 4.0, lambda x: np.diag(2.0 * x), lower=[0.0])
    >>> reference = Reference.of(problem, np.array([1.0]))
    >>> certificate = NonlinearCertificate.at(Linearisation(problem, np.array([2.001])), reference)
    >>> certificate.w.round(4), float(round(certificate.relative_residual, 4)), certificate.relative_to
    (array([0.004]), 0.001, 'F at the point of the bounds nearest to 0')
    """

    is_linearised: ClassVar[bool] = True

    nonlinear: NonlinearProblem = field(kw_only=True, repr=False)
    value: FloatVector = field(kw_only=True, repr=False)
    reference: Reference = field(kw_only=True, repr=False)

    @classmethod
    def at(cls, point: Linearisation, reference: Reference) -> NonlinearCertificate:
        """Return the certificate of the x of a linearisation.

        Raises
        ------
        InvalidProblem
            Where F or its derivative is not finite there.
        """
        return cls(point.lcp, point.x, nonlinear=point.problem, value=point.value, reference=reference)

    @property
    def w(self) -> FloatVector:
        """F(x), shape (n,), read-only."""
        return self.value

    @property
    def reference_ends(self) -> Ends:
        """Bounds of the reference."""
        return self.reference.ends(self.problem, self.z, self.value)

    @property
    def relative_to(self) -> str:
        """What the relative residual is relative to, in words."""
        if self.reference.is_limited(self.problem, self.z, self.value):
            return "what an affine F with this derivative has at most at the point of the bounds nearest to 0"
        return "F at the point of the bounds nearest to 0"

    def _sharp_ends(self) -> FloatVector:
        return self._scaled_ends[1]  # of the numbers that F returns, nothing is summed here

    def _ends(self, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
        return _ends(self.problem, self.z, self.value, scale)

    @cached_property
    def rounding_floor(self) -> FloatVector:
        """What rounding alone can make of each residual, estimated, shape (n,).

        k_i ε (|F′(x)||x| + |F(x)|)_i / d_i, k_i = entries of row i of F′ + 2, and what F adds to that on its way: the
        largest |F(x + δ) − F(x) − F′(x) δ|_i / d_i, δ a few fractions of 1/64 of the step that the residual asks for.
        """
        problem, x = self.problem, self.z
        scale = problem.residual_scale
        terms = np.diff(problem.matrix.csr_rows.indptr) + 2
        with np.errstate(all="ignore"):
            size = abs(problem.matrix.rows) @ np.abs(x) + np.abs(self.value)
            left = np.zeros(x.size)
            step = np.clip(x - self.value / scale, problem.lower, problem.upper) - x
            for k in range(ASKED):
                near = x + NEARBY / (k + 1) * step
                left = np.maximum(left, np.abs(self.nonlinear.value(near) - self.value - problem.M @ (near - x)))
            floor: FloatVector = (terms * EPSILON * size + left) / scale
        return floor

    def __str__(self) -> str:
        return f"{super().__str__()}\nrelative to         {self.relative_to}"


def _ends(problem: LCP, x: FloatVector, value: FloatVector, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return bounds of every |x_i − mid(lower_i, upper_i, x_i − value_i/scale_i)|."""
    nothing = sp.csr_array((x.size, x.size))
    return residual_ends_of(nothing, x, problem, x, scale, q=np.ascontiguousarray(value))


