"""Contacts whose friction cones are pyramids, as cones of three unknowns each: the LCP's answer from theirs.

With m edges a contact the LCP of :mod:`lcp_plugin.problems.contact` has m + 2 unknowns where the impulse has three. In
De Saxcé's form, K ∋ r ⟂ û ∈ K*, û = u + μ max_d (−dᵀu_T) e_N with the pyramid for K, it is the problem of exact cones,
and kernels take both. Back from r: β on the two edges beside r_T, λ = max_d (−dᵀu_T).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np

from ...core.algorithm import Algorithm, Step
from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.rounding import read_only_views
from ...core.settings import Settings
from .data import Blocks
from .methods import NPGS, SWEEPS_A_STEP, Newton
from .small import LARGEST, run_loop

ACCURATE = Settings(tolerance=1e-9)  # the last steps of Newton's method make exact what is so near
ROUNDING = 2.0**-40  # of the largest impulse of friction, between it and one that slides
SWEEPS, NEWTON_STEPS = (
    (3, 3, 10),
    40,
)  # steps of npgs, and of Newton's method after each, of larger problems


@dataclass(frozen=True, kw_only=True)
class Pyramids(Algorithm):
    """Sweeps and Newton's steps on the three unknowns of each contact in space, where friction is a pyramid."""

    name: ClassVar[str] = "pyramids"
    is_monotone: ClassVar[bool] = False
    ends_with_a_case: ClassVar[bool] = True

    @property
    def takes_scaled(self) -> bool:
        """Return False: what stands behind the LCP is in the caller's units."""
        return False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then what the compiled loop proves; of more contacts each step of Newton's method."""
        contacts, k, m = problem.origin, problem.origin.count, len(problem.origin.edges)
        yield Step(z0)
        r, free = (
            np.column_stack([x[:k], x[k:-k].reshape(k, m) @ contacts.edges])
            for x in (z0, problem.q)
        )
        free[:, 1:] *= 2.0 / m  # Σ d dᵀ = m/2 I
        W, starts, mu = contacts.W, np.arange(0, 3 * k + 1, 3), np.array(contacts.friction)
        if W.shape[0] <= LARGEST:
            ends = np.full((1, W.shape[0]), np.inf)
            arrays = (
                *read_only_views(
                    W[None], free.reshape(1, -1), -ends, ends, np.zeros_like(ends), mu[None]
                ),
            )
            found = run_loop(
                starts, arrays, r.reshape(1, -1), ACCURATE, has_friction=m, is_warm=bool(r.any())
            )
            if found.is_proved[0]:
                (sweeps, steps), r = found.made[0].tolist(), found.z[0]
                work = (
                    (sweeps + sweeps / SWEEPS_A_STEP + steps * k)
                    * W.size
                    / max(problem.nonzeros, 1)
                )
                yield Step(_whole(contacts.edges, mu, r, W @ r + free.ravel()), work=work)
            return
        cones = Blocks(
            LCP(W, free.ravel(), lower=-np.inf, upper=np.inf), starts, mu, has_friction=m
        )
        swept = r.ravel()
        for turn, sweeps in enumerate(SWEEPS):
            *_, step = islice(NPGS().iterates(cones, cones.projected(swept)), 1 + sweeps)
            swept = step.z
            for step in islice(
                Newton(seed=turn % 2).iterates(cones, swept.copy()), 1, 1 + NEWTON_STEPS
            ):
                r = cones.projected(step.z)
                work = step.work * cones.nonzeros / max(problem.nonzeros, 1)
                yield Step(_whole(contacts.edges, mu, r, cones.slack(r)), work=work)


def _whole(edges: Any, mu: FloatVector, r: FloatVector, u: FloatVector) -> FloatVector:
    """Return z = (p, β, λ) from impulses r in the pyramids and the velocities u that they make.

    β is 0 on one edge where r is on the other, and λ where r is within: what is left of r or u there is rounding.
    """
    m, (p, x, y) = len(edges), r.reshape(-1, 3).T
    turn, contact = 2.0 * np.pi / m, np.arange(p.size)
    beside, beta = np.floor(np.arctan2(y, x) / turn).astype(np.int64), np.zeros((p.size, m))
    for one, other, sign in ((beside, beside + 1, 1.0), (beside + 1, beside, -1.0)):
        way = edges[other % m]
        share = sign * (x * way[:, 1] - y * way[:, 0]) / np.sin(turn)
        beta[contact, one % m] = np.where(share > ROUNDING * mu * p, share, 0.0)
    slides = beta.sum(axis=1) >= (1.0 - ROUNDING) * mu * p
    return np.concatenate(
        [p, beta.ravel(), np.where(slides, (u.reshape(-1, 3)[:, 1:] @ edges.T).max(axis=1), 0.0)]
    )
