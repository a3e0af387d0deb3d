"""The strategies: whatever they draw is, in exact arithmetic, what they promise, and it shrinks well."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import find, given, settings
from hypothesis import strategies as st

from lcp_plugin import LCP, strategies
from lcp_plugin.errors import InvalidOption, InvalidProblem
from lcp_plugin.strategies import h_plus_matrices, positive_definite_matrices, solved_lcps

STABLE = settings(deadline=None, derandomize=True, max_examples=60, database=None)
SEARCH = settings(deadline=None, derandomize=True, max_examples=2000, database=None)

H_PLUS = {
    "default": h_plus_matrices(),
    "half empty": h_plus_matrices(density=0.5),
    "wild scales": h_plus_matrices(row_scale=400, column_scale=400),
    "nearly singular": h_plus_matrices(margin=2.0**-30),
    "sparse": h_plus_matrices(st.integers(0, 6), density=0.3, dense=False),
    "diagonal": h_plus_matrices(density=0.0),
}
POSITIVE_DEFINITE = {
    "default": positive_definite_matrices(),
    "half empty": positive_definite_matrices(density=0.5),
    "wild scales": positive_definite_matrices(scale=400),
    "nearly singular": positive_definite_matrices(margin=2.0**-30),
    "sparse": positive_definite_matrices(st.integers(0, 6), density=0.3, dense=False),
}
SOLVED = {
    "default": solved_lcps(),
    "bounds": solved_lcps(bounds=True),
    "wild scales": solved_lcps(bounds=True, row_scale=400, column_scale=400),
    "nearly singular": solved_lcps(h_plus_matrices(margin=2.0**-30), bounds=True, column_scale=50),
    "sparse": solved_lcps(h_plus_matrices(st.integers(0, 6), dense=False), row_scale=50),
    "scaled matrices": solved_lcps(h_plus_matrices(row_scale=100) | positive_definite_matrices(scale=5)),
}


def exact_rows(matrix: object) -> list[list[Fraction]]:
    """The entries as exact numbers."""
    dense = matrix.toarray() if sp.issparse(matrix) else matrix
    return [[Fraction(value) for value in row] for row in dense.tolist()]


def pivots(rows: list[list[Fraction]]) -> list[Fraction]:
    """The pivots of Gaussian elimination without exchanges, up to the first that is not positive."""
    rows, found = [row.copy() for row in rows], []
    for k in range(len(rows)):
        found.append(rows[k][k])
        if found[-1] <= 0:
            break
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return found


def is_h_plus(matrix: object) -> bool:
    """A Z-matrix is a nonsingular M-matrix exactly if elimination without exchanges has positive pivots."""
    rows = exact_rows(matrix)
    comparison = [[value if i == j else -abs(value) for j, value in enumerate(row)] for i, row in enumerate(rows)]
    return all(pivot > 0 for pivot in pivots(comparison))


def is_positive_definite(matrix: object) -> bool:
    """Symmetric, and positive pivots in LDLᵀ."""
    rows = exact_rows(matrix)
    return rows == [list(column) for column in zip(*rows, strict=True)] and all(pivot > 0 for pivot in pivots(rows))


def exact_slack(problem: LCP, z: tuple[Fraction, ...]) -> list[Fraction]:
    """M z + q in exact arithmetic."""
    rows = exact_rows(problem.M)
    return [
        Fraction(q) + sum((m * x for m, x in zip(row, z, strict=True)), Fraction(0))
        for q, row in zip(problem.q.tolist(), rows, strict=True)
    ]


def kind(z: Fraction, w: Fraction, lower: float, upper: float) -> str:
    """The place of a row: between or at which bound, and the sign of its slack; "wrong" where it is no solution."""
    at_lower, at_upper = z == lower, z == upper
    if not lower <= z <= upper or (w > 0 and not at_lower) or (w < 0 and not at_upper):
        return "wrong"
    place = "fixed" if at_lower and at_upper else "lower" if at_lower else "upper" if at_upper else "between"
    if place == "between":
        place = {0: "free", 1: "half bounded", 2: "boxed"}[int(np.isfinite(lower)) + int(np.isfinite(upper))]
    return place if w == 0 else f"{place}, w {'>' if w > 0 else '<'} 0"


def kinds(problem: LCP, z: tuple[Fraction, ...]) -> list[str]:
    slack = exact_slack(problem, z)
    return [kind(*row) for row in zip(z, slack, problem.lower.tolist(), problem.upper.tolist(), strict=True)]


# --- What is drawn is what is promised --------------------------------------------------------------------


@pytest.mark.parametrize("name", H_PLUS)
def test_h_plus_matrices_are_h_plus(name: str) -> None:
    """In rational arithmetic the comparison matrix of every drawn matrix is a nonsingular M-matrix."""

    @STABLE
    @given(H_PLUS[name])
    def check(matrix: object) -> None:
        assert matrix.dtype == np.float64
        assert sp.issparse(matrix) == (name == "sparse")
        assert is_h_plus(matrix)

    check()


@pytest.mark.parametrize("name", POSITIVE_DEFINITE)
def test_positive_definite_matrices_are_positive_definite(name: str) -> None:
    """In rational arithmetic every drawn matrix is symmetric with positive pivots."""

    @STABLE
    @given(POSITIVE_DEFINITE[name])
    def check(matrix: object) -> None:
        assert matrix.dtype == np.float64
        assert sp.issparse(matrix) == (name == "sparse")
        assert is_positive_definite(matrix)

    check()


@pytest.mark.parametrize("name", SOLVED)
def test_solved_lcps_are_solved(name: str) -> None:
    """In rational arithmetic on the stored data the drawn z lies within the bounds and is complementary."""

    @STABLE
    @given(SOLVED[name])
    def check(drawn: tuple[LCP, tuple[Fraction, ...]]) -> None:
        problem, z = drawn
        assert "wrong" not in kinds(problem, z)
        assert [Fraction(value) for value in np.array(z, dtype=float).tolist()] == list(z)
        assert problem.is_plain or name not in ("default", "sparse", "scaled matrices")

    check()


def test_exact_checks_can_fail() -> None:
    """The oracles of this file refuse a matrix that is neither, and a point that is no solution."""
    matrix = np.array([[1.0, 2.0], [1.0, 1.0]])
    assert not is_h_plus(matrix)
    assert not is_positive_definite(matrix)
    assert not is_positive_definite(np.array([[1.0, 2.0], [2.0, 3.0]]))
    assert not is_h_plus(np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert kinds(LCP([[1.0]], [-1.0]), (Fraction(1, 2),)) == ["wrong"]
    assert kinds(LCP([[1.0]], [-1.0], upper=0.5), (Fraction(1, 2),)) == ["upper, w < 0"]


# --- Everything occurs ------------------------------------------------------------------------------------


def counted(strategy: st.SearchStrategy[tuple[LCP, tuple[Fraction, ...]]], examples: int = 150) -> Counter[str]:
    """How often each kind of row occurs in that many drawn problems."""
    counts: Counter[str] = Counter()

    @settings(STABLE, max_examples=examples)
    @given(strategy)
    def count(drawn: tuple[LCP, tuple[Fraction, ...]]) -> None:
        counts.update(kinds(*drawn))

    count()
    return counts


def test_active_inactive_and_degenerate_rows_occur() -> None:
    """Each of the three kinds makes up at least a sixth of the rows of plain problems."""
    counts = counted(solved_lcps())
    assert set(counts) == {"half bounded", "lower", "lower, w > 0"}
    assert min(counts.values()) > counts.total() / 6


def test_every_kind_of_bound_occurs() -> None:
    """Free rows, rows inside boxes and half lines, at each bound with w = 0 or not, and fixed rows all occur often."""
    counts = counted(solved_lcps(bounds=True))
    sides = ["lower", "lower, w > 0", "upper", "upper, w < 0", "fixed", "fixed, w > 0", "fixed, w < 0"]
    assert set(counts) == {"free", "half bounded", "boxed", *sides}
    assert min(counts.values()) > counts.total() / 100


def test_options_do_what_they_say() -> None:
    """Density thins out, scales spread, a small margin nearly makes singular, a size is obeyed."""
    nonzeros, spreads, slimmest = {0.25: [], 1.0: []}, [], []

    @STABLE
    @given(st.sampled_from(list(nonzeros)).flatmap(lambda p: st.tuples(st.just(p), h_plus_matrices(7, density=p))))
    def collect_density(drawn: tuple[float, np.ndarray]) -> None:
        density, matrix = drawn
        nonzeros[density].append(np.count_nonzero(matrix))

    @STABLE
    @given(h_plus_matrices(7, row_scale=30), h_plus_matrices(7, margin=2.0**-20))
    def collect(wild: np.ndarray, near: np.ndarray) -> None:
        assert wild.shape == near.shape == (7, 7)
        spreads.append(np.ptp(np.log2(wild.diagonal())))
        slimmest.append((2 * near.diagonal() - abs(near).sum(axis=1)).max())

    collect_density()
    collect()
    assert np.mean(nonzeros[0.25]) < 0.6 * np.mean(nonzeros[1.0])
    assert np.max(spreads) > 20
    assert np.max(slimmest) <= 9 * 2.0**-20


def test_positive_definite_matrices_leave_h_plus() -> None:
    """Most of the larger positive definite matrices are no H₊-matrices, so they test something else."""
    outside = []

    @STABLE
    @given(positive_definite_matrices(6))
    def collect(matrix: np.ndarray) -> None:
        outside.append(not is_h_plus(matrix))

    collect()
    assert np.mean(outside) > 0.5


# --- Shrinking --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["default", "wild scales", "nearly singular"])
def test_h_plus_matrices_shrink_to_the_identity(name: str) -> None:
    """The simplest matrix of any options is the identity: 1 × 1, or with the margin on its diagonal."""
    simplest = find(H_PLUS[name], lambda matrix: matrix.shape[0] > 0, settings=SEARCH)
    assert exact_rows(simplest) == [[Fraction(1, 2**30) if name == "nearly singular" else 1]]


@pytest.mark.parametrize("name", ["default", "sparse", "nearly singular"])
def test_positive_definite_matrices_shrink_to_the_identity(name: str) -> None:
    """The simplest matrix of any options is the identity: 1 × 1, or with the margin on its diagonal."""
    simplest = find(POSITIVE_DEFINITE[name], lambda matrix: matrix.shape[0] > 0, settings=SEARCH)
    assert exact_rows(simplest) == [[Fraction(1, 2**30) if name == "nearly singular" else 1]]


def test_counterexamples_are_small() -> None:
    """What is found for a claim that breaks at an off-diagonal entry or at a slack has only small integers."""
    matrix = find(
        h_plus_matrices(st.integers(1, 4), row_scale=20), lambda M: np.count_nonzero(M) > len(M), settings=SEARCH
    )
    assert sorted(abs(matrix).ravel().tolist()) == [0.0, 1.0, 1.0, 2.0]
    problem, z = find(solved_lcps(), lambda drawn: drawn[0].n == 2 and exact_slack(*drawn)[0] > 0, settings=SEARCH)
    assert np.array_equal(problem.M.toarray() if sp.issparse(problem.M) else problem.M, np.eye(2))
    assert exact_slack(problem, z)[0] == 1
    assert max(z) <= 1


# --- What cannot be drawn ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: h_plus_matrices(-1), "size must be a whole number ≥ 0 or a strategy of such, got -1"),
        (lambda: h_plus_matrices(2.0), "size must be a whole number ≥ 0 or a strategy of such, got 2.0"),
        (lambda: h_plus_matrices(True), "size must be a whole number ≥ 0 or a strategy of such, got True"),
        (lambda: h_plus_matrices(density=1.5), r"density must lie in \[0, 1\], got 1.5"),
        (lambda: h_plus_matrices(density=float("nan")), r"density must lie in \[0, 1\], got nan"),
        (lambda: h_plus_matrices(row_scale=401), "row_scale must be a whole number from 0 to 400, got 401"),
        (lambda: h_plus_matrices(column_scale=-1), "column_scale must be a whole number from 0 to 400, got -1"),
        (lambda: positive_definite_matrices(scale=1.0), "scale must be a whole number from 0 to 400, got 1.0"),
        (lambda: h_plus_matrices(margin=0.3), r"margin must be a power of two from 2\*\*-30 to 1, got 0.3"),
        (lambda: positive_definite_matrices(margin=0.0), r"margin must be a power of two from 2\*\*-30 to 1, got 0.0"),
        (lambda: solved_lcps(row_scale=True), "row_scale must be a whole number from 0 to 400, got True"),
    ],
)
def test_wrong_options_are_refused_at_once(build: object, message: str) -> None:
    """An option out of range is refused when the strategy is made, with the value and the range."""
    with pytest.raises(InvalidOption, match=message):
        build()


@pytest.mark.parametrize(
    "matrix", [np.array([[2.0**60, 1.0], [1.0, 2.0**60]]), np.full((1, 1), np.finfo(float).max)], ids=["wide", "huge"]
)
def test_matrices_that_make_q_round_are_refused(matrix: np.ndarray) -> None:
    """Where a double cannot hold q = w − M z the problem is refused, not drawn with a wrong answer."""
    with pytest.raises(InvalidProblem, match="not free of rounding in row 0"):
        find(solved_lcps(st.just(matrix)), lambda drawn: False, settings=SEARCH)


def test_nothing_is_drawn_in_vain() -> None:
    """Valid by construction: the module neither filters nor assumes."""
    source = Path(strategies.__file__).read_text(encoding="utf-8")
    assert ".filter(" not in source
    assert "assume" not in source
    assert "reject" not in source


def test_hypothesis_loads_with_the_strategies_only() -> None:
    """``import lcp_plugin`` leaves hypothesis alone; the first use of ``lcp_plugin.strategies`` loads it."""
    code = (
        "import sys, lcp_plugin\n"
        "before = 'hypothesis' in sys.modules\n"
        "lcp_plugin.strategies.h_plus_matrices()\n"
        "print(before, 'hypothesis' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "True"]
