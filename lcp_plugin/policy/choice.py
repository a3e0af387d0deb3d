"""The policy behind algorithm="auto": which algorithm comes next, decided on counted work and measured residuals.

| so far | next |
|---|---|
| nothing; M sparse, n > 1000, 0.8 m_ii ≥ the row's other entries on every row | psor: proved to be quick |
| nothing | npsor, relaxation 1.7, row scaling 1/d (converges for every H₊-matrix) |
| npsor, 1 sweep, M triangular with a positive diagonal | pgs in the order of the triangle: one sweep is exact |
| npsor, 10 sweeps (from 3 on where two rates agree), then every 20: it arrives within 20 | goes on |
| npsor on dense M, from 2 sweeps on: it arrives within 5 | goes on |
| M is sparse, n > 1000, the diagonal positive: npsor needs more than 300 further sweeps | multigrid |
| the same, npsor needs 20 to 300 | psor with automatic relaxation |
| psor before multigrid, every 20 sweeps: it needs more than 100 further ones, or fails | multigrid |
| multigrid ends without an answer, n > 20 000 | psor, until it fails |
| otherwise, or where one of them fails | the direct methods, on the presolved problem, each until it ends |

| M | direct methods, in this order |
|---|---|
| sparse, the diagonal positive and nothing else | newton, then as below |
| symmetric up to rounding, diagonal > 0; or M + Mᵀ is PSD | interior_point, feasibility, newton, lemke, search |
| any other | newton, feasibility, lemke and interior_point (the latter first where n > 1000), search |

Where a factor would fill in too much (n > 5000), newton and interior_point are left out. A row that contradicts its
bounds by itself brings `feasibility` to the front. To fail is to diverge, to stall, or to have nothing more to offer.
`feasibility` looks for a proof that there is no solution (n ≤ 5000), lemke takes n ≤ 6000 (beyond, psor comes back at
the end, until it stalls), `search` looks at all cases of problems with at most 24 rows that leave a choice, until a
counted number of operations on long numbers. No clock is asked: the same call gives the same answer bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ..algorithms import Algorithm, Step, create
from ..algorithms.splittings.projected_relaxation import PGS, PSOR
from ..algorithms.splittings.projected_type import NPSOR
from ..certificates.infeasibility import contradictory_row
from ..checks import FloatVector
from ..conversions.presolve import Presolved, presolve
from ..errors import InvalidOption, UnknownAlgorithm
from ..matrix.row_sums import has_positive_diagonal
from ..problem.lcp import LCP

TRIAL_SWEEPS, TRIAL_SWEEPS_DENSE, SHORTEST_TRIAL = 10, 2, 3
STEADY = 0.05
NEAR_ENOUGH, NEAR_ENOUGH_DENSE = 20, 5  # sweeps; on a dense M a direct answer costs about ten
SMALL = 1000  # up to here a factorisation costs no more than some dozen sweeps
MEDIUM = 20_000
CLEARLY_DOMINANT = 0.8  # Gauss–Seidel gains this factor a sweep, or more: 1e-8 in 83 sweeps at the most
BLOCK = 2**14  # rows
MULTIGRID_SOON, MULTIGRID_LATER = 300, 100  # sweeps: a run of multigrid costs about as much as 150
LARGEST_ANALYSIS = 20_000
LARGEST_PROGRAM = 5000
LARGEST_PIVOTED = 6000
KEPT_RESIDUALS = 512


@dataclass(frozen=True)
class Choice:
    """An algorithm, the reason for it, and the smaller problem it is to run on, if any."""

    algorithm: Algorithm
    because: str = ""
    presolved: Presolved | None = None

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the steps of the algorithm in terms of the caller's problem."""
        if self.presolved is None or self.presolved.problem is problem:
            yield from self.algorithm.iterates(problem, z0)
            return
        smaller = self.presolved.problem
        start = np.clip(self.presolved.reduce(z0), smaller.lower, smaller.upper)
        share = smaller.nonzeros / max(problem.nonzeros, 1)
        for step in self.algorithm.iterates(smaller, start):
            z = np.clip(self.presolved.restore(step.z), problem.lower, problem.upper)
            yield replace(step, z=z, residual=None, euclidean=None, increment=None, work=share * step.work, proof=None)


@dataclass
class Stage:
    """What one algorithm of a chain has done so far; `residuals` holds (iteration of this stage, residual)."""

    algorithm: Algorithm
    because: str = ""
    iterations: int = 0
    work: float = 0.0
    remark: str = ""
    residuals: list[tuple[int, float]] = field(default_factory=list)

    def note(self, residual: float) -> None:
        """Keep the residual of the present iteration: of the first 512 measured all, then the latest."""
        if len(self.residuals) >= KEPT_RESIDUALS:
            self.residuals.pop()
        self.residuals.append((self.iterations, residual))

    def rate(self) -> float:
        """Return the contraction of the residual a sweep, over the second half of the stage."""
        if len(self.residuals) < 2:
            return 1.0
        last_step, last = self.residuals[-1]
        first_step, first = next(
            (entry for entry in self.residuals if entry[0] >= last_step // 2), self.residuals[0]
        )
        if last_step == first_step or not first > 0.0 or not math.isfinite(last):
            return 1.0
        return float((last / first) ** (1.0 / (last_step - first_step)))

    def is_steady(self) -> bool:
        """Return whether the last two contractions of the residual agree."""
        (_, first), (_, second), (_, third) = self.residuals[-3:]
        if not min(first, second, third) > 0.0:
            return False
        return abs(third / second - second / first) <= STEADY * second / first

    def steps_to_go(self, target: float) -> float:
        """Return how many more steps arrive at that residual, at the stage's own rate."""
        if not self.residuals:
            return math.inf
        residual, rate = self.residuals[-1][1], self.rate()
        if residual <= target:
            return 0.0
        return math.log(target / residual) / math.log(rate) if 0.0 < rate < 1.0 and target > 0.0 else math.inf


class Policy(Protocol):
    """Chooses the first algorithm, and after each step whether another one takes over."""

    name: str

    def first(self, problem: LCP) -> Choice:
        """Return the algorithm to begin with."""

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return the algorithm that takes over, or None to go on (where the present one failed: to end)."""


class Single:
    """The caller's choice: one algorithm to the end; where one that ends by itself fails, a look at feasibility."""

    def __init__(self, algorithm: Algorithm) -> None:
        self.algorithm = algorithm
        self.name = algorithm.name

    def first(self, problem: LCP) -> Choice:
        """Return the caller's algorithm."""
        return Choice(self.algorithm)

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return None, or the feasibility check after a method that ended without a solution."""
        if not failed or len(stages) > 1 or self.algorithm.is_monotone or problem.n > LARGEST_PROGRAM:
            return None
        from ..algorithms.search.stages import FeasibilityCheck

        return Choice(FeasibilityCheck(), f"{self.name} found no solution: is there one?")


class Auto:
    """The tables of this module."""

    name = "auto"

    def __init__(self) -> None:
        self._direct: Iterator[Choice] | None = None

    def first(self, problem: LCP) -> Choice:
        """Return PSOR where the first look at the rows proves it quick, otherwise NPSOR.

        NPSOR at that row scaling is proved to converge for every H₊-matrix and costs no look at M.
        """
        if not problem.is_dense and problem.n > SMALL and _triangle(problem) is None and _is_clearly_dominant(problem):
            return Choice(PSOR(), f"every row is dominated: a sweep gains a factor {CLEARLY_DOMINANT} at least")
        return Choice(NPSOR(scaling="diagonal"), "the projected-type iteration comes first")

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return what the tables say, or None to go on."""
        now = stages[-1]
        if self._direct is not None:
            return next(self._direct, None) if failed else None
        following = self._after_sweeps(problem, stages, target, failed)
        if following is None and (failed or _is_over(problem, now, target)):
            self._direct = direct_methods(problem)
            following = next(self._direct, None)
        return following

    def _after_sweeps(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return another iteration where one is due."""
        now = stages[-1]
        if isinstance(now.algorithm, PSOR):
            return self._after_psor(stages, target, failed)
        if now.algorithm.name == "multigrid" and failed and problem.n > MEDIUM:
            return Choice(PSOR(), "multigrid came to an end, and a factorisation may be too large")
        if not isinstance(now.algorithm, NPSOR) or not has_positive_diagonal(problem.matrix).all():
            return None
        if now.iterations == 1 and (order := _triangle(problem)) is not None:
            return Choice(PGS(sweep=order), "M is triangular: a sweep in that order is exact")
        if problem.is_dense or problem.n <= SMALL or not (failed or _is_slow(problem, now, target)):
            return None
        if failed or now.steps_to_go(target) > MULTIGRID_SOON:
            return Choice(create("multigrid", {}), f"npsor needs more than {MULTIGRID_SOON} further sweeps")
        return Choice(PSOR(), f"npsor needs more than {NEAR_ENOUGH} further sweeps")

    def _after_psor(self, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        now = stages[-1]
        if any(stage.algorithm.name == "multigrid" for stage in stages):
            return None
        asked = now.iterations > 0 and now.iterations % NEAR_ENOUGH == 0
        if failed or (asked and now.steps_to_go(target) > MULTIGRID_LATER):
            return Choice(create("multigrid", {}), f"psor needs more than {MULTIGRID_LATER} further sweeps")
        return None


def _is_over(problem: LCP, now: Stage, target: float) -> bool:
    """Return whether the direct methods are due, although nothing failed."""
    if isinstance(now.algorithm, PGS):
        return now.iterations > 1
    return isinstance(now.algorithm, NPSOR) and _is_slow(problem, now, target)


def _is_slow(problem: LCP, now: Stage, target: float) -> bool:
    """Return whether the trial of the first iteration is over and does not promise to arrive soon."""
    if problem.is_dense:
        return now.iterations >= TRIAL_SWEEPS_DENSE and now.steps_to_go(target) > NEAR_ENOUGH_DENSE
    asked = now.iterations >= TRIAL_SWEEPS and (now.iterations - TRIAL_SWEEPS) % NEAR_ENOUGH == 0
    agreed = SHORTEST_TRIAL <= now.iterations < TRIAL_SWEEPS and now.is_steady()
    return (asked or agreed) and now.steps_to_go(target) > NEAR_ENOUGH


def direct_methods(problem: LCP) -> Iterator[Choice]:
    """Yield the methods that factorise, pivot or search, in the order of the second table."""
    from ..algorithms.search import is_searchable
    from ..algorithms.search.stages import ExhaustiveSearch, FeasibilityCheck
    from ..matrix.factors import factor_fits

    reduced = presolve(problem)
    left = reduced.problem
    about = f" ({reduced})" if left is not problem else ""
    newton = Choice(create("newton", {}), f"the active set is guessed and its linear system solved{about}", reduced)
    interior = Choice(create("interior_point", {}), f"M is monotone, or may be{about}", reduced)
    check = Choice(FeasibilityCheck(), "is there a solution at all?")
    lemke = Choice(create("lemke", {}), f"pivoting needs no property of M{about}", reduced)
    left_out = [] if problem.n <= LARGEST_PROGRAM else [check]
    if not (left.is_dense or left.n <= LARGEST_PROGRAM or factor_fits(left.csr)):
        left_out += [newton, interior]
    if contradictory_row(problem) is not None:
        yield replace(check, because="one row contradicts its bounds by itself")
    elif newton not in left_out and not left.is_dense and _suits_newton(left):
        yield newton
        left_out.append(newton)
    if _seems_monotone(left, problem.origin):
        order = [interior, check, newton, lemke]
    else:
        order = [newton, check, interior, lemke] if left.n > SMALL else [newton, check, lemke, interior]
    yield from (choice for choice in order if choice not in left_out)
    if is_searchable(problem):
        yield Choice(ExhaustiveSearch(), "few enough cases to look at all of them")
    if problem.n > LARGEST_PIVOTED and has_positive_diagonal(problem.matrix).all():
        yield Choice(last_resort(problem), "the direct methods failed: sweeps to the end")


def last_resort(problem: LCP) -> Algorithm:
    """Return the method that auto follows to its end where nothing before it arrives."""
    return create("lemke" if problem.n <= LARGEST_PIVOTED else "psor", {})


def _suits_newton(problem: LCP) -> bool:
    from ..matrix import analyze

    return bool(has_positive_diagonal(problem.matrix).all()) and bool(analyze(problem).is_z_matrix)


def _seems_monotone(problem: LCP, origin: Any) -> bool:
    """Return whether the interior point method has good prospects; proves nothing."""
    from ..conversions.qp_forms import QPOrigin
    from ..matrix.symmetry import is_nearly_symmetric

    if problem.n == 0:
        return False
    if isinstance(origin, QPOrigin):  # only convex programs are converted
        return True
    if bool(has_positive_diagonal(problem.matrix).all()) and is_nearly_symmetric(problem.matrix):
        return True
    from ..matrix.definiteness import is_semidefinite_to_rounding, symmetric_part

    twice = symmetric_part(problem.M)
    if bool((twice.diagonal() < 0.0).any()):
        return False
    # The multipliers of a quadratic program have empty rows and columns there.
    rows = np.flatnonzero((twice != 0.0).sum(axis=1))  # the magnitudes may overflow
    if rows.size > LARGEST_ANALYSIS:
        return False
    return not rows.size or is_semidefinite_to_rounding(twice[rows][:, rows]) is True


def _is_clearly_dominant(problem: LCP) -> bool:
    """Return whether Σ_{j≠i} |m_ij| ≤ 0.8 m_ii on every row; the first block of rows refuses most other matrices."""
    M, diagonal = problem.csr, problem.diagonal
    for first in range(0, problem.n, BLOCK):
        d = diagonal[first:first + BLOCK]
        if not d.min() > 0.0:
            return False
        ends = M.indptr[first:first + BLOCK + 1]
        with np.errstate(over="ignore"):
            sums = np.add.reduceat(np.abs(M.data[ends[0]:ends[-1]]), ends[:-1] - ends[0])
            if not bool(np.all(sums - d <= CLEARLY_DOMINANT * d)):
                return False
    return True


def _triangle(problem: LCP) -> str | None:
    """Return the direction of a sweep that solves a triangular problem, or None."""
    M = problem.csr
    # The rows are sorted; those at both ends refuse almost every other matrix.
    if problem.n < 2 or (M.indices[M.indptr[1] - 1] > 0 and M.indices[M.indptr[-2]] < problem.n - 1):
        return None
    from ..matrix.structure import triangular_form

    return {"lower": "forward", "diagonal": "forward", "upper": "backward"}.get(triangular_form(problem.matrix) or "")


def policy_for(algorithm: Any, options: dict[str, Any]) -> Policy:
    """Return the policy that the caller's `algorithm` and options mean.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        Where the name or an option does not exist.
    """
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(
                f"options {sorted(options)} were given beside an algorithm object; "
                f"set them in {type(algorithm).__name__}(…)"
            )
        if not getattr(algorithm, "name", ""):
            raise InvalidOption(f'{type(algorithm).__name__} has no name; write name = "…" in the class')
        return Single(algorithm)
    if isinstance(algorithm, str) and algorithm == "auto":
        if options:
            raise InvalidOption(
                f'algorithm="auto" has no options, got {sorted(options)}; name an algorithm as well, or see '
                "help(lcp_plugin.solve) for what solve itself takes"
            )
        return Auto()
    if isinstance(algorithm, type):
        name = algorithm.__name__
        raise UnknownAlgorithm(f"algorithm must be a name or an object, got the class {name}; write {name}()")
    if not isinstance(algorithm, str):
        raise UnknownAlgorithm(f"algorithm must be a name or an object such as PSOR(relaxation=1.5), got {algorithm!r}")
    return Single(create(algorithm, options))
