"""``.sol`` files, which answer an ``.nl`` file: message, dual and primal values, and a code of what came out.

Always text: AMPL's reader takes text after a binary ``.nl`` as well, and others read nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.errors import InvalidProblem, UnreadableFile
from ..files.files import checked_path, write_whole
from ..files.matrix_market import opened
from .content import MOST_OPTIONS, WITH_TOLERANCE

OPTIONS = "Options"


@dataclass(frozen=True, eq=False)
class SolContent:
    """What a ``.sol`` file says.

    Attributes
    ----------
    message : str
    options : tuple of int
        As in the first line of the ``.nl`` file, the number of them first.
    tolerance : float or None
    rows, variables : int
        Their numbers.
    duals, values : ndarray or None
        Of the rows and of the variables, None where none are given.
    code : int
        0 to 99 solved, 100 solved to a lower precision, 200 infeasible, 300 unbounded, 400 limit, 500 failure; −1
        where none is given.
    """

    message: str
    options: tuple[int, ...]
    tolerance: float | None
    rows: int
    variables: int
    duals: FloatVector | None
    values: FloatVector | None
    code: int


def write_sol(
    path: str | PathLike[str], message: str, x: Any, y: Any, options: Sequence[int], code: int, *,
    tolerance: float | None = None, sizes: tuple[int, int] | None = None,
) -> None:
    """Write the answer to an ``.nl`` file.

    Parameters
    ----------
    path : str or Path
        The ``.sol`` file.
    message : str
        Lines for a person.
    x, y : array-like or None
        Values of the variables, shape (n,), and of the rows, shape (m,); None, or not finite: none are given.
    options, tolerance
        Of the first line of the ``.nl`` file (`NLContent`).
    code : int
        As `SolContent.code`.
    sizes : tuple of int, optional
        m and n, where x or y is None.
    """
    target = checked_path(path)
    duals, values = _given(y), _given(x)
    if sizes is None and (x is None or y is None):
        raise InvalidProblem("without x or y the file still says how many there are; give sizes=(m, n)")
    m, n = sizes or (np.size(y), np.size(x))
    for given, size, what in ((duals, m, "y"), (values, n, "x")):
        if given is not None and given.shape != (size,):
            raise InvalidProblem(f"{what} must have the shape ({size},), got {given.shape}")
    # A blank line ends the message, and a line that says Options would.
    lines = [line.rstrip() or " " for line in message.strip().splitlines()]
    lines = [f"- {line}" if line.lstrip().startswith(OPTIONS) else line for line in lines]
    lines.append("")
    if options and options[0]:
        has_tolerance = len(options) > 2 and options[2] == WITH_TOLERANCE
        lines += [OPTIONS, str(options[0] + 2 * has_tolerance), *map(str, options[1:options[0] + 1])]
        lines += map(str, (m, 0 if duals is None else m, n, 0 if values is None else n))
        lines += [repr(float(tolerance or 0.0))] * has_tolerance
    for given in (duals, values):
        lines += [] if given is None else map(repr, given.tolist())
    lines += [f"objno 0 {code}", ""]
    write_whole({target: lambda file: file.write("\n".join(lines).encode())})


def _given(values: Any) -> FloatVector | None:
    """Return the values, or None where no reader could take them."""
    if values is None:
        return None
    given = np.asarray(values, dtype=np.float64)
    return given if np.isfinite(given).all() else None


def read_sol(path: str | PathLike[str]) -> SolContent:
    """Return what a ``.sol`` file in text says; suffixes behind its end are passed over.

    Raises
    ------
    UnreadableFile
        Where it is missing, binary or damaged.
    """
    source = checked_path(path)
    with opened(source, ".sol file") as file:
        lines = file.read().decode("utf-8", errors="replace").splitlines()
    position = next((k for k, line in enumerate(lines) if line.strip() == OPTIONS), len(lines))
    message = "\n".join(line for line in lines[:position] if line.strip())
    rest = enumerate(lines[position + 1:], position + 2)
    try:
        if position == len(lines):
            raise ValueError(f"no line says {OPTIONS}")
        count = int(_next(rest))
        if not 2 <= count <= MOST_OPTIONS:
            raise ValueError(f"{count} options are announced, and 2 to {MOST_OPTIONS} are possible")
        options = [int(_next(rest)) for _ in range(2)]
        has_tolerance = options[1] == WITH_TOLERANCE
        count -= 2 * has_tolerance
        options += [int(_next(rest)) for _ in range(count - 2)]
        m, m_given, n, n_given = (int(_next(rest)) for _ in range(4))
        if min(m, n) < 0 or m_given not in (0, m) or n_given not in (0, n) or m_given + n_given > len(lines):
            raise ValueError(f"{m_given} of {m} dual and {n_given} of {n} primal values are announced")
        tolerance = float(_next(rest)) if has_tolerance else None
        duals, values = (np.array([float(_next(rest)) for _ in range(k)]) for k in (m_given, n_given))
        ending = next(rest, (0, ""))[1].split()
        code = int(ending[2]) if len(ending) == 3 and ending[0] == "objno" else -1  # none given
    except ValueError as error:
        line = next(rest, (len(lines) + 1, ""))[0] - 1
        raise UnreadableFile(f"cannot read {source}, line {line}: {error}; it is damaged, or "
                             "no .sol file in text") from error
    return SolContent(message, (count, *options), tolerance, m, n, duals if m_given or not m else None,
                      values if n_given or not n else None, code)


def _next(lines: Iterator[tuple[int, str]]) -> str:
    _, line = next(lines, (0, None))
    if line is None:
        raise ValueError("the file ends here")
    return line
