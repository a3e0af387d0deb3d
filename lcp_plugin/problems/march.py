"""Time stepping: one matrix, and a q that depends on the solution of the previous step.

On a narrow band, steps are solved one after the other, and checked in blocks. M may be tridiagonal with off-diagonal
entries ≤ 0 and bounds on one side only, as in an American option. Each step is then one pass of
:func:`~lcp_plugin.methods.banded.solve_one_sided`. On other bands a step runs
:func:`~lcp_plugin.methods.banded.active_sets`.

The derivative of a run is the chain of its steps, forwards or backwards. With q_k = f_k + C z_{k−1} each step passes on
dq_k = df_k + dC z_{k−1} + C dz_{k−1}. Backwards, a function L of all z has g_k = ∂L/∂z_k + Cᵀ ∂L/∂q_{k+1}, from which
the derivative of the step computes ∂L/∂q_k. The gradients by M, C and the bounds are summed over the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property, partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core import checks
from ..core.algorithm import Algorithm
from ..core.checks import AnyMatrix, Array, BoolVector, Vector, derived_property, read_only
from ..core.deadline import Clock
from ..core.entries import row_numbers
from ..core.errors import (
    InvalidOption,
    InvalidProblem,
    LCPError,
    NotConverged,
    UnsuitableProblem,
    did_you_mean,
)
from ..core.kernels.floats import EPSILON, MAY_UNDERFLOW
from ..core.lcp import LCP
from ..core.matrix import Matrix
from ..core.problem_classes import class_of, classes_of, refusal, with_article
from ..core.settings import OF_SOLVE, Settings, Status, whole_number
from ..core.structure import connected_components
from ..judges.lcp import Measured, RowData
from ..methods.banded import Banded, active_sets, held_entries, solve_held, solve_one_sided
from ..solving.dispatch import options_of, parse_call, solve
from ..solving.lcp_run import run_on
from ..solving.lcp_solver import solve_lcp
from ..solving.plan import plan, repeated
from ..solving.result import Result, StageRecord
from ..solving.run import Stage
from ..systems.factors import BANDED_UP_TO, Bands, bands
from ..systems.graph import bandwidth, outer_on_pattern, sum_of_outer
from .many import AnswerSequence
from .nonlinear.data import NonlinearProblem


def propagation(C: sp.csr_array) -> Callable[[Vector], Vector]:
    """Return the function C z, for each row of z; if C is diagonal, a product of vectors."""
    if np.array_equal(C.indices, row_numbers(C)):
        diagonal: Vector = C.diagonal()
        return lambda z: diagonal * z
    return lambda z: np.asarray((C @ z.T).T)


class BandSteps:
    """The steps of a march on a narrow band.

    Parameters
    ----------
    done : March
        Gives the matrix, the bounds and the propagator.
    band : Bands
        Bands of the matrix.
    settings : Settings
    """

    def __init__(self, done: March, band: Bands, settings: Settings) -> None:
        self.done, self.band, self.propagate = done, band, propagation(done.propagator)
        self.settings, self.absolute = settings, abs(done.problem.csr)
        self.none = read_only(np.zeros(done.problem.n, np.bool_))

    def solve(self, block: slice, state: Vector) -> tuple[Vector, Vector]:
        """Return q and z of the first of these steps that meet the criterion from this state, shapes (k, n).

        Parameters
        ----------
        block : slice
            The numbers of the steps.
        state : array, shape (n,)
        """
        forcing, problem = self.done.forcing[block], self.done.problem
        Q, Z = np.empty(forcing.shape), np.empty(forcing.shape)
        fixed = read_only(Q)
        for k, f in enumerate(forcing):
            Q[k] = f + self.propagate(state)
            stated = self.done.problems[block.start + k]
            z = self._step(stated, fixed[k], state)
            if z is None:
                Q, Z = Q[:k], Z[:k]
                break
            state = Z[k] = z
        bounds = self.done.bounds_of(slice(block.start, block.start + len(Q)))
        data = RowData(problem.csr, self.absolute, Q, *bounds, problem.residual_scale)
        measured = data.measure(Z, self.settings.tolerance)
        passes, moves = measured.passes, (measured.z != Z).any(axis=1)
        count = len(Q) if passes.all() else int(np.argmin(passes))
        if moves[:count].any():  # later steps were computed from the point before it was moved
            count = int(np.argmax(moves)) + 1
        return Q[:count], read_only(measured.z)[:count]

    def _step(self, problem: LCP, q: Vector, state: Vector) -> Vector | None:
        """Return the solution of one step with the bounds of a problem; None if a limit ends its iterations."""
        lower, upper = problem.lower, problem.upper
        side = int(np.isinf(upper).all()) or -int(np.isinf(lower).all())
        if side and self.band.is_tridiagonal_z:
            value = lower if side > 0 else upper
            x = solve_one_sided(self.band.entries, q, side, value, self.none)[0]
            return None if x is None else np.clip(x, lower, upper)
        reference = next(active_sets(problem, self.band, q, problem.nearest_to_zero))[1]
        goal = 0.5 * self.settings.tolerance * reference
        rounds = active_sets(problem, self.band, q, np.clip(state, lower, upper))
        rounds = islice(rounds, self.settings.max_iterations)
        return next((z for z, residual in rounds if residual <= goal), None)


StepDerivative = Any  # Derivative of sensitivity.py, which imports this file
STEPS_TOGETHER = 64  # steps between two checks for Ctrl-C; results of earlier blocks are kept


class March(AnswerSequence[Result]):
    """The results of steps in time, in order; each is built when it is first read.

    Parameters
    ----------
    problem, forcing, propagator, z0 : problem, array of shape (k, n), csr_array of shape (n, n), array of shape (n,)
        `problem` is the problem of the first step.
    problems : sequence of k problems

    Attributes
    ----------
    keep : int
        The argument of :func:`march`; 0 means the last step only.
    z : array, shape (k, n)
        The solution of each kept step, a row each.
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
        problems: Sequence[Any],
        forcing: Vector,
        propagator: sp.csr_array,
        z0: Vector,
    ) -> None:
        self.problem, self.forcing, self.propagator, self.z0 = problem, forcing, propagator, z0
        self.problems, self.keep, self.steps, self.taken = problems, 1, list[int](), 0
        self.seconds = 0.0
        self.error: LCPError | None = None
        self.is_interrupted = False
        self._z: list[Vector] = []
        self._results: list[Result | Callable[[], Result]] = []

    @property
    def has_own_matrices(self) -> bool:
        """True if the matrices of LCPs change."""
        matrices = [getattr(problem, "matrix", None) for problem in self.problems]
        return any(matrix is not matrices[0] for matrix in matrices)

    def bounds_of(self, steps: slice) -> tuple[Vector, Vector]:
        """Return the bounds of some steps, shape (n,) if they are constant, else a row per step."""
        problem, problems = self.problem, self.problems[steps]
        if all(one is problem for one in problems):
            return problem.lower, problem.upper
        return np.array([one.lower for one in problems]), np.array([one.upper for one in problems])

    def at(self, k: int) -> Result:
        """Return the result of step k."""
        result = self._results[k]
        if not isinstance(result, Result):
            result = self._results[k] = result()
        return result

    def __len__(self) -> int:
        return len(self._z)

    @cached_property
    def z(self) -> Vector:
        """The solution of each kept step, shape (k, n)."""
        z = read_only(np.reshape(self._z, (len(self), self.z0.size)))
        self._z = [*z]  # views
        return z

    @property
    def status(self) -> list[Status]:
        """The status of each kept step; all but the last are SOLVED."""
        return [Status.SOLVED] * (len(self) - 1) + [result.status for result in self[-1:]]

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
        outcome = f"{self.counts()}; {self.algorithm}, {self.seconds:.3g} s"
        steps = f"{self.taken} of {len(self.forcing)} steps{kept}: {outcome}"
        return [steps, *([f"ended by {self.error}"] if self.error else [])]

    def __repr__(self) -> str:
        return f"March({'; '.join(self._summary())})"

    def __getstate__(self) -> dict[str, Any]:
        """Build the results that were not read yet, because their builders cannot be pickled."""
        return vars(self) | {"_results": [self.at(k) for k in range(len(self))]}

    def take(self, z: Vector, result: Result | Callable[[], Result]) -> None:
        """Add one step; the step before it is dropped if it is not one of every `keep`."""
        if self.taken and (self.taken % self.keep if self.keep else True):
            del self.steps[-1], self._z[-1], self._results[-1]
        self.steps.append(self.taken)
        self._z.append(z)
        self._results.append(result)
        self.taken += 1


def take_steps_on_band(done: March, algorithm: Any, options: dict[str, Any], clock: Clock) -> None:
    """Take the steps of a march on a narrow band, until a time limit or an unsolved step."""
    problem = done.problem
    if not isinstance(problem, LCP) or not problem.n or done.has_own_matrices:
        return
    method, settings = parse_call(algorithm, options)
    is_watched = settings.record or settings.verbose
    if is_watched or settings.max_iterations == 0 or options.get("callback") is not None:
        return
    begin = next(plan(problem, method, settings.goal))
    is_banded = isinstance(begin.algorithm, Banded) and connected_components(problem.matrix) is None
    band = bands(problem.matrix) if is_banded else None
    if band is None:
        return
    steps, state = BandSteps(done, band, settings), done.z0
    while done.taken < len(done.forcing) and clock.left:
        block = slice(done.taken, min(done.taken + STEPS_TOGETHER, len(done.forcing)))
        solved = steps.solve(block, state)
        for q, state in zip(*solved, strict=True):
            row, z = (q, state) if done.keep == 1 else (q.copy(), read_only(state.copy()))
            stated = done.problems[done.taken]
            done.take(z, partial(_result_at, stated, row, z, settings))  # without its block
        if done.taken < block.stop:
            break


def _result_at(problem: LCP, q: Vector, z: Vector, settings: Settings) -> Result:
    """Return the result of a step on a band, which is measured already."""
    stage = StageRecord(Banded.name, "M is a narrow band: many steps in one loop", 1, 1.0)
    point = Measured(z, 0.0, passes=True)
    return Result.of(problem.with_q(q), point, [stage], settings)


def take_steps(done: March, algorithm: Any, options: dict[str, Any], clock: Clock) -> None:
    """Take the remaining steps of a march within a time limit, until one is not solved."""
    problem, propagator, total = done.problem, done.propagator, len(done.forcing)
    is_lcp = isinstance(problem, LCP)
    state = done._z[-1] if done._z else done.z0
    first: Stage | None = None  # the method that solved the step before
    while done.taken < total and done.all_solved:
        step, left = done.taken, clock.left
        try:
            stated = done.problems[step].with_q(done.forcing[step] + propagator @ state)
            call = {**options, "max_seconds": left}
            if is_lcp and first is not None:
                within, watch = parse_call("auto", call)[1], call.get("callback")
                near = checks.checked_start(stated, state)
                result = run_on(stated, None, within, near, Clock(left), watch, first)
            elif is_lcp:
                result = solve_lcp(stated, algorithm, z0=state, **call)
            else:  # z° is not passed as a start, because over cones Newton's steps begin at a start
                if (state != problem.nearest_to_zero).any():
                    call["z0"] = state
                result = solve(stated, algorithm, **call)
            done.all_solved = result.is_solved
            done.is_interrupted = result.status is Status.INTERRUPTED
            if is_lcp and algorithm == "auto" and result.is_solved and result.iterations:
                # The first step does not count, because it may start far from its solution.
                first = repeated(result.stages[-1]) if step else None
            done.take(result.z, result)
            state = result.z
            if not left and result.is_solved and done.taken < total:  # it began at its solution
                done.error, done.all_solved = NotConverged("the limit max_seconds"), False
        except InvalidProblem as error:
            if not done:
                raise
            done.error, done.all_solved = error, False


def checked_rows(name: str, values: Any, shape: str, fits: Callable[[Any], bool]) -> Vector:
    """Return a finite array with a fitting shape."""
    need = f"{name} must be a finite array of shape {shape}"
    rows = checks.real_array(values.toarray() if sp.issparse(values) else values, need)
    if not fits(rows.shape):
        raise InvalidProblem(f"{need}, got shape {rows.shape}")
    checks.require_finite(rows, name)
    return rows


def checked_propagator(propagator: AnyMatrix, n: int, name: str = "propagator") -> sp.csr_array:
    """Return the propagator as a finite matrix by rows; a number stands for a multiple of the identity."""
    if checks.is_number(propagator):
        propagator = float(propagator) * sp.eye_array(n)
    return sp.csr_array(checks.rectangular_matrix(propagator, name, n, n))


@np.errstate(all="ignore")
def march(
    problem: Any,
    forcing: ArrayLike,
    propagator: object = -1.0,
    *,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    max_seconds: float | None = None,
    keep: int | str = 1,
    **options: Any,
) -> March:
    """Return the results of steps in time: step j has q = forcing[j] + propagator @ z, z from the step before.

    Parameters
    ----------
    problem : LCP or NonlinearProblem or ConeProblem or FrictionalContact, or a sequence of k of these
        Gives M and the bounds or cones; its q is not used. A NonlinearProblem gives F, to which the q of a step is
        added. If M, F or bounds change from step to step, a problem per step, of one class and size. For bounds of the
        steps write ``[problem.with_data(lower=row) for row in rows]``, as for the dates of a Bermudan option (−∞
        between them) or an obstacle that moves. Steps with the same matrix share its factors.
    forcing : array, shape (k, n)
        One row per step; use ``np.broadcast_to(row, (k, n))`` for constant forcing.
    propagator : number or array or sparse array, shape (n, n)
        Map from the z of one step to its contribution to the next q; a number means a multiple of the identity. An
        implicit Euler step (I + Δt A) z = z_before has −1. A FrictionalContact needs an array, see the notes.
    z0 : array, shape (n,), optional
        The state before the first step; by default the point of the bounds of the first step nearest to 0.
    max_seconds : float, optional
        Wall-clock limit in seconds. The current step is then the last step.
    keep : int or "last"
        Steps that the result contains: every k-th step and the last, or the last only. Other steps are dropped as soon
        as the next step is taken, which saves memory; the derivative of a march needs all steps.
    algorithm, **options
        Other options of :func:`lcp_plugin.solve`, for each step.

    Returns
    -------
    March
        A sequence of k Results. The sequence is shorter after Ctrl-C, after a step that was not solved, or if the q of
        a step overflows (see ``error``).

    Raises
    ------
    InvalidOption, InvalidProblem, UnknownAlgorithm, UnsuitableProblem
        Before the first step.

    Notes
    -----
    Each step starts from the solution of the previous step, and has its own certificate. On narrow bands, for which
    `auto` uses `banded`, a step is one banded solve or a few, and many steps are certified at once. Otherwise `auto`
    chooses in the first two steps; later steps start with the method that finished the step before. If few rows have
    a bound, as in contact, the others are eliminated by one factorization for all steps, if that is cheaper. A march
    of 1000 steps and 10⁴ unknowns takes 80 MB; for longer ones set `keep`.

    A θ-scheme for B ż + A z = f, (B + θ Δt A) z = (B − (1 − θ) Δt A) z_before + Δt f, has M = B + θ Δt A, the
    propagator (1 − θ) Δt A − B and the forcing −Δt f. Crank–Nicolson, θ = ½, is of order 2 after data with a kink only
    with damping: take four implicit half steps first, with the same M, the propagator −B and the forcing
    −½ Δt f (Rannacher 1984).

    Nonlinear: an implicit Euler step of B ẋ + F(x) solves B x + Δt F(x) − B x_before, complementary to the bounds.
    Let ``NonlinearProblem`` be B x + Δt F(x), and −B the propagator.

    Contacts with friction on elastic bodies: W has displacements by forces. A slow load determines, step by step, the
    gaps without contact and the tangential displacements from the step before. Use the propagator −W with zeros in the
    rows of the normals, because the slip is the tangential displacement of a step. For moving bodies, or if W changes,
    call ``step.solve(b=b, W=W, warm=True)`` of ``step = prepare(problem)`` for each step instead of `march`.

    References
    ----------
    R. Rannacher, *Finite element solution of diffusion problems with irregular data*, Numer. Math. 43 (1984),
    doi:10.1007/BF01390130.

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)  # cools in two steps, heated on the left
    >>> march(rod, [[-1, 0], [-1, 0]], z0=[1, 1]).z.round(3)
    array([[0.875, 0.625],
           [0.781, 0.469]])
    >>> held = rod.with_data(lower=[0, 0.6])  # in the second step
    >>> march([rod, held], [[-1, 0], [-1, 0]], z0=[1, 1]).z.round(3)
    array([[0.875, 0.625],
           [0.825, 0.6  ]])

    ẋ = −x³ in steps of ½, for x ≥ 0.6:

    >>> steps = march(NonlinearProblem(lambda x: x + 0.5 * x**3, lower=0.6), np.zeros((3, 1)), z0=[1.0])
    >>> steps.z.ravel().round(4)
    array([0.7709, 0.6399, 0.6   ])
    """
    clock = Clock(Settings(max_seconds=max_seconds).max_seconds)
    every = 0 if keep == "last" else whole_number(keep, "keep", 1, ', or "last"')
    done = _begin(problem, forcing, propagator, z0, algorithm, options)
    done.keep = every
    try:
        take_steps_on_band(done, algorithm, options, clock)
        take_steps(done, algorithm, options, clock)
    except KeyboardInterrupt:
        if not done.taken:
            raise
        done.is_interrupted, done.all_solved = True, False
    done.seconds = clock.read()
    return done


def _begin(
    problem: Any, forcing: Any, propagator: Any, z0: Any, algorithm: Any, options: dict[str, Any]
) -> March:
    """Return the march before its first step; raise an error for invalid data."""
    stated = problem if isinstance(problem, (list, tuple)) and problem else [problem]
    first, name = stated[0], str(class_of(stated[0]))
    if name not in classes_of("march"):
        raise InvalidOption(refusal("march", first))
    if wrong := options.keys() & {"lower", "upper", "lower_at", "upper_at", "M_at", "F_at"}:
        raise InvalidOption(
            f"march has no option {min(wrong)!r}: M, F and bounds are of the problem, or of a list with a problem per "
            "step; write [problem.with_data(lower=row) for row in rows]"
        )
    # no options of solve
    others = ("problem", "forcing", "propagator", "z0", "algorithm", "keep")
    known = {*OF_SOLVE, *options_of(name)} - {"x0", "options"}
    if algorithm == "auto" and (unknown := [name for name in options if name not in known]):
        hint = did_you_mean(unknown[0], (*others, *sorted(known)))
        raise InvalidOption(f"march has no option {unknown[0]!r}{hint}")
    n = first.n
    need = "(k, n), a row per step" + ("" if n is None else f", n = {n}")
    force = checked_rows("forcing", forcing, need, lambda of: len(of) == 2 and n in (None, of[1]))
    k, n = force.shape
    if stated is problem:
        _check_count("problem", problem, k)
    for step, one in enumerate(stated):
        if class_of(one) != name or one.n not in (None, n):
            got = f"{type(one).__name__} with n = {getattr(one, 'n', None)}"
            raise InvalidProblem(
                f"problem[{step}] must be {with_article(name)}, n = {n}, got {got}"
            )
    problems = [one.with_size(n) if one.n is None else one for one in stated]
    if name == "FrictionalContact" and checks.is_number(propagator) and propagator:
        raise InvalidOption(
            f"march of a FrictionalContact needs an array as propagator, see help(march), got {propagator}; for "
            "moving bodies call step.solve(b=…) of step = prepare(problem) in a loop"
        )
    C = checked_propagator(propagator, n)
    if name == "LCP":
        parse_call(algorithm, options)
    first = problems[0]
    state = first.nearest_to_zero if z0 is None else checks.checked_vector(z0, "z0", n)
    return March(first, problems if stated is problem else problems * k, force, C, state)


def _check_count(name: str, values: Any, k: int) -> None:
    """Raise InvalidProblem unless a sequence has an entry per step."""
    if (count := len(values)) != k:
        raise InvalidProblem(
            f"{name} must have one entry per step, {k} for {k} rows of forcing, got {count}"
        )


# solutions, rows at their lower and at their upper bounds, degenerate rows, and whether these are certain
Settled = tuple[Vector, NDArray[np.bool_], BoolVector, bool]
LEFT = 2.0**-20  # relative to the last change: bound of the remaining error
CLEAR = 64.0  # times the rounding error


class Band(NamedTuple):
    """Matrix of a march on a narrow band, its bands, and propagator; possibly transposed."""

    M: sp.csr_array
    size: sp.csr_array
    entries: Bands
    propagate: Callable[[Vector], Vector]

    @classmethod
    def of(cls, matrix: Matrix, propagator: sp.csr_array) -> Band | None:
        """Return the band of a matrix, or None if it is not narrow."""
        width = sum(bandwidth(matrix) or (matrix.n, matrix.n))
        if width > BANDED_UP_TO or (entries := bands(matrix)) is None:
            return None
        return cls(matrix.csr, abs(matrix.csr), entries, propagation(propagator))

    def follow(
        self, is_held: BoolVector, value: Vector, right: Vector, before: Vector
    ) -> tuple[Vector, Vector, Vector] | None:
        """Return x, w = M x + r and the rounding error of w of consecutive steps, r = right + C before.

        `before` is the x of the step before. x is `value` on held rows; the other rows are free and satisfy
        w = 0. The rounding error is relative to the row weights. The result is None if a block of free rows is nearly
        singular, because its residual exceeds the rounding error, or its terms cancel.

        Parameters
        ----------
        is_held, value, right : arrays, shape (k, n)
        before : array, shape (n,)

        Returns
        -------
        x, w : array, shape (k, n)
        rounding : array, shape (k,)
        """
        x, unit, is_free = np.empty(right.shape), self.entries.weights, ~is_held
        values, weights = np.where(is_free, -right * unit, value), np.where(is_free, unit, 0.0)
        last = before
        for k, entries in enumerate(held_entries(self.entries, is_held)):
            right_side = values[k] - weights[k] * self.propagate(last)
            if (solution := solve_held(entries, self.entries.below, right_side)) is None:
                return None
            last = x[k] = solution
        right = right + self.propagate(np.array([before, *x[:-1]]))
        w, size = (self.M @ x.T).T + right, ((self.size @ np.abs(x).T).T + np.abs(right)) * unit
        total = np.abs((self.M @ np.where(is_free, 0.0, x).T).T + right) * unit
        sizes = size, total, np.abs(w) * unit
        terms, total, residual = (rows.max(axis=1, initial=0.0, where=is_free) for rows in sizes)
        # Otherwise the block is nearly singular
        is_regular = (residual <= 2.0**-40 * terms) & (terms <= 2.0**40 * total)
        return (x, w, EPSILON * terms) if is_regular.all() else None


class Steps:
    """Consecutive steps of a march; `steps` is the slice of their numbers.

    On a narrow band each solution is first computed again on its free rows, and its rows are classified: at the lower
    bound, at the upper bound, else free; degenerate at a bound with w = 0. Each step is passed to its Derivative if
    rounding error leaves rows of a step undecided, or if a free block is nearly singular.

    Parameters
    ----------
    whole : MarchDerivative
    first : int
        The number of the first step.
    states : array, shape (count + 1, n)
        The state before the first step, and the solutions.
    """

    @np.errstate(all="ignore")
    def __init__(self, whole: MarchDerivative, first: int, states: Vector) -> None:
        self.whole, self.march, self.states = whole, whole.march, states
        march, count = whole.march, len(states) - 1
        self.steps = slice(first, first + count)
        self.q = march.forcing[self.steps] + (march.propagator @ states[:-1].T).T
        if first not in whole.settled:
            whole.settled[first] = self._settle(whole.band)
        z, self.at_bounds, self.kinks, self.is_plain = whole.settled[first]
        self.z = z.copy()

    def __len__(self) -> int:
        return len(self.states) - 1

    def _settle(self, band: Band | None) -> Settled:
        """Solve each step on its free rows once; return the solutions, the states of rows, and if active sets stay.

        Without a band, they count as not decided.
        """
        problem, z = self.march.problem, self.states[1:]
        change = before = at_bounds = np.zeros((2, *z.shape), np.bool_)
        if band is None:
            return z, at_bounds, at_bounds[0], False
        lower, upper = self.march.bounds_of(self.steps)
        scale, is_fixed = problem.residual_scale, lower == upper
        for is_last in (False, True):
            w, size = (band.M @ z.T).T + self.q, (band.size @ np.abs(z).T).T + np.abs(self.q)
            above, below = z - lower, upper - z
            nearest = np.minimum(above, below) * scale
            is_negligible = (nearest < MAY_UNDERFLOW) & (np.abs(w) < MAY_UNDERFLOW)
            rules = is_fixed, is_negligible, above * scale <= w
            at_upper = np.select(rules, (w < 0.0, below < above, False), -below * scale >= w)
            at_lower = (is_fixed | is_negligible | rules[2]) & ~at_upper
            at_bounds = np.stack([at_lower, at_upper])
            if is_last:
                break
            before, is_held = at_bounds, np.logical_or(at_lower, at_upper)
            value = np.where(at_upper, upper, lower)
            right = np.where(is_held, value - z, -w * band.entries.weights)
            entries = np.concatenate([*held_entries(band.entries, is_held)], axis=1)
            step = solve_held(entries, band.entries.below, right.ravel())
            if step is None:
                return z, at_bounds, at_upper, False
            step = step.reshape(z.shape)
            change, z = np.abs(step), np.where(is_held, value, z + step)
        size *= EPSILON * (np.diff(band.M.indptr) + 1)
        near, slight = size + LEFT * change * scale, size + LEFT * (band.size @ change.T).T
        is_clear = (nearest > CLEAR * near) | (np.abs(w) > CLEAR * slight) | is_fixed
        is_kink = is_negligible | ((np.maximum(nearest, np.abs(w)) <= size) & ~is_clear)
        is_plain = bool(((at_bounds == before).all(axis=0) & (is_clear | is_kink)).all())
        is_kink &= ~is_fixed
        nearer = np.stack([above <= below, below < above])
        return z, np.where(is_kink, nearer, at_bounds), is_kink, is_plain

    def at(self, k: int) -> StepDerivative:
        """Return the derivative of a step by the data of the step."""
        result = self.march[self.steps.start + k]
        problem = result.certificate.problem
        # The last factorization is used again if it fits
        before = self.whole.before
        before = before if before and before.problem.matrix is problem.matrix else None
        step = self.whole.derivative_at(problem, result.z, result.w, before=before)
        self.whole.before = step
        return step

    def degenerate(self, k: int) -> NDArray[np.intp]:
        """Return the degenerate rows of a step."""
        return np.flatnonzero(self.kinks[k]) if self.is_plain else self.at(k).degenerate

    def jvp(
        self, dM: list[Any], dC: AnyMatrix, df: Vector, low: Vector, high: Vector, before: Vector
    ) -> Vector:
        """Return the changes of the solutions for changes of M, propagator, forcing and bounds, a row per step.

        At the call, `before` is the change of the state before the first step; the last change is written to it.
        """
        h = df + (dC @ self.states[:-1].T).T
        value = np.select([*self.at_bounds], [low, high])

        def solve_alone(k: int, before: Vector) -> Vector:
            alone = self.at(k)
            dq = h[k] + self.march.propagator @ before + dM[k] @ alone.z
            return alone.jvp(dq=dq, dlower=low[k], dupper=high[k])

        forwards = np.arange(len(self))
        right = h + np.array([change @ z for change, z in zip(dM, self.z, strict=True)])
        dz, _ = self._follow(self.whole.band, forwards, value, right, before, solve_alone)
        before[:] = dz[-1]
        return dz

    def vjp(self, g: Vector, after: Vector, of_bounds: Vector) -> Vector:
        """Return the gradients by q, and write the gradients by the bounds of each step to `of_bounds`.

        `after` is the gradient by q of the next step (0 if there is none), and is overwritten by the gradient of
        the first of these steps.
        """

        def solve_alone(k: int, after: Vector) -> Vector:
            alone = self.at(k)
            gradient = alone.vjp(g[k] + self.march.propagator.T @ after)
            self.z[k] = alone.z
            of_bounds[:, k] = gradient.lower, gradient.upper
            return np.asarray(gradient.q)

        order, none = np.arange(len(self))[::-1], np.zeros(g.shape)
        by_q, w = self._follow(self.whole.transposed, order, none, g[order], after, solve_alone)
        of_bounds[:, order] += w * self.at_bounds[:, order]
        after[:] = by_q[-1]
        return by_q[order]

    def _follow(
        self, band: Any, order: Any, value: Vector, right: Vector, before: Vector, solve_alone: Any
    ) -> tuple[Vector, Vector]:
        """Return x and w of the steps in this order, on the band if that decides, else one by one, with w = 0.

        Forwards, a degenerate row stays at its bound if its slack agrees; backwards, any piece is a gradient.
        """
        if band is not None and self.is_plain:
            at_bounds = self.at_bounds[:, order]
            path = band.follow(at_bounds.any(axis=0), value, right, before)
            if path is not None:
                x, w, rounding = path
                signed = np.where(at_bounds[1], w, -w) * band.entries.weights
                is_kink = self.kinks[order] & (order[-1] >= order[0])
                if not (is_kink & (signed > rounding[:, np.newaxis])).any():
                    return x, w
        x = np.empty(right.shape)
        for k, step in enumerate(order.tolist()):
            before = x[k] = solve_alone(step, before)
        return x, np.zeros(right.shape)


class MarchGradient(NamedTuple):
    """Gradient of a function of all steps in time, with respect to the data.

    Attributes
    ----------
    z0, lower, upper : array, shape (n,)
        Gradients by the state before the first step, also for the default z0, and by the bounds of all steps.
    M, propagator : csr_array, shape (n, n)
        Gradients by the entries of M and the propagator, on their sparsity patterns. For a number as propagator, use
        the sum of the diagonal. If matrices change, M is a list of the gradients by the matrix of each step. For
        a NonlinearProblem, M has no entries.
    forcing, lower_at, upper_at : array, shape (k, n)
        Gradients by the forcing and the bounds of each step.
    """

    z0: Vector
    lower: Vector
    upper: Vector
    M: AnyMatrix
    propagator: sp.csr_array
    forcing: Vector
    lower_at: Vector
    upper_at: Vector


class MarchDerivative:
    """The derivative of all steps in time with respect to M, forcing, propagator, z0 and bounds.

    Item k is the :class:`~lcp_plugin.problems.sensitivity.Derivative` of step k by the q of the step, with its proofs.

    Parameters
    ----------
    march : March
    each : callable
        Returns the Derivative of a problem at its z and w.

    Raises
    ------
    UnsuitableProblem
        If the march was not solved to its end.

    Notes
    -----
    A step on a narrow band is one banded system. The steps of a block of 64 are passed to their Derivatives if rows of
    a step are nearly degenerate or a free block is nearly singular, and for other matrices.
    """

    def __init__(self, march: March, each: Callable[..., StepDerivative]) -> None:
        if march.keep != 1:
            raise UnsuitableProblem(
                f"keep={march.keep or 'last'} dropped steps that the derivative of a march needs; leave out keep"
            )
        if not (march.all_solved and len(march) == len(march.forcing)):
            last = march[-1]
            ended = "was the last one taken" if last.is_solved else f"ended {last.status.name}"
            raise UnsuitableProblem(
                f"only a march solved to its end has a derivative; it took {len(march)} of {len(march.forcing)} steps, "
                f"and step {len(march) - 1} {march.error or ended}; take derivative(march[k]) of single steps, "
                "or march along fewer of them"
            )
        self.march, self.derivative_at = march, each
        self.before: StepDerivative | None = None  # of the last step
        # By the first step of a block: as much memory as the march, a quarter of the time of further directions.
        self.settled: dict[int, Settled] = {}

    def __len__(self) -> int:
        return len(self.march)

    def __getitem__(self, k: int) -> StepDerivative:
        result = self.march[k]
        return self.derivative_at(result.certificate.problem, result.z, result.w)

    @derived_property
    def degenerate(self) -> NDArray[np.intp]:
        """Pairs of a step and a row at a bound with w = 0, up to rounding error; shape (count, 2).

        Rows without a bound that only prescribe z, such as boundary values as identity rows, do not count.
        """
        pairs = [np.empty((0, 2), np.intp)]
        for part in self._parts():
            for k in range(len(part)):
                rows = part.degenerate(k)
                pairs.append(np.column_stack([np.full(rows.size, part.steps.start + k), rows]))
        return np.concatenate(pairs)

    @derived_property
    def is_unique(self) -> bool | None:
        """True if the derivative of each step exists, at its q: see ``Derivative``.

        True if this is proved for all steps, False if rows of a step are degenerate, otherwise None.
        """
        if self.degenerate.size:
            return False
        return True if all(self[k].is_unique for k in range(len(self))) else None

    @checks.changes_by_name
    def jvp(
        self,
        *,
        dM: AnyMatrix = None,
        dforcing: Array = None,
        dpropagator: object = None,
        dz0: Array = None,
        dlower: Array = None,
        dupper: Array = None,
        only_last: bool = False,
    ) -> Vector:
        """Return the changes dz of the solutions for changes of the data; one-sided at a kink.

        Parameters
        ----------
        dM : array or sparse array, shape (n, n), or a sequence of k of these, optional
            The change of M in all steps, or in each, on any pattern; F of a NonlinearProblem changes by dM x.
        dforcing : array, shape (k, n) or (n,), optional
            Change of the forcing of each step, or one row for all.
        dpropagator : number or array or sparse array, shape (n, n), optional
            The change of the propagator, on any pattern; a number stands for a multiple of the identity.
        dz0 : array, shape (n,), optional
        dlower, dupper : number or array, shape (n,) or (k, n), optional
            Changes of the bounds of all steps, or of each; only active bounds matter.
        only_last : bool
            If True, return only the change of the last solution.

        Returns
        -------
        array, shape (k, n), or (n,) for the last solution only
            Changes of the solutions. Without steps, `only_last` returns dz0.

        Raises
        ------
        InvalidProblem, UnsuitableProblem
            As the Derivative of a step.

        Examples
        --------
        >>> from lcp_plugin import LCP, derivative, march
        >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)
        >>> derivative(march(rod, [[-1, 0], [-1, 0]], z0=[1, 1])).jvp(dz0=[1, 0])
        array([[0.375  , 0.125  ],
               [0.15625, 0.09375]])
        """
        n, steps = self.march.problem.n, len(self)
        rows = _rows(dforcing, "dforcing", steps, n)
        none = sp.csr_array((n, n))
        is_each = False
        with suppress(TypeError, ValueError, LookupError):
            is_each = getattr(dM, "ndim", 3) == 3 and np.ndim(dM[0]) == 2
        if is_each:
            _check_count("dM", dM, steps)
        dC = none if dpropagator is None else checked_propagator(dpropagator, n, "dpropagator")
        low, high = _rows(dlower, "dlower", steps, n, ()), _rows(dupper, "dupper", steps, n, ())

        def change_of_M(k: int) -> Any:
            change = dM[k] if is_each else dM
            return none if dM is None else checks.rectangular_matrix(change, "dM", n, n)

        before = checks.change_of_vector(dz0, "dz0", n).copy()
        dz = np.empty((0 if only_last else steps, n))
        for part in self._parts():
            at = part.steps
            of_M = [*map(change_of_M, range(steps)[at])]
            changes = part.jvp(of_M, dC, rows[at], low[at], high[at], before)
            if not only_last:
                dz[part.steps] = changes
        return before if only_last else dz

    def vjp(self, g: ArrayLike) -> MarchGradient:
        """Return the gradients of a function L by M, forcing, propagator, z0 and bounds.

        If rows are degenerate, this is the gradient of one of the pieces that meet there: see ``Derivative.vjp``.

        Parameters
        ----------
        g : array, shape (k, n), or (n,) for the last solution only
            ∂L/∂z.

        Raises
        ------
        InvalidProblem, UnsuitableProblem
            As the Derivative of a step.

        Examples
        --------
        >>> from lcp_plugin import LCP, derivative, march
        >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)
        >>> gradient = derivative(march(rod, [[-1, 0], [-1, 0]], z0=[1, 1])).vjp([1, 0])
        >>> gradient.z0, gradient.propagator.diagonal()
        (array([0.15625, 0.09375]), array([-0.484375, -0.171875]))
        >>> gradient.forcing
        array([[-0.15625, -0.09375],
               [-0.375  , -0.125  ]])
        """
        n, steps = self.march.problem.n, len(self)
        need = f"({steps}, {n}), or ({n},) for the last solution only"
        values = checked_rows("g", g, need, ((steps, n), (n,)).__contains__)
        rows = np.zeros((steps, n))
        rows[slice(-1, None) if values.ndim == 1 else slice(None)] = values
        march, problem = self.march, self.march.problem
        M = getattr(problem, "csr", sp.csr_array((n, n)))
        has_own_matrices, propagator = march.has_own_matrices, march.propagator
        after, of_bounds, forcing = np.zeros(n), np.zeros((2, steps, n)), np.empty((steps, n))
        of_M, of_C, each = np.zeros(M.nnz), np.zeros(propagator.nnz), list[Any]()
        for part in self._parts(backwards=True):
            by_q = part.vjp(rows[part.steps], after, of_bounds[:, part.steps])
            forcing[part.steps] = by_q
            if has_own_matrices:
                at = (result.certificate.problem.matrix for result in march[part.steps])
                each[:0] = [*map(outer_on_pattern, at, by_q, part.z)]
            else:
                of_M += sum_of_outer(M, by_q, part.z).data
            of_C += sum_of_outer(propagator, by_q, part.states[:-1]).data
        z0 = propagator.T @ after if steps else np.atleast_2d(values).sum(axis=0)
        by_M: Any = sp.csr_array((of_M, M.indices, M.indptr), shape=(n, n))
        by_M = each if has_own_matrices else by_M
        by_C = sp.csr_array((of_C, propagator.indices, propagator.indptr), shape=(n, n))
        lower, upper = of_bounds.sum(axis=1)
        return MarchGradient(z0, lower, upper, by_M, by_C, forcing, of_bounds[0], of_bounds[1])

    def _parts(self, *, backwards: bool = False) -> Iterator[Steps]:
        """Yield the steps in blocks, with their classified rows."""
        march = self.march
        starts = range(0, len(march), STEPS_TOGETHER)
        for first in reversed(starts) if backwards else starts:
            before = march.z[first - 1] if first else march.z0
            yield Steps(self, first, np.vstack([before, march.z[first : first + STEPS_TOGETHER]]))

    @derived_property
    def band(self) -> Band | None:
        """The band of M; None if M is not a narrow band, or changes from step to step."""
        problem = self.march.problem
        if self.march.has_own_matrices or isinstance(problem, NonlinearProblem):
            return None
        return Band.of(problem.matrix, self.march.propagator)

    @derived_property
    def transposed(self) -> Band | None:
        """The band of the transposed matrices."""
        if self.band is None:
            return None
        M, C = (sp.csr_array(part.T) for part in (self.march.problem.csr, self.march.propagator))
        return Band.of(Matrix(M), C)


def _rows(values: Array, name: str, steps: int, n: int, *shapes: tuple[int, ...]) -> Vector:
    """Return a row per step; a vector, or an array of further shapes, is the row of all steps, None means 0."""
    if values is None:
        return np.broadcast_to(0.0, (steps, n))
    need = f"({steps}, {n}), or ({n},) for all steps"
    rows = checked_rows(name, values, need, ((steps, n), (n,), *shapes).__contains__)
    return np.broadcast_to(rows, (steps, n))
