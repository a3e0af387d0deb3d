"""How wrong an x is for a nonlinear problem: the residuals of its linearisation at x, with F(x) for w.

The scale d of the residual r_i(x) = x_i − mid(lower_i, upper_i, x_i − F_i(x)/d_i) comes from F′(x) as it does from M
(the diagonal, or where that is negligible the row's largest entry), and so does that of the reference r(z°), F(z°) for
w: both change alike with the units of F and of x. On an affine F these are the residuals of the LCP. Where F is not
defined at z°, the middle between it and the projected start takes its place, or a point nearer to the start; the start
itself may be the answer already. A row with an infinite slope (√x at 0) counts with d = 1.

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
from .row_residuals import residual_ends_of

NEARBY = 2.0**-6  # of the step to the projected point: a derivative that is wrong by a half explains no residual
ASKED = 4  # points
HALVINGS = 10


@dataclass(frozen=True)
class Reference:
    """What the residuals of a nonlinear problem are compared with: a point and F there.

    Attributes
    ----------
    x, value : ndarray, shape (n,)
    name : str
        Which point it is.
    """

    x: FloatVector
    value: FloatVector
    name: str

    @classmethod
    def of(cls, problem: NonlinearProblem, start: FloatVector) -> Reference:
        """Return z°, the point of the bounds nearest to 0, or where F is not defined there one on the way to the start.

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
        at_origin = value if np.array_equal(origin, start) else problem.value(origin)
        if np.isfinite(at_origin).all():
            return cls(origin, at_origin, "the point of the bounds nearest to 0")
        for k in range(1, HALVINGS):  # not from the start itself: that may be the answer already
            between = read_only(start + 0.5**k * (origin - start))
            if np.isfinite(value := problem.value(between)).all():
                return cls(between, value, f"1/{2**k} of the way from the start to the point nearest to 0")
        return cls(start, problem.value(start), "the projected start, F being undefined nearer to 0")

    def ends(self, problem: LCP) -> Ends:
        """Return bounds of ‖r‖∞ here, in the scale of a linearisation."""
        smallest, largest = _ends(problem, self.x, self.value, problem.residual_scale)
        return float(smallest.max(initial=0.0)), float(largest.max(initial=0.0))


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
        What the relative residual is relative to.

    Examples
    --------
    >>> problem = NonlinearProblem(lambda x: x**2 - 4.0, lambda x: np.diag(2.0 * x), lower=[0.0])
    >>> reference = Reference.of(problem, np.array([1.0]))
    >>> certificate = NonlinearCertificate.at(Linearisation(problem, np.array([2.001])), reference)
    >>> certificate.w.round(4), float(round(certificate.relative_residual, 4)), certificate.reference.name
    (array([0.004]), 0.001, 'the point of the bounds nearest to 0')
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
        """Bounds of ‖r‖∞ at the reference point."""
        return self.reference.ends(self.problem)

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
        return f"{super().__str__()}\nrelative to         F at {self.reference.name}"


def _ends(problem: LCP, x: FloatVector, value: FloatVector, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return bounds of every |x_i − mid(lower_i, upper_i, x_i − value_i/scale_i)|."""
    nothing = sp.csr_array((x.size, x.size))
    return residual_ends_of(nothing, x, problem, x, scale, q=np.ascontiguousarray(value))


