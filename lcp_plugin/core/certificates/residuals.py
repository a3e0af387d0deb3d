"""Residuals of a point z: functions of only the user's (M, q, lower, upper) and z."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..checks import BoolVector, FloatVector, read_only, real_vector, restore_state
from ..errors import InvalidProblem
from ..lcp import LCP
from ..problem_classes import refusal
from ..rounding import gamma
from .criterion import (
    POWER,
    RowsAtPoint,
    VectorEnds,
    references_of_components,
    row_data,
    rows_near_start,
    scaled_residual,
    sharp_residual_ends,
)
from .row_residuals import (
    divide_nonnegative,
    euclidean_norm,
    find_rounding_rows,
    largest_ratio,
)

if TYPE_CHECKING:
    from ..settings import Settings

GAINED = 0.1  # of the reference
DECIDED = 1e-12  # of the reference: rounding bounds below it may be plain


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
            z = real_vector(z, "z", problem.n)
        else:
            z = read_only(z.copy())
        return cls(problem, z)

    @cached_property
    def _rows(self) -> RowsAtPoint:
        with np.errstate(all="ignore"):
            return row_data(self.problem).rows(self.z)

    @cached_property
    def w(self) -> FloatVector:
        """The slack M z + q in double precision, shape (n,), read-only."""
        return read_only(self._rows.w)

    @cached_property
    def _worst(self) -> tuple[float, int]:
        """The residual that is largest relative to the reference of its component, and its row."""
        references = self.references[0]
        with np.errstate(all="ignore"):
            residual = relative = np.abs(scaled_residual(self.problem, self.z, self.w))
            if references.size > 1:  # the component with the largest relative residual
                relative = divide_nonnegative(self._proved_rows, references)
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

    @cached_property
    def relative_residual(self) -> float:
        """The largest ‖r_P(z)‖∞ / ref_P of all components, rounded upwards; 0 for 0/0."""
        if np.isinf(self.references[1]).any():
            return np.nan
        return largest_ratio(*self.residuals_of_components)

    @cached_property
    def term_residuals(self) -> FloatVector:
        """The least tolerance at which each row passes the componentwise test, shape (n,)."""
        with np.errstate(all="ignore"):
            return row_data(self.problem).term_residuals(self.z, self._rows)

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every row passes the componentwise test."""
        return _largest(self.term_residuals)

    def meets(
        self, settings: Settings, answered: BoolVector | None = None, *, power: float = POWER
    ) -> bool:
        """Return whether z passes both tests of the criterion.

        Parameters
        ----------
        settings : Settings
        answered : array of bool, shape (n,), optional
            Rows that do not count.
        power : float
            Exponent of the tolerance, next to the terms of a row.
        """
        goal, least = settings.goal, settings.least_reference
        of_rows = self.term_residuals ** (POWER / power)
        if least:  # rows within the absolute tolerance
            of_rows = np.where(self._scaled_ends[1] > goal * least, of_rows, 0.0)
        if not _largest(of_rows) <= goal:
            return False
        if not self.relative_above(least, answered) <= goal and self._may_be_sharpened:
            known = self.__dict__
            known["_scaled_ends"] = sharp_residual_ends(self.problem, self.z)
            known["_may_be_sharpened"] = False
            for name in ("relative_residual", "_proved_rows"):
                known.pop(name, None)
        return self.relative_above(least, answered) <= goal

    @cached_property
    def _may_be_sharpened(self) -> bool:
        """True if the rounding bound of a plain pass is too wide for a decision, so that compensated sums help."""
        low, high = self._scaled_ends
        return not self.is_linearised and bool((low < 0.99 * high).any())

    @property
    def residuals_of_components(self) -> VectorEnds:
        """Upper bounds of ‖r_P(z)‖∞ and lower ones of ref_P of each row, shape (n,), or (1,) if M is connected."""
        with np.errstate(all="ignore"):
            return row_data(self.problem).largest(self._proved_rows), self.references[0]

    @cached_property
    def _proved_rows(self) -> FloatVector:
        """An upper bound of every |r_i|, sharp in components that z° solves: there only an exact 0 passes."""
        ends = self._scaled_ends[1]
        is_exact = (self.references[0] == 0.0) & (ends > 0.0) & (ends < np.inf)
        return np.where(is_exact, self._sharp_ends(), ends) if is_exact.any() else ends

    def _sharp_ends(self) -> FloatVector:
        return sharp_residual_ends(self.problem, self.z)[1]

    @cached_property
    def references(self) -> VectorEnds:
        """Bounds of ref_P of each row, shape (n,), or (1,) if M is connected."""
        least, most = references_of_components(self.problem)
        with np.errstate(all="ignore"):
            limit = row_data(self.problem).acting_reference(self._rows)
        return np.minimum(least, limit), np.minimum(most, limit)

    @cached_property
    def _scaled_ends(self) -> VectorEnds:
        """Bounds of every |r_i|."""
        low, high = self._ends(self.problem.matrix.residual_scale)
        is_open = (high > DECIDED * self.references[0]) & (low < 0.99 * high) & (high < np.inf)
        # If rounding counts, compensated sums are sharper.
        return sharp_residual_ends(self.problem, self.z) if is_open.any() else (low, high)

    def _ends(self, scale: FloatVector) -> VectorEnds:
        with np.errstate(all="ignore"):
            at = self._rows
            return row_data(self.problem).residual_ends(self.z, at.w, at.slip, scale)

    @cached_property
    def _natural(self) -> FloatVector:
        """An upper bound of every |z − mid(lower, upper, z − w)|."""
        return self._ends(np.ones(self.z.size))[1]

    @cached_property
    def natural_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖∞."""
        return _largest(self._natural)

    @cached_property
    def euclidean_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖₂, rounded upwards, without overflow."""
        norm = euclidean_norm(self._natural)
        return (
            float(np.nextafter(norm * (1.0 + gamma(self.problem.n + 8)), np.inf)) if norm else 0.0
        )

    @cached_property
    def bound_violation(self) -> float:
        """max_i of lower_i − z_i, z_i − upper_i and 0."""
        problem = self.problem
        with np.errstate(all="ignore"):
            outside = np.maximum(problem.lower - self.z, self.z - problem.upper)
        return _largest(np.maximum(outside, 0.0))

    @cached_property
    def complementarity(self) -> float:
        """max_i of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over the finite bounds."""
        problem = self.problem
        with np.errstate(all="ignore"):
            above = np.where(np.isfinite(problem.lower), self.z - problem.lower, 0.0)
            below = np.where(np.isfinite(problem.upper), problem.upper - self.z, 0.0)
            larger = np.maximum(above * np.maximum(self.w, 0.0), below * np.maximum(-self.w, 0.0))
            return _largest(np.abs(larger))

    @cached_property
    def rounding_floor(self) -> FloatVector:
        """Rounding bound of each residual: k_i ε (|M||z| + |q|)_i / d_i, shape (n,).

        k_i = nonzeros of row i + 2; a residual in double precision below this level is meaningless.
        """
        floor: FloatVector = row_data(self.problem).rounding_floor(self._rows.terms)
        return floor

    @cached_property
    def is_at_rounding_level(self) -> bool:
        """True if no row's residual exceeds four times its rounding floor."""
        residual = self._scaled_ends[1]
        if not self.is_linearised:
            with np.errstate(all="ignore"):
                residual = np.abs(scaled_residual(self.problem, self.z, self.w))
        return bool(find_rounding_rows(residual, self.rounding_floor).all())

    @cached_property
    def is_limited_by_rounding(self) -> bool:
        """True at rounding level, if each component has a small residual or is solved by z° up to rounding.

        Otherwise rounding as large as the problem itself, from a z of extreme size, would count as a limit reached.
        """
        if not self.is_at_rounding_level:
            return False
        is_large = ~(divide_nonnegative(*self.residuals_of_components) <= GAINED)
        return not (is_large & ~rows_near_start(self.problem)).any()

    def relative_above(self, least: float, answered: BoolVector | None = None) -> float:
        """Return the relative residual with no reference taken for less than `least`, in the unit of z.

        The `answered` rows, shape (n,), do not count.
        """
        if not least and answered is None:
            return self.relative_residual
        rows = self._proved_rows if answered is None else np.where(answered, 0.0, self._proved_rows)
        references = np.maximum(self.references[0], least)
        return largest_ratio(rows, np.broadcast_to(references, rows.shape))

    def __str__(self) -> str:
        lines = [
            ("relative residual", self.relative_residual),
            ("natural residual", self.natural_residual),
            ("bound violation", self.bound_violation),
            ("complementarity", self.complementarity),
            ("term residual", self.term_residual),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)


def _largest(values: FloatVector) -> float:
    return (
        float(values.max()) if values.size else 0.0
    )  # NaN is the maximum of anything with NaN in it
