"""The parts that verdicts on matrices are made of, each against rational arithmetic or its definition."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from exact import determinant, principal_minors
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_plugin import LCP
from lcp_plugin.core.matrix.matrix import Matrix
from lcp_plugin.core.matrix.symmetry import ROUNDED, is_symmetric_to_rounding, mismatch
from lcp_plugin.core.rounding import lower_end, upper_end
from lcp_plugin.proofs.exact.linear_systems import (
    has_nonnegative_pivots,
    has_positive_minors,
    has_positive_pivots,
)
from lcp_plugin.proofs.verdicts import analyze, h_matrix, h_verdict
from lcp_plugin.proofs.verdicts.h_matrix import is_nonpositive, positive_margin
from lcp_plugin.proofs.verdicts.p_matrix import is_p_matrix_by_recursion, nonpositive_pair
from lcp_plugin.systems.comparison_sums import comparison_product, exact_comparison_row
from lcp_plugin.systems.definiteness import (
    is_positive_definite,
    is_semidefinite_to_rounding,
    symmetric_part,
)
from lcp_plugin.systems.graph import row_excess_signs

# --- Small matrices in rational arithmetic ------------------------------------------------------------------


@st.composite
def small_matrices(draw: st.DrawFn) -> list[list[Fraction]]:
    """Square matrices of small integers, half of them symmetric, with a diagonal that is often not negative."""
    n = draw(st.integers(1, 4))
    rows = [[draw(st.integers(-2, 2)) for _ in range(n)] for _ in range(n)]
    for i in range(n):
        rows[i][i] = draw(st.integers(-1, 5))
    if draw(st.booleans()):
        rows = [[rows[min(i, j)][max(i, j)] for j in range(n)] for i in range(n)]
    return [[Fraction(entry) for entry in row] for row in rows]


@settings.get_profile("many")
@given(small_matrices())
def test_rational_verdicts_are_the_minors(A: list[list[Fraction]]) -> None:
    """P: every principal minor is positive. Pivots: the leading ones are. Semidefinite: no minor is negative."""
    n, minors = len(A), principal_minors(A)
    leading = [determinant([row[:k] for row in A[:k]]) for k in range(1, n + 1)]
    assert has_positive_minors(A) == all(minor > 0 for minor in minors)
    assert has_positive_pivots(A) == all(minor > 0 for minor in leading)
    if all(A[i][j] == A[j][i] for i in range(n) for j in range(n)):
        assert has_nonnegative_pivots(A) == all(minor >= 0 for minor in minors)


@settings.get_profile("many")
@given(small_matrices())
def test_verdicts_on_small_integers_are_the_minors(A: list[list[Fraction]]) -> None:
    """The report on small integers says what its minors say; a singular ⟨M⟩ may be undecided."""
    report = analyze([[float(entry) for entry in row] for row in A])
    symmetric = [[entry + A[j][i] for j, entry in enumerate(row)] for i, row in enumerate(A)]
    comparison = [
        [abs(e) if i == j else -abs(e) for j, e in enumerate(row)] for i, row in enumerate(A)
    ]
    assert report.is_p_matrix is all(minor > 0 for minor in principal_minors(A))
    assert report.is_positive_definite is all(minor > 0 for minor in principal_minors(symmetric))
    assert report.is_positive_semidefinite is all(
        minor >= 0 for minor in principal_minors(symmetric)
    )
    is_h = all(minor > 0 for minor in principal_minors(comparison))
    assert report.is_h_matrix in ((is_h,) if is_h or determinant(comparison) else (None, False))


# --- ⟨M⟩v > 0 and ⟨M⟩y ≤ 0 ----------------------------------------------------------------------------------


def hidden_sign(sign: int, other_rows: int) -> sp.csr_array:
    """A matrix whose first row sum of ⟨M⟩ has a sign that the compensated sum does not see; the others are plain."""
    rng = np.random.default_rng(0)
    others = np.ldexp(rng.random(60), rng.integers(-40, 1, 60)).tolist()
    diagonal = float(np.nextafter(sum(others), np.inf)) + 2.0**-40
    while (rest := Fraction(diagonal) - sum(map(Fraction, others))) > Fraction(2.0**-190):
        nearest = float(rest)
        others.append(nearest if Fraction(nearest) < rest else float(np.nextafter(nearest, 0.0)))
    if sign <= 0:
        others.append(float(rest) if sign == 0 else float(np.nextafter(float(rest), np.inf)))
    M = sp.lil_array(sp.eye_array(len(others) + 1))
    M[1:, 0] = 1.0 - 0.5 * other_rows
    M[0, 0], M[0, 1:] = diagonal, others
    return sp.csr_array(M)


@pytest.mark.parametrize("sign", [-1, 0, 1])
def test_signs_that_the_sums_hide_are_decided_exactly(
    sign: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the compensated sum of a row leaves its sign open, a proof asks rational arithmetic, for some rows only."""
    M = hidden_sign(sign, 1)
    ones = np.ones(M.shape[0])
    value, radius = comparison_product(M, ones)
    exact = exact_comparison_row(M, ones, 0)
    assert (exact > 0) - (exact < 0) == sign
    assert lower_end(value, radius)[0] < 0.0 < upper_end(value, radius)[0]
    assert row_excess_signs(Matrix(M)).tolist() == [sign] + [1] * (ones.size - 1)
    margin = positive_margin(M, ones)
    assert (margin is not None) == (sign > 0)
    assert margin is None or 0 < Fraction(margin[0]) <= exact
    assert not is_nonpositive(M, ones)
    for other_rows in (0, -1):
        assert is_nonpositive(hidden_sign(sign, other_rows), ones) == (sign <= 0)
        assert positive_margin(hidden_sign(sign, other_rows), ones) is None
    monkeypatch.setattr(h_matrix, "EXACT_ROWS", 0)
    assert positive_margin(M, ones) is None
    assert not is_nonpositive(hidden_sign(sign, 0), ones)


@pytest.mark.parametrize("v", [[1.0, 0.0], [1.0, -1.0], [1.0, np.inf], [1.0, np.nan]])
def test_no_proof_from_a_vector_that_is_none(v: list[float]) -> None:
    """A proof needs v positive and finite; or y finite, not negative and not zero."""
    assert positive_margin(sp.csr_array(np.eye(2)), np.array(v)) is None
    assert is_nonpositive(sp.csr_array([[0.0, 1.0], [1.0, 0.0]]), np.array(v)) == (v[1] == 0.0)
    assert not is_nonpositive(sp.csr_array([[0.0, 1.0], [1.0, 0.0]]), np.zeros(2))


@pytest.mark.parametrize("n", [3, 12])
@pytest.mark.parametrize("decades", [0.0, 2.0])
@pytest.mark.parametrize("radius", [0.3, 0.999, 1.001, 3.0])
def test_the_verdict_is_on_the_side_of_the_spectral_radius(
    n: int, decades: float, radius: float
) -> None:
    """M is an H-matrix exactly where ρ(D⁻¹|B|) < 1."""
    rng = np.random.default_rng(n)
    B = rng.uniform(0.5, 1.0, (n, n))
    np.fill_diagonal(B, 0.0)
    D = 10.0 ** rng.uniform(-decades, decades, n)
    M = np.diag(D) + radius / max(abs(np.linalg.eigvals(B / D[:, None]))) * B
    verdict = h_verdict(LCP(M, np.zeros(n)).matrix)
    assert verdict.is_h is (radius < 1.0)
    if abs(radius - 1.0) > 0.1 and not decades:
        assert "= 1: " in verdict.evidence


# --- Definiteness -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("build", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_symmetric_part_of_the_smallest_and_largest_entries(build: type) -> None:
    """Nothing is lost below 2⁻¹⁰²² and nothing overflows: a symmetric matrix is its own symmetric part."""
    for entry in (5e-324, 1.5e-323, 1.7e308):
        M = build([[4.0, entry], [entry, 4.0]])
        part = symmetric_part(M)
        np.testing.assert_array_equal(
            part.toarray() if sp.issparse(part) else part, [[4.0, entry], [entry, 4.0]]
        )


@pytest.mark.parametrize("eigenvalue", [1e-9, 0.0, -1e-9])
@pytest.mark.parametrize("build", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_definite_beyond_rounding_in_any_unit(eigenvalue: float, build: type) -> None:
    """With n = 30 the sign of the least eigenvalue ±1e-9 is proven, of ±0 never claimed, in any unit of the rows."""
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.standard_normal((30, 30)))[0]
    values = np.linspace(1.0, 2.0, 30)
    values[0] = eigenvalue
    unit = np.exp2(rng.integers(-60, 60, 30))
    P = unit[:, None] * (Q * values @ Q.T) * unit
    P = build(np.tril(P) + np.tril(P, -1).T)
    assert is_positive_definite(P) is {1e-9: True, 0.0: None, -1e-9: False}[eigenvalue]


@pytest.mark.parametrize("build", [np.array, sp.csr_array], ids=["dense", "sparse"])
@pytest.mark.parametrize(
    ("share", "expected"), [(-2.0, False), (-0.5, None), (0.5, None), (2.0, True)]
)
def test_definiteness_is_claimed_beyond_the_margin_only(
    share: float, expected: bool | None, build: type
) -> None:
    """With n = 30 and a unit diagonal an eigenvalue is told from 0 where it exceeds n (n + 4) 2⁻⁵², not before."""
    n = 30
    ones = np.ones((n, n)) / n
    P = np.eye(n) - ones + share * n * (n + 4) * 2.0**-52 * ones
    assert is_positive_definite(build(np.tril(P) + np.tril(P, -1).T)) is expected


@pytest.mark.parametrize("build", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_a_row_of_zeros_is_semidefinite(build: type) -> None:
    """A zero on the diagonal has to have nothing beside it, and then does not count."""
    assert (
        is_semidefinite_to_rounding(build([[0.0, 0.0, 0.0], [0.0, 4.0, 2.0], [0.0, 2.0, 1.0]]))
        is True
    )
    assert (
        is_semidefinite_to_rounding(build([[0.0, 0.0, 0.0], [0.0, 4.0, 2.1], [0.0, 2.1, 1.0]]))
        is False
    )
    assert (
        is_semidefinite_to_rounding(build([[0.0, 1e-9, 0.0], [1e-9, 4.0, 2.0], [0.0, 2.0, 1.0]]))
        is False
    )


def test_dominance_decides_what_is_too_large_for_a_factor() -> None:
    """A large matrix with a dominant symmetric part is definite though nothing can be factorized."""
    rng = np.random.default_rng(0)
    n = 20_000
    where = rng.integers(n, size=8 * n), rng.integers(n, size=8 * n)
    M = sp.coo_array((rng.uniform(-1, 1, 8 * n), where), shape=(n, n)).tocsr()
    report = analyze(sp.csr_array(M + 16.0 * sp.eye_array(n)))
    assert report.is_positive_definite is True
    assert report.evidence["is_positive_definite"].startswith("the symmetric part is dominant")


def test_diagonals_near_the_smallest_doubles_are_undecided() -> None:
    """Where rounding of the symmetric part is not small beside the diagonal, nothing is claimed of large matrices."""
    rng = np.random.default_rng(0)
    skew = rng.standard_normal((12, 12))
    S = np.eye(12) + 0.5 * np.ones((12, 12)) + skew - skew.T
    assert analyze(S).is_positive_definite is True
    tiny = analyze(np.ldexp(S, -1040))
    assert tiny.is_positive_definite is tiny.is_positive_semidefinite is None
    assert "ends of the range" in tiny.evidence["is_positive_semidefinite"]


# --- Symmetry, structure, pairs, words ----------------------------------------------------------------------


@pytest.mark.parametrize(("i", "j"), [(0, 1), (3, 290), (290, 3), (299, 270), (255, 256)])
def test_symmetry_to_rounding_is_its_definition(i: int, j: int) -> None:
    """|m_ij − m_ji| against 1e-13 √(size_i size_j), dense by tiles and sparse, in a small and a large unit."""
    rng = np.random.default_rng(0)
    M = rng.standard_normal((300, 300))
    M = M + M.T
    unit = np.ones(300)
    unit[j] = 1e6
    M = unit[:, None] * M * unit
    np.fill_diagonal(M, unit**2)
    for factor, expected in ((0.5, True), (2.0, False)):
        other = M.copy()
        other[i, j] = M[i, j] + factor * ROUNDED * unit[i] * unit[j]
        assert is_symmetric_to_rounding(other) is expected
        assert is_symmetric_to_rounding(sp.csr_array(other)) is expected
        assert is_symmetric_to_rounding(other, unit**2 * 1e3)
        distance, where = mismatch(sp.csr_array(other), unit**2, ROUNDED)
        assert distance == abs(other[i, j] - other[j, i])
        assert where is None if expected else set(where) == {i, j}
    assert mismatch(sp.csr_array(M), unit**2, ROUNDED) == (0.0, None)


@settings.get_profile("many")
@given(st.lists(st.integers(-3, 3), min_size=9, max_size=9))
def test_pairs_are_the_two_by_two_minors(entries: list[int]) -> None:
    """With a diagonal 1, 2, 4 a pair is named exactly where a minor of two rows is not positive."""
    A = np.array(entries, dtype=float).reshape(3, 3)
    np.fill_diagonal(A, [1.0, 2.0, 4.0])
    bad = {(i, j) for i, j in ((0, 1), (0, 2), (1, 2)) if A[i, i] * A[j, j] <= A[i, j] * A[j, i]}
    found = nonpositive_pair(sp.csr_array(A))
    assert found in bad if bad else found is None


@pytest.mark.parametrize(
    ("entry", "is_p"),
    [(4.0, False), (np.nextafter(4.0, 0.0), True), (np.nextafter(4.0, 5.0), False)],
)
def test_minors_that_rounding_hides_are_settled_in_integers(entry: float, is_p: bool) -> None:
    """Among 14 rows a minor that vanishes, or misses that by one unit in the last place, is decided."""
    skew = np.triu(np.random.default_rng(2).integers(-3, 4, (14, 14)), 1).astype(float)
    M = 4.0 * np.eye(14) + skew - skew.T
    M[:2, 2:], M[0, 1], M[1, 0] = 0.0, 4.0, entry
    assert is_p_matrix_by_recursion(sp.csr_array(M)) is is_p


def test_evidence_names_the_row() -> None:
    """The first row that fails is named, with = or < as it fails."""
    equal = analyze([[3.0, 1.0, 1.0], [1.0, 3.0, 2.0], [1.0, 1.0, 2.0]])
    assert equal.evidence["is_strictly_dominant"] == "|m_ii| = Σ|m_ij| on row 1"
    less = analyze([[3.0, 2.0, 1.0], [1.0, 3.0, 2.0], [1.0, 2.0, 2.0]])
    assert less.row_excess_signs.tolist() == [0, 0, -1]
    assert less.evidence["is_strictly_dominant"] == "|m_ii| = Σ|m_ij| on row 0"
    assert (
        analyze([[1.0, 2.0], [0.0, 1.0]]).evidence["is_strictly_dominant"]
        == "|m_ii| < Σ|m_ij| on row 0"
    )
    assert analyze(np.diag([0.0, 1.0, -2.0])).zero_diagonal.tolist() == [0]
    assert analyze(np.diag([0.0, 1.0, -2.0])).negative_diagonal.tolist() == [2]


# --- Equilibration ------------------------------------------------------------------------------------------


def test_noise_of_an_assembly_is_symmetric_up_to_rounding() -> None:
    """1e-7 that stands on one side only, in rows of 1e11, is told beside the rows; a triangle is no noise."""
    stiffness = [[1e11, -5e10, 1e-7], [-5e10, 1e11, 0.0], [-2e-7, 0.0, 1e11]]
    assert analyze(np.array(stiffness)).evidence["is_symmetric"] == (
        "symmetric up to rounding: its largest asymmetry relative to the rows is 3e-18"
    )
    assert analyze(np.array([[2.0, 1.0], [0.0, 2.0]])).evidence["is_symmetric"] == (
        "asymmetry 1 relative to entries, 0.5 to rows"
    )
