"""What rooms offer by name, imported when it is first asked for: whoever asks here imports no room.

The front door says in :mod:`lcp_plugin.rooms` which room has what. A room that is not here offers nothing; who asks for
what it has is told so.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from .errors import InvalidOption

PACKAGE = __name__.partition(".")[0]
_PLACES: dict[str, dict[str, str]] = {}


def offer(what: str, places: Mapping[str, str]) -> None:
    """Take note of where things are.

    Parameters
    ----------
    what : str
        What they are.
    places : mapping from str to str
        Of each name the module in this package and its attribute, as in "core.lcp:LCP".
    """
    _PLACES.setdefault(what, {}).update(places)


def offered(what: str) -> dict[str, str]:
    """Return the names and places of what is offered by the rooms that are here, in order."""
    return {name: place for name, place in _PLACES.get(what, {}).items() if _is_here(place)}


def ask(what: str, name: str) -> Any:
    """Return what is offered by that name.

    Raises
    ------
    InvalidOption
        Where the room that has it is not here.

    Examples
    --------
    >>> ask("conversion", "from_qp").__name__
    'lcp_from_qp'
    """
    found = ask_or_none(what, name)
    if found is None:
        raise InvalidOption(missing(what, name))
    return found


def missing(what: str, name: str) -> str:
    """Return which room that is not here has what is offered by that name, '' where no such is known."""
    place = _PLACES.get(what, {}).get(name)
    if place is None or _is_here(place):
        return ""
    return (
        f"the {what} {name!r} is offered by {place.partition(':')[0]}, which this installation of {PACKAGE} does not "
        f"have; install {PACKAGE} as a whole"
    )


def ask_or_none(what: str, name: str) -> Any:
    """Return what is offered by that name, None where the room that has it is not here."""
    place = _PLACES.get(what, {}).get(name)
    return at(place) if place is not None and _is_here(place) else None


def at(place: str) -> Any:
    """Return what stands at a place.

    Examples
    --------
    >>> at("core.settings:Status").__name__
    'Status'
    """
    module, name = _parts(place)
    return getattr(sys.modules.get(module) or import_module(module), name)


@cache
def _parts(place: str) -> tuple[str, str]:
    module, _, name = place.partition(":")
    return f"{PACKAGE}.{module}", name


@cache
def _is_here(place: str) -> bool:
    try:
        return find_spec(f"{PACKAGE}.{place.partition(':')[0]}") is not None
    except ModuleNotFoundError:  # not even the room is
        return False
