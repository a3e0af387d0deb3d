"""The solver of each problem class, by the table of classes; the algorithm, the settings and the options of a call."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cache, partial
from pkgutil import resolve_name
from typing import Any

import numpy as np

from ..algorithms import create, refusal_of_engine
from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ..core.problem import check_labels
from ..core.problem_classes import CLASSES, class_of, classes_of, refusal, with_article
from ..core.settings import BESIDE, DEFAULT, OF_SOLVE, Settings
from ..engines.engine import Engine


def solve(problem: object, algorithm: object = "auto", **options: Any) -> Any:
    """Return the result of the solver of a problem's class; :func:`lcp_plugin.solve` describes the parameters."""
    return solver_with(problem, algorithm, options)(problem)


def solver_with(
    problem: Any, algorithm: Any, options: dict[str, Any], function: str = "solve"
) -> Callable[..., Any]:
    """Return the solver of a problem's class with the options of a call of a function, whose names are checked."""
    name = class_of(problem)
    if name not in classes_of(function):
        raise InvalidOption(refusal(function, problem))
    if isinstance(algorithm, (np.ndarray, list, tuple)):
        raise UnknownAlgorithm("algorithm must be a name or an object; a start is z0=…")
    if not isinstance(algorithm, str) or algorithm != "auto":
        options["algorithm"] = algorithm
    if callable(callback := options.get("callback")):  # it keeps the caller's floating-point state
        options["callback"] = np.errstate(**np.geterr())(callback)
    check_labels(problem, options)
    known = options_of(name)
    if "z0" in options and "z0" not in known and "x0" in known:  # the unknown is called x
        options["x0"] = options.pop("z0")
    if "x0" in options and "x0" not in known:
        raise InvalidOption(f"solve takes no x0 for {with_article(name)}; the start is called z0")
    for option in () if "options" in known else options:
        if option not in known:
            hint = did_you_mean(option, known)
            raise InvalidOption(f"solve takes no {option} for {with_article(name)}{hint}")
    return partial(solver_of(name), **options)


@cache
def solver_of(name: str) -> Callable[..., Any]:
    """Return the function that solves a class of problem."""
    return resolve_name(f"lcp_plugin.{CLASSES[name].solver}")


@cache
def options_of(name: str) -> Mapping[str, Any]:
    """Return the options of the solver of a class; "options" is among them if it accepts an algorithm's options."""
    known = dict.fromkeys([*inspect.signature(solver_of(name)).parameters][1:])
    if typed := CLASSES[name].options:
        known = dict.fromkeys([*known, *typed.split()])
        del known["options"]
    return known


def parse_call(
    algorithm: str | Algorithm, arguments: dict[str, Any], plain: Settings = DEFAULT
) -> tuple[Algorithm | None, Settings]:
    """Return the method (None for auto) and the settings of a call, `plain` without arguments, which may be z0."""
    if not arguments:
        return method_of(algorithm, arguments), plain
    items = arguments.items()
    of_solve = {name: value for name, value in items if name in OF_SOLVE and name not in BESIDE}
    settings = Settings(**of_solve)
    options = {name: value for name, value in items if name not in OF_SOLVE}
    return method_of(algorithm, options), settings


def method_of(algorithm: object, options: dict[str, Any]) -> Algorithm | None:
    """Return the algorithm object for the `algorithm` and the options of a call; None for "auto".

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        If the name or an option does not exist.
    """
    if isinstance(algorithm, str):
        if algorithm != "auto":
            return create(algorithm, options)
        if options:
            hint = did_you_mean(next(iter(options)), (), OF_SOLVE)
            if {"method", "solver"} & options.keys():
                hint = "; did you mean algorithm=…?"
            if "prove" in options:
                hint = "; prove=True needs an objective; did you mean prove_infeasibility=…?"
            name_one = "" if "did you mean" in hint else "; name an algorithm as well"
            raise InvalidOption(
                f'algorithm="auto" has no options, got {sorted(options)}{name_one}{hint}'
            )
        return None
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(
                f"options {sorted(options)} were given with an algorithm object; "
                f"set them in {type(algorithm).__name__}(…){did_you_mean(next(iter(options)), (), OF_SOLVE)}"
            )
        if not getattr(algorithm, "name", ""):
            raise InvalidOption(
                f'{type(algorithm).__name__} has no name; write name = "…" in the class'
            )
        return algorithm
    if isinstance(algorithm, Engine):
        raise refusal_of_engine(algorithm.name)
    got = repr(algorithm)
    if isinstance(algorithm, type):
        got = f"the class {algorithm.__name__}"
        got += f"; write {algorithm.__name__}()" if issubclass(algorithm, Algorithm) else ""
    raise UnknownAlgorithm(
        f"algorithm must be a name or an object such as PSOR(relaxation=1.5), got {got}"
    )
