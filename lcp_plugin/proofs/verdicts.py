"""Matrix classes: verdicts with evidence, and the certificates behind bounds and guarantees.

For other subpackages: :func:`comparison_certificate` (v with ⟨M⟩v ≥ margin > 0).

Each verdict of a report is one function: tests from cheap to costly, and the evidence as text.

Is ⟨M⟩ a nonsingular M-matrix? Yes is proven by v > 0 with ⟨M⟩v > 0. No is proven by y ≥ 0, y ≠ 0 with ⟨M⟩y ≤ 0, since
⟨M⟩⁻¹ ≥ 0 would make this y nonpositive. One solve gives either: with (I − D⁻¹|B|)x = 1, x > 0 is a valid v, else y =
max(−x, 0) is strict on its support. Both are checked on M itself with the bounds of :mod:`lcp_plugin.core.rounding`;
the verdict is undecided if rounding makes both fail.

Are all principal minors positive? A is a P-matrix exactly if a₁₁ > 0 and both A without its first row and column and
the Schur complement of a₁₁ are.

A summary lists the classes of M and a wrong sign: a matrix whose diagonal is negative throughout is
often meant to be its negative.

References
----------
Berman, Plemmons, *Nonnegative Matrices in the Mathematical Sciences*, SIAM 1994, ch. 6, doi:10.1137/1.9781611971262.
M. J. Tsatsomeros, L. Li, *A recursive test for P-matrices*, BIT 40 (2000), doi:10.1023/A:1022367507760.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Vector, read_only
from ..core.entries import largest_in_rows, max_norm, row_numbers, with_entries
from ..core.kernels.floats import TINY, UNIT
from ..core.matrix import Matrix, fact
from ..core.names import format_count
from ..core.rounding import lower_end, upper_end
from ..core.structure import ROUNDED, connected_components, triangular_form
from ..systems import definiteness, graph
from ..systems.definiteness import is_positive_definite
from ..systems.factors import factor_fits
from ..systems.graph import ComparisonMatrix
from . import exact

EXACT_ROWS = 2_000  # ambiguous rows that are worth an exact sum
TOLERANCES = 0.1, 1e-3, 1e-7  # of the solves, if they iterate: a loose tolerance is often enough


@dataclass(frozen=True, eq=False)
class HCertificate:
    """A proof that ⟨M⟩ is a nonsingular M-matrix: ⟨M⟩v ≥ margin > 0, v > 0, both of shape (n,), read-only.

    `margin` is a lower bound of the exact product of the stored doubles.
    """

    v: Vector
    margin: Vector


class HVerdict(NamedTuple):
    """Verdict on ⟨M⟩: `value` True, False or None, the reason, and the proof of True."""

    value: bool | None
    evidence: str
    certificate: HCertificate | None = None


def comparison_certificate(matrix: Matrix) -> HCertificate | None:
    """Return v > 0 with ⟨M⟩v ≥ margin > 0, proven and cached for this M, or None.

    Parameters
    ----------
    matrix : Matrix

    Notes
    -----
    It does not depend on the signs of the diagonal. Cost: a product with M; if that does not decide, up to three
    solves with ⟨M⟩ (LAPACK, sparse LU, or multigrid).

    Examples
    --------
    >>> certificate = comparison_certificate(Matrix([[2, -2], [-1, 2]]))
    >>> bool((certificate.margin > 0).all())
    True
    >>> comparison_certificate(Matrix([[1, 2], [2, 1]])) is None
    True
    """
    return h_verdict(matrix).certificate


@fact
def h_verdict(matrix: Matrix) -> HVerdict:
    """Return whether ⟨M⟩ is a nonsingular M-matrix: v = 1, then solutions of ⟨M⟩v = |diag(M)| w for w = 1, then |v|.

    Weights |v| make the margin of every row relative to its v.
    """
    M = matrix.csr
    zeros = np.flatnonzero(M.diagonal() == 0.0)
    if zeros.size:
        return HVerdict(False, f"M[{zeros[0]}, {zeros[0]}] = 0")
    ones = read_only(np.ones(matrix.n))
    if (margin := positive_margin(M, ones)) is not None:
        certificate = HCertificate(ones, read_only(margin))
        return HVerdict(True, "v = 1: every row sum of ⟨M⟩ is positive", certificate)
    if is_nonpositive(M, ones):
        return HVerdict(False, "y = 1: no row sum of ⟨M⟩ is positive")
    system, weights = ComparisonMatrix(M), ones
    for tolerance in TOLERANCES:
        x = system.solve(system.diagonal * weights, tolerance=tolerance)
        if x is None:
            return HVerdict(None, "⟨M⟩ is numerically singular, or too large to be factorized")
        v = _centered(system.to_caller(x))
        if (margin := positive_margin(M, v)) is not None:
            smallest = float((margin / np.abs(M.diagonal()) / v).min())
            evidence = f"v from a solve with ⟨M⟩: ⟨M⟩v > 0 checked, ρ(D⁻¹|B|) ≤ 1 − {smallest:.3g}"
            return HVerdict(True, evidence, HCertificate(read_only(v), read_only(margin)))
        y = _centered(system.to_caller(np.maximum(-x, 0.0)))
        if is_nonpositive(M, y):
            return HVerdict(False, "y ≥ 0 from a solve with ⟨M⟩: ⟨M⟩y ≤ 0 checked")
        weights = np.maximum(np.abs(x) / np.abs(x).max(), 1e-30)
    return HVerdict(None, "solutions of ⟨M⟩v = |diag(M)| pass neither check: ρ is 1 up to rounding")


def positive_margin(M: AnyMatrix, v: Vector) -> Vector | None:
    """Return a rigorous lower bound of ⟨M⟩v if it is positive on every row and v > 0, else None."""
    if not ((v > 0.0) & np.isfinite(v)).all():
        return None
    margin = lower_end(*graph.comparison_product(M, v))
    doubtful = np.flatnonzero(~(margin > 0.0))
    if doubtful.size > EXACT_ROWS:
        return None
    for row in doubtful:
        value = graph.exact_comparison_row(M, v, int(row))
        margin[row] = exact.rounded_down(value) if value > 0 else 0.0
        if not margin[row] > 0.0:
            return None
    return margin


def is_nonpositive(M: AnyMatrix, y: Vector) -> bool:
    """Return whether ⟨M⟩y ≤ 0 is proven on every row, for y ≥ 0, y ≠ 0."""
    if not (np.isfinite(y).all() and (y >= 0.0).all() and y.any()):
        return False
    doubtful = np.flatnonzero(~(upper_end(*graph.comparison_product(M, y)) <= 0.0))
    sums = (graph.exact_comparison_row(M, y, int(row)) for row in doubtful)
    return doubtful.size <= EXACT_ROWS and all(value <= 0 for value in sums)


def _centered(v: Vector) -> Vector:
    """Return v ≥ 0 times a power of two that keeps products with it away from the ends of the range."""
    positive = v[v > 0.0]
    if positive.size == 0 or not np.isfinite(positive).all():
        return v
    middle = int(np.frexp(positive.max())[1] + np.frexp(positive.min())[1]) // 2
    return np.ldexp(v, -middle)


def is_p_matrix_by_recursion(M: AnyMatrix) -> bool | None:
    """Return whether all principal minors are positive, proven; None if the numbers are too long.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        n ≤ 16; the time doubles with each row.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> is_p_matrix_by_recursion(sp.csr_array(np.array([[1.0, -3.0], [3.0, 0.5]])))
    True
    >>> is_p_matrix_by_recursion(sp.csr_array(np.array([[1.0, 2.0], [2.0, 4.0]])))
    False
    """
    if not (M.diagonal() > 0.0).all():
        return False
    columns = [exact.shortened(column) for column in zip(*exact.exact_rows(M), strict=True)]
    rows = [list(row) for row in zip(*columns, strict=True)]
    bits = max((entry.bit_length() for row in rows for entry in row), default=0)
    # Entries beyond 160 bits are too long for more than 10 rows
    return None if len(rows) > 10 and bits > 160 else exact.has_positive_minors(rows)


UNDECIDED = "undecided: singular up to rounding"


class Verdict(NamedTuple):
    """`value` True, False, or None if it is undecided; `evidence` is the reason."""

    value: bool | None
    evidence: str


@fact
def symmetric(matrix: Matrix) -> Verdict:
    """M = Mᵀ, entry by entry."""
    M = matrix.csr
    difference = sp.coo_array(M - M.T)
    if not difference.count_nonzero():
        return Verdict(True, "M = Mᵀ exactly")
    # relative to the rows, because the rounding error of an assembly is small there
    root = np.sqrt(np.maximum(largest_in_rows(M), largest_in_rows(sp.csr_array(M.T))))
    largest = float(np.max(np.abs(difference.data) / root[difference.row] / root[difference.col]))
    to_rounding = "symmetric up to rounding: its " * (largest <= ROUNDED)
    return Verdict(False, f"{to_rounding}largest asymmetry relative to the rows is {largest:.2g}")


@fact
def z_matrix(matrix: Matrix) -> Verdict:
    """No positive off-diagonal entry."""
    M = matrix.csr
    rows = row_numbers(M)
    positive = np.flatnonzero((M.data > 0.0) & (rows != M.indices))
    if positive.size == 0:
        return Verdict(True, "no positive off-diagonal entry")
    k = positive[0]
    return Verdict(False, f"M[{rows[k]}, {M.indices[k]}] = {M.data[k]:.6g} > 0")


@fact
def m_matrix(matrix: Matrix) -> Verdict:
    """M is a nonsingular M-matrix: Z and H₊."""
    is_z = z_matrix(matrix)
    return h_plus(matrix) if is_z.value else Verdict(False, f"no Z-matrix: {is_z.evidence}")


@fact
def strictly_dominant(matrix: Matrix) -> Verdict:
    """|m_ii| > Σ_j≠i |m_ij| on every row."""
    signs = graph.row_excess_signs(matrix)
    if (signs > 0).all():
        return Verdict(True, "|m_ii| > Σ|m_ij| on every row, exactly")
    row = int(np.flatnonzero(signs <= 0)[0])
    return Verdict(False, f"|m_ii| {'=' if signs[row] == 0 else '<'} Σ|m_ij| on row {row}")


@fact
def h_matrix(matrix: Matrix) -> Verdict:
    """⟨M⟩ is a nonsingular M-matrix, for any signs of the diagonal."""
    return Verdict(*h_verdict(matrix)[:2])


@fact
def h_plus(matrix: Matrix) -> Verdict:
    """M is an H-matrix with positive diagonal."""
    return _nonpositive_diagonal(matrix) or h_matrix(matrix)


@fact
def irreducible(matrix: Matrix) -> Verdict:
    """M has a strongly connected graph."""
    from scipy.sparse.csgraph import connected_components  # slow to import

    M = matrix.csr  # the routine drops explicit zeros of floats, and only the pattern counts
    pattern = with_entries(M, np.ones(M.nnz))
    count, _ = connected_components(pattern, directed=True, connection="strong")
    if count <= 1:
        return Verdict(True, "the graph of M is strongly connected")
    return Verdict(False, f"{count} strongly connected blocks")


@fact
def triangular(matrix: Matrix) -> Verdict:
    """Lower or upper triangular, or diagonal, in the order of M."""
    form = triangular_form(matrix)
    return Verdict(form is not None, form or "entries on both sides of the diagonal")


@fact
def positive_definite(matrix: Matrix) -> Verdict:
    """xᵀM x > 0 for every x ≠ 0."""
    early = _nonpositive_diagonal(matrix) or _definite_by_comparison(matrix)
    if early is not None:
        return early
    what = "M" if symmetric(matrix).value else "the symmetric part of M"
    if not can_factorize(matrix):
        return Verdict(None, _not_computed(matrix))
    value = is_positive_definite(symmetric_part_of(matrix)) if _is_well_rounded(matrix) else None
    if value is None and matrix.n <= exact.EXACT_SIZE:
        value = exact.has_nonnegative_pivots(exact.exact_symmetric_part(matrix.csr), is_strict=True)
        return Verdict(value, f"exact elimination of {what}")
    if value is None:
        return Verdict(None, f"{UNDECIDED}: {what}")
    if value:
        kind = "SPD: " * bool(symmetric(matrix).value)
        return Verdict(True, f"{kind}{what} has a Cholesky factor, with rounding margin")
    return Verdict(False, f"{what} has no Cholesky factor, rounding margin included")


@fact
def positive_semidefinite(matrix: Matrix) -> Verdict:
    """xᵀM x ≥ 0 for every x: exactly up to n = 10; beyond, a singular M is undecided, with the δ in the evidence."""
    if (matrix.diagonal < 0.0).any():
        return _nonpositive_diagonal(matrix) or Verdict(False, "")
    if symmetric(matrix).value and (graph.row_excess_signs(matrix) >= 0).all():
        return Verdict(True, "λ_min ≥ 0: symmetric, m_ii ≥ Σ|m_ij| on every row, exactly")
    definite = positive_definite(matrix)
    if definite.value:
        return Verdict(True, "λ_min > 0: positive definite")
    if not can_factorize(matrix):
        return Verdict(None, _not_computed(matrix))
    part = symmetric_part_of(matrix)
    value = definiteness.is_semidefinite_to_rounding(part) if _is_well_rounded(matrix) else None
    if value is not False and matrix.n <= exact.EXACT_SIZE:
        is_so = exact.has_nonnegative_pivots(exact.exact_symmetric_part(matrix.csr))
        what = "M" if symmetric(matrix).value else "the symmetric part of M"
        return Verdict(is_so, f"λ_min {'≥' if is_so else '<'} 0: exact elimination of {what}")
    if value:
        delta = definiteness.semidefinite_margin(part)
        return Verdict(None, f"undecided: λ_min ≥ −{delta:.3g}, below which the test cannot decide")
    if value is None and not _is_well_rounded(matrix):
        return Verdict(None, "undecided: the numbers are near the ends of the range of doubles")
    if value is None:
        return Verdict(None, f"not computed: rounding at n = {matrix.n} would hide too much")
    return Verdict(False, "a negative eigenvalue beyond rounding")


@fact
def p_matrix(matrix: Matrix) -> Verdict:
    """Every principal minor is positive."""
    early = _nonpositive_diagonal(matrix) or _p_by_class(matrix)
    if early is not None:
        return early
    if (pair := nonpositive_pair(matrix)) is not None:
        return pair
    if matrix.n <= 16:  # a third of a second; the time doubles with each row
        value = is_p_matrix_by_recursion(matrix.csr)
        if value is not None:
            return Verdict(value, "recursive Schur complements in integers")
    definite = positive_definite(matrix)
    if definite.value:
        return Verdict(True, "every positive definite matrix is one")
    return Verdict(None, f"not computed: the minors of {matrix.n} rows are too many or too long")


def _p_by_class(matrix: Matrix) -> Verdict | None:
    """Decide by a class: triangular, H₊, Z (P is M), symmetric (P is positive definite)."""
    if triangular_form(matrix) is not None:
        return Verdict(True, "triangular with positive diagonal")
    h = h_plus(matrix)
    if h.value:
        return Verdict(True, "every H₊-matrix is one")
    if z_matrix(matrix).value and h.value is False:
        return Verdict(False, "a Z-matrix that is not an M-matrix")
    if symmetric(matrix).value:
        definite = positive_definite(matrix)
        return Verdict(definite.value, f"symmetric: {definite.evidence}")
    return None


def _nonpositive_diagonal(matrix: Matrix) -> Verdict | None:
    nonpositive = np.flatnonzero(matrix.diagonal <= 0.0)
    if nonpositive.size == 0:
        return None
    row = int(nonpositive[0])
    return Verdict(False, f"M[{row}, {row}] = {matrix.diagonal[row]:.6g}")


def nonpositive_pair(matrix: Matrix) -> Verdict | None:
    """Return the verdict by i < j with m_ii m_jj − m_ij m_ji ≤ 0, for a positive diagonal; None without such a pair."""
    M = matrix.csr
    even = with_entries(M, M.data / matrix.diagonal[row_numbers(M)])
    ratios = sp.coo_array(sp.triu(even.multiply(even.T.tocsr()), 1))
    suspicious = np.flatnonzero(ratios.data > 1.0 - 8.0 * UNIT)
    likeliest = suspicious[np.argsort(-ratios.data[suspicious], kind="stable")][:2_000]
    for i, j in zip(ratios.row[likeliest].tolist(), ratios.col[likeliest].tolist(), strict=True):
        first, second, *others = (Fraction(float(M[k])) for k in ((i, i), (j, j), (i, j), (j, i)))
        if first * second <= others[0] * others[1]:
            return Verdict(False, f"the principal minor of rows {i}, {j} is not positive")
    return None


def _definite_by_comparison(matrix: Matrix) -> Verdict | None:
    """Decide by theorems: symmetric H₊-matrices are SPD, symmetric Z-matrices that are not H₊ are not."""
    if symmetric(matrix).value:
        h = h_plus(matrix)
        if h.value:
            return Verdict(True, "SPD: symmetric and H₊")
        if h.value is False and z_matrix(matrix).value:
            return Verdict(False, "a symmetric Z-matrix that is not an M-matrix")
        return nonpositive_pair(matrix)
    if not _has_dominant_symmetric_part(matrix):
        return None
    return Verdict(True, "the symmetric part is dominant, rounding included")


def _has_dominant_symmetric_part(matrix: Matrix) -> bool:
    """Return whether the row sums of ⟨(M + Mᵀ)/2⟩ are proven positive."""
    if not _is_well_rounded(matrix):
        return False
    # Each entry of the symmetric part was rounded once, subnormal ones absolutely; the margin must survive that.
    part = sp.csr_array(sparse_symmetric_part(matrix))
    outward = np.where(row_numbers(part) == part.indices, 1.0 - 4.0 * UNIT, 1.0 + 4.0 * UNIT)
    margin = positive_margin(with_entries(part, part.data * outward), np.ones(matrix.n))
    return margin is not None and bool((margin > 2.0 * TINY * matrix.n).all())


def _is_well_rounded(matrix: Matrix) -> bool:
    """Return whether the rounding of the symmetric part is small relative to the diagonal, and nothing overflows."""
    if symmetric(matrix).value:
        return True
    diagonal, entries = matrix.diagonal[matrix.diagonal > 0.0], matrix.csr.data
    return bool((diagonal >= 2.0**-960).all() and max_norm(entries) < definiteness.LARGEST_SUMMAND)


def _not_computed(matrix: Matrix) -> str:
    return f"not computed: n = {matrix.n} is too large for a factorization"


@fact
def sparse_symmetric_part(matrix: Matrix) -> Any:
    """(M + Mᵀ)/2 as CSR, each entry rounded once."""
    if symmetric(matrix).value:
        return matrix.csr
    part = definiteness.symmetric_part(matrix.csr)
    part.data.flags.writeable = False
    return part


def symmetric_part_of(matrix: Matrix) -> Any:
    """(M + Mᵀ)/2, dense where that is faster."""
    part = sparse_symmetric_part(matrix)
    return part.toarray() if matrix.n <= 500 or matrix.is_dense else part


@fact
def can_factorize(matrix: Matrix) -> bool:
    """Return whether a factorization of the symmetric part is predicted to fit."""
    return factor_fits(sparse_symmetric_part(matrix))


WORDS = {True: "yes", False: "no", None: "undecided"}


CLAIMS: dict[str, Claim] = {}  # of the class below, by name


class Claim:
    """A property of a report: True, False or None (undecided); computed once, on first access."""

    def __init__(self, title: str, decide: Callable[[Matrix], Verdict]) -> None:
        self.title = title
        self.decide = decide

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self.__doc__ = self.decide.__doc__
        CLAIMS[name] = self

    def __get__(self, report: MatrixReport | None, owner: type | None = None) -> Any:
        return self if report is None else report.verdict(self.name).value


class MatrixReport:
    """Classes a matrix belongs to, each True, False or None (undecided), never a guess.

    A verdict is computed on first access, by tests from cheap to costly, and kept. ``verdict(name).evidence`` describes
    its reason; ``evidence`` computes all of them.

    Parameters
    ----------
    matrix : LCP, array or sparse array, shape (n, n)
        Matrix of the report. Reports on one LCP, and on LCPs with one matrix, share what is computed.

    Raises
    ------
    InvalidProblem
        If M is not a real, finite, square matrix.

    Attributes
    ----------
    v, margin : arrays, shape (n,), or None
        Proof that M is an H-matrix: ⟨M⟩v ≥ margin > 0, rigorous.

    Examples
    --------
    >>> report = MatrixReport([[2, -1], [-1, 2]])
    >>> report.is_m_matrix, report.is_positive_definite, report.is_p_matrix
    (True, True, True)
    >>> report.evidence["is_strictly_dominant"]
    '|m_ii| > Σ|m_ij| on every row, exactly'
    """

    is_symmetric = Claim("symmetric", symmetric)
    is_z_matrix = Claim("Z-matrix", z_matrix)
    is_m_matrix = Claim("M-matrix (nonsingular)", m_matrix)
    is_strictly_dominant = Claim("strictly diagonally dominant", strictly_dominant)
    is_h_matrix = Claim("H-matrix", h_matrix)
    is_h_plus = Claim("H₊-matrix", h_plus)
    is_positive_definite = Claim("positive definite", positive_definite)
    is_positive_semidefinite = Claim("positive semidefinite", positive_semidefinite)
    is_p_matrix = Claim("P-matrix", p_matrix)
    is_triangular = Claim("triangular", triangular)
    is_irreducible = Claim("irreducible", irreducible)

    symbol: str = "matrix"
    #: Names of the verdicts that are printed.
    claims: Iterable[str] = CLAIMS

    def __init__(self, matrix: AnyMatrix) -> None:
        matrix = getattr(matrix, "matrix", matrix)
        self.matrix = matrix if isinstance(matrix, Matrix) else Matrix(matrix)
        self.n = self.matrix.n

    @property
    def v(self) -> Vector | None:
        """See the class."""
        return getattr(comparison_certificate(self.matrix), "v", None)

    @property
    def margin(self) -> Vector | None:
        """See the class."""
        return getattr(comparison_certificate(self.matrix), "margin", None)

    @property
    def evidence(self) -> dict[str, str]:
        """The reasons of all verdicts, by name."""
        return {name: self.verdict(name).evidence for name in self.claims}

    @np.errstate(all="ignore")  # an overflow fails the check
    def verdict(self, name: str) -> Verdict:
        """Return (value, evidence) of a claim, for instance ``"is_h_plus"``.

        Raises
        ------
        KeyError
            If no claim has this name.
        """
        if name not in CLAIMS:
            raise KeyError(f"no verdict {name!r}; there are {', '.join(CLAIMS)}")
        return CLAIMS[name].decide(self.matrix)

    def __str__(self) -> str:
        matrix, labels = self.matrix, connected_components(self.matrix)
        kind = "dense" if matrix.is_dense else "sparse"
        parts = format_count(1 if labels is None else int(labels.max()) + 1, "component")
        lines = [f"{self.symbol} of size {self.n}, {matrix.nonzeros} nonzeros, {kind}, {parts}"]
        for name in self.claims:
            value, evidence = self.verdict(name)
            lines += wrapped(f"{CLAIMS[name].title:<29} {WORDS[value]:<10} ", evidence)
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(n={self.n}, nonzeros={self.matrix.nonzeros})"


def wrapped(title: str, text: str) -> list[str]:
    """Return the text next to its title, in lines of at most 100 columns."""
    lines = textwrap.wrap(text, 100, initial_indent=title, subsequent_indent=" " * len(title))
    return lines or [title.rstrip()]


@fact
def is_negative(matrix: Matrix) -> bool:
    """Return whether every diagonal entry is negative, for example if −M is positive definite."""
    return matrix.n > 0 and bool((matrix.diagonal < 0.0).all())


def sign_remark(matrix: Matrix) -> str:
    """Return the remark about a negative diagonal, '' unless all diagonal entries are negative.

    Examples
    --------
    >>> sign_remark(Matrix([[-2.0, 1.0], [1.0, -2.0]]))
    'every diagonal entry of M is negative (M[0, 0] = -2.0), and −M is a positive definite M-matrix: is its sign right?'
    >>> sign_remark(Matrix([[-2.0, 1.0], [1.0, 0.0]]))
    ''
    """
    if not is_negative(matrix):
        return ""
    known = ""
    if h_verdict(matrix).value:
        is_m = int((matrix.csr.data < 0.0).sum()) == matrix.n
        matrix_class = "M-matrix" if is_m else "H₊-matrix"
        known = f", and −M is {'a positive definite' if symmetric(matrix).value else 'an'} {matrix_class}"
    return f"every diagonal entry of M is negative (M[0, 0] = {matrix.diagonal[0]}){known}: is its sign right?"


def classes_in_words(matrix: Matrix) -> str:
    """Return the classes of M that are visible from its entries.

    Examples
    --------
    >>> classes_in_words(Matrix([[2.0, -1.0], [-1.0, 2.0]]))
    'dense, symmetric, a Z-matrix, with positive diagonal'
    """
    form, is_positive = triangular_form(matrix) or "", (matrix.diagonal > 0.0).all()
    classes = (
        "dense" if matrix.is_dense else "sparse",
        "symmetric" * bool(symmetric(matrix).value),
        form if form in ("", "diagonal") else f"{form} triangular",
        "a Z-matrix" * bool(z_matrix(matrix).value),
        "with positive diagonal" if is_positive else "with a diagonal not everywhere positive",
    )
    return ", ".join(filter(None, classes))
