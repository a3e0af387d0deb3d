"""External solvers: their input, the use of their points, and independent verification."""

import itertools
import time

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.planted import planted_program
from scipy.optimize import linprog

from lcp_plugin import InvalidOption, QuadraticProgram, Status, UnsuitableProblem, solve
from lcp_plugin.engines import ENGINES, engine_class
from lcp_plugin.engines.engine import Engine, EnginePoint, EngineStatus
from lcp_plugin.problems.programs.engine_points import attempts, run_engine, unscaled

INF = np.inf
QUADRATIC = [name for name in ENGINES if not engine_class(name).is_for_linear_alone]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", QUADRATIC)
def test_each_engine_finds_the_planted_answer(name, seed):
    """X to 1e-9 after the polish, its multipliers, and the engine's name in the result."""
    program, x, value = planted_program(12, 9, 3, 12, seed)
    found = solve(program, name)
    assert np.abs(found.x - x).max() <= 1e-9 * (1.0 + np.abs(x).max())
    assert found.objective == pytest.approx(value, abs=1e-9)
    assert found.algorithm == name
    rows = program.P @ found.x + program.c + program.G.T @ found.duals["inequality"]
    rows += program.A.T @ found.duals["equality"] - found.duals["lower"] + found.duals["upper"]
    assert np.abs(rows).max() <= 1e-9


@pytest.mark.parametrize("name", ENGINES)
def test_each_engine_takes_dense_and_sparse_linear_programs(name):
    """Max x₁ + 2 x₂ with x₁ + x₂ ≤ 3 in a box: (1, 2), by arrays and by sparse ones."""
    for kind in (np.array, sp.csr_array):
        program = QuadraticProgram(None, [-1, -2], kind([[1.0, 1.0]]), [3], lower=0, upper=2)
        found = solve(program, name)
        assert found.x.tolist() == pytest.approx([1.0, 2.0], abs=1e-8)
        assert found.duals["inequality"].tolist() == pytest.approx([1.0], abs=1e-7)


@pytest.mark.parametrize("name", QUADRATIC)
def test_a_program_without_rows_or_free_unknowns_is_answered(name):
    """Bounds alone, and bounds that leave one point."""
    assert solve(
        QuadraticProgram(np.eye(2), [-3, 1], lower=0, upper=2), name
    ).x.tolist() == pytest.approx([2, 0])
    fixed = QuadraticProgram(np.eye(2), [-3, 1], [[1, 1]], [9], lower=[1, 2], upper=[1, 2])
    assert solve(fixed, name).x.tolist() == [1, 2]


@pytest.mark.parametrize("name", ENGINES)
def test_what_an_engine_says_of_no_minimum_is_proved_by_us(name):
    """Inconsistent rows and an unbounded objective get proofs that verify exactly."""
    contradicting = solve(
        QuadraticProgram(None, [1, 1], [[1, 1], [-1, -1]], [1, -3], lower=-9, upper=9), name
    )
    assert contradicting.status is Status.INFEASIBLE
    assert contradicting.proof.verify()
    endless = solve(QuadraticProgram(None, [-1, 0], [[0, 1]], [1], lower=0), name)
    assert endless.status is Status.UNBOUNDED
    assert endless.proof.verify()


def test_what_an_engine_does_not_take_is_refused_and_nothing_left_needs_none():
    """HiGHS rejects quadratic programs; no engine runs if all unknowns are fixed."""
    with pytest.raises(
        UnsuitableProblem, match='highs solves linear programs, but P has nonzeros; take "piqp"'
    ):
        solve(QuadraticProgram(np.eye(1), [1.0]), "highs")
    for name in ENGINES:
        assert solve(
            QuadraticProgram(None, [1.0], G=[[1.0]], h=[2.0], lower=0, upper=0), name
        ).x.tolist() == [0.0]


@pytest.mark.parametrize("name", ENGINES)
def test_an_answer_of_zeros_is_found(name):
    """Rows x ≥ 0 and positive costs: x = 0, of which an interior point leaves 1e-11 or 1e-50."""
    kind = np.zeros((2, 2)) if name == "highs" else np.eye(2)
    found = solve(QuadraticProgram(kind, [1, 1], G=-np.eye(2), h=[0, 0]), name)
    assert found.is_solved
    assert np.abs(found.x).max() <= 1e-12


def test_a_row_with_a_large_coefficient_is_met_to_the_rounding_of_its_unknown():
    """1e15 times 4e-15 is a term of a row, and 4e-15 is the rounding of x₃ in another row: x is right to 1e-12."""
    program = QuadraticProgram(
        [[18, -1, 7, -13], [-1, 15, 8, -7], [7, 8, 13, -3], [-13, -7, -3, 26]],
        [2, -3, -1, -3],
        G=[[-1, 2, -2, -2]],
        h=[-2],
        A=[[0, 2, 3, -2], [2, 3, 2, 1e15]],
        b=[8, 11],
        lower=[-1, 1, -1, -INF],
        upper=[4, 1, 4, 2],
    )
    for name in ("auto", *QUADRATIC):
        found = solve(program, name)
        assert not found.is_solved or np.abs(found.x - [0.0, 1.0, 2.0, 4e-15]).max() <= 1e-12


def test_options_are_the_engine_s_own_and_others_are_refused():
    """An option is passed by its name; a wrong option raises InvalidOption."""
    program, x, _ = planted_program(12, 9, 3, 12, 0)
    assert np.abs(solve(program, "piqp", max_iter=60, eps_abs=1e-8).x - x).max() <= 1e-7
    for name in QUADRATIC:
        with pytest.raises(InvalidOption, match=f"{name} does not take max_itr=3"):
            solve(program, name, max_itr=3)
    linear = QuadraticProgram(None, [1.0], lower=0)
    with pytest.raises(InvalidOption, match="highs does not take max_itr=3"):
        solve(linear, "highs", max_itr=3)
    piqp = engine_class("piqp")
    assert np.abs(solve(program, piqp(max_iter=50)).x - x).max() <= 1e-7
    assert repr(piqp(max_iter=50)) == "PIQP(max_iter=50)"
    with pytest.raises(InvalidOption, match="PIQP"):
        solve(program, piqp(), max_iter=3)


def test_the_same_call_gives_the_same_points_where_an_engine_has_none():
    """For inconsistent rows daqp returns uninitialized memory, which is never used as a point."""
    program = QuadraticProgram(
        2.0 * np.eye(2), [0, 0], A=[[1, -1], [1, -1]], b=[1e3, 1e3 * (1 + 2e-6)]
    )
    runs = [run_engine(program, engine_class("daqp")(), 1e-6, unscaled).solution for _ in range(5)]
    assert len({run.x.tobytes() for run in runs}) == 1
    assert np.abs(runs[0].x).max() <= 1e4


def test_a_clock_chooses_no_engine(monkeypatch):
    """The same engines run, and give the same bits, on a machine that slows down from call to call."""
    program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1 / 3]], h=[1 / 3])
    runs = [solve(program, tolerance=1e-40)]  # which no point reaches
    ticks = (10.0**k for k in itertools.count())
    monkeypatch.setattr(time, "thread_time", lambda: next(ticks))
    monkeypatch.setattr(time, "process_time", lambda: next(ticks))
    runs.append(solve(program, tolerance=1e-40))
    first, second = ([stage.name for stage in run.stages] for run in runs)
    assert first == second
    assert len(first) > 2
    assert runs[0].x.tobytes() == runs[1].x.tobytes()


def test_piqp_without_steps_gives_the_same_point_in_each_call():
    """After max_iter = 0, PIQP's result is uninitialized memory, which is never used as a point."""
    none, points = engine_class("piqp")(max_iter=0), set()
    for seed in range(20):
        draws = np.random.default_rng(seed)
        # leaves numbers in freed memory
        solve(QuadraticProgram(np.eye(4), draws.standard_normal(4)), "piqp")
        program = QuadraticProgram(np.eye(4), -np.ones(4), G=np.ones((1, 4)), h=[1.0], lower=0.1)
        points.add(run_engine(program, none, 1e-6, unscaled).solution.x.tobytes())
    assert len(points) == 1


def test_unknown_residuals_are_not_printed_as_nan(capsys):
    """The start of an external solver has no residual, so its line has a dash."""
    solve(planted_program(12, 9, 3, 12, 0)[0], verbose=True)
    printed = capsys.readouterr().out
    assert "–" in printed
    assert "nan" not in printed


@pytest.mark.parametrize("limit", [{"max_seconds": 1e-9}, {"callback": lambda sample, z: True}])
def test_auto_that_ends_at_the_start_names_the_solver_that_began(limit):
    """The name of the algorithm never is "auto: auto"."""
    result = solve(planted_program(12, 9, 3, 12, 0)[0], **limit)
    assert result.algorithm == ", ".join(["auto: " + stage.name for stage in result.stages])


def test_auto_without_a_solver_has_its_own_name():
    """A contradiction of a program that is not convex is proved before any solver begins."""
    result = solve(QuadraticProgram(-np.eye(2), [1, 1], A=[[1, 1], [1, 1]], b=[1, 2], lower=0))
    assert result.status is Status.INFEASIBLE
    assert result.algorithm == "auto"


def test_an_engine_takes_the_options_of_solve():
    """Engines support a step limit, record and callback, ignore a start, and reject bad values."""
    program, x, _ = planted_program(12, 9, 3, 12, 0)
    short = solve(program, "piqp", max_iterations=1)
    assert short.status in (Status.MAX_ITERATIONS, Status.SOLVED)  # a polish may complete one step
    assert solve(program, "piqp", max_iterations=1, max_seconds=60).iterations == short.iterations
    seen = []
    watched = solve(
        program,
        "piqp",
        record=True,
        callback=lambda sample, z: seen.append((sample.iteration, z.size)),
    )
    assert short.iterations < watched.iterations
    assert [sample.residual is None for sample in watched.history] == [True, False]
    assert seen == [(0, x.size), (watched.iterations, x.size)]
    assert np.array_equal(solve(program, "piqp", z0=x).x, watched.x)
    for name, wrong in (
        ("piqp", {"max_iter": 1.5}),
        ("daqp", {"iter_limit": "x"}),
        ("clarabel", {"tol_feas": "a"}),
    ):
        with pytest.raises(InvalidOption, match=f"{name} does not take"):
            solve(program, name, **wrong)


def test_an_engine_that_answers_nonsense_is_not_believed():
    """A point that an engine falsely calls optimal is not SOLVED; NaN is harmless."""

    class Liar(Engine):
        name, solves, cost, reference = "liar", "nothing", "nothing", "nobody"
        value = 1.0

        def solve(self, program, limits):
            n, m, p = program.c.size, program.h.size, program.b.size
            return EnginePoint(np.full(n, self.value), np.zeros(m + p), 1, EngineStatus.OPTIMAL)

    program = QuadraticProgram(None, [-1, -1, 2], [[1, 2, 3]], [6], lower=0, upper=5)
    assert not solve(program, Liar()).is_solved
    Liar.value = np.nan
    assert not solve(program, Liar()).is_solved


@pytest.mark.parametrize("name", QUADRATIC)
@pytest.mark.parametrize("far", [1e9, 1e12, 1e15, 1e19])
def test_limits_far_beyond_all_others_fool_no_engine_for_good(name, far):
    """Two rows and bounds of 1e9 … 1e19 do not change the known solution of a program."""
    program, x, value = planted_program(12, 9, 3, 12, 7)
    rng = np.random.default_rng(1)
    G = np.vstack([program.G, rng.normal(size=(2, x.size))])
    stretched = QuadraticProgram(
        program.P,
        program.c,
        G,
        np.append(program.h, [far, 3.0 * far]),
        program.A,
        program.b,
        lower=program.lower,
        upper=far,
    )
    found = solve(stretched, name)
    assert found.objective == pytest.approx(value, abs=1e-8)
    assert np.abs(found.x - x).max() <= 1e-7


@pytest.mark.parametrize("kind", [np.asarray, sp.csr_array])
@pytest.mark.parametrize("rank", [0, 2])
def test_a_minimum_at_0_with_multipliers_is_solved(kind, rank, draws):
    """The solution is x = 0 over rows G x ≤ 0 if c = −Gᵀy for some y ≥ 0, although all terms vanish there."""
    for seed in draws(40):
        rng = np.random.default_rng(seed)
        n, m = int(rng.integers(2, 8)), int(rng.integers(1, 10))
        G, F = rng.normal(size=(m, n)).round(1), rng.normal(size=(n, rank)).round(1)
        cost = -G.T @ rng.random(m).round(1)
        found = solve(QuadraticProgram(kind(F @ F.T + np.eye(n)), cost, kind(G), np.zeros(m)))
        assert found.is_solved, seed
        assert np.abs(found.x).max() <= 1e-12


def test_a_factorization_that_fills_in_is_not_begun():
    """Flows of 40 goods through 400 shared arcs: HiGHS pivots 632 times, PIQP's first step took 10 s; value of linprog.

    A chain of as many rows goes to PIQP, and a quadratic program to Clarabel.
    """
    rng, nodes, goods = np.random.default_rng(0), 100, 40
    tails, heads = np.repeat(np.arange(nodes), 4), rng.integers(0, nodes, 4 * nodes)
    heads[::4] = (tails[::4] + 1) % nodes
    arcs, pairs = np.arange(tails.size), rng.choice(nodes, (goods, 2))
    network = sp.csr_array((np.ones(tails.size), (tails, arcs)), shape=(nodes, tails.size))
    network -= sp.csr_array((np.ones(tails.size), (heads, arcs)), shape=(nodes, tails.size))
    b = (np.eye(nodes)[pairs[:, 0]] - np.eye(nodes)[pairs[:, 1]]).ravel()
    A = sp.csr_array(sp.kron(sp.eye_array(goods), network))
    G, h = sp.csr_array(sp.kron(np.ones((1, goods)), sp.eye_array(tails.size))), np.full(400, 5.0)
    c = np.tile(rng.random(tails.size) + 0.1, goods)
    found = solve(QuadraticProgram(None, c, G, h, A, b, lower=0.0))
    assert found.algorithm == "auto: highs"
    assert found.objective == pytest.approx(linprog(c, G, h, A, b).fun, rel=1e-9)
    quadratic = QuadraticProgram(sp.eye_array(c.size), c, G, h, A, b, lower=0.0)
    assert next(attempts(quadratic))[0].name == "clarabel"
    chain = sp.diags_array([np.ones(4399), -np.ones(4399)], offsets=[0, 1], shape=(4399, 4400))
    line = QuadraticProgram(None, np.ones(4400), chain, np.ones(4399), lower=0.0)
    assert next(attempts(line))[0].name == "piqp"
