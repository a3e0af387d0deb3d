"""M*: the modulus-based matrix splitting iterations of Bai.

With z − lower = (|x| + x)/γ and w = Ω(|x| − x)/γ, γ = 2, complementarity holds by construction and

    (αΩ + D − βL)(x⁺ − x) = −2α (M z + q − Ω max(−x, 0)) + β-part of what is already updated

is Bai's (𝓜 + Ω) x⁺ = 𝓝 x + (Ω − M)|x| − γ q with the AOR splitting, written as a correction.

Modulus-based splittings, in which complementarity holds by construction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..core import algorithm
from ..core.algorithm import IterationFacts, Step, check_positive, require_positive_diagonal
from ..core.checks import Vector, vector_option
from ..core.errors import InvalidOption, UnsuitableProblem
from ..core.kernels.splitting_sweeps import modulus_sweep
from ..core.lcp import LCP
from ..core.splittings import Splitting
from ..core.sweep_data import inverse_residual_scale


@dataclass(frozen=True, kw_only=True, eq=False)
class ModulusBased(Splitting):
    """(αΩ + D − βL) x⁺ = [(1−α)D + (α−β)L + αU] x + α[(Ω − M)|x| − 2q], z = lower + max(x, 0).

    Parameters
    ----------
    omega : float or array, shape (n,)
        Ω: a positive multiple of the diagonal of M, or the positive diagonal of Ω itself.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Raises
    ------
    UnsuitableProblem
        On rows without a finite lower bound or with a finite upper bound: the substitution has no place for them.

    Notes
    -----
    The start is x⁰ = z⁰ − lower (γ/2 = 1), as in the paper's tables.
    """

    needs: ClassVar[str] = "positive diagonal, only lower bounds"
    solves: ClassVar[str] = "H₊ for Ω ≥ D, 0 ≤ β ≤ α ≤ 1"
    reference: ClassVar[str] = "Bai 2010, doi:10.1002/nla.680"

    omega: float | ArrayLike = 1.0
    sweep: str = "forward"

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.ndim(self.omega) == 0:
            check_positive(self, "omega")

    def facts(self, problem: LCP) -> IterationFacts:
        """Return α, β, Ω and the sweep."""
        omega = self._checked_omega(problem)
        return IterationFacts(algorithm.MODULUS, *self.weights(), self.sweep, omega=omega)

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield z = lower + max(x, 0) of x₀, x₁, …, each with its residual."""
        omega, weights = self._checked_omega(problem), self.weights()
        inverse_pivot = 1.0 / (weights[0] * omega + problem.diagonal)
        q = problem.slack(problem.lower)
        inverse_scale = inverse_residual_scale(problem.matrix)
        rows = np.column_stack([q, problem.lower, inverse_scale, omega, inverse_pivot])
        yield from self.swept(problem, modulus_sweep, rows, weights, z0 - problem.lower, z=z0)

    def _checked_omega(self, problem: LCP) -> Vector:
        """Return Ω, shape (n,); raise UnsuitableProblem for other than lower bounds."""
        wrong = ~np.isfinite(problem.lower) | (problem.upper != np.inf)
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            raise UnsuitableProblem(
                f"{self.name} needs a finite lower and no upper bound on every row, but {problem.names.row(i)} has "
                f'bounds [{problem.lower[i]}, {problem.upper[i]}]; try algorithm="auto"'
            )
        diagonal = require_positive_diagonal(problem, self.name)
        if np.ndim(self.omega) == 0:
            return float(self.omega) * diagonal  # type: ignore[arg-type]
        need = f"{self.name}: omega must be a positive multiple of the diagonal, or a vector of length {problem.n}"
        omega = vector_option(self.omega, "omega", problem.n, is_finite=False, need=need)
        wrong = ~(np.isfinite(omega) & (omega > 0.0))
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            raise InvalidOption(
                f"{self.name}: omega must be positive and finite, but omega[{i}] = {omega[i]}"
            )
        return omega


@dataclass(frozen=True, kw_only=True, eq=False)
class MAOR(ModulusBased):
    """MAOR, modulus-based accelerated overrelaxation.

    Parameters
    ----------
    relaxation : float
        α > 0.
    acceleration : float
        β.
    omega : float or array, shape (n,)
        Ω: a positive multiple of the diagonal of M, or the positive diagonal of Ω itself.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "maor"
    relaxation: float = 0.85
    acceleration: float = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class MSOR(ModulusBased):
    """MSOR, modulus-based successive overrelaxation: MAOR with α = β = relaxation.

    Parameters
    ----------
    relaxation : float
        α > 0.
    omega : float or array, shape (n,)
        Ω: a positive multiple of the diagonal of M, or the positive diagonal of Ω itself.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    The paper prints Ω = D/(2α); its tables use Ω = D/(2α²) in this formula.
    """

    name: ClassVar[str] = "msor"
    relaxation: float = 0.85


@dataclass(frozen=True, kw_only=True, eq=False)
class MGS(ModulusBased):
    """MGS, modulus-based Gauss–Seidel: MAOR with α = β = 1.

    Parameters
    ----------
    omega : float or array, shape (n,)
        Ω: a positive multiple of the diagonal of M, or the positive diagonal of Ω itself.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "mgs"


@dataclass(frozen=True, kw_only=True, eq=False)
class MJ(ModulusBased):
    """MJ, modulus-based Jacobi: MAOR with α = 1, β = 0.

    Parameters
    ----------
    omega : float or array, shape (n,)
        Ω: a positive multiple of the diagonal of M, or the positive diagonal of Ω itself.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "mj"
    is_coupled: ClassVar[bool] = False
