"""``.sol`` files: message, dual and primal values, and the code of the outcome.

Always text: AMPL's reader takes text after a binary ``.nl`` as well, and others read nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.errors import InvalidProblem
from ..files.files import checked_path, write_whole
from .content import WITH_TOLERANCE

OPTIONS = "Options"


def write_sol(
    path: str | PathLike[str],
    message: str,
    x: Any,
    y: Any,
    options: Sequence[int],
    code: int,
    *,
    tolerance: float | None = None,
    sizes: tuple[int, int] | None = None,
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
        0 to 99 solved, 100 solved to a lower precision, 200 infeasible, 300 unbounded, 400 limit, 500 failure.
    sizes : tuple of int, optional
        m and n, if x or y is None.
    """
    target = checked_path(path)
    duals, values = _given(y), _given(x)
    if sizes is None and (x is None or y is None):
        raise InvalidProblem(
            "without x or y the file still says how many there are; give sizes=(m, n)"
        )
    m, n = sizes or (np.size(y), np.size(x))
    for given, size, what in ((duals, m, "y"), (values, n, "x")):
        if given is not None and given.shape != (size,):
            raise InvalidProblem(f"{what} must have the shape ({size},), got {given.shape}")
    # A blank line ends the message, and also a line that starts with Options.
    lines = [line.rstrip() or " " for line in message.strip().splitlines()]
    lines = [f"- {line}" if line.lstrip().startswith(OPTIONS) else line for line in lines]
    lines.append("")
    if options and options[0]:
        has_tolerance = len(options) > 2 and options[2] == WITH_TOLERANCE
        lines += [
            OPTIONS,
            str(options[0] + 2 * has_tolerance),
            *map(str, options[1 : options[0] + 1]),
        ]
        lines += map(str, (m, 0 if duals is None else m, n, 0 if values is None else n))
        lines += [repr(float(tolerance or 0.0))] * has_tolerance
    for given in (duals, values):
        lines += [] if given is None else map(repr, given.tolist())
    lines += [f"objno 0 {code}", ""]
    write_whole({target: lambda file: file.write("\n".join(lines).encode())})


def _given(values: Any) -> FloatVector | None:
    """Return the values, or None if no reader could take them."""
    if values is None:
        return None
    given = np.asarray(values, dtype=np.float64)
    return given if np.isfinite(given).all() else None
