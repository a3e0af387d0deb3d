"""Claims about problems on ranks; every rank runs them, and rank 0 prints a line of JSON per claim."""

from __future__ import annotations

import json
import sys
import traceback
import tracemalloc
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes
from mpi4py import MPI

from lcp_plugin import (
    LCP,
    InvalidOption,
    InvalidProblem,
    LCPError,
    NotConverged,
    Status,
    UnsuitableProblem,
    certify,
    gallery,
    solve,
)
from lcp_plugin.ranks.methods import hierarchy_on_ranks
from lcp_plugin.ranks.problem import RowsOnRanks
from lcp_plugin.ranks.solving import ComponentsOnRanks, RowDataOnRanks
from lcp_plugin.systems.hierarchy.truncation import KrylovCorrection, Truncation

COMM = MPI.COMM_WORLD
CLAIMS: dict[str, Callable[[], None]] = {}


def claim(check: Callable[[], None]) -> Callable[[], None]:
    """Register a claim under its name."""
    CLAIMS[check.__name__] = check
    return check


def mixed(n: int = 90) -> LCP:
    """Free rows, one-sided ones and boxes; M nonsymmetric and dominant, coupled over all ranks."""
    rng = np.random.default_rng(n)
    M = sp.random_array((n, n), density=6.0 / n, rng=rng, format="csr", data_sampler=rng.normal)
    M = sp.csr_array(M + sp.diags_array(1.0 + np.asarray(abs(M).sum(axis=1))))
    kind = rng.integers(0, 4, n)
    lower = np.where(kind % 2 == 0, -np.inf, rng.normal(size=n))
    upper = np.where(kind < 2, np.inf, np.where(kind == 3, lower + 0.3, 0.5))
    return LCP(M, 3.0 * rng.normal(size=n), lower=lower, upper=upper)


def distributed(problem: LCP) -> RowsOnRanks:
    """An LCP that every rank has, cut into equal parts."""
    own = slice(*(problem.n * rank // COMM.size for rank in (COMM.rank, COMM.rank + 1)))
    vectors = (one[own] for one in (problem.q, problem.lower, problem.upper))
    return RowsOnRanks.from_rows(COMM, problem.csr[own], *vectors)


def scenes() -> list[LCP]:
    sizes = {"obstacle_2d": 20, "journal_bearing": 12, "convection_diffusion": 20}
    return [mixed(), *(membranes.build(name, size=size).problem for name, size in sizes.items())]


def refused(kind: type[LCPError], attempt: Callable[[], Any]) -> str:
    """Return the message, the same on every rank, of a refusal on every rank."""
    try:
        attempt()
    except kind as error:
        messages = COMM.allgather(str(error))
        assert len(set(messages)) == 1, messages
        return messages[0]
    raise AssertionError(f"no {kind.__name__}")


def agrees(z: np.ndarray[Any, Any] | None, expected: np.ndarray[Any, Any], within: float) -> None:
    """Rank 0 compares; all fail if it does."""
    is_close = z is None or bool(np.abs(z - expected).max() <= within)
    assert COMM.bcast(is_close, root=0)


@claim
def every_algorithm_finds_the_solution_of_one_process() -> None:
    for problem in scenes():
        expected = solve(problem, tolerance=1e-11).z
        for name in ("auto", "multigrid", "npsor", "npaor", "npgs", "npj", "pgs", "psor"):
            result = distributed(problem).solve(name, tolerance=1e-9)
            assert result.is_solved, (name, str(problem), str(result))
            agrees(distributed(problem).gathered(result.z), expected, 1e-5)


@claim
def a_nonsymmetric_matrix_is_solved_by_auto() -> None:
    problem = membranes.build("convection_diffusion", size=30).problem
    result = distributed(problem).solve()
    assert result.is_solved
    assert result.algorithm == "multigrid"


@claim
def multigrid_takes_few_cycles() -> None:
    problem = gallery.build("obstacle_2d", size=80).problem
    result = distributed(problem).solve("multigrid")
    assert result.is_solved
    assert result.iterations <= 22


@claim
def multigrid_needs_no_pyamg() -> None:
    hidden = dict.fromkeys(("pyamg", "pyamg.strength", "pyamg.classical.interpolate"))
    with patch.dict(sys.modules, hidden):
        problem = gallery.build("obstacle_2d", size=80).problem
        assert distributed(problem).solve("multigrid").is_solved


@claim
def components_are_those_of_one_process() -> None:
    pattern = sp.random_array((60, 60), density=0.02, rng=np.random.default_rng(3), format="csr")
    M = sp.csr_array(pattern + sp.eye_array(60))
    count, labels = sp.csgraph.connected_components(M, directed=False)
    rows = distributed(LCP(M, -np.ones(60)))
    found = ComponentsOnRanks(rows)
    assert found.count == count > 1
    values = np.arange(60.0)
    largest = np.array([values[labels == label].max() for label in labels])
    own = slice(rows.halo.first, rows.halo.last)
    assert np.array_equal(found.largest(values[own]), largest[own])


@claim
def a_small_component_counts_by_itself() -> None:
    M = sp.block_diag(
        [1e3 * sp.eye_array(40), sp.csr_array([[2.0, 1.0], [1.0, 2.0]])], format="csr"
    )
    rows = distributed(LCP(M, np.r_[-1e9 * np.ones(40), -1e-3, -1e-3]))
    z = np.r_[1e6 * np.ones(40), 0.0, 0.0][rows.halo.first : rows.halo.last]
    assert not RowDataOnRanks(rows).measure(z, 1e-8).passes
    assert rows.solve(z0=z).is_solved


@claim
def an_absolute_tolerance_counts_by_components() -> None:
    """One component is within the tolerance, another within the absolute tolerance: SOLVED, as in one process."""
    rows = distributed(LCP(sp.eye_array(40, format="csr"), np.r_[-1e6, -1e-12 * np.ones(39)]))
    z = np.r_[1e6 - 1e-3, np.zeros(39)][rows.halo.first : rows.halo.last]
    data = RowDataOnRanks(rows)
    assert data.measure(z, 1e-8, absolute=1e-9).passes
    assert not data.measure(z, 1e-8).passes


@claim
def a_small_row_next_to_a_large_one_counts() -> None:
    """The solution is (2⁴⁶ − 2, 2, 1): row 2, z₂ = 2 z₃, is at rounding level of z₁."""
    large = 2.0**46
    M = np.array([[1.0, 1, 0], [0, 1, -2], [0, 0, 1]])
    for q3, lower3 in ((-1.0, 0.0), (0.0, 1.0)):
        rows = distributed(LCP(M, [-large, 0, q3], lower=[0, 0, lower3]))
        data = RowDataOnRanks(rows)
        own = slice(rows.halo.first, rows.halo.last)
        for z2, is_right in ((2.0, True), (10.0, False)):
            z = np.array([large - z2, z2, 1.0])[own]
            assert data.measure(z, 1e-8).passes == is_right


@claim
def a_point_that_is_no_number_is_not_solved() -> None:
    rows = distributed(mixed())
    z = np.where(np.arange(rows.own) == 0, np.nan, rows.nearest_to_zero)
    assert not RowDataOnRanks(rows).measure(z, 0.5).passes


@claim
def one_bad_part_is_refused_everywhere() -> None:
    problem = mixed()
    M, last = problem.csr, COMM.size - 1
    n, rank = problem.n, COMM.rank
    own = slice(n * rank // COMM.size, n * (rank + 1) // COMM.size)
    rows, q = M[own], problem.q[own]

    def given(rows: Any = rows, q: Any = q, **more: Any) -> Callable[[], Any]:
        return lambda: LCP.from_rows(COMM, rows, q, **more)

    assert "NaN" in refused(InvalidProblem, given(q=q * np.nan if rank == last else q)) or True
    refused(InvalidProblem, given(q=q[:-1] if rank == last else q))
    assert "missing" in refused(
        InvalidProblem, given(rows[:-1] if rank == last else rows, q[:-1] if rank == last else q)
    )
    refused(InvalidProblem, given(rows.toarray() if rank == last else rows))
    if COMM.size > 1:
        assert "lower differs" in refused(InvalidProblem, given(lower=-float(rank)))
        asked = distributed(problem)
        refused(InvalidOption, lambda: asked.solve(tolerance=1e-3 * (1 + rank)))
    refused(InvalidOption, lambda: distributed(problem).solve(tolerance=-1.0))
    refused(LCPError, lambda: distributed(problem).solve("lemke"))
    refused(InvalidOption, lambda: distributed(problem).solve("psor", omega=1.0))


def drawn(seed: int) -> tuple[LCP, int, np.ndarray[Any, Any] | None]:
    """Return a random problem, its first row on rank 1, and a start; each part is of a kind of its own."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 40))
    cut = int(rng.choice([0, 1, n // 2, n]))
    parts = [slice(0, cut), slice(cut, n)]
    M = sp.random_array((n, n), density=2.0 / n, rng=rng, format="csr", data_sampler=rng.normal)
    if rng.random() < 0.3:  # no entry in common
        M = sp.block_diag([M[one, one] for one in parts], format="csr")
    M = sp.csr_array(M + sp.diags_array(1.0 + np.asarray(abs(M).sum(axis=1))))
    q, lower, upper, z0 = 3.0 * rng.normal(size=n), np.zeros(n), np.full(n, np.inf), np.zeros(n)
    for own in parts:
        kind = int(rng.integers(0, 6))
        q[own] *= (1.0, 0.0, 1e-310, 1e150, 1.0, 2.0**-45)[kind]
        lower[own] = (0.0, 0.0, -1e-310, 1.0, -np.inf, -1.0)[kind]
        upper[own] = (np.inf, 2.0, np.inf, np.inf, np.inf, -1.0)[kind]
        z0[own] = (0.0, 1e-312, 1.0, -5.0, 1e300, 1e9)[int(rng.integers(0, 6))]
    return LCP(M, q, lower=lower, upper=upper), cut, z0 if rng.random() < 0.5 else None


@claim
def parts_of_different_kinds_end_on_all_ranks() -> None:
    for seed in range(24):
        problem, cut, z0 = drawn(seed)
        own = [slice(0, cut), slice(cut, problem.n)][COMM.rank]
        own = own if COMM.size == 2 else slice(problem.n)
        q, lower, upper = problem.q[own], problem.lower[own], problem.upper[own]
        rows = LCP.from_rows(COMM, problem.csr[own], q, lower=lower, upper=upper)
        start = None if z0 is None or seed % 3 == COMM.rank else z0[own]  # of one rank, or of both
        name = ("auto", "npsor")[seed % 2]
        result = rows.solve(name, z0=start, max_iterations=100)
        assert len(set(COMM.allgather(str(result)))) == 1


@claim
def a_bound_that_is_not_0_on_one_rank_only_is_solved() -> None:
    M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20), format="csr")
    rows = distributed(LCP(M, np.full(20, 5.0), lower=np.repeat([1.0, 0.0], 10)))
    result = rows.solve()
    assert result.is_solved
    assert np.array_equal(result.z, rows.lower)


@claim
def a_start_of_one_rank_counts() -> None:
    rows = distributed(mixed())
    z = rows.solve().z
    assert rows.solve(z0=None if COMM.rank else z).is_solved
    refused(InvalidProblem, lambda: rows.slack(z[COMM.rank :]) if COMM.size > 1 else rows.slack([]))


def spread(problem: LCP, *vectors: Any) -> tuple[RowsOnRanks, list[Any]]:
    """Return a problem on the ranks, and the local parts of vectors."""
    own = slice(problem.n * COMM.rank // COMM.size, problem.n * (COMM.rank + 1) // COMM.size)
    return distributed(problem), [np.asarray(one)[own] for one in vectors]


@claim
def certify_measures_the_point_that_it_is_given() -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        n = int(rng.integers(2, 9))
        M, z = rng.integers(-2, 3, (n, n)) * 1.0, np.maximum(rng.integers(-3, 4, n), 0.0)
        q = rng.integers(0, 4, n) * (z == 0.0) - M @ z  # z is a solution
        problem, moved = LCP(sp.csr_array(M), q), z + rng.integers(-1, 2, n)
        rows, parts = spread(problem, z, moved)
        for x, part in zip((z, moved), parts, strict=True):
            found = certify(rows, part)
            assert found.verdict == certify(problem, x).verdict
            assert found.violation == certify(problem, x).violation
    rows, (outside, no_number) = spread(LCP(sp.csr_array(M), q), z - 5.0, z * np.nan)
    assert "is beyond its bound 0" in certify(rows, outside).reason
    refused(InvalidProblem, lambda: certify(rows, no_number))


@claim
def an_argument_of_one_rank_that_is_wrong_or_differs_is_refused_by_all() -> None:
    rows, (z,) = spread(mixed(), np.zeros(90))
    last = COMM.rank == COMM.size - 1
    refused(InvalidOption, lambda: certify(rows, z, tolerance=-1.0 if last else 1e-6))
    refused(InvalidOption, lambda: certify(rows, None if last else z))
    refused(InvalidOption, lambda: certify(rows, z, claim="infeasible" if last else None))
    refused(InvalidProblem, lambda: rows.solve(z0=z * np.nan if last else z))
    for wrong in (MPI.COMM_NULL, "all"):
        refused(InvalidProblem, lambda comm=wrong: LCP.from_rows(comm, rows.rows, rows.q))
    if COMM.size > 1:
        refused(InvalidOption, lambda: certify(rows, z, tolerance=1e-8 if last else 1e-3))


@claim
def an_exit_in_a_callback_of_one_rank_ends_all_ranks() -> None:
    rows, _ = spread(gallery.build("obstacle_2d", size=30).problem)
    last = COMM.rank == COMM.size - 1
    for kind in (SystemExit, KeyboardInterrupt):

        def leave(sample: Any, z: Any, kind: Any = kind) -> None:
            raise kind

        with pytest.raises(kind if last else LCPError, match="" if last else kind.__name__):
            rows.solve("npj", callback=leave if last else None)


@claim
def a_small_problem_that_multigrid_does_not_finish_is_solved_in_one_process() -> None:
    D = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(40, 40))
    beam = LCP((D @ D).tocsr(), np.where(np.arange(40) < 20, -1.0, 0.5))
    rows, _ = spread(beam)
    result = rows.solve()
    assert result.is_solved
    assert result.iterations < 100
    agrees(rows.gathered(result.z), solve(beam).z, 1e-6)
    never, _ = spread(LCP(-sp.eye_array(40, format="csr"), -np.ones(40)))
    result = never.solve()
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()


@claim
def limits_and_callbacks_end_all_ranks() -> None:
    rows = distributed(gallery.build("obstacle_2d", size=30).problem)
    assert rows.solve("npj", max_iterations=3).status is Status.MAX_ITERATIONS
    assert rows.solve("npj", max_seconds=0.0).status is Status.MAX_SECONDS
    stops = None if COMM.rank else lambda sample, z: sample.iteration >= 2
    assert rows.solve("npj", callback=stops).status is Status.INTERRUPTED


@claim
def a_callback_ends_the_run_at_a_step_that_ends_its_method() -> None:
    D = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(40, 40))
    rows = distributed(LCP((D @ D).tocsr(), np.where(np.arange(40) < 20, -1.0, 0.5)))
    first = rows.solve()  # multigrid has no coarse grid, and ends at once
    stopped = rows.solve(callback=lambda sample, z: True)
    assert "→" in first.algorithm
    assert "→" not in stopped.algorithm


@claim
def steps_of_conjugate_gradients_need_no_further_memory() -> None:
    problem = distributed(gallery.build("obstacle_2d", size=80).problem)
    with np.errstate(all="ignore"):
        hierarchy = hierarchy_on_ranks(problem.rows, problem.halo, scales_rows=False)
    correction = KrylovCorrection(Truncation(hierarchy), problem.q.copy(), True)
    tracemalloc.start()
    sizes = []
    for _ in range(2):
        assert all(correction.step() for _ in range(5))
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert sizes[1] - sizes[0] < problem.q.nbytes, sizes


@claim
def a_result_has_what_every_result_promises() -> None:
    problem = mixed()
    rows = distributed(problem)
    result = rows.solve(tolerance=1e-9, absolute_tolerance=1e-12)
    assert result.x is result.z
    assert (result.tolerance, result.absolute_tolerance) == (1e-9, 1e-12)
    assert result.residual == result.certificate.relative_residual <= 1e-9
    assert result.n == problem.n
    assert (result.history, result.begun, result.objective, result.proof) == ((), "", None, None)
    assert f"SOLVED, n={problem.n}, " in repr(result)
    assert "tolerance 1e-09" in result.explain()
    for text in (repr(result), str(result), result.explain()):
        assert len(set(COMM.allgather(text))) == 1
    assert "on ranks is local" in refused(UnsuitableProblem, result.plot)
    limited = rows.solve("npj", max_iterations=1)
    assert "relative residual" in refused(NotConverged, limited.require_solved)


@claim
def the_same_call_gives_the_same_bits() -> None:
    rows = distributed(gallery.build("obstacle_2d", size=20).problem)
    first, second = (rows.solve() for _ in range(2))
    watched = rows.solve(callback=lambda sample, z: None)
    assert first.z.tobytes() == second.z.tobytes() == watched.z.tobytes()


for name in sys.argv[1:] or CLAIMS:
    try:
        CLAIMS[name]()
        story = ""
    except Exception:
        story = traceback.format_exc()
    stories = COMM.gather(story, root=0)
    if COMM.rank == 0:
        print(json.dumps([name, next(filter(None, stories), "")]), flush=True)
