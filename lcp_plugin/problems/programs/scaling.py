"""Scaling of a quadratic program: what its rows, its unknowns and its objective are measured in.

Nobody's answer may depend on whether he writes euros or millions. So each row is measured in its largest coefficient,
and the objective in the size that most of its coefficients have; both follow wherever rows and the objective are
multiplied. Unknowns keep the user's unit unless the data show others: rows and columns of

    [A b], [P c], and [1 bound] for each bound

are fitted to each other (Curtis, Reid; :mod:`lcp_plugin.core.matrix.scaling`), exact powers of two, where the columns
of A and P, or b, c and bounds beside them, are of sizes that differ by more than 2⁸ on average. The column of b, c and
bounds says how large unknowns are. Where these exponents lie within 2⁸ of each other all unknowns get the one in their
middle: multigrid interpolates what is constant in one unit, and an elastic body in newtons and metres is one grid.

Where numbers are far from 1, the scaled program is solved (`Rescaled`), and its answer brought back as that
of a step of a reduction is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, assembled, read_only
from ...core.matrix.matrix import largest_in_rows
from ...core.matrix.scaling import ALIKE, fitted_columns
from ...core.matrix.structure import row_numbers
from ...proofs.exact.rational import like
from .program_matrices import Exponents, ProgramMatrices, as_csr, curved_part, exponents_of, or_one, vertically
from .reductions import Step

if TYPE_CHECKING:
    from .program import QuadraticProgram

MOST = 900  # no exponent is larger in size
FAR = 16  # log2 of an objective, or of a row's coefficients: linear programs and pivots have tolerances of their own


class ProgramScaling(NamedTuple):
    """Scaling of rows, unknowns and objective of a program.

    Attributes
    ----------
    coefficient : ndarray
        The largest |coefficient| of each constraint times the unit of its unknown; 1 where there is none.
    unknown : ndarray, shape (n,)
        Powers of two; the last coefficients, those of bounds, are the same.
    objective, least : float
        What most costs are near, and the smallest one: powers of two.
    leaves_unknowns : bool
        Whether unknowns are left in the unit that they are given in.
    """

    coefficient: FloatVector
    unknown: FloatVector
    objective: float
    least: float
    leaves_unknowns: bool

    @classmethod
    def of(cls, program: QuadraticProgram) -> ProgramScaling:
        """Return those of a program."""
        exponents = _fitted(program)
        if exponents is not None and np.ptp(exponents) <= ALIKE:
            # One unit for all: a grid whose neighbours had others would be none.
            exponents = np.full_like(exponents, (exponents.max() + exponents.min()) // 2)
        return cls.of_unknowns(program, None if exponents is None else np.ldexp(1.0, exponents))

    @classmethod
    def of_unknowns(cls, program: QuadraticProgram, unknown: FloatVector | None) -> ProgramScaling:
        """Return those of a program whose unknowns are measured in these; None: as the user has them."""
        diagonal = program.matrices.diagonal
        with np.errstate(over="ignore"):
            costs = (program.c, diagonal) if unknown is None else (program.c * unknown, diagonal * unknown * unknown)
        if unknown is None or not np.isfinite(costs).all():  # beyond the range of doubles no objective is measured
            size, least = objective_sizes(program.c, diagonal).tolist()
            return cls(program.matrices.row_sizes, np.ones(program.n), size, least, True)
        rows = program.matrices.rows
        of_rows = or_one(largest_in_rows(rows, np.abs(rows.data) * unknown[rows.indices]))
        size, least = objective_sizes(*costs).tolist()
        return cls(np.concatenate([of_rows, unknown, unknown]), unknown, size, least, False)

    def of_rows(self, left: Any) -> ProgramScaling:
        """Return those of the same program with these of its rows, the others put into its bounds."""
        bounds = self.coefficient[self.coefficient.size - 2 * self.unknown.size :]  # none without unknowns
        return self._replace(coefficient=np.concatenate([self.coefficient[left], bounds]))

    def of_unknowns_left(self, left: Any) -> ProgramScaling:
        """Return those of the same program in these of its unknowns, the others put in."""
        rows = self.coefficient[: -2 * self.unknown.size]
        unknown = self.unknown[left]
        return self._replace(coefficient=np.concatenate([rows, unknown, unknown]), unknown=unknown)


def objective_sizes(c: Any, diagonal: Any) -> Any:
    """Return powers of two: what most |c_j| are near, or most p_jj if these are larger, and the smallest |c_j|.

    Shapes (…, n) to (…, 2); 1 where all are 0. The first is an average of exponents. Neither one huge coefficient nor
    rounding in the place of zeros changes it much, nor does such rounding the second.

    Examples
    --------
    >>> objective_sizes(np.array([[3e6, 2e3, 0.0], [0.0, 1e-9, 1e-25]]), np.zeros(3)).tolist()
    [[32768.0, 1024.0], [9.313225746154785e-10, 9.313225746154785e-10]]
    """
    from .kernels.entry_sizes import objective_exponents  # numba, which not every run needs

    exponents = np.empty((*c.shape[:-1], 2))
    objective_exponents(*(np.atleast_2d(one) for one in (c, diagonal, exponents)))
    return np.ldexp(1.0, exponents.astype(np.int64))


def size_of_unknowns(
    exponents: Exponents, is_equality: Any, limits: Any, c: Any, lower: Any, upper: Any
) -> tuple[Any, Any]:
    """Return how large unknowns are in log2, on average, and which of the limits, costs, and bounds say so.

    Shapes (m,) and (count, m) and (count, n) to (count,) and (count, m + 3n); ∞ where nothing says so.
    """
    from .kernels.entry_sizes import sizes_of_unknowns  # numba, which not every run needs

    sizes, say = np.empty(len(c)), np.empty((len(c), limits.shape[1] + 3 * c.shape[1]), np.bool_)
    sizes_of_unknowns(exponents.of_rows, exponents.of_hessian, is_equality, limits, c, lower, upper, sizes, say)
    return sizes, say


def scaling_of_stacks(
    P: Any, c: Any, C: Any, d: Any, is_equality: Any, lower: Any, upper: Any
) -> tuple[Any, Any]:
    """Return the sizes of the objectives of a batch of dense programs, and where unknowns keep the user's units.

    Shapes (1 or count, rows, n) of the matrices and (count, size) of the vectors to (count,).
    """
    diagonal = np.ascontiguousarray(np.diagonal(P, axis1=1, axis2=2))
    exponents = exponents_of(C, curved_part(P, diagonal))
    size, _ = size_of_unknowns(exponents, is_equality, d, c, lower, upper)
    return objective_sizes(c, diagonal), (exponents.spread <= ALIKE) & (np.abs(size) <= ALIKE)


def _fitted(program: QuadraticProgram) -> Any:
    """Return the exponents that scale the unknowns, None where all stay the user's."""
    matrices, n = program.matrices, program.n
    limits, spread = np.concatenate([program.h, program.b]), float(matrices.exponents.spread[0])
    vectors = (one[np.newaxis] for one in (limits, program.c, program.lower, program.upper))
    (size,), (say,) = size_of_unknowns(matrices.exponents, matrices.is_equality[: limits.size], *vectors)
    if (spread <= ALIKE and abs(size) <= ALIKE) or not np.isfinite([spread, size]).all():
        return None
    identity = sp.eye_array(n, format="csr")
    matrix = vertically(matrices.rows, as_csr(matrices.curved), identity, identity)
    column = np.where(say, np.concatenate([limits, program.c, program.lower, program.upper]), 0.0)
    of_costs = slice(limits.size, limits.size + n)
    is_relative = bool(say[of_costs].any())  # minima of rows of P are of all unknowns together: one may be an outlier
    column[of_costs] = 0.0
    is_used = say | (np.arange(column.size) < column.size - 2 * n)
    exponents = fitted_columns(sp.csr_array(sp.hstack([matrix, column[:, np.newaxis]], format="csr"))[is_used])
    unknown = exponents[:-1] - exponents[-1]
    is_alone = (np.bincount(matrix.indices, minlength=n) == 2) & ~say[-2 * n :].reshape(2, n).any(axis=0)
    if 0 < np.count_nonzero(is_alone) < n:  # in no row, nor in P: no unit but that of the others
        unknown[is_alone] = np.floor(unknown[~is_alone].mean())
    if is_relative:
        unknown += np.int64(np.floor(size)) - np.int64(np.floor(unknown.mean()))
    unknown = np.clip(unknown, -MOST, MOST)
    return unknown if np.abs(unknown).max(initial=0) > ALIKE else None


@dataclass(frozen=True, eq=False)
class Rescaled(Step):
    """A scaled program: powers of two, so that no number is rounded.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        As it was stated, and scaled.
    of_x, of_multipliers : ndarray, shapes (n,) and (m + p + 2n,)
        What x and the multipliers of the latter are multiplied by.
    of_rows : ndarray, shape (m + p + 2n,)
        What its rows were divided by.
    """

    of_x: FloatVector
    of_multipliers: FloatVector
    of_rows: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> Rescaled | None:
        """Return that of a program; None where its numbers are near 1 as they are.

        None, too, where it has bounds alone and a positive diagonal of P: a complementarity problem in any unit.
        """
        if program.matrices.sizes[:2] == (0, 0) and (program.matrices.diagonal > 0.0).all():
            return None
        coefficient, unknown, objective, _, leaves_unknowns = program.scaling
        m, p = program.matrices.sizes[:2]
        far, of_matrices = 2.0**FAR, coefficient[: m + p]
        is_near = 1.0 / far <= objective <= far and of_matrices.max(initial=1.0) < 2.0 * far
        if leaves_unknowns and is_near and of_matrices.min(initial=1.0) >= 1.0 / far:
            return None
        rows = np.ldexp(1.0, np.frexp(coefficient)[1] - 1)
        with np.errstate(over="ignore", under="ignore"):
            matrices = ProgramMatrices(
                _scaled(program.P, unknown / objective, unknown), _scaled(program.G, 1.0 / rows[:m], unknown),
                _scaled(program.A, 1.0 / rows[m : m + p], unknown),
            )
            vectors = (program.c * unknown / objective, program.h / rows[:m], program.b / rows[m : m + p],
                       program.lower / unknown, program.upper / unknown)
        stored = [as_csr(one).data for one in (matrices.P, matrices.G, matrices.A)]
        given = (program.c, program.h, program.b, program.lower, program.upper)
        was_finite, is_finite = (np.isfinite(np.concatenate(numbers)) for numbers in (given, vectors))
        if not np.isfinite(np.concatenate(stored)).all() or (was_finite != is_finite).any():
            return None
        made = program.with_matrices(matrices, *map(read_only, vectors))
        made.__dict__.update(asymmetry=0.0, ranges=None, rescaled=None)
        return cls(program, made, unknown, objective / rows, rows)

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and multipliers in the program's own scaling."""
        return x / self.of_x, multipliers / self.of_multipliers

    def point(self, x: Any, *, is_direction: bool = False) -> Any:
        """Return x in the units in which the program was stated."""
        with np.errstate(over="ignore"):
            return x * like(self.of_x, x)

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return multipliers likewise; of those that contradict each other the size of no objective is a part."""
        with np.errstate(over="ignore"):
            return reduced * (like(1.0 / self.of_rows, reduced) if x is None else self.of_multipliers)

    def proof(self, found: Any) -> Any:
        """Return the same proof of the given program; where a radius is too small in its units, the one in its own."""
        return super().proof(found) or found


def _scaled(matrix: Any, rows: FloatVector, columns: FloatVector) -> Any:
    """Return diag(rows) · matrix · diag(columns), of the same kind."""
    if not sp.issparse(matrix):
        return read_only(matrix * rows[:, np.newaxis] * columns)
    data = matrix.data * rows[row_numbers(matrix)] * columns[matrix.indices]
    return assembled(data, matrix.indices, matrix.indptr, matrix.shape)
