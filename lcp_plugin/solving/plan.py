"""The plan of ``algorithm="auto"``: a list of stages, each with its reason and its budget.

A small problem (256 unknowns if M is dense, 128 otherwise, except tridiagonal M-matrices) begins with sweeps of npsor
that guess the active set, active-set iterations and Lemke's path. Larger problems:

| stage | if | until it has ended, or |
|---|---|---|
| the direct methods (:mod:`lcp_plugin.solving.direct`) | a program's KKT form, or a bimatrix game | |
| banded | a narrow band, predicted to take the time of 150 sweeps | |
| npsor, relaxation 1.7, row scaling 1/d | the diagonal is positive | 3 sweeps, unless 10 more are enough |
| psor, automatic relaxation | the same; on large symmetric M if predicted cheaper | the work of the next stage |
| multigrid | M is sparse, n > 1000, positive diagonal | 270 passes, and factorizations are cheaper |
| psor | a factorization is predicted to be too large | |
| the direct methods | | |

So the projected-type iteration comes first: it converges for every H₊-matrix and costs no analysis of M. If M is not
symmetric, the rate of a few sweeps does not forecast the rest: psor may take 10 sweeps, or thousands. So psor is not
left before its work equals the predicted work of the next stage, and both together cost at most about twice the better
of the two. The work of multigrid is predicted by n, the work of the direct methods by n and the nonzeros of M.

On a large symmetric M there is a forecast. The first sweeps are the quickest: they smooth the error, and only then its
slowest part shows. So after one sweep the free unknowns F are measured: Gauss–Seidel takes ln R/2λ sweeps to reduce the
residual by a factor R, λ least with D⁻¹M_FF x = λx. On a cube of any dimension λ = π²h²/2, h = 1ᵀM_FF 1/1ᵀD_F 1, and λ
is never below the least sum of a row of D⁻¹M_FF. The larger λ of the two counts. The forecast is at most √R sweeps,
because in the plane a localized residual falls as 1/k². If npsor needs s sweeps, psor is predicted to need 3 √s.

Decisions never depend on measured time, so that a repeated call gives the identical result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..core.algorithm import Algorithm, count_driven_sweeps
from ..core.lcp import LCP
from ..core.splittings import NPSOR, PSOR
from ..core.structure import is_nearly_symmetric
from ..core.sweep_data import has_positive_diagonal
from ..core.tuning import BANDED_PASSES, DIRECT_UP_TO, LINEAR_PROGRAM_UP_TO
from ..methods.banded import Banded, banded_passes
from ..methods.lemke.pivoting_path import is_game
from ..methods.multigrid import Multigrid
from ..methods.search import FeasibilityCheck
from ..methods.small import GUESSED, Rounds, takes_rounds
from .direct import direct_methods, factor_passes
from .result import StageRecord
from .run import Budget, Stage

ASKED_EVERY = 20  # iterations between two forecasts
SWEEPING: dict[str, Algorithm] = {
    algorithm.name: algorithm
    for algorithm in (NPSOR(scaling="diagonal"), PSOR(), Multigrid(hands_over=True))
}
CHEAP = "cheap sweeps over the rows come first; their rate decides the next stage"
ACCELERATED = "sweeps with automatic relaxation; on a large symmetric M if predicted cheaper"
PATIENCE = 1.5  # a stage is left if its work exceeds this multiple of the work of the next stage


def plan(
    problem: LCP, method: Algorithm | None, goal: float, *, prove_infeasibility: bool = True
) -> Iterator[Stage]:
    """Yield the stages of ``algorithm="auto"``, each after the stage before has ended, or the stage of a method.

    Parameters
    ----------
    problem : LCP
    method : Algorithm or None
        None for auto. After another method that ends by itself a proof of infeasibility is tried.
    goal : float
        The relative residual that the run needs.
    prove_infeasibility : bool
        If False, no method looks for proofs.
    """
    if method is not None:
        yield Stage(method)
        is_unfit = method.is_monotone or problem.n > LINEAR_PROGRAM_UP_TO
        if prove_infeasibility and not is_unfit:
            yield Stage(FeasibilityCheck(), f"{method.name} found no solution: is there one?")
        return
    if not problem.is_kkt and takes_rounds(problem):
        yield Stage(Rounds(), GUESSED)
    elif not (problem.is_kkt or is_game(problem)):
        passes = count_driven_sweeps(problem, banded_passes(problem.matrix))
        if passes <= BANDED_PASSES:
            time = "one sweep" if passes < 1.5 else f"{passes:.0f} sweeps"
            yield Stage(Banded(), f"M is a narrow band, solved in about the time of {time}")
        if has_positive_diagonal(problem.matrix).all():
            yield from _sweeping_stages(problem, goal)
    yield from direct_methods(problem, goal, prove_infeasibility=prove_infeasibility)


def repeated(last: StageRecord) -> Stage | None:
    """Return the method that solved the step before, with three times its work; None if it is not one of SWEEPING."""
    algorithm = SWEEPING.get(last.name)
    if algorithm is None:
        return None
    most = 3.0 * last.work + ASKED_EVERY
    return Stage(algorithm, "solved the step before", Budget(is_over=lambda one: one.work > most))


def _sweeping_stages(problem: LCP, goal: float) -> Iterator[Stage]:
    """Yield npsor, psor and multigrid, which need a positive diagonal."""
    direct, cycles = _direct_passes(problem), _cycle_passes(problem)
    best = min(direct, cycles)
    is_forecast = cycles < math.inf and is_nearly_symmetric(problem.matrix)
    fewest, least = 40, 0.0 if is_forecast else best  # iterations and work of psor

    def is_trial_over(stage: Stage) -> bool:
        if stage.iterations == 1 and is_forecast:  # squared: one sweep is a weak forecast
            return fewest_sweeps(problem, stage, goal) > PATIENCE**2 * cycles
        is_near = stage.work <= 30.0 and stage.trend.steps_to_go(goal) <= 10.0  # psor takes as many
        return stage.iterations >= 3 and not is_near

    def is_too_slow(stage: Stage) -> bool:
        if stage.iterations < fewest or stage.iterations % ASKED_EVERY or stage.work < least:
            return False
        return stage.work + stage.trend.steps_to_go(goal) > PATIENCE * best

    budget = Budget("3 sweeps, unless 10 more are enough", is_trial_over)
    yield (npsor := Stage(SWEEPING["npsor"], CHEAP, budget))
    sweeps = 0.0
    if is_forecast and npsor.trend.residuals:
        sweeps = max(npsor.trend.steps_to_go(goal), fewest_sweeps(problem, npsor, goal))
    if 3.0 * math.sqrt(sweeps) <= best:
        until = f"{max(fewest, least):.0f} passes, if its rate needs many more"
        budget = Budget(until, is_too_slow)
        yield Stage(SWEEPING["psor"], ACCELERATED, budget)
    if cycles < math.inf:
        trial = 270.0  # passes: three times as many as are predicted on large grids

        def is_factorization_cheaper(stage: Stage) -> bool:
            if stage.iterations % ASKED_EVERY or stage.work <= trial:
                return False
            needed = stage.trend.steps_to_go(goal) * stage.work / stage.iterations
            return needed > (passes := factor_passes(problem)) and stage.work > 0.5 * passes

        why = "a sparse M with many rows: work in proportion to them"
        until = f"{trial:.0f} passes, if factorizations are predicted to be cheaper"
        yield Stage(SWEEPING["multigrid"], why, Budget(until, is_factorization_cheaper))
        if factor_passes(problem) == math.inf:
            yield Stage(SWEEPING["psor"], "a factorization of M is predicted to be too large")


def _cycle_passes(problem: LCP) -> float:
    """Return the predicted work of multigrid in passes over M; ∞ if it does not suit."""
    if problem.matrix.is_dense or problem.n <= DIRECT_UP_TO:
        return math.inf
    # The calls on all levels cost as much as passes over 350 000 rows; with them, a solve takes the time of 190 to 310.
    return 90.0 + 350_000.0 / problem.n


def _direct_passes(problem: LCP) -> float:
    """Return the predicted work of the direct methods in passes over M; ∞ on large sparse M."""
    if problem.matrix.is_dense:
        return 0.05 * problem.n
    if problem.n > DIRECT_UP_TO:
        return math.inf
    entries = min(12_500.0 * problem.n, 0.06 * problem.n**3)  # that factorizations touch
    return max(10.0, count_driven_sweeps(problem, entries / max(problem.matrix.nonzeros, 1)))


def fewest_sweeps(problem: LCP, stage: Stage, goal: float) -> float:
    """Return the sweeps that an error needs that is constant on the free unknowns, M symmetric; 0 if unknown."""
    z = stage.z
    if z is None or goal <= 0.0:
        return 0.0
    gain = stage.trend.residuals[-1][1] / goal
    margin = 1e-2 * max(z.max(), -z.min())  # npsor approaches a bound without reaching it
    is_free = (problem.lower + margin < z) & (z < problem.upper - margin)
    free = is_free.astype(np.float64)
    sums, diagonal = problem.matrix.csr @ free, problem.matrix.diagonal
    share = free @ sums / (free @ diagonal)
    least = (sums / diagonal).min(initial=1.0, where=is_free)
    slowest = max(0.5 * (math.pi * share) ** 2, least)
    if not (gain > 1.0 and 0.0 < slowest < 1.0):
        return 0.0
    return float(min(math.sqrt(gain), 0.5 * math.log(gain) / slowest))
