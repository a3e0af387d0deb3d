"""The claims of `claims.py` hold on one and on two ranks; the page's script runs."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path

import pytest
from launch import run, run_code

SCRIPT = Path(__file__).with_name("claims.py")
CLAIMS = re.findall(r"^@claim\ndef (\w+)", SCRIPT.read_text(encoding="utf-8"), re.MULTILINE)
PAGE = Path(__file__).parents[2].joinpath("examples", "manual", "many_machines.md")


@functools.cache
def stories(ranks: int) -> dict[str, str]:
    """Return the traceback of each claim, empty if it holds, after one run of all."""
    done = run(ranks, str(SCRIPT), timeout=500.0)
    found = dict(json.loads(line) for line in done.stdout.splitlines() if line.startswith("["))
    return {name: found.get(name, done.stderr or "did not run") for name in CLAIMS}


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("name", CLAIMS)
def test_claim_holds_on_ranks(name, ranks):
    """Each claim holds on every number of ranks."""
    assert not stories(ranks)[name], stories(ranks)[name]


def test_the_script_of_the_page_runs():
    """The script solves its problem on two ranks, with a bound, and rank 0 alone prints."""
    page = PAGE.read_text(encoding="utf-8").split("## Several machines")[1]
    done = run_code(2, page.split("```python\n")[1].split("```")[0])
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("SOLVED") == 1
