"""How wrong a z is: a function of the caller's (M, q, lower, upper) and z, and of nothing else."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..checks import BoolVector, FloatVector, read_only, real_vector, restored
from ..errors import InvalidProblem
from ..lcp import LCP
from ..matrix.structure import connected_components
from ..problem_classes import refusal
from ..rounding import gamma
from .criterion import (
    RowScaling,
    VectorEnds,
    for_each_row,
    hold_at_zero,
    largest_of_components,
    references_of_components,
    within,
)
from .own_terms import term_residuals
from .row_residuals import (
    at_rounding_level,
    euclidean_norm,
    largest_ratio,
    magnitude,
    over,
    residual_ends_of,
    rounding_floor,
    scaled_residual,
    sharp_residual_ends,
)

if TYPE_CHECKING:
    from ..settings import Settings

GAINED = 1e-2  # of the reference
SMALL = 1e-9  # a smaller tolerance is meant of the complementarity problem that a program was made into, too


@dataclass(frozen=True, eq=False)
class Certificate:
    """How far z is from solving the problem, measured on the problem's data and z alone.

    The relative, natural and euclidean residuals are proved: upper bounds of the exact ones, sharp but for some ulps.
    The others are measured in double precision.

    Attributes
    ----------
    problem : LCP
        The problem that z was judged on.
    z, w : ndarray, shape (n,)
        The point and its slack M z + q in double precision.
    scaled_residual : float
        ‖r(z)‖∞ of the worst component, in the caller's unit of z, measured.
    relative_residual : float
        The largest ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ of all connected components P of the graph of M, with
        r_i = z_i − mid(lower_i, upper_i, z_i − w_i/d_i) and z° the point of [lower, upper] nearest to 0, in the scaling
        that M needs (:mod:`lcp_plugin.core.certificates.criterion`).
    term_residual : float
        How wrong the worst row is beside its own terms (:mod:`lcp_plugin.core.certificates.own_terms`).
    natural_residual : float
        ‖z − mid(lower, upper, z − w)‖∞, unscaled; the number other solvers print.
    euclidean_residual : float
        ‖z − mid(lower, upper, z − w)‖₂; the paper's Res.
    bound_violation : float
        How far z lies outside [lower, upper], in the unit of z.
    complementarity : float
        max_i of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over finite bounds.
    worst_index : int
        The row of the largest residual relative to the ‖r_P(z°)‖∞ of its component: it names the worst one; −1 for an
        empty problem.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> Certificate.of(problem, [2.5, 0]).relative_residual
    0.0
    >>> Certificate.of(problem, [2.5, 0.5]).worst_index
    1
    """

    problem: LCP = field(repr=False)
    z: FloatVector = field(repr=False)

    is_linearised: ClassVar[bool] = (
        False  # whether `problem` is only what a nonlinear one looks like near z
    )

    __setstate__ = restored

    @classmethod
    def of(cls, problem: LCP, z: ArrayLike) -> Certificate:
        """Return the certificate of z, shape (n,), for the problem.

        Raises
        ------
        InvalidProblem
            Where z is no real vector of length n. NaN and infinities are measured, not refused.
        """
        if not isinstance(problem, LCP):
            raise InvalidProblem(refusal("Certificate.of", problem))
        if type(z) is not np.ndarray or z.dtype != np.float64 or z.shape != (problem.n,):
            z = real_vector(z, "z", problem.n)
        else:
            z = read_only(z.copy())
        return cls(problem, z)

    @classmethod
    def enclosed(
        cls, problem: LCP, z: FloatVector, relative_residual: float, term_residual: float
    ) -> Certificate:
        """Return the certificate of a z, shape (n,), whose residuals a kernel has measured in the same way.

        Of a problem whose matrix needs no scaling: kernels know of none.
        """
        certificate = cls(problem, read_only(z))
        certificate.__dict__.update(
            relative_residual=relative_residual, term_residual=term_residual, _scaling=None
        )
        return certificate

    @cached_property
    def w(self) -> FloatVector:
        """The slack M z + q in double precision, shape (n,), read-only."""
        with np.errstate(all="ignore"):
            w: FloatVector = self.problem.matrix.array @ self.z
            w += self.problem.q
        return read_only(w)

    def _largest(self, values: FloatVector) -> float:
        """Return the largest of all rows' values."""
        return _largest(values)

    @cached_property
    def _worst(self) -> tuple[float, int]:
        """The residual that is the largest beside the reference of its component, and its row."""
        several = connected_components(self.problem.matrix)
        with np.errstate(all="ignore"):
            residual = np.abs(scaled_residual(self.problem, self.z, self.w, self._scale))
            relative = self._scaled(residual)
            if (
                several is not None
            ):  # as the relative residual is proved: its component is the one that is named
                relative = over(self._proved_rows, self.references[0][several.labels])
        worst = int(np.argmax(relative)) if relative.size else -1  # argmax stops at the first NaN
        if not relative.size:
            return 0.0, -1
        return float(residual[worst] if self._scaling is None else residual.max()), worst

    @property
    def worst_index(self) -> int:
        """The row of the largest residual beside the reference of its component; −1 for an empty problem."""
        return self._worst[1]

    @property
    def scaled_residual(self) -> float:
        """‖r(z)‖∞ of the worst component, of all in mixed units, in the unit of z, as measured in double precision."""
        return self._worst[0]

    @cached_property
    def relative_residual(self) -> float:
        """The largest ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ of all components, rounded upwards; 0 for 0/0."""
        if np.isinf(self.references[1]).any():
            return np.nan
        return largest_ratio(*self.residuals_of_components)

    @cached_property
    def term_residual(self) -> float:
        """How wrong the worst row is in its own terms."""
        return self._largest(self.term_residuals)

    @cached_property
    def term_residuals(self) -> FloatVector:
        """How wrong each row is in its own terms, shape (n,)."""
        return term_residuals(self.problem, self.z, self.w)

    def term_above(self, small: float) -> float:
        """Return the term residual without the rows whose own residual is at most `small`, in the unit of z."""
        if not small:
            return self.term_residual
        return self._largest(np.where(self._scaled_ends[1] > small, self.term_residuals, 0.0))

    def meets(self, settings: Settings, answered: BoolVector | None = None) -> bool:
        """Return whether z is SOLVED as settings ask for it; the `answered` rows, shape (own,), do not count."""
        goal, least = settings.goal, settings.least_reference
        return bool(
            within(self.relative_above(least, answered), self.term_above(goal * least), goal)
        )

    def answers_program(self, settings: Settings) -> bool | None:
        """Return whether z answers the program that the problem was made from, as that says; None without one."""
        criterion = self.problem.criterion
        if criterion is None or settings.is_on_error or settings.absolute_tolerance:
            return None
        return criterion.is_answered(self.z, settings.tolerance)

    def ends_a_run(self, settings: Settings, answered: BoolVector | None = None) -> bool:
        """Return whether z is SOLVED, and no program left without an answer."""
        return self.meets(settings, answered) and self.answers_program(settings) is not False

    def is_solved(self, settings: Settings) -> bool:
        """Return whether z is SOLVED; where the problem was made from a program, as that says."""
        answers = self.answers_program(settings)
        if answers is None or (answers and settings.tolerance < SMALL):
            return self.meets(settings)
        return answers

    @cached_property
    def _terms(self) -> FloatVector:
        """|M||z| + |q|."""
        return magnitude(self.problem, self.z)

    @property
    def residuals_of_components(self) -> VectorEnds:
        """Upper bounds of ‖r_P(z)‖∞ and lower ones of ‖r_P(z°)‖∞, shape (components,) each."""
        return largest_of_components(self.problem, self._proved_rows), self.references[0]

    @property
    def _proved_rows(self) -> FloatVector:
        """An upper bound of every |r_i|, sharp in components that z° solves: there only what is exactly 0 will do."""
        ends, least = self._scaled(self._scaled_ends[1]), self.references[0]
        several = connected_components(self.problem.matrix)
        of_rows = least if several is None else least[several.labels]
        is_exact = (of_rows == 0.0) & (ends > 0.0) & (ends < np.inf)
        if not is_exact.any():
            return ends
        return np.where(is_exact, self._scaled(self._sharp_ends()), ends)

    def _sharp_ends(self) -> FloatVector:
        return sharp_residual_ends(self.problem, self.z, self._scale)[1]

    @cached_property
    def _scaling(self) -> RowScaling | None:
        """The scaling of the criterion; None where they are the caller's."""
        return RowScaling.of(self.problem)

    @property
    def _scale(self) -> FloatVector:
        """What w is divided by in the residual that SOLVED speaks of."""
        return self.problem.residual_scale if self._scaling is None else self._scaling.scale

    def _scaled(self, residuals: FloatVector) -> FloatVector:
        """Return upper bounds of |r| in the scaling of the criterion."""
        return residuals if self._scaling is None else self._scaling.upwards(residuals)

    @property
    def references(self) -> VectorEnds:
        """Bounds of ‖r_P(z°)‖∞ of each component, shape (components,) each."""
        return references_of_components(self.problem)

    @cached_property
    def _scaled_ends(self) -> tuple[FloatVector, FloatVector]:
        """Bounds of every |r_i|."""
        return self._ends(self._scale)

    def _ends(self, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
        problem = self.problem
        return residual_ends_of(problem.matrix.array, self.z, problem, self.z, scale)

    @cached_property
    def _natural(self) -> FloatVector:
        """An upper bound of every |z − mid(lower, upper, z − w)|."""
        return self._ends(np.ones(self.z.size))[1]

    @cached_property
    def natural_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖∞."""
        return self._largest(self._natural)

    @cached_property
    def euclidean_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖₂, rounded upwards, without overflow."""
        terms, norm = self.problem.n + 8, euclidean_norm(self._natural)
        return float(np.nextafter(norm * (1.0 + gamma(terms)), np.inf)) if norm else norm

    @cached_property
    def bound_violation(self) -> float:
        """max_i of lower_i − z_i, z_i − upper_i and 0."""
        problem = self.problem
        with np.errstate(all="ignore"):
            outside = np.maximum(problem.lower - self.z, self.z - problem.upper)
        return self._largest(np.maximum(outside, 0.0))

    @cached_property
    def _products(self) -> FloatVector:
        """The larger of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over the finite bounds, shape (n,)."""
        problem = self.problem
        with np.errstate(all="ignore"):
            above = np.where(np.isfinite(problem.lower), self.z - problem.lower, 0.0)
            below = np.where(np.isfinite(problem.upper), problem.upper - self.z, 0.0)
            larger = np.maximum(above * np.maximum(self.w, 0.0), below * np.maximum(-self.w, 0.0))
            products: FloatVector = np.abs(larger)
            return products

    @cached_property
    def complementarity(self) -> float:
        """max_i of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over the finite bounds."""
        return self._largest(self._products)

    @cached_property
    def rounding_floor(self) -> FloatVector:
        """What rounding alone can make of each residual: k_i ε (|M||z| + |q|)_i / d_i, shape (n,).

        k_i = nonzeros of row i + 2; below this level a residual in double precision says nothing.
        """
        return rounding_floor(self.problem, self._terms, self._scale)

    @cached_property
    def is_at_rounding_level(self) -> bool:
        """True where no row's residual exceeds four times its rounding floor."""
        is_low = at_rounding_level(self._scaled_ends[1], self.rounding_floor)
        return bool(is_low.all())

    @cached_property
    def is_limited_by_rounding(self) -> bool:
        """True at that level, where the residual is small, or in its component z° is a solution up to rounding.

        Rounding as large as the problem itself is no limit reached, but data or a z out of all proportion.
        """
        if not self.is_at_rounding_level:
            return False
        is_large = ~(over(*self.residuals_of_components) <= GAINED)
        if not is_large.any():
            return True
        return not (is_large & ~hold_at_zero(self.problem)).any()

    def relative_above(self, least: float, answered: BoolVector | None = None) -> float:
        """Return the relative residual with no reference taken for less than `least`, in the caller's unit of z.

        The `answered` rows, shape (own,), do not count.
        """
        if not least and answered is None:
            return self.relative_residual
        rows = self._proved_rows if answered is None else np.where(answered, 0.0, self._proved_rows)
        floors = np.full(self.z.size, least)
        floors = floors if self._scaling is None else self._scaling.downwards(floors)
        references = np.maximum(for_each_row(self.problem, self.references[0]), floors)
        return largest_ratio(rows, references)

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
