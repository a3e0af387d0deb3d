"""Uncoupled components of a problem are the same, and judged alike, on any number of ranks."""

from __future__ import annotations

import pytest
from checks import identities, require_passed

SCRIPT = "components_on_ranks.py"


@pytest.mark.parametrize("identity", identities(SCRIPT))
def test_on_ranks(identity: str) -> None:
    """The check of that name passes on that number of ranks; its own first line says the claim."""
    require_passed(SCRIPT, identity)
