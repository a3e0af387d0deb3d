"""Time stepping: one matrix, and a q that depends on the solution of the previous step.

march(): time stepping for one or many problems, such as strikes of an option.

Time stepping on a narrow band: steps are solved one after the other, and checked in blocks.

M may be tridiagonal with off-diagonal entries ≤ 0 and bounds on one side only, as in an American option. Each step
is then one pass of :func:`~lcp_plugin.methods.banded.solve_one_sided`. On other bands a step runs
:func:`~lcp_plugin.methods.banded.active_sets`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...api import solve
from ...auto import parse_call, plan, run_on, solve_lcp
from ...core.algorithm import Algorithm
from ...core.certificates.criterion import RowData
from ...core.checks import (
    FloatVector,
    checked_start,
    checked_vector,
    is_number,
    read_only,
    real_array,
    rectangular_matrix,
    require_finite,
)
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem, LCPError, did_you_mean
from ...core.lcp import LCP
from ...core.matrix import connected_components, row_numbers
from ...core.problem_classes import class_of, refusal, takes
from ...core.settings import OF_SOLVE, Settings, Status, whole_number
from ...core.solving.result import Result, StageRecord
from ...methods.banded import Banded, active_sets, solve_one_sided
from ...systems.factors import Bands, bands
from ..cones.data import Blocks
from ..many import AnswerSequence, length_of_all, rows_of_a_batch


def propagation(C: sp.csr_array) -> Callable[[FloatVector], FloatVector]:
    """Return the function C z, for each row of z; if C is diagonal, a product of vectors."""
    if np.array_equal(C.indices, row_numbers(C)):
        diagonal: FloatVector = C.diagonal()
        return lambda z: diagonal * z
    return lambda z: np.asarray((C @ z.T).T)


class BandSteps:
    """The steps of a march on a narrow band.

    Parameters
    ----------
    problem : LCP
        The matrix and the bounds.
    band : Bands
        Bands of its matrix.
    propagator : csr_array, shape (n, n)
    settings : Settings
    """

    def __init__(
        self, problem: LCP, band: Bands, propagator: sp.csr_array, settings: Settings
    ) -> None:
        self.problem, self.band, self.propagate = problem, band, propagation(propagator)
        self.tolerance, self.absolute = settings.tolerance, abs(problem.csr)
        self.most = settings.max_iterations
        self.of_nearest: FloatVector = problem.csr @ problem.nearest_to_zero
        #: 1 if a step is one pass from the lower bounds, −1 from the upper ones, else 0.
        self.side, self.none = 0, read_only(np.zeros(problem.n, np.bool_))
        if band.is_tridiagonal_z:
            self.side = int(np.isinf(problem.upper).all()) or -int(np.isinf(problem.lower).all())

    def solve(self, forcing: FloatVector, state: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return q and z of the first steps that meet the criterion from this state, shapes (k, n).

        Parameters
        ----------
        forcing : array, shape (k, n)
        state : array, shape (n,)
        """
        Q, Z = np.empty(forcing.shape), np.empty(forcing.shape)
        fixed = read_only(Q)
        for k, given in enumerate(forcing):
            Q[k] = given + self.propagate(state)
            found = self._step(fixed[k], state)
            if found is None:
                Q, Z = Q[:k], Z[:k]
                break
            state = Z[k] = found
        measured = self._data(Q).measure(Z, self.tolerance, power=1.0)
        passes, moves = measured.passes, (measured.z != Z).any(axis=1)
        count = len(Q) if passes.all() else int(np.argmin(passes))
        if moves[:count].any():  # later steps were computed from the point before it was moved
            count = int(np.argmax(moves)) + 1
        return Q[:count], read_only(measured.z)[:count]

    def _step(self, q: FloatVector, state: FloatVector) -> FloatVector | None:
        """Return the solution of one step, or None if none was found."""
        problem = self.problem
        if self.side:
            value = problem.lower if self.side > 0 else problem.upper
            found = solve_one_sided(self.band.entries, q, self.side, value, self.none)[0]
            return (
                None
                if found is None
                else np.minimum(np.maximum(found, problem.lower), problem.upper)
            )
        data = self._data(q)
        reference = data.residual(data.start, self.of_nearest + q)
        goal = 0.5 * self.tolerance * np.abs(reference).max(initial=0.0)
        rounds = active_sets(problem, self.band, q, np.clip(state, problem.lower, problem.upper))
        return next((z for z, residual in islice(rounds, self.most) if residual <= goal), None)

    def _data(self, q: FloatVector) -> RowData:
        """Return the data of the criterion of one step, q of shape (n,), or of several."""
        problem = self.problem
        vectors = q, problem.lower, problem.upper, problem.residual_scale
        return RowData(problem.csr, self.absolute, *vectors, start=problem.nearest_to_zero)


ITERATIVE = ("npsor", "psor", "multigrid")
BLOCK = 64  # steps between two checks for Ctrl-C; results of earlier blocks are kept


class March(AnswerSequence[Result]):
    """The results of steps in time, in order; each is built when it is first read.

    Parameters
    ----------
    problem, forcing, propagator, z0 : problem, array of shape (k, n), csr_array of shape (n, n), array of shape (n,)
    keep : int
        The arguments of :func:`march`; keep 0 means the last step only.

    Attributes
    ----------
    z : list of arrays, shape (n,)
        The solution of each kept step.
    steps : list of int
        Number of each kept step, from 0; `taken` is the number of steps that were taken.
    all_solved : bool
        True if every step that was taken is SOLVED, and none was rejected or interrupted.
    error : LCPError or None
        Error of the q of the step that ended the march.
    seconds : float
        Wall-clock seconds of the march.
    """

    item = "step"
    all_solved = True

    def __init__(
        self,
        problem: Any,
        forcing: FloatVector,
        propagator: sp.csr_array,
        z0: FloatVector,
        keep: int = 1,
    ) -> None:
        self.problem, self.forcing, self.propagator, self.z0 = problem, forcing, propagator, z0
        self.keep, self.steps, self.taken = keep, list[int](), 0
        self.seconds = 0.0
        self.error: LCPError | None = None
        self.is_interrupted = False
        self.z: list[FloatVector] = []
        self._results: list[Result | Callable[[], Result]] = []

    def at(self, k: int) -> Result:
        """Return the result of step k."""
        found = self._results[k]
        if not isinstance(found, Result):
            found = self._results[k] = found()
        return found

    def __len__(self) -> int:
        return len(self.z)

    @property
    def status(self) -> list[Status]:
        """The status of each kept step; all but the last are SOLVED."""
        return [Status.SOLVED] * (len(self) - 1) + [one.status for one in self[-1:]]

    @property
    def algorithm(self) -> str:
        """Name of the algorithm of the last step."""
        return self[-1].algorithm if len(self) else "no step"

    def explain(self) -> str:
        """Return the number of steps by status, and the explanation of the last step."""
        last = f"the last step: {self[-1]}" if len(self) else ""
        return "\n".join(filter(None, [*self._summary(), last]))

    def _summary(self) -> list[str]:
        kept = f", {len(self)} kept" if len(self) < self.taken else ""
        found = f"{self.counts()}; {self.algorithm}, {self.seconds:.3g} s"
        steps = f"{self.taken} of {len(self.forcing)} steps{kept}: {found}"
        return [steps, *([f"ended by {self.error}"] if self.error else [])]

    def __repr__(self) -> str:
        return f"March({'; '.join(self._summary())})"

    def __getstate__(self) -> dict[str, Any]:
        """Build the results that were not read yet, because their builders cannot be pickled."""
        return {**self.__dict__, "_results": [self.at(k) for k in range(len(self))]}

    def take(self, z: FloatVector, result: Result | Callable[[], Result]) -> None:
        """Add one step; the step before it is dropped if it is not one of every `keep`."""
        if self.taken and (self.taken % self.keep if self.keep else True):
            del self.steps[-1], self.z[-1], self._results[-1]
        self.steps.append(self.taken)
        self.z.append(z)
        self._results.append(result)
        self.taken += 1


def take_steps_on_band(
    done: March, algorithm: str | Algorithm, wishes: dict[str, Any], limit: float
) -> None:
    """Take the steps of a march on a narrow band, until a time limit or an unsolved step."""
    problem, clock = done.problem, Clock()
    if not isinstance(problem, LCP) or not problem.n:
        return
    method, settings = parse_call(algorithm, wishes)
    begin = next(plan(problem, method, settings.goal))
    if (
        settings.record
        or settings.error_bound
        or settings.verbose
        or settings.max_iterations == 0
        or wishes.get("callback") is not None
        or not isinstance(begin.algorithm, Banded)
        or (band := bands(problem.matrix)) is None
        or connected_components(problem.matrix) is not None
    ):
        return
    steps, state = BandSteps(problem, band, done.propagator, settings), done.z0
    while done.taken < len(done.forcing) and clock.read() < limit:
        forcing = done.forcing[done.taken : done.taken + BLOCK]
        solved = steps.solve(forcing, state)
        for q, state in zip(*solved, strict=True):
            row, z = (q, state) if done.keep == 1 else (q.copy(), read_only(state.copy()))
            done.take(z, partial(_result_at, problem, row, z, settings))  # without its block
        if len(solved[0]) < len(forcing):
            break


def _result_at(problem: LCP, q: FloatVector, z: FloatVector, settings: Settings) -> Result:
    """Return the result of a step on a band, which is measured already."""
    stage = StageRecord(Banded.name, "M is a narrow band: many steps in one loop", 1, 1.0)
    return Result.at(problem.with_q(q), z, stage, settings)


def take_steps(
    done: March, algorithm: str | Algorithm, wishes: dict[str, Any], limit: float
) -> None:
    """Take the remaining steps of a march within a time limit, until one is not solved."""
    problem, propagator, total = done.problem, done.propagator, len(done.forcing)
    is_lcp, clock = isinstance(problem, LCP), Clock()
    state = done.z[-1] if done.z else done.z0
    begin: str | None = None  # the iteration that finished the step before
    while done.taken < total and done.all_solved:
        step = done.taken
        try:
            stated = problem.with_q(done.forcing[step] + propagator @ state)
            left = {} if limit == np.inf else {"max_seconds": max(limit - clock.read(), 0.0)}
            if is_lcp and begin is not None:
                within = parse_call("auto", {**wishes, **left})[1]
                near = checked_start(stated, state)
                found = run_on(
                    stated, None, within, near, Clock(), wishes.get("callback"), begin=begin
                )
            elif is_lcp:
                found = solve_lcp(stated, algorithm, z0=state, **{**wishes, **left})
            else:  # z° is not passed as a start, because over cones Newton's steps begin at a start
                start = {"z0": state} if (state != problem.nearest_to_zero).any() else {}
                found = solve(stated, algorithm, **{**wishes, **left, **start})
            done.all_solved = found.is_solved
            done.is_interrupted = found.status is Status.INTERRUPTED
            if is_lcp and algorithm == "auto" and found.is_solved and found.iterations:
                begin = beginning_of_next(found, step)
            done.take(found.z, found)
            state = found.z
        except InvalidProblem as error:
            if not done:
                raise
            done.error, done.all_solved = error, False


def beginning_of_next(found: Result, step: int) -> str | None:
    """Return the algorithm that finished this step and starts the next, or None for auto.

    The first step does not count, because it may start far from its solution.
    """
    last = found.stages[-1].name
    return last if step and last in ITERATIVE else None


def checked_rows(
    name: str, given: Any, shape: str, fits: Callable[[tuple[int, ...]], bool]
) -> FloatVector:
    """Return a finite array with a fitting shape."""
    need = f"{name} must be a finite array of shape {shape}"
    rows = real_array(given.toarray() if sp.issparse(given) else given, need)
    if not fits(rows.shape):
        raise InvalidProblem(f"{need}, got shape {rows.shape}")
    require_finite(rows, name)
    return rows


def checked_propagator(propagator: Any, n: int, name: str = "propagator") -> sp.csr_array:
    """Return the propagator as a finite matrix by rows; a number stands for a multiple of the identity."""
    if is_number(propagator):
        propagator = float(propagator) * sp.eye_array(n)
    return sp.csr_array(rectangular_matrix(propagator, name, n, n))


BOUNDS = "lower", "upper"
# options of `march`, not of `solve`
OF_MARCH = "problem", "forcing", "propagator", *BOUNDS, "algorithm", "keep"


@np.errstate(all="ignore")
def march(
    problem: LCP | Blocks | Sequence[LCP],
    forcing: ArrayLike,
    propagator: Any = -1.0,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    max_seconds: float | None = None,
    keep: int | str = 1,
    **wishes: Any,
) -> Any:
    """Return the results of steps in time: step j has q = forcing[j] + propagator @ z, z from the step before.

    If forcing, z0, lower or upper have an additional first axis, or if problem or propagator is a list, m marches run
    one after the other.

    Parameters
    ----------
    problem : LCP or ConeProblem or FrictionalContact, or a list of m LCPs
        Gives M and the bounds or cones; its q is not used. In a list, one problem per march.
    forcing : array, shape (k, n), or (m, k, n) for m marches
        One row per step; use ``np.broadcast_to(row, (k, n))`` for constant forcing.
    propagator : number or array or sparse array, shape (n, n), or a list of m of these
        Map from the z of one step to its contribution to the next q; a number means a multiple of the identity. An
        implicit Euler step (I + Δt A) z = z_before has −1.
    lower, upper : number or array, shape (n,) or (m, n), optional
        Replace the bounds of an LCP.
    z0 : array, shape (n,) or (m, n), optional
        The state before the first step; by default the point of [lower, upper] nearest to 0.
    max_seconds : float, optional
        Wall-clock limit in seconds for all marches together. The current step is then the last step.
    keep : int or "last"
        Steps that the result contains: every k-th step and the last, or the last only. Other steps are dropped as soon
        as the next step is taken, which saves memory; the derivative of a march needs all steps.
    algorithm, **wishes
        Other options of :func:`lcp_plugin.solve`, for each step.

    Returns
    -------
    March, or a list of m of them
        A sequence of k Results. The sequence is shorter after Ctrl-C, after a step that was not solved, or if the q of
        a step overflows (see ``error``). Ctrl-C and a callback also end the other marches.

    Raises
    ------
    InvalidOption, InvalidProblem, UnknownAlgorithm, UnsuitableProblem
        Before the first step.

    Notes
    -----
    Each step starts from the solution of the previous step, and has its own certificate. On narrow bands, for which
    `auto` uses `banded`, all steps run in one compiled loop, certificates included. Otherwise `auto` chooses in the
    first two steps; later steps start with the method that finished the previous step. If few rows have a bound,
    as in contact, the others are eliminated by one factorization for all steps, if that is cheaper. A march of 1000
    steps and 10⁴ unknowns takes 80 MB; for longer ones set `keep`.

    A θ-scheme for B ż + A z = f, (B + θ Δt A) z = (B − (1 − θ) Δt A) z_before + Δt f, has M = B + θ Δt A, the
    propagator (1 − θ) Δt A − B and the forcing −Δt f. Crank–Nicolson, θ = ½, is of order 2 after data with a kink only
    with damping: take four implicit half steps first, with the same M, the propagator −B and the forcing
    −½ Δt f (Rannacher 1984).

    Contacts with friction on elastic bodies: W has displacements by forces. A slow load determines, step by step, the
    gaps without contact and the tangential displacements from the step before. Use the propagator −W with zeros in the
    rows of the normals, because the slip is the tangential displacement of a step. If contacts change, W changes: use
    ``solve(FrictionalContact(W, b, friction), z0=result.z)`` for each step instead of `march`.

    References
    ----------
    R. Rannacher, *Finite element solution of diffusion problems with irregular data*, Numer. Math. 43 (1984),
    doi:10.1007/BF01390130.

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)  # cools in two steps, heated on the left
    >>> [z.round(3) for z in march(rod, [[-1, 0], [-1, 0]], z0=[1, 1]).z]
    [array([0.875, 0.625]), array([0.781, 0.469])]
    >>> [done.z[-1].round(3) for done in march(rod, [[-1, 0], [-1, 0]], z0=[1, 1], upper=[[1, 1], [0.5, 1]])]
    [array([0.781, 0.469]), array([0.5  , 0.333])]
    >>> stiffer = LCP([[4, -2], [-2, 4]], [0, 0], upper=1)
    >>> [done.z[-1].round(3) for done in march([rod, stiffer], [[-1, 0], [-1, 0]], z0=[1, 1])]
    [array([0.781, 0.469]), array([0.722, 0.528])]
    """
    of_states = lower, upper, z0
    is_list = isinstance(problem, (list, tuple))
    are_many = is_list or _is_one_a_march(propagator) or _axes(forcing) == 3
    are_many = are_many or 2 in map(_axes, of_states)
    problems: list[Any] = [*problem] if is_list else [problem]  # type: ignore[misc]
    if not problems:
        return []
    clock, limit = Clock(), Settings(max_seconds=max_seconds).max_seconds
    given = zip((*BOUNDS, "z0"), of_states, strict=True)
    states = {name: values for name, values in given if values is not None}
    marches = _begin(problems, forcing, propagator, states, algorithm, wishes, are_many=are_many)
    every = 0 if keep == "last" else whole_number(keep, "keep", 1, ', or "last"')
    for k, one in enumerate(marches):
        one.keep, begun = every, clock.read()
        try:
            take_steps_on_band(one, algorithm, wishes, limit - clock.read())
            take_steps(one, algorithm, wishes, max(limit - clock.read(), 0.0))
        except KeyboardInterrupt:
            if not one.taken:
                raise
            one.is_interrupted, one.all_solved = True, False
        one.seconds = clock.read() - begun
        if one.is_interrupted:
            for later in marches[k + 1 :]:
                later.all_solved = not len(later.forcing)
            break
    return marches if are_many else marches[0]


def _axes(values: Any) -> int:
    """Return the number of axes of an argument."""
    try:
        return np.ndim(values)
    except ValueError:  # rows of different lengths, which later raise InvalidProblem
        return 0


def _begin(
    problems: list[Any],
    forcing: ArrayLike,
    propagator: Any,
    states: dict[str, Any],
    algorithm: str | Algorithm,
    wishes: dict[str, Any],
    *,
    are_many: bool,
) -> list[March]:
    """Return the marches before their first steps; raise an error for invalid data."""
    n = getattr(problems[0], "n", 0)
    for j, one in enumerate(problems):
        if not takes("march", one):
            raise InvalidOption(refusal("march", one))
        if not isinstance(one, LCP) and states.keys() - {"z0"}:
            raise InvalidOption(
                f"lower and upper of a march are bounds of an LCP; a {class_of(one)} has none"
            )
        if one.n != n:
            raise InvalidProblem(
                f"all problems must have one size, got n = {n}, and {one.n} of problem {j}; "
                "call march once per size"
            )
    if algorithm == "auto" and (unknown := [name for name in wishes if name not in OF_SOLVE]):
        raise InvalidOption(
            f"march has no option {unknown[0]!r}{did_you_mean(unknown[0], (*OF_MARCH, *OF_SOLVE))}"
        )
    shape = "(m, k, n), or (k, n) for all marches" if are_many else "(k, n), a row a step"
    axes = (2, 3) if are_many else (2,)
    given = checked_rows(
        "forcing", forcing, f"{shape}, n = {n}", lambda of: len(of) in axes and of[-1] == n
    )
    each = propagator if _is_one_a_march(propagator) else [propagator]
    several: dict[str, Any] = {
        "problem": problems,
        "forcing": [given] if given.ndim == 2 else list(given),
        "propagator": [checked_propagator(C, n) for C in each],
    }
    for name, values in states.items():
        several[name] = rows_of_a_batch(values, name, n) if are_many else [values]
    if isinstance(problems[0], LCP):
        parse_call(algorithm, wishes)
    lengths = {name: len(one) for name, one in several.items() if len(one) != 1}
    marches: list[March] = []
    for j in range(length_of_all(lengths)):
        own = {name: one[min(j, len(one) - 1)] for name, one in several.items()}
        stated, bounds = own["problem"], {name: own[name] for name in BOUNDS if name in own}
        stated = stated.with_q(stated.q, **bounds) if bounds else stated
        state = checked_vector(own["z0"], "z0", n) if "z0" in own else stated.nearest_to_zero
        marches.append(March(stated, own["forcing"], own["propagator"], state))
    return marches


def _is_one_a_march(propagator: Any) -> bool:
    """Return whether the argument is a sequence of propagators: sparse arrays, or a batch axis."""
    if sp.issparse(propagator) or is_number(propagator):
        return False
    if isinstance(propagator, (list, tuple)) and any(map(sp.issparse, propagator)):
        return True
    return _axes(propagator) in (1, 3)  # numbers, or matrices
