"""Points of external solvers: scaled, cleaned and polished, and tested on the unscaled program."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice, product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ...core.checks import FloatVector
from ...core.deadline import is_over, seconds_left
from ...core.errors import InvalidOption, UnsuitableProblem
from ...engines import (
    Engine,
    EngineAnswer,
    EngineStatus,
    ProgramData,
    SolverLimits,
    engine_class,
)
from ...engines.polish import ROUNDS, polish_steps
from ...engines.scaling import (
    ScaledProgram,
    with_sides_about_one,
    without_far_limits,
    without_forbidden,
)
from .criterion import KKTErrors
from .program import QuadraticProgram
from .solution import QPSolution

NO_MINIMUM = (EngineStatus.INFEASIBLE, EngineStatus.UNBOUNDED)
NOISE = 2.0**-40  # of the largest: an interior point reaches 0 only to this
TINY = 2.0**-20  # x or multipliers that may all be noise, where solutions are about 1
GIVEN, FITTED, SIDES = "the caller's units", "fitted units", "units of limits and costs"
# PIQP's points for 29 published programs fail the test more often at 1e-11 than at 1e-12, and 1e-13 takes 1.5 times the
# steps for some of them. Dense kernel matrices of 1 000 rows reach neither, after all 150 steps.
ATTEMPTS = (  # engine, tolerance of its own, units
    ("daqp", None, GIVEN),
    ("piqp", 1e-12, FITTED),
    ("piqp", 1e-13, FITTED),
    ("piqp", 1e-12, SIDES),
    ("highs", None, FITTED),
    ("clarabel", 1e-12, GIVEN),
    ("clarabel", 1e-9, SIDES),
)
SHORT_ROW = 64.0  # entries of P; longer sums have larger rounding errors, below which PIQP takes all its steps
TOLERANCES = MappingProxyType(
    {
        "piqp": ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
        "clarabel": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    }
)


class ProgramPoint(NamedTuple):
    """Measured point of a run, as :class:`~lcp_plugin.core.certificates.measured.Measured`.

    Attributes
    ----------
    solution : QPSolution
        Of an engine the best of its points: original, cleaned or polished.
    errors : KKTErrors
        Two measures of the solution.
    passes : bool
        Whether the measures meet the tolerance.
    says : EngineStatus
        Status that the engine reports for its last point.
    name : str
    iterations : int
    is_limited : bool
        False: a later engine may have a better point.
    """

    solution: QPSolution
    errors: KKTErrors
    passes: bool
    says: EngineStatus = EngineStatus.GAVE_UP
    name: str = ""
    iterations: int = 0
    is_limited: bool = False

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


def attempts(program: QuadraticProgram, engine: Any = None) -> Iterator[tuple[Engine, str]]:
    """Yield the engines that may solve a program, with the units for each.

    Parameters
    ----------
    engine : Engine, optional
        If given, only this engine runs; its options override the options of an attempt.

    Examples
    --------
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> [engine.name for engine, units in attempts(program)]
    ['daqp', 'piqp', 'piqp', 'piqp', 'clarabel', 'clarabel']
    """
    matrices = program.matrices
    for name, tolerance, units in ATTEMPTS:
        length = matrices.sparse_P.nnz / max(program.n, 1) if name == "piqp" else 0.0
        factor = max(1.0, length / SHORT_ROW)  # 16 for a dense kernel matrix of 1 000 rows
        options = dict.fromkeys(TOLERANCES[name], tolerance * factor) if tolerance else {}
        if engine is not None:
            if name == engine.name:
                yield type(engine)(**{**options, **engine.options}), units
        elif name == "daqp":
            if matrices.is_small:
                yield engine_class(name)(), units
        elif name != "highs" or not matrices.has_curvature:
            yield engine_class(name)(**options), units


def run_engine(
    program: QuadraticProgram,
    engine: Engine,
    tolerance: float,
    units: str,
    *,
    is_verbose: bool = False,
) -> ProgramPoint:
    """Return the first point of an engine that passes the test, or its best point.

    Raises
    ------
    UnsuitableProblem
        If the engine accepts only linear programs and P has nonzeros.
    """
    if engine.is_for_linear_alone and program.matrices.has_curvature:
        raise UnsuitableProblem(
            f'{engine.name} solves {engine.solves}, but P has nonzeros; take "piqp", or give P = None'
        )
    reduced = program.folded.reduced
    best, iterations, says = None, 0, EngineStatus.GAVE_UP
    errors, passes = KKTErrors(np.inf, np.inf), False
    for scaled in _statements(reduced, units):
        point = _call_engine(engine, scaled.statement, is_verbose)
        iterations, says = iterations + point.iterations, point.says
        rounds = 0 if says in NO_MINIMUM else ROUNDS
        for near in candidates(scaled.statement, point, rounds):
            back = scaled.outward(near)
            x, y = np.minimum(np.maximum(back.x, reduced.lower), reduced.upper), back.y
            found = KKTErrors.of(reduced, x, y, tolerance)
            is_good = bool(found.meet(tolerance))
            is_better = found.largest < errors.largest or is_good
            if is_better and not (passes and found.tolerated):
                best, errors, passes = (x, y), found, is_good
            if (is_good and not found.tolerated) or is_over():
                break
        if passes or is_over():
            break
    solution = QPSolution.from_reduced(program, *(best or nearest(program)))
    return ProgramPoint(solution, errors, passes, says, engine.name, iterations)


def nearest(program: QuadraticProgram) -> tuple[FloatVector, FloatVector]:
    """Return x nearest to 0 within the bounds, without multipliers; in a linear program, x moved by its costs."""
    reduced = program.folded.reduced
    x = np.clip(0.0, reduced.lower, reduced.upper)
    rows = reduced.h.size + reduced.b.size
    if not rows and not reduced.matrices.has_curvature:
        end = np.where(reduced.c > 0.0, reduced.lower, reduced.upper)
        x = np.where((reduced.c != 0.0) & np.isfinite(end), end, x)
    return x, np.zeros(rows)


def candidates(statement: ProgramData, point: EngineAnswer, rounds: int) -> Iterator[EngineAnswer]:
    """Yield points that may be the solution near a point: the point, and polished, each with noise set to 0.

    If all of x is tiny, all of it may be noise; the same holds for the multipliers.
    """
    for one in chain([point], polish_steps(statement, point, rounds)):
        yield one
        clean = quiet(one)
        pairs = product(*(_with_zero(values) for values in (clean.x, clean.y)))
        for x, y in islice(pairs, int(clean is one), None):  # the first may be the point again
            yield one._replace(x=x, y=y)


def _with_zero(values: FloatVector) -> tuple[FloatVector, ...]:
    """Return the values and, if all are tiny, zeros: in the units of an engine, its noise is below 2⁻²⁰."""
    return (values, np.zeros_like(values)) if np.abs(values).max(initial=0.0) <= TINY else (values,)


def quiet(point: EngineAnswer) -> EngineAnswer:
    """Return the point with 0 in place of x and multipliers of rows at rounding level of the largest, if any."""
    of_y, of_x = np.abs(point.y), np.abs(point.x)
    y = np.where(of_y <= NOISE * of_y.max(initial=0.0), 0.0, point.y)
    x = np.where(of_x <= NOISE * of_x.max(initial=0.0), 0.0, point.x)
    if (x == point.x).all() and (y == point.y).all():
        return point
    return point._replace(x=x, y=y)


def _statements(reduced: QuadraticProgram, units: str) -> Iterator[ScaledProgram]:
    """Yield the program as scaled for an attempt; if it is scaled, first without very large right-hand sides."""
    (P, G, A), one = reduced.matrices.arrays, reduced
    given = ProgramData(P, one.c, G, one.h, A, one.b, one.lower, one.upper)
    allowed = without_forbidden(given)
    for data in (given,) if allowed is given else (allowed, given):
        if units is GIVEN:
            yield ScaledProgram(data, np.ones(1), np.ones(1), 1.0).with_modest_costs()
            continue
        scales = one.matrices.engine_units if units is FITTED else one.matrices.largest_units
        fitted = ScaledProgram.from_units(data, *scales).with_modest_costs()
        near = without_far_limits(fitted.statement)
        every = (fitted,) if near is fitted.statement else (fitted._replace(statement=near), fitted)
        yield from every if units is FITTED else map(with_sides_about_one, every)


def _call_engine(engine: Engine, statement: ProgramData, is_verbose: bool) -> EngineAnswer:
    """Return the point of an engine."""
    try:
        return engine.answer(statement, SolverLimits(seconds_left(), is_verbose))
    except Exception:  # an external solver may raise any error for an option
        _check_options(engine)
        raise


def _check_options(engine: Engine) -> None:
    """Raise InvalidOption if the engine does not solve a program of one unknown with its options."""
    none = np.zeros((0, 1)), np.zeros(0)
    one = ProgramData(np.zeros((1, 1)), np.ones(1), *none, *none, np.zeros(1), np.ones(1))
    try:
        engine.answer(one, SolverLimits())
    except Exception as error:
        own = TOLERANCES.get(engine.name, ())
        asked = {name: value for name, value in engine.options.items() if name not in own}
        given = ", ".join(f"{name}={value!r}" for name, value in (asked or engine.options).items())
        raise InvalidOption(
            f"{engine.name} does not take {given}: {_shorten_message(error)}"
        ) from error


def _shorten_message(error: Exception) -> str:
    """Return the first sentence of an external error message, or the head of a binding's list of signatures."""
    return str(error).splitlines()[0].removeprefix("(): ").partition(". The following")[0]
