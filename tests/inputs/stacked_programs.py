"""Lists of programs from arrays with an axis for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lcp_plugin import QuadraticProgram

AXES = {"P": 2, "c": 1, "G": 2, "h": 1, "A": 2, "b": 1, "lower": 1, "upper": 1, "constant": 0}


def programs_of(
    P: Any, c: Any, G: Any = None, h: Any = None, **rest: Any
) -> list[QuadraticProgram]:
    """Return a program for each item of the first axis of the stacked arrays; other arrays are the same for all."""
    given = {"P": P, "c": c, "G": G, "h": h, **rest}
    stacked = {name for name, one in given.items() if np.ndim(one) > AXES[name]}
    count = max((len(given[name]) for name in stacked), default=1)
    return [
        QuadraticProgram(
            **{name: one[k] if name in stacked else one for name, one in given.items()}
        )
        for k in range(count)
    ]
