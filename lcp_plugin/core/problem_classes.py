"""The problem classes, and the functions that take them."""

from __future__ import annotations

from typing import Any

CLASSES = (
    "LCP",
    "NonlinearProblem",
    "QuadraticProgram",
    "EquilibriumProgram",
    "BoundedLeastSquares",
    "ConeProblem",
    "FrictionalContact",
)
# The classes that a function takes, or whose results it takes; LCP alone if it is not listed.
TAKES: dict[str, tuple[str, ...]] = {
    "solve": CLASSES,
    "solve_batch": CLASSES,
    "prepare": ("LCP", "QuadraticProgram"),
    "march": ("LCP", "ConeProblem", "FrictionalContact"),
    "trace": ("LCP", "QuadraticProgram", "BoundedLeastSquares"),
    "derivative": ("LCP", "NonlinearProblem", "ConeProblem", "FrictionalContact"),
    "certify": ("QuadraticProgram",),
}


def class_of(problem: Any) -> str | None:
    """Return the name of a problem's class, or None for any other object.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> class_of(LCP([[1.0]], [1.0])), class_of([1.0])
    ('LCP', None)
    """
    for kind in type(problem).__mro__:
        if kind.__name__ in CLASSES and kind.__module__.startswith("lcp_plugin."):
            return kind.__name__
    return None


def takes(function: str, problem: Any) -> bool:
    """Return whether a function takes a problem of this class."""
    return class_of(problem) in TAKES.get(function, ("LCP",))


def refusal(function: str, given: Any) -> str:
    """Return the error message for an argument that a function does not accept."""
    *most, last = TAKES.get(function, ("LCP",))
    needs = with_article(f"{', '.join(most)} or {last}" if most else last)
    step = ""
    if function == "derivative":
        needs = f"the result of {needs}"
        step = "; write derivative(solve(problem))" if class_of(given) else ""
        if isinstance(given, (list, tuple)):
            step = "; write [derivative(result) for result in results]"
    elif function == "solve":
        step = "; for a matrix M and a vector q write solve(LCP(M, q))"
    return f"{function} needs {needs}, got {type(given).__name__}{step}"


def with_article(word: str) -> str:
    """Return a word with its article."""
    return f"an {word}" if word[0] in "AEIOU" or word.startswith("LCP") else f"a {word}"
