"""Every code block of the README runs, and what it names is there."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from pathlib import Path

import pytest
from pages import masked
from tools.processes import lcp_plugin

ROOT = Path(__file__).parents[2]
README = ROOT.joinpath("README.md").read_text(encoding="utf-8")
MANUAL = ROOT / "examples" / "manual"


def blocks(language: str) -> list[str]:
    found: list[str] = re.findall(rf"^```{language}\n(.*?)^```", README, re.S | re.M)
    return found


def commands() -> list[str]:
    """Every call of lcp-plugin in a shell block; the installation before it is what .ci/run does."""
    lines = "\n".join(blocks("bash") + blocks("sh")).splitlines()
    return [
        part.strip()
        for line in lines
        for part in line.split("&&")
        if part.strip().startswith("lcp-plugin")
    ]


@pytest.mark.parametrize("k", range(len(blocks("python"))))
def test_python_blocks_run(k, capsys):
    """A Python block prints the text below it, apart from times and residuals, and says SOLVED."""
    namespace = {"__name__": "readme"}
    exec(compile(blocks("python")[k], f"README block {k}", "exec", dont_inherit=True), namespace)
    assert masked(capsys.readouterr().out) == masked(blocks("text")[k])
    assert "SOLVED" in blocks("text")[k]


@pytest.mark.quick(1)
@pytest.mark.parametrize("command", commands())
def test_commands_run(command, tmp_path, monkeypatch):
    """A command of the README does what it says and exits with 0."""
    monkeypatch.chdir(tmp_path)
    outcome = lcp_plugin(*shlex.split(command, comments=True)[1:])
    assert outcome.exit_code == 0, outcome.output
    if "--plot" in command:
        name = command.rsplit(maxsplit=1)[-1]
        start = {".png": b"\x89PNG", ".pdf": b"%PDF"}[Path(name).suffix]
        assert (tmp_path / name).read_bytes().startswith(start)


def test_first_two_shell_blocks_install_and_test():
    """The first shell block installs and solves with a picture, the second runs the quick tests and nothing else."""
    first, second = blocks("bash")[:2]
    assert "pip install" in first
    assert "--plot" in first
    assert [part.strip() for part in second.split("&&")][1:] == [
        "pip install '.[test]'",
        "python -m pytest -n 2",
    ]


def pages(text: str) -> list[str]:
    """The modules whose help a text names, as in help("lcp_plugin.modeling")."""
    return re.findall(r'help\("(lcp_plugin[\w.]*)"\)', text)


def page(module: str) -> str:
    """What help() shows first of a module; "" where there is none."""
    path = ROOT.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""


@pytest.mark.parametrize("module", pages(README))
def test_pages_are_there(module):
    """A page that the README names is one, and help(lcp_plugin) lists it."""
    assert len(page(module).splitlines()) > 10
    assert module in pages(page("lcp_plugin"))


@pytest.mark.parametrize("module", pages(page("lcp_plugin")))
def test_pages_open_without_extras(module):
    """Each page that help(lcp_plugin) lists opens, and is one."""
    assert len((importlib.import_module(module).__doc__ or "").splitlines()) > 10


def test_links_lead_to_files():
    """Each link of the README and of the manual's pages leads to a file, and to a title of it."""
    followed = 0
    for file in (ROOT / "README.md", ROOT / "examples" / "README.md", *MANUAL.glob("*.md")):
        for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", file.read_text(encoding="utf-8")):
            name, _, title = link.partition("#")
            target = file.parent / name if name else file
            assert target.is_file(), f"{file.name} → {link}"
            titles = (
                re.findall(r"^#+ (.+)$", target.read_text(encoding="utf-8"), re.M) if title else []
            )
            assert not title or title in {
                re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in titles
            }
            followed += 1
    assert followed > 20
