"""Projected full multigrid: projected sweeps find the free unknowns, truncated V-cycles correct them.

A hierarchy of M, built from its entries alone, gives the linear corrections. The answer of each grid starts the next
finer one (nested iteration), so that the free set is nearly right before the finest grid is touched.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...core.algorithm import (
    Algorithm,
    Step,
    check_choice,
    check_flag,
    check_positive,
    require_positive_diagonal,
)
from ...core.checks import FloatVector
from ...core.errors import InvalidOption
from ...core.lcp import LCP

SMOOTHERS = ("pgs", "psor")


@dataclass(frozen=True, kw_only=True)
class Multigrid(Algorithm):
    """Projected full multigrid: a projected sweep, a truncated V-cycle on the free unknowns, a projected sweep back.

    Parameters
    ----------
    smoother : {"pgs", "psor"}
        The projected sweep on the finest grid and in the nested iteration.
    relaxation : float
        Relaxation parameter of psor, in (0, 2).
    nested : bool
        Whether to start on the coarsest grid: for z itself, or from a warm start for the increment.
    coarsest : int
        A grid with at most this many unknowns is not coarsened, ≥ 1.
    hands_over : bool
        If True, end as soon as cycles and sweeps have gained little three times, even if the energy still falls, so
        that another method can continue; used by `auto`.

    Notes
    -----
    pyamg sets up the hierarchy: first pass of Ruge and Stüben, also the second pass if couplings jump from edge to
    edge, direct interpolation. Rows of a nonsymmetric M may have any scaling. If the scaling of neighboring columns
    differs, cycles are slow or end STALLED. Unknowns at a bound are removed from all grids, fine unknowns with
    strong couplings to removed unknowns are no longer interpolated, and a coarse row is computed again only if it
    changes. If the free set changes little and a cycle gains less than a factor 10, a few steps of conjugate
    gradients (M symmetric) or generalized conjugate residuals accelerate the correction, one V-cycle each.
    Corrections fail if few contacts carry much load. Then, and from the start if couplings jump from edge to edge,
    such steps solve on a sequence of free sets. The projected solution on a free set determines the next free set,
    and only the last result is tested (primal–dual active sets). A correction that raises the energy (M symmetric)
    is shortened. Projected Gauss–Seidel sweeps from the last accepted iterate replace the cycles for a while if the
    residual grows a hundredfold, if the energy nevertheless rises, or if neither has fallen enough for twelve
    cycles after such free sets. With this safeguard the run converges on every symmetric positive definite M, from
    any start, for any corrections (:mod:`lcp_plugin.methods.multigrid.multigrid_safeguard` has the proof). It ends
    if three such rounds gain only rounding; without symmetry, if they gain little. The driver ends a run whose best
    residual no longer falls, as for sweeps. If coarser grids would cost too much, only sweeps run.

    Passes over at least 131 072 rows are shared by the threads of the solve. If M is symmetric, sweeps take its rows in
    blocks, first all even ones: this order depends only on M, so that the number of threads changes no bit.

    For the thirteen-point stencil of plates, the number of cycles grows with the grid: 32, 61 and 138 on 30², 60² and
    120² points.

    Memory, five-point matrix: 490 bytes per unknown (98 per nonzero of M) at the peak, the problem included; measured
    at n = 10⁷: 4.9 GB.

    References
    ----------
    C. Gräser, R. Kornhuber, *Multigrid methods for obstacle problems*, J. Comput. Math. 27 (2009).
    J. Toivanen, C. W. Oosterlee, *A projected algebraic multigrid method for linear complementarity problems*,
    Numer. Math. Theory Methods Appl. 5 (2012), doi:10.4208/nmtma.2011.m11si05.

    Examples
    --------
    >>> import lcp_plugin
    >>> from lcp_plugin import gallery
    >>> lcp_plugin.solve(gallery.build("obstacle_2d", size=60).problem, "multigrid").status.name
    'SOLVED'
    """

    name: ClassVar[str] = "multigrid"
    needs: ClassVar[str] = "positive diagonal"
    solves: ClassVar[str] = "SPD"
    cost: ClassVar[str] = "about 10 passes"
    reference: ClassVar[str] = (
        "Gräser, Kornhuber 2009, J. Comput. Math. 27; Toivanen, Oosterlee 2012, doi:10.4208/nmtma.2011.m11si05"
    )
    is_monotone: ClassVar[bool] = False
    is_watched: ClassVar[bool] = True

    smoother: str = "pgs"
    relaxation: float = 1.7
    nested: bool = True
    coarsest: int = 60
    hands_over: bool = False

    def __post_init__(self) -> None:
        check_choice(self, "smoother", SMOOTHERS)
        check_positive(self, "relaxation", below=2.0)
        for option in ("nested", "hands_over"):
            check_flag(self, option)
        is_count = isinstance(self.coarsest, (int, np.integer)) and not isinstance(
            self.coarsest, bool
        )
        if not is_count or self.coarsest < 1:
            raise InvalidOption(
                f"multigrid: coarsest must be an integer ≥ 1, got {self.coarsest!r}"
            )

    def theorem(self, problem: LCP, report: Any) -> str | None:
        """Return the theorem on symmetric positive definite matrices; None if the run may hand over."""
        require_positive_diagonal(problem, self.name)
        if self.hands_over or not (report.is_symmetric and report.is_positive_definite):
            return None
        return "M is symmetric positive definite: the safeguard lets no energy rise for good (Gräser, Kornhuber 2009)"

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then z after each sweep that follows a correction on the finest grid."""
        require_positive_diagonal(problem, self.name)
        from .multigrid_run import MultigridRun

        yield from MultigridRun(self, problem).iterates(z0)
