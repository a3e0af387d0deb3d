"""Facts about a matrix: verdicts on demand, each with its evidence.

A summary lists the classes of M and a wrong sign: a matrix whose diagonal is negative throughout is
often meant to be its negative.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...core.errors import InvalidProblem
from ...core.matrix import structure
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.structure import triangular_form
from ...core.problem_classes import class_of, refusal
from ...systems import graph
from ...systems.symmetry import asymmetry
from . import verdicts
from .h_matrix import h_verdict
from .verdicts import Verdict, symmetric, z_matrix

LINE = 100
WORDS = {True: "yes", False: "no", None: "undecided"}


def _view(tell: Callable[[Matrix], Any]) -> Any:
    """Return an attribute of a report that is a cached property of its matrix."""

    @property  # type: ignore[misc]
    @np.errstate(all="ignore")  # an overflow fails the check
    def view(report: MatrixReport) -> Any:
        return tell(report.matrix)

    return view


class Claim:
    """A property of a report: True, False or None (undecided); computed once, on first access."""

    def __init__(self, title: str, decide: Callable[[Matrix], Verdict]) -> None:
        self.title = title
        self.decide = decide

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self.__doc__ = self.decide.__doc__

    def __get__(self, report: MatrixReport | None, owner: type | None = None) -> Any:
        return self if report is None else report.verdict(self.name).value


class MatrixReport:
    """Classes a matrix belongs to, each True, False or None (undecided), never a guess.

    A verdict is computed on first access, by tests from cheap to costly, and kept. ``verdict(name).evidence`` describes
    its reason; ``evidence`` computes all of them.

    Parameters
    ----------
    matrix : LCP, array or sparse array, shape (n, n)
        The one examined; :func:`analyze` makes the report, once a matrix.

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
    row_excess_signs : array, shape (n,)
        Exact signs of |m_ii| − Σ_j≠i |m_ij|.

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
    is_h_matrix = Claim("H-matrix", verdicts.h_matrix)
    is_h_plus = Claim("H₊-matrix", verdicts.h_plus)
    is_positive_definite = Claim("positive definite", verdicts.positive_definite)
    is_positive_semidefinite = Claim("positive semidefinite", verdicts.positive_semidefinite)
    is_p_matrix = Claim("P-matrix", verdicts.p_matrix)
    is_triangular = Claim("triangular", verdicts.triangular)
    is_irreducible = Claim("irreducible", verdicts.irreducible)

    csr = _view(lambda matrix: matrix.csr)
    diagonal = _view(lambda matrix: matrix.diagonal)
    v = _view(lambda matrix: getattr(h_verdict(matrix).certificate, "v", None))
    margin = _view(lambda matrix: getattr(h_verdict(matrix).certificate, "margin", None))
    not_h_vector = _view(lambda matrix: h_verdict(matrix).not_h_vector)
    asymmetry = _view(asymmetry)
    triangular_form = _view(structure.triangular_form)
    row_excess_signs = _view(graph.row_excess_signs)
    components = _view(graph.components)
    blocks = _view(lambda matrix: graph.diagonal_blocks(matrix)[0])
    zero_diagonal = _view(lambda matrix: np.flatnonzero(matrix.diagonal == 0.0))
    negative_diagonal = _view(lambda matrix: np.flatnonzero(matrix.diagonal < 0.0))
    scale_spread = _view(graph.scale_spread)

    def __init__(self, matrix: Any) -> None:
        self.matrix = matrix_of(matrix)
        self.n = self.matrix.n

    @property
    def evidence(self) -> dict[str, str]:
        """The reasons of all verdicts, by name."""
        return {name: v.evidence for name, v in self._all()}

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

    def to_content(self) -> dict[str, Any]:
        """Return all verdicts and facts as a dict that JSON can hold."""
        return {
            "n": self.n,
            "nonzeros": self.matrix.nonzeros,
            "verdicts": {
                name: {"value": v.value, "evidence": v.evidence} for name, v in self._all()
            },
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
        lines.append(
            f"{'connected components':<29} {self.components}, strongly connected blocks {self.blocks}"
        )
        rows = f"{self.zero_diagonal.size} zero, {self.negative_diagonal.size} negative"
        lines.append(f"{'diagonal':<29} {rows}")
        spread = ", ".join(f"{name} {decades:.1f}" for name, decades in self.scale_spread.items())
        lines.append(f"{'decades of magnitude':<29} {spread}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"MatrixReport(n={self.n}, nonzeros={self.matrix.nonzeros})"


CLAIMS = {name: claim for name, claim in vars(MatrixReport).items() if isinstance(claim, Claim)}


@np.errstate(all="ignore")
def analyze(M: Any) -> MatrixReport:
    """Return the classes of a matrix, or of a problem's matrix; each verdict is proved.

    Parameters
    ----------
    M : array, sparse array or LCP, shape (n, n)
        Real, finite. For an LCP the report is shared by all problems with this matrix.

    Raises
    ------
    InvalidProblem
        If M is not a real, finite, square matrix.

    Notes
    -----
    Each verdict is computed on first access; ``print(report)`` computes all of them.

    Examples
    --------
    >>> report = analyze([[2.0, -3.0], [1.0, 2.0]])
    >>> report.is_h_plus, report.is_positive_definite
    (True, True)
    >>> analyze([[1, 2], [2, 1]]).evidence["is_p_matrix"]
    'symmetric: the principal minor of rows 0, 1 is not positive'
    """
    return _report(matrix_of(M))


def matrix_of(M: Any) -> Matrix:
    """Return the `Matrix` of a problem or an array; a `Matrix` is returned unchanged."""
    if class_of(M) not in (None, "LCP"):
        raise InvalidProblem(refusal("analyze", M))
    matrix = getattr(M, "matrix", M)
    return matrix if isinstance(matrix, Matrix) else Matrix(M)


def wrapped(title: str, text: str) -> list[str]:
    """Return the text next to its title, in lines of at most 100 columns."""
    return textwrap.wrap(text, LINE, initial_indent=title, subsequent_indent=" " * len(title)) or [
        title.rstrip()
    ]


@fact
def _report(matrix: Matrix) -> MatrixReport:
    """Return the one report on the matrix."""
    return MatrixReport(matrix)


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
    if h_verdict(matrix).is_h:
        is_m = int((matrix.csr.data < 0.0).sum()) == matrix.n
        kind = "M-matrix" if is_m else "H₊-matrix"
        known = f", and −M is {'a positive definite' if symmetric(matrix).value else 'an'} {kind}"
    return f"every diagonal entry of M is negative (M[0, 0] = {matrix.diagonal[0]}){known}: is its sign right?"


def classes_in_words(matrix: Matrix) -> str:
    """Return the classes of M that are visible from its entries.

    Examples
    --------
    >>> classes_in_words(Matrix([[2.0, -1.0], [-1.0, 2.0]]))
    'dense, symmetric, a Z-matrix, with positive diagonal'
    """
    return ", ".join(_classes(matrix))


def _classes(matrix: Matrix) -> Iterator[str]:
    yield "dense" if matrix.is_dense else "sparse"
    if symmetric(matrix).value:
        yield "symmetric"
    if (form := triangular_form(matrix)) is not None:
        yield form if form == "diagonal" else f"{form} triangular"
    if z_matrix(matrix).value:
        yield "a Z-matrix"
    yield (
        "with positive diagonal"
        if (matrix.diagonal > 0.0).all()
        else "with a diagonal not everywhere positive"
    )
