"""A collection of linear complementarity problems whose answers are known: one family of sources a module.

``all_entries()`` gives them all; what each claims of itself is verified by ``tests/evidence/test_collection.py``.
"""

from __future__ import annotations

from functools import cache

from . import games, matrices, programs, textbook, unsolvable
from .entry import Entry

MODULES = (textbook, games, programs, matrices, unsolvable)


@cache
def all_entries() -> tuple[Entry, ...]:
    """Return every entry, in the order of the modules."""
    return tuple(entry for module in MODULES for entry in module.entries())
