"""The README's section on several machines does what it says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from launch import run, run_code

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
SECTION = README.split("## Several machines")[1].split("\n## ")[0]


def test_the_script_of_the_section_runs() -> None:
    """The script solves its problem on two ranks, with a rigorous bound, and rank 0 alone speaks."""
    code, = (block for block in re.findall(r"```text\n(.*?)```", SECTION, re.S) if "from_rows" in block)
    done = run_code(2, code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("SOLVED") == 1
    assert "rigorous" in done.stdout


def test_the_command_of_the_section_runs(tmp_path: Path) -> None:
    """The command under mpiexec solves its scene and writes z, w and the status."""
    line, = (line for line in SECTION.splitlines() if line.startswith("mpiexec"))
    words = shlex.split(line)
    ranks, arguments = int(words[2]), words[4:]
    assert words[:4] == ["mpiexec", "-n", str(ranks), "lcp-plugin"]
    arguments[arguments.index("--out") + 1] = str(tmp_path / "answer")
    done = run(ranks, "-m", "lcp_plugin", *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("SOLVED") == 1
    assert sorted(path.name for path in (tmp_path / "answer").iterdir()) == ["status.json", "w.npy", "z.npy"]
