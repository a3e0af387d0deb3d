"""How wrong a z is whose parts lie on several ranks: every number is the same on all of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast
from weakref import WeakKeyDictionary

import numpy as np

from ..certificates.residuals import (
    GAINED,
    Certificate,
    Ends,
    euclidean_norm,
    is_large_product,
    ratio_upwards,
    residual_ends_of,
    scaled_residual,
)
from ..checks import FloatVector, read_only
from ..errors import InvalidOption, did_you_mean
from ..exact.rounding import gamma
from ..kernels.floats import EPSILON, TINY
from ..peers.ranks.collective import gathered, largest
from ..problem.lcp import LCP
from ..settings import MEASURES
from .problem import DistributedLCP

_references: WeakKeyDictionary[DistributedLCP, Ends] = WeakKeyDictionary()


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
        least, most_of_reference = reference_ends_of(problem)
        scale = problem.residual_scale
        with np.errstate(all="ignore"):
            own = _OwnRows.at(problem, z)
            maxima = (
                own.scaled_residual, own.proved_residual, own.natural_residual, own.bound_violation,
                own.slack_violation, own.complementarity, own._complementarity_over(most_of_reference),
                own.backward_error, float(not own.is_at_rounding_level),
                scale.max(initial=-np.inf), -scale.min(initial=np.inf),
            )
            worst = problem.first + own.worst_index if own.z.size else -1
            table = gathered(problem.comm, *maxima, own.euclidean_residual, worst)
            scaled, proved, natural, bound, slack, complementarity, product, backward, is_more, most, minus_least = (
                table[:, : len(maxima)].max(axis=0).tolist()
            )
            spread = float(np.divide(most, -minus_least)) if problem.n else 1.0
        is_worst = table[:, 0] == scaled if not np.isnan(scaled) else np.isnan(table[:, 0])
        rows = table[is_worst & (table[:, -1] >= 0.0), -1]
        return cls(
            problem, own.z, own.w, scaled_residual=scaled,
            relative_residual=np.nan if most_of_reference == np.inf else ratio_upwards(proved, least),
            natural_residual=natural, bound_violation=bound,
            euclidean_residual=euclidean_norm(table[:, -2]) * (1.0 + gamma(len(table) + 8)),
            slack_violation=slack, complementarity=complementarity, relative_complementarity=product,
            backward_error=backward,
            worst_index=int(rows[0]) if rows.size else -1,
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
    """The measures of the own rows alone, with the foreign part of z at hand in `whole`."""

    whole: FloatVector
    magnitude: FloatVector

    @classmethod
    def at(cls, problem: DistributedLCP, z: FloatVector) -> _OwnRows:
        """Return the measures of z; all ranks call."""
        own, rows = read_only(np.array(z, dtype=np.float64)), problem.rows.as_csr()
        whole = problem.rows.filled(own).copy()
        magnitude: FloatVector = abs(rows) @ np.abs(whole) + np.abs(problem.q)
        return cls(cast(LCP, problem), own, whole, magnitude)  # q, bounds and scale of the own rows

    @cached_property
    def w(self) -> FloatVector:
        """The own part of the slack."""
        w: FloatVector = self._rows @ self.whole + self.problem.q
        return read_only(w)

    @property
    def _rows(self) -> Any:
        return cast(DistributedLCP, self.problem).rows.as_csr()

    @property
    def proved_residual(self) -> float:
        """An upper bound of the own rows' largest |r_i|."""
        return float(self._scaled_ends[1].max(initial=0.0))

    def _ends(self, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
        return residual_ends_of(self._rows, self.whole, self.problem, self.z, scale)

    @cached_property
    def backward_error(self) -> float:
        residual = np.abs(scaled_residual(self.problem, self.z, self.w))
        size = np.abs(self.z) + self.magnitude / self.problem.residual_scale
        return float(np.where(residual == 0.0, 0.0, residual / size).max(initial=0.0))

    @cached_property
    def rounding_floor(self) -> FloatVector:
        terms = np.diff(self._rows.indptr) + 2
        floor: FloatVector = terms * (EPSILON * self.magnitude + TINY) / self.problem.residual_scale
        return floor


def reference_ends_of(problem: DistributedLCP) -> Ends:
    """Return bounds of ‖r(z°)‖∞ over all ranks, the denominator of the relative residual; all ranks call."""
    if problem not in _references:
        z = problem.nearest_to_zero
        alike, rows = cast(LCP, problem), problem.rows
        ends = residual_ends_of(rows.as_csr(), rows.filled(z), alike, z, problem.residual_scale)
        least, most = largest(problem.comm, *(float(end.max(initial=0.0)) for end in ends))
        _references[problem] = least, most
    return _references[problem]


def reference_residual_of(problem: DistributedLCP) -> float:
    """Return ‖r(z°)‖∞ over all ranks, rounded upwards."""
    return reference_ends_of(problem)[1]


def residual_of(problem: DistributedLCP, z: FloatVector) -> float:
    """Return ‖r(z)‖∞ over all ranks, as measured."""
    with np.errstate(all="ignore"):
        residual = scaled_residual(cast(LCP, problem), z, problem.slack(z))
        own = float(np.abs(residual, out=residual).max(initial=0.0))
    return largest(problem.comm, own)[0]
