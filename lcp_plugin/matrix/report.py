"""What is known about a matrix: verdicts on demand, each with its evidence."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from ..checks import FloatVector, read_only
from . import verdicts
from .definiteness import symmetric_part
from .factors import factor_fits
from .h_matrix import HVerdict, h_verdict
from .matrix import Matrix, fact
from .structure import IntVector, components, row_excess_signs, scale_spread, strong_blocks, triangular_form
from .symmetry import asymmetry
from .verdicts import Verdict

LINE = 100
WORDS = {True: "yes", False: "no", None: "undecided"}


class Claim:
    """A property of a report: True, False or None (undecided); decided once, when first asked."""

    def __init__(self, title: str, decide: Callable[[MatrixReport], Verdict]) -> None:
        self.title = title
        self.decide = decide

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self.__doc__ = self.decide.__doc__

    def __get__(self, report: MatrixReport | None, owner: type | None = None) -> Any:
        return self if report is None else report.verdict(self.name).value


class MatrixReport:
    """Classes a matrix belongs to, each True, False or None (undecided), never a guess.

    A verdict is computed when it is first asked for, from cheap to costly, and kept. ``evidence[name]`` says in words
    what it stands on.

    Parameters
    ----------
    matrix : Matrix
        The one examined; :func:`analyze` makes the report.

    Attributes
    ----------
    v, margin : arrays, shape (n,), or None
        Proof that M is an H-matrix: ⟨M⟩v ≥ margin > 0, rigorous.
    not_h_vector : array, shape (n,), or None
        Proof that it is none: y ≥ 0, y ≠ 0, ⟨M⟩y ≤ 0.
    asymmetry : float
        Largest |m_ij − m_ji|/max(|m_ij|, |m_ji|).
    triangular_form : str or None
        "diagonal", "lower", "upper".
    components, blocks : int
        Numbers of connected components and of strongly connected blocks of the graph of M.
    zero_diagonal, negative_diagonal : arrays
        Row numbers.
    scale_spread : mapping
        log10 of largest over smallest nonzero magnitude of entries, rows, columns, diagonal.

    Examples
    --------
    >>> report = analyze([[2, -1], [-1, 2]])
    >>> report.is_m_matrix, report.is_positive_definite, report.is_p_matrix
    (True, True, True)
    >>> report.evidence["is_strictly_dominant"]
    '|m_ii| > Σ|m_ij| on every row, exactly'
    """

    is_symmetric = Claim("symmetric", verdicts.symmetric)
    is_z_matrix = Claim("Z-matrix", verdicts.z_matrix)
    is_m_matrix = Claim("M-matrix (nonsingular)", verdicts.m_matrix)
    is_strictly_dominant = Claim("strictly diagonally dominant", verdicts.strictly_dominant)
    is_irreducibly_dominant = Claim("irreducibly dominant", verdicts.irreducibly_dominant)
    is_h_matrix = Claim("H-matrix", verdicts.h_matrix)
    is_h_plus = Claim("H₊-matrix", verdicts.h_plus)
    is_positive_definite = Claim("positive definite", verdicts.positive_definite)
    is_positive_semidefinite = Claim("positive semidefinite", verdicts.positive_semidefinite)
    is_p_matrix = Claim("P-matrix", verdicts.p_matrix)
    is_triangular = Claim("triangular", verdicts.triangular)
    is_irreducible = Claim("irreducible", verdicts.irreducible)

    def __init__(self, matrix: Matrix) -> None:
        self.matrix = matrix
        self._verdicts: dict[str, Verdict] = {}
        self.n = matrix.n
        self.evidence: Mapping[str, str] = _Evidence(self)

    def verdict(self, name: str) -> Verdict:
        """Return (value, evidence) of a claim, for instance ``"is_h_plus"``.

        Raises
        ------
        KeyError
            Where no claim has that name; ``list(report.evidence)`` tells the names.
        MemoryError
            Where memory ends, also while a library is loaded.
        """
        if name not in self._verdicts:
            if name not in CLAIMS:
                raise KeyError(f"no verdict {name!r}; there are {', '.join(CLAIMS)}")
            try:
                with np.errstate(all="ignore"):  # what overflows fails its check
                    self._verdicts[name] = CLAIMS[name].decide(self)
            except ImportError as error:  # a library that is installed, but finds no room
                raise MemoryError(f"memory ended where {name} was to be decided: {error}") from error
        return self._verdicts[name]

    @property
    def csr(self) -> Any:
        """M as canonical CSR, shape (n, n)."""
        return self.matrix.csr

    @property
    def diagonal(self) -> FloatVector:
        """The diagonal of M, shape (n,)."""
        return self.matrix.diagonal

    @property
    def h_verdict(self) -> HVerdict:
        """Whether M is an H-matrix, with its proof and bounds of the spectral radius of D⁻¹|B|."""
        return h_verdict(self.matrix)

    @property
    def v(self) -> FloatVector | None:
        """V > 0 with ⟨M⟩v ≥ margin > 0, shape (n,), or None."""
        return None if self.h_verdict.certificate is None else self.h_verdict.certificate.v

    @property
    def margin(self) -> FloatVector | None:
        """Rigorous lower bound of ⟨M⟩v, positive, shape (n,), or None."""
        return None if self.h_verdict.certificate is None else self.h_verdict.certificate.margin

    @property
    def not_h_vector(self) -> FloatVector | None:
        """Y ≥ 0, y ≠ 0 with ⟨M⟩y ≤ 0, shape (n,), or None."""
        return self.h_verdict.not_h_vector

    @cached_property
    def asymmetry(self) -> float:
        """Largest |m_ij − m_ji|/max(|m_ij|, |m_ji|)."""
        return asymmetry(self.csr)

    @cached_property
    def row_excess_signs(self) -> IntVector:
        """Exact signs of |m_ii| − Σ_j≠i |m_ij|, shape (n,)."""
        return read_only(row_excess_signs(self.csr))

    @cached_property
    def triangular_form(self) -> str | None:
        """"diagonal", "lower", "upper", or None."""
        return triangular_form(self.csr)

    @cached_property
    def _strong(self) -> tuple[int, IntVector]:
        count, labels = strong_blocks(self.csr)
        return count, read_only(labels)

    @property
    def blocks(self) -> int:
        """Number of strongly connected blocks of the graph of M."""
        return self._strong[0]

    @property
    def block_labels(self) -> IntVector:
        """The strongly connected block of each row, shape (n,)."""
        return self._strong[1]

    @cached_property
    def components(self) -> int:
        """Number of connected components of the graph of M."""
        return components(self.csr)[0]

    @property
    def zero_diagonal(self) -> IntVector:
        """Rows with m_ii = 0."""
        return np.flatnonzero(self.diagonal == 0.0)

    @property
    def negative_diagonal(self) -> IntVector:
        """Rows with m_ii < 0."""
        return np.flatnonzero(self.diagonal < 0.0)

    @cached_property
    def scale_spread(self) -> Mapping[str, float]:
        """Decades between largest and smallest nonzero magnitude: entries, rows, columns, diagonal."""
        return MappingProxyType(scale_spread(self.csr))

    @cached_property
    def sparse_symmetric_part(self) -> Any:
        """(M + Mᵀ)/2 as CSR, each entry rounded once."""
        if self.is_symmetric:
            return self.csr
        part = symmetric_part(self.csr)
        part.data.flags.writeable = False
        return part

    @property
    def symmetric_part(self) -> Any:
        """(M + Mᵀ)/2, dense where that is faster."""
        is_dense = self.n <= verdicts.DENSE_LIMIT or isinstance(self.matrix.array, np.ndarray)
        return self.sparse_symmetric_part.toarray() if is_dense else self.sparse_symmetric_part

    @cached_property
    def can_factorise(self) -> bool:
        """Whether a factorisation of the symmetric part has its end in sight."""
        return factor_fits(self.sparse_symmetric_part)

    @property
    def semidefinite_delta(self) -> float | None:
        """δ ≥ 0 of what is known of `is_positive_semidefinite`, λ_min ≥ −δ in the unit of M; None: no such δ is known.

        0 where the verdict is True; positive where it is undecided because an eigenvalue vanishes up to rounding.
        """
        return self.verdict("is_positive_semidefinite").delta

    def to_content(self) -> dict[str, Any]:
        """Return all verdicts and facts as a dict that JSON can hold."""
        return {
            "n": self.n,
            "nonzeros": self.matrix.nonzeros,
            "verdicts": {name: {"value": v.value, "evidence": v.evidence} for name, v in self._all()},
            "triangular_form": self.triangular_form,
            "components": self.components,
            "blocks": self.blocks,
            "zero_diagonal": [int(row) for row in self.zero_diagonal],
            "negative_diagonal": [int(row) for row in self.negative_diagonal],
            "scale_spread": dict(self.scale_spread),
        }

    def _all(self) -> Iterator[tuple[str, Verdict]]:
        return ((name, self.verdict(name)) for name in CLAIMS)

    def __str__(self) -> str:
        lines = [f"matrix of size {self.n}, {self.matrix.nonzeros} nonzeros"]
        for name, v in self._all():
            lines += wrapped(f"{CLAIMS[name].title:<29} {WORDS[v.value]:<10} ", v.evidence)
        lines.append(f"{'connected components':<29} {self.components}, strongly connected blocks {self.blocks}")
        rows = f"{self.zero_diagonal.size} zero, {self.negative_diagonal.size} negative"
        lines.append(f"{'diagonal':<29} {rows}")
        spread = ", ".join(f"{name} {decades:.1f}" for name, decades in self.scale_spread.items())
        lines.append(f"{'decades of magnitude':<29} {spread}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"MatrixReport(n={self.n}, nonzeros={self.matrix.nonzeros})"


class _Evidence(Mapping[str, str]):
    """Claim → why, computed when asked."""

    def __init__(self, report: MatrixReport) -> None:
        self._report = report

    def __getitem__(self, name: str) -> str:
        return self._report.verdict(name).evidence

    def __iter__(self) -> Iterator[str]:
        return iter(CLAIMS)

    def __len__(self) -> int:
        return len(CLAIMS)


CLAIMS = {name: claim for name, claim in vars(MatrixReport).items() if isinstance(claim, Claim)}


def analyze(M: Any) -> MatrixReport:
    """Return the report on a matrix, or on the matrix of a problem.

    Parameters
    ----------
    M : array, sparse array or LCP, shape (n, n)
        Real, finite. For an LCP the report is shared by all problems with this matrix.

    Raises
    ------
    InvalidProblem
        Where M is no real, finite, square matrix.

    Notes
    -----
    Nothing is computed here; each verdict is when it is first asked for, ``print(report)`` asks for all.

    Examples
    --------
    >>> report = analyze([[2.0, -3.0], [1.0, 2.0]])
    >>> report.is_h_plus, report.is_positive_definite
    (True, True)
    >>> analyze([[1, 2], [2, 1]]).evidence["is_p_matrix"]
    'symmetric: the principal minor of rows 0, 1 is not positive'
    """
    matrix = getattr(M, "matrix", M)
    return _report(matrix if isinstance(matrix, Matrix) else Matrix(M))


def wrapped(title: str, text: str) -> list[str]:
    """Return the text beside its title, in lines of at most 100 columns."""
    return textwrap.wrap(text, LINE, initial_indent=title, subsequent_indent=" " * len(title)) or [title.rstrip()]


@fact
def _report(matrix: Matrix) -> MatrixReport:
    """Return the one report on the matrix."""
    return MatrixReport(matrix)
