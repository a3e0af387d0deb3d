"""NPSplitting: the paper's Method 3.1 with any splitting M = 𝓜 − 𝓝, the left-hand matrix factorized once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..core import sweep_data
from ..core.algorithm import PROJECTED_SPLITTING, IterationFacts, Step, check_choice
from ..core.checks import Vector
from ..core.entries import max_norm
from ..core.errors import InvalidOption, InvalidProblem, UnsuitableMatrix
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact
from ..core.splittings import ScaledByRows, step_unit
from ..judges.lcp import scaled_residual
from ..systems.factors import sparse_lu


@dataclass(frozen=True, kw_only=True, eq=False)
class NPSplitting(ScaledByRows):
    """NP with any splitting M = 𝓜 − 𝓝: (S(𝓜 + D) + 2I)(z⁺ − z) = −2 r_S(z), the left-hand matrix factorized once.

    Parameters
    ----------
    splitting : sparse array or array, shape (n, n), or {"diagonal", "tridiagonal", "lower"}
        𝓜, or the part of M to take: its diagonal (NPJ), three diagonals, or lower triangle (NPGS). A block
        diagonal, or the product of incomplete factors, is a good 𝓜 too.
    scaling, scaling_factor, momentum
        As in NPSOR; for a splitting of your own, scaling="auto" is 1/d_i.

    Raises
    ------
    UnsuitableMatrix
        If S(𝓜 + D) + 2I is singular.
    """

    name: ClassVar[str] = "npsplitting"
    needs: ClassVar[str] = "𝓜 + 2I + D nonsingular"
    solves: ClassVar[str] = "ρ(T) < 1 (the paper's Theorem 4.1); H₊ for a named splitting, scaled"
    cost: ClassVar[str] = "1 product with M, 1 solve with 𝓜 + 2I + D"

    splitting: Any = "tridiagonal"

    def __post_init__(self) -> None:
        if isinstance(self.splitting, str):
            check_choice(self, "splitting", ("diagonal", "tridiagonal", "lower"))
        super().__post_init__()

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield z₀, z₁, …, each with its residual."""
        while not problem.n:  # SuperLU rejects a matrix without rows
            yield Step(z0, 0.0, work=0.0)
        splitting = self._matrix(problem)
        step = self.row_scaling(problem)
        scaled = sp.diags_array(step) @ (splitting + sp.diags_array(problem.diagonal))
        try:
            factor = sparse_lu(scaled + sp.diags_array(np.full(problem.n, 2.0)))
        except RuntimeError as error:
            raise UnsuitableMatrix(
                f'npsplitting: S(𝓜 + D) + 2I is singular ({error}); choose another splitting, or algorithm="auto"'
            ) from error
        entries = max(problem.nonzeros, 1)
        scale = sweep_data.inverse_residual_scale(problem.matrix)
        unit = step_unit(max_norm(problem.q * scale))
        work = (splitting.nnz + factor.nnz + problem.nonzeros) / entries
        points, z = self.extrapolations(z0, problem.lower, problem.upper), z0
        while True:
            w = problem.slack(z)
            residual = max_norm(scaled_residual(problem, z, w))
            natural = np.clip(step * w, z - problem.upper, z - problem.lower)
            yield Step(z, residual, work=work)
            new = np.clip(z - factor.solve(2.0 * natural), problem.lower, problem.upper)
            squares = float((((new - z) * unit) ** 2).sum())
            z = new if points is None else points.send((new, z, squares))[0]
            work = (factor.nnz + problem.nonzeros) / entries

    def facts(self, problem: LCP) -> IterationFacts:
        """Return 𝓜, S, and whether 𝓜 is a part of M."""
        return IterationFacts(
            PROJECTED_SPLITTING,
            has_momentum=self.momentum is not None,
            splitting=self._matrix(problem),
            scaling=self.row_scaling(problem),
            is_part_of_matrix=isinstance(self.splitting, str),
        )

    def automatic_factors(self, problem: LCP) -> Vector | float:
        """Return θ, shape (n,), or 1 for a splitting of the user."""
        if not isinstance(self.splitting, str):
            return 1.0
        matrix, part = problem.matrix, part_of(problem.matrix, self.splitting)
        taken = np.add(*sweep_data.triangle_sums(matrix, np.ones(matrix.n), part))
        sums = sweep_data.unit_triangle_sums(matrix)
        return sweep_data.balanced_factors(matrix, 1.0, taken, sums)

    def _matrix(self, problem: LCP) -> sp.csr_array:
        M = problem.csr
        if isinstance(self.splitting, str):
            return part_of(problem.matrix, self.splitting)
        need = f"npsplitting: the splitting must be a real matrix of the shape {M.shape} of M"
        shape = getattr(self.splitting, "shape", None)
        if shape is not None and shape != M.shape:
            raise InvalidOption(f"{need}, got shape {shape}")
        try:
            # The checks of a problem's matrix are the checks of 𝓜.
            return LCP(self.splitting, np.zeros(problem.n)).csr
        except InvalidProblem as error:
            raise InvalidOption(f"{need}: {error}") from error


@fact
def part_of(matrix: Matrix, splitting: str) -> sp.csr_array:
    """Return the part of M that a splitting by name is, shape (n, n)."""
    reach = {"diagonal": 0, "tridiagonal": 1, "lower": matrix.n}[splitting]
    upper_reach = 0 if splitting == "lower" else reach
    return sp.csr_array(sp.tril(sp.triu(matrix.csr, -reach), upper_reach))
