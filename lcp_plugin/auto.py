"""The policy behind algorithm="auto": what comes next is what is predicted to need the fewest passes over M.

A small problem (256 unknowns where M is dense, 128 elsewhere, but not on tridiagonal M-matrices) is solved by one
compiled call, which does the same in miniature: sweeps of npsor guess the active set, rounds solve for it, pivots
follow; where a row without a positive diagonal entry allows no sweep these come first, up to 500 unknowns. What that
leaves open goes to the direct methods, with which the KKT form of a program begins: neither sweeps nor pivots find much
in it. So does a bimatrix game, with Lemke and Howson's paths: its paths from r > 0 end on a ray. Otherwise:

The projected-type iteration comes first: npsor, relaxation 1.7, row scaling 1/d, which converges for every H₊-matrix
and costs no look at M (psor where the first look at the rows proves it quick). Only a narrow band comes before it:
`banded`, where it is predicted to cost no more than a trial of npsor, or 150 sweeps where psor is not proved quick. As
soon as the rate of npsor is known, what it still needs is compared with what its rivals predict
(`Algorithm.predicted_passes`, from :mod:`lcp_plugin.core.tuning`):

| rival | where | predicts |
|---|---|---|
| psor with automatic relaxation | after npsor; positive diagonal | 3 √(npsor's sweeps), or 20 |
| multigrid | once; sparse, n > 1000, positive diagonal | 90 passes, and 350 000 rows of passes |
| the direct methods | M is dense and symmetric, or its diagonal not positive | 10 passes |
| the direct methods | M is dense, but not symmetric | 0.25 n passes, or 10 |
| the direct methods | n ≤ 1000 | 12 500 n entries, 0.06 n³ at most, or 10 passes |
| the direct methods | otherwise | only when nothing else is left |

| the question is asked | |
|---|---|
| of npsor, M sparse | after 10 sweeps (from 3 on where two rates agree), then every 20 |
| of npsor, M dense | from its first sweep on |
| of psor | after 40 sweeps, then every 20: its first relaxation must have had its trial |
| of multigrid | every 20 steps, once it has cost 270 passes |
| of anything that fails: diverges, stalls, or has nothing more to offer | at once: it needs ∞ |

The first sweeps are the quickest: they smooth what is left, and only then the slowest error shows. So of a symmetric M
the free unknowns F so far are asked, too, with one pass: Gauss–Seidel takes ln R/2λ sweeps to reduce the residual by
a factor R, λ least with D⁻¹M_FF x = λx. On a cube of any dimension λ = π²h²/2, h = 1ᵀM_FF 1/1ᵀD_F 1, and λ is never
below the least sum of a row of D⁻¹M_FF. The larger λ of the two counts, and never more than √R sweeps: of a lump in
the plane the residual falls as 1/k². That is the least that npsor is reckoned to need; where multigrid needs less, it
comes after one sweep.

A sweep costs its pass and the calls around it, as much as 10 000 entries more: so `banded` and the direct methods
are reckoned on small M. psor's rate is that of all its sweeps, since each trial of a relaxation raises the residual.
What sweeps have cost and still need must together stay below 1.5 times what the rival predicts, so that nothing that is
always nearly there goes on for ever.

Along a strong flow sweeps are quick, which the first ones of npsor do not show: where Σ_j √(m_ij m_ji / (m_ii m_jj)) is
at most 0.8 on every row, psor may cost as much as multigrid is predicted to before it gives way.

The direct methods follow a multigrid that fails, or that at its rate still needs more than their factors are predicted
to take and either has cost half as much or does not settle: twice, at least half as many unknowns have come to bounds
or left them in 20 steps as in the 20 before; or has cost as much as one factor, and that one shows that nothing holds
z. Two exceptions: after one sweep on a triangular M with a positive diagonal, pgs in the order of the triangle is
exact; where multigrid fails and a factor is predicted to be too large, psor goes on until it fails. No clock is asked:
the same call gives the same answer bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .algorithms import create, refusal_of_engine
from .core.algorithm import Algorithm, in_driven_sweeps
from .core.certificates.residuals import Certificate
from .core.checks import FloatVector, checked_start, read_only
from .core.deadline import Clock
from .core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from .core.lcp import LCP
from .core.matrix.matrix import Matrix
from .core.matrix.row_sums import has_positive_diagonal, row_blocks
from .core.matrix.symmetry import mean_coupling
from .core.policy.policy import Policy
from .core.policy.remaining import TRIAL_SWEEPS, Remaining
from .core.policy.stages import Choice, Stage
from .core.settings import BESIDE, OF_SOLVE, Settings, Status, checked_callback
from .core.solving.driver import solved_by
from .core.solving.result import Result, StageRecord
from .core.solving.run import Callback
from .core.splittings.projected_relaxation import PGS, PSOR
from .core.splittings.projected_type import NPSOR
from .core.tuning import BANDED_PASSES, DIRECT_UP_TO, LINEAR_PROGRAM_UP_TO
from .engines import Engine
from .methods.small.rounds import Rounds, first_answer, is_small

if TYPE_CHECKING:
    from .methods.direct import FallbackOrder

DIRECT = "newton"  # predicts for all direct methods
SHARE_OF_SOLVED, CALLS = (
    0.1,
    20.0,
)  # of the work of a run for its last system; in passes, the calls around that
CLEARLY_DOMINANT = (
    0.8  # Gauss–Seidel gains this factor a sweep, or more: 1e-8 in 83 sweeps at the most
)
GUESSED = "small: a few sweeps guess the active set"
PROJECTED_TYPE = Choice(
    NPSOR(scaling="diagonal"),
    "cheap sweeps over the rows come first; how fast they are decides what follows",
)


class EndsWithItsCase(Policy):
    """A policy whose runs end with the linear system of the case they found.

    A residual is not an error: where M is ill-conditioned, as of heavy bodies on light ones, a small one allows any z,
    and the solution of that system is off by no more than rounding.
    """

    def last_system(
        self, problem: LCP, z: FloatVector, work: float, is_solved: bool
    ) -> tuple[FloatVector, float] | None:
        """Return the solution of the linear system of the case that z shows, and its work.

        It may take a tenth of what the run has cost, or all of that where auto has not solved the problem; a method by
        name that fails says so.
        """
        most = (
            SHARE_OF_SOLVED * work - CALLS
            if is_solved
            else math.inf
            if self.chosen == "auto"
            else 0.0
        )
        if most <= 0.0:
            return None
        from .methods.newton.active_set import solve_case

        found = solve_case(problem, z, min(most, work + CALLS))
        return found and (found.z, found.work)


class Single(EndsWithItsCase):
    """The caller's choice: one algorithm to the end; where one that ends by itself fails, a look at feasibility.

    Where `prove_infeasibility` is False, no proof is looked for.
    """

    algorithm: Algorithm

    def __init__(self, algorithm: Algorithm, *, prove_infeasibility: bool = True) -> None:
        self.algorithm = self.chosen = algorithm
        self.name, self._prove_infeasibility = algorithm.name, prove_infeasibility

    def first(self, problem: LCP) -> Choice:
        """Return the caller's algorithm."""
        return Choice(self.algorithm)

    def next_step(
        self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return None, or the feasibility check after a method that ended without a solution."""
        is_unfit = (
            not self._prove_infeasibility
            or self.algorithm.is_monotone
            or problem.n > LINEAR_PROGRAM_UP_TO
        )
        if not failed or len(stages) > 1 or is_unfit:
            return None
        from .methods.search.stages import FeasibilityCheck

        return Choice(FeasibilityCheck(), f"{self.name} found no solution: is there one?")


class Auto(EndsWithItsCase):
    """What is predicted to need the least work; where `prove_infeasibility` is False, without a look for proofs."""

    name = chosen = "auto"

    def __init__(self, *, prove_infeasibility: bool = True) -> None:
        self._prove_infeasibility = prove_infeasibility
        self._direct: FallbackOrder | None = None

    def first(self, problem: LCP) -> Choice:
        """Return what programs need, games, small problems, narrow bands or quick rows; else NPSOR."""
        is_program = getattr(problem.origin, "form", "") == "kkt"
        if not is_program and takes_rounds(problem):
            return Choice(Rounds(), GUESSED)
        if is_program or _is_game(problem):
            self._direct = self._fallback_order(problem)
            if (first := self._direct.first()) is not None:
                why = "multipliers have no diagonal entry, which sweeps need"
                return replace(first, because=f"{why}; {first.because}") if is_program else first
            self._direct = None
        banded = _banded()
        passes = in_driven_sweeps(problem, banded.predicted_passes(problem, math.inf))
        cost = f"{max(passes, 1.0):.0f} sweep" + "s" * (passes > 1.5)
        narrow = Choice(banded, f"M is a narrow band, solved in about the time of {cost}")
        is_large = not problem.is_dense and problem.n > DIRECT_UP_TO
        if passes <= TRIAL_SWEEPS:
            return narrow
        if is_large and _triangle(problem) is None and _is_clearly_dominant(problem):
            why = f"diagonal entries outweigh their rows: a sweep leaves at most {CLEARLY_DOMINANT:.0%} of the error"
            return Choice(PSOR(), why)
        return narrow if passes <= BANDED_PASSES else PROJECTED_TYPE

    def next_step(
        self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return what needs the least work from here, or None to go on."""
        now = stages[-1]
        if self._direct is not None:
            return self._direct.after(stages, goal, failed=failed)
        if (order := _exact_order(problem, now)) is not None:
            return Choice(PGS(sweep=order), "M is triangular: a sweep in that order is exact")
        if now.algorithm.name == "banded":
            why = "banded ended without a solution; cheap sweeps over the rows are next"
            return replace(PROJECTED_TYPE, because=why) if failed else None
        left = Remaining.of(problem, now, goal, failed=failed)
        if left is None:
            return None
        if left.name == "multigrid":
            from .methods.direct import factor_passes

            passes = factor_passes(problem)
            if left.has_failed and passes == math.inf:
                return Choice(PSOR(), f"{left}, and a factor of M is predicted to be too large")
            is_behind = left.sweeps > passes and (2.0 * left.work > passes or now.is_unsettled())
            if not (left.has_failed or is_behind):
                return None
        else:
            rivals = _rivals(problem, stages, left)
            predicted = {rival: rival.predicted_passes(problem, left.sweeps) for rival in rivals}
            rival = min(predicted, key=lambda one: predicted[one], default=None)
            if rival is None or not left.loses_to(rival, passes := predicted[rival]):
                return None
            if passes < math.inf and rival.name != DIRECT:
                return Choice(
                    rival,
                    f"{left}; {rival.name} is expected to take the time of {passes:.0f} sweeps",
                )
        self._direct = self._fallback_order(problem)
        first = self._direct.first()
        return first and replace(first, because=f"{left}; {first.because}")

    @property
    def left_out(self) -> Sequence[str]:  # type: ignore[override]
        """What the direct methods did not try, where it came to them."""
        return () if self._direct is None else self._direct.left_out

    def _fallback_order(self, problem: LCP) -> FallbackOrder:
        """Return the direct methods."""
        from .methods.direct import FallbackOrder

        return FallbackOrder(
            problem,
            prove_infeasibility=self._prove_infeasibility,
        )


def _is_game(problem: LCP) -> bool:
    """Return whether the problem is a bimatrix game, on which sweeps, rounds and paths from r > 0 lead nowhere."""
    if has_positive_diagonal(problem.matrix).any():
        return False
    from .methods.lemke.games import is_game

    return is_game(problem)


def takes_rounds(problem: LCP) -> bool:
    """Return whether auto begins with rounds on a dense M: a small problem, no tridiagonal M-matrix kept sparse."""
    if not is_small(problem):
        return False
    return problem.is_dense or _banded().predicted_passes(problem, math.inf) > TRIAL_SWEEPS


def _rivals(problem: LCP, stages: Sequence[Stage], left: Remaining) -> list[Algorithm]:
    """Return what could take over, in the order in which a tie is decided."""
    from .methods.newton.semismooth_newton import Newton

    now = stages[-1].algorithm
    rivals: list[Algorithm] = []
    if has_positive_diagonal(problem.matrix).all():
        rivals += [PSOR()] if isinstance(now, NPSOR) else []
        was_tried = any(stage.algorithm.name == "multigrid" for stage in stages)
        is_suited = not (problem.is_dense or was_tried) and isinstance(now, (NPSOR, PSOR))
        if is_suited:
            from .methods.multigrid import Multigrid

            multigrid = Multigrid(hands_over=True)
            has_had_its_turn = isinstance(now, PSOR) and left.work > multigrid.predicted_passes(
                problem, left.sweeps
            )
            if (
                left.has_failed
                or has_had_its_turn
                or mean_coupling(problem.matrix) > CLEARLY_DOMINANT
            ):
                rivals.append(multigrid)
    return [*rivals, Newton()]


@cache
def _banded() -> Algorithm:
    """Return the rounds on a narrow band."""
    from .methods.banded import Banded

    return Banded()


def _is_clearly_dominant(problem: LCP) -> bool:
    """Return whether Σ_{j≠i} |m_ij| ≤ 0.8 m_ii on every row; the first block of rows refuses most other matrices."""
    M, diagonal = problem.csr, problem.diagonal
    for rows in row_blocks(problem.n):
        d, ends = diagonal[rows], M.indptr[rows.start : rows.stop + 1]
        if not d.min() > 0.0:
            return False
        with np.errstate(over="ignore"):
            sums = np.add.reduceat(np.abs(M.data[ends[0] : ends[-1]]), ends[:-1] - ends[0])
            if not bool(np.all(sums - d <= CLEARLY_DOMINANT * d)):
                return False
    return True


def _triangle(problem: LCP) -> str | None:
    """Return the direction of a sweep that solves a triangular problem, or None."""
    M = problem.csr
    # The rows are sorted; those at both ends refuse almost every other matrix.
    if problem.n < 2 or (
        M.indices[M.indptr[1] - 1] > 0 and M.indices[M.indptr[-2]] < problem.n - 1
    ):
        return None
    from .core.matrix.structure import triangular_form

    return {"lower": "forward", "diagonal": "forward", "upper": "backward"}.get(
        triangular_form(problem.matrix) or ""
    )


def _exact_order(problem: LCP, now: Stage) -> str | None:
    """Return the order of the sweep that is exact, where M is triangular and one sweep of npsor is done."""
    is_after_one_sweep = isinstance(now.algorithm, NPSOR) and now.iterations == 1
    return (
        _triangle(problem)
        if is_after_one_sweep and has_positive_diagonal(problem.matrix).all()
        else None
    )


def policy_for(
    algorithm: Any,
    options: dict[str, Any],
    *,
    prove_infeasibility: bool = True,
) -> Policy:
    """Return the policy that the caller's `algorithm` and options mean.

    Where `prove_infeasibility` is False, it has no stage that looks for a proof that there is no solution.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        Where the name or an option does not exist.
    """
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(
                f"options {sorted(options)} were given beside an algorithm object; "
                f"set them in {type(algorithm).__name__}(…){did_you_mean(next(iter(options)), (), OF_SOLVE)}"
            )
        if not getattr(algorithm, "name", ""):
            raise InvalidOption(
                f'{type(algorithm).__name__} has no name; write name = "…" in the class'
            )
        return Single(algorithm, prove_infeasibility=prove_infeasibility)
    if isinstance(algorithm, Policy):
        return algorithm
    if isinstance(algorithm, str) and algorithm == "auto":
        if options:
            raise InvalidOption(
                f'algorithm="auto" has no options, got {sorted(options)}; name an algorithm as well'
                f"{did_you_mean(next(iter(options)), (), OF_SOLVE)}"
            )
        return Auto(prove_infeasibility=prove_infeasibility)
    if isinstance(algorithm, type):
        name = algorithm.__name__
        raise UnknownAlgorithm(
            f"algorithm must be a name or an object, got the class {name}; write {name}()"
        )
    if isinstance(algorithm, Engine):
        raise refusal_of_engine(algorithm.name)
    if not isinstance(algorithm, str):
        raise UnknownAlgorithm(
            f"algorithm must be a name or an object such as PSOR(relaxation=1.5), got {algorithm!r}"
        )
    return Single(create(algorithm, options), prove_infeasibility=prove_infeasibility)


@np.errstate(under="ignore")
def solve_lcp(
    problem: LCP,
    algorithm: str | Algorithm | Policy = "auto",
    *,
    z0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    record: bool = False,
    callback: Callback | None = None,
    error_bound: bool = False,
    prove_infeasibility: bool = True,
    threads: int | None = None,
    verbose: bool = False,
    **options: Any,
) -> Result:
    """Return the answer to an LCP: what :func:`lcp_plugin.solve` does with one, and says of these parameters.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        As there.
    """
    clock = Clock()
    policy = policy_for(algorithm, options, prove_infeasibility=prove_infeasibility)
    settings = Settings(
        tolerance,
        max_iterations,
        max_seconds,
        absolute_tolerance,
        record,
        error_bound,
        threads,
        verbose,
        prove_infeasibility,
    )
    callback, start = checked_callback(callback), checked_start(problem, z0)
    is_limited = settings.max_seconds < math.inf or not settings.max_iterations
    is_plain = settings.is_unobserved and not (is_limited or settings.absolute_tolerance)
    if algorithm == "auto" and callback is None and is_plain:
        found = _result_of_rounds(problem, settings, start, clock)
        if found is not None:
            return found
    # Ctrl-C that hits an errstate further down while it ends leaves that one's settings behind.
    with np.errstate():
        return solved_by(
            policy,
            problem,
            settings,
            start,
            clock,
            callback,
            header=_header,
        )


def _result_of_rounds(
    problem: LCP, settings: Settings, start: FloatVector, clock: Clock
) -> Result | None:
    """Return the result of a small problem that the first rounds, or the first path, solve; else None."""
    if getattr(problem.origin, "form", "") == "kkt" or not takes_rounds(problem):
        return None
    found = first_answer(problem, start, settings.tolerance)
    if found is None:
        return None
    z, label, work = found
    seconds = clock.read()
    return Result(
        z=z,
        w=read_only(problem.slack(z)),
        status=Status.SOLVED,
        certificate=Certificate(problem, z),
        algorithm=f"auto: {label}",
        iterations=1,
        work=work + 1.0,  # the point is measured
        seconds=seconds,
        setup_seconds=0.0,
        tolerance=settings.tolerance,
        stages=(StageRecord(label, GUESSED, 1, work),),
    )


def _header(matrix: Matrix) -> tuple[str, str]:
    from .proofs.verdicts.report import classes_in_words, sign_remark

    return classes_in_words(matrix), sign_remark(matrix)


def asked_of_solve(algorithm: str | Algorithm, wishes: dict[str, Any]) -> tuple[Policy, Settings]:
    """Return what an algorithm and other keyword arguments of `solve` ask for; a start and a callback may be there."""
    settings = Settings(
        **{name: wish for name, wish in wishes.items() if name in OF_SOLVE and name not in BESIDE}
    )
    options = {name: wish for name, wish in wishes.items() if name not in OF_SOLVE}
    return policy_for(
        algorithm, options, prove_infeasibility=settings.prove_infeasibility
    ), settings
