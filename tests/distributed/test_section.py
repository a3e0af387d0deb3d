"""The manual's section on several machines, and the page that it names, do what they say."""

from __future__ import annotations

import shlex
import textwrap
from pathlib import Path

from launch import run, run_code

import lcp_plugin.ranks

PAGE = (
    Path(__file__)
    .parents[2]
    .joinpath("examples", "manual", "many_machines.md")
    .read_text(encoding="utf-8")
)
SECTION = PAGE.split("## Several machines")[1].split("\n## ")[0]


def test_the_script_of_the_page_runs() -> None:
    """The script solves its problem on two ranks, with a rigorous bound, and rank 0 alone speaks."""
    assert 'help("lcp_plugin.ranks")' in SECTION
    blocks = (lcp_plugin.ranks.__doc__ or "").split("::\n\n")[1:]
    (code,) = (block for block in blocks if "from_rows" in block)
    lines = [
        line
        for line in code.split("\n\n**")[0].splitlines()
        if line == "" or line.startswith("    ")
    ]
    done = run_code(2, textwrap.dedent("\n".join(lines)))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("SOLVED") == 1
    assert "rigorous" in done.stdout


def test_the_command_of_the_section_runs(tmp_path: Path) -> None:
    """The command under mpiexec solves its scene and writes z, w and the status."""
    (line,) = (line for line in SECTION.splitlines() if line.startswith("mpiexec"))
    words = shlex.split(line)
    ranks, arguments = int(words[2]), words[4:]
    assert words[:4] == ["mpiexec", "-n", str(ranks), "lcp-plugin"]
    arguments[arguments.index("--out") + 1] = str(tmp_path / "answer")
    done = run(ranks, "-m", "lcp_plugin", *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("SOLVED") == 1
    assert sorted(path.name for path in (tmp_path / "answer").iterdir()) == [
        "status.json",
        "w.npy",
        "z.npy",
    ]
