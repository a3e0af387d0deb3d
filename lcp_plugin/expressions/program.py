"""A smooth map as a short program: levels of elementary functions between sparse matrices.

A level takes linear combinations of all previous quantities, beginning with the unknowns, and applies elementary
functions to thousands of them at once. The result is a linear combination of all quantities. The sparsity of a
derivative never changes, so the entries of the Jacobian are stored as one vector. A level maps the previous entries to
its entries by a sparse matrix and the factors of the chain rule, so that no pattern is computed twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
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
    change or a gradient two, a Jacobian one with each of the matrices that :class:`_Pattern` holds.
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

    def quantities(self, x: FloatVector) -> FloatVector:
        """Return the unknowns and the values of all functions, level by level."""
        return self._swept(x)[0]

    def rearranged(self, places: Indices, signs: FloatVector) -> Program:
        """Return the program whose result k is signs[k] times the result places[k] of this one."""
        matrix = sp.csr_array(sp.diags_array(signs) @ self.result.matrix[places])
        return Program(self.n, self.levels, Combination(matrix, signs * self.result.offset[places]))

    def value(self, x: FloatVector) -> FloatVector:
        """Return F(x), shape (m,)."""
        with np.errstate(all="ignore"):
            return self.result(self._swept(x)[0])

    def jacobian(self, x: FloatVector) -> sp.csr_array:
        """Return F′(x) as CSR, shape (m, n), with a constant pattern; do not change its indices."""
        return self._patterns[-1].matrix(self._derivative(x))

    def change(self, x: FloatVector, dx: FloatVector) -> FloatVector:
        """Return F′(x) dx without the Jacobian."""
        with np.errstate(all="ignore"):
            arguments, moved = self._swept(x)[1], np.zeros(self._count)
            moved[: self.n] = dx
            for level, span, values in zip(self.levels, self._spans, arguments, strict=True):
                first, second = (
                    slope * (argument.matrix @ moved)
                    for slope, argument in zip(
                        level.derivatives(values), level.arguments, strict=True
                    )
                )
                first[: second.size] += second
                moved[span] = first
            change: FloatVector = self.result.matrix @ moved
            return change

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

    def _derivative(self, x: FloatVector) -> FloatVector:
        """Return the entries of the Jacobian."""
        with np.errstate(all="ignore"):
            entries, arguments = np.ones(self._patterns[-1].stop), self._swept(x)[1]
            for level, pattern, values in zip(self.levels, self._patterns, arguments, strict=False):
                first, second = (
                    pattern.repeated(slope) * combined(entries[: pattern.start])
                    for slope, combined in zip(
                        level.derivatives(values), pattern.combined, strict=True
                    )
                )
                first[: second.size] += second
                entries[pattern.start : pattern.stop] = first
            last = self._patterns[-1]
            return last.combined[0](entries[: last.start])

    @cached_property
    def _patterns(self) -> list[_Pattern]:
        """The sparsity patterns of the levels' Jacobians, and of the result's Jacobian."""
        rows = sp.csr_array(
            (np.arange(self.n), np.arange(self.n), np.arange(self.n + 1)), shape=(self.n, self.n)
        )
        known = rows.indptr.astype(np.int64), rows.indices.astype(np.int64)
        patterns = []
        for level in self.levels:
            patterns.append(_Pattern(known, level.arguments, self.n))
            indptr = np.concatenate([known[0], known[0][-1] + patterns[-1].indptr[1:]])
            known = indptr, np.concatenate([known[1], patterns[-1].indices])
        nothing = Combination(sp.csr_array((0, self.result.matrix.shape[1])), np.zeros(0))
        patterns.append(_Pattern(known, (self.result, nothing), self.n))
        return patterns


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


#: Sparsity of the derivatives: quantity k depends on the unknowns indices[indptr[k] : indptr[k + 1]].
_Places = tuple[Indices, Indices]


class _Pattern:
    """Sparsity pattern of the derivatives of functions of combinations, and the sources of its entries.

    Parameters
    ----------
    known : _Places
        Pattern of the previous quantities.
    arguments : pair of Combination
        The functions with a second argument come first; both have the entries that either has.
    n : int
    """

    def __init__(self, known: _Places, arguments: tuple[Combination, Combination], n: int) -> None:
        size = arguments[0].offset.size
        terms = [_terms(known, argument.matrix, n) for argument in arguments]
        keys, where = np.unique(np.concatenate([keys for keys, _, _ in terms]), return_inverse=True)
        rows, self.indices = keys // n if n else keys, keys % n if n else keys
        self._lengths = np.bincount(rows, minlength=size)
        self.indptr: Indices = np.concatenate([[0], np.cumsum(self._lengths)]).astype(np.int64)
        self.start = int(known[0][-1])
        self.stop = self.start + keys.size
        counts = (keys.size, int(self.indptr[arguments[1].offset.size]))
        parts = np.split(np.ravel(where), [terms[0][0].size])
        self.combined = [
            _constant_apart(part, sources, factors, count, self.start, n)
            for part, (_, sources, factors), count in zip(parts, terms, counts, strict=True)
        ]
        self._n = n

    def repeated(self, values: FloatVector) -> FloatVector:
        """Return the values of functions, each repeated once per entry of its derivative."""
        return np.repeat(values, self._lengths[: values.size])

    @cached_property
    def _index(self) -> tuple[Any, Any]:
        kind = np.int32 if max(self.indices.size, self._n) < 2**31 else np.int64
        return self.indices.astype(kind), self.indptr.astype(kind)

    def matrix(self, entries: FloatVector) -> sp.csr_array:
        """Return the entries as a sparse matrix."""
        return sp.csr_array((entries, *self._index), shape=(self.indptr.size - 1, self._n))


def _terms(known: _Places, matrix: sp.csr_array, n: int) -> tuple[Indices, Indices, FloatVector]:
    """Return the terms of matrix · derivatives: result indices, source entries, coefficients."""
    indptr, indices = known
    counts = np.diff(indptr)[matrix.indices]
    total = int(counts.sum())
    rows = np.repeat(np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), counts)
    before = np.cumsum(counts) - counts
    sources = np.repeat(indptr[matrix.indices] - before, counts) + np.arange(total)
    return rows * n + indices[sources], sources, np.repeat(matrix.data, counts)


def _constant_apart(
    places: Indices, sources: Indices, factors: FloatVector, count: int, before: int, n: int
) -> Combination:
    """Return the map of entries to entries; derivatives of the unknowns are 1, so their terms are constants."""
    is_constant = sources < n
    offset = np.zeros(count)
    offset[places[is_constant]] = factors[
        is_constant
    ]  # one term an entry: the combinations hold no unknown twice
    entries = (factors[~is_constant], (places[~is_constant], sources[~is_constant]))
    return Combination(sp.csr_array(sp.coo_array(entries, shape=(count, before))), offset)
