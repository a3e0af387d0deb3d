"""solve_nonlinear(): Josephy–Newton on the one loop, judged by the residual of F."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...auto import Single, policy_for
from ...core.algorithm import Algorithm
from ...core.certificates.criterion import CommonScaling
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector, checked_vector, read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.threads import threads_for
from ...core.policy.stages import Choice
from ...core.settings import Settings, Status, checked_callback
from ...core.solving.judge import End, Judge
from ...core.solving.result import Result
from ...core.solving.run import Callback, Run
from .certificate import NonlinearCertificate, Reference
from .data import Linearisation, Linearisations, NonlinearProblem
from .josephy_newton import JosephyNewton

STEP = 2.0**-20
OTHERS = (
    2.0**-30,
    2.0**-40,
    2.0**-10,
)  # what is curved is not wrong on shorter ones, nor on a longer one what is rough
WRONG = 1e-2  # of the terms of a row
ELSEWHERE = "F or its derivative is not finite at the start given, projected onto them"
UNSURE = 10.0  # times what differences of two lengths disagree by


@np.errstate(under="ignore")
def solve_nonlinear(
    problem: NonlinearProblem,
    x0: ArrayLike,
    algorithm: str | Algorithm = "auto",
    *,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    record: bool = False,
    callback: Callback | None = None,
    check_jacobian: bool = True,
    threads: int | None = None,
    verbose: bool = False,
) -> Result:
    """Return the solution of a nonlinear complementarity problem by Josephy–Newton, measured with F itself.

    Parameters
    ----------
    problem : NonlinearProblem
    x0 : array, shape (n,), or a number for n = 1
        Where to begin, projected onto the bounds; where F or its derivative is not finite there, at the point of the
        bounds nearest to 0, or else to 1, which ``explain()`` tells. F is given an array in any case.
    algorithm : str or Algorithm
        What solves the linear complementarity problem of each step.
    tolerance : float
        SOLVED means that the measured residual of the returned x is at most this. As for :func:`lcp_plugin.solve`, with
        F(x) for w, in the units that F is given in: in every component relative to the residual of F at the point of
        the bounds nearest to 0, which counts for no more than that of an affine F with this derivative could be there
        (``certificate.relative_to``), and every row in its own terms
        (:mod:`lcp_plugin.problems.nonlinear.certificate`).
    max_iterations : int, default 100 000
        Newton steps.
    max_seconds : float, optional
        Wall-clock limit in seconds, obeyed as by :func:`lcp_plugin.solve`, inside a step as well.
    absolute_tolerance : float
        In the unit of x, as for :func:`lcp_plugin.solve`; such a row need not be right in its own terms either.
    record, callback
        As for :func:`lcp_plugin.solve`, a sample each Newton step.
    check_jacobian : bool
        Compare a `jacobian` that was given with differences of F near the start.
    threads : int, optional
        As for :func:`lcp_plugin.solve`; F itself is called in this thread.
    verbose : bool
        Print the run, a line each Newton step at geometric intervals.

    Returns
    -------
    Result
        With z = x and w = F(x), whatever the status. INFEASIBLE is never claimed. STALLED: x is a stationary point of
        the merit, or steps no longer gain; another start may find a solution. PRECISION_LIMIT rests on an estimate of
        what rounding does in F. Ctrl-C ends the run, and the best x is returned, as soon as F is known at the start.
        ``derivative(result)`` takes a change of F as dq.

    Raises
    ------
    InvalidProblem
        Where F or its derivative is finite at no start, has another shape, or `jacobian` is clearly wrong.
    InvalidOption, UnknownAlgorithm
        For a wrong option.

    Notes
    -----
    Each step solves the linear complementarity problem of F′(x), as exactly as the residual at x deserves; a line
    search keeps ‖Φ‖ falling, Φ the Fischer–Burmeister function. What follows where that fails stands in
    ``help("lcp_plugin.problems.nonlinear.josephy_newton")``.

    Examples
    --------
    >>> import numpy as np
    >>> problem = NonlinearProblem(lambda x: np.array([np.exp(x[0]) + x[1] - 3, x[1] - x[0] + 2]))
    >>> result = solve_nonlinear(problem, [0.0, 0.0], tolerance=1e-10)
    >>> result.status.name, result.z.round(4), result.w.round(4) + 0.0
    ('SOLVED', array([1.0986, 0.    ]), array([0.    , 0.9014]))
    """
    if not isinstance(problem, NonlinearProblem):
        raise InvalidOption(
            f"solve_nonlinear needs a NonlinearProblem, got {type(problem).__name__}; write NonlinearProblem(F), or "
            "solve(problem) for an LCP"
        )
    settings = Settings(
        tolerance,
        "residual",
        max_iterations,
        max_seconds,
        absolute_tolerance,
        record,
        threads=threads,
        verbose=verbose,
    )
    policy_for(algorithm, {})
    checked_callback(callback)
    start = _checked_start(problem, x0)
    problem = problem.sized(start.size)
    clock = Clock()
    start = read_only(np.clip(start, problem.lower, problem.upper))
    with np.errstate(), threads_for(settings.threads):
        points = Linearisations(problem)
        start, begun = begun_at(points, start)
        reference = Reference.of(problem, start)
        first = points.at(start)
        asked = settings.goal
        newton = JosephyNewton(
            points=points, compared_with=reference, linear=algorithm, tolerance=asked
        )
        judge = NonlinearJudge(points, reference, first, settings)
        run = Run(
            judge.scaling,
            Single(newton, prove_infeasibility=False),
            settings,
            callback,
            clock,
            judge,
        )
        try:
            if check_jacobian and problem.jacobian is not None:
                require_true_jacobian(first)
            return replace(
                run.judged(start, run.drive(start, Choice(newton, TANGENTS))), begun=begun
            )
        except KeyboardInterrupt:
            return replace(run.judged(start, End.INTERRUPTED), begun=begun)


def begun_at(points: Linearisations, start: FloatVector) -> tuple[FloatVector, str]:
    """Return where a run begins, and what is to be said of it: at the start, or nearest to 0 or 1 where F is defined.

    Where F is defined nowhere there it is the start, whose refusal says so.
    """
    lower, upper = points.problem.lower, points.problem.upper
    if points.at(start).is_defined:
        return start, ""
    for near in (0.0, 1.0):
        point = read_only(np.clip(np.full(start.size, near), lower, upper))
        if points.at(point).is_defined:
            return point, f"begun at the point of the bounds nearest to {near:g}: {ELSEWHERE}"
    return start, ""


def _checked_start(problem: NonlinearProblem, x0: ArrayLike) -> FloatVector:
    try:
        return checked_vector(x0, "x0", problem.n, may_be_number=True)
    except InvalidProblem as error:
        raise InvalidOption(str(error)) from error


class NonlinearJudge(Judge):
    """Measures by F; see :class:`Judge`."""

    words = {  # noqa: RUF012 - read only
        Status.SOLVED: "the residual is within the tolerance, as measured on F",
        Status.PRECISION_LIMIT: (
            "the residual is above the tolerance, but no larger than rounding in F explains, as far as F tells at "
            "points nearby; next: accept z, or scale F"
        ),
        Status.STALLED: (
            "no step reduces the residual further; z is a stationary point that is no solution, or F has none, is not "
            "smooth here, or its jacobian is wrong; next: try another start x0"
        ),
        Status.DIVERGED: "the residual left every reasonable range; next: try another start x0, or bounds near it",
        Status.MAX_ITERATIONS: "the iteration limit came first; next: raise max_iterations, or go on from x0=result.z",
        Status.MAX_SECONDS: "the time limit came first; next: raise max_seconds, or go on from x0=result.z",
        Status.INTERRUPTED: Status.INTERRUPTED.value,
    }

    def __init__(
        self, points: Linearisations, reference: Reference, start: Linearisation, settings: Settings
    ) -> None:
        self.points, self.compared_with = points, reference
        self.problem, self.asked, self.settings = start.lcp, points.problem, settings
        self.scaling = CommonScaling(start.lcp, start.lcp)
        self.reference = 1.0  # the certificate knows what each component is compared with
        self.proof = self._certificate = None

    def certificate_of(self, z: FloatVector) -> Certificate:
        """Return the certificate of z by F(z) and F′(z)."""
        if self._certificate is None or not np.array_equal(self._certificate.z, z):
            self._certificate = NonlinearCertificate.at(self.points.at(z), self.compared_with)
        return self._certificate

    def measure(self, z: FloatVector) -> float:
        """Return the relative residual of z."""
        return self.certificate_of(z).relative_above(self.settings.least_reference)


TANGENTS = (
    "each iteration replaces F by its tangent at x and solves the linear problem that this gives"
)


@np.errstate(all="ignore")
def require_true_jacobian(point: Linearisation) -> None:
    """Raise where differences of F along a random direction contradict the derivative there; cost: 9 values of F.

    A row that disagrees is looked through for its worst entry, which takes some 2 log₂ n more.

    Parameters
    ----------
    point : Linearisation
        The start. Where F is not defined nearby nothing is said.

    Raises
    ------
    InvalidProblem
        Naming the worst entry.
    """
    direction = _direction(point)
    contradiction = _contradiction(point, direction)
    if not contradiction.size or not contradiction.max() > WRONG:
        return
    i = int(np.argmax(contradiction))
    columns = np.arange(point.x.size)
    while columns.size > 1:  # the half that disagrees more
        halves = np.array_split(columns, 2)
        wrong = [float(np.abs(_difference(point, _only(direction, half))[0])[i]) for half in halves]
        columns = halves[int(np.argmax(np.nan_to_num(wrong)))]
    j = int(columns[0])
    alone = _only(direction, columns)
    own = alone * np.abs(
        point.x[j] / alone[j]
    )  # where x_j ≪ 1, 1/x_j is curved on every step of the size 1
    if own[j] != 0.0 and not _contradiction(point, own)[i] > WRONG:
        return
    given = float(point.lcp.M[i, j])
    found = given + float(_difference(point, alone)[0][i] / alone[j])
    raise InvalidProblem(
        f"jacobian contradicts F at the start: jacobian(x0)[{i}, {j}] = {given:.6g}, and differences of F give "
        f"{found:.6g}; correct it, leave it out (differences take its place), or pass check_jacobian=False"
    )


def _contradiction(point: Linearisation, direction: FloatVector) -> FloatVector:
    """Return by how much each row disagrees, relative to its terms, where it does so least; 0 where nothing tells."""
    least = np.full(point.x.size, np.inf)
    size = np.asarray(abs(point.lcp.M) @ np.abs(direction))
    for step in (STEP, *OTHERS):
        wrong, unsure = _difference(point, direction, step)
        terms = size + np.abs(wrong)
        is_sure = np.isfinite(terms) & (UNSURE * unsure < np.maximum(np.abs(wrong), WRONG * terms))
        least = np.where(is_sure, np.minimum(least, np.abs(wrong) / terms), least)
    contradiction: FloatVector = np.where(np.isinf(least) | point.is_steep, 0.0, least)
    return contradiction


def _difference(
    point: Linearisation, direction: FloatVector, step: float = STEP
) -> tuple[FloatVector, FloatVector]:
    """Return the derivative of F along a direction less F′ times it, and a bound of the former's error, about."""
    x, value, F = point.x, point.value, point.problem.value
    long = (F(x + 2.0 * step * direction) - value) / (2.0 * step)
    short = (F(x + step * direction) - value) / step
    product = np.asarray(point.lcp.M @ direction)
    rounding = 2.0**-50 * (np.abs(value) + np.abs(short) * step + _added(point)) / step
    return 2.0 * short - long - product, np.abs(short - long) * 0.5 + rounding


def _added(point: Linearisation) -> FloatVector:
    """Return what F adds up, about, shape (n,): where its terms cancel at x they need not at the origin."""
    origin = np.clip(0.0, point.problem.lower, point.problem.upper)
    return np.nan_to_num(np.abs(point.problem.value(origin)), posinf=0.0)


def _direction(point: Linearisation) -> FloatVector:
    """Return a direction of the size of x, or 1, that leads into the bounds where x is at one."""
    x, lower, upper = point.x, point.problem.lower, point.problem.upper
    random = np.random.default_rng(0)
    sign = np.where(random.random(x.size) < 0.5, -1.0, 1.0)
    size = np.maximum(np.abs(x), 1.0) * random.uniform(0.5, 1.0, x.size)
    sign = np.where(
        x - lower < 4.0 * STEP * size, 1.0, np.where(upper - x < 4.0 * STEP * size, -1.0, sign)
    )
    direction: FloatVector = sign * size
    return direction


def _only(direction: FloatVector, columns: NDArray[np.intp]) -> FloatVector:
    kept = np.zeros(direction.size)
    kept[columns] = direction[columns]
    return kept
