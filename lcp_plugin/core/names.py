"""Texts of messages: names of rows and unknowns, which only this file makes from an index; counts, radii."""

from __future__ import annotations

import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .errors import InvalidProblem

MOST_NAMES = 5  # in a message
UNLABELED = "constraint"  # of cvxpy, before its number
Naming = Sequence[str] | Callable[[int], str] | None


class Names(NamedTuple):
    """Names of the rows and unknowns of a problem, each a sequence, a function of the index, or None for numbers.

    Attributes
    ----------
    rows, unknowns : sequence of str, callable or None
        A large model passes a function, because few names are ever printed.

    Examples
    --------
    >>> names = Names(["market", "budget"])
    >>> names.row(1), names.unknown(1)
    ('budget', 'z[1]')
    """

    rows: Naming = None
    unknowns: Naming = None

    def row(self, i: int, otherwise: str = "row {}") -> str:
        """Return the name of row i, by default "row 3"."""
        return _name_of(self.rows, i) or otherwise.format(i)

    def unknown(self, i: int, otherwise: str = "z[{}]") -> str:
        """Return the name of unknown i, by default "z[3]"."""
        return _name_of(self.unknowns, i) or otherwise.format(i)

    def pair(self, i: int) -> tuple[str, str]:
        """Return the names of row and unknown i, which are "w[name]" and "z[name]" if both have one name."""
        row, unknown = self.row(i), self.unknown(i)
        return (row, unknown) if row != unknown else (f"w[{row}]", f"z[{row}]")


def listed(names: Iterable[str], most: int = 4, between: str = ", ") -> str:
    """Return different names as text: the first ones, and the number of the others.

    Examples
    --------
    >>> listed(["a", "b", "a", "c"], 2)
    'a, b and 1 more'
    """
    different = [*dict.fromkeys(names)]
    more = f" and {len(different) - most} more" if len(different) > most else ""
    return between.join(different[:most]) + more


def grouped(names: Iterable[str], most: int = 4) -> list[str]:
    """Return different names, entries of one array as one name with their number if there are more than `most`.

    Examples
    --------
    >>> grouped(["row 0", "lower[0]", "lower[1]", "x[0] ≥ 1", "x[1] ≥ 1", "x[2] ≥ 1", "z[1]"])
    ['row 0', 'lower (2 entries)', 'x ≥ 1 (3 entries)', 'z[1]']
    """
    different = [*dict.fromkeys(names)]
    if len(different) <= most:
        return different
    arrays = {name: re.sub(r"\[[\d, ]+\]|, entry [\d, ()]+$", "", name) for name in different}
    counts = Counter(arrays.values())
    shown = ((name, array, counts[array]) for name, array in arrays.items())
    texts = (f"{array} ({count} entries)" if count > 1 else name for name, array, count in shown)
    return [*dict.fromkeys(texts)]


def remark_on_labels(text: str) -> str:
    """Return the call that gives names to constraints, if a text has numbers of constraints; otherwise ""."""
    is_needed = re.search(rf"\b{UNLABELED} \d+ \(", text) is not None
    return "to name a constraint write constraint.set_label('market')" if is_needed else ""


def _name_of(names: Naming, i: int) -> str:
    if names is None:
        return ""
    return str(names(int(i)) if callable(names) else names[int(i)])


def checked_names(
    labels: object, rows: int | None, unknowns: int | None, *, are_pairs: bool = False
) -> Names:
    """Return the names of a new problem from a list for the unknowns, or a pair of lists, for rows and unknowns.

    Parameters
    ----------
    labels : sequence of str, pair of them, Names or None
    rows, unknowns : int or None
        Numbers of names that are needed; None if they are not known yet.
    are_pairs : bool
        Whether row i belongs to unknown i, so that a list names both.

    Raises
    ------
    InvalidProblem
        If the names are anything else, their number differs from the number of rows or unknowns, or two unknowns
        have one name.

    Examples
    --------
    >>> checked_names(["a", "b"], 2, 2, are_pairs=True).row(1), checked_names(["a", "b"], 2, 2).row(1)
    ('b', 'row 1')
    >>> checked_names([["r"], None], 1, 2).row(0)
    'r'
    """
    if labels is None or isinstance(labels, Names):
        return labels or Names()
    given = _as_list(labels)
    if _are_names(given) and not isinstance(labels, str):
        both = Names(given if are_pairs else None, given)
    elif len(given) == 2 and all(
        k is None or (_are_names(_as_list(k)) and not isinstance(k, str)) for k in given
    ):
        both = Names(*(k if k is None else _as_list(k) for k in given))
    else:
        raise InvalidProblem(
            "names must be a sequence of strings, or a pair of sequences, of the rows and of the unknowns, "
            f"got {labels!r:.60}; write names=[str(name) for name in …]"
        )
    for what, names, count in (("row", both.rows, rows), ("unknown", both.unknowns, unknowns)):
        if isinstance(names, list) and count is not None and len(names) != count:
            raise InvalidProblem(
                f"names has {format_count(len(names), 'name')} of {what}s, and the problem has {count}; give one each"
            )
    twice = _first_repeated(both.unknowns) if isinstance(both.unknowns, list) else None
    if twice is not None:
        raise InvalidProblem(f"names of unknowns must differ, but {twice!r} is there twice")
    return both


def _first_repeated(names: Sequence[str]) -> str | None:
    return next((name for name, count in Counter(names).items() if count > 1), None)


def shared_labels(
    axes: Iterable[str], data: Mapping[str, Any], known: Mapping[str, Naming] | None = None
) -> dict[str, list[str]]:
    """Return the labels of pandas objects by axis, the first ones that are not numbers, as text.

    `axes` has a letter for each axis of an argument in `data`, as ``["M zz", "q z"]``. InvalidProblem is raised if axes
    with one letter have the same labels in another order, or the `known` names of a problem, by letter.
    """
    names: dict[str, list[str]] = {}
    if "pandas" not in sys.modules or not any(hasattr(one, "iloc") for one in data.values()):
        return names
    found = {k: [("the problem", of)] for k, of in (known or {}).items() if isinstance(of, list)}
    for name, letters in map(str.split, axes):
        indices = data[name].axes if hasattr(data.get(name), "iloc") else ()
        for letter, index in zip(letters, indices, strict=False):
            for first, others in found.setdefault(letter, []):
                same = index is others or len(index) != len(others)
                was, now = ([] if same else [*map(str, part)] for part in (others, index))
                if was != now and sorted(was) == sorted(now):
                    k = next(k for k, label in enumerate(was) if label != now[k])
                    raise InvalidProblem(
                        f"the labels of {first} and {name if name != first else 'its columns'} must be in one order, "
                        f"but label {k} is {was[k]!r} and {now[k]!r}; write {name}.reindex(…), or "
                        f"{name}.to_numpy() if its order is right"
                    )
            found[letter].append((name, index))
            if index.dtype.kind not in "iuf" and index.is_unique:
                names.setdefault(letter, [*map(str, index)])
    return names


def _as_list(values: Any) -> list[Any]:
    """Return a list, tuple, array or index of names as a list, anything else as its only entry."""
    is_sequence = hasattr(values, "__getitem__") and hasattr(values, "__len__")
    is_other = isinstance(values, (str, bytes, Mapping)) or getattr(values, "ndim", 1) == 0
    return [*values] if is_sequence and not is_other else [values]


def _are_names(values: list[Any]) -> bool:
    return all(isinstance(name, str) for name in values)


def format_count(count: int, what: str) -> str:
    """Return a count with its noun, in the singular or the plural.

    Examples
    --------
    >>> format_count(1, "iteration"), format_count(12, "iteration")
    ('1 iteration', '12 iterations')
    """
    return f"{count} {what}" + "s" * (count != 1)


def describe_lcp(problem: Any) -> str:
    """Return the text of ``repr`` for an LCP: its size and its kinds of bounds."""
    return f"LCP(n={problem.n}, nonzeros={problem.nonzeros}, bounds {_bounds_in_words(problem)})"


def _bounds_in_words(problem: Any) -> str:
    if problem.is_plain:
        return "0 ≤ z"
    is_below, is_above = np.isfinite(problem.lower), np.isfinite(problem.upper)
    boxed, free = int((is_below & is_above).sum()), int((~is_below & ~is_above).sum())
    parts = [(problem.n - free - boxed, "one-sided"), (boxed, "boxed"), (free, "free")]
    return ", ".join(f"{count} {form}" for count, form in parts if count)


def three_digits_below(value: float) -> str:
    """Return three digits of a lower bound that are at most the bound.

    Examples
    --------
    >>> three_digits_below(0.25), three_digits_below(1 / 1.5)
    ('0.25', '0.663')
    """
    text = f"{value:.3g}"
    return text if float(text) <= value else f"{value * (1.0 - 0.005):.3g}"


def describe_radius(radius: float, what: str) -> str:
    """Return the points up to a radius, rounded down, to which a proof is restricted; an empty text if it is ∞.

    Examples
    --------
    >>> describe_radius(2.5e12, "x"), describe_radius(math.inf, "x")
    ('all x up to 2e+12', '')
    """
    digits, exponent = f"{radius:.15e}".split("e") if radius < math.inf else ("", "")
    return f"all {what} up to {digits[0]}e{exponent}" if digits else ""
