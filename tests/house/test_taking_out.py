"""Any room can be taken out, and the rest works: README's picture says what goes with it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from picture import ARROWS, ROOT


@pytest.mark.full
@pytest.mark.parametrize("room", ["everything", *(room for room in ARROWS if room != "core")])
def test_the_rest_works_without_a_room(room: str) -> None:
    """Without a room and those above it all files can be imported, and the core solves, judges and explains.

    ``python tests/take_out.py ROOM`` runs all tests of the core, which takes two minutes a room.
    """
    command = [sys.executable, str(ROOT / "tests" / "take_out.py"), room, "--only", "tests/core/test_core_alone.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
