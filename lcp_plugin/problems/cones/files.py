"""Problems over cones in ``.npz`` files, without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from ...core.errors import InvalidProblem, UnreadableFile
from .data import CONES, ConeProblem
from .frictional_contact import FrictionalContact

LAYOUT = (
    "a FrictionalContact holds the CSR arrays data, indices, indptr, shape of W (or W), b (or q) and mu (or friction), "
    "with an axis in front where they are of many worlds, contacts beside them where these differ in size; "
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
    try:
        if "mu" in content or "friction" in content:
            M = content["W"] if "W" in content else content["M"]
            q = content["b"] if "b" in content else content["q"]
            friction = content["mu"] if "mu" in content else content["friction"]
            given = {name: content[name] for name in ("contacts", "dimension") if name in content}
            if "dimension" in given:
                given["dimension"] = int(given["dimension"])
            state = FrictionalContact.worlds if M.ndim == 3 else FrictionalContact
            return state(M, q, friction, **given)
        M, first, cones = content["M"], 0, []
        kinds, sizes = (_whole_numbers(content[name], name) for name in ("cone_kinds", "cone_rows"))
        if kinds.shape != sizes.shape:
            raise InvalidProblem(
                f"cone_kinds names {kinds.size} cones, and cone_rows has the rows of {sizes.size}"
            )
        if kinds.size and not 0 <= kinds.min() <= kinds.max() < len(CONES):
            raise InvalidProblem(f"cone_kinds must be 0 to {len(CONES) - 1}, got {kinds.tolist()}")
        for name in ("lower", "upper") if CONES.index("box") in kinds else ():
            if content[name].shape != (sizes.sum(),):
                raise InvalidProblem(
                    f"{name} must have shape ({sizes.sum()},), got {content[name].shape}"
                )
        for kind, rows in zip(kinds.tolist(), sizes.tolist(), strict=True):
            own = slice(first, first + rows)
            word = CONES[kind]
            cones.append(
                (word, content["lower"][own], content["upper"][own])
                if word == "box"
                else (word, rows)
            )
            first += rows
        return ConeProblem(M, content["q"], cones)
    except KeyError as error:
        raise UnreadableFile(f"{Path(source)} lacks the key {error}; {LAYOUT}") from error
    except (InvalidProblem, ValueError, IndexError, TypeError) as error:
        raise UnreadableFile(
            f"{Path(source)} states no problem over cones: {error}; {LAYOUT}"
        ) from error


def _whole_numbers(values: Any, name: str) -> Any:
    """Return a vector of integers, or raise InvalidProblem."""
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise InvalidProblem(f"{name} must be a vector of integers, got {values.tolist()!r}")
    return values
