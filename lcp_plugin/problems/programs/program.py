"""Quadratic programs: checked data, the conditions under which a point is optimal, and whether they are convex."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import repeat
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core import checks
from ...core.checks import AnyMatrix, Array, Indices, Vector
from ...core.entries import largest_in_rows
from ...core.errors import InvalidProblem, UnsupportedModel
from ...core.kernels.floats import EPSILON, UNIT
from ...core.names import Names, checked_names, listed, shared_labels
from ...core.problem import Problem, check_labels
from ...core.rounding import compensated_pair, compensated_product
from ...core.structure import mismatch
from ...judges.program import JudgedProgram
from ...proofs.exact import like
from .constraints import Constraints
from .program_matrices import ProgramMatrices, as_array

CANCELS = 1e-9  # of the objective: more rounding is worth an exact sum


@dataclass(frozen=True, eq=False, init=False, repr=False)
class QuadraticProgram(Problem):
    """Minimize ½ xᵀP x + cᵀx + constant subject to G x ≤ h, A x = b, lower ≤ x ≤ upper; checked, read-only data.

    It is one class because its constructors, its changes and its reductions all write the same data.

    Parameters
    ----------
    P : array or sparse array, shape (n, n)
        Real, finite, symmetric; None or zero for a linear program. Rounding errors in the symmetry are averaged away,
        and ``asymmetry`` is their size. Sparse stays sparse. P may be indefinite: `is_convex` tests whether it is
        positive semidefinite.
    c : array, shape (n,)
        Real, finite.
    G, h : array or sparse array, shape (m, n), and array, shape (m,), optional
        An h of 1e20 and beyond means no row, as ∞ does.
    A, b : array or sparse array, shape (p, n), and array, shape (p,), optional
    lower, upper : scalar or array, shape (n,)
        In the unit of x; none by default. ±1e20 and beyond means none, as ±∞ does.
    constant : float
        Constant of the objective, in its value and in the bounds of the value.
    names : sequence of str, or a pair of sequences, optional
        Names that messages use: of the unknowns, or a pair, names of the rows of G, then of A, and of the unknowns. By
        default the labels of pandas objects, see `LCP`.

    Attributes
    ----------
    asymmetry : float
        max |p_ij − p_ji| of the P of the user.
    matrices : ProgramMatrices
        P, G and A with their cached properties.
    ranges : tuple or None
        For a program built by `from_ranges`: the original row of each row of G and A, its sign, and the number of
        original rows, which have the names.
    sense : float
        −1 if the user maximizes the negative of the objective: results and texts then state this value.

    Raises
    ------
    InvalidProblem
        If the data do not define such a program.

    Examples
    --------
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
    >>> program
    QuadraticProgram(n=2, 1 inequality, 0 equalities)
    >>> print(program)
    QuadraticProgram(n=2, 1 inequality, 0 equalities)
    >>> program.objective([0.5, 1.5])
    -4.5
    """

    axes = "P xx", "c x", "G gx", "h g", "A ax", "b a", "lower x", "upper x"
    matrix_names, vector_names = ("P", "G", "A"), ("c", "h", "b", "lower", "upper")
    other_names = "constant", "names"

    P: AnyMatrix
    c: checks.Vector
    G: AnyMatrix
    h: checks.Vector
    A: AnyMatrix
    b: checks.Vector
    lower: checks.Vector
    upper: checks.Vector
    constant: float = 0.0
    sense: float = 1.0
    asymmetry: float = field(default=0.0)
    ranges: Any = field(default=None, repr=False)
    names: Names = field(default=Names(), repr=False)
    matrices: ProgramMatrices = field(init=False, repr=False)

    def __init__(
        self,
        P: AnyMatrix,
        c: ArrayLike,
        G: AnyMatrix = None,
        h: ArrayLike | None = None,
        A: AnyMatrix = None,
        b: ArrayLike | None = None,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        constant: float = 0.0,
        names: Names | None = None,
    ) -> None:
        labels = shared_labels(self.axes, locals())
        vector = checks.checked_vector(c, "c", None)
        n = vector.size
        if P is None or (np.isscalar(P) and P == 0):
            P = sp.csr_array((n, n))
        P, asymmetry = symmetrized(checks.rectangular_matrix(P, "P", n, n))
        rows, limits = _checked_rows(G, h, "G", "h", n, checks.checked_right_side)
        equations, right = _checked_rows(A, b, "A", "b", n, checks.checked_vector)
        below, above = checks.checked_bounds(lower, upper, n)
        vectors = {"c": vector, "h": limits, "b": right, "lower": below, "upper": above}
        constant, m = checked_constant(constant), limits.size + right.size
        if labels and names is None:
            of_rows = labels.get("g", []) + labels.get("a", [])
            names = Names(of_rows if len(of_rows) == m else None, labels.get("x"))
        facts = {"names": checked_names(names, m, n), "asymmetry": asymmetry, "constant": constant}
        self._keep(ProgramMatrices(P, rows, equations), **vectors, **facts)

    @classmethod
    def from_ranges(
        cls,
        P: AnyMatrix,
        c: ArrayLike,
        A: AnyMatrix,
        lower_rows: ArrayLike,
        upper_rows: ArrayLike,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        constant: float = 0.0,
        names: Names | None = None,
    ) -> QuadraticProgram:
        """Return the program min ½ xᵀP x + cᵀx + constant over lower_rows ≤ A x ≤ upper_rows, lower ≤ x ≤ upper.

        Parameters
        ----------
        P, c, lower, upper, constant
            As in the class.
        A : array or sparse array, shape (m, n)
        lower_rows, upper_rows : scalar or array, shape (m,)
            Lower and upper bounds of the rows; equal bounds are an equality. 1e20 and beyond means ∞, also for x.
        names : sequence of str, or a pair of sequences, optional
            Names of the unknowns, or a pair, names of the rows of A and of the unknowns.

        Raises
        ------
        InvalidProblem
            As for the class, and if a lower bound of a row exceeds its upper bound.

        Examples
        --------
        >>> program = QuadraticProgram.from_ranges(np.eye(2), [0, 0], [[1, 1], [1, -1]], [2, -1], [2, 1])
        >>> print(program)
        QuadraticProgram(n=2, 2 inequalities, 1 equality)
        """
        vector = checks.checked_vector(c, "c", None)
        n = vector.size
        rows = sp.csr_array(checks.rectangular_matrix(A, "A", None, n))
        m = rows.shape[0]
        low, high = checks.checked_bounds(
            lower_rows, upper_rows, m, names=("lower_rows", "upper_rows")
        )
        is_equality = low == high
        above, below = (np.flatnonzero(np.isfinite(limit) & ~is_equality) for limit in (high, low))
        equal, sides = np.flatnonzero(is_equality), above.size + below.size
        order, signs = np.concatenate([above, below, equal]), np.ones(sides + equal.size)
        signs[above.size : sides] = -1.0
        both = rows[order]
        both.data *= np.repeat(signs, np.diff(both.indptr))
        h, b = np.append(high[above], -low[below]), low[equal]
        program = cls(P, vector, both[:sides], h, both[sides:], b, lower, upper, constant)
        return program.replaced(ranges=(order, signs, m), names=checked_names(names, m, n))

    @property
    def n(self) -> int:
        """Number of variables."""
        return int(self.c.size)

    @property
    def is_convex(self) -> bool | None:
        """True if P is positive semidefinite to rounding; None if n is too large to decide. Cost: one factorization."""
        return self.matrices.is_semidefinite

    @cached_property
    def constraints(self) -> Constraints:
        """Constraints and bounds as rows of one matrix."""
        limit = np.concatenate([self.h, self.b, -self.lower, self.upper])
        return Constraints(self.matrices, limit)

    @cached_property
    def judged(self) -> JudgedProgram:
        """The arrays that the criterion measures."""
        d = np.concatenate([self.h, self.b])
        return JudgedProgram(self.matrices.terms, self.c, d, self.lower, self.upper)

    @cached_property
    def folded(self) -> FoldedRows:
        """The program with bounds in place of rows of one variable, and with `ProgramMatrices.semidefinite_P` for P.

        So a P that is indefinite by the rounding errors of its entries counts as semidefinite.
        """
        program, P = self, self.matrices.semidefinite_P
        if P is not None and P is not self.P:
            program = self.replaced(ProgramMatrices(P, self.G, self.A))
        return FoldedRows.of(program)

    @property
    def reduced(self) -> QuadraticProgram:
        """The reduced program; this one, without a cycle of references to `folded`, if nothing changes."""
        P, is_same = self.matrices.semidefinite_P, not self.has_short_rows
        return self if is_same and (P is None or P is self.P) else self.folded.reduced

    @cached_property
    def has_short_rows(self) -> bool:
        """True if a row has fewer than two unknowns, or no limit."""
        is_long, is_limited = self.matrices.terms.counts > 1, np.isfinite(self.judged.d)
        return not np.logical_and.reduce(is_long & is_limited)

    @cached_property
    def known(self) -> dict[str, Any]:
        """Proofs that were searched for; see :func:`lcp_plugin.problems.programs.no_minimum.known_proof`."""
        return {}

    def with_vectors(  # type: ignore[override]
        self,
        c: ArrayLike | None = None,
        h: ArrayLike | None = None,
        b: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        constant: float | None = None,
    ) -> QuadraticProgram:
        """Return the program with other vectors; it shares the cached properties of the matrices.

        Parameters
        ----------
        c, h, b, lower, upper : arrays, shapes (n,), (m,), (p,), (n,), (n,), optional
            The present vectors by default. A number stands for a vector of one.
        constant : float, optional

        Raises
        ------
        InvalidProblem
            As the class.

        Examples
        --------
        >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
        >>> program.with_vectors(h=[9]).h
        array([9.])
        """
        check_labels(self, locals())
        m, p, n, _ = self.matrices.sizes
        below, above = checks.checked_bounds(
            self.lower if lower is None else lower, self.upper if upper is None else upper, n
        )
        checked = checks.checked_vector
        return self.replaced(
            c=self.c if c is None else checked(c, "c", n, may_be_number=n == 1),
            h=self.h if h is None else checks.checked_right_side(h, "h", m, may_be_number=m == 1),
            b=self.b if b is None else checked(b, "b", p, may_be_number=p == 1),
            lower=below,
            upper=above,
            constant=self.constant if constant is None else checked_constant(constant),
        )

    def replaced(self, matrices: ProgramMatrices | None = None, **data: Any) -> QuadraticProgram:
        """Return the program with other data, which are not checked."""
        names = *self.vector_names, "constant", "sense", "asymmetry", "ranges", "names"
        kept = {name: getattr(self, name) for name in names}
        return object.__new__(type(self))._keep(matrices or self.matrices, **(kept | data))

    def name(self, k: int) -> str:
        """Return the name of a row of `constraints`; of a bound, and of a nameless row of one unknown, its text."""
        rows, (m, p, n, _) = self.constraints, self.matrices.sizes
        stated = k if k >= m + p or self.ranges is None else int(self.ranges[0][k])
        if k < m + p and (name := self.names.row(stated, "")):
            return name
        row = rows.matrix[[k]]
        if row.nnz == 1 and (name := self.names.unknown(int(row.indices[0]), "")):
            sign = "=" if rows.is_equality[k] else "≤" if row.data[0] > 0.0 else "≥"
            return f"{name} {sign} {rows.limit[k] / row.data[0] + 0.0:.9g}"
        if stated != k or (k < m + p and self.ranges is not None):
            return f"row {stated} of A"
        words = ("row {} of G", "row {} of A", "lower[{}]", "upper[{}]")
        starts = np.cumsum([0, m, p, n])
        part = int(np.searchsorted(starts, k, side="right")) - 1
        return words[part].format(k - starts[part])

    @classmethod
    def with_matrices(cls, matrices: ProgramMatrices, *vectors: checks.Vector) -> QuadraticProgram:
        """Return the program of these matrices and of c, h, b, lower and upper, which are not checked."""
        return object.__new__(cls)._keep(
            matrices, **dict(zip(cls.vector_names, vectors, strict=True))
        )

    def _keep(self, matrices: ProgramMatrices, **data: Any) -> Self:
        """Write checked data into this new program."""
        parts = {"P": matrices.P, "G": matrices.G, "A": matrices.A, "matrices": matrices}
        return checks.fill(self, **parts, **data)

    @np.errstate(all="ignore")
    def objective(self, x: ArrayLike) -> float:
        """Return ½ xᵀP x + cᵀx + constant for x of shape (n,), without rounding if that is more than 1e-9 of it."""
        point = checks.checked_vector(x, "x", self.n)
        value = float(0.5 * (point @ (self.P @ point)) + self.c @ point) + self.constant
        sizes = np.abs(point)
        terms = float(sizes @ (abs(self.P) @ sizes) + np.abs(self.c) @ sizes)
        if not CANCELS * abs(value) < (self.n + 4) * EPSILON * terms < np.inf:
            return value
        high, low, _ = compensated_pair(self.matrices.terms.sparse_P, point)
        row = sp.csr_array(np.concatenate([0.5 * high, 0.5 * low, self.c])[np.newaxis])
        return float(compensated_product(row, np.tile(point, 3), np.array([self.constant]))[0][0])

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Raise AttributeError, with the spelling of a program for a method of LCP."""
            hint = "; write program.with_vectors(c=…)" if name == "with_q" else ""
            raise AttributeError(f"'QuadraticProgram' object has no attribute {name!r}{hint}")

    def __repr__(self) -> str:
        m, p = self.h.size, self.b.size
        averaged = f", asymmetry {self.asymmetry:.1e} averaged away" if self.asymmetry else ""
        rows = f"{m} inequalit{'y' if m == 1 else 'ies'}, {p} equalit{'y' if p == 1 else 'ies'}"
        return f"QuadraticProgram(n={self.n}, {rows}{averaged})"

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without cached properties."""
        return {attribute.name: getattr(self, attribute.name) for attribute in fields(self)}

    __setstate__ = checks.restore_state


VECTORS = QuadraticProgram.vector_names


def checked_constant(constant: Array) -> float:
    """Return the constant of an objective as a float; raise InvalidProblem if it is not a finite number."""
    if not (checks.is_number(constant) and math.isfinite(constant)):
        raise InvalidProblem(f"constant must be a finite number, got {constant!r}")
    return float(constant)


def _checked_rows(
    matrix: AnyMatrix,
    right: ArrayLike | None,
    name: str,
    right_name: str,
    n: int,
    check: Callable[[Any, str, int], Any],
) -> tuple[Any, checks.Vector]:
    """Return the checked matrix and right-hand side; None for both means zero rows."""
    if (matrix is None) != (right is None):
        present, missing = (name, right_name) if right is None else (right_name, name)
        sign = "≤" if name == "G" else "="
        raise InvalidProblem(
            f"{name} and {right_name} belong together, got {present} without {missing}: {name} x {sign} {right_name}"
        )
    if matrix is None:
        return checks.read_only(np.zeros((0, n))), checks.read_only(np.zeros(0))
    checked = checks.rectangular_matrix(matrix, name, None, n)
    return checked, check(right, right_name, checked.shape[0])


def symmetrized(P: AnyMatrix) -> tuple[Any, float]:
    """Return P with rounding errors in its symmetry averaged away, and the size of these errors."""
    if isinstance(P, np.ndarray) and np.logical_and.reduce(P == P.T, None):
        return P, 0.0
    asymmetry, where = asymmetry_of(P)
    if where is not None:
        i, j = where
        raise InvalidProblem(
            f"P must be symmetric, but P[{i}, {j}] = {P[i, j]} and P[{j}, {i}] = {P[j, i]}; only "
            "(P + P.T) / 2 matters: pass that matrix if it is intended"
        )
    if asymmetry == 0.0:
        return P, 0.0
    with np.errstate(all="ignore"):
        return checks.rectangular_matrix((P + P.T) * 0.5, "P", None, None), asymmetry


def asymmetry_of(M: AnyMatrix) -> tuple[float, tuple[int, int] | None]:
    """Return max |m_ij − m_ji|, and the i, j of the largest relative difference, or None if at rounding level."""
    return mismatch(M, largest_in_rows(M), 1e-12)


def refuse_nonconvex(program: QuadraticProgram) -> None:
    """Raise if P is not convex to the rounding of single precision: P + n 2⁻²⁴ diag(P) is not semidefinite.

    Only the unknowns count that bounds, and rows of one unknown, do not fix.

    Cost: one factorization, if no row decides and the factorization fits into memory.

    Raises
    ------
    UnsupportedModel
        With the eigenvalue that shows it.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> refuse_nonconvex(QuadraticProgram([[1, 2], [2, 1]], [0, 0]))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    lcp_plugin.core.errors.UnsupportedModel: the program is not convex: the smallest eigenvalue of P is -1, ...
    """
    if program.matrices.is_nearly_semidefinite:
        return
    P, (lower, upper) = program.P, (program.reduced.lower, program.reduced.upper)
    free = np.flatnonzero(lower < upper)
    if free.size < program.n:
        none = np.zeros((0, free.size))
        if ProgramMatrices(P[free][:, free], none, none).is_nearly_semidefinite:
            return
    shown, repair = "P has a negative eigenvalue", ""
    if program.n <= 1000:  # unknowns of a P whose eigenvalues are computed for a message
        values = np.linalg.eigvalsh(as_array(P))
        shown = f"the smallest eigenvalue of P is {values[0]:.3g}"
        # Rounding to some digits may cause so negative an eigenvalue
        if -values[0] <= 1e-2 * values[-1]:
            repair = (
                "if P is rounded, replace it by the nearest semidefinite matrix: w, V = numpy.linalg.eigh(P); "
                "P = V * w.clip(0) @ V.T; otherwise "
            )
    if (unbounded := np.flatnonzero(upper - lower == np.inf)).size:  # the search needs them
        names = listed(map(program.names.unknown, unbounded.tolist(), repeat("x[{}]")))
        repair += f"without bounds it may fall forever: give {names} finite bounds, then "
    raise UnsupportedModel(
        f"the program is not convex: {shown}, so that a stationary point need not be a minimum; {repair}solve "
        "EquilibriumProgram(program, [], []), which searches for the global minimum with SCIP (pip install pyscipopt)"
    )


NO_ROW = -1  # no row gives the bound


@dataclass(frozen=True, eq=False)
class FoldedRows:
    """The program's bounds and rows with singleton, empty and unlimited rows gone.

    A row g x_j ≤ h or a x_j = b becomes a bound; 0 ≤ h, 0 = 0 and g x ≤ ∞ are dropped. 0 = 1e-16 is 0 = 0 if 1e-16 is
    one rounding error of the smallest other right-hand side. An infeasible row, 0 ≤ −1 or singleton rows with
    inconsistent bounds, remains a row, so that the solver detects the inconsistency.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after; the same object if no row goes.
    left : ndarray of int
        Rows of [G; A] that remain.
    lower_row, upper_row : ndarray of int, shape (n,)
        The row of [G; A] that gives the bound, or −1.
    coefficient : ndarray, shape (rows of G + rows of A,)
        The only entry of a singleton row; 1 elsewhere.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[0, 2]], h=[2])
    >>> folded = program.folded
    >>> print(folded.reduced)
    QuadraticProgram(n=2, 0 inequalities, 0 equalities)
    >>> folded.multipliers(np.array([0.0, 0.0, 0.0, 2.0]))
    array([1., 0., 0., 0., 0.])
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    left: Indices
    lower_row: Indices
    upper_row: Indices
    coefficient: checks.Vector

    @classmethod
    def of(cls, program: QuadraticProgram) -> FoldedRows:
        """Return the reduction of a program; `QuadraticProgram.folded` keeps it."""
        matrices, right = program.matrices, program.judged.d
        if not program.has_short_rows:
            none = np.full(program.n, NO_ROW)
            return cls(program, program, np.arange(right.size), none, none, np.ones(right.size))
        is_equality = matrices.is_equality[: right.size]
        (rows, columns, coefficient) = matrices.singletons
        limits = right[rows] / coefficient[rows]
        is_finite = np.isfinite(limits)
        rows, columns, limits = rows[is_finite], columns[is_finite], limits[is_finite]
        sides = []
        for sign, bounds in ((1.0, program.upper), (-1.0, -program.lower)):
            on = is_equality[rows] | (sign * coefficient[rows] > 0.0)
            sides.append(_tightest(bounds, sign * limits[on], columns[on], rows[on]))
        (upper, upper_row), (negated, lower_row) = sides
        lower = -negated + 0.0  # no negative zeros
        contradicts = lower > upper
        lower = np.where(contradicts, program.lower, lower)
        upper = np.where(contradicts, program.upper, upper)
        lower_row[contradicts] = upper_row[contradicts] = NO_ROW

        others = np.abs(right[(matrices.terms.counts > 0) & (right < np.inf) & (right != 0.0)])
        rounding = UNIT * others.min() if others.size else 0.0
        holds = np.where(is_equality, np.abs(right) <= rounding, right >= -rounding)
        stays = ~(holds & (matrices.terms.counts == 0) | (right == np.inf))
        stays[rows[~contradicts[columns]]] = False
        left = np.flatnonzero(stays)
        folded, m = program, program.h.size
        if left.size < right.size:
            h, b = right[left[left < m]], right[left[left >= m]]
            kept = matrices.of_rows(left)
            folded = program.with_matrices(kept, program.c, h, b, lower, upper)
        return cls(program, folded, left, lower_row, upper_row, coefficient)

    def multipliers(self, reduced: Vector) -> Any:
        """Return the multipliers of all constraints, doubles or Fractions; rows get the multipliers of their bounds."""
        if self.reduced is self.program:
            return reduced
        of_rows, *bounds = np.split(reduced, [self.left.size, self.left.size + self.program.n])
        every = np.zeros(self.coefficient.size, dtype=reduced.dtype)
        every[self.left] = of_rows
        of_bounds = []
        for owner, share, sign in ((self.lower_row, bounds[0], -1), (self.upper_row, bounds[1], 1)):
            moved = np.flatnonzero((owner != NO_ROW) & (share != 0))
            rows = owner[moved]
            every[rows] += sign * share[moved] / like(self.coefficient[rows], reduced)
            of_bounds.append(np.where(owner == NO_ROW, share, 0))
        return np.concatenate([every, *of_bounds])


def _tightest(
    bounds: checks.Vector, limits: checks.Vector, columns: Indices, rows: Indices
) -> tuple[checks.Vector, Indices]:
    """Return the smallest upper bound of each variable and its row; the variable's bound wins a tie."""
    tightest, owner = bounds.copy(), np.full(bounds.size, NO_ROW)
    np.minimum.at(tightest, columns, limits)
    # The first of equal limits
    gives = np.flatnonzero((limits == tightest[columns]) & (limits < bounds[columns]))[::-1]
    owner[columns[gives]] = rows[gives]
    return tightest, owner
