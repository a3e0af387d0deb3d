"""A smooth map as a short program: levels of elementary functions between sparse matrices.

A level takes linear combinations of all previous quantities, beginning with the unknowns, and applies elementary
functions to thousands of them at once. The result is a linear combination of all quantities. Derivatives follow level
by level from the chain rule.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from .functions import Function
from .rows import Compiler, Indices, Rows, assembled


@dataclass(frozen=True, eq=False)
class Combination:
    """Linear combinations of quantities: matrix · quantities + offset.

    Attributes
    ----------
    matrix : CSR array, shape (m, k)
        Canonical: sorted, without duplicates.
    offset : ndarray, shape (m,)
    """

    matrix: sp.csr_array
    offset: FloatVector

    def __call__(self, quantities: FloatVector) -> FloatVector:
        """Return the combinations of these quantities."""
        values: FloatVector = self.matrix @ quantities
        values += self.offset
        return values


@dataclass(frozen=True, eq=False)
class Level:
    """Elementary functions of linear combinations; functions of two arguments come first.

    Attributes
    ----------
    arguments : tuple of Combination
        The first argument of every function, and the second of those that have one.
    spans : list of (Function, slice)
    """

    arguments: tuple[Combination, Combination]
    spans: list[tuple[Function, slice]]

    @property
    def size(self) -> int:
        """The number of functions."""
        return int(self.arguments[0].offset.size)

    def values(self, arguments: list[FloatVector]) -> FloatVector:
        """Return the values of the functions at the first and the second arguments."""
        result = np.empty_like(arguments[0])
        for function, span in self.spans:
            result[span] = function.value(*(u[span] for u in arguments[: function.arguments]))
        return result

    def derivatives(self, arguments: list[FloatVector]) -> list[FloatVector]:
        """Return the derivatives by the first and by the second arguments."""
        found = [np.empty_like(u) for u in arguments]
        for function, span in self.spans:
            slopes = function.derivatives(*(u[span] for u in arguments[: function.arguments]))
            for whole, slope in zip(found, slopes, strict=False):
                whole[span] = slope
        return found


class Program:
    """A map from n unknowns to m results, with its derivatives.

    Attributes
    ----------
    n : int
    levels : list of Level
    result : Combination

    Notes
    -----
    Outside the domain of F entries are NaN or infinite; nothing is raised. A value costs a product with each matrix, a
    gradient two, a Jacobian a product of sparse matrices for each level.
    """

    def __init__(self, n: int, levels: Sequence[Level], result: Combination) -> None:
        self.n, self.levels, self.result = n, list(levels), result
        ends = np.cumsum([n, *(level.size for level in levels)]).tolist()
        self._spans = [slice(*pair) for pair in pairwise(ends)]

    @classmethod
    def of(
        cls, compiler: Compiler, results: Sequence[Rows], first: Mapping[int, int], n: int
    ) -> Program:
        """Return the program with these rows, stacked, as results.

        Parameters
        ----------
        compiler : Compiler
            Compiler that created the rows.
        results : sequence of Rows
        first : mapping
            From the key of a source to the number of its first unknown.
        n : int
            The number of unknowns.
        """
        # Functions of two arguments first.
        groups = sorted(
            compiler.groups, key=lambda group: (group[0], len(group[2]) == 1, group[1].name)
        )
        numbers, count = dict(first), n
        for _, _, arguments, key in groups:
            numbers[key], count = count, count + arguments[0].size
        levels = []
        for level in sorted({group[0] for group in groups}):
            own = [group for group in groups if group[0] == level]
            both = [
                [arguments[k] for _, _, arguments, _ in own if len(arguments) > k] for k in (0, 1)
            ]
            first_of_two, second = (_combination(rows, numbers, count) for rows in both)
            levels.append(Level((first_of_two, second), _spans(own)))
        return cls(n, levels, _combination(results, numbers, count))

    @property
    def size(self) -> int:
        """The number of results."""
        return int(self.result.offset.size)

    def rearranged(self, places: Indices, signs: FloatVector) -> Program:
        """Return the program whose result k is signs[k] times the result places[k] of this one."""
        matrix = sp.csr_array(sp.diags_array(signs) @ self.result.matrix[places])
        return Program(self.n, self.levels, Combination(matrix, signs * self.result.offset[places]))

    def value(self, x: FloatVector) -> FloatVector:
        """Return F(x), shape (m,)."""
        with np.errstate(all="ignore"):
            return self.result(self._swept(x)[0])

    def jacobian(self, x: FloatVector) -> sp.csr_array:
        """Return F′(x) as CSR, shape (m, n)."""
        with np.errstate(all="ignore"):
            known = sp.eye_array(self.n, format="csr")  # of all quantities so far
            for level, values in zip(self.levels, self._swept(x)[1], strict=True):
                own = _weighted(
                    level.arguments, level.derivatives(values), level.size, known.shape[0]
                )
                known = sp.vstack([known, own @ known], format="csr")
            return sp.csr_array(self.result.matrix @ known)

    def gradient(self, x: FloatVector, by_result: FloatVector) -> FloatVector:
        """Return F′(x)ᵀ by_result without the Jacobian."""
        with np.errstate(all="ignore"):
            arguments, total = self._swept(x)[1], np.zeros(self._count)
            total += self.result.matrix.T @ by_result
            for level, span, values in zip(
                self.levels[::-1], self._spans[::-1], arguments[::-1], strict=True
            ):
                for slope, argument in zip(level.derivatives(values), level.arguments, strict=True):
                    total += argument.matrix.T @ (slope * total[span][: slope.size])
            return total[: self.n]

    @property
    def _count(self) -> int:
        return int(self.result.matrix.shape[1])

    def _swept(self, x: FloatVector) -> tuple[FloatVector, list[list[FloatVector]]]:
        """Return all quantities, and the arguments of each level."""
        quantities, arguments = np.zeros(self._count), []  # a level takes none that come after it
        quantities[: self.n] = x
        for level, span in zip(self.levels, self._spans, strict=True):
            arguments.append([argument(quantities) for argument in level.arguments])
            quantities[span] = level.values(arguments[-1])
        return quantities, arguments


def _spans(groups: list[Any]) -> list[tuple[Function, slice]]:
    spans: list[tuple[Function, slice]] = []
    start = 0
    for _, function, arguments, _ in groups:
        stop = start + arguments[0].size
        if spans and spans[-1][0] is function:
            spans[-1] = (function, slice(spans[-1][1].start, stop))
        else:
            spans.append((function, slice(start, stop)))
        start = stop
    return spans


def _combination(rows: Sequence[Rows], first: Mapping[int, int], count: int) -> Combination:
    matrix, offset = assembled(rows, first, count)
    if not (matrix.has_canonical_format and (matrix.data != 0.0).all()):
        matrix = matrix.copy()
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    return Combination(matrix, offset)


def _weighted(
    arguments: Sequence[Combination], slopes: Sequence[FloatVector], size: int, width: int
) -> sp.csr_array:
    """Return Σ slope · matrix over the arguments, their first columns; 0 times an infinite slope is NaN."""
    parts = [
        (argument.matrix.tocoo(), slope) for argument, slope in zip(arguments, slopes, strict=True)
    ]
    data = np.concatenate([slope[one.row] * one.data for one, slope in parts])
    rows, columns = (
        np.concatenate([getattr(one, name) for one, _ in parts]) for name in ("row", "col")
    )
    return sp.csr_array(sp.coo_array((data, (rows, columns)), shape=(size, width)))
