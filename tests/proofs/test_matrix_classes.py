"""Verdicts on matrices are true, their proofs hold, and undecided verdicts are reported as such."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.exact import determinant, principal_minors

from lcp_plugin import (
    LCP,
    Certificate,
    UnsuitableMatrix,
    analyze,
    convergence_guarantee,
    error_bound,
)
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.proofs import verdicts
from lcp_plugin.systems import definiteness
from lcp_plugin.systems.definiteness import is_positive_definite, symmetric_part
from lcp_plugin.systems.factors import factor_fits, positive_factor


def with_radius(rng: np.random.Generator, n: int, radius: float) -> np.ndarray:
    """A full matrix with random signs and ρ(D⁻¹|B|) = radius up to some ulps."""
    B = rng.uniform(0.1, 1.0, (n, n))
    np.fill_diagonal(B, 0.0)
    v = 10.0 ** rng.uniform(-2, 2, n)
    return B * rng.choice([-1.0, 1.0], (n, n)) + np.diag(B @ v / (v * radius))


KNOWN = {
    # matrix: verdicts, T F U in the order Z M dominant H+ definite semidefinite P
    "identity": (np.eye(3), "TTTTTTT"),
    "strictly dominant": ([[3, 1], [-2, 3]], "FFTTTTT"),
    "M-matrix, not dominant": ([[1, -3], [-0.2, 1]], "TTFTFFT"),
    "singular M-matrix": ([[1, -1], [-1, 1]], "TFFFFTF"),
    "P but neither H nor definite": ([[1, -9], [1, 1]], "FFFFFFT"),
    "definite, not H": ([[1, 5], [-5, 1]], "FFFFTTT"),
    "negative diagonal": ([[-4, 1], [1, 4]], "FFTFFFF"),
    "zero diagonal, skew": ([[0, 1], [-1, 0]], "FFFFFTF"),
    "SPD, not H": ([[1, 0.6, 0.6], [0.6, 1, 0.6], [0.6, 0.6, 1]], "FFFFTTT"),
    "indefinite minor": ([[1, 2], [2, 1]], "FFFFFFF"),
    "lower triangular": ([[1, 0], [100, 1]], "FFFTFFT"),
    "P block over P block": ([[1, -3, 7], [3, 0.5, 9], [0, 0, 2]], "FFFFFFT"),
}
CLAIMS = (
    *("is_z_matrix", "is_m_matrix", "is_strictly_dominant", "is_h_plus"),
    *("is_positive_definite", "is_positive_semidefinite", "is_p_matrix"),
)


@pytest.mark.parametrize("sparse", [False, True], ids=["dense", "sparse"])
@pytest.mark.parametrize("name", KNOWN)
def test_textbook_matrices(name, sparse):
    """Matrices whose classes are known by hand get exactly those, each with evidence."""
    matrix, expected = KNOWN[name]
    report = analyze(sp.csr_array(np.array(matrix, dtype=float)) if sparse else matrix)
    found = "".join({True: "T", False: "F", None: "U"}[getattr(report, claim)] for claim in CLAIMS)
    assert found == expected
    assert all(report.evidence.values())


@pytest.mark.quick(1)
@pytest.mark.parametrize("n", [40, 600])
@pytest.mark.parametrize("distance", [1e-9, 1e-12])
def test_both_sides_of_singular(n, distance):
    """The correct side is proved for |1 − ρ| = 1e-9 and 1e-12, also under scaling by 1e±100."""
    rng = np.random.default_rng(n)
    for sign in (-1.0, 1.0):
        M = with_radius(rng, n, 1.0 + sign * distance)
        units = 10.0 ** rng.uniform(-100, 100, (n, 1)) * 10.0 ** rng.uniform(-100, 100, n)
        for matrix in (M, M * units):
            report = analyze(matrix)
            assert report.is_h_matrix == (sign < 0)
            assert (report.v is not None) == (sign < 0)


def test_definite_is_proved_only_by_a_factor_whose_asymmetry_is_measured(monkeypatch):
    """Of a sparse factorization with U ≠ D Lᵀ by more than the smallest eigenvalue, nothing is concluded."""
    matrix = five_point_matrix(30, 4.0)
    assert is_positive_definite(matrix) is True

    def skewed(part):
        if (factor := positive_factor(part)) is None:
            return None
        U = factor.superlu.U.copy()
        U.data[-2] += 0.5
        return replace(factor, superlu=SimpleNamespace(L=factor.superlu.L, U=U))

    monkeypatch.setattr(definiteness, "positive_factor", skewed)
    assert is_positive_definite(matrix) is None


def test_laplacian_is_certified_through_a_solve():
    """Dominant nowhere strictly inside: H₊, SPD and P with a margin that is positive on every row."""
    for m in (5, 30, 90):
        report = analyze(five_point_matrix(m, 4.0))
        assert report.is_h_plus
        assert report.is_positive_definite
        assert report.is_p_matrix
        assert not report.is_strictly_dominant
        assert report.margin.min() > 0.0
        exact = Fraction(4) * Fraction(report.v[0]) - Fraction(report.v[1]) - Fraction(report.v[m])
        assert exact >= Fraction(report.margin[0])


def test_beyond_singular_on_a_large_grid():
    """The five-point matrix minus more than its least eigenvalue is not an H-matrix, by proof."""
    m = 90
    smallest = 8.0 * np.sin(np.pi / (2 * (m + 1))) ** 2
    for factor, expected in ((0.999, True), (1.001, False)):
        report = analyze(five_point_matrix(m, 4.0) - factor * smallest * sp.eye_array(m * m))
        assert report.is_h_plus is expected
        assert report.is_positive_definite is expected
        assert (report.v is not None) == expected


def test_singular_laplacian_ties_are_exact():
    """Row sums of exactly 0 prove that the Neumann matrix is semidefinite, but not an H-matrix."""
    grid = five_point_matrix(60, 4.0)
    neumann = sp.csr_array(grid - sp.diags_array(grid @ np.ones(3600)))
    report = analyze(neumann)
    assert report.is_h_plus is False
    assert report.is_positive_semidefinite is True


@pytest.mark.full
def test_p_at_sixteen_rows():
    """A scaled definite matrix with n = 16 is a P-matrix, one with a bad minor of 3 rows is not."""
    rng = np.random.default_rng(2)
    M = rng.normal(size=(16, 16))
    M = (
        (M - M.T + 0.5 * np.eye(16))
        * 10.0 ** rng.uniform(-40, 40, (16, 1))
        * 10.0 ** rng.uniform(-40, 40, 16)
    )
    report = analyze(M)
    assert report.is_p_matrix is True
    assert report.evidence["is_p_matrix"].startswith("recursive")
    M = rng.normal(size=(16, 16)) / 9.0 + np.eye(16)
    M[7:10, 7:10] = [[1.0, -2.0, 0.0], [0.0, 1.0, -2.0], [-2.0, 0.0, 1.0]]
    report = analyze(M)
    assert verdicts.nonpositive_pair(report.matrix) is None
    assert report.is_p_matrix is False


def test_large_and_undecided_says_so():
    """If the number of minors explodes, the verdict is None and the evidence has the reason."""
    rng = np.random.default_rng(3)
    M = rng.normal(size=(30, 30))
    M = (M - M.T + 0.5 * np.eye(30)) * 10.0 ** rng.uniform(-2, 2, (30, 1))
    report = analyze(M)
    assert report.is_h_plus is False
    assert report.is_positive_definite is False
    assert report.is_p_matrix is None
    assert "the minors of 30 rows" in report.evidence["is_p_matrix"]


def test_definiteness_at_the_edge_is_undecided_or_exact():
    """A singular matrix is never called definite, nor semidefinite beyond n = 10."""
    rng = np.random.default_rng(5)
    factor = rng.integers(-4, 5, (30, 20)).astype(float)
    gram = factor @ factor.T
    gram[np.diag_indices(30)] += gram.diagonal() == 0.0
    assert analyze(gram).is_positive_definite is None
    assert analyze(gram).is_positive_semidefinite is None
    assert analyze(gram).evidence["is_positive_semidefinite"].startswith("undecided: λ_min ≥ −")
    # the columns of a Gram matrix are dependent: this one is indefinite
    gram[3, 3] = np.nextafter(gram[3, 3], 0.0)
    assert analyze(gram).is_positive_semidefinite is None
    delta = float(analyze(gram).evidence["is_positive_semidefinite"].split("−")[1].split(",")[0])
    assert 0.0 < delta < 1e-9 * gram.max()


# --- Functions used by other subpackages
# ----------------------------------------------------------------------------


def random_graph(n: int, degree: int, shift: float) -> sp.csr_array:
    """A symmetric matrix of random entries on a random graph, plus a multiple of the identity."""
    rng = np.random.default_rng(0)
    where = rng.integers(n, size=n * degree // 2), rng.integers(n, size=n * degree // 2)
    R = sp.coo_array((rng.uniform(-1, 1, where[0].size), where), shape=(n, n)).tocsr()
    return sp.csr_array(0.5 * (R + R.T) + shift * sp.eye_array(n))


@pytest.mark.full
def test_a_random_graph_is_not_factorized(monkeypatch):
    """Fill of order n² is foreseen: undecided, or decided where dominance does it."""
    for factorization in ("scipy.sparse.linalg.splu", "qdldl.Solver"):
        monkeypatch.setattr(factorization, lambda *_, **__: pytest.fail("minutes of fill"))
    M = random_graph(20_000, 8, 1.2)
    assert not factor_fits(M)
    report = analyze(M)
    str(report)
    assert report.is_positive_definite is None
    assert report.is_p_matrix is None
    assert analyze(random_graph(20_000, 8, 12.0)).is_h_plus


@pytest.mark.parametrize(
    ("M", "is_semidefinite"),
    [
        ([[1.0, 1.0], [1.0, 1.0 - 2.0**-53]], False),
        ([[0.0, 1e-300], [1e-300, 1.0]], False),
        ([[4.0, 2.0, -2.0], [2.0, 1.0, -1.0], [-2.0, -1.0, 1.0]], True),
        ([[1.0, 5.0], [-3.0, 1.0]], True),
        ([[1.0, 5.0], [-3.0 + 2.0**-50, 1.0]], False),
        # A zero on the diagonal requires a zero row, which then does not count.
        ([[0.0, 0.0, 0.0], [0.0, 4.0, 2.0], [0.0, 2.0, 1.0]], True),
        ([[0.0, 0.0, 0.0], [0.0, 4.0, 2.0], [0.0, 2.0, 0.9]], False),
        ([[0.0, 1e-9, 0.0], [1e-9, 4.0, 2.0], [0.0, 2.0, 1.0]], False),
    ],
)
@pytest.mark.parametrize("build", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_semidefinite_is_exact_when_small(M, is_semidefinite, build):
    """Up to n = 10 semidefiniteness is decided in rational arithmetic, without any δ."""
    assert analyze(build(M)).is_positive_semidefinite is is_semidefinite


# The minor of rows 0 to 3 is negative in rational arithmetic; all other minors are at least 1.
NEGATIVE_MINOR = [
    [1, 1e137, 0, 1e132, -1e-240],
    [-1e92, 1, 0, 0, -1e-211],
    [0, 1e-95, 1, 0, 1e36],
    [0, 0, -1e101, 1, 0],
    [0, 0, 0, 1e-257, 1],
]
MINORS_OF_ONE = [[1, 0, 0, -1e103], [1, 1, 1e84, 0], [0, -1e128, 1, 0], [0, -1e201, 0, 1]]


@pytest.mark.parametrize(("M", "is_p"), [(NEGATIVE_MINOR, False), (MINORS_OF_ONE, True)])
def test_p_at_the_ends_of_the_range(M, is_p):
    """Entries whose products leave the range of double precision are decided."""
    assert analyze(M).is_p_matrix is is_p
    lemke = convergence_guarantee(LCP(M, -np.ones(len(M))), "lemke")
    assert lemke.is_guaranteed == is_p


# --- The report ---------------------------------------------------------------------------------------------


def test_report_prints_each_verdict():
    """The table has one line for each verdict, which agrees with the properties."""
    report = analyze([[0.0, 1.0], [1e-8, -2.0]])
    text = str(report)
    for name, evidence in report.evidence.items():
        assert report.verdict(name) == (getattr(report, name), evidence)
        assert evidence in text
    with pytest.raises(KeyError, match="is_h_plus"):
        report.verdict("is_nice")


@pytest.mark.parametrize(
    ("form", "M"),
    [
        ("diagonal", np.eye(2)),
        ("lower", [[1, 0], [1, 1]]),
        ("upper", [[1, 1], [0, 1]]),
        (None, [[1, 1], [1, 1]]),
    ],
)
def test_triangular_forms(form, M):
    """The triangular form is named."""
    report = analyze(M)
    assert report.evidence["is_triangular"].startswith(form or "entries on both sides")
    assert report.is_triangular is (form is not None)


@pytest.mark.parametrize(
    "M",
    [
        [[1e-300, 1e-300, -1e300], [1.7e308, 1e-300, 1e-150], [-1.0, -1.7e308, 1e-300]],
        [[1.0, 1.0, 1e-300], [1.7e308, 1e300, 1e-300], [1e-300, 0.0, 1e150]],
        [[1e300, -1.7e308, 1.7e308], [1e-150, 1.7e308, -1.7e308], [-1.7e308, 0.0, 1e150]],
        [[1e300, 1e-300], [0.0, 1e-300]],
    ],
)
def test_no_question_ends_in_a_warning_or_a_number_too_large(M):
    """Overflow inside a test of M raises no RuntimeWarning (an error here) and no OverflowError."""

    def problem():
        return LCP(M, -np.ones(len(M)))

    assert str(analyze(M))
    for name in ("npsor", "psor", "msor", "npsplitting", "lemke"):
        assert convergence_guarantee(problem(), name).verdict
    with contextlib.suppress(UnsuitableMatrix):
        assert error_bound(problem(), np.ones(len(M))).infinity >= 0.0
    assert Certificate.of(problem(), np.ones(len(M))).relative_residual >= 0.0


def test_a_symmetric_part_near_the_largest_double_is_no_error():
    """An overflowing symmetric part of more than 10 rows is undecided, and raises no error."""
    skew = np.triu(np.random.default_rng(0).uniform(-1.0, 1.0, (12, 12)), 1)
    M = np.ldexp(np.eye(12) * 15.0 + skew - skew.T, 1019)
    assert analyze(M).is_positive_definite is True
    M[0, 1] = M[1, 0] = np.finfo(np.float64).max
    assert analyze(M).is_positive_definite is None
    assert "ends of the range" in analyze(M).evidence["is_positive_semidefinite"]
    huge = np.ldexp([[1.0, -1.5], [0.5, 1.0]], 1023)
    assert (np.ldexp(symmetric_part(huge), -1023) == [[1.0, -0.5], [-0.5, 1.0]]).all()


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
def test_verdicts_on_small_integers_are_the_minors(A):
    """The report on small integers agrees with the minors; a singular ⟨M⟩ may be undecided."""
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
def test_signs_that_the_sums_hide_are_decided_exactly(sign):
    """If the compensated sum of a row has no certain sign, rational arithmetic decides it."""
    report = analyze(hidden_sign(sign, 1))
    assert report.is_strictly_dominant is (sign > 0)
    assert (report.v is not None) == (report.is_h_plus is True)


# --- Definiteness -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("eigenvalue", [1e-9, 0.0, -1e-9])
@pytest.mark.parametrize("build", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_definite_beyond_rounding_in_any_unit(eigenvalue, build):
    """The sign of a least eigenvalue ±1e-9 is proved for n = 30, of ±0 never."""
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.standard_normal((30, 30)))[0]
    values = np.linspace(1.0, 2.0, 30)
    values[0] = eigenvalue
    unit = np.exp2(rng.integers(-60, 60, 30))
    P = unit[:, None] * (Q * values @ Q.T) * unit
    P = build(np.tril(P) + np.tril(P, -1).T)
    assert analyze(P).is_positive_definite is {1e-9: True, 0.0: None, -1e-9: False}[eigenvalue]


# --- Symmetry, structure, pairs, words ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "is_p"),
    [(4.0, False), (np.nextafter(4.0, 0.0), True), (np.nextafter(4.0, 5.0), False)],
)
def test_minors_that_rounding_hides_are_settled_in_integers(entry, is_p):
    """“True and False are proved”: a minor of 0, or one unit in the last place from 0, is decided among 14 rows."""
    skew = np.triu(np.random.default_rng(2).integers(-3, 4, (14, 14)), 1).astype(float)
    M = 4.0 * np.eye(14) + skew - skew.T
    M[:2, 2:], M[0, 1], M[1, 0] = 0.0, 4.0, entry
    assert analyze(M).is_p_matrix is is_p


def test_evidence_names_the_row():
    """The first row that fails is named, with = or < as it fails."""
    equal = analyze([[3.0, 1.0, 1.0], [1.0, 3.0, 2.0], [1.0, 1.0, 2.0]])
    assert equal.evidence["is_strictly_dominant"] == "|m_ii| = Σ|m_ij| on row 1"
    assert (
        analyze([[1.0, 2.0], [0.0, 1.0]]).evidence["is_strictly_dominant"]
        == "|m_ii| < Σ|m_ij| on row 0"
    )


# --- Equilibration ------------------------------------------------------------------------------------------


def test_noise_of_an_assembly_is_symmetric_up_to_rounding():
    """An asymmetry of 1e-7 in rows of 1e11 is small; a triangle is not symmetric."""
    stiffness = [[1e11, -5e10, 1e-7], [-5e10, 1e11, 0.0], [-2e-7, 0.0, 1e11]]
    assert analyze(np.array(stiffness)).evidence["is_symmetric"] == (
        "symmetric up to rounding: its largest asymmetry relative to the rows is 3e-18"
    )
    assert analyze(np.array([[2.0, 1.0], [0.0, 2.0]])).evidence["is_symmetric"] == (
        "largest asymmetry relative to the rows is 0.5"
    )
