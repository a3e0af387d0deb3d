"""Problems over cones in ``.npz`` files, without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import scipy.sparse as sp

from ...core.errors import InvalidProblem, UnreadableFile
from .data import CONES, ConeProblem, FrictionalContact

LAYOUT = (
    "a FrictionalContact holds the CSR arrays data, indices, indptr, shape of W (or W), b (or q) and mu (or friction); "
    "a ConeProblem those of M (or M), q, cone_kinds (0 free, 1 nonnegative, 2 box, 3 second order), cone_rows, and "
    "lower, upper where there are boxes"
)


def problem_of(content: Mapping[str, Any], source: str | PathLike[str]) -> Any:
    """Return the problem of the arrays that a file holds, by name.

    Raises
    ------
    UnreadableFile
        Where they state none.
    """
    name = "W" if "mu" in content or "friction" in content else "M"
    try:
        M = content.get(name)
        if M is None:
            parts = [content[key] for key in ("data", "indices", "indptr", "shape")]
            M = sp.csr_array(tuple(parts[:3]), shape=tuple(int(size) for size in parts[3]))
            M.check_format(full_check=True)
        if name == "W":
            q = content["b"] if "b" in content else content["q"]
            return FrictionalContact(M, q, content["mu"] if "mu" in content else content["friction"])
        first, cones = 0, []
        for kind, rows in zip(content["cone_kinds"].tolist(), content["cone_rows"].tolist(), strict=True):
            own = slice(first, first + rows)
            word = CONES[kind]
            cones.append((word, content["lower"][own], content["upper"][own]) if word == "box" else (word, rows))
            first += rows
        return ConeProblem(M, content["q"], cones)
    except KeyError as error:
        raise UnreadableFile(f"{Path(source)} lacks the key {error}; {LAYOUT}") from error
    except (InvalidProblem, ValueError, IndexError, TypeError) as error:
        raise UnreadableFile(f"{Path(source)} states no problem over cones: {error}; {LAYOUT}") from error
