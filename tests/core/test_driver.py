"""The one loop: statuses, limits, clock, record, callback, warm start, automatic choice."""

from __future__ import annotations

import copy
import pickle
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes
from inputs.families import BOUNDED, DIRECT
from inputs.scripted import TWO, Scripted

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    InvalidOption,
    NonlinearProblem,
    NotConverged,
    QuadraticProgram,
    Status,
    convergence_guarantee,
    gallery,
    solve,
)
from lcp_plugin.algorithms import REGISTRY, Algorithm, Step, create

EXAMPLE = gallery.build("paper_example_1", n=400)
OBSTACLE = gallery.build("obstacle_2d", size=20)


def test_an_honest_iterate_is_solved_whatever_ends_the_run():
    """A best iterate that passes is SOLVED even if a limit ended the run at this step."""
    result = solve(TWO, Scripted(points=((0.0, 0.0), (2.5, 0.0))), max_iterations=1)
    assert result.status is Status.SOLVED
    assert result.iterations == 1


@pytest.mark.parametrize("name", REGISTRY)
@pytest.mark.parametrize("limit", [0, 1, 7])
def test_iteration_limit_is_exact(name, limit):
    """max_iterations=k returns after exactly k iterations, 0 included; direct methods may be done before."""
    result = solve(
        OBSTACLE.problem if name in BOUNDED else EXAMPLE.problem, name, max_iterations=limit
    )
    if name in DIRECT and result.is_solved:
        assert 0 < result.iterations <= limit
    else:
        assert (result.status, result.iterations) == (Status.MAX_ITERATIONS, limit)


def test_best_iterate_is_returned():
    """If the iteration gets worse again, the best point is returned, not the last one."""
    points = ((0.0, 0.0), (2.4, 0.0), (2.0, 3.0))
    result = solve(TWO, Scripted(points=points), max_iterations=5)
    np.testing.assert_array_equal(result.z, (2.4, 0.0))


def test_nan_in_the_middle_is_diverged_with_the_best_so_far():
    """A NaN ends the run as DIVERGED; the best finite iterate is kept."""
    result = solve(TWO, Scripted(points=((0.0, 0.0), (2.0, 0.0), (np.nan, 0.0))))
    assert result.status is Status.DIVERGED
    np.testing.assert_array_equal(result.z, (2.0, 0.0))


def test_explosion_is_diverged():
    """A residual that rises ten times in a row, to 1e8 times its start, ends the run."""
    growing = tuple((10.0**k, 10.0**k) for k in range(1, 30))
    result = solve(TWO, Scripted(points=((0.0, 0.0), *growing)))
    assert (result.status, result.iterations) == (Status.DIVERGED, 10)


@pytest.mark.parametrize("name", ["npsor", "npgs"])
def test_a_guaranteed_run_over_a_mountain_arrives(name):
    """A residual that rises by ten decades and falls again does not count as divergence."""
    problem = LCP([[1.0, -1e10], [0.0, 1.0]], [0.0, -1.0])
    assert convergence_guarantee(problem, name).is_guaranteed
    result = solve(problem, name)
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(result.z, [1e10, 1.0], rtol=1e-7)


def test_standstill_is_stalled_after_two_hundred_steps():
    """A residual that does not fall ends the run as STALLED after 200 steps, not after max_iterations."""
    result = solve(TWO, Scripted(points=((2.0, 0.5),)))
    assert result.status is Status.STALLED
    assert result.iterations == 200


def test_a_start_outside_the_bounds_is_projected():
    """A start below the lower bounds begins at them, and is not modified."""
    start, seen = np.full(EXAMPLE.n, -5.0), []
    solve(EXAMPLE.problem, "pgs", z0=start, callback=lambda sample, z: seen.append(z.copy()))
    assert (seen[0] == 0.0).all()
    assert (start == -5.0).all()


@dataclass(frozen=True, kw_only=True)
class OwnJacobi(Algorithm):
    """Method of a user, with a last step if one is stated, and points of another length if it is."""

    name: ClassVar[str] = "own_jacobi"
    steps: int = 10**6
    length: int | None = None

    def iterates(self, problem: LCP, z0: np.ndarray) -> Iterator[Step]:
        z = z0.copy()
        for _ in range(self.steps + 1):
            yield Step(z if self.length is None else np.zeros(self.length))
            z = np.clip(z - problem.slack(z) / problem.diagonal, problem.lower, problem.upper)


def test_iterates_that_end_and_points_of_a_wrong_length_are_named():
    """The message has the number of steps, or the shapes."""
    for steps, words in ((0, "0 steps"), (1, "1 step"), (2, "2 steps")):
        result = solve(OBSTACLE.problem, OwnJacobi(steps=steps))
        assert result.status is Status.STALLED
        assert result.advice.startswith(f'iterates ended after {words}; next: try algorithm="auto"')
    for length in (0, 3, 1):
        with pytest.raises(InvalidOption, match=rf"own_jacobi.*z of shape \(2,\).*\({length},\)"):
            solve(TWO, OwnJacobi(length=length))


class FakeClock:
    """A clock that advances only on request."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr("lcp_plugin.core.deadline.time.perf_counter", lambda: self.now)


@dataclass(frozen=True, kw_only=True)
class Ticking(Algorithm):
    """Halves the distance to (2.5, 0); the set-up takes 3 s and a step 1 s of a fake clock."""

    name: ClassVar[str] = "ticking"
    clock: FakeClock

    def iterates(self, problem: LCP, z0: np.ndarray) -> Iterator[Step]:
        self.clock.now += 3.0
        z = z0
        while True:
            yield Step(z)
            self.clock.now += 1.0
            z = 0.5 * (z + np.array([2.5, 0.0]))


def test_time_limit_ends_with_the_iteration_under_way(monkeypatch):
    """max_seconds covers set-up and steps and ends with the step in which it passes."""
    clock = FakeClock(monkeypatch)
    result = solve(TWO, Ticking(clock=clock), max_seconds=7.5)
    assert (result.status, result.iterations) == (Status.MAX_SECONDS, 5)
    assert (result.setup_seconds, result.seconds) == (3.0, 8.0)


@dataclass(frozen=True, kw_only=True)
class GivingUp(Ticking):
    """Ends by itself after a set-up of 3 s, like a method that notices the time limit in a step."""

    def iterates(self, problem: LCP, z0: np.ndarray) -> Iterator[Step]:
        yield Step(z0)
        self.clock.now += 3.0


def test_what_ends_after_the_limit_ended_by_the_limit(monkeypatch):
    """An iterator that ends by itself is STALLED before the time limit, and MAX_SECONDS after it."""
    clock = FakeClock(monkeypatch)
    for limit, status in ((5.0, Status.STALLED), (2.0, Status.MAX_SECONDS)):
        assert solve(TWO, GivingUp(clock=clock), max_seconds=limit).status is status


def test_clock_stops_while_somebody_looks(monkeypatch):
    """Time in a callback is not the algorithm's time, but counts against max_seconds."""
    clock = FakeClock(monkeypatch)
    samples = []

    def slow_callback(sample, z):
        samples.append(sample)
        clock.now += 50.0

    result = solve(TWO, Ticking(clock=clock), callback=slow_callback, max_iterations=4)
    assert [sample.seconds for sample in samples] == [3.0, 4.0, 5.0, 6.0, 7.0]
    assert result.seconds == 7.0
    assert (
        solve(TWO, Ticking(clock=clock), callback=slow_callback, max_seconds=60.0).iterations == 2
    )


@pytest.mark.parametrize("name", ["npsor", "psor", "auto"])
def test_history_is_geometric_and_complete(name):
    """History begins at sample 0, ends with the last iterate, has a residual everywhere, and grows like a logarithm."""
    result = solve(OBSTACLE.problem, name, record=True, tolerance=1e-10)
    samples = result.history
    assert [samples[0].iteration, samples[-1].iteration] == [0, result.iterations]
    iterations = [sample.iteration for sample in samples]
    assert iterations == sorted(set(iterations))
    assert all(
        later <= max(earlier + 1, 1.05 * earlier + 1) for earlier, later in pairwise(iterations)
    )
    assert len(samples) < result.iterations or result.iterations <= 1 / 0.05
    assert all(sample.residual is not None and sample.residual >= 0.0 for sample in samples)
    assert samples[0].seconds == result.setup_seconds
    assert all(a.seconds <= b.seconds and a.work <= b.work for a, b in pairwise(samples))


SMALL = {
    "LCP": LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]),
    "program": QuadraticProgram(np.eye(2), [-1.0, -3.0], G=[[1.0, 1.0]], h=[2.0]),
    "fit": BoundedLeastSquares([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [2.0, 1.0, -1.0]),
    "contact": FrictionalContact(np.eye(3), [-1.0, 0.3, 0.1], 0.5, dimension=3),
}


@pytest.mark.parametrize("name", SMALL)
def test_a_watched_small_problem_needs_no_run(monkeypatch, name):
    """It has the bits of the plain call, a first and a last sample, and the callback sees start and solution."""
    problem, seen = SMALL[name], []
    plain = solve(problem)
    with monkeypatch.context() as patch:
        patch.setattr("lcp_plugin.solving.run.Run.follow_all", None)
        watched = solve(problem, record=True, callback=lambda *at: seen.append(at))
    assert watched.is_solved
    assert watched.x.tobytes() == plain.x.tobytes() == seen[-1][1].tobytes()
    assert watched.history == tuple(sample for sample, _ in seen)
    assert [sample.iteration for sample in watched.history] == [0, plain.iterations]
    assert watched.history[-1].residual <= watched.tolerance
    assert not plain.history


def test_callback_stops_the_run_and_cannot_write():
    """A true return value ends with INTERRUPTED at this iterate, and exceptions propagate."""
    result = solve(OBSTACLE.problem, "npgs", callback=lambda sample, z: sample.iteration == 5)
    assert (result.status, result.iterations) == (Status.INTERRUPTED, 5)

    def writes(sample, z):
        z[0] = 1.0

    with pytest.raises(ValueError, match="read-only"):
        solve(OBSTACLE.problem, "npgs", callback=writes)


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", DIRECT)
def test_iterates_of_direct_methods_are_within_the_bounds(name):
    """Every step, also on the way, is a point of the box, although Newton and interior point methods leave it."""
    problem = membranes.build("random_h_plus", n=40).problem
    boxed = problem.with_q(problem.q, lower=-0.01, upper=0.01)
    for each in (problem, boxed, LCP([[1.0, -9.0], [-9.0, 1.0]], [-1.0, -1.0])):
        for step in create(name, {}).iterates(each, each.nearest_to_zero.copy()):
            assert np.array_equal(np.clip(step.z, each.lower, each.upper), step.z)


@dataclass(frozen=True, kw_only=True)
class InterruptedFinish(Scripted):
    """Is interrupted in its clean-up."""

    def finish(self, problem: LCP, z: np.ndarray) -> np.ndarray:
        signal.raise_signal(signal.SIGINT)
        return z


def test_ctrl_c_in_the_last_moment_loses_nothing():
    """SIGINT during the final test still returns the result."""
    result = solve(TWO, InterruptedFinish(points=((0.0, 0.0), (2.4, 0.0))), max_iterations=3)
    assert result.status is Status.INTERRUPTED
    np.testing.assert_array_equal(result.z, (2.4, 0.0))
    assert solve(TWO, InterruptedFinish(points=((2.5, 0.0),))).status is Status.SOLVED


def test_require_solved_raises_with_the_advice():
    """require_solved returns the result itself, or raises NotConverged with status, residual and advice."""
    good = solve(TWO, "pgs")
    assert good.require_solved() is good
    with pytest.raises(
        NotConverged, match=r"MAX_ITERATIONS after 2 iterations of npsor: .* raise max_iterations"
    ):
        solve(OBSTACLE.problem, "npsor", max_iterations=2).require_solved()


# --- Error bounds and guarantees -----------------------------------------------------------------------------


def stiff_m_matrix(n: int = 60, contrast: float = 1e10) -> tuple[LCP, np.ndarray]:
    """A chain with an inclusion of large coefficient that only weak links tie to the rest, and its solution."""
    conductance = np.ones(n + 1)
    conductance[n // 3 + 1 : 2 * n // 3] = contrast
    M = (
        np.diag(conductance[:-1] + conductance[1:])
        - np.diag(conductance[1:-1], 1)
        - np.diag(conductance[1:-1], -1)
    )
    exact = np.interp(np.arange(n), [0, n // 3, 2 * n // 3 - 1, n - 1], [0.5, 3.0, 3.0, 1.0])
    return LCP(M, -M @ exact), exact


def test_error_bound_goes_into_the_result():
    """The result has a bound, and explain() is the same before and after it was read."""
    result = solve(EXAMPLE.problem)
    told = result.explain()
    assert result.error_bound is not None
    assert result.explain() == told


@pytest.mark.parametrize(
    "duplicate", [copy.copy, copy.deepcopy, lambda result: pickle.loads(pickle.dumps(result))]
)
def test_copies_of_a_result_are_read_only(duplicate):
    """Z and w of a copied or unpickled result cannot be written to, its certificate's neither."""
    result = duplicate(solve(EXAMPLE.problem))
    for array in (result.z, result.w, result.certificate.z, result.certificate.w):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_where_no_bound_exists_the_result_has_none():
    """If a matrix allows no bound, and for contacts and nonlinear problems, error_bound is None."""
    game = LCP([[0.0, 1.0], [1.0, 0.0]], [-1.0, -1.0])
    contact = FrictionalContact(np.eye(2), [-1.0, 0.5], 0.5)
    for problem, start in ((game, None), (contact, None), (NonlinearProblem(np.expm1), 0.5)):
        assert solve(problem, **({} if start is None else {"x0": start})).error_bound is None


@pytest.mark.parametrize("form", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_a_nearly_singular_matrix_is_named(form):
    """SOLVED by a z of length 1 where the solution has 256, though the diagonal is even: `explain()` warns."""
    matrix = np.array([[5.0, -5.0 + 2.0**-36], [-5.0 + 2.0**-36, 5.0]])
    q = np.array([-3.0, 3.0 - 2.0**-27])
    assert (np.linalg.solve(matrix, -q) > 255.0).all()
    far = solve(LCP(form(matrix), q), "psor")
    assert (far.status, float(far.z.max()) < 1.0) == (Status.SOLVED, True)
    assert (
        "near-singular: the system of the 2 unknowns between their bounds magnifies errors"
        in far.explain()
    )
    assert (
        "near-singular"
        not in solve(LCP(form([[5.0, -4.0], [-4.0, 5.0]]), [-3.0, 2.0]), "psor").explain()
    )


def test_stiff_data_tell_the_truth():
    """A z wrong by half has a small residual on stiff data, but its rows are wrong; the bound shows by how much."""
    problem, exact = stiff_m_matrix(contrast=1e6)
    fooled = solve(problem, "pgs", tolerance=1e-7)
    assert (fooled.status, fooled.residual <= 1e-7) == (Status.MAX_ITERATIONS, True)
    assert "a theorem proves convergence" in fooled.advice
    assert fooled.error_bound is not None
    error = np.max(np.abs(fooled.z - exact))
    assert error > 0.3 * exact.max()
    assert error <= fooled.error_bound.infinity <= 10.0 * error


def test_stiffer_data_are_named():
    """Sweeps leave an inclusion at 0 instead of 3, which no residual shows: that is not SOLVED, and auto is right."""
    problem, exact = stiff_m_matrix(contrast=1e10)
    far = solve(problem, "pgs")
    assert (far.status, far.residual <= 1e-8) == (Status.MAX_ITERATIONS, True)
    for algorithm in ("auto", "newton", "multigrid"):
        result = solve(problem, algorithm)
        assert result.is_solved
        assert result.z == pytest.approx(exact, abs=1e-4)


def test_a_program_prints_the_tolerance_of_its_residuals():
    """Rows are tested to 10⁻⁹, the duality gap to the tolerance, and the explanation shows both."""
    program = QuadraticProgram(np.eye(2), [-1.0, -2.0], G=[[1.0, 1.0]], h=[1.0])
    for tolerance, options in ((1e-6, {}), (1e-12, {"tolerance": 1e-12})):
        told = solve(program, **options).explain()
        assert "(tolerance 1e-09), the duality gap" in told
        assert f"(tolerance {tolerance:.0e}), each relative to its terms" in told


def test_a_slow_run_that_its_limit_allows_is_not_ended():
    """The residual falls by less than 1 % in 400 iterations, and the rest of the limit suffices: no end there."""
    rho = 1.0 - 2.2e-5
    problem = LCP(np.array([[1.0, -rho], [-rho, 1.0]]), [-1.0, -0.5])
    run = solve(
        problem, "gfp", max_iterations=10**7, tolerance=1e-2, polish=False,
        callback=lambda sample, z: sample.iteration >= 2000,
    )  # fmt: skip
    assert run.iterations >= 2000
