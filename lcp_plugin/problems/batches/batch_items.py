"""The problems of a batch: arrays with an axis in front, one matrix with many right-hand sides, or a list of LCPs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...auto import takes_rounds
from ...core.checks import DENSE_ABOVE_DENSITY, checked_start, read_only, real_array, without_huge
from ...core.errors import InvalidOption, InvalidProblem, LCPError
from ...core.lcp import LCP
from ...core.tuning import COMPILED_SPARSE_UP_TO, COMPILED_UP_TO
from ...methods.small.rounds import as_dense, is_small
from ...systems.graph import outer_on_pattern
from ..many.data import length_of_all, rows_of_a_batch
from .batch_groups import Group


class Items:
    """The problems, checked: ``errors[k]`` says what is wrong with problem k, and does not stop the rest.

    `sizes` holds the numbers of unknowns.
    """

    sizes: set[int]

    def __init__(self, count: int) -> None:
        self.count = count
        self.errors: dict[int, LCPError] = {}

    def problem(self, k: int) -> LCP:
        """Return problem k."""
        raise NotImplementedError

    def start(self, k: int) -> Any:
        """Return its z0, or None."""
        raise NotImplementedError

    def groups(self, *, every: bool = False) -> Iterator[Group]:
        """Yield those that are small enough for a compiled call, without errors; every one, or where auto has one."""
        raise NotImplementedError

    def slack(self, k: int, z: Any) -> Any:
        """Return w = M z + q of problem k."""
        return self.problem(k).slack(z)

    def outer(self, left: Any, right: Any) -> Any:
        """Return left_i right_j of each problem's rows where M has entries, in the form in which M was given.

        Parameters
        ----------
        left, right : arrays, shape (B, n), or lists of arrays
        """
        raise NotImplementedError

    def projected_start(self, k: int) -> Any:
        """Return where problem k begins."""
        return checked_start(self.problem(k), self.start(k))

    def _note_errors(self, suspects: Sequence[int]) -> None:
        for k in suspects:
            try:
                self.problem(k)
            except LCPError as error:
                self.errors[k] = error


class Listed(Items):
    """LCPs of any sizes."""

    def __init__(self, problems: Sequence[LCP], z0: Any) -> None:
        super().__init__(len(problems))
        if z0 is not None and (
            isinstance(z0, str) or not hasattr(z0, "__len__") or len(z0) != len(problems)
        ):
            raise InvalidOption(
                f"z0 must be a list of {len(problems)} starts, one a problem, or None"
            )
        self._problems, self._starts = problems, z0
        self.sizes = {problem.n for problem in problems}

    def problem(self, k: int) -> LCP:
        """Return problem k."""
        return self._problems[k]

    def start(self, k: int) -> Any:
        """Return its z0, or None."""
        return None if self._starts is None else self._starts[k]

    def outer(self, left: Any, right: Any) -> Any:
        """Return a list of CSR arrays, on the pattern of each M; None where no z was found."""
        triples = zip(self._problems, left, right, strict=True)
        return [
            outer_on_pattern(one.matrix, a, b) if a.size == one.n else None for one, a, b in triples
        ]

    def groups(self, *, every: bool = False) -> Iterator[Group]:
        """Yield those that are small enough for a compiled call, without errors; every one, or where auto has one."""
        for n in sorted(self.sizes if every or self._starts is None else ()):
            suits = is_small if every else takes_rounds
            items = [k for k, one in enumerate(self._problems) if one.n == n and suits(one)]
            chosen = [self.problem(k) for k in items]
            if not chosen:
                continue
            matrices = {id(problem.matrix): as_dense(problem.matrix) for problem in chosen}
            each = [
                matrices[id(problem.matrix)]
                for problem in chosen[: 1 if len(matrices) == 1 else None]
            ]
            vectors = (
                np.array([getattr(p, name) for p in chosen]) for name in ("q", "lower", "upper")
            )
            yield Group(
                np.array(items), *map(read_only, (np.concatenate(each), *vectors, np.empty((1, 0))))
            )


class Stacked(Items):
    """Arrays: M of shape (B, n, n), or one (n, n) or LCP for all; the vectors of shape (B, n), (n,) or numbers."""

    def __init__(self, M: Any, q: Any, lower: Any, upper: Any, z0: Any) -> None:
        need = "M must be an array of shape (B, n, n) or (n, n), or a list of LCPs"
        given = M if isinstance(M, LCP) else None
        self._M = given.M if given else M if sp.issparse(M) else real_array(M, need)
        self._shared = self._M.ndim == 2
        n = self._M.shape[-1] if self._M.ndim else 0
        if self._M.ndim not in (2, 3) or self._M.shape[-2] != n:
            raise InvalidProblem(
                f"M must have shape (B, n, n), or (n, n) for all, got {self._M.shape}"
            )
        if q is None:
            raise InvalidProblem(
                "q is missing: an array of shape (B, n), or (n,) for all; a list of LCPs needs none"
            )
        named = {"q": q, "lower": lower, "upper": upper} | ({} if z0 is None else {"z0": z0})
        self._vectors = {name: rows_of_a_batch(values, name, n) for name, values in named.items()}
        bounds = without_huge(self._vectors["lower"], self._vectors["upper"])
        self._vectors["lower"], self._vectors["upper"] = bounds
        counts = {
            name: rows.shape[0] for name, rows in self._vectors.items() if np.ndim(named[name]) == 2
        }
        counts |= {} if self._shared else {"M": self._M.shape[0]}
        super().__init__(length_of_all(counts))
        self.sizes = {n}
        self._base = given or (LCP(self._M, np.zeros(n)) if self._shared else None)
        self._note_errors(self._suspects())

    def _suspects(self) -> Any:
        """Return what may not be a problem: numbers that are not finite, bounds that are none."""
        q, lower, upper = (self._vectors[name] for name in ("q", "lower", "upper"))
        with np.errstate(all="ignore"):
            is_good = np.isfinite(q).all(1) & (
                (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
            ).all(1)
            if not self._shared:
                is_good = is_good & np.isfinite(self._M.sum(axis=(1, 2)))
            if "z0" in self._vectors and not np.isfinite(self._vectors["z0"]).all():
                raise InvalidOption("z0 must be finite, got NaN or infinite entries")
        return np.flatnonzero(~np.broadcast_to(is_good, self.count)).tolist()

    def _row(self, name: str, k: int) -> Any:
        rows = self._vectors[name]
        return rows[k if rows.shape[0] > 1 else 0]

    def problem(self, k: int) -> LCP:
        """Return problem k."""
        q, lower, upper = (self._row(name, k) for name in ("q", "lower", "upper"))
        if self._base is not None:
            return self._base.with_q(q, lower=lower, upper=upper)
        return LCP(self._M[k], q, lower=lower, upper=upper)

    def slack(self, k: int, z: Any) -> Any:
        """Return w = M z + q of problem k; what a sparse M is multiplied by is left to it."""
        n = z.size
        if self._shared or np.count_nonzero(self._M[k]) <= DENSE_ABOVE_DENSITY * n * n:
            return self.problem(k).slack(z)
        return self._M[k] @ z + self._row("q", k)

    def outer(self, left: Any, right: Any) -> Any:
        """Return products of shape (B, n, n), or their sum where one M stands for all, on its pattern if sparse."""
        if not self._shared:
            return left[:, :, np.newaxis] * right[:, np.newaxis, :]
        if self._base is None or not sp.issparse(self._M):
            return left.T @ right
        total = outer_on_pattern(self._base.matrix, *np.zeros((2, left.shape[1])))
        for a, b in zip(left, right, strict=True):
            total.data += outer_on_pattern(self._base.matrix, a, b).data
        return total

    def projected_start(self, k: int) -> Any:
        """Return where problem k begins."""
        start = self._row("z0", k) if "z0" in self._vectors else 0.0
        return np.clip(start, self._row("lower", k), self._row("upper", k))

    def start(self, k: int) -> Any:
        """Return its z0, or None."""
        return self._row("z0", k) if "z0" in self._vectors else None

    def groups(self, *, every: bool = False) -> Iterator[Group]:
        """Yield those that are small enough for a compiled call, without errors; every one, or where auto has one."""
        n = self._M.shape[-1]
        is_here = np.ones(self.count, np.bool_)
        is_here[[*self.errors]] = False
        if self._base is not None:
            is_here &= (is_small if every else takes_rounds)(self._base)
        elif n > COMPILED_SPARSE_UP_TO:
            is_dense = [np.count_nonzero(M) > DENSE_ABOVE_DENSITY * n * n for M in self._M]
            is_here &= np.array(is_dense, np.bool_) & (n <= COMPILED_UP_TO)
        elif n > 2 and not every:
            is_here[_tridiagonal(self._M)] = False  # solve knows better
        items = np.flatnonzero(is_here)
        if n == 0 or items.size == 0:
            return
        M = np.ascontiguousarray(self._M) if self._base is None else as_dense(self._base.matrix)
        q, lower, upper = (self._vectors[name] for name in ("q", "lower", "upper"))
        starts = (
            np.clip(self._vectors["z0"], lower, upper)
            if "z0" in self._vectors
            else np.empty((1, 0))
        )
        is_whole = items.size == self.count
        chosen = (
            a if a.shape[0] == 1 or is_whole else a[items] for a in (M, q, lower, upper, starts)
        )
        yield Group(items, *map(read_only, chosen))


def _tridiagonal(M: Any) -> list[int]:
    """Return which of the matrices are tridiagonal with most entries zero; a look at one row spares most of them."""
    n = M.shape[-1]
    outside = abs(np.subtract.outer(np.arange(n), np.arange(n))) > 1
    suspects = np.flatnonzero(~M[:, 0, 2:].any(axis=1)).tolist()
    return [
        k
        for k in suspects
        if not M[k][outside].any() and np.count_nonzero(M[k]) <= DENSE_ABOVE_DENSITY * n * n
    ]


def put(table: Any, items: Any, rows: Any) -> None:
    """Write rows of a table, an array or a list of arrays."""
    if isinstance(table, np.ndarray):
        table[items] = rows
    else:
        for k, row in zip(items, rows, strict=True):
            table[k] = row
