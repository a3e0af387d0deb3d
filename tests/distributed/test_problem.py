"""A problem spread over ranks: wrong parts are refused on all ranks, and files lead back to the same problem."""

from __future__ import annotations

import pytest
from checks import identities, require_passed

SCRIPT = "problem_on_ranks.py"


@pytest.mark.parametrize("identity", identities(SCRIPT))
def test_on_ranks(identity: str) -> None:
    """The check of that name passes on that number of ranks; its own first line says the claim."""
    require_passed(SCRIPT, identity)
