"""Algorithms of other packages, which offer them as entry points.

``examples/add_an_algorithm.py`` writes one and says how a package offers it: ``name = "module:Class"`` in the group
``lcp_plugin.algorithms``. The name of the entry point must be the class's ``name``, and none of ours.

References
----------
Python Packaging Authority, *Entry points specification*,
https://packaging.python.org/specifications/entry-points/.
"""

from __future__ import annotations

import inspect
from functools import cache
from typing import TYPE_CHECKING

from ..core.algorithms import REGISTRY, Algorithm
from ..core.errors import UnknownAlgorithm, did_you_mean

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

ENTRY_POINT_GROUP = "lcp_plugin.algorithms"


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
