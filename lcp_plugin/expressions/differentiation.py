"""Gradients of rows as rows: the derivative of levels of elementary functions consists of such levels again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.errors import UnsupportedModel
from . import functions
from .functions import Function
from .rows import Compiler, Rows, added

BY_UFUNC = {
    one.value: one for one in functions.FUNCTIONS.values() if isinstance(one.value, np.ufunc)
}


@dataclass(frozen=True, eq=False)
class Symbol:
    """Rows with the arithmetic of arrays, so that the derivatives of a `Function` apply to them unchanged."""

    compiler: Compiler
    rows: Rows

    def emit(self, function: Function, *others: Symbol) -> Symbol:
        """Return the function of the rows; constants are evaluated."""
        arguments = [self.rows, *(one.rows for one in others)]
        if not any(rows.blocks for rows in arguments):
            return self._of(Rows.of(function.value(*(rows.offset for rows in arguments))))
        return self._of(self.compiler.emit(function, *arguments))

    def _of(self, rows: Rows) -> Symbol:
        return Symbol(self.compiler, rows)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any) -> Symbol:
        """Return the elementary function that numpy's function is."""
        if ufunc not in BY_UFUNC:
            raise UnsupportedModel(
                f"the derivative of {ufunc.__name__} is not an elementary function here"
            )
        return self.emit(BY_UFUNC[ufunc], *inputs[1:])

    def __add__(self, other: Any) -> Symbol:
        parts = [
            self.rows,
            other.rows if isinstance(other, Symbol) else np.full(self.rows.size, other),
        ]
        return self._of(added(parts, self.rows.shape))

    def __mul__(self, other: Any) -> Symbol:
        if not isinstance(other, Symbol):
            return self._of(self.rows.scaled(other))
        first, second = (self, other) if other.rows.blocks else (other, self)
        if not first.rows.blocks:
            factor = first.rows.offset
            return self._of(second.rows.scaled(factor[0] if factor.size == 1 else factor))
        return self.emit(functions.PRODUCT, other)

    def __truediv__(self, other: Symbol) -> Symbol:
        return self.emit(functions.QUOTIENT, other)

    def __rtruediv__(self, number: float) -> Symbol:
        return self**-1.0 * number

    def __pow__(self, exponent: float) -> Symbol:
        if exponent == 0.0:
            return self._of(Rows.of(np.ones(self.rows.size)))
        if exponent == 1.0:
            return self
        return self.emit(functions.power(exponent))

    def __sub__(self, other: Symbol) -> Symbol:
        return self + -other

    def __neg__(self) -> Symbol:
        return self * -1.0

    __radd__, __rmul__ = __add__, __mul__


#: Derivatives whose arrays distinguish limits, in formulas.
FORMULAS: dict[Function, Callable[..., tuple[Any, ...]]] = {
    functions.RELATIVE_ENTROPY: lambda u, v: (1.0 + np.log(u) - np.log(v), -(u / v)),
    functions.LOG_ADD_EXP: lambda u, v: (1.0 / (1.0 + np.exp(v - u)), 1.0 / (1.0 + np.exp(u - v))),
}


def gradient(
    compiler: Compiler, weighted: Iterable[tuple[Rows, Rows]], sources: Mapping[int, int]
) -> dict[int, Rows]:
    """Return the gradient of Σ weights · rows by each of the sources, as rows.

    Parameters
    ----------
    compiler : Compiler
        Compiler that created the rows; functions of the gradient are added to it.
    weighted : iterable of (Rows, Rows)
        Rows, and as many weights, which do not depend on the sources.
    sources : mapping
        From the key of a source to its size.
    """
    active, groups = set(sources), list(compiler.groups)
    for _, _, arguments, key in groups:
        if any(not active.isdisjoint(rows.blocks) for rows in arguments):
            active.add(key)
    found: dict[int, list[Rows]] = defaultdict(list)
    for key, size in sources.items():
        found[key].append(Rows({}, np.zeros(size), (size,)))

    def distribute(rows: Rows, weights: Rows) -> None:
        for key in active.intersection(rows.blocks):
            if isinstance(block := rows.blocks[key], float):
                found[key].append(replace(weights, shape=(rows.size,)).scaled(block))
            else:
                found[key].append(weights.applied(sp.csr_array(block.T), (block.shape[1],)))

    for rows, weights in weighted:
        distribute(rows, weights)
    for _, function, arguments, key in reversed(groups):
        if key not in found:
            continue
        parts = found.pop(key)
        weight = Symbol(compiler, added(parts, parts[0].shape))
        symbols = [
            Symbol(compiler, Rows(u.blocks, u.offset, (u.size,), u.level)) for u in arguments
        ]
        slopes = FORMULAS.get(function, function.derivatives)(*symbols)
        for rows, slope in zip(arguments, slopes, strict=True):
            if not active.isdisjoint(rows.blocks):
                distribute(rows, (weight * slope).rows)
    return {key: added(parts, parts[0].shape) for key, parts in found.items()}
