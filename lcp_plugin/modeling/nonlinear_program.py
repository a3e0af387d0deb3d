"""A smooth map as a short program: levels of elementary functions between sparse matrices.

A level takes linear combinations of all quantities before it, the unknowns first, and puts elementary functions on
them, thousands at once. The result is a linear combination of everything. What a derivative is made of never changes
its place: the entries of the Jacobian are kept as one vector of numbers, and a level maps those before it to its own by
a sparse matrix and the factors of the chain rule, so that no pattern is computed twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from .nonlinear_intervals import EnclosedProduct, Interval, added, multiplied
from .nonlinear_rules import Rule

Indices = NDArray[np.int64]


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
        """Return the combinations of these quantities, of which there may be more."""
        values: FloatVector = self.matrix @ quantities[: self.matrix.shape[1]] + self.offset
        return values

    @cached_property
    def _enclosed(self) -> EnclosedProduct:
        return EnclosedProduct(self.matrix)

    def enclosed(self, quantities: Interval) -> Interval:
        """Return intervals of the combinations."""
        count = self.matrix.shape[1]
        return self._enclosed((quantities[0][:count], quantities[1][:count]), self.offset)


@dataclass(frozen=True, eq=False)
class Level:
    """Elementary functions of linear combinations; those of two arguments come first.

    Attributes
    ----------
    arguments : tuple of Combination
        The first argument of every function, and the second of those that have one.
    spans : list of (Rule, slice)
    """

    arguments: tuple[Combination, Combination]
    spans: list[tuple[Rule, slice]]

    @property
    def size(self) -> int:
        """The number of functions."""
        return int(self.arguments[0].offset.size)

    def values(self, first: FloatVector, second: FloatVector) -> FloatVector:
        """Return the values of the functions."""
        result = np.empty(self.size)
        for rule, span in self.spans:
            result[span] = rule.value(*(u[span] for u in (first, second)[: rule.arguments]))
        return result

    def derivatives(self, first: FloatVector, second: FloatVector) -> list[FloatVector]:
        """Return the derivatives by the first and by the second arguments."""
        found = [np.empty(first.size), np.empty(second.size)]
        for rule, span in self.spans:
            slopes = rule.derivatives(*(u[span] for u in (first, second)[: rule.arguments]))
            for whole, slope in zip(found, slopes, strict=False):
                whole[span] = slope
        return found

    def intervals(self, first: Interval, second: Interval) -> Interval:
        """Return intervals of the values."""
        lower, upper = np.empty(self.size), np.empty(self.size)
        for rule, span in self.spans:
            arguments = ((u[0][span], u[1][span]) for u in (first, second)[: rule.arguments])
            lower[span], upper[span] = rule.interval(*arguments)
        return lower, upper

    def interval_derivatives(self, first: Interval, second: Interval) -> list[Interval]:
        """Return intervals of the derivatives by the first and by the second arguments."""
        found = [(np.empty(u[0].size), np.empty(u[0].size)) for u in (first, second)]
        for rule, span in self.spans:
            arguments = ((u[0][span], u[1][span]) for u in (first, second)[: rule.arguments])
            for whole, slope in zip(found, rule.interval_derivatives(*arguments), strict=False):
                whole[0][span], whole[1][span] = slope
        return found


class Program:
    """A map from n unknowns to m results, with its sparse Jacobian and with intervals of both.

    Parameters
    ----------
    n : int
    levels : list of Level
    result : Combination

    Notes
    -----
    Outside the domain of F entries are NaN or infinite; nothing is raised. A value costs a product with each matrix, a
    Jacobian one with each of the matrices that :class:`_Pattern` holds.
    """

    def __init__(self, n: int, levels: Sequence[Level], result: Combination) -> None:
        self.n, self._levels, self._result = n, list(levels), result

    @property
    def size(self) -> int:
        """The number of results."""
        return int(self._result.offset.size)

    def rearranged(self, places: Indices, signs: FloatVector) -> Program:
        """Return the program whose result k is signs[k] times the result places[k] of this one."""
        matrix = sp.csr_array(sp.diags_array(signs) @ self._result.matrix[places])
        return Program(self.n, self._levels, Combination(matrix, signs * self._result.offset[places]))

    def value(self, x: FloatVector) -> FloatVector:
        """Return F(x), shape (m,)."""
        with np.errstate(all="ignore"):
            return self._result(self._quantities(x))

    def _quantities(self, x: FloatVector) -> FloatVector:
        quantities = np.empty(self._result.matrix.shape[1])
        quantities[: self.n] = x
        start = self.n
        for level in self._levels:
            stop = start + level.size
            quantities[start:stop] = level.values(*(argument(quantities) for argument in level.arguments))
            start = stop
        return quantities

    def jacobian(self, x: FloatVector) -> sp.csr_array:
        """Return F′(x) as CSR, shape (m, n), its pattern the same for every x; its indices are not to be changed."""
        with np.errstate(all="ignore"):
            quantities = self._quantities(x)
            entries = np.ones(self._patterns[-1].stop)
            for level, pattern in zip(self._levels, self._patterns, strict=False):
                slopes = level.derivatives(*(argument(quantities) for argument in level.arguments))
                own = [combined(entries) for combined in pattern.combined]
                own[0] *= pattern.repeated(slopes[0])
                own[0][: own[1].size] += pattern.repeated(slopes[1]) * own[1]
                entries[pattern.start : pattern.stop] = own[0]
            last = self._patterns[-1]
            return last.matrix(last.combined[0](entries))

    def interval_F(self, lower: FloatVector, upper: FloatVector) -> Interval:
        """Return an interval that contains F(x) for every x in [lower, upper], the program's numbers being exact."""
        with np.errstate(all="ignore"):
            return self._result.enclosed(self._interval_quantities(lower, upper))

    def _interval_quantities(self, lower: FloatVector, upper: FloatVector) -> Interval:
        ends = np.empty((2, self._result.matrix.shape[1]))
        ends[0, : self.n], ends[1, : self.n] = lower, upper
        start = self.n
        for level in self._levels:
            stop = start + level.size
            arguments = (argument.enclosed((ends[0], ends[1])) for argument in level.arguments)
            ends[0, start:stop], ends[1, start:stop] = level.intervals(*arguments)
            start = stop
        return ends[0], ends[1]

    def interval_jacobian(self, lower: FloatVector, upper: FloatVector) -> tuple[sp.csr_array, sp.csr_array]:
        """Return lower and upper ends of F′(x) for every x in [lower, upper], on the pattern of the Jacobian."""
        with np.errstate(all="ignore"):
            quantities = self._interval_quantities(lower, upper)
            ends = np.ones((2, self._patterns[-1].stop))
            for level, pattern in zip(self._levels, self._patterns, strict=False):
                slopes = level.interval_derivatives(*(a.enclosed(quantities) for a in level.arguments))
                first, second = (combined.enclosed((ends[0], ends[1])) for combined in pattern.combined)
                first = multiplied(pattern.repeated_ends(slopes[0]), first)
                count = second[0].size
                with_second = added(
                    (first[0][:count], first[1][:count]), multiplied(pattern.repeated_ends(slopes[1]), second)
                )
                first[0][:count], first[1][:count] = with_second
                ends[:, pattern.start : pattern.stop] = first
            last = self._patterns[-1]
            lowest, highest = last.combined[0].enclosed((ends[0], ends[1]))
            return last.matrix(lowest), last.matrix(highest)

    @cached_property
    def _patterns(self) -> list[_Pattern]:
        """The patterns of the levels' Jacobians, and that of the result's."""
        rows = sp.csr_array((np.arange(self.n), np.arange(self.n), np.arange(self.n + 1)), shape=(self.n, self.n))
        known = _Places(rows.indptr.astype(np.int64), rows.indices.astype(np.int64))
        patterns = []
        for level in self._levels:
            patterns.append(_Pattern(known, level.arguments, self.n))
            known = known.extended(patterns[-1])
        nothing = Combination(sp.csr_array((0, self._result.matrix.shape[1])), np.zeros(0))
        patterns.append(_Pattern(known, (self._result, nothing), self.n))
        return patterns


@dataclass(frozen=True, eq=False)
class _Places:
    """Where the derivatives of the quantities are: of quantity k by the unknowns indices[indptr[k] : indptr[k + 1]]."""

    indptr: Indices
    indices: Indices

    def extended(self, pattern: _Pattern) -> _Places:
        indptr = np.concatenate([self.indptr, self.indptr[-1] + pattern.indptr[1:]])
        return _Places(indptr, np.concatenate([self.indices, pattern.indices]))


class _Pattern:
    """The derivatives of some functions of combinations: which unknowns they have, and what their entries come from.

    Parameters
    ----------
    known : _Places
        Of the quantities before.
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
        self.start = int(known.indptr[-1])
        self.stop = self.start + keys.size
        counts = (keys.size, int(self.indptr[arguments[1].offset.size]))
        parts = np.split(np.ravel(where), [terms[0][0].size])
        self.combined = [
            _constant_apart(part, sources, factors, count, self.start, n)
            for part, (_, sources, factors), count in zip(parts, terms, counts, strict=True)
        ]
        self._n = n

    def repeated(self, values: FloatVector) -> FloatVector:
        """Return the number of each function once an entry of its derivative."""
        return np.repeat(values, self._lengths[: values.size])

    def repeated_ends(self, values: Interval) -> Interval:
        """Return the interval of each function once an entry of its derivative."""
        return self.repeated(values[0]), self.repeated(values[1])

    @cached_property
    def _index(self) -> tuple[Any, Any]:
        kind = np.int32 if max(self.indices.size, self._n) < 2**31 else np.int64
        return self.indices.astype(kind), self.indptr.astype(kind)

    def matrix(self, entries: FloatVector) -> sp.csr_array:
        """Return the entries as a sparse matrix."""
        return sp.csr_array((entries, *self._index), shape=(self.indptr.size - 1, self._n))


def _terms(known: _Places, matrix: sp.csr_array, n: int) -> tuple[Indices, Indices, FloatVector]:
    """Return of matrix · derivatives, term by term: the place in the result, the entry it comes from, the factor."""
    counts = np.diff(known.indptr)[matrix.indices]
    total = int(counts.sum())
    rows = np.repeat(np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), counts)
    before = np.cumsum(counts) - counts
    sources = np.repeat(known.indptr[matrix.indices] - before, counts) + np.arange(total)
    return rows * n + known.indices[sources], sources, np.repeat(matrix.data, counts)


def _constant_apart(
    places: Indices, sources: Indices, factors: FloatVector, count: int, before: int, n: int
) -> Combination:
    """Return the map of entries to entries; those of the unknowns themselves are 1, so that theirs are constants."""
    is_constant = sources < n
    offset = np.zeros(count)
    offset[places[is_constant]] = factors[is_constant]  # one term an entry: the combinations hold no unknown twice
    entries = (factors[~is_constant], (places[~is_constant], sources[~is_constant]))
    return Combination(sp.csr_array(sp.coo_array(entries, shape=(count, before))), offset)
