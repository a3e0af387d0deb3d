"""The solver for LCPs: the plan of ``algorithm="auto"``, a list of stages, and the run that follows it.

A small problem (256 unknowns if M is dense, 128 otherwise, except tridiagonal M-matrices) begins with sweeps of npsor
that guess the active set, active-set iterations and Lemke's path. Larger problems:

| stage | if | until it has ended, or |
|---|---|---|
| the direct methods (:mod:`lcp_plugin.methods.direct`) | a program's KKT form, or a bimatrix game | |
| banded | a narrow band, predicted to take the time of 150 sweeps | |
| npsor, relaxation 1.7, row scaling 1/d | the diagonal is positive | another stage is cheaper |
| psor with automatic relaxation | the diagonal is positive; predicted cheaper than the stages below | the same |
| multigrid | M is sparse, n > 1000, positive diagonal | 270 passes, and factorizations are cheaper |
| psor | a factorization is predicted to be too large | |
| the direct methods | | |

So the projected-type iteration comes first if no faster way is seen: it converges for every H₊-matrix and costs no
analysis of M. A stage of sweeps is over if its work so far and the sweeps that it still needs at its rate exceed 1.5
times the work of the next stage. The work of psor is predicted as 3 √s sweeps if npsor needs s, at least 20; the work
of multigrid as 90 passes and its calls, 2.5 times that for a flow (`has_flow`); the work of the direct methods by n.

The first sweeps are the quickest: they smooth the error, and only then its slowest part shows. So after one sweep on a
large symmetric M the free unknowns F are measured too: Gauss–Seidel takes ln R/2λ sweeps to reduce the residual by a
factor R, λ least with D⁻¹M_FF x = λx. On a cube of any dimension λ = π²h²/2, h = 1ᵀM_FF 1/1ᵀD_F 1, and λ is never
below the least sum of a row of D⁻¹M_FF. The larger λ of the two counts, and never more than √R sweeps, because in
the plane a localized residual falls as 1/k².

Decisions never depend on measured time, so that a repeated call gives the identical result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .algorithms import create, refusal_of_engine
from .core.algorithm import Algorithm, count_driven_sweeps
from .core.checks import Vector, checked_start, read_only
from .core.deadline import Clock
from .core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from .core.kernels.threads import threads_for
from .core.lcp import LCP
from .core.matrix import Matrix, fact, has_positive_diagonal, is_nearly_symmetric
from .core.settings import BESIDE, OF_SOLVE, Settings
from .core.solving.lcp_run import LCPRun
from .core.solving.progress import Callback
from .core.solving.result import Result, StageRecord
from .core.solving.stage import Stage
from .core.splittings import NPSOR, PSOR
from .core.tuning import BANDED_PASSES, DIRECT_UP_TO, LINEAR_PROGRAM_UP_TO
from .engines.engine import Engine
from .methods.small import Rounds, first_candidate, is_small

GUESSED = "small: a few sweeps guess the active set"
ASKED_EVERY = 20
PATIENCE = 1.5  # a stage is left if its work exceeds this multiple of the next one's


def plan(
    problem: LCP,
    method: Algorithm | None,
    goal: float,
    *,
    prove_infeasibility: bool = True,
    begin: str | None = None,
) -> Iterator[Stage]:
    """Yield the stages of ``algorithm="auto"``, each after the one before has ended, or the stage of a method.

    Parameters
    ----------
    problem : LCP
    method : Algorithm or None
        None for auto. After another method that ends by itself a proof of infeasibility is tried.
    goal : float
        The relative residual that the run needs.
    prove_infeasibility : bool
        If False, no method looks for proofs.
    begin : {"npsor", "psor", "multigrid"}, optional
        The method that solved a problem with this M before.
    """
    if method is not None:
        yield Stage(method)
        is_unfit = method.is_monotone or problem.n > LINEAR_PROGRAM_UP_TO
        if prove_infeasibility and not is_unfit:
            from .methods.search import FeasibilityCheck

            yield Stage(FeasibilityCheck(), f"{method.name} found no solution: is there one?")
        return
    from .methods.banded import Banded, banded_passes
    from .methods.direct import SEARCHED, direct_methods
    from .methods.lemke.pivoting_path import is_game

    direct = partial(direct_methods, problem, goal, prove_infeasibility=prove_infeasibility)
    if begin is None:
        is_program = getattr(problem.origin, "form", "") == "kkt"
        if not is_program and takes_rounds(problem):
            from .methods.search import NearbyPoints, has_few_active_sets, points_nearby

            is_few = has_few_active_sets(problem)
            yield Stage(Rounds(restarts=not is_few), GUESSED)
            if is_few and not prove_infeasibility and (near := points_nearby(problem)) is not None:
                if not near.size:
                    return
                yield Stage(NearbyPoints(), SEARCHED)
            yield from direct()
            return
        if is_program or is_game(problem):
            yield from direct()
            return
        passes = count_driven_sweeps(problem, banded_passes(problem.matrix))
        if passes <= BANDED_PASSES:
            time = "one sweep" if passes < 1.5 else f"{passes:.0f} sweeps"
            yield Stage(Banded(), f"M is a narrow band, solved in about the time of {time}")
    if has_positive_diagonal(problem.matrix).all():
        yield from _sweeping_stages(problem, goal, begin)
    yield from direct()


def _sweeping_stages(problem: LCP, goal: float, begin: str | None) -> Iterator[Stage]:
    """Yield npsor, psor and multigrid, which need a positive diagonal."""
    direct, cycles = _direct_passes(problem), _cycle_passes(problem)

    def is_trial_over(stage: Stage) -> bool:
        if stage.iterations == 1 and cycles < math.inf:
            return fewest_sweeps(problem, stage, goal) > PATIENCE**2 * cycles
        if stage.iterations < 3:
            return False
        needed, best = stage.steps_to_go(goal), min(_psor_passes(0.0), direct)
        return needed > best and stage.work + needed > PATIENCE * best

    def is_too_slow(stage: Stage) -> bool:
        if stage.iterations < 40 or stage.iterations % ASKED_EVERY:
            return False
        return stage.work + stage.steps_to_go(goal) > PATIENCE * min(direct, cycles)

    sweeps = 0.0
    if begin in (None, "npsor"):
        why = "cheap sweeps over the rows come first; their rate decides the next stage"
        npsor = Stage(NPSOR(scaling="diagonal"), why, is_trial_over)
        yield npsor
        sweeps = max(npsor.steps_to_go(goal), fewest_sweeps(problem, npsor, goal))
    if begin != "multigrid" and _psor_passes(sweeps) <= min(direct, cycles):
        yield Stage(PSOR(), "sweeps with automatic relaxation", is_too_slow)
    if cycles < math.inf:
        from .methods.direct import factor_passes
        from .methods.multigrid import Multigrid

        def is_no_grid(stage: Stage) -> bool:
            is_asked = stage.iterations % ASKED_EVERY == 0
            if not is_asked or stage.work <= 270.0:
                return False
            needed = stage.steps_to_go(goal) * stage.work / stage.iterations
            return needed > (passes := factor_passes(problem)) and stage.work > 0.5 * passes

        why = "a sparse M with many rows: work in proportion to them"
        yield Stage(Multigrid(hands_over=True), why, is_no_grid)
        if factor_passes(problem) == math.inf:
            yield Stage(PSOR(), "a factorization of M is predicted to be too large")


def _psor_passes(sweeps: float) -> float:
    """Return the predicted work of psor if npsor needs so many sweeps."""
    return max(20.0, 3.0 * math.sqrt(sweeps))


def _cycle_passes(problem: LCP) -> float:
    """Return the predicted work of multigrid in passes over M; ∞ if it does not suit."""
    if problem.matrix.is_dense or problem.n <= DIRECT_UP_TO:
        return math.inf
    # On few rows the calls on all levels cost as much as the passes. With a flow, a solve takes the time of 260 to 930
    # sweeps, otherwise of 190 to 310.
    passes = 90.0 + 350_000.0 / problem.n
    return 2.5 * passes if has_flow(problem.matrix) else passes


@fact
def has_flow(matrix: Matrix) -> bool:
    """Return whether neighbors weigh differently upstream and downstream: m_ij/m_ii and m_ji/m_jj, in 1000 rows.

    The median of their ratio is 1 to 1.1 for diffusion, for any scaling of the rows; 7 to 9 for flows of which the mesh
    resolves no layer; and above 1000 for random units of the unknowns, which hide a flow.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> scenes = gallery.convection_diffusion(size=40), gallery.obstacle_2d(size=40)
    >>> [has_flow(scene.problem.matrix) for scene in scenes]
    [True, False]
    """
    M = matrix.csr
    i = np.linspace(0, matrix.n - 1, 1000).astype(np.int64)
    j = M.indices[M.indptr[i]]  # of the first entry of each row
    one, other = (abs(M[a, b]) / matrix.diagonal[a] for a, b in ((i, j), (j, i)))
    least, most = np.minimum(one, other), np.maximum(one, other)
    is_pair = (i != j) & (least > 0.0)
    ratios = most[is_pair] / least[is_pair]
    return bool(ratios.size) and 2.0 < float(np.median(ratios)) < 100.0


def _direct_passes(problem: LCP) -> float:
    """Return the predicted work of the direct methods in passes over M; ∞ on large sparse M."""
    if problem.matrix.is_dense:
        # A third of the measured work of interior_point, because npsor seems faster than it is.
        return 10.0 if is_nearly_symmetric(problem.matrix) else max(10.0, 0.25 * problem.n)
    if problem.n > DIRECT_UP_TO:
        return math.inf
    entries = min(12_500.0 * problem.n, 0.06 * problem.n**3)  # that factorizations touch
    return max(10.0, count_driven_sweeps(problem, entries / max(problem.matrix.nonzeros, 1)))


def fewest_sweeps(problem: LCP, stage: Stage, goal: float) -> float:
    """Return the sweeps that an error needs that is constant on the free unknowns; 0 if that is unknown."""
    z = stage.z
    if z is None or problem.matrix.is_dense or problem.n <= DIRECT_UP_TO:
        return 0.0
    if not (stage.residuals and goal > 0.0 and is_nearly_symmetric(problem.matrix)):
        return 0.0
    gain = stage.residuals[-1][1] / goal
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


def takes_rounds(problem: LCP) -> bool:
    """Return whether auto begins with rounds on a dense M: a small problem, no tridiagonal M-matrix kept sparse."""
    if not is_small(problem):
        return False
    if problem.matrix.is_dense:
        return True
    from .methods.banded import banded_passes

    return banded_passes(problem.matrix) > 10


def method_of(algorithm: Any, options: dict[str, Any]) -> Algorithm | None:
    """Return the algorithm object for the `algorithm` and the options of a call; None for "auto".

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        If the name or an option does not exist.
    """
    if isinstance(algorithm, str):
        if algorithm != "auto":
            return create(algorithm, options)
        if options:
            hint = did_you_mean(next(iter(options)), (), OF_SOLVE)
            name_one = "" if "did you mean" in hint else "; name an algorithm as well"
            raise InvalidOption(
                f'algorithm="auto" has no options, got {sorted(options)}{name_one}{hint}'
            )
        return None
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(
                f"options {sorted(options)} were given with an algorithm object; "
                f"set them in {type(algorithm).__name__}(…){did_you_mean(next(iter(options)), (), OF_SOLVE)}"
            )
        if not getattr(algorithm, "name", ""):
            raise InvalidOption(
                f'{type(algorithm).__name__} has no name; write name = "…" in the class'
            )
        return algorithm
    if isinstance(algorithm, Engine):
        raise refusal_of_engine(algorithm.name)
    got = repr(algorithm)
    if isinstance(algorithm, type):
        got = f"the class {algorithm.__name__}"
        got += f"; write {algorithm.__name__}()" if issubclass(algorithm, Algorithm) else ""
    raise UnknownAlgorithm(
        f"algorithm must be a name or an object such as PSOR(relaxation=1.5), got {got}"
    )


@np.errstate(all="ignore")
def solve_lcp(
    problem: LCP,
    algorithm: str | Algorithm = "auto",
    *,
    z0: ArrayLike | None = None,
    callback: Callback | None = None,
    **options: Any,
) -> Result:
    """Return the result of an LCP; :func:`lcp_plugin.solve` describes the parameters and the result.

    Parameters
    ----------
    **options
        The fields of :class:`~lcp_plugin.core.settings.Settings`, and the options of a named algorithm.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        As :func:`lcp_plugin.solve`.
    """
    clock = Clock()
    method, settings = parse_call(algorithm, options)
    start = problem.nearest_to_zero if z0 is None else checked_start(problem, z0)
    is_watched = settings.record or settings.error_bound or settings.verbose
    is_limited = settings.max_seconds < math.inf or not settings.max_iterations
    is_plain = not (is_watched or is_limited or settings.absolute_tolerance)
    is_plain = is_plain and method is None and callback is None
    if is_plain and getattr(problem.origin, "form", "") != "kkt" and takes_rounds(problem):
        found = first_candidate(problem, start, settings.tolerance)
        if found is not None:
            point, label, work = found
            stage = StageRecord(label, GUESSED, 1, work)
            rows = point.rows if problem.matrix.is_dense else None  # of the stored M
            z = read_only(point.z)
            return Result.at(problem, z, stage, settings, clock.read(), rows)
    return run_on(problem, method, settings, start, clock, callback)


def run_on(
    problem: LCP,
    method: Algorithm | None,
    settings: Settings,
    start: Vector,
    clock: Clock,
    callback: Callback | None = None,
    *,
    begin: str | None = None,
) -> Result:
    """Return the result of a run with a method, or with auto for None.

    Parameters
    ----------
    start : ndarray, shape (n,)
        Within the bounds.
    clock : Clock
        Running.
    begin : str, optional
        For auto: the method that solved a problem with this M before.
    """
    proofs = settings.prove_infeasibility
    with threads_for(settings.threads):
        chosen = method or "auto"
        run = LCPRun(
            problem,
            chosen,
            settings,
            callback,
            clock,
            start,
            header=_header,
            polish=_polish,
            is_guaranteed=partial(_is_contraction, problem, method),
        )
        goal = run.goal
        return run.solve(plan(problem, method, goal, prove_infeasibility=proofs, begin=begin))


def _polish(problem: LCP, z: Vector, most: float) -> Any:
    from .methods.newton import polish_active_set

    return polish_active_set(problem, z, most)


def _is_contraction(problem: LCP, method: Algorithm | None) -> bool:
    """Return whether a theorem proves that the iteration of a named method converges on M."""
    from .proofs.guarantees import convergence_guarantee

    if method is None:
        return False
    guarantee = convergence_guarantee(problem, method)
    return guarantee.is_guaranteed and guarantee.facts is not None


def _header(matrix: Matrix) -> tuple[str, str]:
    from .proofs.verdicts import classes_in_words, sign_remark

    return classes_in_words(matrix), sign_remark(matrix)


def parse_call(
    algorithm: str | Algorithm, wishes: dict[str, Any]
) -> tuple[Algorithm | None, Settings]:
    """Return the method (None for auto) and the settings of a call; `wishes` may contain z0 and callback."""
    settings = Settings(
        **{name: wish for name, wish in wishes.items() if name in OF_SOLVE and name not in BESIDE}
    )
    options = {name: wish for name, wish in wishes.items() if name not in OF_SOLVE}
    return method_of(algorithm, options), settings
