"""How wrong a z is whose parts lie on several ranks: every number is the same on all of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..certificates.residuals import (
    GAINED,
    MEASURES,
    Certificate,
    euclidean_norm,
    ratio,
    scaled_residual,
)
from ..errors import InvalidOption, did_you_mean
from ..problem import FloatVector
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
    backward_error: float
    worst_index: int
    is_at_rounding_level: bool
    scale_spread: float

    @classmethod
    def of(cls, problem: DistributedLCP, z: FloatVector) -> DistributedCertificate:
        """Return the certificate of z, of which each rank gives its own part; all ranks call."""
        local, whole = problem.at(z)
        own = Certificate.of(local, whole)  # a foreign unknown solves its own equation: it adds nothing to any measure
        scale, reference = problem.residual_scale, reference_residual_of(problem)
        table = gathered(
            problem.comm,
            own.scaled_residual, own.sure_residual(reference), own.natural_residual, own.bound_violation,
            own.slack_violation, own.complementarity, own.backward_error, not own.is_at_rounding_level,
            scale.max(initial=0.0), -scale.min(initial=np.inf), problem.first + own.worst_index, own.euclidean_residual,
        )
        scaled, sure, natural, bound, slack, complementarity, backward, is_more, most, least, *_ = table.max(axis=0)
        w = own.w[: z.size]
        w.flags.writeable = False
        with np.errstate(all="ignore"):
            spread = float(np.divide(most, -least)) if problem.n else 1.0
        return cls(
            problem, z, w, scaled_residual=float(scaled), relative_residual=ratio(float(sure), reference),
            natural_residual=float(natural), euclidean_residual=euclidean_norm(table[:, -1]),
            bound_violation=float(bound), slack_violation=float(slack), complementarity=float(complementarity),
            backward_error=float(backward), is_at_rounding_level=not is_more, scale_spread=spread,
            worst_index=int(table[int(np.argmax(table[:, 0])), -2]) if problem.n else -1,
        )

    def measured(self, measure: str) -> float:
        """Return the residual of that measure, "relative" or "euclidean" (InvalidOption for another)."""
        if measure not in MEASURES:
            raise InvalidOption(f"measure={measure!r} is not offered{did_you_mean(measure, MEASURES)}")
        return self.relative_residual if measure == "relative" else self.euclidean_residual

    @property
    def is_gained(self) -> bool:
        """True where the residual is small beside that of z°, so that rounding may be its limit."""
        return self.relative_residual <= GAINED

    def __str__(self) -> str:
        return Certificate.__str__(self)  # type: ignore[arg-type]


def reference_residual_of(problem: DistributedLCP) -> float:
    """Return ‖r(z°)‖∞ over all ranks, the denominator of the relative residual."""
    return residual_of(problem, problem.nearest_to_zero)


def residual_of(problem: DistributedLCP, z: FloatVector) -> float:
    """Return ‖r(z)‖∞ over all ranks."""
    with np.errstate(all="ignore"):
        residual = scaled_residual(problem, z, problem.slack(z))  # type: ignore[arg-type]
        own = float(np.abs(residual, out=residual).max(initial=0.0))
    return largest(problem.comm, own)[0]
