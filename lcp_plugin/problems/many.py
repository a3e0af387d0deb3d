"""Common parts of batches, time stepping and derivatives: arrays, sequences of results, chunks for threads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from operator import index
from typing import Any, Self, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ..core.checks import Array, checked_bounds, normalize_bounds, real_array, without_none
from ..core.errors import InvalidProblem, LCPError, NotConverged
from ..core.kernels.threads import MAX_THREADS, shared_among
from ..core.names import format_count
from ..core.settings import Status

T = TypeVar("T")


def item_number(k: int, count: int, hint: str = "") -> int:
    """Return the number of a result, counted from 0; raise IndexError if it is none of `count`."""
    if not -count <= index(k) < count:
        raise IndexError(f"there are {count} results, and none has the number {k}{hint}")
    return index(k) % count


def errors_of(items: Any, is_right: Any) -> dict[int, LCPError]:
    """Return the errors that the wrong ones among some items raise, by their numbers."""
    errors: dict[int, LCPError] = {}
    for k in np.flatnonzero(~is_right).tolist():
        try:
            items[k]
        except LCPError as error:
            errors[k] = error
    return errors


class AnswerSequence(Sequence[T]):
    """The results of a batch, in order; ``self.at(k)`` returns item k, 0 ≤ k < len(self).

    Attributes
    ----------
    status : sequence of Status
        Status of each item; None if the data of an item are invalid.
    seconds : float
        Wall-clock seconds of the batch.
    """

    item, keep = "problem", 1
    seconds: float
    status: Any

    def at(self, k: int) -> T:
        """Return item k."""
        raise NotImplementedError

    @overload
    def __getitem__(self, k: int) -> T: ...
    @overload
    def __getitem__(self, k: slice) -> list[T]: ...
    def __getitem__(self, k: int | slice) -> T | list[T]:
        if isinstance(k, slice):
            return [self.at(i) for i in range(len(self))[k]]
        hint = "; keep=1 keeps all steps" if self.keep != 1 else ""
        return self.at(item_number(k, len(self), hint))

    @property
    def all_solved(self) -> bool:
        """True if every status is SOLVED."""
        return all(status is Status.SOLVED for status in self.status)

    is_solved = all_solved

    def counts(self) -> str:
        """Return the number of items per status, as text."""
        counted = Counter(getattr(status, "name", "invalid") for status in self.status)
        return ", ".join(f"{count} {name}" for name, count in counted.most_common()) or "none"

    @property
    def advice(self) -> str:
        """Meaning of the status of the first item that is not SOLVED, in one sentence."""
        if self.all_solved or not len(self):
            return Status.SOLVED.value
        k, item = self._first_unsolved()
        return f"{self.item} {k}: {getattr(item, 'advice', item)}"

    def explain(self) -> str:
        """Return the number of items per status, and a summary of the first unsolved item."""
        lines = [f"{format_count(len(self), self.item)}: {self.counts()}; {self.seconds:.3g} s"]
        if len(self):
            k, item = self._first_unsolved()
            lines.append(f"{self.item} {k}: {item}")
        return "\n".join(lines)

    def _first_unsolved(self) -> tuple[int, Any]:
        """Return the number and the result, or the error, of the first item that is not SOLVED; else of the last."""
        unsolved = (k for k, status in enumerate(self.status) if status is not Status.SOLVED)
        k = next(unsolved, len(self) - 1)
        try:
            return k, self.at(k)
        except LCPError as error:
            return k, f"no {self.item}: {error}"

    def require_solved(self) -> Self:
        """Return this sequence, or raise NotConverged if some item is not solved.

        Raises
        ------
        NotConverged
            With the number of items per status and the summary of the first unsolved item.
        """
        if not self.all_solved:
            raise NotConverged(self.explain())
        return self

    def __repr__(self) -> str:
        return f"{type(self).__name__}({format_count(len(self), self.item)}: {self.counts()}; {self.seconds:.3g} s)"

    def __str__(self) -> str:
        return self.explain()


def run_in_chunks(work: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``work(first, end)`` for all of 0 ≤ k < count; after Ctrl-C no further chunk starts."""
    threads = min(threads, MAX_THREADS)
    # Small chunks, so that all threads end at about the same time, and 256 problems between two checks of the clock
    size = min(max(count // (32 * threads), 1), 256)
    ends = [*range(0, count, size), count]
    if threads == 1 or len(ends) <= 2:
        for first, end in pairwise(ends):
            work(first, end)
        return
    shared_among(work, ends, threads)


def rows_of_a_batch(values: ArrayLike, name: str, n: int) -> Any:
    """Return the values as an array of shape (B, n), or (1, n) if all problems share them."""
    is_bound = name in ("lower", "upper")
    size = "m" if name == "b" else "n"
    need = f"{name} must have shape (B, {size}) or ({size},), {size} = {n}{', or be a number' if is_bound else ''}"
    array = real_array(without_none(values, name) if is_bound else values, need)
    if array.ndim == 0 and is_bound:
        array = np.full(n, float(array))
    if array.ndim not in (1, 2) or array.shape[-1] != n:
        hint = "; give its transpose" if array.ndim == 2 and array.shape[0] == n else ""
        if is_bound:
            hint = "; for one number per problem use a column, shape (B, 1), times np.ones(n)"
        raise InvalidProblem(f"{need}, got shape {array.shape}{hint}")
    return np.array(np.atleast_2d(array), order="C")


def bounds_of_a_batch(lower: Array, upper: Array, n: int) -> Any:
    """Return the bounds as arrays of shape (B, n), or (1, n) if all problems share them; ±1e20 means none."""
    if type(lower) is type(upper) is float and lower <= 0.0 <= upper:
        return [end[np.newaxis] for end in checked_bounds(lower, upper, n)]
    return normalize_bounds(rows_of_a_batch(lower, "lower", n), rows_of_a_batch(upper, "upper", n))


def length_of_all(counts: dict[str, int]) -> int:
    """Return the number of problems, the common length of the batch axes; 1 without any.

    Raises
    ------
    InvalidProblem
        If the lengths differ.
    """
    if len(set(counts.values())) > 1:
        lengths = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise InvalidProblem(
            f"arrays with an axis for problems must be equally long, got {lengths}"
        )
    return next(iter(counts.values()), 1)
