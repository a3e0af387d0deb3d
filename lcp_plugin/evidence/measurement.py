"""Measurement of one method on one problem: error and residual along the run; and the methods of a study.

A run has the clock of `solve`, which stops while an error is measured and does not count compilation. Each run
gets a new LCP of the same arrays, so that no cached fact about M shortens the set-up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ..algorithms import create, paper_options
from ..core.algorithm import Algorithm
from ..core.checks import Vector
from ..core.entries import max_norm
from ..core.errors import InvalidOption, UnsuitableMatrix
from ..core.lcp import LCP
from ..core.settings import Status
from ..gallery.scene import Scene
from ..judges.certificate import Certificate
from ..proofs.bounds import error_bound
from ..solving.dispatch import method_of, solve
from ..solving.result import Result, Sample

TRUE_ERROR, BOUND, RESIDUAL = "true error", "rigorous bound", "residual"
POINT = ("iteration", "work", "seconds", "seconds_low", "seconds_high", "error", "residual")
SINGLE_POINTS = ("reference", "polish")  # families
PAPER, PAPER_RELAXATION, PAPER_MSOR = "the paper's settings", 1.7, 0.85

Measure = Callable[[Vector], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Measurement:
    """A row of a study: one method on one problem.

    Attributes
    ----------
    problem : str
        Label of the problem.
    size : int or None
        The size requested; None if the problem has one size.
    n, nonzeros : int
        0 if the problem could not be built.
    method, family : str
        Label of the method, and "method"; "reference" for a convex solver; "polish" for the linear solve on the active
        set that `solve` makes after the last iterate of the method.
    status : str
        Name of a :class:`lcp_plugin.Status`, or cvxpy's status of a reference. REFUSED if the method rejects the
        problem; ERROR if it raised another error.
    error_kind : {"true error", "rigorous bound", "residual"}
        Kind of the errors; the first two in the unit of z.
    tolerance : float
        Relative residual requested; NaN with the paper's stopping rule.
    points : ndarray, shape (k, 7)
        Iteration, work (passes over M), seconds (median over the repeats) with quartiles, error and relative residual.
        The first point is the set-up, the last one the last iterate. A reference and a polish have one point.
    note : str
        Message of the error, or choice of options.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> from lcp_plugin.evidence.study import study
    >>> row = study(gallery.half_active(n=100), "pgs", repeats=1).rows[0]
    >>> row.method, row.status, bool(row.iterations == row.points[-1, 0])
    ('pgs', 'SOLVED', True)
    """

    problem: str
    size: int | None
    n: int
    nonzeros: int
    method: str
    family: str
    status: str
    error_kind: str
    tolerance: float
    points: Vector = field(default_factory=lambda: np.zeros((0, len(POINT))))
    note: str = ""

    @property
    def is_curve(self) -> bool:
        """True for the iterates of a method, False for the single point of a reference or a polish."""
        return self.family not in SINGLE_POINTS

    @property
    def is_solved(self) -> bool:
        """True if the tolerance was reached."""
        return self.status == "SOLVED"

    def column(self, name: str) -> Vector:
        """Return a column of `points` by name, shape (k,)."""
        return self.points[:, POINT.index("iteration" if name == "iterations" else name)]

    def last(self, name: str) -> float:
        """Return a column's value at the result; NaN if there is none."""
        return float(self.column(name)[-1]) if len(self.points) else math.nan

    @property
    def iterations(self) -> int:
        """Iterations until the result; 0 if there is none."""
        value = self.last("iteration")
        return 0 if math.isnan(value) else int(value)

    @property
    def work(self) -> float:
        """Passes over M until the result."""
        return self.last("work")

    @property
    def seconds(self) -> float:
        """Median of the seconds until the result."""
        return self.last("seconds")

    @property
    def error(self) -> float:
        """Error of the result, of the kind `error_kind`."""
        return self.last("error")

    def __str__(self) -> str:
        if not len(self.points):
            return f"{self.method:<18} {self.status:<15} {self.note}"
        steps = "" if self.family == "reference" else f"{self.iterations:>7} iterations"
        passes = "" if self.family == "reference" else f"{self.work:>9.1f} passes"
        head = f"{self.method:<18} {self.status:<15} {steps:<18} {passes:<16}"
        return f"{head} {self.seconds:>9.3g} s, {self.error_kind} {self.error:.1e}"


def fresh(problem: LCP) -> LCP:
    """Build a problem on the same arrays, without cached facts."""
    return LCP(problem.M, problem.q, lower=problem.lower, upper=problem.upper)


def track(
    scene: Scene, algorithm: object, measure: Measure, paper_tolerance: float = 0.0, **limits: Any
) -> tuple[Result, list[tuple[float, ...]]]:
    """Return a result and its samples (iteration, work, seconds, error, residual) at geometric intervals.

    With `paper_tolerance`, a run also ends at the first iterate whose ‖z − mid(lower, upper, z − w)‖₂ is below it. The
    status of the result is INTERRUPTED then, and the last sample is this iterate.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C, on which `solve` keeps the best iterate.
    """
    problem, samples = fresh(scene.problem), list[tuple[float, ...]]()
    due, is_last = 0, False

    def record(sample: Sample, z: Vector) -> bool:
        nonlocal due, is_last
        if paper_tolerance:
            moved = np.clip(z - problem.slack(z), problem.lower, problem.upper)
            is_last = bool(np.linalg.norm(z - moved) < paper_tolerance)
        if is_last or sample.iteration >= due:
            # The iterations of two samples have this ratio
            due = max(sample.iteration + 1, math.ceil(sample.iteration * 1.08))
            samples.append((sample.iteration, sample.work, sample.seconds, *measure(z)))
        return is_last

    result = solve(problem, algorithm, z0=scene.start, callback=record, **limits)
    if is_last:
        return result, samples
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if len(samples) > 1 and samples[-1][0] >= result.iterations:
        samples.pop()
    samples.append((result.iterations, result.work, result.seconds, *measure(result.z)))
    return result, samples


def measure_method(
    scene: Scene, method: Method, measure: Measure, repeats: int, **limits: Any
) -> tuple[str, Vector]:
    """Return the status and the iterates of a method; a first run of three steps compiles its kernels.

    Errors come from the first run, seconds are the median and quartiles of all at iterations that all have reached.
    """
    solve(fresh(scene.problem), method.algorithm, z0=scene.start, max_iterations=3)
    limits |= {"polish": False}
    result, first = track(scene, method.algorithm, measure, **limits)
    repeated = [track(scene, method.algorithm, _unmeasured, **limits)[1] for _ in range(1, repeats)]
    times = [{(s[0], s is part[-1]): s[2] for s in part} for part in (first, *repeated)]
    points = []
    for place, sample in zip(times[0], first, strict=True):
        if all(place in seconds for seconds in times):
            low, middle, high = np.percentile([seconds[place] for seconds in times], (25, 50, 75))
            points.append((*sample[:2], middle, low, high, *sample[3:]))
    status = "SOLVED" if result.status is Status.INTERRUPTED else result.status.name
    return status, np.array(points)  # by the paper's rule


def measure_polish(
    scene: Scene, method: Method, measure: Measure, **limits: Any
) -> tuple[str, Vector] | None:
    """Return the status and the point of a run that ends with a polish; None if it makes none."""
    result, _ = track(scene, method.algorithm, _unmeasured, **limits)
    if not result.is_polished:
        return None
    point = (result.iterations, result.work, *[result.seconds] * 3, *measure(result.z))
    return result.status.name, np.array([point])


def _unmeasured(z: Vector) -> tuple[float, float]:
    return math.nan, math.nan


# --- The error ------------------------------------------------------------------------------------------------


def error_measure(scene: Scene, max_seconds: float) -> tuple[str, Measure, str]:
    """Return the kind of error that this problem allows, a function z → (error, residual), and why there is no better.

    The true error if z* is known; else a rigorous bound if M is an H₊-matrix and the bound is less than the solution.
    Otherwise the relative residual. The bound of a point is its distance from one ẑ plus the error bound of ẑ, a
    solution by "auto".
    """
    problem, reason = fresh(scene.problem), ""
    error: Callable[[Vector], float] | None = None
    if scene.exact is not None:
        exact = scene.exact
        kind, error = TRUE_ERROR, lambda z: max_norm(z - exact)
    else:
        error, reason = _error_bound(scene, max_seconds)
        kind = RESIDUAL if error is None else BOUND

    def measure(z: Vector) -> tuple[float, float]:
        residual = Certificate.of(problem, z).relative_residual
        return residual if error is None else error(z), residual

    return kind, measure, reason


def _error_bound(scene: Scene, max_seconds: float) -> tuple[Callable[[Vector], float] | None, str]:
    problem = fresh(scene.problem)
    try:
        error_bound(problem, problem.nearest_to_zero, sharp=False)
    except UnsuitableMatrix as failure:
        return None, f"no bound of the error: {failure}"
    result, _ = track(scene, "auto", _unmeasured, max_seconds=max_seconds)
    known = error_bound(problem, result.z)
    least, size = known.infinity, max_norm(result.z)
    if (near := known.near) is not None:
        least, size = max_norm(near.y), max_norm(near.high)
    if least > 0.0 and not least < size:
        return None, f"no bound of the error: it is {least:.1e} for a solution of size {size:.1e}"
    return (lambda z: max_norm(known.carried_to(z))), ""


# --- The methods ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Method:
    """A label, the algorithm ("auto" or an object), its role in a study, and the choice of its options."""

    label: str
    algorithm: str | Algorithm
    family: str = "method"
    note: str = ""


def methods_of(algorithms: Any) -> list[Method]:
    """Return the methods of a study.

    Parameters
    ----------
    algorithms : None, an algorithm, a sequence of them, or a mapping of labels to them
        An algorithm is a name, an Algorithm object, or a pair of a name and a dictionary of options. If it is None,
        the paper's methods with its settings and with ours, next to their relatives.

    Raises
    ------
    UnknownAlgorithm
        With the closest name.
    InvalidOption
        If `algorithms` is none of these, or if two different algorithms have one label.
    """
    if algorithms is None:
        paper = ("npgs", None), ("npsor", PAPER_RELAXATION), ("mgs", None), ("msor", PAPER_MSOR)
        made = ((name, create(name, paper_options(name, omega))) for name, omega in paper)
        methods = [Method(f"{name.upper()} paper", one, note=PAPER) for name, one in made]
        relatives = "NPGS", "NPSOR", "NPAOR", "GFP", "PGS", "PSOR", "multigrid"
        methods += [Method(label, create(label.lower(), {})) for label in relatives]
        return [*methods, Method("auto", "auto")]
    if isinstance(algorithms, str | Algorithm) or _is_pair(algorithms):
        algorithms = [algorithms]
    try:
        is_named = isinstance(algorithms, Mapping)
        named = [*algorithms.items()] if is_named else [(None, part) for part in [*algorithms]]
    except TypeError:  # a sparse array only looks like a sequence
        raise InvalidOption(
            f'methods must be names or Algorithm objects, got {algorithms!r}; write ["psor"]'
        ) from None
    methods_by_label: dict[str, Method] = {}
    for label, algorithm in named:
        method = _method(label, algorithm)
        other = methods_by_label.setdefault(method.label, method)
        if other.algorithm != method.algorithm:
            raise InvalidOption(
                f'two methods are called {method.label!r}; give them labels, as in {{"mine": …, "theirs": …}}'
            )
    return [*methods_by_label.values()]


def _is_pair(pair: object) -> bool:
    return isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[1], Mapping)


def _method(label: object, algorithm: Any) -> Method:
    if isinstance(algorithm, str) or _is_pair(algorithm):
        name, options = (algorithm, {}) if isinstance(algorithm, str) else algorithm
        algorithm = method_of(name, dict(options)) or "auto"
    elif not isinstance(algorithm, Algorithm):
        raise InvalidOption(f"a method is a name, Algorithm or (name, options), got {algorithm!r}")
    return Method(str(label) if label else _label(algorithm), algorithm)


def _label(algorithm: str | Algorithm) -> str:
    """Return the name with the options that differ from the defaults."""
    if isinstance(algorithm, str):
        return algorithm
    values = {option.name: getattr(algorithm, option.name) for option in fields(algorithm)}
    changed = (o.name for o in fields(algorithm) if repr(values[o.name]) != repr(o.default))
    return " ".join([algorithm.name, *(f"{name}={values[name]}" for name in changed)])
