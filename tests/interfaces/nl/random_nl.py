"""Contents of ``.nl`` files by chance, how two of them differ, and damage done to files."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.interfaces.nl.reading import NARY, OPERATOR_NAMES, PIECEWISE, NLContent, Tree

WRONG_NUMBERS = (
    b"-1",
    b"0",
    b"1",
    b"3",
    b"1000000",
    b"999999999999",
    b"1e300",
    b"nan",
    b"9" * 400,
    b"x",
    b"",
)


def random_content(rng: Any, most: int = 6) -> NLContent:
    """Return a content with some of everything that the format knows."""
    n, m, o, d = (
        int(rng.integers(1, most + 1)),
        *(int(k) for k in rng.integers(0, [most + 1, 3, 4])),
    )
    lower, upper = _bounds(rng, n)
    row_lower, row_upper = _bounds(rng, m)
    partners, partner_bounds = np.full(m, -1), np.zeros(m, dtype=np.int64)
    chosen = rng.permutation(m)[: rng.integers(0, min(m, n) + 1)]
    partners[chosen] = rng.permutation(n)[: chosen.size]
    partner_bounds[chosen] = rng.integers(0, 4, chosen.size)
    row_lower[chosen], row_upper[chosen] = -np.inf, np.inf
    has_start = rng.random(n) < 0.5
    is_integer = np.arange(n) >= n - (rng.integers(0, n + 1) if rng.random() < 0.3 else 0)
    return NLContent(
        lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper, partners=partners,
        partner_bounds=partner_bounds, linear=_matrix(rng, m, [n] * m, n), trees=_trees(rng, [n + d] * m),
        is_maximized=rng.random(o) < 0.5, objective_linear=_matrix(rng, o, [n] * o, n),
        objective_trees=_trees(rng, [n + d] * o), defined_linear=_matrix(rng, d, range(n, n + d), n + d),
        defined_trees=_trees(rng, range(n, n + d)), is_integer=is_integer,
        start=np.where(has_start, _numbers(rng, n), 0.0),
        has_start=has_start, options=((3, 1, 1, 0), (5, 0, 1, 0, 7, 2021))[m % 2],
    )  # fmt: skip


def _numbers(rng: Any, count: int) -> Any:
    """Return integers, decimals, and numbers of 17 digits at any scale."""
    kind = rng.integers(0, 3, count)
    scale = 10.0 ** rng.integers(-300, 300, count)
    drawn = np.where(kind == 0, rng.integers(-9, 10, count), rng.standard_normal(count))
    return np.where(kind == 2, drawn * scale, drawn)


def _bounds(rng: Any, count: int) -> tuple[Any, Any]:
    first = rng.standard_normal(count).round(rng.integers(0, 17))
    lower = np.where(rng.random(count) < 0.3, -np.inf, first)
    upper = np.where(rng.random(count) < 0.3, np.inf, first + rng.integers(0, 3, count))
    return lower, upper


def _matrix(rng: Any, count: int, reach: Any, width: int) -> sp.csr_array:
    """Return rows with any entries among their first `reach` columns, zeros among them."""
    rows = [np.flatnonzero(rng.random(k) < 0.5) for k in reach]
    starts = np.concatenate([[0], np.cumsum([row.size for row in rows])]).astype(np.int32)
    columns = np.concatenate([*rows, np.zeros(0, dtype=np.int64)]).astype(np.int32)
    return sp.csr_array((_numbers(rng, columns.size) * (rng.random(columns.size) < 0.8), columns, starts),
                        shape=(count, width))  # fmt: skip


def _trees(rng: Any, reach: Any) -> list[Tree]:
    trees = []
    for k in reach:
        tree, wanted, most = Tree(), 1, int(rng.integers(1, 20))
        while wanted:
            kind = "nvo"[rng.choice(3, p=[0.3, 0.3, 0.4])] if len(tree) < most else "n"
            value, count = float(_numbers(rng, 1)[0]), 0
            if kind == "v":
                value = int(rng.integers(0, k))
            elif kind == "o":
                value, count = _operator(rng)
            tree.append((kind, value, count))
            wanted += count - 1
        trees.append(tree)
    return trees


def _operator(rng: Any) -> tuple[int, int]:
    counts = {
        1: 1,
        2: 2,
        3: 3,
        NARY: int(rng.integers(1, 5)),
        PIECEWISE: 2 * int(rng.integers(2, 4)),
    }
    arity = int(rng.choice([*counts], p=[0.3, 0.4, 0.1, 0.15, 0.05]))
    return int(rng.choice([*OPERATOR_NAMES[arity]])), counts[arity]


def difference(one: NLContent, other: NLContent) -> str:
    """Return what is not the same bit for bit, with types; nothing where all is."""
    return ", ".join(field.name for field in fields(NLContent)
                     if _bits(getattr(one, field.name), one) != _bits(getattr(other, field.name), other))  # fmt: skip


def _bits(part: Any, whole: NLContent) -> Any:
    if isinstance(part, np.ndarray):
        return part.dtype.str, part.shape, part.tobytes()
    if sp.issparse(part):
        return part.shape, *(
            _bits(numbers, whole) for numbers in (part.data, part.indices * 1, part.indptr * 1)
        )
    return repr(part)


def mutilated(data: bytes, rng: Any) -> bytes:
    """Return the file cut, with bits turned, bytes or lines out of place, or another number in it."""
    at, other = sorted(int(k) for k in rng.integers(0, len(data) + 1, 2))
    kind = int(rng.integers(0, 7))
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + data[other:]
    if kind == 2:
        return data[:other] + data[at:]
    if kind == 3:
        turned = bytearray(data)
        for k in rng.integers(0, len(data), rng.integers(1, 5)):
            turned[k] ^= 1 << int(rng.integers(0, 8))
        return bytes(turned)
    if kind == 4:  # a number becomes another one, in text
        numbers = list(re.finditer(rb"-?\d+", data))
        found = numbers[int(rng.integers(0, len(numbers)))]
        return (
            data[: found.start()]
            + WRONG_NUMBERS[rng.integers(0, len(WRONG_NUMBERS))]
            + data[found.end() :]
        )
    if kind == 5:  # four bytes become another number
        number = int(rng.choice([-1, 0, 1, 2**31 - 1, 10**6]))
        return data[:at] + number.to_bytes(4, "little", signed=True) + data[at + 4 :]
    lines = data.split(b"\n")
    i, k = rng.integers(0, len(lines), 2)
    lines[i], lines[k] = lines[k], lines[i]
    return b"\n".join(lines)
