"""Writing ``.nl`` files, as text, and the ``.sol`` files of answers."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import Array
from ...core.entries import entries_of_row
from ...core.errors import InvalidProblem
from ...core.files import checked_path, write_whole
from ...core.lcp import LCP
from ...core.problem_classes import foreign_function
from .reading import (
    ARITY,
    NARY,
    PARTNER,
    PIECEWISE,
    WITH_TOLERANCE,
    NLContent,
    Tree,
    number_tree,
    variables_in,
)


def write_nl(problem: object, path: str | PathLike[str]) -> None:
    """Write an LCP or model as a text ``.nl`` file, its names as ``.col`` and ``.row``.

    Parameters
    ----------
    problem : LCP, NLContent, or a Pyomo model
        A Pyomo model may hold complementarities, which ``model.write`` rejects.
    path : str or Path

    Raises
    ------
    InvalidProblem
        If the format cannot state it, for example a function written in Python.
    UnsupportedModel
        Names the component of a Pyomo model that is not supported.

    Examples
    --------
    >>> import tempfile
    >>> from lcp_plugin import LCP
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_nl(LCP([[2, 1], [1, 2]], [-5, 1]), f"{folder}/m.nl")
    ...     print(LCP.load(f"{folder}/m.nl"))
    LCP(n=2, nonzeros=4, bounds 0 ≤ z)
    """
    target, content = checked_path(path), _content_of(problem)
    parts = TextWriter(content).parts()
    contents = {target: lambda file: file.writelines(parts)}
    for ending, names in ((".col", content.names), (".row", content.row_names)):
        if names is not None:
            text = "".join(f"{name}\n" for name in names).encode()
            contents[target.with_suffix(ending)] = lambda file, text=text: file.write(text)  # type: ignore[misc]
    write_whole(contents)


def _content_of(problem: Any) -> NLContent:
    """Return the content of a file of the problem; of an LCP rows M z + q, each complementary to its z."""
    if (content_of := foreign_function("content", problem)) is not None:
        problem = content_of(problem)
    if isinstance(problem, LCP):
        n, (lower, upper) = problem.n, (problem.lower, problem.upper)
        free, zero, no = np.full(n, np.inf), np.zeros(n), np.zeros(n, dtype=bool)
        pairs = np.arange(n), np.isfinite(lower) + 2 * np.isfinite(upper)
        rows = -free, free, *pairs, problem.csr, [*map(number_tree, problem.q.tolist())]
        nothing = sp.csr_array((0, n)), list[Tree]()
        return NLContent(lower, upper, *rows, no[:0], *nothing, *nothing, no, zero, no)
    if not isinstance(problem, NLContent):
        raise InvalidProblem(f"an .nl file states an LCP or a model, got {type(problem).__name__}")
    return problem


class TextWriter:
    """The segments as lines."""

    format, arithmetic = "g", 0

    def __init__(self, content: NLContent) -> None:
        self.content = content
        self.out: list[bytes] = []

    def parts(self) -> list[bytes]:
        """Return the file as a list of strings."""
        content, n = self.content, self.content.lower.size
        self.out.append(self._head().encode())
        for k, tree in enumerate(content.defined_trees):
            row = entries_of_row(content.defined_linear, k)
            self._line("V", (n + k, len(row[0]), 0))
            self._pairs(*row)
            self._tree(tree)
        for i, tree in enumerate(content.trees):
            self._line("C", (i,))
            self._tree(tree)
        for k, tree in enumerate(content.objective_trees):
            self._line("O", (k, int(content.is_maximized[k])))
            self._tree(tree)
        if content.has_start.any():
            indices = np.flatnonzero(content.has_start)
            self._line("x", (indices.size,))
            self._pairs(indices.tolist(), content.start[indices].tolist())
        if content.row_lower.size:
            self._bounds("r", content.row_lower, content.row_upper)
        self._bounds("b", content.lower, content.upper)
        if n:
            self._columns(np.cumsum(np.bincount(content.linear.indices, minlength=n))[:-1])
        for letter, matrix in (("J", content.linear), ("G", content.objective_linear)):
            for i in np.flatnonzero(np.diff(matrix.indptr)).tolist():
                row = entries_of_row(matrix, i)
                self._line(letter, (i, len(row[0])))
                self._pairs(*row)
        return self.out

    def _head(self) -> str:
        content = self.content
        n, m, o = content.lower.size, content.row_lower.size, len(content.objective_trees)
        low, high, is_pair = content.row_lower, content.row_upper, content.partners >= 0
        is_equation = ~is_pair & (low == high)
        is_range = ~is_pair & ~is_equation & np.isfinite(low) & np.isfinite(high)
        is_nonlinear = _has_variables(content.trees)
        in_rows, in_objectives, integers = _groups(content)
        tolerance = "" if content.tolerance is None else f" {content.tolerance!r}"
        nonlinear = is_nonlinear.sum(), _has_variables(content.objective_trees).sum()
        pairs = (is_pair & ~is_nonlinear).sum(), (is_pair & is_nonlinear).sum()
        lines = [
            (n, m, o, is_range.sum(), is_equation.sum(), 0),
            (*nonlinear, *pairs, 0, 0),
            (0, 0),
            (in_rows, in_objectives, min(in_rows, in_objectives)),
            (0, 0, self.arithmetic, 1),
            (0, *integers),
            (content.linear.nnz, content.objective_linear.nnz),
            (_longest(content.row_names), _longest(content.names)),
            (len(content.defined_trees), 0, 0, 0, 0),
        ]
        first = f"{self.format}{' '.join(map(str, content.options))}{tolerance}"
        numbers = "".join(f" {' '.join(map(str, line))}\n" for line in lines)
        return f"{first}\t# written by lcp_plugin\n{numbers}"

    def _line(self, letter: str, numbers: Iterable[int]) -> None:
        """Write a letter with the numbers behind it."""
        self.out.append(f"{letter}{' '.join(map(str, numbers))}\n".encode())

    def _pairs(self, indices: list[Any], values: Array) -> None:
        lines = zip(indices, values, strict=True)
        self.out.append("".join(f"{index} {value!r}\n" for index, value in lines).encode())

    def _columns(self, counts: Array) -> None:
        self.out.append("\n".join([f"k{counts.size}", *map(str, counts.tolist()), ""]).encode())

    def _bounds(self, letter: str, lower: Array, upper: Array) -> None:
        self._line(letter, ())
        for kind, *numbers in stated_bounds(self.content, lower, upper, is_rows=letter == "r"):
            self.out.append(" ".join([str(kind), *map(repr, numbers)]).encode() + b"\n")

    def _tree(self, tree: Tree) -> None:
        for kind, value, count in tree:
            behind = count_behind(int(value), count) if kind == "o" else 0
            self.out.append(f"{kind}{value!r}\n".encode() + b"%d\n" % behind * (behind > 0))


def count_behind(operator: int, count: int) -> int:
    """Return the number that follows an operator: operands or slopes; 0 if none follows."""
    return {NARY: count, PIECEWISE: count // 2}.get(ARITY[operator], 0)


def stated_bounds(
    content: NLContent, lower: Array, upper: Array, *, is_rows: bool
) -> Iterable[tuple[Any, ...]]:
    """Yield the kind of each bound with the numbers behind it."""
    for i, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        if is_rows and content.partners[i] >= 0:
            yield PARTNER, int(content.partner_bounds[i]), int(content.partners[i]) + 1
        # −0 and 0 are two numbers to be read again
        elif low == high and (low or repr(low) == repr(high)):
            yield 4, low
        elif low == -np.inf:
            yield (3,) if high == np.inf else (1, high)
        else:
            yield (2, low) if high == np.inf else (0, low, high)


def _has_variables(trees: list[Tree]) -> Any:
    """Return the mask of trees that are not a single number."""
    return np.array([len(tree) > 1 or tree[0][0] != "n" for tree in trees], dtype=bool)


def _longest(names: list[str] | None) -> int:
    return max(map(len, names or []), default=0)


def _groups(content: NLContent) -> tuple[int, int, tuple[int, int, int, int]]:
    """Return up to which variable the rows and the objectives are nonlinear, and the integers of each group."""
    n = content.lower.size

    def most(*trees: Tree) -> int:
        used = variables_in(trees)
        return int(used[used < n].max(initial=-1)) + 1

    in_rows = most(*content.trees, *content.defined_trees)
    in_objectives = most(*content.objective_trees, *content.defined_trees)
    in_objectives = max(in_objectives, in_rows) if in_objectives else 0
    is_integer = content.is_integer
    integers = np.flatnonzero(is_integer)
    if not integers.size:
        return in_rows, in_objectives, (0, 0, 0, 0)
    is_last = is_integer & ~np.append(is_integer[1:], False)
    first = int(np.flatnonzero(is_last)[0]) + 1
    first = first if first >= max(in_rows, in_objectives) else n
    inner = int(is_integer[:first].sum())  # the last of the nonlinear group
    others = integers.size - inner
    if not (is_integer[first - inner : first].all() and is_integer[n - others :].all()):
        raise InvalidProblem(
            f"variable {integers[0]} is integer and one behind it is not; the integer variables of an "
            ".nl file must come last, or last of those that are nonlinear; order the variables so"
        )
    return first, first, (others, inner, 0, 0)


OPTIONS_LINE = "Options"


def write_sol(
    path: str | PathLike[str], content: NLContent, message: str, x: Array, y: Array, code: int
) -> None:
    """Write the answer to an ``.nl`` file.

    Parameters
    ----------
    path : str or Path
        The ``.sol`` file.
    content : NLContent
        The content of the ``.nl`` file.
    message : str
        Lines for a person.
    x, y : array or None
        Values of the variables, shape (n,), and of the rows, shape (m,); if None or not finite, the file has none.
    code : int
        0 to 99 solved, 100 solved to a lower precision, 200 infeasible, 300 unbounded, 400 limit, 500 failure.
    """
    target, options = checked_path(path), content.options
    vectors = [v.tolist() if v is not None and np.isfinite(v).all() else [] for v in (y, x)]
    m, n = content.row_lower.size, content.lower.size
    # A blank line ends the message, and also a line that starts with Options.
    lines = [line.rstrip() or " " for line in message.strip().splitlines()]
    lines = [f"- {line}" if line.lstrip().startswith(OPTIONS_LINE) else line for line in lines]
    lines.append("")
    if options[0]:
        has_tolerance = len(options) > 2 and options[2] == WITH_TOLERANCE
        counts = m, len(vectors[0]), n, len(vectors[1])
        numbers = options[0] + 2 * has_tolerance, *options[1 : options[0] + 1], *counts
        lines += [OPTIONS_LINE, *map(str, numbers)]
        lines += [repr(float(content.tolerance or 0.0))] * has_tolerance
    lines += [*map(repr, vectors[0] + vectors[1]), f"objno 0 {code}", ""]
    write_whole({target: lambda file: file.write("\n".join(lines).encode())})
