"""Algorithms: what one is, and by which name it is had; rooms and other packages add theirs.

``examples/add_an_algorithm.py`` writes one and says how a package offers it. The class attributes ``assumption``,
``converges_on``, ``cost`` and ``reference`` are what ``lcp-plugin list`` tells.

The classes are had from :mod:`lcp_plugin.algorithms`. An instance holds its options, and is refused where one is wrong:

>>> from lcp_plugin import LCP, solve
>>> from lcp_plugin.algorithms import NPSOR
>>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
>>> solve(problem, NPSOR(relaxation=1.5)).iterations == solve(problem, "npsor", relaxation=1.5).iterations
True
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any

from ..errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ..registry import ask_or_none, at, missing, offered
from ..settings import OF_SOLVE
from .base import Algorithm, FusedSolve, Step

__all__ = ["REGISTRY", "Algorithm", "FusedSolve", "Step", "algorithm_class", "create", "made", "module_of"]

REGISTRY = {
    "npj": "core.splittings.projected_type:NPJ",
    "npgs": "core.splittings.projected_type:NPGS",
    "npsor": "core.splittings.projected_type:NPSOR",
    "npaor": "core.splittings.projected_type:NPAOR",
    "pj": "core.splittings.projected_relaxation:PJ",
    "pgs": "core.splittings.projected_relaxation:PGS",
    "psor": "core.splittings.projected_relaxation:PSOR",
    "paor": "core.splittings.projected_relaxation:PAOR",
    "gfp": "core.splittings.projected_relaxation:GFP",
    **offered("algorithm"),
}


def algorithm_class(name: str) -> type[Algorithm]:
    """Return the class registered under the name, here or by an installed package.

    Parameters
    ----------
    name : str
        One that ``lcp-plugin list`` shows.

    Raises
    ------
    UnknownAlgorithm
        With the closest known name, or with what is wrong with the package that offers it.

    Notes
    -----
    Other packages offer algorithms as :mod:`lcp_plugin.doors.packages` says. What is installed is only looked through
    for a name that is not in `REGISTRY`.

    Examples
    --------
    >>> algorithm_class("psor").__name__
    'PSOR'
    """
    if name not in REGISTRY:
        if words := missing("algorithm", name):
            raise UnknownAlgorithm(words)
        if (from_outside := ask_or_none("algorithm of another package", "class")) is None:
            raise UnknownAlgorithm(f"unknown algorithm {name!r}{did_you_mean(name, {'auto', *REGISTRY})}")
        return from_outside(name)  # type: ignore[no-any-return]
    found: type[Algorithm] = at(REGISTRY[name])
    return found


def module_of(name: str) -> str:
    """Return the module of a registered algorithm, which is its family; of any other name the name itself.

    Examples
    --------
    >>> module_of("psor"), module_of("gfp"), module_of("auto")
    ('projected_relaxation', 'projected_relaxation', 'auto')
    """
    return REGISTRY.get(name, name).partition(":")[0].rpartition(".")[2]


def create(name: str, options: dict[str, Any]) -> Algorithm:
    """Return the named algorithm with these options.

    Parameters
    ----------
    name : str
        One that ``lcp-plugin list`` shows.
    options : dict
        Values of the options by name; those not given take their defaults.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        With the right names and a guess, or the names of options that have no default.
    """
    return made(algorithm_class(name), name, options)


def made(kind: type[Algorithm], name: str, options: dict[str, Any]) -> Algorithm:
    """Return an instance of the class with these options; raise InvalidOption as `create` does."""
    try:
        return kind(**options)
    except InvalidOption:
        raise
    except TypeError:
        required = {field.name: field.default is field.default_factory is MISSING for field in fields(kind)}
        for option in options:
            if option not in required:
                hint = did_you_mean(option, required, OF_SOLVE)
                raise InvalidOption(f"{name} has no option {option!r}{hint}") from None
        missing = [option for option, is_required in required.items() if is_required and option not in options]
        if not missing:
            raise
        raise InvalidOption(
            f"{name} needs a value for {' and '.join(missing)}, which has no default; give one"
        ) from None
