"""The strategies: drawn problems have their documented properties exactly, and shrink well."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import Phase, find, given, settings
from hypothesis import strategies as st
from inputs.drawn_scaling import nearly_singular, scaled_matrices, scaled_solved, skewed, strict
from oracles.exact import exact_rows, has_positive_pivots, principal_minors
from oracles.truth import ExactData
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, InvalidOption, InvalidProblem, analyze
from lcp_plugin.strategies import (
    assert_solves,
    convex_qps,
    h_plus_matrices,
    infeasible_lcps,
    p_matrices,
    positive_definite_matrices,
    positive_semidefinite_matrices,
    solved_lcps,
    strictly_dominant_matrices,
)

FIRST = settings(max_examples=5, phases=[Phase.generate])

SOLVED = {
    "default": solved_lcps(),
    "bounds": solved_lcps(bounds=True),
    "strict": strict(solved_lcps(bounds=True)),
    "sparse": solved_lcps(h_plus_matrices(st.integers(0, 6)).map(sp.csr_array)),
    "huge slacks": solved_lcps(huge_slacks=True),
    "in units": scaled_solved(solved_lcps(bounds=True), 60, 60),
    "nearly singular": solved_lcps(nearly_singular(2.0**-30), bounds=True),
}


def is_h_plus(matrix: object) -> bool:
    """A Z-matrix is a nonsingular M-matrix exactly if elimination without exchanges has positive pivots."""
    rows = exact_rows(matrix)
    comparison = [
        [value if i == j else -abs(value) for j, value in enumerate(row)]
        for i, row in enumerate(rows)
    ]
    return has_positive_pivots(comparison)


def is_positive_definite(matrix: object) -> bool:
    """Symmetric, and positive pivots in LDLᵀ."""
    rows = exact_rows(matrix)
    return rows == [list(column) for column in zip(*rows, strict=True)] and has_positive_pivots(
        rows
    )


# --- What is drawn is what is promised --------------------------------------------------------------------


@pytest.mark.parametrize("name", SOLVED)
def test_solved_lcps_are_solved(name):
    """The drawn z is exactly within the bounds and complementary, for the stored data."""

    @given(SOLVED[name])
    def check(drawn):
        problem, z = drawn
        assert ExactData(problem).is_solution(z)
        assert [Fraction(value) for value in np.array(z, dtype=float).tolist()] == list(z)
        assert problem.is_plain or name not in ("default", "sparse", "huge slacks")

    check()


# --- The other classes, each with an oracle in fractions ----------------------------------------------------


def doubled_symmetric_part(matrix: object) -> list[list[Fraction]]:
    rows = exact_rows(matrix)
    return [[rows[i][j] + rows[j][i] for j in range(len(rows))] for i in range(len(rows))]


def is_dominant(matrix: object) -> bool:
    return all(2 * abs(row[i]) > sum(map(abs, row)) for i, row in enumerate(exact_rows(matrix)))


def is_definite(matrix: object) -> bool:
    return has_positive_pivots(doubled_symmetric_part(matrix))


def is_semidefinite(matrix: object) -> bool:
    return all(minor >= 0 for minor in principal_minors(doubled_symmetric_part(matrix)))


def is_p(matrix: object) -> bool:
    return all(minor > 0 for minor in principal_minors(exact_rows(matrix)))


def sparse(matrices: Any, **options: float) -> st.SearchStrategy[Any]:
    """Return matrices of up to six rows, also without any, in sparse storage."""
    return matrices(st.integers(0, 6), **options).map(sp.csr_array)


FEW = st.integers(1, 5)
# strategy, oracle, verdict of analyze
CLASSES = {
    "H₊": (h_plus_matrices(), is_h_plus, "is_h_plus"),
    "H₊, half empty": (h_plus_matrices(density=0.5), is_h_plus, "is_h_plus"),
    "H₊, sparse": (sparse(h_plus_matrices, density=0.3), is_h_plus, "is_h_plus"),
    "H₊, diagonal": (h_plus_matrices(density=0.0), is_h_plus, "is_h_plus"),
    "symmetric": (positive_definite_matrices(), is_positive_definite, "is_positive_definite"),
    "symmetric, half empty": (
        positive_definite_matrices(density=0.5),
        is_positive_definite,
        "is_positive_definite",
    ),
    "symmetric, sparse": (
        sparse(positive_definite_matrices, density=0.3),
        is_positive_definite,
        "is_positive_definite",
    ),
    "dominant": (strictly_dominant_matrices(FEW), is_dominant, "is_h_plus"),
    "nearly singular": (nearly_singular(), is_dominant, "is_strictly_dominant"),
    "definite": (skewed(positive_definite_matrices(FEW)), is_definite, "is_positive_definite"),
    "semidefinite": (
        positive_semidefinite_matrices(FEW),
        is_semidefinite,
        "is_positive_semidefinite",
    ),
    "p": (p_matrices(FEW), is_p, "is_p_matrix"),
    "p in units": (scaled_matrices(p_matrices(FEW), 9, 9), is_p, "is_p_matrix"),
}


@pytest.mark.parametrize("name", CLASSES)
def test_classes_hold_in_fractions(name):
    """Every matrix drawn is of its class in fractions, and `analyze` finds it."""
    strategy, oracle, verdict = CLASSES[name]

    @settings.get_profile("few")
    @given(strategy)
    def check(matrix):
        assert matrix.dtype == np.float64
        assert sp.issparse(matrix) == name.endswith("sparse")
        assert oracle(matrix)
        assert getattr(analyze(matrix), verdict) is True

    check()


INFEASIBLE = {"default": infeasible_lcps(), "bounds": infeasible_lcps(bounds=True)}


@pytest.mark.parametrize("name", INFEASIBLE)
def test_infeasible_lcps_have_a_proof(name):
    """The Farkas vector is exact."""

    @settings.get_profile("few")
    @given(INFEASIBLE[name])
    def check(drawn):
        problem, proof = drawn
        assert proof.verify()
        assert max(map(abs, proof.exact_y)) == 1
        if problem.is_plain:
            rows = exact_rows(problem.M)
            assert min(proof.exact_y) >= 0
            products = [
                sum(y * row[j] for y, row in zip(proof.exact_y, rows, strict=True))
                for j in range(problem.n)
            ]
            assert max(products) <= 0
            assert (
                sum(y * Fraction(q) for y, q in zip(proof.exact_y, problem.q.tolist(), strict=True))
                < 0
            )

    check()


def times(matrix: object, x: tuple[Fraction, ...]) -> list[Fraction]:
    return [
        sum((a * b for a, b in zip(row, x, strict=True)), Fraction(0)) for row in exact_rows(matrix)
    ]


def test_convex_qps_are_solved():
    """The answer is feasible, stationary and complementary in fractions, and the objective is its value."""

    @given(convex_qps() | convex_qps(bounds=False))
    def check(drawn):
        program, answer = drawn
        exact = [
            list(map(Fraction, values.tolist())) for values in (program.c, program.h, program.b)
        ]
        gradient, h, b = exact
        bent = times(program.P, answer.x)
        forces = [times(program.G.T, answer.inequality), times(program.A.T, answer.equality)]
        columns = zip(bent, gradient, *forces, answer.lower, answer.upper, strict=True)
        assert all(p + c + g + a - low + high == 0 for p, c, g, a, low, high in columns)
        gaps = [right - left for left, right in zip(times(program.G, answer.x), h, strict=True)]
        assert times(program.A, answer.x) == b
        assert min(*gaps, *answer.inequality, *answer.lower, *answer.upper, 0, 0) >= 0
        assert all(
            gap * multiplier == 0 for gap, multiplier in zip(gaps, answer.inequality, strict=True)
        )
        for x, low, high, at_low, at_high in zip(
            answer.x,
            program.lower.tolist(),
            program.upper.tolist(),
            answer.lower,
            answer.upper,
            strict=True,
        ):
            assert low <= x <= high
            assert at_low == 0 or x == low
            assert at_high == 0 or x == high
        value = sum(
            (x * (p / 2 + c) for x, p, c in zip(answer.x, bent, gradient, strict=True)), Fraction(0)
        )
        assert answer.objective == value

    check()


# --- The judge ----------------------------------------------------------------------------------------------


def verdict_on(solver: object, **options: object) -> str:
    with pytest.raises(AssertionError) as found:
        assert_solves(solver, max_examples=100, **options)
    return str(found.value)


def exact_diagonal(
    M: np.ndarray, q: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    return np.clip(-q / M.diagonal(), lower, upper)


@pytest.mark.full
@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda z: z * np.nan, "z must be finite"),
        (lambda z: np.append(z, 0.0), "z must be a vector of length 1, got shape"),
        (lambda z: z - 2.0, r"z\[0\] = -1 is beyond its bound 0"),
        (lambda z: z * 0.0, r"w\[0\] = -1 < 0 while z\[0\] = 0"),
        (lambda z: z + 0.5, r"w\[0\] = 0.5 while z\[0\] = 1.5 > 0"),
        (lambda z: None, "it gave up \\(returned None\\) on a problem that has a solution"),
        (lambda z: 1 / 0, "it gave up \\(raised ZeroDivisionError: division by zero\\)"),
    ],
)
def test_the_judge_names_what_is_wrong(spoil, complaint):
    """Each kind of wrong answer is named, on the 1 × 1 identity with q = −1, 0 or 1."""
    report = verdict_on(
        lambda *data: spoil(exact_diagonal(*data)), matrices=h_plus_matrices(density=0)
    )
    assert re.search(complaint, report), report
    assert re.search(r"problem = LCP\(\[\[1.0\]\], \[(-1|0|1).0\]\)", report), report


def test_the_judge_names_a_modified_input():
    """A solver that writes into q fails, although its z is right."""

    def writes_into_q(*data):
        z = exact_diagonal(*data)
        data[1][:] = 7.0
        return z

    report = verdict_on(writes_into_q, matrices=h_plus_matrices(density=0))
    assert "modified its input q" in report


def test_the_judge_measures_the_distance_where_the_residual_is_small():
    """A small residual does not hide a wrong z for a nearly singular matrix, unless allowed."""
    nearly = st.just(np.array([[1.0 + 2.0**-30, -1.0], [-1.0, 1.0]]))

    def careless(M, q, lower, upper):
        z = least_squares_point(M, q)
        return z + 1.0 if z.min() > 0 else z * 0.0

    def least_squares_point(M, q):
        return np.linalg.solve(M, -q)

    inactive = {"matrices": nearly, "tolerance": 10.0}
    assert "z is far from the exact answer" in verdict_on(careless, **inactive)
    assert assert_solves(careless, error_tolerance=np.inf, max_examples=30, **inactive) == 30


# --- Errors -----------------------------------------------------------------------------------------------


@refusals(r"""
h_plus_matrices(-1) → size must be an integer ≥ 0 or a strategy of such, got -1
h_plus_matrices(density=1.5) → density must lie in \[0, 1\], got 1.5
assert_solves(exact_diagonal, matrices=np.eye(2))
    → matrices must be a strategy such as p_matrices\(4\), got ndarray
assert_solves(exact_diagonal, max_examples=0) → max_examples must be an integer ≥ 1, got 0
assert_solves(exact_diagonal, tolerance=-1.0) → tolerance must be a number ≥ 0, got -1.0
assert_solves(np.eye(2)) → solver must be callable
""")
def test_wrong_options_are_refused_at_once(call, words):
    """An option out of range raises an error with the value and the range, before anything is drawn."""
    assert_refused(call, words, globals(), InvalidOption)


@pytest.mark.parametrize(
    "matrix",
    [np.array([[2.0**60, 1.0], [1.0, 2.0**60]]), np.full((1, 1), np.finfo(float).max)],
    ids=["wide", "huge"],
)
def test_matrices_that_make_q_round_are_refused(matrix):
    """If q = w − M z is not representable, an error is raised instead of a wrong problem."""
    with pytest.raises(InvalidProblem, match="not free of rounding in row 0"):
        find(solved_lcps(st.just(matrix)), lambda drawn: False, settings=FIRST)


@pytest.mark.full
def test_a_counterexample_can_be_copied():
    """The judge prints the call that makes the problem, bounds included if there are any."""
    with pytest.raises(AssertionError) as caught:
        assert_solves(lambda *data: data[1] + 9.0, matrices=h_plus_matrices(1), bounds=True)
    (call,) = re.findall(r"^problem = (LCP\(.*\))$", str(caught.value), re.M)
    problem = eval(call, {"LCP": LCP, "inf": np.inf})
    assert problem.n == 1
