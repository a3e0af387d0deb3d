"""Proofs that a problem has no solution, and by how much: a lower bound of the residual of every z.

Each is a set of cases, with a Farkas vector for every one; the linear constraints alone are one case.

The references that residuals are compared with are fractions: they reach beyond the range of doubles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache, cached_property
from typing import ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import (
    references_of_components,
    rounding_of_data,
)
from ...core.checks import FloatVector
from ...core.kernels.floats import DATA_ROUNDING, EPSILON
from ...core.lcp import LCP
from ...core.matrix.structure import connected_components
from ...core.matrix.symmetry import is_nearly_symmetric
from ...core.settings import Status
from ..exact.rational import ZERO, Rational, exact_residuals, integer_matrix, rounded_down
from .free_motion import is_at_rest, moved_unknowns
from .linear_constraints import Contradiction

SAFE_RANGE = (1e-290, 1e290)
LOWER, SLACKLESS, UPPER, FIXED = "lower", "zero", "upper", "fixed"
FEW = 500  # rows up to which all of M is kept in integers


def exact_references(problem: LCP) -> Callable[[int], Fraction]:
    """Return upper bounds of ‖r_P(z°)‖∞, P the component of a row; fractions reach beyond the range of doubles."""
    several = connected_components(problem.matrix)
    most = references_of_components(problem)[1]

    @cache
    def of_component(component: int) -> Fraction:
        if most[component] == 0.0 or SAFE_RANGE[0] < most[component] < SAFE_RANGE[1]:
            return Fraction(float(most[component]))
        rows = (
            range(problem.q.size)
            if several is None
            else np.flatnonzero(several.labels == component).tolist()
        )
        exact = exact_residuals(problem, problem.nearest_to_zero)
        return max(exact[i] for i in rows)

    def of_row(row: int) -> Fraction:
        return of_component(0 if several is None else int(several.labels[row]))

    return of_row


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


@dataclass(frozen=True)
class Closing:
    """Certificate of one complementarity piece: every z in it has Σ weight_i |r_i(z)| ≥ contradiction.

    Attributes
    ----------
    contradiction : Fraction
        Positive, a lower bound.
    relative : Fraction
        At least Σ weight_i ‖r_P(z°)‖∞, r the scaled residual and P the component of row i.
    absolute : Fraction
        At least Σ weight_i.
    """

    contradiction: Fraction
    relative: Fraction
    absolute: Fraction


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

    def closings(self) -> Iterator[Closing | None]:
        """Yield the verified certificate of each piece; None for an open piece."""
        raise NotImplementedError

    def verify(self) -> bool:
        """Return whether the proof holds, computed again from only the problem's data."""
        return all(closing is not None for closing in self.closings())

    @cached_property
    def exact(self) -> bool:
        """True if the stored data have no solution, by any margin; the result of `verify`."""
        return self.verify()

    @cached_property
    def margin(self) -> float:
        """Verified lower bound of the relative residual of every z within the bounds, or 0."""
        return rounded_down(self._least[0])

    @cached_property
    def absolute_margin(self) -> float:
        """A verified lower bound of ‖r(z)‖∞, in the unit of z, for every z within the bounds."""
        return rounded_down(self._least[1])

    @property
    def is_rounding(self) -> bool:
        """True if the margin is within the rounding of the largest number in q."""
        return rounded_down(self._least[1]) <= rounding_of_data(self.problem)

    def excludes(self, tolerance: float, absolute_tolerance: float = 0.0) -> bool:
        """Return whether no z within the bounds could be called SOLVED with these settings of a run."""
        if self.is_rounding or not self.margin > tolerance:
            return False
        # A point may use up both tolerances, in different components.
        return not absolute_tolerance or (
            tolerance / self.margin + absolute_tolerance / self.absolute_margin < 1.0 - EPSILON
        )

    @cached_property
    def _least(self) -> tuple[Fraction | None, Fraction | None]:
        """The least relative residual and the least one; None for ∞."""
        found = list(self.closings())
        closings = [closing for closing in found if closing is not None]
        if len(closings) < len(found):
            return ZERO, ZERO
        relative = [one.contradiction / one.relative for one in closings if one.relative]
        absolute = [one.contradiction / one.absolute for one in closings if one.absolute]
        return min(relative, default=None), min(absolute, default=None)


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

    def contradiction(self, y: Mapping[int, Rational]) -> Contradiction:
        """Return the Farkas certificate of a vector, by row, if its signs are right."""
        rows = integer_matrix(self.problem.matrix) if self.problem.n <= FEW else None
        return Contradiction(self, {i: Fraction(value) for i, value in y.items() if value}, rows)

    def closed_by(self, y: Mapping[int, Rational]) -> Closing | None:
        """Return the certificate of the piece by a Farkas vector, for all z; None if it is not one."""
        found = self.contradiction(y)
        if not found.holds:
            return None
        scale, path = self.problem.residual_scale, self.path
        sizes = {i: abs(y) for i, y in found.y.items() if path.get(i) not in (LOWER, UPPER)}
        scaled = [(i, size * Fraction(float(scale[i]))) for i, size in sizes.items()]
        leaving = {
            i: abs(value)
            for i, value in found.product.items()
            if path.get(i) == (LOWER if value > 0 else UPPER)
        }  # of z_i from its bound
        shares = [*scaled, *leaving.items()]
        reference = exact_references(self.problem)
        return Closing(
            found.size,
            sum((share * reference(i) for i, share in shares), ZERO),
            sum((share for _, share in shares), ZERO),
        )


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

    def closings(self) -> Iterator[Closing | None]:
        """Yield the certificate of the only piece: c = −sup, and weights |y_i| for a wrong sign of w_i."""
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
