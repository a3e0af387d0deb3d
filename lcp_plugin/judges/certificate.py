"""Residuals of a point z, functions of only the user's (M, q, lower, upper) and z, and its worst rows by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core.checks import Vector, checked_vector, derived_property, fill, read_only, restore_state
from ..core.entries import max_norm
from ..core.errors import InvalidProblem
from ..core.lcp import LCP
from ..core.problem_classes import refusal
from ..core.rounding import ROUNDING, gamma
from . import lcp as judge
from .lcp import RowData, RowResiduals, RowsAtPoint, VectorEnds


@dataclass(frozen=True, eq=False)
class Certificate:
    """Residuals of z as a solution of the problem, computed only from the problem's data and z.

    The relative, natural and euclidean residuals are upper bounds of the exact ones: rounding errors are included. The
    other numbers are measured in double precision. A slack at the rounding level of its row may count as 0.

    Attributes
    ----------
    problem : LCP
        The problem on which z was measured.
    z : ndarray, shape (n,)

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> Certificate.of(problem, [2.5, 0]).relative_residual < 1e-14
    True
    >>> Certificate.of(problem, [2.5, 0.5]).worst_index
    1
    """

    problem: LCP = field(repr=False)
    z: Vector = field(repr=False)

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
        return cls(problem, checked_vector(z, "z", problem.n, is_finite=False))

    @classmethod
    def at(cls, problem: LCP, z: Vector, **known: Any) -> Certificate:
        """Return the certificate of z, read-only; `known` are its properties `criterion` and `rows`, or None."""
        measures = {name: value for name, value in known.items() if value is not None}
        return fill(cls(problem, z), **measures)

    @derived_property
    def criterion(self) -> RowData:
        """The data of the criterion."""
        return judge.row_data(self.problem)

    @derived_property
    def rows(self) -> RowsAtPoint:
        """Values of all rows at z."""
        return self.criterion.rows(self.z)

    @derived_property
    def by_row(self) -> RowResiduals:
        """Residuals of all rows, by sums in twice the precision if rounding makes the largest residual uncertain."""
        return self.criterion.residuals_at(self.z, self.rows, ROUNDING)

    @derived_property
    def w(self) -> Vector:
        """The slack M z + q in double precision, shape (n,), read-only."""
        return read_only(self.rows.w)

    @derived_property
    def worst_index(self) -> int:
        """The row of the largest residual relative to the reference of its component; −1 for an empty problem."""
        residual = relative = np.abs(judge.scaled_residual(self.problem, self.z, self.w))
        if self.by_row.reference.size > 1:  # the component with the largest relative residual
            relative = np.where(np.isfinite(residual), self.by_row.relative, np.nan)
        return int(np.argmax(relative)) if relative.size else -1  # argmax stops at the first NaN

    @derived_property
    def scaled_residual(self) -> float:
        """‖r(z)‖∞ of the worst component, in the unit of z, as measured in double precision."""
        residual = np.abs(judge.scaled_residual(self.problem, self.z, self.w))
        return float(residual[self.worst_index]) if residual.size else 0.0

    @property
    def relative_residual(self) -> float:
        """The largest ‖r_P(z)‖∞ / ref_P of all components, rounded upwards; 0 for 0/0."""
        return float(self.by_row.relative.max(initial=0.0))

    @derived_property
    def term_residuals(self) -> Vector:
        """The least tolerance at which each row passes the componentwise test, shape (n,)."""
        return self.criterion.term_residuals(self.rows)

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every row passes the componentwise test."""
        return float(self.term_residuals.max(initial=0.0))

    @derived_property
    def _natural(self) -> Vector:
        """An upper bound of every |z − mid(lower, upper, z − w)|."""
        at = self.rows
        return self.criterion.residual_ends(self.z, at.w, at.rounding, np.ones(self.z.size))[1]

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
        return max_norm(np.maximum(*self.products))

    @derived_property
    def rounding_floor(self) -> Vector:
        """Rounding bound of each residual: k_i ε (|M||z| + |q|)_i / d_i, shape (n,).

        k_i = nonzeros of row i + 2; a residual in double precision below this level is meaningless.
        """
        return self.criterion.rounding_floor(self.rows.terms)

    @derived_property
    def is_at_rounding_level(self) -> bool:
        """True if no row's residual exceeds four times its rounding floor."""
        return bool(judge.find_rounding_rows(self.by_row[:2], self.rounding_floor).all())

    def __str__(self) -> str:
        names = "relative_residual", "natural_residual", "bound_violation", "complementarity"
        return describe_measures(self, *names, "term_residual")


def describe_measures(certificate: object, *names: str) -> str:
    """Return a line of text per measure of a certificate."""
    values = ((name.replace("_", " "), getattr(certificate, name)) for name in names)
    return "\n".join(f"{name:<18} {value:.3e}" for name, value in values)
