"""Quadratic programs of one shape, as stacked data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import (
    INFINITE_LIMIT,
    BoolVector,
    assemble_csr,
    read_only,
    real_array,
    replace_huge_bounds_by_inf,
)
from ...core.errors import InvalidProblem, LCPError
from ..many.data import length_of_all, rows_of_a_batch
from .criterion import ProgramComponents
from .program import SYMMETRIC_TO, QuadraticProgram, check_pair
from .program_matrices import (
    ProgramMatrices,
    as_array,
    may_be_small,
    refuse_nonconvex,
)


class QuadraticProgramBatch:
    """Programs of one shape, for each k: minimize ½ xᵀP x + cᵀx + constant; G x ≤ h, A x = b, lower ≤ x ≤ upper.

    ``programs[k]`` is the :class:`~lcp_plugin.QuadraticProgram` of number k, and raises what is wrong with it.

    Parameters
    ----------
    P, G, A : arrays, shapes (B, n, n), (B, m, n) and (B, p, n), or without B: the same for all
        G and A are optional. Stacks are not copied: do not change their entries while you use the batch.
        If all three are the same for all programs they may be sparse. Rounding errors in the symmetry of P are averaged
        away.
    c, h, b : arrays, shapes (B, n), (B, m) and (B, p), or without B
    lower, upper : scalar or array, shape (n,) or (B, n)
        ±1e20 and beyond means none, and an h of 1e20 no row, as ±∞ does.
    constant : float or array, shape (B,)
        Constants of the objectives.

    Raises
    ------
    InvalidProblem
        If shapes do not fit together, or if the shared data do not define a program.

    Examples
    --------
    The points of x₁ + x₂ ≤ 2 nearest to (1, 2) and to (0, 1):

    >>> programs = QuadraticProgramBatch(np.eye(2), [[-1, -2], [0, -1]], G=[[1, 1]], h=[2])
    >>> programs, programs[1].c
    (QuadraticProgramBatch(2 programs, n=2), array([ 0., -1.]))
    """

    item = "program"
    _given: Sequence[QuadraticProgram | LCPError] | None
    _shared: QuadraticProgram | None

    def __init__(
        self,
        P: Any,
        c: ArrayLike,
        G: Any = None,
        h: ArrayLike | None = None,
        A: Any = None,
        b: ArrayLike | None = None,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        constant: ArrayLike = 0.0,
    ) -> None:
        c = real_array(c, "c must have shape (B, n) or (n,)")
        if not c.ndim:
            raise InvalidProblem(
                f"c must have shape (B, n) or (n,), got the number {c}; write [{c}]"
            )
        n = c.shape[-1]
        check_pair(G, h, "G", "h")
        check_pair(A, b, "A", "b")
        given = {
            "P": P,
            "G": np.zeros((0, n)) if G is None else G,
            "A": np.zeros((0, n)) if A is None else A,
        }
        matrices = {name: _checked_matrices(values, name, n) for name, values in given.items()}
        m, p = (matrices[name].shape[-2] for name in "GA")
        right: dict[str, Any] = {
            "c": (c, n),
            "h": ([] if h is None else h, m),
            "b": ([] if b is None else b, p),
        }
        right |= {"lower": (lower, n), "upper": (upper, n)}
        self.vectors = {
            name: rows_of_a_batch(values, name, size) for name, (values, size) in right.items()
        }
        h_rows = self.vectors["h"]
        self.vectors["lower"], self.vectors["upper"] = replace_huge_bounds_by_inf(
            self.vectors["lower"], self.vectors["upper"]
        )
        h_rows[h_rows >= INFINITE_LIMIT] = np.inf
        stacks = {name: values for name, values in matrices.items() if values.ndim == 3}
        stacks |= {
            name: rows for name, rows in self.vectors.items() if np.ndim(right[name][0]) == 2
        }
        self.constant = real_array(constant, "constant must be a number or have shape (B,)")
        stacks |= {"constant": self.constant} if self.constant.ndim else {}
        self.count = length_of_all({name: len(rows) for name, rows in stacks.items()})
        self.sizes: tuple[int, int, int, int] = m, p, n, n
        self._shared, self._given = None, None
        if not stacks.keys() & matrices.keys():
            self._shared = QuadraticProgram(
                matrices["P"], np.zeros(n), matrices["G"], np.zeros(m), matrices["A"], np.zeros(p)
            )
            matrices = {name: getattr(self._shared, name) for name in matrices}
        self.P, self.G, self.A = (
            matrices.values() if self._shared is not None else map(_stack, matrices.values())
        )
        self._is_symmetric: Any = True
        if self._shared is None:
            self.P, self._is_symmetric = _symmetric(self.P)

    @classmethod
    def of(
        cls, programs: Sequence[QuadraticProgram | LCPError], example: QuadraticProgram
    ) -> QuadraticProgramBatch | None:
        """Return checked programs of one shape as a batch; None if their shapes differ, or they need too much memory.

        Parameters
        ----------
        programs : sequence of QuadraticProgram or LCPError
            An error replaces an invalid program; accessing this program raises it.
        example : QuadraticProgram
            Program of the same shape.

        Examples
        --------
        >>> program = QuadraticProgram(np.eye(2), [-1, 0])
        >>> QuadraticProgramBatch.of([program, program.with_vectors(c=[0, -1])], program)
        QuadraticProgramBatch(2 programs, n=2)
        """
        given = [one for one in programs if isinstance(one, QuadraticProgram)]
        (m, p, n, _), is_shared = (
            example.matrices.sizes,
            all(one.matrices is example.matrices for one in given),
        )
        if any(one.matrices.sizes != example.matrices.sizes for one in given):
            return None
        if not (is_shared or may_be_small(n, m + p, [n * (n + m + p)])):
            return None
        made = object.__new__(cls)
        made.count, made.sizes, made._given = len(programs), (m, p, n, n), programs
        made._shared, made._is_symmetric = (example if is_shared else None), True
        # The vectors of an invalid program are NaN.
        sizes = {"c": n, "h": m, "b": p, "lower": n, "upper": n}
        none = {name: np.full(size, np.nan) for name, size in sizes.items()}
        made.constant = np.array([getattr(one, "constant", np.nan) for one in programs])
        made.vectors = {
            name: np.array([getattr(one, name, missing) for one in programs]).reshape(
                len(programs), missing.size
            )
            for name, missing in none.items()
        }
        if is_shared:
            made.P, made.G, made.A = example.P, example.G, example.A
        else:
            given = [one if isinstance(one, QuadraticProgram) else example for one in programs]
            made.P, made.G, made.A = (
                np.array([as_array(getattr(one, name)) for one in given]) for name in "PGA"
            )
        return made

    @classmethod
    def with_costs(cls, program: QuadraticProgram, c: ArrayLike) -> QuadraticProgramBatch:
        """Return the program with each c, shape (B, n).

        Raises
        ------
        InvalidProblem
            If the shape does not fit.
        """
        made = object.__new__(cls)
        rest = {name: getattr(program, name)[np.newaxis] for name in ("h", "b", "lower", "upper")}
        made.vectors = {"c": rows_of_a_batch(c, "c", program.n), **rest}
        made.count, made.sizes = len(made.vectors["c"]), program.matrices.sizes
        made._shared, made._given, made._is_symmetric = program, None, True
        made.P, made.G, made.A = program.P, program.G, program.A
        made.constant = np.array(program.constant)
        return made

    def start(self, k: int) -> None:
        """Return None: external solvers need no start."""

    @property
    def n(self) -> int:
        """Number of variables of each."""
        return self.sizes[2]

    @property
    def points(self) -> Any:
        """The points of [lower, upper] nearest to 0, shape (B, n)."""
        nearest = np.clip(0.0, self.vectors["lower"], self.vectors["upper"])
        return np.array(np.broadcast_to(nearest, (self.count, self.n)))

    @property
    def has_one_matrix(self) -> bool:
        """True if all programs share P, G and A."""
        return self._shared is not None

    @property
    def arrays(self) -> tuple[Any, ...]:
        """P, c, C, d, lower and upper: C and d hold G and A, h and b.

        Matrices are of shape (B or 1, …), vectors (B, …), C-contiguous and read-only.
        """
        c, h, b, lower, upper = (
            np.broadcast_to(rows, (self.count, rows.shape[1])) for rows in self.vectors.values()
        )
        P, G, A = map(_stack, (self.P, self.G, self.A))
        data = P, c, _concatenate(G, A), _concatenate(h, b), lower, upper
        return tuple(read_only(np.ascontiguousarray(array)) for array in data)

    @property
    def may_be_stated(self) -> BoolVector:
        """Mask of the valid programs, shape (B,), as far as vectors and the symmetry of P show."""
        c, h, b, lower, upper = self.vectors.values()
        with np.errstate(all="ignore"):
            has_values = ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all(axis=1)
            is_finite = (
                np.isfinite(c).all(axis=1) & np.isfinite(b).all(axis=1) & (h > -np.inf).all(axis=1)
            )
        return np.broadcast_to(has_values & is_finite & self._is_symmetric, self.count)

    def refuse_nonconvex(self) -> None:
        """Raise if one P for all is not convex.

        As :func:`~lcp_plugin.problems.programs.program_matrices.refuse_nonconvex`.
        """
        if self._shared is not None:
            refuse_nonconvex(self._shared)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, k: int) -> QuadraticProgram:
        if not -len(self) <= k < len(self):
            raise IndexError(f"there are {len(self)} programs, and none has the number {k}")
        c, h, b, lower, upper = (_row_of(rows, k % len(self)) for rows in self.vectors.values())
        constant = float(np.broadcast_to(self.constant, self.count)[k])
        if self._given is not None:
            if isinstance(one := self._given[k], LCPError):
                raise one
            return one
        if self._shared is not None:
            return self._shared.with_vectors(c, h, b, lower, upper, constant)
        P, G, A = (_row_of(stack, k % len(self)) for stack in (self.P, self.G, self.A))
        return QuadraticProgram(P, c, G, h, A, b, lower, upper, constant)

    def __repr__(self) -> str:
        return (
            f"QuadraticProgramBatch({len(self)} program{'' if len(self) == 1 else 's'}, n={self.n})"
        )


def block_matrices(P: Any, C: Any, m: int, count: int) -> ProgramMatrices:
    """Return P, G and A of one block diagonal program; C holds m rows of G, then the rows of A."""
    n, rows = P.shape[1], C.shape[1]
    stacks = (np.broadcast_to(one, (count, *one.shape[1:])) for one in (P, C[:, :m], C[:, m:]))
    matrices = ProgramMatrices(*map(block_diagonal, stacks))
    matrices.__dict__["summands"] = n, n, rows
    is_connected = [(one != 0.0).all(axis=2).any(axis=1) for one in (P, C)]  # by a row without 0
    if np.logical_or(*is_connected).all():
        of_unknown, *parts = (np.repeat(np.arange(count), size) for size in (n, m, rows - m))
        components = ProgramComponents(of_unknown, np.concatenate(parts), count)
        matrices.__dict__["components"] = components
    return matrices


def block_diagonal(stack: Any) -> sp.csr_array:
    """Return a stack of matrices, shape (B, m, n), as the CSR array of B blocks, without their zeros.

    Examples
    --------
    >>> block_diagonal(np.array([[[1.0, 0.0]], [[2.0, 3.0]]])).toarray()
    array([[1., 0., 0., 0.],
           [0., 0., 2., 3.]])
    """
    count, m, n = stack.shape
    is_entry = stack != 0.0
    starts = np.zeros(count * m + 1, np.int64)
    np.cumsum(is_entry.sum(axis=2).ravel(), out=starts[1:])
    columns = np.broadcast_to(np.arange(count * n).reshape(count, 1, n), stack.shape)[is_entry]
    return assemble_csr(stack[is_entry], columns, starts, (count * m, count * n))


def _row_of(rows: Any, k: int) -> Any:
    """Return the row of program k; a single row is common to all programs."""
    return rows[k if len(rows) > 1 else 0]


def _checked_matrices(values: Any, name: str, n: int) -> Any:
    rows = n if name == "P" else "rows"
    need = (
        f"{name} must have shape (B, {rows}, {n}), or ({rows}, {n}) for all, as c has {n} entries"
    )
    matrices = values if sp.issparse(values) else real_array(values, need)
    if (
        matrices.ndim not in (2, 3)
        or matrices.shape[-1] != n
        or (name == "P" and matrices.shape[-2] != n)
    ):
        raise InvalidProblem(f"{need}; got shape {matrices.shape}")
    return matrices


def _stack(matrices: Any) -> Any:
    dense = np.ascontiguousarray(as_array(matrices))
    return dense if dense.ndim == 3 else dense[np.newaxis]


def _concatenate(first: Any, second: Any) -> Any:
    """Return two stacks as one, without a copy if one stack has no rows."""
    if not first.shape[1] or not second.shape[1]:
        return first if first.shape[1] else second
    count = max(len(first), len(second))
    return np.concatenate(
        [np.broadcast_to(one, (count, *one.shape[1:])) for one in (first, second)], axis=1
    )


def _symmetric(P: Any) -> tuple[Any, BoolVector]:
    """Return P with rounding errors in its symmetry averaged away, and the mask of symmetric P, shape (B or 1,)."""
    is_symmetric = (P.transpose(0, 2, 1) == P).all(axis=(1, 2))
    some = np.flatnonzero(~is_symmetric)
    if some.size:
        one, mirror = P[some], P[some].transpose(0, 2, 1)
        with np.errstate(all="ignore"):
            size = np.sqrt(np.abs(one).max(axis=2))
            is_rounding = (
                np.abs(one - mirror) <= SYMMETRIC_TO * size[:, :, np.newaxis] * size[:, np.newaxis]
            )
            is_symmetric[some], P = is_rounding.all(axis=(1, 2)), P.copy()
            P[some[is_symmetric[some]]] = ((one + mirror) * 0.5)[is_symmetric[some]]
    return P, is_symmetric
