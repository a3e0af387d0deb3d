"""M*: the modulus-based matrix splitting iterations of Bai.

With z − lower = (|x| + x)/γ and w = Ω(|x| − x)/γ, γ = 2, complementarity holds by construction and

    (αΩ + D − βL)(x⁺ − x) = −2α (M z + q − Ω max(−x, 0)) + β-part of what is already updated

is Bai's (𝓜 + Ω) x⁺ = 𝓝 x + (Ω − M)|x| − γ q with the AOR splitting, written as a correction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ...certificates.convergence import MODULUS, IterationFacts
from ...checks import FloatVector, is_number, real_vector
from ...errors import InvalidOption, InvalidProblem, UnsuitableProblem
from ...problem.lcp import LCP
from ..base import (
    SWEEPS,
    Algorithm,
    Step,
    check_choice,
    check_number,
    check_positive,
    directions,
    inverse_residual_scale,
    require_positive_diagonal,
    row_splits,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModulusBased(Algorithm):
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
        On rows without a finite lower bound or with a finite upper bound: the substitution has no room for them.

    Notes
    -----
    The start is x⁰ = z⁰ − lower (γ/2 = 1), as in the paper's tables.
    """

    assumption: ClassVar[str] = "positive diagonal, only lower bounds"
    converges_on: ClassVar[str] = "H₊ for Ω ≥ D, 0 ≤ β ≤ α ≤ 1"
    cost: ClassVar[str] = "1 pass"
    reference: ClassVar[str] = "Bai 2010, doi:10.1002/nla.680"

    omega: float | ArrayLike = 1.0
    sweep: str = "forward"

    def __post_init__(self) -> None:
        check_choice(self, "sweep", SWEEPS)
        if self._has_one_omega:
            check_positive(self, "omega")

    def splitting(self) -> tuple[float, float]:
        """Return (α, β)."""
        raise NotImplementedError

    def facts(self, problem: LCP) -> IterationFacts:
        """Return α, β, Ω and the sweep."""
        _require_lower_bounds_only(problem, self.name)
        diagonal = require_positive_diagonal(problem, self.name)
        alpha, beta = self.splitting()
        return IterationFacts(
            family=MODULUS, relaxation=alpha, acceleration=beta, sweep=self.sweep, omega=self._omega(problem, diagonal)
        )

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield z = lower + max(x, 0) of x₀, x₁, …, each with its residual."""
        from ...kernels import splitting_sweeps as kernels

        M = problem.csr
        _require_lower_bounds_only(problem, self.name)
        diagonal = require_positive_diagonal(problem, self.name)
        alpha, beta = self.splitting()
        omega = self._omega(problem, diagonal)
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is seen in the residual
            inverse_pivot = 1.0 / (alpha * omega + diagonal)
            q = problem.slack(problem.lower)
        rows = kernels.packed(q, problem.lower, inverse_residual_scale(problem.matrix), omega, inverse_pivot)
        passes = directions(self.sweep)
        splits = {backward: row_splits(problem.matrix, backward) for backward in passes}
        z, x, new = z0, z0 - problem.lower, np.empty_like(z0)
        unwanted = np.empty_like(z0) if len(passes) > 1 else z
        work = 1.0
        while True:
            for k, backward in enumerate(passes):
                residual, squares = kernels.modulus_sweep(
                    M.indptr, splits[backward], M.indices, M.data, rows, alpha, beta, backward, x, new,
                    unwanted if k else z,
                )
                if k == 0:
                    yield Step(z, residual, squares**0.5, None, work)
                x, new = new, x
            work = float(len(passes))

    def _omega(self, problem: LCP, diagonal: FloatVector) -> FloatVector:
        if self._has_one_omega:
            with np.errstate(over="ignore"):
                return float(self.omega) * diagonal  # type: ignore[arg-type]
        try:
            omega = real_vector(self.omega, "omega", problem.n)
        except InvalidProblem as error:
            raise InvalidOption(f"{self.name}: {error}, or a positive multiple of the diagonal") from error
        wrong = ~(np.isfinite(omega) & (omega > 0.0))
        if wrong.any():
            i = int(np.flatnonzero(wrong)[0])
            raise InvalidOption(f"{self.name}: omega must be positive and finite, but omega[{i}] = {omega[i]}")
        return omega

    @property
    def _has_one_omega(self) -> bool:
        """Whether omega is a multiple of the diagonal (or nothing that could be a vector)."""
        return is_number(self.omega) or isinstance(self.omega, (str, bool)) or self.omega is None


def _require_lower_bounds_only(problem: LCP, name: str) -> None:
    wrong = ~np.isfinite(problem.lower) | (problem.upper != np.inf)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise UnsuitableProblem(
            f"{name} needs a finite lower and no upper bound on every row, but row {i} has bounds "
            f'[{problem.lower[i]}, {problem.upper[i]}]; try algorithm="npsor" or "psor"'
        )


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

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "relaxation")
        check_number(self, "acceleration")

    def splitting(self) -> tuple[float, float]:
        """Return (relaxation, acceleration)."""
        return float(self.relaxation), float(self.acceleration)


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
    The paper prints Ω = D/(2α); its tables are those of Ω = D/(2α²) in this formula.
    """

    name: ClassVar[str] = "msor"
    relaxation: float = 0.85

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "relaxation")

    def splitting(self) -> tuple[float, float]:
        """Return (relaxation, relaxation)."""
        return float(self.relaxation), float(self.relaxation)


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

    def splitting(self) -> tuple[float, float]:
        """Return (1, 1)."""
        return 1.0, 1.0


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

    def splitting(self) -> tuple[float, float]:
        """Return (1, 0)."""
        return 1.0, 0.0
