"""What residuals are compared with: in each part P of a problem ‖r_P(z°)‖∞; and units in which all parts are alike.

The parts are the connected components of the graph of M. A problem with several is several problems, and each is
judged by its own data: z is within a tolerance where in every part ‖r_P(z)‖∞ ≤ tolerance · ‖r_P(z°)‖∞. With
D = diag(2^k_P), constant on each part, D M D⁻¹ = M exactly: ẑ = D z solves the problem of (M, D q, D lower, D upper)
exactly where z solves that of (M, q, lower, upper), and r̂ = D r. With 2^k_P ‖r_P(z°)‖∞ in [1, 2) for all P one maximum
norm speaks of every part within a factor 2. Where ‖r_P(z°)‖∞ = 0 the answer is z_P = z°_P.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector, read_only
from ..kernels.floats import DATA_ROUNDING
from ..matrix.structure import IntVector, Parts, parts
from ..problem.lcp import LCP
from .row_residuals import at_rounding_level, magnitude, residual_ends_of, rounding_floor, sharp_residual_ends

Ends = tuple[float, float]  # a lower and an upper bound
VectorEnds = tuple[FloatVector, FloatVector]
_references: WeakKeyDictionary[LCP, VectorEnds] = WeakKeyDictionary()
LARGEST_EXPONENT = 1000  # of two, that other units may give a number


def largest_of_parts(problem: LCP, values: FloatVector) -> FloatVector:
    """Return the largest of the values ≥ 0 of each part's rows, shape (parts,); a NaN stays, 0 where there is no row.

    Parameters
    ----------
    values : array, shape (own,)
    """
    several = parts(problem.matrix)
    if several is not None:
        return several.largest(values)
    return np.array([problem.communicator.largest(float(values.max()) if values.size else 0.0)])


def for_each_row(problem: LCP, values: Any) -> Any:
    """Return the value of each own row's part, shape (own,), or (1,) where there is one part."""
    several = parts(problem.matrix)
    return values if several is None else values[several.labels]


def references_of_parts(problem: LCP) -> VectorEnds:
    """Return bounds of ‖r_P(z°)‖∞ of each part, shape (parts,) each; computed once a problem."""
    if problem not in _references:
        z, matrix = problem.nearest_to_zero, problem.matrix
        whole = matrix.whole(z)
        rows = matrix.rows if whole.any() else _no_entries(matrix.own, matrix.width)
        ends = residual_ends_of(rows, whole, problem, z, problem.residual_scale)
        least, most = (largest_of_parts(problem, end) for end in ends)
        is_open = (least == 0.0) & (most > 0.0)  # is z° the answer?
        if not problem.communicator.everywhere(not is_open.any()):
            sharp = [largest_of_parts(problem, end) for end in sharp_residual_ends(problem, z)]
            least, most = np.where(is_open, sharp[0], least), np.where(is_open, sharp[1], most)
        _references[problem] = least, most
    return _references[problem]


def least_reference(least: FloatVector, most: FloatVector) -> float:
    """Return the least of references between these ends that is not 0; ∞ where there is none."""
    return float(np.min(np.where(least > 0.0, least, most), initial=np.inf, where=most > 0.0))


def reference_ends(problem: LCP) -> Ends:
    """Return bounds of ‖r(z°)‖∞ over all parts."""
    least, most = references_of_parts(problem)
    if problem.communicator.is_alone:
        return float(least.max()), float(most.max())
    ends = problem.communicator.all_largest(*(float(end.max(initial=0.0)) for end in (least, most)))
    return ends[0], ends[1]


def reference_residual(problem: LCP) -> float:
    """Return ‖r(z°)‖∞, rounded upwards: what the residuals of a run in common units are compared with on the way."""
    return reference_ends(problem)[1]


def rounding_of_data(problem: LCP) -> float:
    """Return how large a residual may come from rounding of the largest number in q: 2⁻⁴⁴ max_i |q_i|/d_i."""
    with np.errstate(over="ignore"):
        largest = float(np.abs(problem.q / problem.residual_scale).max(initial=0.0))
    return DATA_ROUNDING * problem.communicator.largest(largest)


def _no_entries(rows: int, columns: int) -> sp.csr_array:
    """Return zeros; scipy takes as long for them as a kernel for a small matrix."""
    empty = np.empty(0), np.empty(0, dtype=np.int32), np.zeros(rows + 1, dtype=np.int32)
    return sp.csr_array(empty, shape=(rows, columns))


@dataclass(frozen=True, eq=False)
class CommonUnits:
    """A problem whose parts have units in which their references are alike, and the way back to the caller's.

    Attributes
    ----------
    callers : LCP
        The problem as it was stated.
    problem : LCP
        The same M, with q and the bounds in the common units; the caller's own where these are alike already.
    exponents : array of int, shape (own,), or None
        Binary logarithms of D; None where D = I.
    answered : array of bool, shape (own,), or None
        The rows of parts that z° solves, as far as double precision can tell; None where there are none.
    least : float
        No other reference counts for less than this, in the caller's units.
    """

    callers: LCP
    problem: LCP
    exponents: IntVector | None = None
    answered: BoolVector | None = None
    least: float = 0.0

    @classmethod
    def of(cls, problem: LCP, least: float = 0.0) -> CommonUnits:
        """Return those of a problem; of one part whatever units it has."""
        several = parts(problem.matrix)
        if several is None:
            return cls(problem, problem, least=least)
        most = references_of_parts(problem)[1]
        is_answered = (most == 0.0) | hold_at_zero(problem)
        most = np.maximum(most, least)
        exponents = _exponents(problem, several, np.where(is_answered, 0.0, most))
        answered = is_answered[several.labels]
        has_units, has_answers = (not problem.communicator.everywhere(not rows.any()) for rows in (exponents, answered))
        scaled = _scaled(problem, exponents) if has_units else problem
        units = exponents if has_units else None, read_only(answered) if has_answers else None
        return cls(problem, scaled, *units, least)

    @cached_property
    def references(self) -> VectorEnds:
        """Bounds of ‖r̂_P(z°)‖∞ of each part, shape (parts,) each, raised to `least`; 0 where z° is the answer."""
        least, most = references_of_parts(self.problem)
        if self.least:
            raised, several = np.full(most.size, self.least), parts(self.problem.matrix)
            if several is not None and self.exponents is not None:
                with np.errstate(over="ignore"):
                    raised[several.labels] = np.ldexp(self.least, self.exponents)
            raised = np.where(most > 0.0, raised, 0.0)
            least, most = np.maximum(least, raised), np.maximum(most, raised)
        return self.in_open_parts(least), self.in_open_parts(most)

    def in_open_parts(self, values: FloatVector) -> FloatVector:
        """Return values of parts, shape (parts,), with 0 for those that z° answers."""
        several = parts(self.problem.matrix)
        if several is None or self.answered is None:
            return values
        return np.where(several.largest(self.answered.astype(np.float64)) == 0.0, values, 0.0)

    @cached_property
    def reference(self) -> float:
        """The least of them that is not 0, rounded upwards where there is one part; 0 where z° is the answer."""
        least, most = self.references
        if parts(self.problem.matrix) is None:
            return float(most.max(initial=0.0))
        smallest = -self.problem.communicator.largest(-least_reference(least, most))
        return smallest if smallest < np.inf else 0.0

    @property
    def is_the_callers(self) -> bool:
        """Whether z means the same in both."""
        return self.exponents is None and self.answered is None

    def inward(self, z: FloatVector) -> FloatVector:
        """Return a point of the caller's in the common units, shape (own,); z° where that is the answer.

        So it is where a number overflows: it is far from anything in its part.
        """
        if self.is_the_callers:
            return z
        origin = self.problem.nearest_to_zero
        if z is self.callers.nearest_to_zero:
            return origin
        with np.errstate(all="ignore"):
            scaled = z if self.exponents is None else np.ldexp(z, self.exponents)
        scaled = np.where(np.isinf(scaled) & np.isfinite(z), origin, scaled)
        scaled = np.clip(scaled, self.problem.lower, self.problem.upper)
        return scaled if self.answered is None else np.where(self.answered, origin, scaled)

    def outward(self, z: FloatVector) -> FloatVector:
        """Return a point in the common units in the caller's, shape (own,); z° where that is the answer."""
        if self.is_the_callers:
            return z
        with np.errstate(all="ignore"):
            back = z if self.exponents is None else np.ldexp(z, -self.exponents)
        return back if self.answered is None else np.where(self.answered, self.callers.nearest_to_zero, back)


def hold_at_zero(problem: LCP) -> BoolVector:
    """Return of which parts z° cannot be told from a solution in double precision, shape (parts,).

    In each row r_i(z°) = 0, or w_i is rounding: a narrow box makes r_i small whatever w_i is.
    """
    z, matrix = problem.nearest_to_zero, problem.matrix
    if problem.communicator.everywhere(not z.any()):  # what r(0) is made of is not rounded
        return np.asarray(references_of_parts(problem)[1] == 0.0)
    whole = matrix.whole(z)
    residual = residual_ends_of(matrix.rows, whole, problem, z, problem.residual_scale)[1]
    with np.errstate(all="ignore"):
        floor = rounding_floor(problem, magnitude(problem, whole))
        is_rounding = at_rounding_level(np.abs(problem.slack(z)) / problem.residual_scale, floor)
    is_above = largest_of_parts(problem, ((residual > 0.0) & ~is_rounding).astype(np.float64))
    return np.asarray(is_above == 0.0)


def _scaled(problem: LCP, exponents: IntVector) -> LCP:
    q, lower, upper = (np.ldexp(vector, exponents) for vector in (problem.q, problem.lower, problem.upper))
    scaled = problem.with_q(q, lower=lower, upper=upper)
    scaled.origin = problem.origin
    return scaled


def _exponents(problem: LCP, several: Parts, most: FloatVector) -> IntVector:
    """Return the binary logarithm of each row's unit, shape (own,): 0 where nothing has to be changed.

    Of a part that z° solves only numbers larger than the others' references are made smaller; no number is made larger
    than a double is.
    """
    with np.errstate(all="ignore"):
        sizes = [np.abs(problem.nearest_to_zero), np.abs(problem.q / problem.residual_scale), np.abs(problem.q)]
        sizes += [np.where(np.isinf(bound), 0.0, np.abs(bound)) for bound in (problem.lower, problem.upper)]
        size = several.largest(np.nan_to_num(np.maximum(*sizes[:2]), posinf=np.finfo(float).max))
        largest = several.largest(np.maximum.reduce(sizes[2:]))
    is_open = (most > 0.0) & np.isfinite(most)
    wanted = 1 - np.frexp(most)[1].astype(np.int64)
    ends = np.max(wanted, initial=-(10**6), where=is_open), np.max(-wanted, initial=-(10**6), where=is_open)
    highest, minus_lowest = problem.communicator.all_largest(*map(float, ends))
    if highest == -minus_lowest:  # they are alike
        wanted -= int(highest)
    unit = 1 - int(highest) if highest == -minus_lowest else 1
    smaller = np.minimum(unit - np.frexp(size)[1], 0)
    wanted = np.where(is_open, wanted, np.where(most == 0.0, smaller, 0))
    return np.minimum(wanted, LARGEST_EXPONENT - np.frexp(largest)[1].astype(np.int64))[several.labels]
