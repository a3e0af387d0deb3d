"""What ``.sol`` files say, for tests of what writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lcp_plugin.interfaces.nl.content import WITH_TOLERANCE
from lcp_plugin.interfaces.nl.solution import OPTIONS


class SolContent(NamedTuple):
    """The message, the first line of the ``.nl`` file, m and n, duals and values or None, and the code."""

    message: str
    options: tuple[int, ...]
    tolerance: float | None
    rows: int
    variables: int
    duals: Any
    values: Any
    code: int


def read_sol(path: Path) -> SolContent:
    """Return what a ``.sol`` file in text says."""
    lines = path.read_text(encoding="utf-8").splitlines()
    begin = next(k for k, line in enumerate(lines) if line.strip() == OPTIONS)
    message, rest = (
        "\n".join(line for line in lines[:begin] if line.strip()),
        iter(lines[begin + 1 :]),
    )
    count, *options = (int(next(rest)) for _ in range(3))
    has_tolerance = options[1] == WITH_TOLERANCE
    count -= 2 * has_tolerance
    options += [int(next(rest)) for _ in range(count - 2)]
    m, m_given, n, n_given = (int(next(rest)) for _ in range(4))
    tolerance = float(next(rest)) if has_tolerance else None
    duals, values = (np.array([float(next(rest)) for _ in range(k)]) for k in (m_given, n_given))
    _, _, code = next(rest).split()
    return SolContent(
        message,
        (count, *options),
        tolerance,
        m,
        n,
        duals if m_given or not m else None,
        values if n_given or not n else None,
        int(code),
    )
