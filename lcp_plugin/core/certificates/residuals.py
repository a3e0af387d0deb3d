"""Residuals of a point z: functions of only the user's (M, q, lower, upper) and z."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..checks import (
    BoolVector,
    FloatVector,
    checked_vector,
    derived_property,
    read_only,
    restore_state,
)
from ..errors import InvalidProblem
from ..kernels.floats import TINY
from ..lcp import LCP
from ..problem_classes import refusal
from ..rounding import gamma
from .criterion import (
    POWER,
    RowsAtPoint,
    VectorEnds,
    find_rounding_rows,
    references_of_components,
    row_data,
    rows_near_start,
    scaled_residual,
    sharp_residual_ends,
)

if TYPE_CHECKING:
    from ..settings import Settings

GAINED = 0.1  # of the reference


@dataclass(frozen=True, eq=False)
class Certificate:
    """Residuals of z as a solution of the problem, computed only from the problem's data and z.

    The relative, natural and euclidean residuals are upper bounds of the exact ones: rounding errors are included. The
    other numbers are measured in double precision.

    Attributes
    ----------
    problem : LCP
        The problem on which z was measured.
    z, w : ndarray, shape (n,)
        The point and its slack M z + q in double precision.
    scaled_residual : float
        ‖r(z)‖∞ of the worst component, in the user's unit of z, measured.
    relative_residual : float
        The largest ‖r_P(z)‖∞ / ref_P of all connected components P of the graph of M
        (:mod:`lcp_plugin.core.certificates.criterion`).
    term_residual : float
        The least tolerance at which every row passes the componentwise test there.
    natural_residual : float
        ‖z − mid(lower, upper, z − w)‖∞, unscaled; the number other solvers print.
    euclidean_residual : float
        ‖z − mid(lower, upper, z − w)‖₂; the paper's Res.
    bound_violation : float
        Largest distance of z from [lower, upper], in the unit of z.
    complementarity : float
        max_i of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over finite bounds.
    worst_index : int
        The row of the largest residual relative to the reference of its component; −1 for an empty problem.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> Certificate.of(problem, [2.5, 0]).relative_residual < 1e-14
    True
    >>> Certificate.of(problem, [2.5, 0.5]).worst_index
    1
    """

    problem: LCP = field(repr=False)
    z: FloatVector = field(repr=False)

    is_linearised: ClassVar[bool] = (
        False  # whether `problem` is the linearization of a nonlinear problem at z
    )

    __setstate__ = restore_state

    @classmethod
    def of(cls, problem: LCP, z: ArrayLike) -> Certificate:
        """Return the certificate of z, shape (n,), for the problem.

        Raises
        ------
        InvalidProblem
            If z is not a real vector of length n. NaN and infinities are accepted.
        """
        if not isinstance(problem, LCP):
            raise InvalidProblem(refusal("Certificate.of", problem))
        if type(z) is not np.ndarray or z.dtype != np.float64 or z.shape != (problem.n,):
            z = checked_vector(z, "z", problem.n, is_finite=False)
        else:
            z = read_only(z.copy())
        return cls(problem, z)

    @derived_property
    def _rows(self) -> RowsAtPoint:
        return row_data(self.problem).rows(self.z)

    @derived_property
    def w(self) -> FloatVector:
        """The slack M z + q in double precision, shape (n,), read-only."""
        return read_only(self._rows.w)

    @derived_property
    def _worst(self) -> tuple[float, int]:
        """The residual that is largest relative to the reference of its component, and its row."""
        references = self.references[0]
        residual = relative = np.abs(scaled_residual(self.problem, self.z, self.w))
        if references.size > 1:  # the component with the largest relative residual
            relative = divide_nonnegative(self.residual_ends[1], references)
            relative = np.where(np.isfinite(residual), relative, np.nan)  # the worst of all
        worst = int(np.argmax(relative)) if relative.size else -1  # argmax stops at the first NaN
        return (float(residual[worst]), worst) if relative.size else (0.0, -1)

    @property
    def worst_index(self) -> int:
        """The row of the largest residual relative to the reference of its component; −1 for an empty problem."""
        return self._worst[1]

    @property
    def scaled_residual(self) -> float:
        """‖r(z)‖∞ of the worst component, in the unit of z, as measured in double precision."""
        return self._worst[0]

    @property
    def relative_residual(self) -> float:
        """The largest ‖r_P(z)‖∞ / ref_P of all components, rounded upwards; 0 for 0/0."""
        return self.relative_above(0.0)

    @derived_property
    def term_residuals(self) -> FloatVector:
        """The least tolerance at which each row passes the componentwise test, shape (n,)."""
        return row_data(self.problem).term_residuals(self.z, self._rows)

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every row passes the componentwise test."""
        return float(self.term_residuals.max(initial=0.0))

    def meets(
        self, settings: Settings, solved: BoolVector | None = None, *, power: float = POWER
    ) -> bool:
        """Return whether z passes both tests of the criterion.

        Parameters
        ----------
        settings : Settings
        solved : array of bool, shape (n,), optional
            Rows that do not count.
        power : float
            Exponent of the tolerance, next to the terms of a row.
        """
        goal, least = settings.goal, settings.least_reference
        if not self.relative_above(least, solved, goal) <= goal:
            return False
        is_open = self.residual_ends[1] > goal * least  # else within the absolute tolerance
        of_rows = np.where(is_open | (not least), self.term_residuals ** (POWER / power), 0.0)
        if not of_rows.max(initial=0.0) <= goal:
            return False
        with np.errstate(all="ignore"):
            data = row_data(self.problem)
            return not data.are_refuted(self.z, self._rows, goal, np.True_, is_open)

    def relative_above(
        self, least: float, solved: BoolVector | None = None, goal: float = np.inf
    ) -> float:
        """Return the relative residual with no reference taken for less than `least`, in the unit of z.

        The `solved` rows, shape (n,), do not count. If rounding decides whether it is at most `goal`, compensated sums
        replace the plain bounds.
        """
        low, high = (
            self._relative(end if solved is None else np.where(solved, 0.0, end), least)
            for end in self.residual_ends
        )
        if not low <= goal < high or self.is_linearised:
            return high
        self.__dict__["residual_ends"] = sharp_residual_ends(self.problem, self.z)
        return self.relative_above(least, solved)

    def _relative(self, residuals: FloatVector, least: float = 0.0) -> float:
        """Return the largest of the residuals ≥ 0, shape (n,), relative to the reference of its component."""
        smallest, largest = self.references
        if np.isinf(largest).any():
            return np.nan
        if smallest.size == 1:
            residuals = residuals.max(initial=0.0, keepdims=True)
        return largest_ratio(residuals, np.maximum(smallest, least))

    @derived_property
    def references(self) -> VectorEnds:
        """Bounds of ref_P of each row, shape (n,), or (1,) if M is connected."""
        least, most = self._start_references()
        limit = row_data(self.problem).active_reference(self._rows)
        return np.minimum(least, limit), np.minimum(most, limit)

    def _start_references(self) -> VectorEnds:
        """Return bounds of ‖r_P(z°)‖∞, of the shapes of `references`."""
        return references_of_components(self.problem)

    @derived_property
    def residual_ends(self) -> VectorEnds:
        """Bounds of every |r_i|; by compensated sums if rounding makes the largest one uncertain by 1 %."""
        ends = self._ends(self.problem.matrix.residual_scale)
        low, high = (self._relative(end) for end in ends)
        is_certain = high <= 1e-12 or low >= 0.99 * high or self.is_linearised
        return ends if is_certain else sharp_residual_ends(self.problem, self.z)

    def _ends(self, scale: FloatVector) -> VectorEnds:
        at = self._rows
        return row_data(self.problem).residual_ends(self.z, at.w, at.rounding, scale)

    @derived_property
    def _natural(self) -> FloatVector:
        """An upper bound of every |z − mid(lower, upper, z − w)|."""
        return self._ends(np.ones(self.z.size))[1]

    @derived_property
    def natural_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖∞."""
        return float(self._natural.max(initial=0.0))

    @derived_property
    def euclidean_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖₂, rounded upwards, without overflow."""
        largest = self.natural_residual
        if not 0.0 < largest < np.inf:
            return largest
        norm = largest * float(np.linalg.norm(self._natural / largest))
        return float(np.nextafter(norm * (1.0 + gamma(self.problem.n + 8)), np.inf))

    @derived_property
    def bound_violation(self) -> float:
        """max_i of lower_i − z_i, z_i − upper_i and 0."""
        problem = self.problem
        outside = np.maximum(problem.lower - self.z, self.z - problem.upper)
        return float(outside.max(initial=0.0))

    @derived_property
    def products(self) -> VectorEnds:
        """The (z_i − lower_i) w_i⁺ and the (upper_i − z_i) w_i⁻, 0 for an infinite bound, shape (n,) each."""
        problem = self.problem
        above = np.where(np.isfinite(problem.lower), self.z - problem.lower, 0.0)
        below = np.where(np.isfinite(problem.upper), problem.upper - self.z, 0.0)
        return above * np.maximum(self.w, 0.0), below * np.maximum(-self.w, 0.0)

    @derived_property
    def complementarity(self) -> float:
        """max_i of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over the finite bounds."""
        return float(np.abs(np.maximum(*self.products)).max(initial=0.0))

    @derived_property
    def rounding_floor(self) -> FloatVector:
        """Rounding bound of each residual: k_i ε (|M||z| + |q|)_i / d_i, shape (n,).

        k_i = nonzeros of row i + 2; a residual in double precision below this level is meaningless.
        """
        floor: FloatVector = row_data(self.problem).rounding_floor(self._rows.terms)
        return floor

    @derived_property
    def is_at_rounding_level(self) -> bool:
        """True if no row's residual exceeds four times its rounding floor."""
        residual = self.residual_ends[1]
        if not self.is_linearised:
            residual = np.abs(scaled_residual(self.problem, self.z, self.w))
        return bool(find_rounding_rows(residual, self.rounding_floor).all())

    @derived_property
    def is_limited_by_rounding(self) -> bool:
        """True at rounding level, if each component has a small residual or is solved by z° up to rounding.

        Otherwise rounding as large as the problem itself, from a z of extreme size, would count as a limit reached.
        """
        if not self.is_at_rounding_level:
            return False
        is_large = ~(divide_nonnegative(self.residual_ends[1], self.references[0]) <= GAINED)
        return not (is_large & ~rows_near_start(self.problem)).any()

    def __str__(self) -> str:
        lines = [
            ("relative residual", self.relative_residual),
            ("natural residual", self.natural_residual),
            ("bound violation", self.bound_violation),
            ("complementarity", self.complementarity),
            ("term residual", self.term_residual),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)


def largest_ratio(numerators: FloatVector, denominators: FloatVector) -> float:
    """Return the largest quotient of numbers ≥ 0; 0 for 0/0, and for empty arrays, but not by underflow.

    Examples
    --------
    >>> largest_ratio(np.array([1.0, 0.0]), np.array([4.0, 0.0])), largest_ratio(np.array([1e-320]), np.array([1e10]))
    (0.25, 5e-324)
    """
    largest = float(divide_nonnegative(numerators, denominators).max(initial=0.0))
    return largest or (TINY if numerators.any() else 0.0)


def divide_nonnegative(numerators: FloatVector, denominators: FloatVector) -> FloatVector:
    """Return the quotients of numbers that are ≥ 0, with 0/0 = 0; NaN stays NaN."""
    with np.errstate(all="ignore"):
        quotients: FloatVector = np.where(numerators == 0.0, 0.0, numerators / denominators)
    return quotients


def ratio(numerator: float, denominator: float) -> float:
    """Return numerator/denominator with 0/0 = 0; NaN stays NaN, and nothing can be measured against ∞."""
    if denominator == np.inf:
        return np.nan
    if numerator == 0.0:
        return 0.0
    return numerator / denominator if denominator else np.inf if numerator > 0.0 else np.nan
