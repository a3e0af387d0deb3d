"""Points of external solvers: scaled, cleaned and polished, and tested on the unscaled program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ...core import deadline
from ...core.checks import Array, Vector
from ...core.entries import clip
from ...core.errors import InvalidOption, UnsuitableProblem
from ...engines import engine_class, is_installed, scaling
from ...engines.engine import Engine, EnginePoint, EngineStatus, ProgramData, SolverLimits
from ...engines.polish import POLISH_STEPS, polish_steps
from ...judges.program import NO_POLISH, SHARP, KKTErrors
from .program import QuadraticProgram
from .program_matrices import ProgramMatrices
from .solution import QPSolution

NO_MINIMUM = (EngineStatus.INFEASIBLE, EngineStatus.UNBOUNDED)
Scaled = Iterable[scaling.ScaledProgram]


def unscaled(data: ProgramData, matrices: ProgramMatrices) -> Scaled:
    """Return the program in the user's scaling."""
    return [scaling.ScaledProgram(data, np.ones(1), np.ones(1), 1.0).with_modest_costs()]


def fitted(data: ProgramData, matrices: ProgramMatrices) -> Scaled:
    """Return the program in the scaling fitted to its matrices."""
    return _without_far_limits(data, matrices.engine_units)


def sides_about_one(data: ProgramData, matrices: ProgramMatrices) -> Scaled:
    """Return the program in a scaling in which limits and costs are about 1."""
    return map(scaling.with_sides_about_one, _without_far_limits(data, matrices.largest_units))


def _without_far_limits(data: ProgramData, scales: Array) -> Scaled:
    """Return the scaled program; first without very large limits, if it has some."""
    scaled = scaling.ScaledProgram.from_units(data, *scales).with_modest_costs()
    near = scaling.without_far_limits(scaled.statement)
    return [scaled] if near is scaled.statement else [scaled._replace(statement=near), scaled]


Scaling = Callable[[ProgramData, ProgramMatrices], Scaled]
# PIQP's points for 29 published programs fail the test more often at 1e-11 than at 1e-12, and 1e-13 takes 1.5 times the
# steps for some of them. Dense kernel matrices of 1 000 rows reach neither, after all 150 steps.
# A run of PIQP that converges takes 10 to 45 steps. On an assignment of 60 × 60, whose point is optimal after 15 steps,
# it does not reach 1e-12 in 250 steps. A chain of second differences of 2 400 points passes only in `sides_about_one`.
ATTEMPTS: tuple[tuple[str, float | None, int | None, Scaling], ...] = (
    # engine, its tolerance, limit of steps in auto if not the engine's default, scaling
    ("daqp", None, None, unscaled),
    ("piqp", 1e-12, 60, fitted),
    ("piqp", 1e-13, None, fitted),
    ("piqp", 1e-12, None, sides_about_one),
    ("highs", None, None, fitted),
    ("clarabel", 1e-12, None, unscaled),
    ("clarabel", 1e-9, None, sides_about_one),
)
# With much fill, a step of PIQP takes up to 10 s, and nothing interrupts it. HiGHS pivots; Clarabel's factorization is
# up to 20 times as fast then.
ORDER_WITH_FILL = "highs", "clarabel", "daqp", "piqp"
TOLERANCE_NAMES = MappingProxyType(
    {
        "piqp": ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
        "clarabel": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    }
)


class ProgramPoint(NamedTuple):
    """Measured point of a run, as :class:`~lcp_plugin.judges.lcp.Measured`.

    Attributes
    ----------
    solution : QPSolution
        Of an engine the best of its points: original, cleaned or polished.
    errors : KKTErrors
        Two measures of the solution.
    passes : bool
        Whether the measures meet the tolerance.
    reported : EngineStatus
        Status that the engine reports for its last point.
    name : str
    iterations : int
    is_limited : bool
        False: a later engine may have a better point.
    scaling : str
        Scaling of the data for the engine.
    seconds : float
        Wall-clock seconds of the engine and of the measures.
    """

    solution: QPSolution
    errors: KKTErrors
    passes: bool
    reported: EngineStatus = EngineStatus.GAVE_UP
    name: str = ""
    iterations: int = 0
    is_limited: bool = False
    scaling: str = ""
    seconds: float = 0.0

    def describe(self) -> str:
        """Return the scaling, both measures, the engine's own status and the seconds, as text."""
        scale = self.scaling.replace("_", " ")
        measures = f"rows {self.errors.primal:.1e}, gap {self.errors.gap:.1e}"
        return (
            f"scaling: {scale}; {measures}; it reports {self.reported.value}; {self.seconds:.3g} s"
        )

    @classmethod
    def of(
        cls, solution: QPSolution, tolerance: float, name: str, iterations: int = 0
    ) -> ProgramPoint:
        """Return the measured point of a solution."""
        errors = solution.errors_for(tolerance)
        return cls(solution, errors, bool(errors.meet(tolerance)), name=name, iterations=iterations)

    @property
    def residual(self) -> float:
        """The larger of both measures."""
        return float(self.errors.largest)


def attempts(program: QuadraticProgram, engine: Any = None) -> Iterator[tuple[Engine, Scaling]]:
    """Yield the engines that may solve a program, with the scaling for each.

    Parameters
    ----------
    engine : Engine, optional
        If given, only this engine runs; its options override the options of an attempt.

    Examples
    --------
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> [engine.name for engine, scale in attempts(program)]
    ['daqp', 'piqp', 'piqp', 'piqp', 'clarabel', 'clarabel']
    """
    matrices, ladder = program.matrices, ATTEMPTS
    if engine is None and program.folded.reduced.matrices.fills_in:
        ladder = tuple(sorted(ATTEMPTS, key=lambda attempt: ORDER_WITH_FILL.index(attempt[0])))
    for name, tolerance, steps, scale in ladder:
        length = matrices.entries[0] / max(program.n, 1) if name == "piqp" else 0.0
        # Longer sums have larger rounding errors, below which PIQP takes all its steps
        factor = max(1.0, length / 64.0)  # 16 for a dense kernel matrix of 1 000 rows
        options = dict.fromkeys(TOLERANCE_NAMES[name], tolerance * factor) if tolerance else {}
        if engine is not None:
            if name == engine.name:
                yield type(engine)(**{**options, **engine.options}), scale
        elif not is_installed(name):
            continue
        elif name == "daqp":
            # Its proximal steps drift away if nothing bends: linear programs in units of 1e9 ended at x = 1e21
            if matrices.is_small and matrices.has_curvature:
                yield engine_class(name)(), scale
        elif name != "highs" or not matrices.has_curvature:
            limit = {} if steps is None else {"max_iter": steps}
            yield engine_class(name)(**options, **limit), scale


def run_engine(
    program: QuadraticProgram,
    engine: Engine,
    tolerance: float,
    scale: Scaling,
    *,
    is_verbose: bool = False,
    end: EnginePoint | None = None,
) -> ProgramPoint:
    """Return the best of the measured points of an engine: plain, without noise, and polished where that is cheap.

    An `end` is the engine's on the reduced program, if it ran already.

    Raises
    ------
    UnsuitableProblem
        If the engine accepts only linear programs and P has nonzeros.
    """
    if engine.is_for_linear_alone and program.matrices.has_curvature:
        raise UnsuitableProblem(
            f'{engine.name} solves {engine.solves}, but P has nonzeros; take "piqp", or give P = None'
        )
    reduced, clock = program.folded.reduced, deadline.Clock()
    best, iterations, reported = None, 0, EngineStatus.GAVE_UP
    errors, passes = KKTErrors(np.inf, np.inf), False
    for scaled in _statements(reduced, scale):
        try:
            if end is None or not is_of(scaled.statement, reduced):
                end = engine.solve(scaled.statement, SolverLimits(deadline.left(), is_verbose))
            point, end = end, None
        except Exception:  # an external solver may raise any error for an option
            _check_engine(engine)
            raise
        iterations, reported = iterations + point.iterations, point.reported
        rounds = 0 if reported in NO_MINIMUM else POLISH_STEPS
        is_small, size = reduced.matrices.is_small, sum(reduced.matrices.stacked[1].shape)
        is_cheap = is_small or point.iterations >= 20  # two factorizations take a tenth of its time
        for near, is_polished in points_of_engine(scaled.statement, point, rounds):
            back = scaled.outward(near)
            x, y = clip(back.x, reduced.lower, reduced.upper), back.y
            measures, x = KKTErrors.with_point(reduced.judged, x, y, tolerance)
            is_good = bool(measures.meet(tolerance))
            if (is_good, -measures.largest) > (passes, -errors.largest):
                best, errors, passes = (x, y), measures, is_good
            enough = size * (SHARP / 64.0 if is_polished else NO_POLISH)
            is_best = not is_cheap or (is_polished and not is_small) or errors.gap <= enough
            if deadline.is_over() or (passes and is_best):
                break
        if passes or deadline.is_over():
            break
    solution = QPSolution.from_reduced(program, *(best or nearest(program)))
    found = ProgramPoint(solution, errors, passes, reported, engine.name, iterations)
    return found._replace(scaling=getattr(scale, "__name__", ""), seconds=clock.read())


def is_of(data: ProgramData, reduced: QuadraticProgram) -> bool:
    """Return whether the vectors of the data are the vectors of a program, and not scaled."""
    return all(getattr(data, name) is getattr(reduced, name) for name in reduced.vector_names)


def nearest(program: QuadraticProgram) -> tuple[Vector, Vector]:
    """Return x nearest to 0 within the bounds, without multipliers; in a linear program, x moved by its costs."""
    reduced = program.folded.reduced
    x = np.clip(0.0, reduced.lower, reduced.upper)
    rows = reduced.h.size + reduced.b.size
    if not rows and not reduced.matrices.has_curvature:
        end = np.where(reduced.c > 0.0, reduced.lower, reduced.upper)
        x = np.where((reduced.c != 0.0) & np.isfinite(end), end, x)
    return x, np.zeros(rows)


def points_of_engine(
    statement: ProgramData, point: EnginePoint, rounds: int
) -> Iterator[tuple[EnginePoint, bool]]:
    """Yield points that may be the solution near a point, and whether they are polished.

    Before the point and each polished point comes the same point with noise set to 0. Before the polish comes the point
    of the bounds nearest to 0, because an optimum of 0 has no largest unknown next to which noise is small.
    """
    origin = point._replace(x=np.clip(0.0, statement.lower, statement.upper))
    has_origin = not statement.b.any() and (statement.h >= 0.0).all()
    begin = [point, origin] if has_origin else [point]
    for near in chain(begin, polish_steps(statement, point, rounds)):
        clean = near._replace(x=without_noise(near.x), y=without_noise(near.y))
        is_polished = near is not point and near is not origin
        if not (np.array_equal(clean.x, near.x) and np.array_equal(clean.y, near.y)):
            yield clean, is_polished
        yield near, is_polished


def without_noise(values: Vector) -> Vector:
    """Return the values with 0 at rounding level of the largest."""
    sizes = np.abs(values)
    # An interior point reaches 0 only to this
    return np.where(sizes <= 2.0**-40 * sizes.max(initial=0.0), 0.0, values)


def _statements(reduced: QuadraticProgram, scale: Scaling) -> Iterator[scaling.ScaledProgram]:
    """Yield the program as scaled for an attempt; first without very large right-hand sides, if it has some."""
    (P, G, A), bounds = reduced.matrices.arrays, (reduced.lower, reduced.upper)
    stated = ProgramData(P, reduced.c, G, reduced.h, A, reduced.b, *bounds)
    allowed = scaling.without_forbidden(stated)
    for data in (stated,) if allowed is stated else (allowed, stated):
        yield from scale(data, reduced.matrices)


def _check_engine(engine: Engine) -> None:
    """Raise InvalidOption if the engine does not solve a program of one unknown with its options."""
    none = np.zeros((0, 1)), np.zeros(0)
    problem = ProgramData(np.zeros((1, 1)), np.ones(1), *none, *none, np.zeros(1), np.ones(1))
    try:
        engine.solve(problem, SolverLimits())
    except Exception as error:
        tolerances = TOLERANCE_NAMES.get(engine.name, ())
        asked = {name: value for name, value in engine.options.items() if name not in tolerances}
        text = ", ".join(f"{name}={value!r}" for name, value in (asked or engine.options).items())
        # The first sentence, or the head of a binding's list of signatures
        why = str(error).splitlines()[0].removeprefix("(): ").partition(". The following")[0]
        raise InvalidOption(f"{engine.name} does not take {text}: {why}") from error
