"""Ratchet of the prose: no file gets more findings of `plain_english`, and a new file has few."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from plain_english import BASELINE, MAX_PER_1000_WORDS, ROOT, check_file, list_files


@pytest.mark.parametrize(
    "folder", ["lcp_plugin", "examples", pytest.param("tests", marks=pytest.mark.full)]
)
def test_no_file_has_more_findings_than_its_baseline(folder: str) -> None:
    """The findings per file are at most the baseline; a file without a baseline has at most 8 per 1000 words."""
    baseline: dict[str, int] = json.loads(BASELINE.read_text(encoding="utf-8"))
    worse = []
    for file in list_files(folder):
        name = file.relative_to(ROOT).as_posix()
        found, words = check_file(file)
        limit = baseline.get(name, int(MAX_PER_1000_WORDS * words / 1000))
        if len(found) > limit:
            worse.append(f"{name}: {len(found)} findings, at most {limit}")
    assert not worse, "list them with python tests/house/plain_english.py FILE: " + "; ".join(worse)


def test_linter_reads_prose_and_skips_code(tmp_path: Path) -> None:
    """The linter finds a phrase in docstrings, messages and comments, but not in code, doctests or exempt lines."""
    file = tmp_path / "module.py"
    phrase = "be" + "side"
    docstring = f'"""Rows\n\n{phrase} it and `{phrase}`.\n\n>>> f()\n{phrase}\n"""'
    lines = (
        docstring,
        f'm = "no {phrase} in a key"  # {phrase}',
        f"# {phrase} plain: ok",
        f"{phrase} = 1",
    )
    file.write_text("\n".join(lines), encoding="utf-8")
    assert [found.partition(":")[0] for found in check_file(file)[0]] == ["3", "8", "8"]
