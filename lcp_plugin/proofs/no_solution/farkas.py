"""Farkas certificates of inconsistent linear constraints: a linear program finds them, then they are repaired.

The multipliers of HiGHS are not a proof. They are projected to the required signs, rounded to few digits, and solved
for in rational arithmetic; the caller decides which of these vectors is a proof, and with which margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.deadline import is_over, seconds_left
from ...core.matrix.scaling import scale_matrix
from ...systems.equilibration import equilibrating_exponents, power_of_two
from ..exact.linear_systems import MOST_UNKNOWNS, solved_nearby
from ..exact.rational import ZERO, Rational, rational_rows, short
from .linear_constraints import LinearConstraints, without_rounding

AIMS = (0.5, 0.5, 0.5, 0.5, 1.0)  # smallest and largest entries alike, and the largest near 1
NEGLIGIBLE = 1e-12
TIGHT = (1e-9, 1e-7)
LP_TOLERANCE = 1e-9
NORMS = (1e-6, 1e6)  # smallest and largest: entries of one row of the linear program
POLISHES = 2  # the second removes the rounding of the first
MOST_DENSE = 1_000_000  # entries; .1 s
MOST_SHRUNK = 2.0**20  # HiGHS drops coefficients below 1e-9
# times the unit: sizes that a linear program distinguishes from ∞ and from 0
MOST, LEAST = 1e5, 1e-6
ENOUGH = 1e-6  # a tolerance: a proof that excludes it ends the search
CONTRADICTION = 1e-9  # the linear program cannot distinguish less from 0
NEAR_ENOUGH = 0.5  # of the margin predicted by the linear program
KEPT = 0.55  # share of the optimum kept in the search for slack: enough in spite of rounding
SLACK = 0.1  # of the norm of v, for all of its entries together


Multipliers = FloatVector | Sequence[Rational]


@dataclass(frozen=True)
class FarkasAnswer:
    """Optimum and multipliers in the scale of the program."""

    optimum: float
    multipliers: FloatVector


@dataclass(eq=False)
class FarkasProgram:
    """min qᵀy + Σ sup over the bounds of (Mᵀy)_j x_j, y of the signs that a Farkas vector needs, Σ|y_i| weight_i ≤ 1.

    This is the dual of min t over lower ≤ x ≤ upper with every w_i of its sign up to weight_i t. Minus the optimum is
    the least violation that the signs allow, and y proves it. y = 0 is always allowed. If the constraints are feasible,
    the optimum is 0, and its multipliers are a feasible x. Rows and columns are scaled by powers of two first. Parts
    of y are scaled also: v, its nonnegative parts and the multipliers of finite bounds.

    Attributes
    ----------
    unit : float or None
        Divisor of q and the bounds, in the scale of the program; their largest entry by default. With a smaller one,
        entries that are huge relative to it are cut off: the result must be checked, as every result here is.
    pivots : int or None
        A linear program that takes more has no answer.
    """

    constraints: LinearConstraints
    unit: float | None = None
    pivots: int | None = None

    def __post_init__(self) -> None:
        matrix = self.constraints.matrix
        exponents = equilibrating_exponents(without_rounding(matrix), AIMS, 500)
        self.rows, self.columns = (np.ldexp(1.0, side) for side in exponents)
        self.matrix: Any = scale_matrix(matrix, exponents)

    @cached_property
    def sizes(self) -> list[float]:
        """The sizes of offsets and of bounds in the scale of the program, the largest first."""
        asked = self.constraints
        q = (self.rows * asked.q)[asked.needs_rise | asked.needs_fall]
        sizes = np.abs(np.concatenate([q, asked.lower / self.columns, asked.upper / self.columns]))
        return list(map(float, np.unique(sizes[np.isfinite(sizes) & (sizes > 0.0)])[::-1]))

    @cached_property
    def _scaled_unit(self) -> float:
        largest = max(self.sizes, default=0.0) if self.unit is None else self.unit
        return float(0.5 * power_of_two(max(largest, 2.0**-900)))

    def margin_of(self, optimum: float) -> float:
        """Return the margin relative to the reference, as far as an optimum of the program can be trusted."""
        with np.errstate(all="ignore"):
            margin = float(-optimum * self._scaled_unit / np.float64(self.constraints.reference))
        return margin if np.isfinite(margin) else 0.0

    def solve(self) -> FarkasAnswer | None:
        """Return the optimum, or None if it took more pivots or time than there is."""
        form = self._form
        result = linear_program(
            form.cost, form.equations, 0.0, (0.0, None), (form.norm[None, :], [1.0]), self.pivots
        )
        if result is None:
            return None
        return FarkasAnswer(float(result.fun), result.x)

    def proof(self, answer: FarkasAnswer, proven: Callable[[Multipliers], Any]) -> Any:
        """Return the first proof of all x with half the predicted margin, else one with the largest margin, or None.

        A proof within a radius is returned only if no other has been found.

        Parameters
        ----------
        proven : callable
            Gives the proof by a y in the scale of the constraints, or None if that is none.
        """
        wanted, found = NEAR_ENOUGH * self.margin_of(answer.optimum), list[Any]()
        for y in self._tried(answer):
            found += filter(None, [proven(y)])
            is_enough = found and found[-1].radius == math.inf and found[-1].margin >= wanted
            if is_enough or is_over():
                break
        return max(found, key=lambda one: (one.radius == math.inf, one.margin), default=None)

    def polished(self, answer: FarkasAnswer) -> FloatVector:
        """Return the answer's y, shape (m,), with the equalities that a proof needs met to rounding."""
        y = self._form.vector(answer.multipliers)
        return self._polished(y / (np.abs(y).max(initial=0.0) or 1.0))

    def _tried(self, answer: FarkasAnswer) -> Iterator[Multipliers]:
        """Yield vectors near the answer, then near others that leave slack: in all one-sided bounds, then in each."""
        form = self._form
        yield from self.candidates(form.vector(answer.multipliers))
        is_open = np.isinf(self.constraints.lower) != np.isinf(self.constraints.upper)
        shares = np.append(np.zeros(form.m), is_open)[form.place]
        own = sp.eye_array(form.cost.size, format="csr")
        for slacks in (sp.csr_array(shares[:, None]), own) if shares.any() else (own,):
            moved = self._with_slack(answer, slacks)
            if moved is not None:
                yield from self.candidates(form.vector(moved))

    def _with_slack(self, answer: FarkasAnswer, slacks: sp.csr_array) -> FloatVector | None:
        """Return v ≥ slacks · t that keeps about half of the optimum, Σt as large as can be; None if that is nothing.

        A vertex has as few positive multipliers as it can: if the coefficients carry rounding errors, those may
        vanish only together, and proofs with rounding margins require slack in all inequalities.
        """
        form = self._form
        size, count = slacks.shape
        both = sp.hstack([sp.eye_array(size), slacks], format="csc")  # v = the rest + slacks · t
        largest = SLACK * size / (count * form.norm.sum())
        result = linear_program(
            np.repeat([0.0, -1.0], [size, count]),
            form.equations @ both,
            0.0,
            np.repeat([[0.0, np.inf], [0.0, largest]], [size, count], axis=0),
            (np.stack([form.norm, form.cost]) @ both, [1.0, KEPT * answer.optimum]),
            self.pivots,
        )
        return None if result is None or result.fun > -LP_TOLERANCE else np.asarray(both @ result.x)

    @cached_property
    def _form(self) -> _StandardForm:
        """The program in nonnegative parts of y and multipliers of finite bounds."""
        asked, unit, (m, n) = self.constraints, self._scaled_unit, self.matrix.shape
        kinds = [
            np.flatnonzero(kind)
            for kind in (
                asked.needs_rise,
                asked.needs_fall,
                np.isfinite(asked.upper),
                np.isfinite(asked.lower),
            )
        ]
        q, weights = self.rows * asked.q, self.rows * asked.weights
        values = q, q, asked.upper / self.columns, asked.lower / self.columns
        units = (
            weights,
            weights,
            *(weight / self.columns for weight in reversed(asked.bound_weights)),
        )
        cost, norm = (
            np.concatenate([v[k] for v, k in zip(side, kinds, strict=True)])
            for side in (values, units)
        )
        place = np.concatenate([*kinds[:2], m + kinds[2], m + kinds[3]])
        scale = 2.0 / power_of_two(np.clip(norm, 1.0, MOST_SHRUNK))
        signed = np.repeat([1.0, -1.0, 1.0, -1.0], [kind.size for kind in kinds]) * scale
        equations = sp.csc_array(
            sp.hstack([self.matrix.T, -sp.eye_array(n)], format="csc")[:, place]
        )
        equations.data *= np.repeat(signed, np.diff(equations.indptr))
        norm = np.where(norm > 0.0, np.clip(scale * norm, *NORMS), 0.0)
        cost = signed * cost
        cost = np.where(np.isinf(cost), cost, np.clip(cost / unit, -MOST, MOST))
        return _StandardForm(m, place, signed, cost, equations, norm)

    def candidates(self, y: FloatVector) -> Iterator[Multipliers]:
        """Yield vectors near a y in the scale of the program that may be Farkas vectors of the constraints themselves.

        First with corrected signs and without negligible entries, then rounded to few digits, then from a linear solve.
        """
        y = np.where(np.abs(y) <= 1e-14 * np.abs(y).max(initial=0.0), 0.0, y)
        asked = self.constraints
        y = np.clip(
            y, np.where(asked.needs_fall, -np.inf, 0.0), np.where(asked.needs_rise, np.inf, 0.0)
        )
        if not y.any():
            return
        y = y / np.abs(y).max()
        unscaled = y * self.rows
        yield unscaled / np.abs(unscaled).max()
        kept = np.flatnonzero(np.abs(y) > NEGLIGIBLE).tolist()
        for base in dict.fromkeys((1.0, float(np.abs(y[kept]).min()))):
            for denominator in (1, 100, 100_000):  # multipliers of stated models are short
                near = {
                    i: Fraction(float(y[i]) / base).limit_denominator(denominator) for i in kept
                }
                if any(near.values()):
                    yield self._unscaled(near)
        for tight in TIGHT:
            repaired = self._repaired(y, tight)
            if repaired is not None:
                yield self._unscaled(repaired)
        yield self._polished(y)

    def _polished(self, y: FloatVector) -> FloatVector:
        """Return a vector near y that satisfies to rounding the equalities which y satisfies without slack.

        Dependent equalities become independent by rounding: singular values at rounding level count as 0.
        """
        support, tight = self._tight(y, TIGHT[-1])
        if support.size * tight.size <= MOST_DENSE:
            rows = self.matrix.T.tocsr()[tight][:, support].toarray()
            for _ in range(POLISHES):
                y = y.copy()
                y[support] -= np.linalg.lstsq(rows, rows @ y[support], rcond=NEGLIGIBLE)[0]
        unscaled: FloatVector = y * self.rows
        return unscaled

    def _unscaled(self, entries: dict[int, Fraction]) -> list[Fraction]:
        y = [ZERO] * self.rows.size
        for i, value in entries.items():
            y[i] = value * Fraction(float(self.rows[i]))
        return y

    def _repaired(self, y: FloatVector, tight: float) -> dict[int, Fraction] | None:
        """Return a vector near y that satisfies exactly the (in)equalities which y satisfies without slack."""
        support, equalities = self._tight(y, tight)
        if min(support.size, equalities.size) > MOST_UNKNOWNS:
            return None
        columns = rational_rows(self.matrix.T.tocsr()[equalities][:, support])
        # Any nearby value will do: short ones keep the exact solve short.
        exact = solved_nearby(
            columns, [ZERO] * len(columns), short(y[support], 1 << 50), [True] * support.size
        )
        return None if exact is None else dict(zip(support.tolist(), exact, strict=True))

    def _tight(self, y: FloatVector, tight: float) -> tuple[Any, Any]:
        """Return the indices of nonzero y, and the open columns at which Mᵀy has no slack."""
        size = abs(self.matrix).T @ np.abs(y)
        is_unbounded = np.isinf(self.constraints.lower) | np.isinf(self.constraints.upper)
        is_tight = is_unbounded & (np.abs(self.matrix.T @ y) <= tight * size) & (size > 0.0)
        return np.flatnonzero(np.abs(y) > tight), np.flatnonzero(is_tight)


@dataclass(frozen=True)
class _StandardForm:
    """min costᵀv, equations · v = 0, norm · v ≤ 1, v ≥ 0.

    Attributes
    ----------
    m : int
        Number of requested rows.
    place : array of int
        The row that each entry of v is a part of the multiplier of, or m + the unknown with that bound.
    signed : array
        Factor of v in each part.
    """

    m: int
    place: Any
    signed: FloatVector
    cost: FloatVector
    equations: Any
    norm: FloatVector

    def vector(self, v: FloatVector) -> FloatVector:
        """Return y, shape (m,)."""
        y: FloatVector = np.bincount(self.place, self.signed * v, self.m)[: self.m].astype(
            np.float64
        )
        return y


def best_proof(
    stated: Callable[[float], LinearConstraints],
    units: Sequence[float],
    proven: Callable[[Multipliers], Any],
    *,
    exactly: bool = True,
    pivots: int | None = None,
) -> Any:
    """Return the first proof that excludes the tolerance 1e-6, else the proof of the largest margin, or None.

    Parameters
    ----------
    stated : callable
        Gives the constraints with the weights of a unit.
    units : sequence of float
        Units of offsets and bounds: the linear program cannot distinguish 1e-6 of a unit from 0, and truncates 1e5.
    """
    found, tried = list[Any](), list[float]()
    for unit in units:
        if any(LEAST * one <= unit <= MOST * one for one in tried):
            continue
        tried.append(unit)
        farkas = FarkasProgram(stated(unit), unit, pivots)
        answer = farkas.solve()
        if answer is None or answer.optimum > -CONTRADICTION:  # they seem consistent
            continue
        proof = None if exactly else proven(farkas.polished(answer))
        if proof is None or not proof.excludes(ENOUGH):
            proof = farkas.proof(answer, proven)
        if proof is not None:
            found.append(proof)
            if proof.excludes(ENOUGH):
                break
        if is_over():
            break
    return max(found, key=lambda proof: proof.margin, default=None)


def linear_program(
    cost: FloatVector,
    equations: Any,
    right: FloatVector | float,
    bounds: Any,
    at_most: tuple[Any, Any],
    pivots: int | None = None,
) -> Any:
    """Return HiGHS's result of min costᵀv, equations · v = right, rows · v ≤ limits; None if it has no optimum.

    Parameters
    ----------
    bounds : one pair, or a sequence of pairs
        Bounds of v.
    at_most : pair
        Rows and limits.
    pivots : int, optional
        Largest number of pivots; the time limit of a run also holds.
    """
    from scipy.optimize import linprog

    if not cost.size or not np.isfinite(cost).all() or not np.isfinite(equations.data).all():
        return None
    options: dict[str, Any] = {
        "presolve": True,
        "primal_feasibility_tolerance": LP_TOLERANCE,
        "dual_feasibility_tolerance": LP_TOLERANCE,
    }
    if pivots is not None:
        options["maxiter"] = pivots
    if math.isfinite(left := seconds_left()):
        options["time_limit"] = left
    result = linprog(
        cost,
        A_ub=at_most[0],
        b_ub=at_most[1],
        A_eq=equations,
        b_eq=np.broadcast_to(right, equations.shape[0]),
        bounds=bounds,
        method="highs",
        options=options,
    )
    return result if result.status == 0 else None
