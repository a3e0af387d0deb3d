"""What SOLVED asks for: small residuals in each connected component of M, after scaling.

With the scaling R, C of :mod:`lcp_plugin.core.matrix.scaling`, M̂ = R M C, q̂ = R q, ẑ = C⁻¹z, bounds likewise, and in
each connected component P of the graph of M,

    |r̂_i(z)| ≤ tolerance · ‖r̂_P(z°)‖∞ for each row i of P,  r̂_i = ẑ_i − mid(l̂_i, û_i, ẑ_i − ŵ_i / d̂_i),

or |r_i| ≤ absolute tolerance, in the caller's unit of z_i; and every row is right in its own terms to √tolerance, in
the caller's units (:mod:`lcp_plugin.core.certificates.own_terms`).

In the caller's units r̂_i is r_i, with d̂_i / 2^(row_i + column_i) for d_i, times the *weight* 2^−column_i: this is how
a certificate computes it, on the caller's data. A run works on the scaled problem, or, where its algorithm
wants to see the caller's matrix, on that. In both 2^k_P is chosen for each component, so that 2^k_P ‖r̂_P(z°)‖∞ lies in
[1, 2) for all P: D M̂ D⁻¹ = M̂ for D = diag(2^k_P), and one maximum norm speaks of every component within a factor 2.
Where ‖r̂_P(z°)‖∞ = 0 the answer is z_P = z°_P. Where one falls into several components of the graph of rows and
columns (zero diagonals: games, linear programs), M̂ leaves the unit of each open, and q̂ at z° decides: its largest
entry in the rows of each lies in [½, 1). Where it is 0 in all of them, nothing does.

What it does not see: other units where M needs no scaling (entries within 2¹⁰, none beyond 2⁴ times its diagonal entry,
a factor of 2⁸ between unknowns, a row of zeros: such keep the units they are given in), and jumps in mixed units, whose
stiff part counts more than its share. The scaling is found to a few powers of two, not to one, so that beside the same
M in other units the residual may differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from ..checks import BoolVector, FloatVector, read_only
from ..kernels.floats import DATA_ROUNDING, EPSILON, LARGEST, TINY
from ..lcp import LCP
from ..matrix.matrix import Matrix, fact
from ..matrix.scaling import Scaling, is_representable, scaling_of, times_power
from ..matrix.structure import Components, IntVector, connected_components
from .row_residuals import (
    at_rounding_level,
    magnitude,
    measured_residual,
    residual_ends_of,
    rounding_floor,
    scaled_residual,
    sharp_residual_ends,
)

if TYPE_CHECKING:
    from ..algorithm import Step
    from ..policy.stages import Choice

VectorEnds = tuple[FloatVector, FloatVector]  # lower and upper bounds
SMALLEST_NORMAL = float(np.finfo(np.float64).tiny)
LARGEST_EXPONENT = 1000  # of two, that other units may give a number


class RowScaling(NamedTuple):
    """How the criterion scales rows of the caller's.

    Attributes
    ----------
    row, column : array of int, shape (n,)
        ŵ_i = 2^row_i w_i and ẑ_i = 2^−column_i z_i.
    scale : array, shape (n,)
        What w_i is divided by in r_i.
    matrix : Matrix
        M̂.
    """

    row: IntVector
    column: IntVector
    scale: FloatVector
    matrix: Matrix

    @classmethod
    def of(cls, problem: LCP) -> RowScaling | None:
        """Return that of a problem; None where it needs none, or where its origin has a criterion of its own."""
        return (
            None
            if problem.criterion is not None or scaling_of(problem.matrix) is None
            else _row_scaling(problem)
        )

    def upwards(self, residuals: FloatVector) -> FloatVector:
        """Return residuals ≥ 0 in the scaling of the criterion, no smaller, shape (n,)."""
        weighted = times_power(residuals, -self.column)
        return np.where((weighted < SMALLEST_NORMAL) & (residuals > 0.0), weighted + TINY, weighted)

    def downwards(self, residuals: FloatVector) -> FloatVector:
        """Return the same, no larger."""
        weighted = times_power(residuals, -self.column)
        return np.where(weighted < SMALLEST_NORMAL, np.maximum(weighted - TINY, 0.0), weighted)


@fact
def _row_scaling(problem: LCP) -> RowScaling:
    """Return the scaling of M, and by q that of blocks of which a component of M has several."""
    scaling = cast(Scaling, scaling_of(problem.matrix))
    row, column, scale = scaling.row, scaling.column, scaling.scale
    if np.array_equal(scaling.of_row, scaling.of_column):
        return RowScaling(row, column, scale, scaling.matrix)
    with np.errstate(all="ignore"):
        slack = np.ldexp(np.abs(problem.slack(problem.nearest_to_zero)), row)
    largest = np.zeros(2 * problem.n)
    np.maximum.at(largest, scaling.of_row, np.where(np.isfinite(slack), slack, 0.0))
    shift = np.where(largest > 0.0, -np.frexp(largest)[1], 0).astype(np.int64)
    has_scaling = np.maximum(np.abs(scaling.row), np.abs(scaling.column)).astype(np.float64)
    is_open = for_each_row(problem, largest_of_components(problem, has_scaling)) > 0.0
    of_row, of_column = (
        np.where(is_open, shift[side], 0) for side in (scaling.of_row, scaling.of_column)
    )
    shifted = times_power(scale, of_column - of_row)
    if is_representable(shifted):
        row, column, scale = row + of_row, column - of_column, read_only(shifted)
    return RowScaling(row, column, scale, scaling.matrix)


def within(relative_residual: Any, term_residual: Any, tolerance: float) -> Any:
    """Return whether what was measured is SOLVED: of one problem, or, by arrays of shape (k,), of those of a batch.

    Parameters
    ----------
    relative_residual : float or array, shape (k,)
        The largest of all components' residuals beside their references, rounded upwards; a NaN is not SOLVED.
    term_residual : float or array, shape (k,)
        How wrong the worst row is in its own terms.
    tolerance : float

    Examples
    --------
    >>> within(np.array([1e-9, 1e-9, np.nan]), np.array([0.0, 1e-3, 0.0]), 1e-8)
    array([ True, False, False])
    """
    return (relative_residual <= tolerance) & (term_residual <= tolerance)


def residual_scale_of_criterion(problem: LCP) -> FloatVector:
    """Return what w is divided by in the residual that SOLVED speaks of, shape (n,)."""
    scaling = RowScaling.of(problem)
    return problem.residual_scale if scaling is None else scaling.scale


def largest_of_components(problem: LCP, values: FloatVector) -> FloatVector:
    """Return the largest of the values ≥ 0 of each component's rows, shape (components,); a NaN stays, 0 without rows.

    Parameters
    ----------
    values : array, shape (n,)
    """
    several = connected_components(problem.matrix)
    if several is not None:
        return several.largest(values)
    of_all = float(values.max()) if values.size else 0.0  # values may be negative
    return np.array([of_all])


def for_each_row(problem: LCP, values: Any) -> Any:
    """Return the value of each own row's component, shape (n,), or (1,) where there is one component."""
    several = connected_components(problem.matrix)
    return values if several is None else values[several.labels]


def references_of_components(problem: LCP) -> VectorEnds:
    """Return bounds of ‖r̂_P(z°)‖∞ of each component, shape (components,) each."""
    return _references(problem, RowScaling.of(problem) is not None)


def own_references(problem: LCP) -> VectorEnds:
    """Return bounds of ‖r_P(z°)‖∞ in the problem's own units, as a run on it has them."""
    return _references(problem, False)


@fact
def _references(problem: LCP, is_scaled: bool) -> VectorEnds:
    scaling = RowScaling.of(problem) if is_scaled else None
    scale = problem.residual_scale if scaling is None else scaling.scale
    z, matrix = problem.nearest_to_zero, problem.matrix

    def of_components(ends: VectorEnds) -> tuple[FloatVector, ...]:
        weighted = (
            ends if scaling is None else (scaling.downwards(ends[0]), scaling.upwards(ends[1]))
        )
        return tuple(largest_of_components(problem, end) for end in weighted)

    least, most = of_components(residual_ends_of(matrix.array, z, problem, z, scale))
    is_open = (least == 0.0) & (most > 0.0)  # is z° the answer?
    if is_open.any():
        sharp = of_components(sharp_residual_ends(problem, z, scale))
        least, most = np.where(is_open, sharp[0], least), np.where(is_open, sharp[1], most)
    return least, most


def least_reference(least: FloatVector, most: FloatVector) -> float:
    """Return the least of references between these ends that is not 0; ∞ where there is none."""
    return float(np.min(np.where(least > 0.0, least, most), initial=np.inf, where=most > 0.0))


def beside_the_largest(least: FloatVector, most: FloatVector, tolerance: float) -> float:
    """Return the tolerance beside the largest reference that means this one beside the least, all between these ends.

    Parameters
    ----------
    least, most : arrays, shape (components,)
    tolerance : float
    """
    largest = float(most.max(initial=0.0))
    if not largest > 0.0 or least.size == 1:
        return tolerance
    return tolerance * (least_reference(least, most) / largest) * (1.0 - 4.0 * EPSILON)


def reference_residual(problem: LCP) -> float:
    """Return ‖r(z°)‖∞ in the problem's own units, rounded upwards: what a run compares residuals with on the way."""
    return float(own_references(problem)[1].max(initial=0.0))


def measured_scaled_residual(problem: LCP, z: FloatVector) -> float:
    """Return ‖r̂(z)‖∞ over all components as double precision gives it."""
    scaling = RowScaling.of(problem)
    if scaling is None:
        return measured_residual(problem, z)
    with np.errstate(all="ignore"):
        residual = np.abs(scaled_residual(problem, z, problem.slack(z), scaling.scale))
    return float(scaling.upwards(residual).max(initial=0.0))


def rounding_of_data(problem: LCP) -> float:
    """Return how large a residual may come from rounding of the largest number in q: 2⁻⁴⁴ max_i |q̂_i|/d̂_i.

    What is beyond the range of doubles counts as the largest of them: no residual that is so as well is explained.
    """
    scaling = RowScaling.of(problem)
    with np.errstate(over="ignore"):
        sizes = np.abs(problem.q / residual_scale_of_criterion(problem))
    sizes = times_power(sizes, None if scaling is None else -scaling.column)
    return DATA_ROUNDING * min(float(sizes.max(initial=0.0)), LARGEST)


@dataclass(frozen=True, eq=False)
class CommonScaling:
    """A problem in the scaling of the criterion, references of components alike, and the way back to the caller's.

    Attributes
    ----------
    stated : LCP
        The problem as it was stated.
    problem : LCP
        What a run works on: M̂ with q and the bounds in these units; the caller's own where nothing changes.
    exponents : array of int, shape (n,), or None
        ẑ_i = 2^exponents_i z_i; None where ẑ = z.
    row_exponents : array of int, shape (n,), or None
        ŵ_i = 2^row_exponents_i w_i.
    answered : array of bool, shape (n,), or None
        The rows of components that z° solves, as far as double precision can tell; None where there are none.
    least : float
        No other reference counts for less than this, in the caller's units.
    is_scaled : bool
        Whether the run's matrix is M̂, another than the caller's.
    """

    stated: LCP
    problem: LCP
    exponents: IntVector | None = None
    row_exponents: IntVector | None = None
    answered: BoolVector | None = None
    least: float = 0.0
    is_scaled: bool = False

    @classmethod
    def of(cls, problem: LCP, least: float = 0.0) -> CommonScaling:
        """Return those of a problem; where a number would overflow in them, the problem's own."""
        return cls._in(RowScaling.of(problem), problem, least)

    @classmethod
    def _in(cls, scaling: RowScaling | None, problem: LCP, least: float) -> CommonScaling:
        several = connected_components(problem.matrix)
        run, columns, rows = problem, None, None
        if scaling is not None:
            balanced = _scaled(problem, scaling.row, -scaling.column, scaling.matrix)
            if balanced is not None:
                run, columns, rows = balanced, -scaling.column, scaling.row
        is_scaled = run is not problem
        if several is None:
            return cls(problem, run, columns, rows, None, least, is_scaled)
        most = own_references(run)[1]
        is_answered = (most == 0.0) | hold_at_zero(problem)
        if not is_scaled:
            most = np.maximum(most, least)
        exponents = _exponents(run, several, np.where(is_answered, 0.0, most))
        answered = is_answered[several.labels]
        has_scaling, has_answers = (np.any(side) for side in (exponents, answered))
        if has_scaling and (alike := _scaled(run, exponents, exponents, run.matrix)) is not None:
            run, columns, rows = (
                alike,
                *(exponents if side is None else side + exponents for side in (columns, rows)),
            )
        return cls(
            problem,
            run,
            columns,
            rows,
            read_only(answered) if has_answers else None,
            least,
            is_scaled,
        )

    @cached_property
    def references(self) -> VectorEnds:
        """Bounds of ‖r̂_P(z°)‖∞ of each component, raised to `least`, shape (components,) each; 0 where z° answers."""
        least, most = own_references(self.problem)
        if self.least:
            of_rows = times_power(np.full(self.stated.q.size, self.least), self.exponents)
            raised = np.where(most > 0.0, largest_of_components(self.problem, of_rows), 0.0)
            least, most = np.maximum(least, raised), np.maximum(most, raised)
        return self.in_open_components(least), self.in_open_components(most)

    def in_open_components(self, values: FloatVector) -> FloatVector:
        """Return values of components, shape (components,), with 0 for those that z° answers."""
        several = connected_components(self.problem.matrix)
        if several is None or self.answered is None:
            return values
        return np.where(several.largest(self.answered.astype(np.float64)) == 0.0, values, 0.0)

    @cached_property
    def reference(self) -> float:
        """The least of them that is not 0, rounded upwards where there is one component; 0 where z° is the answer."""
        least, most = self.references
        if connected_components(self.problem.matrix) is None:
            return float(most.max(initial=0.0))
        smallest = least_reference(least, most)
        return smallest if smallest < np.inf else 0.0

    @property
    def is_connected(self) -> bool:
        """Whether all rows have one reference."""
        return connected_components(self.problem.matrix) is None

    def beside_the_largest(self, tolerance: float) -> float:
        """Return the tolerance beside the largest of all references that means this one beside the least."""
        if self.least and self.reference > 0.0:
            share = self.reference / reference_residual(self.problem)
            return tolerance * share * (1.0 if self.is_connected else 1.0 - 4.0 * EPSILON)
        return tolerance if self.is_connected else beside_the_largest(*self.references, tolerance)

    @cached_property
    def of_caller(self) -> CommonScaling:
        """The same on the caller's matrix; itself where M needs no scaling."""
        return self._in(None, self.stated, self.least) if self.is_scaled else self

    def steps(self, choice: Choice, z: FloatVector) -> Iterator[Step]:
        """Yield the steps of a choice from z in this scaling, taken where its algorithm wants to take them."""
        here = self.of_caller
        if here is self or choice.algorithm.takes_scaled:
            yield from choice.iterates(self.problem, z)
            return
        for step in choice.iterates(here.problem, here.inward(self.outward(z))):
            at, is_measured = self.inward(here.outward(step.z)), step.residual is not None
            residual = (
                measured_residual(self.problem, at) if is_measured else None
            )  # the criterion's own
            yield replace(step, z=at, residual=residual, work=step.work + is_measured)

    @property
    def row_factors(self) -> list[Fraction] | None:
        """What the rows' multipliers of a proof in this scaling are multiplied by in the caller's; None where by 1."""
        if self.row_exponents is None:
            return None
        return [Fraction(2) ** k for k in self.row_exponents.tolist()]

    @property
    def is_identity(self) -> bool:
        """Whether z means the same in both."""
        return self.exponents is None and self.answered is None

    def inward(self, z: FloatVector) -> FloatVector:
        """Return a point of the caller's in the common scaling, shape (n,); z° where that is the answer.

        So it is where a number overflows: it is far from anything in its component.
        """
        if self.is_identity:
            return z
        origin = self.problem.nearest_to_zero
        if z is self.stated.nearest_to_zero:
            return origin
        scaled = times_power(z, self.exponents)
        scaled = np.where(np.isinf(scaled) & np.isfinite(z), origin, scaled)
        scaled = np.clip(scaled, self.problem.lower, self.problem.upper)
        return scaled if self.answered is None else np.where(self.answered, origin, scaled)

    def outward(self, z: FloatVector) -> FloatVector:
        """Return a point in the common scaling in the caller's, shape (n,); z° where that is the answer."""
        if self.is_identity:
            return z
        back = times_power(z, None if self.exponents is None else -self.exponents)
        return (
            back
            if self.answered is None
            else np.where(self.answered, self.stated.nearest_to_zero, back)
        )


def hold_at_zero(problem: LCP) -> BoolVector:
    """Return in which components z° is a solution up to rounding, shape (components,).

    In each row r_i(z°) = 0, or w_i is rounding: a narrow box makes r_i small whatever w_i is.
    """
    z, matrix = problem.nearest_to_zero, problem.matrix
    if not z.any():  # what r(0) is made of is not rounded
        return np.asarray(references_of_components(problem)[1] == 0.0)
    residual = residual_ends_of(matrix.array, z, problem, z, problem.residual_scale)[1]
    with np.errstate(all="ignore"):
        floor = rounding_floor(problem, magnitude(problem, z), problem.residual_scale)
        is_rounding = at_rounding_level(np.abs(problem.slack(z)) / problem.residual_scale, floor)
    is_above = largest_of_components(problem, ((residual > 0.0) & ~is_rounding).astype(np.float64))
    return np.asarray(is_above == 0.0)


def _scaled(problem: LCP, row: IntVector, of_z: IntVector, matrix: Matrix) -> LCP | None:
    """Return the problem with 2^row q and bounds 2^of_z times theirs; None where one of them overflows."""
    q, lower, upper = (
        times_power(problem.q, row),
        times_power(problem.lower, of_z),
        times_power(problem.upper, of_z),
    )
    is_whole = bool(np.isfinite(q).all())
    for new, old in ((lower, problem.lower), (upper, problem.upper)):
        is_whole &= bool(np.array_equal(np.isinf(new), np.isinf(old)))
    if not is_whole:
        return None
    scaled = LCP(matrix, q)
    scaled.lower, scaled.upper = read_only(lower), read_only(upper)  # checked, in the caller's unit
    scaled.origin, scaled.criterion = problem.origin, problem.criterion
    return scaled


def _exponents(problem: LCP, several: Components, most: FloatVector) -> IntVector:
    """Return the binary logarithm of each row's unit, shape (n,): 0 where nothing has to be changed.

    Of a component that z° solves only numbers larger than the others' references are made smaller; no number is made
    larger than a double is.
    """
    with np.errstate(all="ignore"):
        sizes = [
            np.abs(problem.nearest_to_zero),
            np.abs(problem.q / problem.residual_scale),
            np.abs(problem.q),
        ]
        sizes += [
            np.where(np.isinf(bound), 0.0, np.abs(bound))
            for bound in (problem.lower, problem.upper)
        ]
        size = several.largest(np.nan_to_num(np.maximum(*sizes[:2]), posinf=np.finfo(float).max))
        largest = several.largest(np.maximum.reduce(sizes[2:]))
    is_open = (most > 0.0) & np.isfinite(most)
    wanted = 1 - np.frexp(most)[1].astype(np.int64)
    ends = (
        np.max(wanted, initial=-(10**6), where=is_open),
        np.max(-wanted, initial=-(10**6), where=is_open),
    )
    highest, minus_lowest = ends
    if highest == -minus_lowest:  # they are alike
        wanted -= int(highest)
    unit = 1 - int(highest) if highest == -minus_lowest else 1
    smaller = np.minimum(unit - np.frexp(size)[1], 0)
    wanted = np.where(is_open, wanted, np.where(most == 0.0, smaller, 0))
    return np.minimum(wanted, LARGEST_EXPONENT - np.frexp(largest)[1].astype(np.int64))[
        several.labels
    ]
