"""Proofs that a problem has no solution, and by how much: a lower bound of the residual of every z.

Each is a set of cases, with a Farkas vector for every one; the linear constraints alone are one case.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import (
    references_of_components,
    rounding_of_data,
)
from ...core.checks import FloatVector, derived_property
from ...core.kernels.floats import DATA_ROUNDING, EPSILON
from ...core.lcp import LCP
from ...core.matrix.structure import is_nearly_symmetric
from ...core.settings import Status
from ..exact.rational import ZERO, Rational, integer_matrix, rounded_down
from .free_motion import is_at_rest, moved_unknowns
from .linear_constraints import FarkasCertificate

SAFE_RANGE = (1e-290, 1e290)
LOWER, SLACKLESS, UPPER, FIXED = "lower", "zero", "upper", "fixed"
FEW = 500  # rows up to which all of M is kept in integers
Margins = tuple[float, float]


def row_choices(lower: float, upper: float) -> tuple[str, ...]:
    """Return the branches of a row: z_i = lower with w_i ≥ 0, w_i = 0, z_i = upper with w_i ≤ 0.

    Examples
    --------
    >>> row_choices(0.0, np.inf), row_choices(-np.inf, np.inf), row_choices(1.0, 1.0)
    (('lower', 'zero'), ('zero',), ('fixed',))
    """
    if lower == upper:
        return (FIXED,)
    return (LOWER,) * (lower > -np.inf) + (SLACKLESS,) + (UPPER,) * (upper < np.inf)


class NoSolutionProof:
    """A proof that no z solves a problem, with a lower bound of the residual of every z within the bounds.

    The status is INFEASIBLE or NO_SOLUTION only if the margin exceeds the tolerance of the run: then no z could be
    SOLVED. A smaller margin is true for the stored double-precision data, but has no practical meaning. The same holds
    for a margin below the rounding of the largest number in q.

    Notes
    -----
    |r_i(z)| ≤ t_i, r the scaled residual, leaves a row three cases: z_i − lower_i ≤ t_i and w_i ≥ 0, or
    |w_i| ≤ d_i t_i, or upper_i − z_i ≤ t_i and w_i ≤ 0; if the case is not chosen, w_i has a wrong sign by d_i t_i
    at most. With t_i = t ‖r_P(z°)‖∞, P the component of row i, the least t at which the certificate of a piece fails,
    minimized over all pieces, bounds the relative residual from below.
    """

    problem: LCP
    status: ClassVar[Status] = Status.NO_SOLUTION  # the proved status
    radius: ClassVar[float] = np.inf  # it covers all z

    def closings(self) -> Iterator[Margins | None]:
        """Yield the margins of each piece, (relative, absolute); None for an open piece."""
        raise NotImplementedError

    @np.errstate(all="ignore")
    def verify(self) -> bool:
        """Return whether the proof holds, computed again from only the problem's data."""
        return all(closing is not None for closing in self.closings())

    @cached_property
    def exact(self) -> bool:
        """True if the stored data have no solution, by any margin; the result of `verify`."""
        return self.verify()

    @derived_property
    def _margins(self) -> Margins:
        """The smallest margins of all pieces; 0 if a piece is open."""
        found = list(self.closings())
        closed = [margins for margins in found if margins is not None]
        if len(closed) < len(found):
            return 0.0, 0.0
        relative, absolute = zip(*closed, strict=True)
        return min(relative), min(absolute)

    @property
    def margin(self) -> float:
        """Verified lower bound of the relative residual of every z within the bounds, or 0."""
        return self._margins[0]

    @property
    def absolute_margin(self) -> float:
        """A verified lower bound of ‖r(z)‖∞, in the unit of z, for every z within the bounds."""
        return self._margins[1]

    @derived_property
    def is_rounding(self) -> bool:
        """True if the margin is within the rounding of the largest number in q."""
        return self.absolute_margin <= rounding_of_data(self.problem)

    def excludes(self, tolerance: float, absolute_tolerance: float = 0.0) -> bool:
        """Return whether no z within the bounds could be called SOLVED with these settings of a run."""
        if self.is_rounding or not self.margin > tolerance:
            return False
        # A point may use up both tolerances, in different components.
        return not absolute_tolerance or (
            tolerance / self.margin + absolute_tolerance / self.absolute_margin < 1.0 - EPSILON
        )


class Choices(NamedTuple):
    """The linear constraints of a piece, in which some rows are decided.

    The other rows have w of the signs that their bounds permit.
    """

    problem: LCP
    path: Mapping[int, str]

    @property
    def matrix(self) -> sp.csr_array:
        """M."""
        return self.problem.csr

    @property
    def q(self) -> FloatVector:
        """The offset of w = M z + q."""
        return self.problem.q

    def signs(self, row: int) -> tuple[bool, bool]:
        """Return whether w_i ≥ 0 and w_i ≤ 0."""
        choice = self.path.get(row)
        if choice is None:
            return bool(self.problem.upper[row] == np.inf), bool(self.problem.lower[row] == -np.inf)
        return choice in (LOWER, SLACKLESS), choice in (UPPER, SLACKLESS)

    def bounds(self, column: int) -> tuple[float, float]:
        """Return the bounds of z_j."""
        lower, upper = float(self.problem.lower[column]), float(self.problem.upper[column])
        choice = self.path.get(column)
        return (
            (lower, lower)
            if choice == LOWER
            else (upper, upper)
            if choice == UPPER
            else (lower, upper)
        )

    def contradiction(self, y: Mapping[int, Rational]) -> FarkasCertificate:
        """Return the Farkas certificate of a vector, by row, if its signs are right."""
        rows = integer_matrix(self.problem.matrix) if self.problem.n <= FEW else None
        return FarkasCertificate(
            self, {i: Fraction(value) for i, value in y.items() if value}, rows
        )

    def closed_by(self, y: Mapping[int, Rational]) -> Margins | None:
        """Return the margins of the piece by a Farkas vector; None if it does not prove that the piece is empty.

        Every z has Σ share_i |r_i(z)| ≥ c, r the scaled residual, and c the size of the contradiction. The absolute
        margin is c / Σ share_i, the relative one c / Σ share_i ‖r_P(z°)‖∞, P the component of row i.
        """
        found = self.contradiction(y)
        if not found.holds:
            return None
        scale, path = self.problem.residual_scale, self.path
        shares = [
            (i, abs(value) * Fraction(float(scale[i])))
            for i, value in found.y.items()
            if path.get(i) not in (LOWER, UPPER)
        ] + [
            (i, abs(value))
            for i, value in found.product.items()
            if path.get(i) == (LOWER if value > 0 else UPPER)
        ]  # of z_i from its bound
        most = references_of_components(self.problem)[1]
        reference = np.broadcast_to(most, (self.problem.n,))
        is_safe = (most == 0.0) | ((most > SAFE_RANGE[0]) & (most < SAFE_RANGE[1]))
        if not is_safe.all():  # a reference may be rounded to 0, or to ∞
            return 0.0, 0.0
        relative = sum((share * Fraction(float(reference[i])) for i, share in shares), ZERO)
        absolute = sum((share for _, share in shares), ZERO)
        margins = (rounded_down(found.size / one if one else None) for one in (relative, absolute))
        return next(margins), next(margins)


@dataclass(frozen=True, eq=False)
class Infeasibility(NoSolutionProof):
    """A Farkas vector y: for no z within its bounds has w = M z + q only signs that the bounds permit.

    Permitted is w_i ≥ 0 if upper_i = ∞, w_i ≤ 0 if lower_i = −∞, both signs in a box. The sum yᵀ(M z + q − w) is
    zero for every z, yet sup (Mᵀy)ᵀz − yᵀw + qᵀy over all permitted z and w is negative. For the classical problem:
    y ≥ 0, Mᵀy ≤ 0, qᵀy < 0. With −c the supremum, Σ|y_i| d_i |r_i(z)| ≥ c for every z within the bounds: in some
    component P ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ ≥ c / Σ|y_i| d_i ‖r_P(i)(z°)‖∞, which is `margin` (d and r as in
    :mod:`lcp_plugin.core.certificates.criterion`).

    Attributes
    ----------
    exact_y : tuple of Fraction
        The vector, its largest entry 1.
    y : ndarray, shape (n,)
        Rounded `exact_y`.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §2.7 (Farkas).
    """

    status: ClassVar[Status] = Status.INFEASIBLE

    problem: LCP = field(repr=False)
    exact_y: tuple[Fraction, ...] = field(repr=False)

    @classmethod
    def of(cls, problem: LCP, y: Mapping[int, Rational]) -> Infeasibility:
        """Return the proof by a nonzero vector, by row, of any scale."""
        largest, exact = max(abs(Fraction(value)) for value in y.values()), [ZERO] * problem.n
        for i, value in y.items():
            exact[i] = Fraction(value) / largest
        return cls(problem, tuple(exact))

    def excludes(self, tolerance: float, absolute_tolerance: float = 0.0) -> bool:
        """Return whether no z could be SOLVED; empty rows fail the componentwise test unless q_i is rounding."""
        return super().excludes(tolerance, absolute_tolerance) or (
            not absolute_tolerance and self._rests_on_empty_rows and self.exact
        )

    @cached_property
    def _rests_on_empty_rows(self) -> bool:
        used, sizes = list(self._used), np.abs(self.problem.q)
        is_empty = not np.diff(self.problem.csr.indptr)[used].any()
        return is_empty and bool((sizes[used] > DATA_ROUNDING * sizes.max()).all())

    @cached_property
    def _used(self) -> dict[int, Fraction]:
        return {i: value for i, value in enumerate(self.exact_y) if value}

    @cached_property
    def y(self) -> FloatVector:
        """The vector rounded, shape (n,)."""
        y = np.zeros(self.problem.n)
        y[list(self._used)] = [float(value) for value in self._used.values()]
        return y

    def closings(self) -> Iterator[Margins | None]:
        """Yield the margins of the only piece: c = −sup, and weights |y_i| for a wrong sign of w_i."""
        yield Choices(self.problem, {}).closed_by(self._used)

    def __str__(self) -> str:
        problem = self.problem
        if is_nearly_symmetric(problem.matrix) and is_at_rest(problem.matrix.array, self.y):
            return (
                f"nothing holds {moved_unknowns(self.y)}: along them M d = 0 and qᵀd < 0, and no bound is in the "
                "way; proof: exact"
            )
        rows = list(self._used)
        named = ", ".join(f"{self.y[i]:.4g} × row {i}" for i in rows[:4]) + (
            ", …" if len(rows) > 4 else ""
        )
        combined = f"{len(rows)} rows are inconsistent ({named})"
        if len(rows) == 1:
            combined = f"row {rows[0]} contradicts its bounds"
        return f"no z within its bounds gives w the signs it needs: {combined}; proof: exact"

    def __repr__(self) -> str:
        return f"Infeasibility({self})"
