"""`prepare`: a solver for a loop has the statuses of `solve`, and forgets the last call."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest
from inputs.contact_families import FAMILIES as CONTACTS
from inputs.published_problems import PROGRAMS, PublishedProgram
from inputs.small_families import FAMILIES, draw
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    InvalidOption,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    prepare,
    solve,
    solve_batch,
)
from lcp_plugin.judges.program import KKTErrors, PrimalDualPoint, sharp_errors

INF = np.inf
LOOP = LCP([[2.0, -1.0], [-1.0, 2.0]], [-1.0, 0.0])


def random_program(rng: np.random.Generator) -> tuple[Any, ...]:
    """P, c, G, h, A, b and bounds: rows that may be infeasible, costs and entries of any size, active bounds."""
    n, m, p = rng.integers(2, 7), rng.integers(1, 9), rng.integers(0, 3)
    B = rng.normal(size=(n, rng.integers(1, n + 1))) * 10.0 ** rng.integers(-3, 4)
    G, A, x = rng.normal(size=(m, n)), rng.normal(size=(p, n)), rng.normal(size=n)
    h = G @ x + rng.exponential(size=m) * (rng.random(m) < 0.7) - (rng.random() < 0.1)
    low = np.where(rng.random(n) < 0.4, x - rng.exponential(size=n), -INF)
    high = np.where(rng.random(n) < 0.4, x + rng.exponential(size=n), INF)
    c = rng.normal(size=n) * 10.0 ** rng.integers(-2, 3) * (rng.random() < 0.9)
    return B @ B.T, c, G, h, A, A @ x, low, high


@pytest.mark.parametrize("family", FAMILIES)
def test_a_prepared_lcp_has_the_status_of_solve(family, draws):
    """Each problem of a family with the q, M and bounds of the next of its size, in a loop of one solver."""
    drawn = draw(family, len(draws(1000, 60)), 8)
    steps = {one.n: prepare(one) for one in drawn}
    for one in drawn:
        M = one.matrix.toarray()
        found = steps[one.n].solve(q=one.q, M=M, lower=one.lower, upper=one.upper)
        whole = solve(one)
        assert found.status is whole.status
        assert prepare(one).solve().status is whole.status
        if family == "definite" and found.is_solved:
            error = np.abs(M @ (found.z - whole.z)).max()
            assert error <= 1e-6 * (np.abs(one.q).max() + np.abs(M @ whole.z).max())


def test_a_prepared_program_has_the_status_of_solve(draws):
    """Random programs, some of them infeasible, and then with other vectors."""
    rng = np.random.default_rng(0)
    for _ in draws(1000, 60):
        P, c, G, h, A, b, low, high = random_program(rng)
        step = prepare(QuadraticProgram(P, c, G, h, A, b, low, high))
        other = {"c": rng.normal(size=c.size), "h": h + rng.exponential(size=h.size)}
        for vectors in ({}, other, {}):
            whole = solve(step.problem.with_vectors(**vectors))
            found = step.solve(**vectors)
            assert found.status is whole.status
            if found.is_solved:
                size = abs(whole.objective) + np.abs(step.problem.c * whole.x).sum()
                assert abs(found.objective - whole.objective) <= 1e-5 * size


def test_a_prepared_contact_fit_and_nonlinear_problem_have_the_status_of_solve(draws):
    """Random data: contacts with b and W anew, least squares with b anew, and a nonlinear problem from x0."""
    rng = np.random.default_rng(0)
    for _ in draws(300, 30):
        J, b, A = rng.normal(size=(6, 4)), rng.normal(size=6), rng.random((6, 3))
        W = J @ J.T + np.eye(6) * (rng.random() < 0.8)
        contact = FrictionalContact(W, b, [0.5, 0.3])
        step = prepare(contact)
        again = FrictionalContact(2.0 * W, -b, [0.5, 0.3])
        assert step.solve(W=2.0 * W, b=-b).status is solve(again).status
        assert step.solve(b=-b).status is solve(FrictionalContact(W, -b, [0.5, 0.3])).status
        assert step.solve().z.tobytes() == solve(contact).z.tobytes()
        fit = prepare(BoundedLeastSquares(A, b))
        assert fit.solve(b=-b).status is solve(BoundedLeastSquares(A, -b)).status
        assert "nearest_to_zero" in vars(fit.problem.with_vectors(b=-b))
        curved = NonlinearProblem(lambda x, b=b: x + x**3 + b, lower=np.zeros(6))
        assert prepare(curved).solve(x0=np.abs(b)).status is solve(curved, x0=np.abs(b)).status


def test_a_watched_small_program_has_the_bits_of_a_program_without_options(draws):
    """Without options, daqp's point is returned without a run; with costs in large units, and rows of one unknown."""
    rng = np.random.default_rng(2)
    for k in draws(500, 30):
        P, c, G, h, A, b, low, high = random_program(rng)
        unit = 10.0 ** rng.integers(-11, 12, 2) if k % 4 == 0 else np.ones(2)
        one = np.where(np.arange(c.size) == k % c.size, 1.0, 0.0) if k % 2 else G[0]
        rows, limits = np.vstack([G, one]), np.append(h, h[0])
        program = QuadraticProgram(unit[0] * P, unit[1] * c, rows, limits, A, b, low, high)
        bare, watched = solve(program), solve(program, record=True)
        assert bare.status is watched.status
        np.testing.assert_array_equal(bare.x, watched.x)  # −0 is 0
        stages = (
            [(stage.name, stage.iterations) for stage in one.stages] for one in (bare, watched)
        )
        assert next(stages) == next(stages)  # their reasons hold seconds
        np.testing.assert_equal(bare.duals, watched.duals)


@pytest.mark.parametrize("name", [name for name, size in PROGRAMS.items() if size < 400])
def test_a_prepared_published_program_has_the_status_of_solve(name):
    """Dense and sparse, with rows of one unknown, equations and far limits."""
    of = PublishedProgram.read(name)
    program = QuadraticProgram.from_ranges(of.P, of.q, of.A, of.l, of.u)
    assert prepare(program).solve().status is solve(program).status


BLOCK = 2.0 * np.eye(2), [[0.0, 1]], [[1.0, 0]]  # mass matrix, normals, tangents
HINGED = np.eye(3), [[0.0, 1, 0]], [[1.0, 0, 0]]  # its third velocity is that of a joint


@pytest.mark.parametrize(
    ("W", "b", "shape"),
    [
        (np.eye(3), [[-1.0, 0.3, 0.4]], {"gaps": 0.05, "time_step": 0.1}),
        (BLOCK, [0.3, -2.0], {"gaps": [0.01], "time_step": 0.01}),
        (BLOCK, [[-2.0, 0.3]], {}),
        (HINGED, [0.3, -2.0, 1.0], {"equations": [[0.0, 1, 1]]}),
        (np.eye(3), [-1.0, 0.3, 1.0], {"equations": 1, "dimension": 2}),
    ],
)
def test_velocities_of_a_prepared_contact_are_read_as_by_the_constructor(W, b, shape):
    """Gaps stay, and velocities of bodies are velocities of bodies, also of the result; so for b = None."""
    right = solve(FrictionalContact(W, b, 0.5, **shape))
    first = np.zeros_like(b)
    step = prepare(FrictionalContact(W, first, 0.5, **shape))
    motion = step.solve(b=b).motion
    np.testing.assert_array_equal(step.last.z, right.z)
    np.testing.assert_equal(motion.body_velocities, right.motion.body_velocities)
    np.testing.assert_array_equal(step.solve(b=None).z, step.solve(b=first).z)
    other = 2.0 * step.problem.W
    now = prepare(FrictionalContact(W, b, 0.5, **shape)).solve(W=other)
    np.testing.assert_array_equal(step.solve(b=b, W=other).z, now.z)
    with pytest.raises(InvalidProblem, match="W must"):
        step.solve(W=BLOCK)


def test_a_prepared_lcp_of_bodies_has_their_velocities():
    """They are the velocities of the problem itself, as long as no data are passed."""
    problem = LCP.from_contacts(BLOCK, 0.5, [0.3, -2.0])
    now, right = prepare(problem).solve(), solve(problem)
    velocities = [problem.origin.recover(each).body_velocities for each in (now, right)]
    np.testing.assert_allclose(*velocities)


@pytest.mark.parametrize("family", CONTACTS)
def test_prepared_contacts_between_bodies_have_the_status_of_solve(family, draws):
    """Exact cones and pyramids, masses apart by up to 100, from one step to the next."""
    for seed in draws(100, 8):
        rng = np.random.default_rng(seed)
        data = CONTACTS[family](int(rng.integers(1, 7)), 3, 100.0, rng)
        exact = FrictionalContact(data.W, data.velocities, data.friction)
        pyramid = LCP(*data.arrays, lower=data.lower)
        for one, other in ((exact, {"b": 0.9 * exact.b}), (pyramid, {"q": 0.9 * pyramid.q})):
            step = prepare(one)
            assert step.solve().status is solve(one).status
            assert step.solve(**other).status is step.solve().status


def test_a_point_that_the_quick_test_of_programs_accepts_passes_the_criterion(draws):
    """Points near solutions: two bounds within the tolerances imply the criterion by plain sums."""
    rng, accepted, drawn = np.random.default_rng(1), 0, draws(600, 20)
    for _ in drawn:
        one = QuadraticProgram(*random_program(rng))
        judged, solved = one.judged, solve(one)
        if not solved.is_solved:
            continue
        y = np.append(solved.duals["inequality"], solved.duals["equality"])
        for size in (0.0, 1e-14, 1e-11, 1e-9, 1e-7):
            near = [each * (1.0 + size * rng.normal(size=each.size)) for each in (solved.x, y)]
            errors = sharp_errors(judged, *near)
            for tolerance in (1e-6, 1e-9, 1e-12):
                if errors.meet(tolerance):
                    accepted += 1
                    point = PrimalDualPoint(judged, *near, is_exact=False)
                    plain = point.row_errors().max(), point.gaps().max()
                    assert KKTErrors(*plain).meet(tolerance)
    assert accepted > len(drawn)


def test_data_that_are_not_passed_are_the_prepared_problems():
    """A call with other data, bounds or a start leaves the next call's bits alone."""
    step, other = prepare(LOOP), np.array([1.0, -4.0])
    first = step.solve()
    for call in ({"q": other}, {"M": 3.0 * np.eye(2)}, {"lower": 0.2, "upper": 0.3}, {"z0": other}):
        changed = step.solve(**call)
        assert changed.is_solved
        assert step.solve().z.tobytes() == first.z.tobytes()
    assert step.solve(q=other, warm=True).is_solved
    assert step.solve().z.tobytes() == first.z.tobytes()
    np.testing.assert_allclose(step.solve(q=other).z, [2.0 / 3.0, 7.0 / 3.0])


@refusals(r"""
prepare(LOOP).solve(q=np.array([np.nan, 0.0])) → InvalidProblem: q
prepare(LOOP).solve(q=np.zeros(3)) → InvalidProblem: q
prepare(LOOP).solve(M=np.full((2, 2), np.inf)) → InvalidProblem: M
prepare(LOOP).solve(M=np.eye(3)) → InvalidProblem: M
prepare(LOOP).solve(lower=2.0, upper=1.0) → InvalidProblem: lower
prepare(CURVE).solve(q=np.zeros(3)) → InvalidProblem: q
prepare(CURVE).solve(q=np.array([np.nan, 0.0])) → InvalidProblem: q
prepare(PROGRAM).solve(c=np.array([np.nan, 0.0])) → InvalidProblem: c
prepare(PROGRAM).solve(h=np.zeros(2)) → InvalidProblem: h
prepare(PROGRAM).solve(lower=np.ones(2), upper=np.zeros(2)) → InvalidProblem: lower
prepare(PROGRAM).solve(lower=np.full(2, 1e-12), upper=np.zeros(2)) → InvalidProblem: lower
prepare(PROGRAM).solve(lower=np.full(2, np.nan)) → InvalidProblem: lower
prepare(ConeProblem(np.eye(2), [1.0, 1.0], [("second_order", 2)])) → InvalidOption: prepare needs
prepare(LOOP, tolerrance=1e-8) → InvalidOption: tolerance
""")
def test_wrong_data_are_refused_as_by_the_constructor(call, words):
    """A NaN, another shape, crossed bounds (by little also), and classes without a loop."""
    program = QuadraticProgram(np.eye(2), [1.0, 1.0], [[1.0, 1.0]], [1.0])
    curve = NonlinearProblem(lambda x: x**3, lower=np.zeros(2))
    assert_refused(call, words, {"LOOP": LOOP, "PROGRAM": program, "CURVE": curve})


def test_threads_may_share_a_solver():
    """400 calls by four threads have the bits of calls one after another."""
    rng = np.random.default_rng(0)
    loads = rng.normal(size=(400, 2))
    step = prepare(LOOP)
    alone = [step.solve(q=q).z.tobytes() for q in loads]
    with ThreadPoolExecutor(4) as pool:
        assert [*pool.map(lambda q: step.solve(q=q).z.tobytes(), loads)] == alone


def test_the_caller_may_write_to_the_data_after_the_call():
    """The record of a result, which is made on access, belongs to the data of its call."""
    step, q = prepare(LOOP), np.array([-1.0, 0.5])
    found = step.solve(q=q)
    q[:] = 7.0
    assert found.certificate.problem.q.tolist() == [-1.0, 0.5]
    assert found.residual <= 1e-12
    assert "SOLVED" in str(found)


def test_a_batch_takes_a_solver():
    """Its problem is the problem of the batch."""
    loads = np.array([[-1.0, 0.0], [0.0, -2.0]])
    assert (solve_batch(prepare(LOOP), loads).z == solve_batch(LOOP, loads).z).all()


def test_watched_least_squares_have_the_bits_of_a_call_without_options(draws):
    """Without options, the point of nnls is returned without a run; also if it is not optimal, as of equal columns."""
    rng = np.random.default_rng(3)
    for k in draws(1000, 40):
        A = rng.random(rng.integers(1, 20, 2)) * 10.0 ** rng.integers(-9, 9 if k % 4 == 0 else -8)
        A[:, -1], how = A[:, 0], {"ridge": 1e-6} if k % 3 == 0 else {}
        problem = BoundedLeastSquares(A, A @ rng.normal(size=A.shape[1]), **how)
        bare, watched = solve(problem), solve(problem, record=True)
        assert (bare.status, bare.stages) == (watched.status, watched.stages)
        assert bare.x.tobytes() == watched.x.tobytes()
        assert prepare(problem).solve(b=problem.b).x.tobytes() == bare.x.tobytes()


@pytest.mark.quick
def test_a_step_with_other_matrices_has_the_result_of_solve():
    """Each array of the constructor may change, names stay."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        P, c, G, h, A, b, low, high = random_program(rng)
        step = prepare(QuadraticProgram(P, c, G, h, A, b, low, high))
        P, G, A = P + np.eye(len(P)), G + rng.normal(size=G.shape), 2.0 * A
        found = step.solve(P=P, G=G, A=A)
        whole = solve(QuadraticProgram(P, c, G, h, A, b, low, high))
        assert found.status is whole.status
        assert np.array_equal(found.x, whole.x, equal_nan=True)


@pytest.mark.parametrize(
    ("problem", "data"),
    [
        (NonlinearProblem(lambda x: x + x**3, lower=np.zeros(2)), {"q": np.array([-2.0, 1.0])}),
        (BoundedLeastSquares(np.eye(2), [3.0, 1.0]), {"l1": [1.0, 2.0]}),
        (BoundedLeastSquares(np.eye(2), [3.0, 1.0]), {"A": [[2.0, 0.0], [0.0, 1.0]], "ridge": 1.0}),
        (QuadraticProgram(np.eye(2), [-1.0, -4.0], [[1.0, 1.0]], [2.0]), {"P": 2.0 * np.eye(2)}),
        (LCP(np.eye(2), [-1.0, 1.0], names=["a", "b"]), {"M": [[2.0, 0.0], [0.0, 1.0]]}),
        (FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5), {"W": 2.0 * np.eye(3)}),
    ],
    ids=lambda part: "-".join(part) if isinstance(part, dict) else type(part).__name__,
)
def test_a_prepared_solver_takes_all_data_of_the_table(problem, data):
    """Vectors and matrices by name give the solution of the problem with these data."""
    step = prepare(problem)
    expected = solve(problem.with_data(**data)).require_solved().x
    assert step.solve(**data).require_solved().x.tolist() == pytest.approx(expected.tolist())
    assert not np.allclose(expected, solve(problem).x)


@pytest.mark.parametrize(
    "data", [{"q": [-1.0, 2.0]}, {"upper": 0.25}, {"q": [-1.0, 2.0], "lower": -5.0}]
)
def test_a_nonlinear_problem_may_get_its_size_from_the_data_or_the_start(data):
    """A problem with numbers for bounds knows no size; its steps have the solution of a problem that does."""
    step = prepare(NonlinearProblem(lambda x: x + x**3 - 1.0))
    sized = NonlinearProblem(lambda x: x + x**3 - 1.0, lower=np.zeros(2)).with_data(**data)
    assert step.solve(x0=np.zeros(2), **data).z.tolist() == solve(sized).z.tolist()
    assert step.solve(x0=np.zeros(3)).is_solved


def test_a_prepared_program_refuses_what_solve_refuses():
    """A start that is no finite vector raises InvalidOption, on the short way also."""
    program = QuadraticProgram(2 * np.eye(2), [-2.0, -5.0], [[1, 2]], [3], lower=0)
    for start in ("abc", np.array([np.nan, 1.0]), [1.0], [1.0, 2.0, 3.0, 4.0]):
        for call in (
            prepare(program).solve,
            partial(solve, program),
            partial(solve, program, "piqp"),
        ):
            with pytest.raises(InvalidOption, match="z0"):
                call(z0=start)


def test_a_program_without_iterations_ends_max_iterations():
    """Also by an external solver that takes no limit of 0, and prepared."""
    program = QuadraticProgram(2 * np.eye(2), [-2.0, -5.0], [[1, 2]], [3], lower=0)
    found = [solve(program, name, max_iterations=0) for name in ("auto", "piqp", "daqp", "newton")]
    for result in (*found, prepare(program, max_iterations=0).solve()):
        assert result.status is Status.MAX_ITERATIONS


def test_the_x_of_a_program_is_a_start_of_a_run_on_its_conditions():
    """A minimizer that satisfies the rows strictly needs no step of newton, its multipliers are 0."""
    program = QuadraticProgram(2 * np.eye(2), [-2.0, -4.0], [[1.0, 2.0]], [30.0], lower=0)
    assert (
        solve(program, "newton", z0=[1.0, 2.0]).iterations
        == 0
        < solve(program, "newton").iterations
    )


@pytest.mark.parametrize("watch", [{"record": True}, {"callback": lambda *step: None}])
def test_watching_a_program_changes_no_bit_of_its_point(watch):
    """Noise of 1e-15 in daqp's point counts as 0 with and without an option that watches."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        A, G = rng.normal(size=(4, 4)).round(1), rng.normal(size=(5, 4)).round(1)
        program = QuadraticProgram(A @ A.T, rng.normal(size=4).round(1), G, np.ones(5), lower=-0.5)
        assert (solve(program).x == solve(program, **watch).x).all(), seed
