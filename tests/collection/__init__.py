"""A collection of linear complementarity problems whose answers are known: one family of sources a module.

``all_entries()`` gives them all; what each claims of itself is verified by ``tests/evidence/test_collection.py``.
"""

from __future__ import annotations

from functools import cache

from . import (
    circuits,
    contact,
    economics,
    families,
    games,
    matrices,
    programs,
    textbook,
    unsolvable,
)
from .entry import Entry

MODULES = (textbook, families, games, economics, circuits, contact, programs, matrices, unsolvable)


@cache
def all_entries() -> tuple[Entry, ...]:
    """Return every entry, in the order of the modules."""
    return tuple(entry for module in MODULES for entry in module.entries())
