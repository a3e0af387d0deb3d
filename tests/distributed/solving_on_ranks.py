"""Checks that test_solving.py runs under MPI."""

from __future__ import annotations

import os
import signal
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from checks import check, run_checks
from mpi4py import MPI

from lcp_plugin import (
    LCP,
    Certificate,
    Status,
    all_solutions,
    analyze,
    derivative,
    error_bound,
    gallery,
    prepare,
    solve,
)
from lcp_plugin.algorithms import create
from lcp_plugin.core.errors import (
    InvalidOption,
    LCPError,
    NotConverged,
    UnknownAlgorithm,
    UnsuitableMatrix,
    UnsuitableProblem,
)
from lcp_plugin.proofs.guarantees import convergence_guarantee

ALGORITHMS = ("auto", "multigrid", "npsor", "npaor", "npgs", "npj", "pgs", "psor")
SIZES = {
    "obstacle_2d": 12,
    "obstacle_3d": 5,
    "convection_diffusion": 12,
    "elastic_plastic_torsion": 12,
}


def mixed(n: int = 90) -> LCP:
    """Free rows, one-sided ones and boxes; M nonsymmetric and dominant, coupled over all ranks."""
    rng = np.random.default_rng(n)
    M = sp.random_array((n, n), density=6.0 / n, rng=rng, format="csr", data_sampler=rng.normal)
    M = sp.csr_array(M + sp.diags_array(1.0 + np.asarray(abs(M).sum(axis=1))))
    kind = rng.integers(0, 4, n)
    lower = np.where(kind % 2 == 0, -np.inf, rng.normal(size=n))
    upper = np.where(kind < 2, np.inf, np.where(kind == 3, lower + 0.3, 0.5))
    return LCP(M, 3.0 * rng.normal(size=n), lower=lower, upper=upper)


@cache
def scene(name: str) -> tuple[LCP, Any]:
    """A problem and what one process answers."""
    problem = mixed() if name == "mixed" else gallery.build(name, size=SIZES[name]).problem
    return problem, solve(problem, tolerance=1e-12).z


def require_same_on_all(comm: Any, result: Any) -> None:
    """Everything but the own parts is the same on every rank."""
    told = (
        result.status,
        result.algorithm,
        result.iterations,
        result.work,
        repr(result.residual),
        result.seconds,
    )
    told = (
        *told,
        result.stages,
        result.history,
        result.no_error_bound,
        result.explain(),
        result.to_json(),
    )
    assert len(set(comm.allgather(repr(told)))) == 1


def compare(comm: Any, name: str) -> None:
    """All algorithms on one problem answer as one process does, twice with the same bits."""
    whole, truth = scene(name)
    problem = LCP.from_problem(whole, comm)
    for algorithm in ALGORITHMS:
        marks = []
        for _ in range(2):
            result = solve(problem, algorithm, tolerance=1e-12)
            require_same_on_all(comm, result)
            marks.append(
                (sha256(result.z.tobytes()).hexdigest(), result.iterations, repr(result.residual))
            )
        assert marks[0] == marks[1], algorithm
        assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), (algorithm, str(result))
        own = truth[problem.own_rows]
        assert np.abs(result.z - own).max(initial=0.0) <= 1e-9 * np.abs(truth).max(), algorithm
        assert np.allclose(result.w, problem.slack(result.z))
        assert result.residual == Certificate.of(problem, result.z).relative_residual
        assert (result.algorithm.split(":")[0], result.iterations > 0) == (algorithm, True)


@check(1, 2, 3, 4)
def obstacle_2d_is_solved_as_by_one_process(comm: Any) -> None:
    """The membrane over an obstacle, with every algorithm."""
    compare(comm, "obstacle_2d")


@check(2, 4)
def obstacle_3d_is_solved_as_by_one_process(comm: Any) -> None:
    """The same in space."""
    compare(comm, "obstacle_3d")


@check(2, 3)
def convection_is_solved_as_by_one_process(comm: Any) -> None:
    """A matrix that is not symmetric."""
    compare(comm, "convection_diffusion")


@check(2, 3)
def boxes_are_solved_as_by_one_process(comm: Any) -> None:
    """Two bounds on every row."""
    compare(comm, "elastic_plastic_torsion")


@check(1, 2, 3, 4)
def mixed_rows_are_solved_as_by_one_process(comm: Any) -> None:
    """Free rows, bounds and boxes in one problem that is not symmetric."""
    compare(comm, "mixed")


@check(2, 3)
def limits_and_starts_are_those_of_one_process(comm: Any) -> None:
    """The options z0, max_iterations, max_seconds, record and measure do what they do there."""
    whole, truth = scene("obstacle_2d")
    problem = LCP.from_problem(whole, comm)
    own = truth[problem.own_rows]
    assert solve(problem, "npsor", z0=own).iterations == 0
    far = solve(problem, "pgs", z0=own - 100.0, max_iterations=0)
    assert far.status is Status.MAX_ITERATIONS
    assert np.array_equal(far.z, np.maximum(own - 100.0, problem.lower))
    for algorithm in ("npsor", "pgs", "multigrid"):
        result = solve(problem, algorithm, max_iterations=3, tolerance=1e-12, record=True)
        require_same_on_all(comm, result)
        assert (result.status, result.iterations) == (Status.MAX_ITERATIONS, 3)
        assert [sample.iteration for sample in result.history] == [0, 1, 2, 3]
        assert result.history[-1].label == algorithm
        assert all(sample.residual is not None for sample in result.history)
        assert result.residual <= min(sample.residual for sample in result.history) * (1.0 + 1e-12)
        with pytest.raises(NotConverged, match="MAX_ITERATIONS"):
            result.require_solved()
    late = solve(problem, "npsor", max_seconds=0.0, tolerance=0.0)
    assert (late.status, late.iterations) == (Status.MAX_SECONDS, 0)
    exact = solve(problem, "pgs", tolerance=0.0)
    assert exact.status is Status.PRECISION_LIMIT
    assert solve(problem, create("npsor", {"relaxation": 0.9})).is_solved


@check(1, 2, 3)
def an_error_can_be_asked_for(comm: Any) -> None:
    """With tolerance_on="error" SOLVED means a proof; where M allows none, UnsuitableMatrix on all ranks."""
    for name in ("obstacle_2d", "mixed"):
        whole, truth = scene(name)
        problem = LCP.from_problem(whole, comm)
        own = truth[problem.own_rows]
        for algorithm in ("auto", "pgs", "npsor"):
            result = solve(problem, algorithm, tolerance=1e-5, tolerance_on="error", record=True)
            require_same_on_all(comm, result)
            assert result.is_solved
            assert result.error_bound.relative <= 1e-5
            assert (np.abs(result.z - own) <= result.error_bound.componentwise + 1e-10).all()
            sampled = result.history[-1].error_bound
            assert (
                sampled <= 1e-5 * comm.allreduce(np.abs(result.z).max(initial=0.0), MPI.MAX) * 1.01
            )
            assert (
                sampled == result.error_bound.infinity or algorithm == "npsor"
            )  # which cleans up behind its last z
    bounded = solve(problem, error_bound=True)
    assert bounded.error_bound.infinity > 0.0
    M = sp.csr_array(np.ones((5, 5)) + np.eye(5))
    strong = LCP.from_problem(LCP(M, -np.ones(5)), comm)
    with pytest.raises(UnsuitableMatrix, match='tolerance_on="error"'):
        solve(strong, tolerance_on="error")
    unbounded = solve(strong, "pgs", error_bound=True)
    assert unbounded.is_solved
    assert unbounded.error_bound is None
    assert "H₊" in unbounded.no_error_bound


@check(2, 3)
def one_rank_can_end_the_run(comm: Any) -> None:
    """A true answer of one rank's callback, or Ctrl-C there, ends all ranks with INTERRUPTED and the best z so far."""
    problem = LCP.from_problem(scene("obstacle_2d")[0], comm)
    is_last = comm.rank == comm.size - 1
    for algorithm in ("npsor", "psor", "multigrid"):
        seen: list[int] = []

        def stop(sample: Any, z: Any, seen: list[int] = seen) -> bool:
            assert not z.flags.writeable
            assert z.size == problem.q.size
            seen.append(sample.iteration)
            return is_last and sample.iteration == 3

        result = solve(problem, algorithm, callback=stop, tolerance=1e-13)
        require_same_on_all(comm, result)
        assert (result.status, seen) == (Status.INTERRUPTED, [0, 1, 2, 3])
        alone = solve(problem, algorithm, callback=stop if is_last else None, tolerance=1e-13)
        assert (alone.status, alone.iterations) == (Status.INTERRUPTED, 3)

    def ask(sample: Any, z: Any) -> None:
        if is_last and sample.iteration == 2:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    result = solve(problem, "npsor", callback=ask, tolerance=1e-13)
    require_same_on_all(comm, result)
    assert (result.status, result.iterations) == (Status.INTERRUPTED, 3)
    assert signal.getsignal(signal.SIGINT) is before


@check(2, 3)
def what_a_callback_raises_is_passed_on(comm: Any) -> None:
    """It comes out of solve where it was raised; the other ranks raise an LCPError that names it. Nobody waits."""
    problem = LCP.from_problem(scene("obstacle_2d")[0], comm)

    def fail(sample: Any, z: Any) -> None:
        if comm.rank == 1 and sample.iteration == 2:
            raise ZeroDivisionError("mine")

    with pytest.raises((ZeroDivisionError, LCPError)) as caught:
        solve(problem, "npsor", callback=fail)
    expected = (
        "ZeroDivisionError('mine')"
        if comm.rank == 1
        else "LCPError('rank 1: ZeroDivisionError: mine')"
    )
    assert repr(caught.value) == expected
    assert solve(problem).is_solved


@check(1, 2, 3)
def wrong_options_are_refused_on_all_ranks(comm: Any) -> None:
    """Also where one rank alone gives them; and all ranks must ask for the same."""
    problem = LCP.from_problem(mixed(), comm)
    for algorithm, options, kind, words in (
        ("lemke", {}, UnknownAlgorithm, "'lemke' does not run on several ranks"),
        ("mgs", {}, UnknownAlgorithm, "'mgs' does not run on several ranks"),
        ("npsr", {}, UnknownAlgorithm, "did you mean 'npsor'"),
        (7, {}, UnknownAlgorithm, "7"),
        ("psor", {"relaxation": "fast"}, InvalidOption, r"number in \(0, 2\)"),
        ("psor", {"relaxation": 2.5}, InvalidOption, "relaxation"),
        ("psor", {"sweep": "sideways"}, InvalidOption, "sweep"),
        ("auto", {"relaxation": 1.0}, InvalidOption, "has no options"),
        ("npsor", {"relaxed": 1.0}, InvalidOption, "relaxed"),
        ("npsor", {"tolerance": -1.0}, InvalidOption, "tolerance"),
        ("npsor", {"tolerance_on": "largest"}, InvalidOption, "tolerance_on"),
        ("npsor", {"max_iterations": 1.5}, InvalidOption, "max_iterations"),
        ("npsor", {"callback": 3}, InvalidOption, "callback"),
        ("npsor", {"z0": np.zeros(3)}, InvalidOption, "z0"),
    ):
        with pytest.raises(kind, match=words) as everywhere:
            solve(problem, algorithm, **options)
        assert len(set(comm.allgather(str(everywhere.value)))) == 1
        if comm.size > 1:
            is_here = comm.rank == 1
            with pytest.raises(kind, match=words) as caught:
                solve(problem, algorithm if is_here else "npsor", **(options if is_here else {}))
            assert str(caught.value).startswith("rank 1: ")
    for differing in (
        {"tolerance": 1e-3},
        {"max_iterations": 5},
        {"record": True},
        {"relaxation": 0.9},
    ):
        if comm.size > 1:
            with pytest.raises(InvalidOption, match="asked of solve differs"):
                solve(problem, "npsor", **(differing if comm.rank == 1 else {}))


@check(1, 2, 3, 4)
def problems_that_need_no_iteration_are_solved(comm: Any) -> None:
    """Where z° solves (the reference is 0) any start is forgotten; no row at all, and fewer rows than ranks."""
    M = scene("obstacle_2d")[0].csr
    problem = LCP.from_problem(LCP(M, np.ones(M.shape[0])), comm)
    empty = LCP.from_problem(LCP(sp.csr_array((0, 0)), []), comm)
    for algorithm in ALGORITHMS:
        result = solve(problem, algorithm, z0=np.ones(problem.q.size))
        assert (result.status, result.iterations, result.residual) == (Status.SOLVED, 0, 0.0), (
            algorithm
        )
        assert not result.z.any()
        require_same_on_all(comm, result)
        assert solve(empty, algorithm).is_solved
        for n in (1, 2):
            few = LCP.from_problem(LCP(sp.csr_array(2.0 * np.eye(n) - 0.5), -np.ones(n)), comm)
            own = np.linalg.solve(2.0 * np.eye(n) - 0.5, np.ones(n))[few.first : few.last]
            assert np.allclose(solve(few, algorithm, error_bound=True).z, own)


@check(2, 3)
def a_diagonal_entry_that_is_not_positive_is_refused(comm: Any) -> None:
    """One on one rank: UnsuitableMatrix on all, before the first iteration; np* take it, as on one process."""
    diagonal, q = np.ones(6), -np.ones(6)
    diagonal[5], q[5] = 0.0, 1.0
    problem = LCP.from_problem(LCP(sp.csr_array(np.diag(diagonal)), q), comm)
    for algorithm in ("auto", "multigrid", "pgs", "psor"):
        with pytest.raises(UnsuitableMatrix, match=r"positive diagonal, but M\[5, 5\] = 0"):
            solve(problem, algorithm)
    for algorithm in ("npsor", "npaor", "npgs", "npj"):
        assert solve(problem, algorithm).is_solved
        assert solve(problem, algorithm, scaling=None, sweep="symmetric").is_solved


@check(2, 3)
def any_order_and_an_automatic_relaxation_work(comm: Any) -> None:
    """Backward and symmetric sweeps, row scalings and psor's own relaxation answer as on one process."""
    for name in ("obstacle_2d", "mixed"):
        whole, truth = scene(name)
        problem = LCP.from_problem(whole, comm)
        own = truth[problem.own_rows]
        for algorithm, options in (
            ("psor", {"sweep": "backward"}),
            ("psor", {"sweep": "symmetric", "relaxation": 1.0}),
            ("psor", {}),
            ("npsor", {"sweep": "backward"}),
            ("npgs", {"sweep": "symmetric"}),
            ("npsor", {"scaling": "diagonal", "scaling_factor": 0.5}),
        ):
            result = solve(problem, algorithm, tolerance=1e-12, **options)
            require_same_on_all(comm, result)
            assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), (
                algorithm,
                options,
                str(result),
            )
            assert np.abs(result.z - own).max(initial=0.0) <= 1e-9 * np.abs(truth).max(), (
                algorithm,
                options,
            )


@check(1, 2)
def what_needs_all_rows_says_so(comm: Any) -> None:
    """Analyses and conversions refuse a problem whose rows lie on ranks, in words, instead of judging a part."""
    problem = LCP.from_problem(mixed(12), comm)
    for call in (
        analyze,
        all_solutions,
        convergence_guarantee,
        lambda p: p.to_qp(),
        lambda p: p.M,
        lambda p: p.csr,
        lambda p: LCP.from_problem(p, comm),
    ):
        with pytest.raises(UnsuitableProblem, match="spread over") as caught:
            call(problem)
        assert len(set(comm.allgather(str(caught.value).removeprefix("rank 0: ")))) == 1
    assert solve(prepare(problem)).is_solved


@check(3)
def in_place_sweeps_converge_on_every_h_plus_matrix(comm: Any) -> None:
    """On random ones, hardly H₊, with scaled columns, entries of both signs, not symmetric."""
    for seed in range(25):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(3, 20))
        M = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5)
        np.fill_diagonal(M, 0.0)
        np.fill_diagonal(M, 1.05 * np.abs(M).sum(axis=1) + 0.01)
        problem = LCP(sp.csr_array(M * 2.0 ** rng.uniform(-1, 1, n)), rng.normal(size=n))
        result = solve(LCP.from_problem(problem, comm), "pgs")
        assert result.is_solved, (seed, str(result))


@check(3)
def in_place_sweeps_converge_on_positive_definite_matrices_that_are_not_h(comm: Any) -> None:
    """Strong couplings between the ranks, where sweeps with the diagonal alone would run away."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(6, 16))
        factor = rng.normal(size=(n, n))
        M = np.ones((n, n)) + 0.1 * np.eye(n) if seed == 0 else factor @ factor.T + 0.3 * np.eye(n)
        lower = np.where(rng.random(n) < 0.3, -np.inf, -1.0)
        problem = LCP(
            sp.csr_array(M),
            3.0 * rng.normal(size=n),
            lower=lower,
            upper=np.where(rng.random(n) < 0.5, 2, 9),
        )
        for algorithm, options in (("pgs", {}), ("psor", {"relaxation": 1.6})):
            result = solve(LCP.from_problem(problem, comm), algorithm, **options)
            assert result.is_solved, (seed, algorithm, str(result))


@check(2, 3, 4)
def ranks_that_meet_nobody_join_the_multigrid(comm: Any) -> None:
    """A rank without rows, and one whose rows meet only its own, do not end a run of multigrid on the others."""
    n = 300
    chain = sp.diags_array(
        [-np.ones(n - 1), np.full(n, 2.0), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    apart = sp.block_diag([chain[: n // 2, : n // 2], chain[n // 2 :, n // 2 :]], format="csr")
    halves = np.array([0, n // 2, n])
    for M, ends in (
        (chain, [0, *[n] * comm.size]),
        (apart, np.interp(np.arange(comm.size + 1), [0, 1, 2], halves)),
    ):
        first, last = (int(end) for end in ends[comm.rank : comm.rank + 2])
        problem = LCP.from_rows(comm, sp.csr_array(M[first:last]), np.full(last - first, -1.0))
        assert solve(problem, "multigrid", coarsest=8).is_solved


@check(2, 3)
def the_unit_of_a_row_changes_nothing(comm: Any) -> None:
    """Rows of M and q times 10^±4 leave z and, within a few, the number of cycles."""
    whole = gallery.build("obstacle_2d", size=30).problem
    factors = 10.0 ** np.random.default_rng(0).uniform(-4.0, 4.0, whole.n)
    scaled = LCP(
        sp.csr_array(sp.diags_array(factors) @ whole.csr), factors * whole.q, lower=whole.lower
    )
    one, other = (
        solve(LCP.from_problem(p, comm), "multigrid", tolerance=1e-12) for p in (whole, scaled)
    )
    assert one.is_solved
    assert other.is_solved
    assert other.iterations <= one.iterations + 5
    np.testing.assert_allclose(other.z, one.z, rtol=1e-9, atol=1e-12)


@check(1, 2, 3)
def derivatives_are_those_of_one_process(comm: Any) -> None:
    """Own parts in and out: jvp by q and the bounds, dw and vjp of a membrane; its gradient by M on the own rows."""
    whole = gallery.build("obstacle_2d", size=40).problem
    one, n = derivative(solve(whole, tolerance=1e-12)), whole.n
    problem = LCP.from_problem(whole, comm)
    own = problem.own_rows
    found = derivative(solve(problem, tolerance=1e-12))
    dq, dlower, g, gw = np.random.default_rng(0).normal(size=(4, n))

    def near(part: Any, truth: Any) -> None:
        assert part.shape == truth[own].shape
        assert np.abs(part - truth[own]).max(initial=0.0) <= 1e-9 * np.abs(truth).max()

    assert np.array_equal(found.free, one.free[own])
    assert found.degenerate.size == 0
    assert found.is_unique is one.is_unique is True
    near(found.jvp(dq=dq[own]), one.jvp(dq=dq))
    true = one.jvp(dq=dq, dlower=dlower, dupper=1.0)
    dz = found.jvp(dq=dq[own], dlower=dlower[own], dupper=1.0)
    near(dz, true)
    near(found.dw(dz, dq=dq[own]), one.dw(true, dq=dq))
    only_here = np.where(np.arange(n) < 5, 1.0, 0.0)  # the first rank alone has anything to say
    near(found.jvp(dlower=only_here[own]), one.jvp(dlower=only_here))
    for arguments in ((g,), (g, gw), (0.0 * g, only_here)):
        gradient, truth = found.vjp(*(vector[own] for vector in arguments)), one.vjp(*arguments)
        for name in ("q", "lower", "upper"):
            near(getattr(gradient, name), getattr(truth, name))
        rows = truth.M[own]
        assert gradient.M.shape == rows.shape
        assert np.array_equal(gradient.M.indices, rows.indices)
        assert (
            np.abs(gradient.M.data - rows.data).max(initial=0.0)
            <= 1e-9 * np.abs(truth.M.data).max()
        )


@check(2, 3)
def derivatives_that_need_all_rows_are_refused_everywhere(comm: Any) -> None:
    """A change of M, the adjoint of a nonsymmetric M, a side of a kink; also where one rank alone asks or is kinked."""
    whole = gallery.build("obstacle_2d", size=9).problem
    problem = LCP.from_problem(whole, comm)
    found, own, is_last = derivative(solve(problem)), problem.q.size, comm.rank == comm.size - 1
    words = "rows of M are spread over"
    with pytest.raises(UnsuitableProblem, match=words):
        found.jvp(dM=np.eye(whole.n) if is_last else None)
    with pytest.raises(UnsuitableProblem, match=words):
        found.dw(np.zeros(own), dM=np.eye(whole.n))
    drift = derivative(
        solve(LCP.from_problem(scene("convection_diffusion")[0], comm), tolerance=1e-10)
    )
    z = drift.z
    assert np.isfinite(drift.jvp(dq=np.ones(z.size))).all()
    with pytest.raises(UnsuitableProblem, match=words):
        drift.vjp(np.ones(z.size))
    q = np.full(whole.n, -1.0)
    q[-1] = 1.0  # the neighbour's z is 1
    M = sp.csr_array(
        sp.diags_array([np.r_[np.zeros(whole.n - 2), -1.0], np.ones(whole.n)], offsets=[-1, 0])
    )
    kink = derivative(solve(LCP.from_problem(LCP(M, q), comm)))
    assert kink.is_unique is False
    assert kink.degenerate.size == is_last
    with pytest.raises(UnsuitableProblem, match=words):
        kink.jvp(dq=np.ones(kink.z.size))
    for wrong in (
        found.vjp,
        found.dw,
        lambda part: found.jvp(dq=part),
        lambda part: found.jvp(dlower=part),
    ):
        with pytest.raises(LCPError, match="must be finite"):
            wrong(np.full(own, np.nan if is_last else 1.0))


@check(2, 3)
def a_part_of_wrong_length_is_refused_everywhere(comm: Any) -> None:
    """Where one rank's z is too long or too short, all ranks are told."""
    problem = LCP.from_problem(gallery.build("obstacle_2d", size=9).problem, comm)
    own = problem.q.size
    for wrong in (own - 1, own + 1):
        z = np.zeros(wrong if comm.rank == 1 else own)
        for call in (
            problem.slack,
            problem.gathered,
            lambda z: Certificate.of(problem, z),
            lambda z: error_bound(problem, z),
        ):
            with pytest.raises(LCPError, match=r"rank 1: .* must be a vector of length"):
                call(z)


if __name__ == "__main__":
    run_checks()
