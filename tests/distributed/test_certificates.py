"""Certificates and error bounds of parts on ranks are those of the whole problem."""

from __future__ import annotations

import pytest
from checks import identities, require_passed

SCRIPT = "certificates_on_ranks.py"


@pytest.mark.parametrize("identity", identities(SCRIPT))
def test_on_ranks(identity: str) -> None:
    """The check of that name passes on that number of ranks; its own first line says the claim."""
    require_passed(SCRIPT, identity)
