"""Splitting methods: projected-type (np*) and projected relaxation (p*, gfp).

Convergence of sweeps:

- On the paper's two examples, where no constraint is active, NPSOR(1.7) needs 12–17 iterations
  (``examples/paper_tables.py``) and plain projected Gauss–Seidel 10–16 (``lcp-plugin solve paper_example_1 -a pgs
  --tolerance 1e-5``, and ``paper_example_2``).
- Where constraints are active, the np* methods need their row scaling, which is on by default.
- psor finds a relaxation that needs at most twice the iterations of the best fixed one on a plain obstacle problem.
- On a fine grid all of them are slow: with the best relaxation, the iterations grow with the number of nodes across,
  without it with the square of this number. multigrid takes about ten V-cycles for any n, and requires only M.
- On bimatrix games, circuits, saddle points and infeasible problems, sweeps end STALLED or DIVERGED, sometimes also on
  rank-deficient contact; "auto" then continues with direct methods.

The paper's formulas for NPSOR and NPAOR contain misprints; implemented as printed they converge to a wrong point, which
a test demonstrates. The modulus rows of its tables use Ω = D/2 (MGS) and D/(2α²) (MSOR).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np

from ..algorithm import (
    SWEEPS,
    Algorithm,
    Step,
    check_choice,
    check_number,
    check_positive,
)
from ..checks import FloatVector
from ..lcp import LCP
from ..matrix.row_sums import row_splits


class Splitting(Algorithm):
    """Sweeps over the rows of M = D − L − U, weighted by α and, for already updated unknowns, by β.

    A subclass (a family) defines the sweep. A method is a family with α and β: its fields `relaxation` and
    `acceleration` where it has them; without, α is 1, and β is α where `is_coupled` and 0 elsewhere.
    """

    cost: ClassVar[str] = "1 pass"
    is_coupled: ClassVar[bool] = True

    sweep: str  # a field of each family, in the order of its options

    def __post_init__(self) -> None:
        check_choice(self, "sweep", [*SWEEPS])
        if hasattr(self, "relaxation"):
            check_positive(self, "relaxation")
        if hasattr(self, "acceleration"):
            check_number(self, "acceleration")

    def weights(self) -> tuple[float, float]:
        """Return (α, β)."""
        alpha = float(getattr(self, "relaxation", 1.0))
        return alpha, float(getattr(self, "acceleration", alpha if self.is_coupled else 0.0))

    def swept(
        self,
        problem: LCP,
        kernel: Callable[..., Any],
        rows: FloatVector,
        weights: tuple[Any, ...],
        x: FloatVector,
        *,
        z: FloatVector | None = None,
    ) -> Iterator[Step]:
        """Yield a step for x₀, x₁, …, with the residual that the pass to the next one measures anyway.

        Parameters
        ----------
        kernel : callable
            Kernel of :mod:`~lcp_plugin.core.kernels.splitting_sweeps`, which writes the next x and, if passed, z.
        rows, weights : array and tuple
            Arguments of the kernel, per row and for all rows.
        x : array, shape (width,)
            Overwritten.
        z : array, shape (n,), optional
            If x is not z itself: filled with the z of x.
        """
        matrix, M = problem.matrix, problem.matrix.csr
        passes = SWEEPS[self.sweep]
        splits = {backward: row_splits(matrix, backward) for backward in passes}
        new, unwanted = (
            np.empty_like(x),
            np.empty_like(x) if z is not None and len(passes) > 1 else z,
        )
        work = 1.0
        while True:
            for k, backward in enumerate(passes):
                others = () if z is None else (unwanted if k else z,)
                residual = kernel(
                    M.indptr,
                    splits[backward],
                    M.indices,
                    M.data,
                    rows,
                    *weights,
                    backward,
                    x,
                    new,
                    *others,
                )
                if k == 0:
                    yield Step(x if z is None else z, residual, work=work)
                x, new = new, x
            work = float(len(passes))
