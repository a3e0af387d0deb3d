"""How wrong a z is whose parts lie on several ranks: every number is the same on all of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast

import numpy as np

from ..certificates.residuals import (
    GAINED,
    MACHINE_EPSILON,
    MEASURES,
    SMALLEST,
    Certificate,
    euclidean_norm,
    is_large_product,
    ratio,
    scaled_residual,
)
from ..errors import InvalidOption, did_you_mean
from ..problem import LCP, FloatVector
from ..rounding import compensated_product
from .collective import gathered, largest
from .problem import DistributedLCP


@dataclass(frozen=True, eq=False)
class DistributedCertificate:
    """The measures of :class:`lcp_plugin.Certificate`, taken over all ranks on the caller's own rows.

    Attributes
    ----------
    problem : DistributedLCP
    z, w : ndarray, shape (last − first,)
        The own parts of the point and its slack.
    worst_index : int
        The row of the whole problem with the largest scaled residual; −1 for an empty problem.
    is_at_rounding_level : bool
        True where no row's residual exceeds four times its rounding floor.
    scale_spread : float
        The largest residual scale divided by the smallest.
    """

    problem: DistributedLCP = field(repr=False)
    z: FloatVector = field(repr=False)
    w: FloatVector = field(repr=False)
    scaled_residual: float
    relative_residual: float
    natural_residual: float
    euclidean_residual: float
    bound_violation: float
    slack_violation: float
    complementarity: float
    relative_complementarity: float
    backward_error: float
    worst_index: int
    is_at_rounding_level: bool
    scale_spread: float

    @classmethod
    def of(cls, problem: DistributedLCP, z: FloatVector) -> DistributedCertificate:
        """Return the certificate of z, of which each rank gives its own part; all ranks call.

        NaN and infinities are measured, not refused.
        """
        z = problem.own_part(z)
        reference = reference_residual_of(problem)
        scale = problem.residual_scale
        with np.errstate(all="ignore"):
            own = _OwnRows.at(problem, z, reference)
            maxima = (
                own.scaled_residual, own.sure_residual(reference), own.natural_residual, own.bound_violation,
                own.slack_violation, own.complementarity, own._complementarity_over(reference), own.backward_error,
                float(not own.is_at_rounding_level),
                scale.max(initial=-np.inf), -scale.min(initial=np.inf),
            )
            table = gathered(problem.comm, *maxima, own.euclidean_residual, own.worst_index)
            scaled, sure, natural, bound, slack, complementarity, product, backward, is_more, most, minus_least = (
                table[:, : len(maxima)].max(axis=0).tolist()
            )
            spread = float(np.divide(most, -minus_least)) if problem.n else 1.0
        is_worst = table[:, 0] == scaled if not np.isnan(scaled) else np.isnan(table[:, 0])
        worst = table[is_worst & (table[:, -1] >= 0.0), -1]
        return cls(
            problem, own.z, own.w, scaled_residual=scaled, relative_residual=ratio(sure, reference),
            natural_residual=natural, euclidean_residual=euclidean_norm(table[:, -2]), bound_violation=bound,
            slack_violation=slack, complementarity=complementarity, relative_complementarity=product,
            backward_error=backward,
            worst_index=int(worst[0]) if worst.size else -1,
            is_at_rounding_level=not is_more, scale_spread=spread,
        )

    def measured(self, measure: str) -> float:
        """Return the residual of that measure, "relative" or "euclidean" (InvalidOption for another)."""
        if measure not in MEASURES:
            raise InvalidOption(f"measure={measure!r} is not offered{did_you_mean(measure, MEASURES)}")
        return self.relative_residual if measure == "relative" else self.euclidean_residual

    @property
    def large_product(self) -> str:
        """Where complementarity is large though the residual is small, in words; else empty."""
        if not is_large_product(self.relative_complementarity, self.relative_residual):
            return ""
        return "a z_i far from its bound has a w_i that is not 0: large beside the residual"

    @property
    def is_gained(self) -> bool:
        """True where the residual is small beside that of z°, so that rounding may be its limit."""
        return self.relative_residual <= GAINED

    def __str__(self) -> str:
        return Certificate.__str__(self)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class _OwnRows(Certificate):
    """The measures of the own rows alone, with the foreign part of z at hand in `whole`.

    Whether rounding may hide a residual is a question to all rows, so `may_hide` is the answer of all ranks.
    """

    whole: FloatVector
    magnitude: FloatVector
    may_hide: bool

    @classmethod
    def at(cls, problem: DistributedLCP, z: FloatVector, reference: float) -> _OwnRows:
        """Return the measures of z, `worst_index` counted in the whole problem; all ranks call."""
        own, rows = np.array(z, dtype=np.float64), problem.rows.as_csr()
        whole = problem.rows.filled(own).copy()
        w: FloatVector = rows @ whole + problem.q
        magnitude: FloatVector = abs(rows) @ np.abs(whole) + np.abs(problem.q)
        for array in (own, w):
            array.flags.writeable = False
        alike = cast(LCP, problem)  # q, bounds and scale of the own rows
        residual = np.abs(scaled_residual(alike, own, w))
        worst = int(np.argmax(residual)) if own.size else -1
        at = cls(
            alike, own, w, float(residual[worst]) if own.size else 0.0, problem.first + worst if own.size else -1,
            whole, magnitude, False,
        )
        scaled, floor = largest(problem.comm, at.scaled_residual, at.rounding_floor.max(initial=0.0))
        if 0.0 < reference < np.inf and scaled <= GAINED * reference < floor:
            return cls(alike, own, w, at.scaled_residual, at.worst_index, whole, magnitude, True)
        return at

    def _may_hide(self, reference: float) -> bool:
        return self.may_hide

    @property
    def _rows(self) -> Any:
        return cast(DistributedLCP, self.problem).rows.as_csr()

    @cached_property
    def _sure_slack(self) -> FloatVector:
        return self._enclosed_slack if self.may_hide else self.w

    @cached_property
    def _enclosed_slack(self) -> FloatVector:
        value, radius = compensated_product(self._rows, self.whole, self.problem.q)
        return value + np.copysign(radius, value)

    @cached_property
    def backward_error(self) -> float:
        residual = np.abs(scaled_residual(self.problem, self.z, self.w))
        size = np.abs(self.z) + self.magnitude / self.problem.residual_scale
        return float(np.where(residual == 0.0, 0.0, residual / size).max(initial=0.0))

    @cached_property
    def rounding_floor(self) -> FloatVector:
        terms = np.diff(self._rows.indptr) + 2
        floor: FloatVector = terms * (MACHINE_EPSILON * self.magnitude + SMALLEST) / self.problem.residual_scale
        return floor


def reference_residual_of(problem: DistributedLCP) -> float:
    """Return ‖r(z°)‖∞ over all ranks, the denominator of the relative residual."""
    return residual_of(problem, problem.nearest_to_zero)


def residual_of(problem: DistributedLCP, z: FloatVector) -> float:
    """Return ‖r(z)‖∞ over all ranks."""
    with np.errstate(all="ignore"):
        residual = scaled_residual(cast(LCP, problem), z, problem.slack(z))
        own = float(np.abs(residual, out=residual).max(initial=0.0))
    return largest(problem.comm, own)[0]
