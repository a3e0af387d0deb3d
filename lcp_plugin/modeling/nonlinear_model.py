"""The nonlinear problem that a model became: its rows in their places, where to begin, and a look from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..errors import InvalidProblem
from ..problem.nonlinear import NonlinearProblem
from ._compat import dense, name_of
from .equations import Elimination, matched_for_monotony
from .model import Model, Sources
from .nonlinear_expressions import Compiler
from .nonlinear_program import Program

if TYPE_CHECKING:
    from .builder import Builder, Function

UNCERTAIN = 1e-3  # stands for entries of a derivative that are zero or infinite where equations are matched
DISAGREEMENT = 1e-9  # of 1 + |F|
ROUNDINGS = 100.0


def nonlinear_model(builder: Builder) -> Model:
    """Return the model of what a builder has collected, some of it not affine.

    Notes
    -----
    Nothing is eliminated: an unknown that an equation defines stays, and with it the sparsity of everything that it
    would be put in.
    """
    functions = [*(function for _, function, _ in builder.pairs), *builder.equations]
    program = _program(builder, functions)
    free = np.flatnonzero(~builder.is_paired)
    pairs = sum(columns.size for columns, _, _ in builder.pairs)
    builder.check_square(free, program.size - pairs)
    builder.drop_implied_bounds(free)
    columns = np.concatenate([*(columns for columns, _, _ in builder.pairs), np.zeros(0, dtype=np.int64)])
    signs = np.concatenate([*(sign for _, _, sign in builder.pairs), np.zeros(0)])
    if free.size:
        order, turned = _matched(program, builder, columns, signs, free)
        free = free[order]
        columns, signs = np.concatenate([columns, free]), np.concatenate([signs, turned])
    nothing = np.zeros(0, dtype=np.int64)
    elimination = Elimination(np.arange(builder.count), None, np.zeros(builder.count), nothing, nothing)
    builder.report_equations(elimination, free)
    places = np.argsort(columns, kind="stable")
    program = program.rearranged(places, signs[places])
    problem = NonlinearProblem(
        program.value, program.jacobian, lower=builder.lower, upper=builder.upper, enclosure=program
    )
    stored = sp.csr_array((pairs, builder.count)), sp.csr_array((program.size - pairs, builder.count))
    sources = builder.sources(stored, places, signs[places])
    return Model(problem, builder.variables, builder.offsets, builder.reports, elimination, sources)


def _program(builder: Builder, functions: list[Function]) -> Program:
    """Return the program of all functions, one below the other."""
    compiler = Compiler(builder.offsets, builder.count, builder.memo)
    for function in functions:
        compiler.add(function.nodes)
    return compiler.program([
        compiler.of_function(function.over(builder.count), function.blocks, function.offset) for function in functions
    ])


def _matched(
    program: Program, builder: Builder, columns: Any, signs: FloatVector, free: Any
) -> tuple[Any, FloatVector]:
    """Return for each equation its unknown among the free ones, and its sign, from a derivative inside the bounds."""
    derivative = program.jacobian(np.clip(1.0, builder.lower, builder.upper))
    sizes = np.where(np.isfinite(derivative.data), derivative.data, 0.0)
    derivative.data = np.where(sizes == 0.0, UNCERTAIN, sizes)
    pairs, equations = derivative[: columns.size], derivative[columns.size :]
    return matched_for_monotony(equations, sp.csr_array(sp.diags_array(signs) @ pairs), columns, free)


def start_of(problem: NonlinearProblem, values: FloatVector | None) -> FloatVector:
    """Return where to begin: the values, or the points within the bounds nearest to 0 and to 1, where F is smooth.

    Parameters
    ----------
    problem : NonlinearProblem
    values : array, shape (n,), or None
        The present values of the variables, where all have one.
    """
    given = [] if values is None or not np.isfinite(values).all() else [values]
    zero, one = np.zeros_like(problem.lower), np.ones_like(problem.lower)
    points: list[FloatVector] = [np.clip(point, problem.lower, problem.upper) for point in (*given, zero, one)]
    return next((point for point in points if _is_smooth_at(problem, point)), points[0])


def _is_smooth_at(problem: NonlinearProblem, point: FloatVector) -> bool:
    if not np.isfinite(problem.value(point)).all():
        return False
    try:
        problem.derivative(point)
    except InvalidProblem:  # it is not finite
        return False
    return True


def contradiction(sources: Sources, problem: NonlinearProblem, z: FloatVector, w: FloatVector) -> str | None:
    """Return what the expressions themselves, evaluated by cvxpy, say against w = F(z), or None.

    Parameters
    ----------
    sources : Sources
        Expressions whose variables have the values of z.
    problem : NonlinearProblem
        What was made of them; its enclosure says how much F may be off by rounding, nothing without one.
    z, w : array, shape (n,)
    """
    with np.errstate(all="ignore"):
        values = [np.ravel(dense(expression.value), order="F") for expression in sources.functions]
    for k, columns in sources.slacks.items():
        values[k] = values[k] - z[columns]
    theirs = sources.signs * np.concatenate(values)[sources.places]
    lower, upper = (0.0, 0.0) if problem.enclosure is None else problem.enclosure.interval_F(z, z)
    allowed = DISAGREEMENT * (1.0 + np.abs(w)) + ROUNDINGS * (upper - lower)
    wrong = np.flatnonzero(np.isfinite(w) & ~(np.abs(theirs - w) <= allowed))
    if not wrong.size:
        return None
    owner = np.searchsorted(np.cumsum([value.size for value in values]), sources.places[wrong[0]], side="right")
    less = " less its slack" if owner in sources.slacks else ""
    return (
        f"{name_of(sources.functions[owner])}{less} is {theirs[wrong[0]]:.9g} in one entry at the values of its "
        f"variables, and {w[wrong[0]]:.9g} was computed"
    )
