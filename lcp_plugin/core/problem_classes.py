"""The table of problem classes: solver, functions that take them, typed options, form of a batch.

The second table has functions of higher floors that a class or a function of a lower floor offers, by name.
``lcp_plugin/__init__.py`` is above all floors and fills it, so no file names a file of a higher floor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from operator import attrgetter
from types import MethodType
from typing import Any, NamedTuple

from .errors import public

#: Options of every run with iterations.
WATCHED = "tolerance max_seconds max_iterations record threads verbose"


class ProblemClass(NamedTuple):
    """Row of the table of problem classes.

    Attributes
    ----------
    solver : str
        Module, from the package on, and function. The module also has the function `planned` of `analyze`: it returns
        the letter of a matrix, the matrix or None, and the stages of auto.
    functions : str
        Functions that take the class, or its results, in addition to `solve`, `solve_batch` and `analyze`.
    options : str
        Options that the solver passes on to Settings; "" if it names all in its signature.
    criterion : str
        Module and function that return the data of the stopping criterion at a point, for rows of pairs.
    verdict : str
        Module and function that return the fields of the verdict on a point, for other classes.
    batch : str
        Arguments with which one problem makes a batch.
    """

    solver: str
    functions: str = ""
    options: str = ""
    criterion: str = ""
    verdict: str = ""
    batch: str = "[problem]"


CONE_CLASS = ProblemClass(
    "problems.cones.solving:solve_cones",
    "march derivative certify",
    f"{WATCHED} absolute_tolerance prove_infeasibility",
    "problems.cones.certificate:criterion_at",
)
CLASSES = {
    "LCP": ProblemClass(
        "solving.lcp_solver:solve_lcp",
        "prepare march trace derivative certify",
        criterion="judges.lcp:criterion_at",
        batch="problem, Q",
    ),
    "NonlinearProblem": ProblemClass(
        "problems.nonlinear.solving:solve_nonlinear",
        "prepare march trace derivative certify",
        f"{WATCHED} absolute_tolerance",
        "problems.nonlinear.solving:criterion_at",
    ),
    "QuadraticProgram": ProblemClass(
        "problems.programs.solving:solve_program",
        "prepare trace derivative certify",
        batch="program, C",
    ),
    "EquilibriumProgram": ProblemClass(
        "problems.equilibria.branch_and_bound:minimize_over_solutions",
        "certify",
        verdict="problems.equilibria.certificate:verdict_at",
    ),
    "BoundedLeastSquares": ProblemClass(
        "problems.least_squares.solving:solve_least_squares",
        "prepare trace derivative certify",
        WATCHED,
        verdict="problems.least_squares.solving:verdict_at",
        batch="problem, B",
    ),
    "ConeProblem": CONE_CLASS,
    "FrictionalContact": CONE_CLASS._replace(functions=f"prepare {CONE_CLASS.functions}"),
}


def classes_of(function: str) -> list[str]:
    """Return the names of the classes that a function takes; LCP alone if the table does not name it."""
    if function in ("solve", "solve_batch", "analyze"):
        return [*CLASSES]
    return [name for name, row in CLASSES.items() if function in row.functions.split()] or ["LCP"]


def class_of(problem: object) -> str | None:
    """Return the name of a problem's class, or None for any other object.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> class_of(LCP([[1.0]], [1.0])), class_of([1.0])
    ('LCP', None)
    """
    for base in type(problem).__mro__:
        if base.__name__ in CLASSES and base.__module__.startswith("lcp_plugin."):
            return base.__name__
    return None


# calls for models of other packages, by package
OF_MODELS = {
    "cvxpy": '; write problem.solve(method="LCP")',
    "pyomo": '; write SolverFactory("lcp_plugin").solve(model) after import lcp_plugin.pyomo',
}


def refusal(function: str, argument: object) -> str:
    """Return the error message for an argument that a function does not accept."""
    *most, last = classes_of(function)
    needs = with_article(f"{', '.join(most)} or {last}" if most else last)
    step = ""
    if function == "derivative":
        needs = f"the result of {needs}"
        results = None if isinstance(argument, str) else argument
        if class_of(argument) in classes_of(function):
            step = "; write derivative(solve(problem))"
        elif isinstance(results, Sequence) and all(  # a march is a sequence
            hasattr(result, "status") or isinstance(result, Sequence) for result in results
        ):
            step = "; write [derivative(result) for result in results]"
    elif function == "solve":
        package = type(argument).__module__.partition(".")[0]
        step = OF_MODELS.get(package, "; for a matrix M and a vector q write solve(LCP(M, q))")
        if type(argument).__name__.endswith("Batch"):
            step = "; write solve_batch(…)"
    return f"{function} needs {needs}, got {type(argument).__name__}{step}"


def with_article(word: str) -> str:
    """Return a word with its article."""
    return f"an {word}" if word[0] in "AEIOU" or word.startswith("LCP") else f"a {word}"


# (class or package of models, verb) → "module:function", from the package on
DOORS: dict[tuple[str, str], str] = {}


class Door:
    """Method of a class, or function if `is_static`, that is loaded on first access.

    Parameters
    ----------
    is_static : bool
    """

    def __init__(self, *, is_static: bool = False) -> None:
        self.is_static = is_static

    def __set_name__(self, owner: type, name: str) -> None:
        """Note the key under which the table has the function."""
        self.key = owner.__name__, name

    def __get__(self, instance: object, owner: type) -> Any:
        """Return the function, bound to the instance unless it is static."""
        function = _function(self.key, ".".join(self.key))
        return function if self.is_static or instance is None else MethodType(function, instance)


def foreign_function(verb: str, model: object) -> Callable[..., Any] | None:
    """Return the function of a verb for a model of another package; None for any other object.

    Examples
    --------
    >>> foreign_function("certify", 1.0) is None
    True
    """
    keys = ((base.__module__.partition(".")[0], verb) for base in type(model).__mro__)
    return next((_function(key, verb) for key in keys if key in DOORS), None)


def _function(key: tuple[str, str], name: str) -> Callable[..., Any]:
    module, _, path = DOORS[key].partition(":")
    function: Callable[..., Any] = attrgetter(path)(import_module(f"lcp_plugin.{module}"))
    return public(function, name)
