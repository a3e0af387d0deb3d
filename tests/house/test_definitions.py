"""Go-to-definition leads from every public name to the line that writes it."""

from __future__ import annotations

import pytest


@pytest.mark.full
def test_every_public_name_leads_to_where_it_is_written() -> None:
    """So do the classes of the algorithms, and from solve what auto may try next."""
    from definitions import missed, missed_from_auto

    assert missed() == []
    assert missed_from_auto() == []
