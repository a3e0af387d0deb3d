"""trace(): every segment of a path is right, and a path that cannot continue reports the reason."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import paths
from oracles.exact import exact_solution
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    InvalidOption,
    NotConverged,
    QuadraticProgram,
    Status,
    solve,
    trace,
)
from lcp_plugin.problems.parametric.path import Path

INF = np.inf


def assert_pieces_join(path: Path) -> None:
    """Require that each segment begins where the previous one ends, in θ and, without jumps, z."""
    for one, other in itertools.pairwise(path.pieces):
        if other.begin in (*path.jumps, *path.segments):
            continue
        assert one.end == other.begin
        size = 1e-9 * (1.0 + np.abs(one.z_at(one.end)).max())
        assert np.abs(one.x_at(one.end) - other.x_at(one.end)).max() <= size


@pytest.mark.parametrize("seed", range(12))
def test_small_paths_are_exact(seed):
    """Solutions by exact enumeration for n ≤ 5 are on the path, at breakpoints and between them."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    B = rng.integers(-2, 3, (n, n)).astype(float)
    K = rng.integers(-2, 3, (n, n)).astype(float)
    M = B @ B.T + np.eye(n) + (K - K.T)
    problem = LCP(
        M, rng.integers(-4, 5, n), lower=-rng.integers(0, 2, n), upper=rng.integers(1, 4, n)
    )
    dq = rng.integers(-4, 5, n).astype(float)
    path = trace(problem, {"q": dq}, -4, 4).require_solved()
    assert_pieces_join(path)
    middles = 0.5 * (path.breakpoints[1:] + path.breakpoints[:-1])
    for theta in (*path.breakpoints, *middles, *rng.uniform(-4.0, 4.0, 5)):
        exact = [float(value) for value in exact_solution(problem.with_q(problem.q + theta * dq)).z]
        assert np.abs(path.at(theta).z - exact).max() <= 1e-12 * (1.0 + np.abs(exact).max())
    cases = [tuple(piece.case.tolist()) for piece in path.pieces]
    slopes = [tuple(np.round(piece.x1, 9)) for piece in path.pieces]
    assert all(one != other for one, other in itertools.pairwise(zip(cases, slopes, strict=True)))


@pytest.mark.quick(2)
@pytest.mark.parametrize("seed", range(12))
def test_monotone_paths_meet_solves(seed):
    """Between two solvable ends the path of a monotone LCP is solved everywhere, singular M included."""
    status, wrong, apart = paths.examined(np.random.default_rng(seed), 60, 5)
    assert (status, wrong, apart) == ("SOLVED", 0, 0)


def test_bounds_move():
    """Bounds may move as q does."""
    path = trace(LCP(np.eye(2), [-1, -1], upper=[1, 4]), {"upper": [1, -1], "q": [-1, 0]}, 0, 4)
    for theta in (0.0, 0.5, 2.0, 3.5):
        wanted = np.clip([1 + theta, 1], 0, [1 + theta, 4 - theta])
        assert np.allclose(path.at(theta).z, wanted, rtol=0, atol=1e-14)
    assert path.breakpoints.tolist() == [0.0, 3.0, 4.0]


# --- programs -------------------------------------------------------------------------------------------------


def cheapest(S: Any, mean: Any, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the portfolio of least ½ xᵀS x − tolerance · meanᵀx, Σ x = 1, x ≥ 0, by trying every set of assets."""
    n, best, least = mean.size, np.zeros(mean.size), INF
    for size in range(1, n + 1):
        for assets in itertools.combinations(range(n), size):
            own = list(assets)
            system = np.block(
                [[S[np.ix_(own, own)], -np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]]
            )
            found = np.linalg.solve(system, np.append(tolerance * mean[own], 1.0))[:size]
            value = 0.5 * found @ S[np.ix_(own, own)] @ found - tolerance * mean[own] @ found
            if found.min() >= 0.0 and value < least:
                least, best = value, np.zeros(n)
                best[own] = found
    return best, least


def test_frontier_is_that_of_all_sets_of_assets():
    """An efficient frontier is the least of all sets of assets at every risk tolerance, corners at breakpoints."""
    rng = np.random.default_rng(7)
    factors, mean = rng.standard_normal((6, 12)), rng.random(6)
    S = factors @ factors.T / 12
    program = QuadraticProgram(S, np.zeros(6), A=np.ones((1, 6)), b=[1], lower=0)
    path = trace(program, {"c": -mean}, 0.0, 20.0).require_solved()
    assert len(path) > 3
    for theta in (*path.breakpoints, *rng.uniform(0.0, 5.0, 20)):
        best, least = cheapest(S, mean, theta)
        point = path.at(theta)
        assert np.abs(point.x - best).max() <= 1e-10
        assert point.objective == pytest.approx(least, abs=1e-12)
        assert point.solution.is_optimal(1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_linear_programs_move_along_faces(seed):
    """Paths of linear programs with singular M follow right-hand sides and costs."""
    rng = np.random.default_rng(seed)
    n, m = 8, 5
    G, h = rng.integers(-2, 4, (m, n)).astype(float), rng.integers(3, 9, m).astype(float)
    program = QuadraticProgram(None, -rng.integers(0, 4, n), G=G, h=h, lower=0, upper=3)
    name = "c" if seed % 2 else "h"
    change = rng.integers(-2, 3, n if name == "c" else m).astype(float)
    path = trace(program, {name: change}, 0, 1).require_solved()
    for theta in rng.random(5):
        answer = solve(
            program.with_vectors(**{name: getattr(program, name) + theta * change})
        ).require_solved()
        assert path.at(theta).objective == pytest.approx(answer.objective, abs=1e-7)
        assert path.at(theta).is_solved


def test_infeasible_from_somewhere_on_comes_with_the_proof():
    """A path ends where the program has no point any more, exactly there, and what is beyond is proved."""
    path = trace(
        QuadraticProgram(np.eye(2), [0, 0], A=[[1, 1]], b=[0], lower=0, upper=1), {"b": [1]}, 0, 5
    )
    assert path.status is Status.INFEASIBLE
    assert path.reached == pytest.approx(2.0, abs=1e-12)
    assert path.proof.verify()
    assert "ends at 2" in path.explain()
    assert path.at(2.0).x == pytest.approx([1.0, 1.0])
    with pytest.raises(InvalidOption, match="not on the path"):
        path.at(2.5)
    with pytest.raises(NotConverged, match="INFEASIBLE"):
        path.require_solved()


def test_unbounded_from_somewhere_on_comes_with_the_proof():
    """A path ends where the objective becomes unbounded below."""
    path = trace(QuadraticProgram(None, [1], lower=0), {"c": [-1]}, 0, 2)
    assert path.status is Status.UNBOUNDED
    assert path.reached == pytest.approx(1.0, abs=1e-12)


def test_no_solution_at_the_start():
    """A path without a solution at the start is empty, and has the status of the start."""
    path = trace(
        QuadraticProgram(np.eye(1), [0], lower=1, upper=2, A=[[1]], b=[3]), {"c": [1]}, 0, 1
    )
    assert path.status is Status.INFEASIBLE
    assert not path.pieces
    assert path.breakpoints.size == 0


def test_a_solution_that_jumps_is_named():
    """If M is not monotone a path may turn back: the solution jumps, and is right beyond."""
    path = trace(LCP([[-1]], [2], upper=1), {"q": [-1]}, 0, 3)
    assert path.jumps == pytest.approx([2.0])
    assert path.at(1.9).z == pytest.approx([0.0])
    assert path.at(2.1).z == pytest.approx([1.0])
    assert path.is_solved
    assert "jumps at 2" in path.explain()


# --- least squares --------------------------------------------------------------------------------------------


def lasso(seed: int, m: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A and b of a lasso with few columns that matter."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((m, n)) @ (np.eye(n) + rng.standard_normal((n, n)) / np.sqrt(n))
    return A, A[:, :4] @ [2.0, -1.0, 1.0, 3.0] + rng.standard_normal(m)


@pytest.mark.parametrize("shape", [(30, 10), (20, 40), (60, 60)])
def test_lasso_path_meets_solves(shape):
    """Every value of a penalty has the x that a solve has; wide problems too."""
    A, b = lasso(1, *shape)
    most = np.abs(A.T @ b).max()
    path = trace(
        BoundedLeastSquares(A, b, lower=-INF), {"l1": 1}, most, 1e-3 * most
    ).require_solved()
    assert_pieces_join(path)
    assert not path.at(most).x.any()
    for share in (0.9, 0.5, 0.1, 0.01):
        answer = solve(BoundedLeastSquares(A, b, lower=-INF, l1=share * most)).require_solved()
        assert np.abs(path.at(share * most).x - answer.x).max() <= 1e-6 * np.abs(answer.x).max()
        assert path.at(share * most).objective == pytest.approx(answer.cost, rel=1e-8)


def test_penalties_within_bounds_weights_and_a_ridge():
    """Bounds on both sides of 0, on one side, columns without a penalty, weights and a ridge, sparse and dense."""
    rng = np.random.default_rng(5)
    A, b = lasso(5, 25, 6)
    lower = np.array([-INF, -0.5, 0.0, -2.0, -INF, -1.0])
    upper = np.array([INF, 0.5, INF, 0.0, INF, 1.0])
    weights, change = rng.random(25), np.array([1.0, 1, 1, 1, 0, 2])
    for matrix in (A, sp.csr_array(A)):
        problem = BoundedLeastSquares(
            matrix, b, lower=lower, upper=upper, weights=weights, ridge=0.3
        )
        path = trace(problem, {"l1": change}, 20.0, 0.0).require_solved()
        for theta in (15.0, 5.0, 1.0, 0.1, 0.0):
            answer = solve(problem.with_vectors(l1=theta * change)).require_solved()
            assert np.abs(path.at(theta).x - answer.x).max() <= 1e-6
    assert set(np.unique(path.pieces[0].case)) <= {-1, 0, 1, 2}


# --- words ----------------------------------------------------------------------------------------------------


TWO, FIT = LCP(np.eye(2), [1, 1]), BoundedLeastSquares([[1.0]], [1])
HELD = BoundedLeastSquares([[1.0]], [1], lower=-1, l1=1)
BENT = QuadraticProgram([[-1]], [1], lower=0, upper=1)


@refusals(r"""
trace(TWO, {"M": 1}, 0, 1) → InvalidOption: not M: the solution is not piecewise affine in M
trace(TWO, {"Q": 1}, 0, 1) → InvalidOption: did you mean 'q'
trace(TWO, {}, 0, 1) → InvalidOption: along must name data
trace(TWO, {"q": 1}, 0, np.inf) → InvalidOption: stop must be a finite number, got inf
trace(TWO, {"upper": [1, 0]}, 0, 1) → InvalidOption: upper\[0\] is inf and cannot move
trace(QuadraticProgram([[1]], [1]), {"P": 1}, 0, 1) → InvalidOption: divide the objective by it
trace(BENT, {"c": 1}, 0, 1) → UnsupportedModel: not convex
trace(FIT, {"l1": 1}, 1, -1) → InvalidOption: l1\[0\] = -1.0
trace(HELD, {"lower": 1}, 0, 2) → UnsuitableProblem: changes its sign
trace([1], {"q": 1}, 0, 1) → InvalidOption: trace needs an LCP, .* BoundedLeastSquares, got list
""")
def test_what_cannot_be_traced_is_refused_in_words(call, words):
    """Each error contains the argument and the remedy."""
    assert_refused(call, words, globals())


def test_a_path_is_shown_in_words_tables_and_pictures():
    """explain, repr, to_dataframe and plot show what was traced."""
    pytest.importorskip("matplotlib").use("agg")
    path = trace(LCP([[2, 1], [1, 2]], [-5, 1]), {"q": [0, -1]}, 0, 6)
    assert repr(path).startswith("Path(SOLVED, 2 pieces, 0 to 6")
    assert "breakpoints: 3.5" in path.explain()
    assert len(path.plot().figure.axes) == 1
    program = trace(QuadraticProgram(np.eye(2), [0, 0], lower=0), {"c": [-1, 1]}, 1, -1)
    assert len(program.plot().figure.axes) == 1


# --- rounding, scaling and crossing bounds --------------------------------------------------------------------


def short_lcp(seed: int) -> tuple[LCP, np.ndarray] | None:
    """Return a strictly monotone LCP and a direction of q, or None."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    B, K = (np.round(rng.standard_normal((n, n)), 1) for _ in range(2))
    M = np.round(B @ B.T + 0.5 * np.eye(n) + K - K.T, 1)
    q, dq = (np.round(3.0 * rng.standard_normal(n), 1) for _ in range(2))
    return (LCP(M, q), dq) if np.linalg.eigvalsh(M + M.T)[0] > 0.0 else None


@pytest.mark.full
def test_terms_that_cancel_at_a_breakpoint_stall_no_path():
    """A path is right if z and w both vanish up to rounding; some once ended STALLED."""
    path = trace(LCP([[5.0]], [-1.0]), {"q": [-3.0]}, 1.5, -1.0).require_solved()
    assert path.at(path.breakpoints[1]).is_solved
    assert all(path.at(theta).is_solved for theta in path.breakpoints)
    for seed in range(150):
        if (stated := short_lcp(seed)) is not None:
            trace(stated[0], {"q": stated[1]}, 1.5, -1.0).require_solved()


@pytest.mark.quick(1)
@pytest.mark.parametrize("share", [1e-3, 1e-5, 1e-7])
def test_a_piece_that_is_wrong_is_not_solved(share):
    """A segment that is shifted, turned or extended a little is not SOLVED, even near zeros."""
    rng, refused, planted = np.random.default_rng(1), 0, 0
    for seed in range(60):
        if (stated := short_lcp(seed)) is None:
            continue
        path = trace(stated[0], {"q": stated[1]}, 1.5, -1.0).require_solved()
        k = int(rng.integers(len(path)))
        piece = path.pieces[k]
        size = share * max(1.0, np.abs(piece.z0).max(), np.abs(piece.z1).max())
        row = int(rng.integers(piece.z0.size))
        moved = np.where(np.arange(piece.z0.size) == row, size, 0.0)
        for change in (
            {"z0": piece.z0 + moved},
            {"z1": piece.z1 + moved},
            {"end": piece.end - share * 2.5},
        )[: 3 if share > 1e-6 else 2]:  # segments are checked 1e-6 of their length inside
            wrong = dataclasses.replace(piece, last=None, **change)
            ends = (theta for theta in (wrong.begin, wrong.end) if theta >= path.stop)
            off = (path.at(theta, wrong).x - path.at(theta).x for theta in ends)
            if max(np.abs(one).max() for one in off) <= 2e-8:
                continue  # within the tolerance, as a point on its bound is whichever way it is drawn
            pieces = [*path.pieces[:k], wrong, *path.pieces[k + 1 :]]
            made = Path(path.line)
            made.pieces, made.reached = pieces, path.reached
            planted, refused = planted + 1, refused + (not made.is_solved)
    assert planted > 40  # a shift off a bound changes nothing
    assert refused == planted


def test_solved_is_the_status_of_the_whole_way_only():
    """A path that did not reach stop is not SOLVED, and the explanation reports where it ended."""
    path = trace(LCP([[2, 1], [1, 2]], [-5, 1]), {"q": [0, -1]}, 0, 6)
    cut = Path(path.line)
    cut.pieces, cut.reached = path.pieces[:1], 3.5
    assert cut.status is Status.STALLED
    assert "ends at 3.5, before 6" in cut.explain()


CROSSING = [
    (QuadraticProgram([[1.0]], [-9.0], lower=0.0, upper=1.0), {"upper": [1.0]}),
    (LCP([[1.0]], [-9.0], lower=0.0, upper=1.0), {"upper": [1.0]}),
    (LCP([[1.0]], [-9.0], lower=0.0, upper=1.0), {"upper": [0.3], "lower": [-0.7]}),
    (BoundedLeastSquares([[1.0]], [9.0], lower=0.0, upper=1.0), {"upper": [1.0]}),
]


@pytest.mark.parametrize(("problem", "along"), CROSSING)
def test_a_path_ends_where_bounds_cross(problem, along):
    """Up to where bounds meet there is a path, beyond it a proof; from beyond there is none."""
    path = trace(problem, along, 0.0, -2.0)
    assert path.status is Status.INFEASIBLE
    assert path.reached == pytest.approx(-1.0, abs=1e-15)
    assert path.at(path.reached).is_solved
    assert path.at(-0.5).x == pytest.approx([1.0 - 0.5 * along["upper"][0]])
    assert "lower[0] exceeds upper[0]" in path.explain()
    beyond = trace(problem, along, -1.5, -2.0)
    assert beyond.status is Status.INFEASIBLE
    assert not beyond.pieces


@pytest.mark.parametrize("size", [1.0, 1e7, 1e9, 1e12])
def test_units_of_cost_and_of_columns_end_no_path(size):
    """Pivots are scaled by rows and columns: paths exist for costs and columns of any size."""
    rng = np.random.default_rng(0)
    B = rng.standard_normal((7, 7))
    units = np.where(np.arange(7) % 2, size, 1.0)
    M, q, dq = B @ B.T / 7 + np.eye(7), *(3.0 * rng.standard_normal((2, 7)))
    rows = {
        "G": rng.standard_normal((3, 7)),
        "h": np.ones(3),
        "A": np.ones((1, 7)),
        "b": [1.0],
        "lower": 0,
    }
    trace(
        QuadraticProgram(size * np.eye(2), [0, 0], A=[[1, 1]], b=[1]), {"b": 1}, 0, 2
    ).require_solved()
    trace(QuadraticProgram(size * M, size * q, **rows), {"c": size * dq}, 0, 1).require_solved()
    path = trace(
        LCP(M * np.outer(units, units), q * units), {"q": dq * units}, -1, 1
    ).require_solved()
    plain = trace(LCP(M, q), {"q": dq}, -1, 1).require_solved()
    assert path.breakpoints == pytest.approx(plain.breakpoints, abs=1e-9)
    assert np.allclose(path.x([-0.3, 0.6]) * units, plain.x([-0.3, 0.6]), rtol=0, atol=1e-9)
    squares = BoundedLeastSquares(
        rng.standard_normal((9, 7)) * units, rng.standard_normal(9), lower=-INF
    )
    trace(squares, {"l1": units}, 5, 0.01).require_solved()
    trace(
        squares.with_vectors(lower=np.zeros(7)), {"b": rng.standard_normal(9)}, -1, 1
    ).require_solved()


def test_beyond_a_singular_breakpoint_infeasibility_is_told():
    """Four unknowns, four rows and an equation along h: INFEASIBLE beyond −4/3, a path before."""
    program = QuadraticProgram(
        [[3, 2, 2, -1], [2, 3, 2, -1], [2, 2, 5, 0], [-1, -1, 0, 3]],
        [0, 2, 0, -3],
        [[1, 1, 1, 1], [-1, 1, -1, -1], [0, 0, -1, 0], [-1, -1, 0, 1]],
        [2, 2, 1, 1],
        [[0, 1, 0, 1]],
        [0],
        lower=-2,
        upper=2,
    )
    path = trace(program, {"h": [2, 0, 0, 2]}, 4.0, -3.0)
    assert path.status is Status.INFEASIBLE
    assert path.reached == pytest.approx(-4 / 3, abs=1e-6)
    assert path.pieces[-1].end == path.reached


def test_a_path_without_unknowns_is_solved():
    """N = 0 has the empty solution for every θ."""
    empty = trace(LCP(np.zeros((0, 0)), []), {"q": []}, 0.0, 1.0).require_solved()
    assert empty.x([0.0, 0.5]).shape == (2, 0)
    program = QuadraticProgram(np.zeros((0, 0)), [])
    assert trace(program, {"c": []}, 0.0, 1.0).is_solved


def test_an_unknown_without_a_column_stays_at_its_start():
    """A column of zeros lets x₁ ≤ ∞ be anything; the path keeps the finite value of its start."""
    fit = BoundedLeastSquares([[1.0, 0.0]], [1.0], lower=[0.0, -INF])
    path = trace(fit, {"b": [1.0]}, -2.0, 2.0)
    assert path.status is Status.SOLVED
    assert path.x([1.0, -1.5]).tolist() == [[2.0, 0.0], [0.0, 0.0]]


def test_a_point_on_a_moving_bound_is_on_it():
    """An obstacle that rises below a rod, and bounds of P-matrices: no bound is missed by a rounding error."""
    problem = LCP([[1.0, 0], [-3, 10]], [3.0, 5], upper=[np.inf, 3])
    move = np.array([-0.16, -0.97])
    path = trace(problem, {"q": [-2.0, 0], "lower": move}, 0, 1).require_solved()
    assert path.at(0.6).x[0] == 0.6 * move[0]
    n, rng = 30, np.random.default_rng(0)
    rod, s = (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)) * n**2, np.linspace(0, 1, n)
    for _ in range(10):
        bump = np.exp(-50 * (s - rng.random()) ** 2)
        trace(
            LCP(rod, np.full(n, 6.0), lower=np.full(n, -1.0)), {"lower": bump}, 0, 1
        ).require_solved()
    for _ in range(20):
        A, B = rng.normal(size=(2, 5, 5))
        moved = {"lower": rng.normal(size=5), "q": rng.normal(size=5)}
        found = trace(LCP(A @ A.T + B - B.T, 3 * rng.normal(size=5)), moved, 0, 1).require_solved()
        for theta in rng.random(2):
            np.testing.assert_allclose(
                found.at(theta).x, solve(found.at(theta).problem).x, atol=1e-7
            )


@pytest.mark.parametrize(
    "build",
    [
        lambda c, u: LCP([[0.0]], c, lower=[-1.0], upper=u),
        lambda c, u: QuadraticProgram(None, c, lower=-1.0, upper=u),
    ],
)
def test_an_unknown_without_curvature_begins_at_the_bound_that_its_cost_pushes_to(build):
    """Also if it is the upper bound; where the cost changes its sign a line of solutions connects the bounds."""
    name = "q" if isinstance(build([1.0], 3.0), LCP) else "c"
    path = trace(build([-5.0], 3.0), {name: [0.1]}, 0, 2).require_solved()
    assert path.at(1.0).x.tolist() == [3.0]
    turned = trace(build([-1.0], 3.0), {name: [1.0]}, 0, 2).require_solved()
    assert (turned.at(0.5).x[0], turned.at(1.5).x[0]) == (3.0, -1.0)
    assert turned.segments == pytest.approx([1.0])


def test_a_path_goes_through_data_that_are_0():
    """With b = 0 or q = 0 on the way all rows change at once; x before it has as many digits as b."""
    path = trace(BoundedLeastSquares([[1.0]], [1.0], lower=0), {"b": [1.0]}, 2, -2).require_solved()
    assert path.at(-0.999).x[0] == pytest.approx(1e-3, rel=1e-12)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        fit = BoundedLeastSquares(rng.normal(size=(4, 4)), np.zeros(4), lower=-np.inf)
        exact = trace(fit, {"b": rng.normal(size=4)}, 2, -2).require_solved()
        for theta in (1e-3, 1e-6):
            assert exact.at(theta).status is Status.SOLVED
    for seed in (32, 39, 86, 1, 2):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 7))
        A = rng.normal(size=(n, n))
        problem = LCP(A @ A.T + 0.1 * np.eye(n), np.zeros(n), upper=2.0)
        trace(problem, {"q": rng.normal(size=n)}, -2, 2).require_solved()
