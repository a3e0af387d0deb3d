"""solve() on 1 to 4 ranks answers as on one process, and alike on every rank."""

from __future__ import annotations

import pytest
from checks import identities, require_passed

SCRIPT = "solving_on_ranks.py"


@pytest.mark.parametrize("identity", identities(SCRIPT))
def test_on_ranks(identity: str) -> None:
    """The check of that name passes on that number of ranks; its own first line says the claim."""
    require_passed(SCRIPT, identity)
