"""Convex programs of Maros and Mészáros: value and violations by every interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp
from inputs.published_problems import FOLDER, PROGRAMS, PublishedProgram

from lcp_plugin import QPSolver, QuadraticProgram, certify, solve
from lcp_plugin.interfaces.program_files import load_program
from lcp_plugin.interfaces.qpsolvers import register_with_qpsolvers

register_with_qpsolvers()
TOLERANCE, LARGEST_IN_A_BATCH = 1e-6, 3000
BY_SIZE = sorted(PROGRAMS, key=PROGRAMS.__getitem__)
SMALL = [name for name in BY_SIZE if PROGRAMS[name] <= LARGEST_IN_A_BATCH]
Answer = tuple[np.ndarray, float]


def one_sided(of: PublishedProgram) -> tuple[Any, ...]:
    """Return the rows that are not bounds, as G x ≤ h and A x = b, and the bounds."""
    rows, low, high, lower, upper = of.split()
    is_equation = low == high
    above, below = np.isfinite(high) & ~is_equation, np.isfinite(low) & ~is_equation
    G = sp.csc_matrix(sp.vstack([rows[above], -rows[below]]))
    h = np.concatenate([high[above], -low[below]])
    return G, h, sp.csc_matrix(rows[is_equation]), high[is_equation], lower, upper


def as_a_file(of: PublishedProgram, name: str) -> Answer:
    program = load_program(str(FOLDER / f"qp_{name}.npz"))
    result = solve(program)
    return result.x, result.objective


def as_rows(of: PublishedProgram, name: str) -> Answer:
    result = solve(QuadraticProgram.from_ranges(of.P, of.q, of.A, of.l, of.u, constant=of.r))
    return result.x, result.objective


def as_arrays(of: PublishedProgram, name: str) -> Answer:
    """Solve the program with ±1e20 for infinite bounds."""
    *rows, lower, upper = one_sided(of)
    result = solve(
        QuadraticProgram(of.P, of.q, *rows, np.maximum(lower, -1e20), np.minimum(upper, 1e20))
    )
    return result.x, result.objective + of.r


def in_qpsolvers(of: PublishedProgram, name: str) -> Answer:
    G, h, A, b, lower, upper = one_sided(of)
    rows = (G, h) if h.size else (None, None), (A, b) if b.size else (None, None)
    problem = qpsolvers.Problem(sp.csc_matrix(of.P), of.q, *rows[0], *rows[1], lower, upper)
    found = qpsolvers.solve_problem(problem, "lcp_plugin")
    return found.x, found.obj + of.r


def in_cvxpy(of: PublishedProgram, name: str, are_rows: bool = False) -> Answer:
    """Solve the program in cvxpy with ±1e20 for infinite bounds."""
    G, h, A, b, lower, upper = one_sided(of)
    limits = [np.maximum(lower, -1e20), np.minimum(upper, 1e20)]
    x = cp.Variable(of.q.size, bounds=None if are_rows else limits)
    rows = (
        [G @ x <= h] * bool(h.size)
        + [A @ x == b] * bool(b.size)
        + [limits[0] <= x, x <= limits[1]] * are_rows
    )
    objective = 0.5 * cp.quad_form(x, cp.psd_wrap(of.P)) + of.q @ x + of.r
    problem = cp.Problem(cp.Minimize(objective), rows)
    problem.solve(solver=QPSolver())
    return x.value, float(problem.value)


def in_cvxpy_by_rows(of: PublishedProgram, name: str) -> Answer:
    return in_cvxpy(of, name, are_rows=True)


WAYS: list[Callable[[PublishedProgram, str], Answer]] = [
    as_a_file, as_rows, as_arrays, in_qpsolvers, in_cvxpy, in_cvxpy_by_rows,
]  # fmt: skip


def agrees(of: PublishedProgram, x: np.ndarray, value: float) -> None:
    """Check value and violations of a solution, and the reported value."""
    error, violated = of.errors(x)
    assert error <= of.digits, f"the value is off by {error:.1e}"
    assert violated <= TOLERANCE, f"a row is violated by {violated:.1e} of its terms"
    assert abs(value - of.value) <= of.digits * abs(of.value), (
        "the value that is told is not that of x"
    )


@pytest.mark.quick(1)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_value_and_violations_are_those_published(name, way):
    """All interfaces give the published value, with ∞ and with 1e20 for infinite bounds."""
    of = PublishedProgram.read(name)
    agrees(of, *way(of, name))


@pytest.mark.parametrize("name", ["QBORE3D", "QCAPRI", "QSC205"])
def test_numbers_of_an_engine_at_rounding_level_are_zero(name):
    """An interior point ends near 0, not at 0; rows where all terms are such numbers are violated by their own size."""
    of = PublishedProgram.read(name)
    result = solve(QuadraticProgram.from_ranges(of.P, of.q, of.A, of.l, of.u, constant=of.r))
    assert result.is_solved
    agrees(of, result.x, result.objective)


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", SMALL)
def test_certify_proves_no_answer_that_is_wrong_by_what_was_published(name):
    """The published optimum is proved of no x that misses it."""
    of, rng = PublishedProgram.read(name), np.random.default_rng(0)
    rows, low, high, lower, upper = of.split()
    program = QuadraticProgram.from_ranges(of.P, of.q, rows, low, high, lower, upper)
    x = solve(program).x
    for size in (1e-3, 1e-2, 0.5):
        moved = x * (1.0 + size * rng.standard_normal(x.size))
        if max(of.errors(moved)) > 1e-4:
            assert certify(program, moved, max_seconds=10.0).verdict != "proved"


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", BY_SIZE)
def test_certify_proves_every_answer_of_ours(name):
    """Rows that a solve accepts relative to their terms are also accepted by certify."""
    result = solve(load_program(str(FOLDER / f"qp_{name}.npz")))
    assert certify(result).verdict == "proved"
