"""The command lcp-plugin, run in this process."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner

from lcp_plugin.commands.cli import app


def lcp_plugin(*arguments: str) -> Any:
    """The command in this process; its result has exit_code, stdout and stderr."""
    result = CliRunner().invoke(app, list(arguments))
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(
        result.exception
    )
    assert "Traceback" not in result.stdout + result.stderr
    return result
