"""The options that all strategies share, checked at once, and the small strategies made of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from inspect import Signature, signature
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import InvalidOption

LARGEST_ENTRY = 9
LARGEST_SIZE = 8
LARGEST_SCALE = 400
SMALLEST_MARGIN = 2.0**-30
SHARE_PARTS = 60  # a share is rounded to a whole number of these

Sizes = int | st.SearchStrategy[int] | None
Matrix = NDArray[np.float64]
IntVector = NDArray[np.int64]


class Numbers(NamedTuple):
    """Integers from low to high, simplest the one nearest to 0, and what an array of them stands for."""

    low: int
    high: int
    meaning: Callable[[IntVector], Any] = np.asarray

    def then(self, function: Callable[[Any], Any]) -> Numbers:
        """Return the numbers to which a function of arrays was applied."""
        return Numbers(self.low, self.high, lambda drawn: function(self.meaning(drawn)))


class Options(NamedTuple):
    """What a strategy for matrices needs to know, checked."""

    sizes: st.SearchStrategy[int]
    entries: Numbers
    row_scale: int
    column_scale: int
    scale: int
    margin: float
    dense: bool


def checked_options(
    size: Sizes = None, *, density: float = 1.0, row_scale: int = 0, column_scale: int = 0, scale: int = 0,
    margin: float = 1.0, dense: bool = True, smallest: int = 0,
) -> Options:
    """Return the options, or raise InvalidOption; `smallest` is the least size that has such a matrix."""
    scales = {"row_scale": row_scale, "column_scale": column_scale, "scale": scale}
    row, column, both = (checked_scale(*pair) for pair in scales.items())
    if not SMALLEST_MARGIN <= margin <= 1.0 or math.frexp(margin)[0] != 0.5:
        raise InvalidOption(f"margin must be a power of two from 2**-30 to 1, got {margin!r}")
    return Options(sizes(size, smallest), entries(density), row, column, both, float(margin), dense)


def matrices(
    *scales: str, smallest: Callable[..., int] = lambda **own: 0
) -> Callable[[Callable[..., Matrix]], Callable[..., st.SearchStrategy[Any]]]:
    """Return a decorator: of what draws a matrix before it is scaled it makes a strategy with the shared options.

    The function takes draw, n and the checked options, and its own options by name. The strategy takes these, size,
    density, margin, dense and the named scales; what it needs to be at least as large as, `smallest` tells from the
    own options.
    """

    def decorate(build: Callable[..., Matrix]) -> Callable[..., st.SearchStrategy[Any]]:
        own = [option for option in signature(build).parameters.values() if option.kind is option.KEYWORD_ONLY]
        known = signature(checked_options).parameters
        size, *shared = (known[name] for name in ("size", "density", *scales, "margin", "dense"))
        form = Signature([size, *own, *shared], return_annotation="st.SearchStrategy[Any]")

        @st.composite
        def drawn(draw: st.DrawFn, options: Options, chosen: dict[str, Any]) -> Any:
            n = draw(options.sizes)
            row, column = drawn_units(draw, n, options.row_scale, options.column_scale, options.scale)
            return in_units(build(draw, n, options, **chosen), row, column, dense=options.dense)

        def strategy(*arguments: Any, **keywords: Any) -> st.SearchStrategy[Any]:
            try:
                given = form.bind(*arguments, **keywords).arguments
            except TypeError as error:
                raise InvalidOption(f"{build.__name__}: {error}; it takes {', '.join(form.parameters)}") from None
            chosen = {option.name: given.pop(option.name, option.default) for option in own}
            return drawn(checked_options(**given, smallest=smallest(**chosen)), chosen)

        for name in ("__module__", "__name__", "__qualname__", "__doc__"):
            setattr(strategy, name, getattr(build, name))
        strategy.__signature__ = form  # type: ignore[attr-defined]
        return strategy

    return decorate


def sizes(size: Sizes, smallest: int = 0) -> st.SearchStrategy[int]:
    """Return a strategy for numbers of rows, none below `smallest`."""
    if size is None:
        return st.integers(max(1, smallest), max(LARGEST_SIZE, smallest))
    need = f"size must be a whole number ≥ {smallest} or a strategy of such"
    if isinstance(size, st.SearchStrategy):
        return size.map(lambda n: whole_number(n, need, smallest))
    return st.just(whole_number(size, need, smallest))


def whole_number(value: Any, need: str, low: int, high: float = math.inf) -> int:
    """Return the value as an int, or raise InvalidOption with what is needed where it is none from low to high."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise InvalidOption(f"{need}, got {value!r}")
    return int(value)


def entries(density: float) -> Numbers:
    """Return integers up to 9 in absolute value of which the share `density` is nonzero."""
    density = checked_share("density", density)
    values = 2 * LARGEST_ENTRY
    if density * 1e6 < values:
        return Numbers(0, 0)
    zeros = max(1, round(values * (1.0 - density) / density))
    return Numbers(1 - zeros, values, _signed)


def _signed(k: IntVector) -> IntVector:
    """Return 1, −1, 2, −2 … for 1, 2, 3, 4 …, and 0 for 0 and all below it: simple entries come first."""
    return np.where(k <= 0, 0, np.where(k % 2 == 1, (k + 1) // 2, -(k // 2)))


def checked_scale(option: str, value: int) -> int:
    """Return a largest exponent of two."""
    return whole_number(value, f"{option} must be a whole number from 0 to {LARGEST_SCALE}", 0, LARGEST_SCALE)


def checked_share(option: str, value: float) -> float:
    """Return a number in [0, 1]; True and False are 1 and 0."""
    if not isinstance(value, (int, float, np.integer, np.floating)) or not 0.0 <= value <= 1.0:
        raise InvalidOption(f"{option} must lie in [0, 1], got {value!r}")
    return float(value)


def by_share(*shares: float) -> Numbers:
    """Return 0, 1, … with these probabilities, roughly; what is left over goes to 0."""
    counts = [math.ceil(share * SHARE_PARTS - 1e-9) for share in shares]
    counts[0] += max(0, SHARE_PARTS - sum(counts))
    # The shorter the list, the more evenly hypothesis draws from it.
    common = math.gcd(*counts)
    return one_of(*(which for which, count in enumerate(counts) for _ in range(count // common)))


def one_of(*values: float) -> Numbers:
    """Return numbers from a list, the simplest first."""
    table = np.array(values)
    return Numbers(0, len(values) - 1, lambda drawn: table[drawn])


POSITIVE = Numbers(1, LARGEST_ENTRY)
SIGNED = Numbers(-LARGEST_ENTRY, LARGEST_ENTRY)
ONE_FIRST = one_of(*range(1, LARGEST_ENTRY + 1), 0, *range(-1, -LARGEST_ENTRY - 1, -1))
SIGNS = one_of(1, -1)


def vectors(n: int, values: Numbers) -> st.SearchStrategy[FloatVector]:
    """Return a strategy for arrays of shape (n,).

    Up to 8 rows it always draws 8 and drops the last: shrinking can then lower n without a change of what follows.
    """
    return _numbers(max(n, LARGEST_SIZE), values).map(lambda drawn: drawn[:n])


def integer_vectors(n: int, values: Numbers) -> st.SearchStrategy[IntVector]:
    """Return a strategy for arrays of integers of shape (n,)."""
    return vectors(n, values).map(lambda drawn: drawn.astype(np.int64))


def drawn_number(draw: st.DrawFn, values: Numbers) -> float:
    """Return one number."""
    return float(draw(_numbers(1, values))[0])


def _numbers(count: int, values: Numbers) -> st.SearchStrategy[FloatVector]:
    def meant(drawn: tuple[int, ...]) -> FloatVector:
        return np.asarray(values.meaning(np.array(drawn, dtype=np.int64)), dtype=np.float64)

    return _tuples(count, values.low, values.high).map(meant)


@lru_cache(maxsize=1000)
def _tuples(count: int, low: int, high: int) -> st.SearchStrategy[tuple[int, ...]]:
    return st.tuples(*[st.integers(low, high)] * count)


def orders(n: int) -> st.SearchStrategy[IntVector]:
    """Return a strategy for permutations of 0 … n − 1 that shrinks to the identity."""
    return vectors(n, Numbers(0, LARGEST_SIZE - 1)).map(lambda keys: np.argsort(keys, kind="stable"))


def blocks(rows: int, columns: int, values: Numbers) -> st.SearchStrategy[Matrix]:
    """Return a strategy for arrays of shape (rows, columns)."""
    return _numbers(rows * columns, values).map(lambda drawn: drawn.reshape(rows, columns))


def square(n: int, values: Numbers, part: str = "all") -> st.SearchStrategy[Matrix]:
    """Return a strategy for arrays of shape (n, n): all entries drawn, or those "off" or "below" the diagonal.

    Leading submatrices come first, so that lowering n keeps one. Draw it last, after what has a fixed length.
    """
    i, j = _places(n, part)

    def placed(drawn: FloatVector) -> Matrix:
        A = np.zeros((n, n))
        A[i, j] = drawn
        return A

    return _numbers(i.size, values).map(placed)


@lru_cache(maxsize=100)
def _places(n: int, part: str) -> tuple[IntVector, IntVector]:
    """Return the row and column numbers of the entries, ordered by the larger of the two."""
    i, j = np.indices((n, n)).reshape(2, -1)
    keep = {"all": i >= 0, "off": i != j, "below": i > j}[part]
    order = np.argsort(np.maximum(i, j)[keep], kind="stable")
    return i[keep][order], j[keep][order]


def skew_matrices(n: int, values: Numbers) -> st.SearchStrategy[Matrix]:
    """Return a strategy for K = −Kᵀ."""
    return square(n, values, "below").map(lambda L: L.T - L)


def drawn_units(draw: st.DrawFn, n: int, row_scale: int, column_scale: int, scale: int = 0) -> Any:
    """Return exponents of two of the rows and of the columns; those up to `scale` are the same in both."""
    scales = row_scale, column_scale, scale
    row, column, both = (
        draw(integer_vectors(n, Numbers(-most, most))) if most else np.zeros(n, dtype=np.int64) for most in scales
    )
    return row + both, column + both


def in_units(A: Matrix, row: IntVector, column: IntVector, *, dense: bool) -> Any:
    """Return A with its rows and columns multiplied by powers of two, as it is or as CSR."""
    result: Matrix = np.ldexp(A, row[:, None] + column)
    return result if dense else sp.csr_array(result)


def reordered(A: Matrix, order: IntVector) -> Matrix:
    """Return P A Pᵀ."""
    return A[np.ix_(order, order)]
