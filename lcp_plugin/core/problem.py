"""A problem as a table of named data: the names of the arguments of a problem class that other problems may change."""

from __future__ import annotations

from typing import Any, ClassVar


class Problem:
    """Base of the problem classes. All functions that take the data by name read the names here.

    Attributes
    ----------
    matrix_names, vector_names : tuple of str
        Names of arguments and attributes; the bounds are the last two vectors.
    """

    matrix_names: ClassVar[tuple[str, ...]] = ("M",)
    vector_names: ClassVar[tuple[str, ...]] = ("q", "lower", "upper")

    def with_vectors(self, **vectors: Any) -> Any:
        """Return the problem with other vectors by name, the present ones by default; it shares all facts about M."""
        q = vectors.pop("q", None)
        return self.with_q(self.q if q is None else q, **vectors)  # type: ignore[attr-defined]
