"""``.sol`` files: message, dual and primal values, and the code of the outcome.

Always text: AMPL's reader takes text after a binary ``.nl`` as well, and others read nothing else.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from ..files.files import checked_path, write_whole
from .content import WITH_TOLERANCE, NLContent

OPTIONS = "Options"


def write_sol(
    path: str | PathLike[str], content: NLContent, message: str, x: Any, y: Any, code: int
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
        Values of the variables, shape (n,), and of the rows, shape (m,); None, or not finite: none are given.
    code : int
        0 to 99 solved, 100 solved to a lower precision, 200 infeasible, 300 unbounded, 400 limit, 500 failure.
    """
    target, options = checked_path(path), content.options
    duals, values = (
        None if given is None or not np.isfinite(given).all() else given for given in (y, x)
    )
    m, n = content.row_lower.size, content.lower.size
    # A blank line ends the message, and also a line that starts with Options.
    lines = [line.rstrip() or " " for line in message.strip().splitlines()]
    lines = [f"- {line}" if line.lstrip().startswith(OPTIONS) else line for line in lines]
    lines.append("")
    if options[0]:
        has_tolerance = len(options) > 2 and options[2] == WITH_TOLERANCE
        lines += [
            OPTIONS,
            str(options[0] + 2 * has_tolerance),
            *map(str, options[1 : options[0] + 1]),
        ]
        lines += map(str, (m, 0 if duals is None else m, n, 0 if values is None else n))
        lines += [repr(float(content.tolerance or 0.0))] * has_tolerance
    for given in (duals, values):
        lines += [] if given is None else map(repr, given.tolist())
    lines += [f"objno 0 {code}", ""]
    write_whole({target: lambda file: file.write("\n".join(lines).encode())})
