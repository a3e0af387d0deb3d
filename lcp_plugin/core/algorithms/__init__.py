"""Algorithms: what one is, and by which name it is had; rooms and other packages add theirs.

``examples/add_an_algorithm.py`` writes one and says how a package offers it. The name of the entry point must be the
class's ``name``, and none of ours. The class attributes ``assumption``, ``converges_on``, ``cost`` and ``reference``
are what ``lcp-plugin list`` tells.

The classes are had from :mod:`lcp_plugin.algorithms`. An instance holds its options, and is refused where one is wrong:

>>> from lcp_plugin import LCP, solve
>>> from lcp_plugin.algorithms import NPSOR
>>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
>>> solve(problem, NPSOR(relaxation=1.5)).iterations == solve(problem, "npsor", relaxation=1.5).iterations
True
"""

from __future__ import annotations

import inspect
from dataclasses import MISSING, fields
from functools import cache
from typing import TYPE_CHECKING, Any

from ..errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ..registry import at, missing, offered
from ..settings import OF_SOLVE
from .base import Algorithm, FusedSolve, Step

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "ENTRY_POINT_GROUP",
    "REGISTRY",
    "Algorithm",
    "FusedSolve",
    "Step",
    "algorithm_class",
    "create",
    "from_other_packages",
    "made",
    "module_of",
]

ENTRY_POINT_GROUP = "lcp_plugin.algorithms"

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


def __getattr__(class_name: str) -> type[Algorithm]:
    for name, place in REGISTRY.items():
        if place.endswith(f":{class_name}"):
            return algorithm_class(name)
    raise AttributeError(f"module {__name__!r} has no attribute {class_name!r}")


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
    Other packages offer an algorithm as ``name = "module:Class"`` in the entry point group ``lcp_plugin.algorithms``.
    What is installed is only looked through for a name that is not in `REGISTRY`.

    References
    ----------
    Python Packaging Authority, *Entry points specification*,
    https://packaging.python.org/specifications/entry-points/.

    Examples
    --------
    >>> algorithm_class("psor").__name__
    'PSOR'
    """
    if name not in REGISTRY:
        return _class_from_outside(name)
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


def from_other_packages() -> dict[str, type[Algorithm] | UnknownAlgorithm]:
    """Return what installed packages offer: the class of each name, or the error that says why it cannot be used."""
    found: dict[str, type[Algorithm] | UnknownAlgorithm] = {}
    for name, offers in sorted(_offers().items()):
        try:
            found[name] = _checked_offer(name, offers)
        except UnknownAlgorithm as error:
            found[name] = error
    return found


def _offers() -> dict[str, list[EntryPoint]]:
    from importlib.metadata import entry_points

    offers: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        offers.setdefault(entry.name, []).append(entry)
    return offers


@cache
def _class_from_outside(name: str) -> type[Algorithm]:
    if words := missing("algorithm", name):
        raise UnknownAlgorithm(words)
    offers = _offers()
    if name not in offers:
        raise UnknownAlgorithm(f"unknown algorithm {name!r}{did_you_mean(name, {'auto', *REGISTRY, *offers})}")
    return _checked_offer(name, offers[name])


def _checked_offer(name: str, offers: list[EntryPoint]) -> type[Algorithm]:
    """Return the class that stands behind an entry point, or raise naming the package and what it should mend."""
    packages = " and ".join(sorted({_package(entry) for entry in offers}))
    if name == "auto" or name in REGISTRY:
        raise UnknownAlgorithm(f"{packages}: the name {name!r} belongs to lcp_plugin; the package must choose another")
    if len(offers) > 1:
        raise UnknownAlgorithm(f"{packages}: {name!r} is offered more than once; uninstall all but one")
    entry = offers[0]
    wanted = f'the entry point must read {name} = "module:Class" and name a subclass of lcp_plugin.algorithms.Algorithm'
    try:
        kind = entry.load()
    except Exception as error:  # a foreign module may raise anything while it is imported
        reason = f"{type(error).__name__}: {error}"
        raise UnknownAlgorithm(
            f"{packages}: the algorithm {name!r} cannot be loaded from {entry.value!r} ({reason}); "
            "repair or uninstall the package"
        ) from error
    if not (inspect.isclass(kind) and issubclass(kind, Algorithm)):
        raise UnknownAlgorithm(f"{packages}: {entry.value!r} is {kind!r}; {wanted}")
    if inspect.isabstract(kind):
        raise UnknownAlgorithm(f"{packages}: the class {kind.__name__} has no method iterates(problem, z0); write it")
    if getattr(kind, "name", None) != name:
        raise UnknownAlgorithm(
            f"{packages}: the entry point is called {name!r}, but {kind.__name__}.name is "
            f"{getattr(kind, 'name', None)!r}; they must be equal"
        )
    return kind


def _package(entry: EntryPoint) -> str:
    return f"package {entry.dist.name} {entry.dist.version}" if entry.dist is not None else "a package without name"


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
