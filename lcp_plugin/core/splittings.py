"""Splitting methods: projected-type (np*) and projected relaxation (p*, gfp).

Convergence of sweeps:

- On the paper's two examples, where no constraint is active, NPSOR(1.7) needs 12–17 iterations
  (``examples/paper_tables.py``) and plain projected Gauss–Seidel 10–16 (``lcp-plugin solve paper_example_1 -a pgs
  --tolerance 1e-5``, and ``paper_example_2``).
- Where constraints are active, the np* methods need their row scaling, which is on by default.
- Momentum, also on by default, divides the iterations of the np* methods by 1.3 to 25 where their steps fall slowly.
  On grids psor needs half as many sweeps as they need with it, because its relaxation adapts to the problem.
- On a plain obstacle problem, psor needs at most twice the iterations of the best fixed relaxation.
- On a fine grid all of them are slow: with the best relaxation, the iterations grow with the number of nodes across,
  without it with the square of this number. multigrid takes about ten V-cycles for any n, and requires only M.
- On bimatrix games, circuits, saddle points and infeasible problems, sweeps end STALLED or DIVERGED, sometimes also on
  rank-deficient contact; "auto" then continues with direct methods.

The paper's formulas for NPSOR and NPAOR contain misprints; implemented as printed they converge to a wrong point, which
a test demonstrates. The modulus rows of its tables use Ω = D/2 (MGS) and D/(2α²) (MSOR).

New projected-type methods (NP*): the splitting iterations of Kumar, Deepmala and Das.

Their Method 3.1 with any splitting M = 𝓜 − 𝓝 is, because |w − z| = w + z − 2 min(z, w), exactly

    (𝓜 + 2I + D)(z⁺ − z) = −2 min(z, M z + q):

the residual that is the stopping test anyway, and one triangular solve. Here min(z, w) is replaced by
r_S(z) = z − mid(lower, upper, z − S w), which is the same on the classical problem, allows bounds and free
rows, and lets a positive row scaling S in. Each component of z⁺ is projected onto its bounds (the paper's ζ₊)
immediately, so that the rows after it already see the projected value.

Projected relaxation (P*): projected Jacobi, Gauss–Seidel, SOR and AOR, and the general fixed-point iteration.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from . import algorithm, sweep_data
from .algorithm import SWEEPS, Algorithm, IterationFacts, Step, check_choice, check_positive
from .checks import Vector
from .entries import max_norm
from .errors import InvalidOption, UnsuitableMatrix
from .kernels.splitting_sweeps import extrapolate, relaxation_sweep, splitting_sweep
from .lcp import LCP
from .sweep_data import inverse_residual_scale, split_matrix


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
            algorithm.check_number(self, "acceleration")

    def weights(self) -> tuple[float, float]:
        """Return (α, β)."""
        alpha = float(getattr(self, "relaxation", 1.0))
        return alpha, float(getattr(self, "acceleration", alpha if self.is_coupled else 0.0))

    def swept(
        self,
        problem: LCP,
        kernel: Callable[..., Any],
        rows: Vector,
        weights: tuple[Any, ...],
        x: Vector,
        *,
        z: Vector | None = None,
        points: Extrapolations | None = None,
    ) -> Iterator[Step]:
        """Yield a step for x₀, x₁, …, with the residual that the pass to the next iterate measures anyway.

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
        points : generator, optional
            The extrapolations of x; without them an iteration begins where the last iteration ended.
        """
        passes, new = SWEEPS[self.sweep], np.empty_like(x)
        matrices = [split_matrix(problem.matrix, backward) for backward in passes]
        unwanted = np.empty_like(x) if z is not None and len(passes) > 1 else z
        work = 1.0
        while True:
            squares = 0.0
            for k, backward in enumerate(passes):
                vectors = (x, new) if z is None else (x, new, unwanted if k else z)
                residual, change = kernel(*matrices[k], rows, *weights, backward, *vectors)
                if k == 0:
                    yield Step(x if z is None else z, residual, work=work)
                x, new, squares = new, x, squares + change
            work = float(len(passes))
            if points is not None:
                x, new = points.send((x, new, squares))


#: Sent: z⁺, an array to overwrite, ‖z⁺ − y‖² in a fixed unit; received: y and the array.
Extrapolations = Generator[tuple[Vector, Vector], tuple[Vector, Vector, float], None]
SLOW_RATIO = 0.8  # of two plain steps; momentum has nothing to gain where they fall faster
FALL = 1.0 - 1e-6  # of the steps of a cycle; without it, a cycle might never end nor converge
GAIN = 0.99  # of the least plain step, for a cycle that pays


def step_unit(largest: float) -> float:
    """Return the power of two that brings the largest |q_i|/d_i near 1, so that squares of steps stay in range."""
    exponent = math.frexp(largest)[1] if math.isfinite(largest) else 0
    return math.ldexp(1.0, max(-1000, min(1000, -exponent)))


def extrapolations(
    z: Vector, lower: Vector, upper: Vector, total: Callable[[float], float] = float
) -> Extrapolations:
    """Yield the points y from which the iterations T begin: Nesterov's momentum in cycles.

    In a cycle y = z⁺ + (t − 1)/t⁺ (z⁺ − z) within the bounds, with z⁺ = T(y) and t⁺ = 1/2 + √(1/4 + t²). It begins with
    t = 1, when a plain step ‖T(z) − z‖ exceeds 0.8 of the step before, and ends when the step ‖T(y) − y‖ grows. The
    next cycle begins at the z⁺ of this step, or of the step before if only this step was short, when it is shorter than
    every plain step so far. Otherwise z returns to the start of the cycle, and plain iterations follow, twice as many
    as the cycle had, or as the last return had.

    So the iteration converges wherever T contracts in some norm, because then the step vanishes only at the solution,
    and with it the error. Either an endless cycle or infinitely many cycles with a gain reduce the step to 0, or from
    some point on all cycles are undone, and the remaining iteration is T.

    Parameters
    ----------
    z : ndarray, shape (n,)
        The start; overwritten.
    lower, upper : ndarray, shape (n,)
        Read-only.
    total : callable
        Returns the sum of a number over all ranks.

    References
    ----------
    Nesterov, *A method of solving a convex programming problem with convergence rate O(1/k²)*, Soviet Mathematics
    Doklady 27, 1983. O'Donoghue, Candès 2015, doi:10.1007/s10208-013-9150-3.
    """
    start, before, spare, y = z.copy(), z.copy(), np.empty_like(z), z
    t, last, least = 1.0, math.inf, math.inf
    plain, wait, length = 1, 0, 0
    while True:
        after, spare, squares = yield y, spare
        step, length = math.sqrt(total(squares)), length + 1
        if plain or length == 1:
            least = min(least, step)
        if plain:
            plain = max(plain - 1, int(not step > SLOW_RATIO * last))
            y, last, is_over = after, step, not plain
        elif step < FALL * last:
            weight, t = t - 1.0, 0.5 + math.sqrt(0.25 + t * t)
            extrapolate(after, weight / t, lower, upper, before)
            y, before, last, is_over = before, after, step, False
        else:
            if step > GAIN * least and last <= 0.5 * least:  # a jump at the end of a good cycle
                after, before, step = before, after, last
            y, is_over = after, True
            if step <= GAIN * least:
                least, wait = step, 0
            else:
                np.copyto(after, start)
                plain = wait = 2 * max(wait, length)
        if is_over:
            np.copyto(start, y)
            np.copyto(before, y)
            t, last, length = 1.0, math.inf, 0


@dataclass(frozen=True, kw_only=True)
class ScaledByRows(Algorithm):
    """Base of all NP iterations: momentum, a row scaling S, and a last projected Gauss–Seidel sweep."""

    scaling: str | None = "auto"
    scaling_factor: float = 1.0
    momentum: str | None = "auto"

    reference: ClassVar[str] = (
        "Kumar, Deepmala, Das: More on projected type iteration method and linear complementarity problem"
    )

    def __post_init__(self) -> None:
        check_choice(self, "momentum", ("auto", None))
        check_choice(self, "scaling", ("auto", "diagonal", None))
        check_positive(self, "scaling_factor")
        if self.scaling != "diagonal" and self.scaling_factor != 1.0:
            raise InvalidOption(
                f'{self.name}: scaling_factor={self.scaling_factor!r} needs scaling="diagonal"; '
                f"with {self.scaling!r} it does nothing"
            )

    def extrapolations(
        self, z: Vector, lower: Vector, upper: Vector, total: Callable[[float], float] = float
    ) -> Extrapolations | None:
        """Return the extrapolations of the iterates, which begin at z; None without momentum."""
        if self.momentum is None:
            return None
        points = extrapolations(z, lower, upper, total)
        next(points)
        return points

    @abstractmethod
    def automatic_factors(self, problem: LCP) -> Vector | float:
        """Return the automatic θ, shape (n,) or a number."""

    def row_scaling(self, problem: LCP) -> Vector:
        """Return the diagonal of S, shape (n,): ones, factor/m_ii, or θ/m_ii with automatic θ; finite.

        The scale of the residual replaces m_ii if m_ii ≤ 0 or tiny. A diagonal that is small relative to its row is
        used, as in an H₊-matrix with columns of different units.
        """
        if self.scaling is None:
            return np.ones(problem.q.size)
        factors = self.automatic_factors(problem) if self.scaling == "auto" else self.scaling_factor
        matrix, inverse = problem.matrix, inverse_residual_scale(problem.matrix)
        if matrix.residual_scale is not matrix.diagonal:
            is_usable = sweep_data.has_positive_diagonal(matrix)
            inverse = np.where(is_usable, 1.0 / matrix.diagonal, inverse)
        return np.minimum(factors * inverse, np.finfo(np.float64).max)

    def finish(self, problem: LCP, z: Vector) -> Vector:
        """Return z after one projected Gauss–Seidel sweep, which puts active components at their bounds."""
        cleaned, inverse_scale = z.copy(), inverse_residual_scale(problem.matrix)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, inverse_scale])
        relaxation_sweep(*split_matrix(problem.matrix, False), rows, 1.0, False, cleaned)
        return cleaned


@dataclass(frozen=True, kw_only=True)
class ProjectedType(ScaledByRows, Splitting):
    """(D/α + D + 2S⁻¹ − (β/α) L)(z⁺ − z) = −2 S⁻¹ r_S(z) by forward substitution, each component projected at once.

    Parameters
    ----------
    scaling : {"auto", "diagonal", None}
        Row scaling S: automatic, ``scaling_factor``/d_i with d_i the diagonal, or none (the paper). S changes the
        iteration, never the solutions. "auto" uses θ_i/d_i with θ_i from 0.9 to 2. The iteration is proved to converge
        for every H₊-matrix with "auto", and with "diagonal" if the factor is ≤ 1.
    scaling_factor : float
        θ of the diagonal scaling, > 0.
    momentum : {"auto", None}
        Momentum with restarts (:func:`extrapolations`), or plain iterations (the paper).
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Paper notation: α₁ = relaxation α, β₁ = acceleration β, A = M, σ = q, λ = ζ₊ = z.
    """

    sweep: str = "forward"

    needs: ClassVar[str] = "d/α + d + 2 > 0"
    solves: ClassVar[str] = 'H₊ (scaling="auto", or "diagonal" with scaling_factor ≤ 1)'

    def __post_init__(self) -> None:
        ScaledByRows.__post_init__(self)
        Splitting.__post_init__(self)

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield z₀, z₁, …; each with its residual, which the pass to the next iterate measures anyway."""
        (alpha, beta), step = self.weights(), self.row_scaling(problem)
        pivot, inverse = self._inverse_pivot(problem, step), inverse_residual_scale(problem.matrix)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, inverse, step, pivot])
        points = self.extrapolations(z0, problem.lower, problem.upper)
        weights = beta / alpha, True, step_unit(max_norm(problem.q * inverse))
        yield from self.swept(problem, splitting_sweep, rows, weights, z0, points=points)

    def facts(self, problem: LCP) -> IterationFacts:
        """Return α, β, S and the sweep; raise UnsuitableMatrix if a pivot is not positive."""
        step, has_momentum = self.row_scaling(problem), self.momentum is not None
        self._inverse_pivot(problem, step)
        weights = *self.weights(), self.sweep
        return IterationFacts(algorithm.PROJECTED_TYPE, *weights, step, has_momentum=has_momentum)

    def automatic_factors(self, problem: LCP) -> Vector:
        """Return θ, shape (n,)."""
        alpha, beta = self.weights()
        return sweep_data.automatic_factors(problem.matrix, beta / alpha, self.sweep)

    def _inverse_pivot(self, problem: LCP, step: Vector) -> Vector:
        scaled_diagonal, alpha = step * problem.matrix.diagonal, self.weights()[0]
        pivot = scaled_diagonal / alpha + scaled_diagonal + 2.0
        inverse: Vector = 1.0 / pivot
        if pivot.size and not pivot.min() > 0.0:
            i = int(np.flatnonzero(~(pivot > 0.0))[0])
            raise UnsuitableMatrix(
                f"{self.name} needs d/α + d + 2 > 0 on every row, but M[{i}, {i}] = {problem.matrix.diagonal[i]} "
                f'gives {pivot[i]}; try algorithm="auto"'
            )
        huge = np.isinf(pivot)
        inverse[huge] = 1.0 / scaled_diagonal[huge] / (1.0 / alpha + 1.0)
        return inverse


@dataclass(frozen=True, kw_only=True)
class NPAOR(ProjectedType):
    """NPAOR, new projected-type accelerated overrelaxation: (D/α + D + 2I − (β/α) L)(z⁺ − z) = −2 min(z, w).

    Parameters
    ----------
    relaxation : float
        α > 0.
    acceleration : float
        β; convergence is proved for 0 ≤ β ≤ α.
    scaling : {"auto", "diagonal", None}
        Row scaling S: automatic, ``scaling_factor``/d_i with d_i the diagonal, or none (the paper).
    scaling_factor : float
        θ of the diagonal scaling, > 0.
    momentum : {"auto", None}
        Momentum with restarts (:func:`extrapolations`), or plain iterations (the paper).
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    The paper prints (α−β)U for (α−β)L + αU and αI + D for α(I + D); the formula above follows
    from its Method 3.1. Paper notation: α₁ = relaxation, β₁ = acceleration.

    Examples
    --------
    >>> import lcp_plugin
    >>> problem = lcp_plugin.LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> lcp_plugin.solve(problem, "npaor", relaxation=1.5, acceleration=1.0).z.round(6)
    array([0.75, 0.  ])
    """

    name: ClassVar[str] = "npaor"
    solves: ClassVar[str] = (
        'H₊ for 0 ≤ β ≤ α (scaling="auto", or "diagonal" with scaling_factor ≤ 1)'
    )
    relaxation: float = 1.7
    acceleration: float = 1.0


@dataclass(frozen=True, kw_only=True)
class NPSOR(ProjectedType):
    """NPSOR, new projected-type successive overrelaxation: NPAOR with α = β = relaxation.

    Parameters
    ----------
    relaxation : float
        α > 0; 1.7 is the paper's choice.
    scaling, scaling_factor : {"auto", "diagonal", None} and float
        Row scaling S: automatic, ``scaling_factor``/d_i, or none (the paper); see :class:`NPAOR`.
    momentum : {"auto", None}
        Momentum with restarts (:func:`extrapolations`), or plain iterations (the paper).
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    The paper prints U for αU and αI + D for α(I + D); implemented as printed it converges to a wrong point.
    Paper notation: α₁ = relaxation.
    """

    name: ClassVar[str] = "npsor"
    relaxation: float = 1.7


@dataclass(frozen=True, kw_only=True)
class NPGS(ProjectedType):
    """NPGS, new projected-type Gauss–Seidel: NPAOR with α = β = 1.

    Parameters
    ----------
    scaling, scaling_factor : {"auto", "diagonal", None} and float
        Row scaling S: automatic, ``scaling_factor``/d_i, or none (the paper); see :class:`NPAOR`.
    momentum : {"auto", None}
        Momentum with restarts (:func:`extrapolations`), or plain iterations (the paper).
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "npgs"


@dataclass(frozen=True, kw_only=True)
class NPJ(ProjectedType):
    """NPJ, new projected-type Jacobi: z⁺ = z − min(z, w)/(d + 1), NPAOR with α = 1, β = 0.

    Parameters
    ----------
    scaling, scaling_factor : {"auto", "diagonal", None} and float
        Row scaling S: automatic, ``scaling_factor``/d_i, or none (the paper); see :class:`NPAOR`.
    momentum : {"auto", None}
        Momentum with restarts (:func:`extrapolations`), or plain iterations (the paper).
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Converges for every H₊-matrix at every scale.
    """

    name: ClassVar[str] = "npj"
    solves: ClassVar[str] = "H₊"
    is_coupled: ClassVar[bool] = False


FIRST_WAIT = 8  # sweeps of a first phase of Gauss–Seidel
# smallest step of ω towards 2, as a share of 2 − ω, that pays for a new transient
WORTHWHILE = 0.05


@dataclass(frozen=True, kw_only=True)
class _Relaxation(Splitting):
    """z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii)."""

    needs: ClassVar[str] = "positive diagonal"
    solves: ClassVar[str] = "H₊"
    reference: ClassVar[str] = (
        "Cryer 1971, doi:10.1137/0309028; Mangasarian 1977, doi:10.1007/BF01268170"
    )

    sweep: str = "forward"

    def facts(self, problem: LCP) -> IterationFacts:
        """Return ω and β, None if they are determined during the run, and the sweep."""
        algorithm.require_positive_diagonal(problem, self.name)
        is_automatic = getattr(self, "relaxation", None) == "auto"
        weights: tuple[Any, Any] = (None, None) if is_automatic else self.weights()
        return IterationFacts(algorithm.PROJECTED_RELAXATION, *weights, self.sweep)


class _InPlace(_Relaxation):
    """z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii), w_i always current."""

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield z₀, z₁, …, all in the same array; the increment shows when a residual is worth measuring."""
        pivots = algorithm.require_positive_diagonal(problem, self.name)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, 1.0 / pivots])
        passes = [(*split_matrix(problem.matrix, way), rows, way) for way in SWEEPS[self.sweep]]
        z, work = z0, float(len(passes))

        def sweep(relaxation: float, *, is_settling: bool = False) -> tuple[Step, float]:
            """Return the step of a sweep, and Σ|z⁺ − z|."""
            largest = total = 0.0
            for *arrays, backward in passes:
                change, change_sum = relaxation_sweep(*arrays, relaxation, backward, z)
                largest = change if not change <= largest else largest  # a NaN stays
                total += change_sum
            return Step(z, increment=largest, work=work, is_settling=is_settling), total

        yield Step(z, work=0.0)
        if getattr(self, "relaxation", None) == "auto":
            yield from adaptive_sweeps(sweep, z)
        relaxation, _ = self.weights()
        while True:
            yield sweep(relaxation)[0]


@dataclass(frozen=True, kw_only=True)
class PSOR(_InPlace):
    """PSOR, projected successive overrelaxation: z_i ← mid(lower_i, upper_i, z_i − ω w_i/m_ii), w_i always current.

    Parameters
    ----------
    relaxation : float or "auto"
        ω in (0, 2), or determined during the run by trials that are undone where they do not pay, so that it
        converges wherever Gauss–Seidel does.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.

    Notes
    -----
    Converges for symmetric positive definite M (0 < ω < 2) and for H₊-matrices (0 < ω < 2/(1 + ρ),
    ρ the spectral radius of D⁻¹|L + U|).
    """

    name: ClassVar[str] = "psor"
    solves: ClassVar[str] = "SPD for ω < 2, H₊ for ω < 2/(1+ρ); the automatic ω on both"

    relaxation: float | str = "auto"

    def __post_init__(self) -> None:
        check_choice(self, "sweep", [*SWEEPS])
        if not isinstance(self.relaxation, str):
            check_positive(self, "relaxation", below=2.0)
        elif self.relaxation != "auto":
            raise InvalidOption(
                f'psor: relaxation={self.relaxation!r} is neither a number in (0, 2) nor "auto"'
            )


@dataclass(frozen=True, kw_only=True)
class PGS(_InPlace):
    """PGS, projected Gauss–Seidel: PSOR with ω = 1.

    Parameters
    ----------
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "pgs"
    solves: ClassVar[str] = "SPD, H₊"


class _Simultaneous(_Relaxation):
    """z⁺ = mid(lower, upper, z − D⁻¹(ω w + β Σ m_ij (z⁺_j − z_j))), the sum over the rows done before row i."""

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield z₀, z₁, …, each with its residual."""
        omega, beta = self.weights()
        step = omega / algorithm.require_positive_diagonal(problem, self.name)
        inverse_scale, ones = inverse_residual_scale(problem.matrix), np.ones(problem.n)
        rows = np.column_stack([problem.q, problem.lower, problem.upper, inverse_scale, step, ones])
        yield from self.swept(problem, splitting_sweep, rows, (beta / omega, False, 1.0), z0)


@dataclass(frozen=True, kw_only=True)
class PAOR(_Simultaneous):
    """PAOR, projected accelerated overrelaxation: ω weighs the residual, β what is already updated.

    Parameters
    ----------
    relaxation : float
        ω > 0.
    acceleration : float
        β; PAOR(ω, ω) is PSOR(ω), PAOR(1, 0) projected Jacobi.
    sweep : {"forward", "backward", "symmetric"}
        Order of the rows; symmetric does both in one iteration.
    """

    name: ClassVar[str] = "paor"
    solves: ClassVar[str] = "H₊ for 0 ≤ β ≤ ω < 2/(1+ρ)"

    relaxation: float = 1.0
    acceleration: float = 0.5


@dataclass(frozen=True, kw_only=True)
class PJ(_Simultaneous):
    """PJ, projected Jacobi: z⁺ = mid(lower, upper, z − D⁻¹ w).

    Parameters
    ----------
    sweep : {"forward", "backward", "symmetric"}
        Symmetric does two Jacobi steps in one iteration; otherwise the order does not matter.
    """

    name: ClassVar[str] = "pj"
    is_coupled: ClassVar[bool] = False


@dataclass(frozen=True, kw_only=True)
class GFP(_Simultaneous):
    """GFP, general fixed point: z⁺ = mid(lower, upper, z − Ω (M z + q)) with Ω = ω D⁻¹.

    Parameters
    ----------
    relaxation : float
        ω > 0.
    sweep : {"forward", "backward", "symmetric"}
        Symmetric does two fixed-point steps in one iteration; otherwise the order does not matter.

    Notes
    -----
    On the classical problem z = max(0, z − Ω w) is the same as (I + ΩM) z = |(ΩM − I) z + Ωq| − Ωq.
    """

    name: ClassVar[str] = "gfp"
    is_coupled: ClassVar[bool] = False
    solves: ClassVar[str] = "H₊ for ω < 2/(1+ρ)"
    reference: ClassVar[str] = "Fang 2021, doi:10.3934/math.2021691"

    relaxation: float = 1.0


def adaptive_sweeps(sweep: Callable[..., tuple[Step, float]], z: Vector) -> Iterator[Step]:
    """Yield sweeps with automatic ω by trials, measured by the increments Σ|z⁺ − z|.

    A phase of Gauss–Seidel sweeps measures the contraction λ. On a consistently ordered symmetric positive definite
    matrix, SOR with ω contracts by λ with (λ + ω − 1)² = λ ω² μ², and ω* = 2/(1 + √(1 − μ²)) is best. A trial with that
    ω lasts a few times 1/(2 − ω) sweeps, longer while its increments are still large, and ends with one Gauss–Seidel
    sweep. If the increment of this sweep is a new record (0.9 of the last), the trial is accepted, μ is estimated
    again, and the next trial begins. Otherwise z returns to the start of the trial, and the next Gauss–Seidel phase is
    twice as long.

    So the iteration converges wherever projected Gauss–Seidel does. Either infinitely many trials are kept: then
    the increments of a Gauss–Seidel sweep fall to 0, and they vanish at solutions only. Or from some point on
    all trials are undone: the remaining iteration is Gauss–Seidel.

    Parameters
    ----------
    sweep : callable
        Returns the step of a sweep of z with a relaxation, and Σ|z⁺ − z|.
    z : ndarray, shape (n,)
        Overwritten by each sweep.

    References
    ----------
    Hageman, Young: *Applied Iterative Methods*, Academic Press 1981, chapter 9.
    """
    wait, record = FIRST_WAIT, math.inf
    while True:
        sizes: list[float] = []
        while len(sizes) < wait:
            step, size = sweep(1.0)
            sizes.append(size)
            yield step
        record = min(record, size)
        omega = best_relaxation(contraction_of_steps(sizes), 1.0)
        is_promising = omega > 1.0 + WORTHWHILE and record > 0.0
        while is_promising:
            before, sizes, is_over, is_lost = z.copy(), [], False, False
            period = math.ceil(4.0 / (2.0 - omega)) + 8
            while not (is_over or is_lost):
                step, size = sweep(omega, is_settling=True)
                sizes.append(size)
                yield step
                # Increments may rise during a trial that is still worth its end, but not without limit.
                is_lost = not size <= 40.0 / (2.0 - omega) * record
                is_long = len(sizes) >= 4 * period
                is_over = is_long or (len(sizes) >= period and size <= 0.9 * record)
            if not is_lost:
                step, size = sweep(1.0, is_settling=True)
                yield step
            is_promising = not is_lost and size <= 0.9 * record
            if is_promising:
                record, wait = size, FIRST_WAIT
                wanted = best_relaxation(contraction_of_steps(sizes), omega)
                if wanted > omega + WORTHWHILE * (2.0 - omega):
                    omega = wanted
            else:
                np.copyto(z, before)
        wait = min(2 * wait, 4096)


def contraction_of_steps(sizes: list[float]) -> float:
    """Return the contraction per sweep over the second half of the increments; the first half is transient."""
    half = len(sizes) // 2
    if not sizes[-1 - half] > 0.0:
        return 0.0
    return float((sizes[-1] / sizes[-1 - half]) ** (1.0 / half))


def best_relaxation(rate: float, omega: float) -> float:
    """Return ω* by Young's formula from the contraction observed at ω, or ω itself if the formula does not apply.

    Examples
    --------
    >>> round(best_relaxation(0.96, 1.0), 3)
    1.667
    """
    if not omega - 1.0 < rate < 1.0:  # beyond ω* the rate is ω − 1, for any μ
        return omega
    mu_squared = ((rate + omega - 1.0) / omega) ** 2 / rate
    return min(2.0 / (1.0 + math.sqrt(1.0 - mu_squared)), 1.998) if mu_squared < 1.0 else omega
