"""A problem as a table of named data: the names of the arguments of a problem class that other problems may change."""

from __future__ import annotations

import sys
from typing import Any, ClassVar

from .names import shared_labels


class Problem:
    """Base of the problem classes. All functions that take the data by name read the names here.

    Attributes
    ----------
    matrix_names, vector_names, other_names : tuple of str
        Names of arguments and attributes; the bounds are the last two vectors.
    start_name : str
        Name of a start in `solve`.
    axes : tuple of str
        Arguments, each with a letter for each of its axes: those with one letter have the same labels, see
        :func:`lcp_plugin.core.names.shared_labels`.
    """

    axes: ClassVar[tuple[str, ...]] = ("M wz", "q w", "lower z", "upper z")
    matrix_names: ClassVar[tuple[str, ...]] = ("M",)
    vector_names: ClassVar[tuple[str, ...]] = ("q", "lower", "upper")
    other_names: ClassVar[tuple[str, ...]] = ("names",)
    start_name: ClassVar[str] = "z0"

    def with_data(self, **data: Any) -> Any:
        """Return the problem with other data by name, the present ones for None; as `with_vectors` without matrices."""
        given = {name: value for name, value in data.items() if value is not None}
        if given.keys().isdisjoint(self.matrix_names):
            return self.with_vectors(**given)
        names = *self.matrix_names, *self.vector_names, *self.other_names
        return type(self)(**({name: getattr(self, name) for name in names} | given))

    def with_vectors(self, **vectors: Any) -> Any:
        """Return the problem with other vectors by name, the present ones by default; it shares all facts about M."""
        q = vectors.pop("q", None)
        return self.with_q(self.q if q is None else q, **vectors)  # type: ignore[attr-defined]


def check_labels(problem: Any, data: dict[str, Any]) -> None:
    """Raise InvalidProblem if labels of pandas in `data` are names of a problem in another order."""
    if "pandas" in sys.modules and isinstance(problem, Problem):
        rows, unknowns = getattr(problem, "names", None) or (None, None)
        known = {"w": rows or unknowns, "z": unknowns, "x": unknowns}
        if isinstance(rows, list):
            m = len(getattr(problem, "h", ()))
            known |= {"g": rows[:m], "a": rows[m:]}
        others = "x z", "x0 z", "z0 z", "q kw", "q kx"  # points, and rows of a batch
        shared_labels((*problem.axes, *others), data, known)
