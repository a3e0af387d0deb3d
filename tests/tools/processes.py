"""Processes of their own, and the command lcp-plugin in this process."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from typer.testing import CliRunner

from lcp_plugin.commands.cli import app


def printed_by(code: str) -> str:
    """Return the printed text of a new process, without blanks at its ends; an error fails the test."""
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


def lcp_plugin(*arguments: str) -> Any:
    """The command in this process; its result has exit_code, stdout and stderr."""
    result = CliRunner().invoke(app, list(arguments))
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(
        result.exception
    )
    assert "Traceback" not in result.stdout + result.stderr
    return result
