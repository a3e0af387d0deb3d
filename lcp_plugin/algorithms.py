"""The algorithms by their names: a table of our classes, and those that installed packages offer.

An algorithm is a class below :class:`Algorithm` with ``name``, its options as fields, ``needs``, ``solves``, ``cost``
and ``reference``, which ``lcp-plugin list`` and the manual's table tell. Ours is a file in ``methods/`` and a line of
`REGISTRY`; a class without a line is a step of ``auto`` alone. Another package offers one as an entry point,
``name = "module:Class"`` in the group ``lcp_plugin.algorithms``: the name of the entry point must be the class's, and
none of ours. ``examples/add_an_algorithm.py`` writes one. Convex programs have engines, too, other people's solvers, in
a table of their own (:mod:`lcp_plugin.engines`).

An instance holds its options, and is refused where one is wrong:

>>> from lcp_plugin import LCP, solve
>>> from lcp_plugin.algorithms import NPSOR
>>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
>>> solve(problem, NPSOR(relaxation=1.5)).iterations == solve(problem, "npsor", relaxation=1.5).iterations
True

References
----------
Python Packaging Authority, *Entry points specification*,
https://packaging.python.org/specifications/entry-points/.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from .core.algorithm import Algorithm, FusedSolve, Step
from .core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from .core.settings import OF_SOLVE
from .engines import ENGINES, engine_class

if TYPE_CHECKING:  # for editors and mypy: __getattr__ has each class of the registry by its name
    from importlib.metadata import EntryPoint

    from .core.splittings.projected_relaxation import GFP, PAOR, PGS, PJ, PSOR
    from .core.splittings.projected_type import NPAOR, NPGS, NPJ, NPSOR
    from .methods.banded import Banded
    from .methods.interior_point import InteriorPoint
    from .methods.lemke import Lemke
    from .methods.modulus.modulus import MAOR, MGS, MJ, MSOR
    from .methods.multigrid import Multigrid
    from .methods.newton.semismooth_newton import Newton
    from .methods.npsplitting import NPSplitting

ENTRY_POINT_GROUP = "lcp_plugin.algorithms"


class Registry(Mapping[str, type[Algorithm]]):
    """Classes by their names; a solve imports those that it takes, and no other.

    Parameters
    ----------
    places : mapping
        Each name's ``module:Class``, the module from this package on.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self._places = {name: tuple(place.split(":")) for name, place in places.items()}

    def __getitem__(self, name: str) -> type[Algorithm]:
        module, word = self._places[name]
        found: type[Algorithm] = getattr(import_module(f".{module}", __package__), word)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def module(self, name: str) -> str:
        """Return the module in which the class of that name is written, from this package on."""
        return self._places[name][0]

    def name_of(self, word: str) -> str | None:
        """Return the name of the class that is called so, None where there is none."""
        return next((name for name, (_, own) in self._places.items() if own == word), None)


REGISTRY = Registry(
    {
        "psor": "core.splittings.projected_relaxation:PSOR",
        "pgs": "core.splittings.projected_relaxation:PGS",
        "paor": "core.splittings.projected_relaxation:PAOR",
        "pj": "core.splittings.projected_relaxation:PJ",
        "gfp": "core.splittings.projected_relaxation:GFP",
        "npaor": "core.splittings.projected_type:NPAOR",
        "npsor": "core.splittings.projected_type:NPSOR",
        "npgs": "core.splittings.projected_type:NPGS",
        "npj": "core.splittings.projected_type:NPJ",
        "banded": "methods.banded:Banded",
        "interior_point": "methods.interior_point:InteriorPoint",
        "lemke": "methods.lemke:Lemke",
        "maor": "methods.modulus.modulus:MAOR",
        "msor": "methods.modulus.modulus:MSOR",
        "mgs": "methods.modulus.modulus:MGS",
        "mj": "methods.modulus.modulus:MJ",
        "multigrid": "methods.multigrid:Multigrid",
        "newton": "methods.newton.semismooth_newton:Newton",
        "npsplitting": "methods.npsplitting:NPSplitting",
    }
)

__all__ = [
    "ENTRY_POINT_GROUP",
    "REGISTRY",
    "Algorithm",
    "FusedSolve",
    "Step",
    "algorithm_class",
    "create",
    "from_other_packages",
    "module_of",
]


def __getattr__(name: str) -> Any:
    registered = REGISTRY.name_of(name)
    if registered is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return REGISTRY[registered]


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
    What is installed is only looked through for a name that is not in `REGISTRY`.

    Examples
    --------
    >>> algorithm_class("psor").__name__
    'PSOR'
    """
    return REGISTRY[name] if name in REGISTRY else class_from_outside(name)


def module_of(name: str) -> str:
    """Return the module of a registered algorithm, which is its family; of any other name the name itself.

    Examples
    --------
    >>> module_of("psor"), module_of("gfp"), module_of("auto")
    ('projected_relaxation', 'projected_relaxation', 'auto')
    """
    return REGISTRY.module(name).rpartition(".")[2] if name in REGISTRY else name


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
        required = {
            field.name: field.default is field.default_factory is MISSING for field in fields(kind)
        }
        for option in options:
            if option not in required:
                hint = did_you_mean(option, required, OF_SOLVE)
                raise InvalidOption(f"{name} has no option {option!r}{hint}") from None
        missing = [
            option
            for option, is_required in required.items()
            if is_required and option not in options
        ]
        if not missing:
            raise
        raise InvalidOption(
            f"{name} needs a value for {' and '.join(missing)}, which has no default; give one"
        ) from None


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
def class_from_outside(name: str) -> type[Algorithm]:
    """Return the class that an installed package offers by that name; raise UnknownAlgorithm where there is none."""
    offers = _offers()
    if name in ENGINES:
        raise refusal_of_engine(name)
    if name not in offers:
        hint = did_you_mean(name, {"auto", *REGISTRY, *ENGINES, *offers}, is_listed=True)
        raise UnknownAlgorithm(f"unknown algorithm {name!r}{hint}")
    return _checked_offer(name, offers[name])


def refusal_of_engine(name: str) -> UnknownAlgorithm:
    """Return the error that says which problems the engine solves, and how an LCP is stated for it."""
    return UnknownAlgorithm(
        f"{name} is an engine for {engine_class(name).solves}, not for this problem; the convex program of an LCP "
        f"whose M is positive semidefinite is problem.to_qp(): solve(problem.to_qp(), {name!r})"
    )


def _checked_offer(name: str, offers: list[EntryPoint]) -> type[Algorithm]:
    """Return the class that stands behind an entry point, or raise naming the package and what it should mend."""
    packages = " and ".join(sorted({_package(entry) for entry in offers}))
    if name == "auto" or name in REGISTRY or name in ENGINES:
        raise UnknownAlgorithm(
            f"{packages}: the name {name!r} belongs to lcp_plugin; the package must choose another"
        )
    if len(offers) > 1:
        raise UnknownAlgorithm(
            f"{packages}: {name!r} is offered more than once; uninstall all but one"
        )
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
        raise UnknownAlgorithm(
            f"{packages}: the class {kind.__name__} has no method iterates(problem, z0); write it"
        )
    if getattr(kind, "name", None) != name:
        raise UnknownAlgorithm(
            f"{packages}: the entry point is called {name!r}, but {kind.__name__}.name is "
            f"{getattr(kind, 'name', None)!r}; they must be equal"
        )
    return kind


def _package(entry: EntryPoint) -> str:
    return (
        f"package {entry.dist.name} {entry.dist.version}"
        if entry.dist is not None
        else "a package without name"
    )
