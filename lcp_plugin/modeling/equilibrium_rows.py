"""Unknowns, rows, pairs, integers and an objective, whatever language stated them, as an equilibrium program."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..problems.equilibria.equilibrium_program import EquilibriumProgram, SmoothPart
from ..problems.programs.program import QuadraticProgram
from .expressions import functions
from .expressions.program import Program
from .expressions.rows import Compiler, Indices, Rows, as_matrix, assembled


class EquilibriumRows:
    """What a model says, row by row.

    Parameters
    ----------
    compiler : Compiler
        That made the rows.
    first : dict
        From the key of a source to the number of its first unknown.
    lower, upper : ndarray, shape (count,)
        Bounds of the unknowns.
    integers : ndarray of int
        Those that are whole numbers.
    """

    def __init__(
        self,
        compiler: Compiler,
        first: dict[int, int],
        lower: FloatVector,
        upper: FloatVector,
        integers: Indices,
    ) -> None:
        self.compiler, self.first, self.lower, self.upper = compiler, dict(first), lower, upper
        self.integers = integers
        self._rows: list[tuple[Rows, FloatVector, FloatVector]] = []
        self._pairs: list[tuple[Indices, Indices, FloatVector, FloatVector]] = []

    @property
    def count(self) -> int:
        """The number of unknowns."""
        return self.lower.size

    def constrain(self, rows: Rows, low: Any, high: Any) -> None:
        """Let low ≤ rows ≤ high."""
        ends = [np.broadcast_to(end, rows.size).astype(np.float64) for end in (low, high)]
        self._rows.append((rows, ends[0], ends[1]))

    def pair(
        self, z: Rows, w: Rows, low: FloatVector, high: FloatVector
    ) -> tuple[Indices, Indices]:
        """Let w ≥ 0 where z is low, ≤ 0 where it is high, 0 between; return the unknowns that are z and w."""
        sides = self.named(z), self.named(w)
        self._pairs.append((*sides, low, high))
        return sides

    def named(self, rows: Rows) -> Indices:
        """Return the unknowns that rows are: entries of the model's own, or new ones that equations define."""
        if not rows.level:
            matrix, offset = assembled([rows], self.first, self.count)
            is_plain = (
                matrix.nnz == rows.size
                and (np.diff(matrix.indptr) == 1).all()
                and (matrix.data == 1.0).all()
            )
            if is_plain and not offset.any():
                own: Indices = matrix.indices.astype(np.int64)
                return own
        key, free = 2**62 + self.count, np.full(rows.size, np.inf)
        columns = np.arange(self.count, self.count + rows.size)
        self.first[key] = self.count
        self.lower, self.upper = np.append(self.lower, -free), np.append(self.upper, free)
        blocks = {**rows.blocks, key: -1.0}
        self.constrain(Rows(blocks, rows.offset, (rows.size,), None, rows.level), 0.0, 0.0)
        return columns

    def program(
        self,
        objective: Rows,
        sign: float = 1.0,
        known: tuple[Any, FloatVector, float] | None = None,
    ) -> EquilibriumProgram:
        """Return the program: minimise sign · objective, of which ½ xᵀP x + cᵀx + r may be known as P, c, r."""
        n, goal = self.count, objective.scaled(sign)
        quadratic, smooth = self._quadratic(goal), None
        if known is not None:
            more = n - known[1].size
            P = sp.block_diag([sign * known[0], sp.csr_array((more, more))], format="csr")
            quadratic = P, np.append(sign * known[1], np.zeros(more)), sign * known[2]
        linear = [one for one in self._rows if not one[0].level]
        bent = [one for one in self._rows if one[0].level]
        if bent or quadratic is None:
            nothing = Rows({}, np.zeros(1), (1,))
            results = [goal if quadratic is None else nothing, *(rows for rows, _, _ in bent)]
            ends = (np.concatenate([*(one[k] for one in bent), np.zeros(0)]) for k in (1, 2))
            smooth = SmoothPart(Program.of(self.compiler, results, self.first, n), *ends)
        P, c, offset = quadratic or (sp.csr_array((n, n)), np.zeros(n), 0.0)
        A, shift = assembled([rows for rows, _, _ in linear], self.first, n)
        low, high = (
            np.concatenate([*(one[k] for one in linear), np.zeros(0)]) - shift for k in (1, 2)
        )
        program = QuadraticProgram.from_ranges(P, c, A, low, high, self.lower, self.upper)
        parts = [np.concatenate([*(one[k] for one in self._pairs), np.zeros(0)]) for k in range(4)]
        first, second = (part.astype(np.int64) for part in parts[:2])
        return EquilibriumProgram(
            program, first, second, parts[2], parts[3], offset, self.integers, smooth
        )

    def _quadratic(self, goal: Rows) -> tuple[sp.csr_array, FloatVector, float] | None:
        """Return P, c, r where the objective is ½ xᵀP x + cᵀx + r, None where it is something else."""
        n = self.count
        c, shift = np.zeros(n), float(goal.offset[0])
        half = sp.csr_array((n, n))
        for key, block in goal.blocks.items():
            weights = as_matrix(block, 1).toarray().ravel()
            if key in self.first:
                c[self.first[key] : self.first[key] + weights.size] += weights
                continue
            _, function, arguments, _ = self.compiler.groups[-1 - key]
            if function not in (functions.PRODUCT, functions.SQUARE) or any(
                one.level for one in arguments
            ):
                return None
            (A, a), (B, b) = (
                assembled([one], self.first, n) for one in (arguments[0], arguments[-1])
            )
            half = sp.csr_array(half + A.T @ sp.diags_array(weights) @ B)
            c += A.T @ (weights * b) + B.T @ (weights * a)
            shift += float(weights @ (a * b))
        return sp.csr_array(half + half.T), c, shift
