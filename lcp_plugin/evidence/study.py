"""study(): problems × methods × sizes → one table of raw results; tables, curves and pictures are views of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption, LCPError, UnsuitableMatrix, UnsuitableProblem, did_you_mean
from ..core.kind import kind_of, refusal
from ..core.lcp import LCP
from ..core.settings import Settings
from ..gallery import names as scene_names
from ..gallery import parse
from ..gallery.parameters import parameters_of
from ..gallery.scene import Scene, builder_of
from ..interfaces.files.files import checked_path
from ..proofs.guarantees.radius import spectral_radius
from .collecting import Part, Progress, collect, data_of, machine
from .contestants import Contestant, as_scene_of, contestants, error_line, own_source
from .curves import Curve
from .error_against_time import Bench, checked_numbers, title_of
from .exporting import AnyPath, finite_content
from .results import COLUMNS, ResultsFile, Row, Study, name_of


def study(
    problems: Any,
    methods: Any = None,
    sizes: Sequence[int] | None = None,
    *,
    repeats: int = 3,
    tolerance: float = 1e-8,
    max_seconds: float = 20.0,
    max_work: float = math.inf,
    error_bound: bool = False,
    curves: bool = False,
    out: AnyPath | None = None,
    progress: Progress | None = None,
) -> Study:
    """Return one table of raw results of methods on families of problems.

    Parameters
    ----------
    problems : a problem, a sequence, or a mapping of labels to its items
        Of LCPs, scenes or their names, and functions of a size that return an LCP, a scene or (M, q).
    methods : as `error_against_time` takes them; optional
        Names, Algorithm objects, pairs of a name and its options, or a mapping of labels to these.
    sizes : sequence of int, optional
        Given to each function, and to each scene as its ``size`` or ``n``.
    repeats : int
        Runs behind the median of the seconds and its quartiles, after a warm-up; ≥ 1.
    tolerance, max_seconds, max_work : float
        Where each run ends: relative residual, seconds of the clock, passes over M.
    error_bound : bool
        Whether a rigorous bound of the error is measured where no exact answer is known; it needs an H₊-matrix.
    curves : bool
        Whether the whole run is kept, for the views "curves".
    out : path, optional
        The file of raw results, CSV. What it holds already of the same problems, methods, versions and machine is not
        measured again; every row is written when it is there.
    progress : callable, optional
        Called as ``progress(done, total, label)``.

    Returns
    -------
    Study
        Also after Ctrl-C, with what is there. A method that refuses a problem, a family that refuses a size and code
        that raises are rows with that status and the reason; those that raised are measured again next time.

    Raises
    ------
    InvalidOption, UnknownAlgorithm, UnreadableFile
        Before anything runs, where an argument cannot be used.

    Examples
    --------
    >>> from lcp_plugin.evidence.study import study
    >>> found = study("half_active", ["npsor", "psor"], sizes=[100, 400], repeats=1)
    >>> [(row.n, row.curve.label, row.curve.status) for row in found.rows][:2]
    [(100, 'npsor', 'SOLVED'), (100, 'psor', 'SOLVED')]
    >>> found.table("iterations")[0].columns
    ('method', 'n = 100', 'n = 400')
    """
    checked_numbers(repeats, max_work, progress)
    Settings(tolerance=tolerance, max_seconds=max_seconds)  # refuses what no run can be asked for
    plan = _Plan(
        _problems(problems),
        contestants(methods),
        _checked_sizes(sizes),
        repeats,
        curves,
        {
            "tolerance": tolerance,
            "max_seconds": max_seconds,
            "max_work": max_work,
            "bounds": bool(error_bound),
        },
    )
    results = ResultsFile(None if out is None else checked_path(out), with_points=curves)
    collected = collect(plan.parts(), results, progress)
    rows = tuple(map(Row.from_content, collected.contents.values()))
    return Study(rows, tuple(collected.missing), collected.found)


# --- What takes part ------------------------------------------------------------------------------------------


def _problems(given: Any) -> dict[str, Any]:
    """Return what is built of each problem, by its name."""
    if isinstance(given, Mapping):
        return {str(label): _named(one) for label, one in given.items()}
    if (
        isinstance(given, str | LCP | Scene | tuple)
        or callable(given)
        or kind_of(given) is not None
    ):
        given = [given]
    try:
        listed = list(given)
    except TypeError:
        listed = []
    if not listed:
        raise InvalidOption(
            f"problems must be a list of problems, functions or names, got {given!r}"
        )
    found: dict[str, Any] = {}
    for k, one in enumerate(listed, start=1):
        name = str(title_of(one) if isinstance(one, Scene) else getattr(one, "__name__", ""))
        label = one if isinstance(one, str) else name or f"problem {k}"
        found[label if label not in found else f"{label} {k}"] = _named(one)
    return found


def _named(one: Any) -> Any:
    """Return a problem, or a function of the size, that a text names; anything else as it is."""
    if not isinstance(one, str):
        if isinstance(one, LCP | Scene | tuple) or (callable(one) and kind_of(one) is None):
            return one
        raise InvalidOption(f"{refusal('study', one)}; or a scene, (M, q), a function of the size")
    name = one.partition(":")[0].strip()
    if name in scene_names():
        return partial(_scene, one)
    hint = did_you_mean(name, scene_names(), is_listed=True)
    raise InvalidOption(f"unknown scene {one!r}{hint}; a file: load_problem(path)")


def _scene(text: str, size: int | None = None) -> Scene:
    if size is None:
        return parse(text)
    name, _, settings = text.partition(":")
    parameters = parameters_of(builder_of(name.strip()))
    key = next((key for key in ("size", "n") if key in parameters), None)
    if key is None:
        raise InvalidOption(
            f"scene {name!r} has neither size nor n, so that sizes mean nothing to it; leave them out"
        )
    return parse(f"{text}{',' if settings else ':'}{key}={size}")


def _checked_sizes(sizes: Any) -> list[int | None]:
    if sizes is None:
        return [None]
    listed = (
        list(sizes)
        if isinstance(sizes, Sequence | np.ndarray) and not isinstance(sizes, str)
        else [sizes]
    )
    for size in listed:
        if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
            raise InvalidOption(f"sizes must be whole numbers ≥ 1, as [100, 400], got {size!r}")
    return [int(size) for size in listed] or [None]


# --- What is measured -----------------------------------------------------------------------------------------


class _Plan:
    """Problems × sizes × methods, and how each is measured; one problem is held at a time."""

    def __init__(
        self,
        problems: dict[str, Any],
        methods: list[Contestant],
        sizes: list[int | None],
        repeats: int,
        curves: bool,
        limits: dict[str, Any],
    ) -> None:
        self.problems, self.methods, self.sizes = problems, methods, sizes
        self.repeats, self.curves, self.limits = repeats, curves, limits
        self.scene = lru_cache(maxsize=1)(self._built)
        self.bench = lru_cache(maxsize=1)(
            lambda label, size: Bench(self.scene(label, size), **limits)
        )
        facts = machine()
        self.machine = "; ".join(f"{name} {fact}" for name, fact in facts.items())

    def _built(self, label: str, size: int | None) -> Scene:
        given = self.problems[label]
        return as_scene_of(
            given, label, None if isinstance(given, LCP | Scene) and self.sizes == [None] else size
        )

    def parts(self) -> list[Part]:
        """Return a part for each cell."""
        return [
            Part(
                label,
                name_of(size, one.label),
                partial(self.measured, label, size, one),
                data=partial(self._data, label, size, one),
            )
            for label in self.problems
            for size in self.sizes
            for one in self.methods
        ]

    def _data(self, label: str, size: int | None, one: Contestant) -> str:
        """Return everything that a row depends on; it builds the problem."""
        try:
            problem = data_of(self.scene(label, size).problem)
        except Exception as error:  # reported where it is measured
            problem = error_line(error)
        return str((problem, one.algorithm, own_source(one.algorithm), self.repeats, self.limits))

    def measured(self, label: str, size: int | None, one: Contestant, say: Any) -> dict[str, Any]:
        """Return the row of a cell, whatever somebody's code does."""
        n = nonzeros = 0
        kind, radius = "", math.nan
        try:
            scene = self.scene(label, size)
            n, nonzeros = scene.n, scene.problem.nonzeros
            radius = _radius(scene.problem, one.algorithm)
            bench = self.bench(label, size)
            kind = bench.yardstick.kind
            (curve,) = bench.curves([one], self.repeats, say)
        except (LCPError, ValueError) as error:
            is_refusal = n == 0 or isinstance(error, UnsuitableMatrix | UnsuitableProblem)
            curve = Curve(
                one.label, one.family, "REFUSED" if is_refusal else "ERROR", (), error_line(error)
            )
        except (
            Exception
        ) as error:  # whatever somebody's own code raises: the other rows are worth keeping
            curve = Curve(one.label, one.family, "ERROR", (), error_line(error))
        last, has = curve.last, bool(curve.points)
        points = json.dumps(finite_content(curve.points))
        return dict(
            zip(
                COLUMNS,
                (
                    label,
                    "" if size is None else size,
                    n,
                    nonzeros,
                    one.label,
                    one.family,
                    curve.status,
                    last.iteration if has else "",
                    *map(
                        _blank,
                        (
                            last.work,
                            last.seconds,
                            last.seconds_low,
                            last.seconds_high,
                            curve.setup_seconds,
                            last.residual,
                            last.error,
                        ),
                    ),
                    kind,
                    self.limits["tolerance"],
                    self.repeats,
                    curve.note,
                    self.machine,
                    _blank(radius),
                    "",
                    points if self.curves and has else "",
                ),
                strict=True,
            )
        )


def _radius(problem: Any, algorithm: Any) -> float:
    """Return the spectral radius that bounds a splitting's errors; NaN of any other method."""
    if not isinstance(problem, LCP) or not isinstance(algorithm, Algorithm):
        return math.nan
    try:
        facts = algorithm.facts(problem)
    except (UnsuitableMatrix, UnsuitableProblem):
        return math.nan
    found = None if facts is None else spectral_radius(problem, facts)
    return math.nan if found is None else found


def _blank(value: float) -> float | str:
    return "" if math.isnan(value) else value
