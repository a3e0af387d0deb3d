"""error_against_time(): how the error falls with time and work, algorithm by algorithm, on one problem.

The runs are those of `solve`, with its clock: it stands still while an error is measured, and kernels are compiled
off it. Every run gets a problem of its own on the same arrays, so that nothing a former run computed about M makes a
set-up look cheaper than it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.certificates.residuals import Certificate
from ..core.certificates.row_residuals import is_at_bound
from ..core.checks import FloatVector
from ..core.errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..core.lcp import LCP
from ..core.solving.result import Result, Sample
from ..gallery.scene import Scene
from .contestants import (
    Contestant,
    WorkLimit,
    as_scene_of,
    checked_names,
    contestants,
    fresh,
    measured_run,
)
from .curves import BOUND, RESIDUAL, TRUE_ERROR, Curve, Point, ReferencePoint, Report

Measure = Callable[[FloatVector], float]
Progress = Callable[[str], object]


def error_against_time(
    target: Scene | LCP,
    algorithms: Any = None,
    references: Sequence[str] = (),
    *,
    repeats: int = 3,
    tolerance: float = 1e-8,
    max_seconds: float = 20.0,
    max_work: float = math.inf,
    progress: Progress | None = None,
) -> Report:
    """Return how the error falls with seconds and with passes over M, for each algorithm on one problem.

    Parameters
    ----------
    target : Scene or LCP
        A scene of the gallery says what is known about it; of a plain problem H₊ is examined here.
    algorithms : sequence, or a mapping of labels to its items; optional
        Of names, Algorithm objects and pairs as in ``("npsor", {"relaxation": 1.5})``. By default the projected-type
        methods (ours and with the paper's settings), their relatives and ``"auto"``.
    references : sequence of str
        Convex solvers to ask through cvxpy, of "daqp", "osqp", "scs", "piqp", "clarabel", "highs"; each becomes one
        point. Left out, with the reason, where M is not symmetric.
    repeats : int
        Runs behind each median, ≥ 1; the algorithms take turns.
    tolerance : float
        Relative residual at which a run ends.
    max_seconds, max_work : float
        Limits of each run: seconds of the clock, and passes over M (reproducible).
    progress : callable, optional
        Called with the label of each run before it starts.

    Returns
    -------
    Report
        The error is the true one where the scene knows z*, else a rigorous bound where the scene declares M to be an
        H₊-matrix (of a plain problem: where M allows one) and that bound is smaller than the answer, else the relative
        residual; ``error_kind`` says which, ``left_out`` why.

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        Where an argument cannot be used.

    Notes
    -----
    Points lie at geometric intervals of the iterations. The first is the set-up, the last the answer with its final
    check. Iterations, work, errors and residuals are the same in every run of the same call; seconds are not.

    The rigorous bound of every point is its distance to one point ẑ and the bound of ẑ's own error: an answer of
    ``"auto"``, found beforehand and made nearer to z* by the sharp bound of :func:`lcp_plugin.error_bound`.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> report = error_against_time(gallery.build("half_active", n=100), ["npgs", "pgs"], repeats=1)
    >>> report.error_kind, [curve.status for curve in report.curves]
    ('true error', ['SOLVED', 'SOLVED'])
    """
    checked_numbers(repeats, max_work, progress)
    references = _checked_references(references)
    say = (lambda _: None) if progress is None else progress
    say("what the error is")
    limits = {"tolerance": tolerance, "max_seconds": max_seconds}
    bench = Bench(
        as_scene_of(target, "problem", None, "error_against_time"),
        max_work=max_work,
        bounds=True,
        **limits,
    )
    scene, curves = bench.scene, bench.curves(contestants(algorithms), repeats, say)
    points, more = _references(scene, references, max_seconds, bench.yardstick, say)
    refused = [(curve.label, curve.note) for curve in curves if not curve.points]
    return Report(
        title=title_of(scene),
        description=scene.description,
        n=scene.n,
        nonzeros=scene.problem.nonzeros,
        error_kind=bench.yardstick.kind,
        tolerance=tolerance,
        repeats=repeats,
        active_share=_active_share(bench.best),
        curves=tuple(curve for curve in curves if curve.points),
        references=points,
        left_out=(*bench.yardstick.left_out, *_march(scene), *refused, *more),
    )


def checked_numbers(repeats: Any, max_work: Any, progress: Any) -> None:
    """Raise InvalidOption where one of these cannot be used."""
    if isinstance(repeats, bool) or not isinstance(repeats, int) or repeats < 1:
        raise InvalidOption(f"repeats must be a whole number ≥ 1, got {repeats!r}")
    if (
        isinstance(max_work, bool)
        or not isinstance(max_work, int | float | np.number)
        or not max_work > 0.0
    ):
        raise InvalidOption(f"max_work must be a number > 0, got {max_work!r}")
    if progress is not None and not callable(progress):
        raise InvalidOption(f"progress must be a callable that takes a label, got {progress!r}")


def _checked_references(references: Any) -> list[str]:
    names = checked_names(references, "references")
    if names:
        from .qp_reference import check_reference

        for name in names:
            check_reference(name)
    return names


def title_of(scene: Scene) -> str:
    """Return a scene as it is written on a command line."""
    values = ",".join(f"{name}={value}" for name, value in scene.parameters.items())
    return f"{scene.name}:{values}" if values else scene.name


def _march(scene: Scene) -> list[tuple[str, str]]:
    return (
        [("later steps", f"only the first of {scene.steps} steps is measured")]
        if scene.steps > 1
        else []
    )


# --- What the error is ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Yardstick:
    """The kind of error that this scene allows, how it is measured, and why not a better one."""

    kind: str
    measure: Callable[[FloatVector], tuple[float, float]]
    left_out: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, scene: Scene, max_seconds: float, *, bounds: bool) -> Yardstick:
        """Return the best yardstick, an error bound only where `bounds`; it leaves the runs' problems alone."""
        problem = fresh(scene.problem)
        if scene.exact is not None:
            exact = scene.exact
            return cls(TRUE_ERROR, _with_residual(problem, lambda z: distance(z, exact)), ())
        unknown = (TRUE_ERROR, "the exact answer is not known")
        if not bounds:
            return cls(RESIDUAL, _with_residual(problem, None), (unknown,))
        if scene.is_declared and not scene.is_h_plus:
            reason = "M is not declared to be an H₊-matrix"
        else:
            bound, reason = _bound(problem, scene.start, max_seconds)
            if bound is not None:
                return cls(BOUND, _with_residual(problem, bound), (unknown,))
        return cls(RESIDUAL, _with_residual(problem, None), (unknown, (BOUND, reason)))


def distance(z: FloatVector, exact: FloatVector) -> float:
    """Return ‖z − exact‖∞."""
    return float(np.max(np.abs(z - exact), initial=0.0))


def _with_residual(
    problem: LCP, error: Measure | None
) -> Callable[[FloatVector], tuple[float, float]]:
    """Return what measures an error and the relative residual, which is the error where there is no other."""

    def measured(z: FloatVector) -> tuple[float, float]:
        residual = Certificate.of(problem, z).relative_residual
        return residual if error is None else error(z), residual

    return measured


def _bound(
    problem: LCP, start: FloatVector | None, max_seconds: float
) -> tuple[Measure | None, str]:
    """Return the rigorous bound of ‖z − z*‖∞, or None and the reason."""
    from ..proofs.bounds.error_bounds import error_bound

    try:
        if error_bound(problem, problem.nearest_to_zero, sharp=False).kind != "rigorous":
            return None, "only an estimate is to be had for this matrix"
    except UnsuitableMatrix as error:
        return None, str(error)
    answer = measured_run(problem, "auto", WorkLimit(math.inf), z0=start, max_seconds=max_seconds).z
    known = error_bound(problem, answer)
    least, size = known.infinity, float(np.abs(answer).max(initial=0.0))
    if known.near is not None:
        least, size = (
            float(np.abs(part).max(initial=0.0)) for part in (known.near.y, known.near.high)
        )
    if least > 0.0 and not least < size:
        return None, f"of an answer that reaches {size:.1e} it is {least:.1e}, which says nothing"
    return (lambda z: float(known.carried_to(z).max(initial=0.0))), ""


# --- Running --------------------------------------------------------------------------------------------------


def _unmeasured(z: FloatVector) -> tuple[float, float]:
    return math.nan, math.nan


class Recorder(WorkLimit):
    """Takes samples at geometric intervals while the driver's clock stands still, and ends a run of too much work."""

    def __init__(
        self, measure: Callable[[FloatVector], tuple[float, float]], max_work: float
    ) -> None:
        super().__init__(max_work)
        self.measure = measure
        self.points: list[Point] = []
        self._next = 0

    def __call__(self, sample: Sample, z: FloatVector) -> bool:
        """Take in a sample where one is due; return whether the limit of work is reached."""
        if sample.iteration >= self._next:
            self._next = max(sample.iteration + 1, math.ceil(sample.iteration * 1.08))  # geometric
            error, residual = self.measure(z)
            self.points.append(
                Point(sample.iteration, sample.work, sample.seconds, error=error, residual=residual)
            )
        return super().__call__(sample, z)

    def end(self, result: Result) -> None:
        """Take in what the run ended with; its answer is the last point, instead of a sample of the same iteration."""
        self.certificate = result.certificate
        self.status = "MAX_WORK" if self.is_over and not result.is_solved else result.status.name
        if len(self.points) > 1 and self.points[-1].iteration >= result.iterations:
            self.points.pop()
        error, residual = self.measure(result.z)
        self.points.append(
            Point(result.iterations, result.work, result.seconds, error=error, residual=residual)
        )


def curve_of(contestant: Contestant, runs: Sequence[Recorder]) -> Curve:
    """Return the errors of the first run over the seconds of all, at those iterations that every run reached."""
    times = [
        {(one.iteration, one is run.points[-1]): one.seconds for one in run.points} for run in runs
    ]
    points = []
    for place, one in zip(times[0], runs[0].points, strict=True):
        if all(place in run for run in times):
            low, middle, high = map(
                float, np.percentile([run[place] for run in times], (25.0, 50.0, 75.0))
            )
            points.append(one._replace(seconds=middle, seconds_low=low, seconds_high=high))
    note = "; ".join(
        filter(None, (contestant.note, _CLOCKED if runs[0].status == "MAX_SECONDS" else ""))
    )
    return Curve(contestant.label, contestant.family, runs[0].status, tuple(points), note)


_CLOCKED = "ended by the clock, so that the last point depends on the machine"


class Bench:
    """A problem on which methods are measured, every run on a problem of its own with the same arrays.

    Parameters
    ----------
    scene : Scene
    tolerance, max_seconds, max_work : float
        Where a run ends.
    bounds : bool
        Whether a rigorous bound is the error where the exact answer is not known.
    """

    def __init__(
        self, scene: Scene, *, tolerance: float, max_seconds: float, max_work: float, bounds: bool
    ) -> None:
        self.scene, self.max_work = scene, max_work
        self.limits = {"tolerance": tolerance, "max_seconds": max_seconds}
        self.yardstick = Yardstick.of(scene, max_seconds, bounds=bounds)
        self.best: Certificate | None = None  # of all answers

    def refusal(self, one: Contestant) -> str:
        """Return why the algorithm does not take this problem; empty where it does. Also its warm-up."""
        problem, limit = fresh(self.scene.problem), WorkLimit(math.inf)
        try:
            measured_run(problem, one.algorithm, limit, z0=self.scene.start, max_iterations=3)
        except (UnsuitableMatrix, UnsuitableProblem) as error:
            return str(error)
        return ""

    def run(self, one: Contestant, *, is_first: bool) -> Recorder:
        """Return the samples of a run, with their errors where it is the first."""
        recorder = Recorder(self.yardstick.measure if is_first else _unmeasured, self.max_work)
        recorder.end(
            measured_run(
                fresh(self.scene.problem),
                one.algorithm,
                recorder,
                z0=self.scene.start,
                **self.limits,
            )
        )
        found = recorder.certificate
        if self.best is None or found.relative_residual < self.best.relative_residual:
            self.best = found
        return recorder

    def curves(self, entrants: Sequence[Contestant], repeats: int, say: Progress) -> list[Curve]:
        """Return a curve each, of so many runs, in which they take turns; REFUSED where one takes no such problem."""
        reasons = {}
        for one in entrants:
            say(f"{one.label}, warm-up")
            reasons[one.label] = self.refusal(one)
        runs: dict[str, list[Recorder]] = {
            label: [] for label, reason in reasons.items() if not reason
        }
        for turn in range(repeats):
            for one in entrants:
                if one.label in runs:
                    say(f"{one.label}, run {turn + 1} of {repeats}")
                    runs[one.label].append(self.run(one, is_first=turn == 0))
        return [
            curve_of(one, runs[one.label])
            if one.label in runs
            else Curve(one.label, one.family, "REFUSED", (), reasons[one.label])
            for one in entrants
        ]


def _active_share(best: Certificate | None) -> float:
    """Return the share of components at a bound of the most accurate answer."""
    if best is None or best.problem.n == 0:
        return math.nan
    return float(np.mean(is_at_bound(best.problem, best.z)))


# --- References -----------------------------------------------------------------------------------------------


def _references(
    scene: Scene, names: Sequence[str], max_seconds: float, yardstick: Yardstick, say: Progress
) -> tuple[tuple[ReferencePoint, ...], list[tuple[str, str]]]:
    """Return a point for each reference that gave an answer, and why the others did not."""
    if not names:
        return (), []
    if scene.is_declared and not scene.is_symmetric:
        return (), [
            (
                "quadratic programs",
                "M is not symmetric, so that no quadratic program has these conditions",
            )
        ]
    from .qp_reference import PLAIN, SOLVERS, Formulation, attempt

    formulation = Formulation.of(scene.problem)
    if formulation.kind != PLAIN:
        return (), [("quadratic programs", formulation.evidence)]
    points, left_out = [], []
    for name in names:
        if scene.n > SOLVERS[name].largest:
            left_out.append(
                (
                    name,
                    f"asked up to n = {SOLVERS[name].largest:g} only: it has no limit of its own",
                )
            )
            continue
        say(f"reference {name}")
        one = attempt(formulation, name, max_seconds)
        if one.certificate is None:
            left_out.append(
                (name, f"no answer within {one.seconds:.2g} s: {one.note or 'it gave none'}")
            )
        else:
            points.append(
                ReferencePoint(name, one.seconds, *yardstick.measure(one.certificate.z), one.note)
            )
    return tuple(points), left_out
