"""What a Python of its own prints: for claims about what is loaded, or what a new process does."""

from __future__ import annotations

import subprocess
import sys


def printed_by(code: str) -> str:
    """Return what the code prints, the ends stripped; a code that fails fails the test."""
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()
