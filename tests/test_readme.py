"""Every code block of the README runs."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from lcp_plugin.algorithms import ENTRY_POINT_GROUP
from lcp_plugin.commands.cli import app

README = Path(__file__).parent.parent.joinpath("README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    found: list[str] = re.findall(rf"^```{language}\n(.*?)^```", README, re.S | re.M)
    return found


def commands() -> list[str]:
    """Every call of lcp-plugin in a shell block; the installation before it is what .ci/run does."""
    lines = "\n".join(blocks("bash") + blocks("sh")).splitlines()
    return [part.strip() for line in lines for part in line.split("&&") if part.strip().startswith("lcp-plugin")]


@pytest.mark.parametrize("k", range(len(blocks("python"))))
def test_python_blocks_run(k: int, capsys: pytest.CaptureFixture[str]) -> None:
    """A Python block runs as it stands and says SOLVED, from a status."""
    namespace: dict[str, object] = {"__name__": "readme"}
    exec(compile(blocks("python")[k], f"README block {k}", "exec", dont_inherit=True), namespace)
    assert "SOLVED" in capsys.readouterr().out


@pytest.mark.parametrize("command", commands())
def test_commands_run(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command of the README does what it says and exits with 0."""
    monkeypatch.chdir(tmp_path)
    outcome = CliRunner().invoke(app, shlex.split(command)[1:])
    assert outcome.exit_code == 0, outcome.output
    if "--plot" in command:
        assert (tmp_path / "obstacle.png").read_bytes().startswith(b"\x89PNG")


def test_first_two_shell_blocks_install_and_test() -> None:
    """The first shell block installs and solves with a picture, the second runs the tests."""
    first, second = blocks("bash")[:2]
    assert "pip install" in first
    assert "--plot" in first
    assert "pip install" in second
    assert "pytest" in second


@pytest.mark.parametrize("block", blocks("toml"))
def test_toml_blocks_can_be_read(block: str) -> None:
    """A TOML block is what the text around it says: the entry point of an algorithm."""
    groups = tomllib.loads(block)["project"]["entry-points"]
    assert list(groups) == [ENTRY_POINT_GROUP]


def test_every_kind_of_block_is_known() -> None:
    """No block has a language that none of these tests runs."""
    assert set(re.findall(r"^```(\w+)$", README, re.M)) <= {"bash", "sh", "python", "text", "toml"}
