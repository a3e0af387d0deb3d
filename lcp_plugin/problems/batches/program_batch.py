"""Batch of quadratic programs of one shape: one engine call per small program, one array criterion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import AnyMatrix, Array, BoolVector, read_only
from ...core.errors import InvalidProblem, LCPError
from ...core.kernels.floats import EPSILON, FEW_ROUNDINGS
from ...engines import is_installed
from ...engines.solvers import DAQP, call_daqp, ends_of_rows, kinds_of_rows
from ...judges.program import JudgedProgram, KKTErrors, ProgramTerms, measure_many
from ...methods.small import LOOP_FROM, has_numba
from ..many import rows_of_a_batch
from ..programs.program import CANCELS, VECTORS, QuadraticProgram
from ..programs.program_matrices import as_array, may_be_small
from .instances import ArrayInstances, Stacks, have_values, vectors_of

ENGINE = "daqp"
PROXIMAL_OPTIONS = {
    "eta_prox": 1e-13,
    "eps_prox": -1e-3,
}  # for singular P, because no polish follows


class ProgramBatch(ArrayInstances):
    """Programs of one shape, as arrays with an axis for them; one row of a table has x and all multipliers.

    Parameters
    ----------
    example : QuadraticProgram
        Program of the shape of all.
    rows : dict
        c, h, b, lower and upper of shapes (B, size), or (1, size) for all.
    constant : array, shape (B,) or ()
    matrices : list of arrays, shapes (B, n, n), (B, m, n) and (B, p, n), optional
        P, G and A; by default the matrices of `example` for all.
    problems : sequence, optional
        Programs, or their errors.
    """

    item, stacked_by, fewest_iterations, changing = "program", ("auto", ENGINE), 0, ("c",)

    def __init__(
        self,
        example: QuadraticProgram,
        rows: Any,
        constant: Any,
        matrices: Any = None,
        problems: Any = None,
    ) -> None:
        self.base = example if matrices is None else None
        self.P, self.G, self.A = matrices or (example.P, example.G, example.A)
        self.rows, self.constant, self.problems = rows, constant, problems
        self.count, self.sizes = len(rows["c"]), example.matrices.sizes

    @classmethod
    def of(
        cls, programs: Sequence[QuadraticProgram | LCPError], example: QuadraticProgram
    ) -> ProgramBatch | None:
        """Return checked programs of one shape as a batch; None if their shapes differ, or they need too much memory.

        Parameters
        ----------
        programs : sequence of QuadraticProgram or LCPError
            An error replaces an invalid program; accessing this program raises it.
        example : QuadraticProgram
            Program of the same shape.
        """
        m, p, n, _ = sizes = example.matrices.sizes
        stated = [example if isinstance(item, LCPError) else item for item in programs]
        is_shared = all(item.matrices is example.matrices for item in stated)
        if any(item.matrices.sizes != sizes for item in stated):
            return None
        if not (is_shared or may_be_small(n, m + p, [n * (n + m + p)])):
            return None
        rows = vectors_of(stated, (*VECTORS, "constant"))
        is_invalid = [isinstance(item, LCPError) for item in programs]
        for row in rows.values():
            row[is_invalid] = np.nan
        stacks = ([as_array(getattr(item, name)) for item in stated] for name in "PGA")
        matrices = None if is_shared else [*map(np.array, stacks)]
        return cls(example, rows, rows.pop("constant"), matrices, programs)

    @classmethod
    def with_costs(cls, program: QuadraticProgram, c: ArrayLike) -> ProgramBatch:
        """Return the program with each c, shape (B, n).

        Raises
        ------
        InvalidProblem
            If the shape does not fit.
        """
        rows = vectors_of([program], VECTORS)
        return cls(program, rows | {"c": rows_of_a_batch(c, "c", program.n)}, program.constant)

    @property
    def n(self) -> int:
        """Number of variables of each."""
        return self.sizes[2]

    @property
    def points(self) -> Any:
        """The points of [lower, upper] nearest to 0, with multipliers NaN, shape (B, m + p + 3 n)."""
        m, p, n, _ = self.sizes
        points = np.full((self.count, m + p + 3 * n), np.nan)
        points[:, :n] = np.clip(0.0, self.rows["lower"], self.rows["upper"])
        return points

    def row(self, result: Any) -> Any:
        """Return the row of a result."""
        return np.concatenate([result.x, result.solution.multipliers])

    @property
    def arrays(self) -> tuple[Any, ...]:
        """P, c, C, d, lower and upper: C and d hold G and A, h and b.

        Matrices are of shape (B or 1, …), vectors (B, …), C-contiguous and read-only.
        """
        shapes = ((rows, (self.count, rows.shape[1])) for rows in self.rows.values())
        c, h, b, lower, upper = (np.broadcast_to(*row) for row in shapes)
        P, G, A = map(_stack, (self.P, self.G, self.A))
        data = P, c, np.concatenate([G, A], 1), np.concatenate([h, b], 1), lower, upper
        return tuple(read_only(np.ascontiguousarray(array)) for array in data)

    @property
    def may_be_stated(self) -> BoolVector:
        """Mask of the valid programs, shape (B,), as far as vectors show."""
        c, h, b, lower, upper = self.rows.values()
        is_finite = np.isfinite(c).all(axis=1) & np.isfinite(b).all(axis=1)
        is_stated = is_finite & (h > -np.inf).all(axis=1) & have_values(lower, upper)
        return np.broadcast_to(is_stated, self.count)

    def stacks(self, tolerance: float, has_time: object, threads: int) -> Stacks:
        """Yield small programs in blocks, some for each thread."""
        (m, p, n, _), count = self.sizes, self.count
        entries = max(n * (n + m + p), 1)
        if not (may_be_small(n, m + p, [entries]) and is_installed(ENGINE)):
            return
        data = self.arrays
        may = self.may_be_stated & _are_semidefinite(data[0])
        share = 1 if threads == 1 else 4 * threads  # blocks, so that threads end at the same time
        # Entries per evaluation of the criterion
        size = max(min(2**18 // entries, -(-count // share)), 1)
        for first in range(0, count, size):
            part = slice(first, first + size)
            parts = [array[part] if len(array) > 1 else array for array in data]
            items = np.arange(count)[part]
            yield items, partial(solve_programs, parts, m, may[part], tolerance)

    def tables(self, z: Array) -> dict[str, Any]:
        """Return x and the multipliers by name."""
        m, p, n, _ = self.sizes
        ends = np.cumsum([n, m, p, n])
        names = "x", "inequality", "equality", "lower", "upper"
        return dict(zip(names, np.split(z, ends, axis=1), strict=True))

    def objectives(self, z: Array) -> Any:
        """Return ½ xᵀP x + cᵀx + constant of each program."""
        P, c, x = self.P, self.rows["c"], z[:, : self.n]

        def values_of(P: AnyMatrix, c: Array, x: Array) -> Any:
            Px = (P @ x.T).T if sp.issparse(P) else np.matmul(P, x[:, :, np.newaxis])[:, :, 0]
            return ((0.5 * Px + c) * x).sum(axis=1)

        values, terms = values_of(P, c, x), values_of(abs(P), np.abs(c), np.abs(x))
        values = values + self.constant
        for i in np.flatnonzero(x.shape[1] * EPSILON * terms > CANCELS * np.abs(values)).tolist():
            values[i] = self[i].objective(x[i])  # where terms cancel
        senses = [getattr(item, "sense", 1.0) for item in self.problems or (self.base,)]
        return np.array(senses) * values


def programs_for(program: QuadraticProgram, vectors: Array) -> list[QuadraticProgram | LCPError]:
    """Return the program with each of many vectors, or what is wrong with these.

    Raises
    ------
    InvalidProblem
        If it is not a sequence of mappings from the names of vectors.
    """
    if isinstance(vectors, Mapping) or not isinstance(vectors, Sequence):
        got = type(vectors).__name__
        raise InvalidProblem(
            f'a program takes c, shape (B, n), or a list of mappings, as [{{"b": b}}], got {got}'
        )
    programs: list[QuadraticProgram | LCPError] = []
    for k, entry in enumerate(vectors):
        unknown = set(entry) - {*VECTORS} if isinstance(entry, Mapping) else {type(entry).__name__}
        if unknown:
            raise InvalidProblem(
                f"entry {k} must map some of {', '.join(sorted(VECTORS))} to vectors, got {min(unknown)!r}"
            )
        try:
            programs.append(program.with_vectors(**entry))
        except LCPError as error:
            programs.append(error)
    return programs


def solve_programs(
    data: Sequence[Any], m: int, may: BoolVector, tolerance: float
) -> tuple[Any, Any, Any, Any]:
    """Run the engine on each of these programs, and test each point, except of programs with several components.

    Returns
    -------
    rows, residual, iterations, is_solved : array, shapes (B, m + p + 3 n) and (B,)
        x with all multipliers, the largest error measure, and which are SOLVED.
    """
    P, c, C, d, lower, upper = data
    (count, n), wanted = c.shape, np.flatnonzero(may)
    signed, steps = np.full((count, n + d.shape[1]), np.nan), np.zeros(count, np.int64)
    x: Array = np.full((count, n), np.nan)
    hessians, matrices, costs = (np.array(array, order="C") for array in (P, C, c))
    has_P = P.any()
    kinds, settings = kinds_of_rows(n, m, d.shape[1] - m), DAQP.defaults | PROXIMAL_OPTIONS
    above, below = ends_of_rows(d, m, lower, upper)
    for k in wanted.tolist():
        hessian = hessians[k % len(P)] if has_P else None
        data = matrices[k % len(C)], kinds, costs[k], above[k], below[k], settings
        x[k], signed[k], _, steps[k] = call_daqp(hessian, *data)
    y = signed[:, n:]
    y[:, :m] = np.maximum(y[:, :m], 0.0)
    at_lower = np.maximum(-signed[:, :n], 0.0) * np.isfinite(lower)
    at_upper = np.maximum(signed[:, :n], 0.0) * np.isfinite(upper)
    x = np.clip(x, lower, upper)
    terms = [ProgramTerms(*pair, m) for pair in zip(P, C, strict=True)]
    measured, is_one = np.full((count, 2), np.inf), [part.components.number == 1 for part in terms]
    finite = wanted[np.isfinite(x[wanted]).all(1)]
    first = finite[np.broadcast_to(is_one, count)[finite]]
    if first.size >= LOOP_FROM and has_numba():
        both, found = np.concatenate((P, C), axis=1), np.empty((first.size, 2))
        both = both if len(both) == 1 else both[first]
        each = (array[first] for array in (c, d, lower, upper, x, y))
        measure_many(both, m, *each, found)
        measured[first] = found
    for k in finite[~KKTErrors(*measured[finite].T).meet(tolerance)].tolist():
        judged = JudgedProgram(terms[k % len(terms)], c[k], d[k], lower[k], upper[k])
        measured[k], x[k] = KKTErrors.with_point(judged, x[k], y[k], tolerance)
    errors = KKTErrors(*measured.T)
    rows = np.hstack([x, y, at_lower, at_upper])
    return rows, errors.largest, steps, errors.meet(tolerance)


def _stack(matrices: object) -> Any:
    dense = np.ascontiguousarray(as_array(matrices))
    return dense if dense.ndim == 3 else dense[np.newaxis]


def _are_semidefinite(P: AnyMatrix) -> Any:
    """Return a mask of positive semidefinite P up to rounding error, shape (B or 1,)."""
    if not P.any():
        return np.ones(len(P), np.bool_)
    is_finite = np.isfinite(P).all(axis=(1, 2))
    values = np.linalg.eigvalsh(np.where(is_finite[:, np.newaxis, np.newaxis], P, 0.0))
    return is_finite & (values[:, 0] >= -FEW_ROUNDINGS * P.shape[1] * np.abs(values[:, -1]))
