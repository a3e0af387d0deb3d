"""A program in its own units, and the way back: for those whose numbers are far from 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, assembled, read_only
from ...core.matrix.structure import row_numbers
from ...methods.presolve import like
from .program_matrices import ProgramMatrices, as_csr
from .reductions import Step

if TYPE_CHECKING:
    from .program import QuadraticProgram

FAR = 16  # log2 of an objective, or of a row's coefficients: linear programs and pivots have tolerances of their own


@dataclass(frozen=True, eq=False)
class Rescaled(Step):
    """A program in its own units: powers of two, so that no number is rounded.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        As it was stated, and in its own units.
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
        if program.matrices.sizes[:2] == (0, 0) and (program.P.diagonal() > 0.0).all():
            return None
        coefficient, unknown, objective, _, are_the_users = program.units
        rows = np.ldexp(1.0, np.frexp(coefficient)[1] - 1)
        far = 2.0**FAR
        of_matrices = rows[: program.constraints.rows]
        is_near = 1.0 / far <= objective <= far and of_matrices.max(initial=1.0) <= far
        if are_the_users and is_near and of_matrices.min(initial=1.0) >= 1.0 / far:
            return None
        m, p = program.matrices.sizes[:2]
        with np.errstate(over="ignore", under="ignore"):
            matrices = ProgramMatrices(
                _scaled(program.P, unknown / objective, unknown), _scaled(program.G, 1.0 / rows[:m], unknown),
                _scaled(program.A, 1.0 / rows[m : m + p], unknown),
            )
            vectors = (program.c * unknown / objective, program.h / rows[:m], program.b / rows[m : m + p],
                       program.lower / unknown, program.upper / unknown)
        stored = [as_csr(one).data for one in (matrices.P, matrices.G, matrices.A)]
        if not np.isfinite(np.concatenate([*stored, vectors[0], vectors[2]])).all() or np.isnan(vectors[1]).any():
            return None
        made = program.with_matrices(matrices, *map(read_only, vectors))
        made.__dict__.update(asymmetry=0.0, ranges=None, rescaled=None)
        return cls(program, made, unknown, objective / rows, rows)

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and multipliers in the program's own units."""
        return x / self.of_x, multipliers / self.of_multipliers

    def point(self, x: Any, *, is_direction: bool = False) -> Any:
        """Return x in the units in which the program was stated."""
        return x * like(self.of_x, x)

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return multipliers likewise; of those that contradict each other the size of no objective is a part."""
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
