"""Every problem class rejects the constructed wrong points: a table of classes and cases.

A class is a function from a case to its points, each with the mark whether it is SOLVED. Add a class here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.small_nonlinear import SHAPES, curved
from inputs.constructed_points import CONSTRUCTED, Case

from lcp_plugin import LCP, ConeProblem, FrictionalContact, certify, march, solve, solve_batch

Points = Iterator[tuple[Any, bool]]
FURTHER_ROWS = 200  # of a band, so that a march takes its steps on bands
LINK = 2.0**-60  # entry next to the diagonal of these rows
METHODS = ("npsor", "psor", "newton", "lemke", "interior_point")


def lcp_points(case: Case) -> Points:
    """Yield the results of an LCP, dense and sparse, from the wrong point and from z°."""
    for M in (case.M, sp.csr_array(case.M)):
        for z0 in (case.wrong, None):
            result = solve(LCP(M, case.q, lower=case.lower), z0=z0)
            assert result.is_solved is (case.right is not None)
            yield result.z, result.is_solved


def method_points(method: str, case: Case) -> Points:
    """Yield the results of a named method, from the wrong point and from z°."""
    problem = LCP(case.M, case.q, lower=case.lower)
    for z0 in (case.wrong, None) if method != "psor" or (problem.diagonal > 0.0).all() else ():
        result = solve(problem, method, z0=z0, max_iterations=20_000)
        yield result.z, result.is_solved


def stack_points(case: Case) -> Points:
    """Yield the points of a batch, with the matrix shared and with one per problem, and the results of its items."""
    starts = [case.wrong, case.lower]
    for M in (case.M, np.array([case.M, case.M])):
        batch = solve_batch(M, [case.q, case.q], lower=case.lower, z0=starts)
        for k in range(2):
            assert batch[k].status is batch.status[k]
            assert batch[k].z.tobytes() == batch.z[k].tobytes()
            assert batch[k].is_solved is (case.right is not None)
            yield batch.z[k], batch[k].is_solved


def march_points(problem: LCP, case: Case) -> Points:
    """Yield the points of three steps with the same data, from the wrong point and from z°."""
    further = np.zeros(problem.n - case.q.size)
    for z0 in (np.concatenate([case.wrong, further]), problem.nearest_to_zero):
        each = [problem.with_data(lower=problem.lower) for _ in range(3)]
        for stated in (problem, each, [problem.with_data(M=problem.M) for _ in range(3)]):
            forcing: Any = np.broadcast_to(problem.q, (3, problem.n))
            done = march(stated, forcing, propagator=0.0, z0=z0)
            for k, z in enumerate(done.z):
                assert done[k].status is done.status[k]
                assert done[k].z.tobytes() == z.tobytes()
                yield z, done[k].is_solved


def dense_march_points(case: Case) -> Points:
    """Yield the steps of a march with a dense matrix."""
    return march_points(LCP(case.M, case.q, lower=case.lower), case)


def band_march_points(case: Case) -> Points:
    """Yield the steps of a march over a band: the case, and 200 rows z_i + 2⁻⁶⁰ z_{i−1} + 1."""
    m, n = case.q.size, case.q.size + FURTHER_ROWS
    M = sp.lil_array((n, n))
    M[:m, :m] = case.M
    for i in range(m, n):
        M[i, i], M[i, i - 1] = 1.0, LINK
    q = np.concatenate([case.q, np.ones(FURTHER_ROWS)])
    lower = np.concatenate([case.lower, np.zeros(FURTHER_ROWS)])
    return march_points(LCP(M.tocsr(), q, lower=lower), case)


def by_three_ways(problem: ConeProblem | FrictionalContact, wrong: np.ndarray) -> Points:
    """Yield the points of solve, a batch and a march from the wrong point and from none."""
    for z0 in (wrong, None):
        starts = None if z0 is None else [z0, z0]
        batch = solve_batch([problem, problem], z0=starts)
        steps = march(problem, [problem.q], propagator=0.0, z0=z0)
        yield from ((one.z, one.is_solved) for one in (solve(problem, z0=z0), *batch, *steps))


def cone_points(case: Case) -> Points:
    """Yield the points over the cone of the bounds, dense and sparse, of solve, a batch and a march."""
    for M in (case.M, sp.csr_array(case.M)):
        problem = ConeProblem(M, case.q, [("box", case.lower, np.inf)])
        yield from by_three_ways(problem, case.wrong)


def contact_points(case: Case) -> Points:
    """Yield the normal impulses of contacts that do not slide: normal rows M, tangential rows the identity."""
    if case.lower.any() or (case.M != case.M.T).any():  # of contacts W is symmetric, and r_N ≥ 0
        return
    n = case.q.size
    W, b, wrong = np.eye(2 * n), np.zeros(2 * n), np.zeros(2 * n)
    W[::2, ::2], b[::2], wrong[::2] = case.M, case.q, case.wrong
    points = by_three_ways(FrictionalContact(W, b, 0.5, dimension=2), wrong)
    yield from ((z[::2], is_solved) for z, is_solved in points)


def nonlinear_points(shape: str, case: Case) -> Points:
    """Yield the results for F = M x + q, or for a curved F with the same solutions."""
    linear = LCP(case.M, case.q, lower=case.lower)
    problem, z_of, y_of = curved(linear, shape, float(np.abs(case.q).max()))
    for x0 in (y_of(case.wrong), None):
        result = solve(problem, x0=x0, max_seconds=1.0)
        yield z_of(result.z), result.is_solved


def rank_points(case: Case) -> Points:
    """Yield the wrong point as a single rank measures it."""
    pytest.importorskip("mpi4py")
    from lcp_plugin.ranks.problem import RowsOnRanks
    from lcp_plugin.ranks.solving import RowDataOnRanks

    data = RowDataOnRanks(RowsOnRanks.from_rows(None, sp.csr_array(case.M), case.q, case.lower))
    found = data.measure(case.wrong, 1e-8)
    yield found.z, bool(found.passes)


CLASSES: dict[str, Callable[[Case], Points]] = {
    "LCP": lcp_points,
    "stack": stack_points,
    "march, dense": dense_march_points,
    "march, band": band_march_points,
    "cones": cone_points,
    "contacts": contact_points,
    "ranks": rank_points,
    **{method: partial(method_points, method) for method in METHODS},
    **{f"nonlinear, {shape}": partial(nonlinear_points, shape) for shape in SHAPES},
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("case", CONSTRUCTED)
@pytest.mark.parametrize("problem_class", CLASSES)
def test_no_class_calls_a_wrong_point_solved(problem_class, case):
    """A SOLVED point is the solution; a problem without a solution is never SOLVED."""
    for z, is_solved in CLASSES[problem_class](CONSTRUCTED[case]):
        CONSTRUCTED[case].judge(z, is_solved=is_solved)


@pytest.mark.parametrize(("size", "verdict"), [(2.0**36, "disproved"), (2.0**44, "proved")])
def test_a_demand_below_the_limit_is_noise(size, verdict):
    """A demand of 1 next to terms above 2⁴² is noise, and counts below: the limit of SOLVED, in solved.md."""
    problem = LCP([[1, -1, 0], [-1, 1, 0], [1, 0, 1]], [-1, 0, -size])
    assert certify(problem, [size, size, 0]).verdict == verdict
