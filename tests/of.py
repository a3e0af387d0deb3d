"""Print the tests that run a file of the package, or a line: ``python tests/of.py lcp_plugin/api.py:150``.

The first call, and one with ``--measure``, runs the quick suite under coverage (the extra ``coverage``; minutes) and
stores which test runs which line in ``.coverage``. Compiled kernels have no lines: ask for the line that calls them.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections import defaultdict
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
STORE = ROOT / ".coverage"
COMMAND = [
    "-m",
    "pytest",
    "-q",
    "-n",
    "2",
    "--cov=lcp_plugin",
    "--cov-context=test",
    "--cov-report=",
]


@cache
def stored() -> Any:
    """Return the data of the last measured run; measure first if there is none."""
    if not STORE.exists():
        print(
            "no test was measured yet: the quick suite runs under coverage, some minutes",
            file=sys.stderr,
        )
        subprocess.run([sys.executable, *COMMAND], cwd=ROOT, stdout=subprocess.DEVNULL)
    from coverage import CoverageData

    data = CoverageData(str(STORE))
    data.read()
    return data


def tests_of(file):
    """Return the tests of each line of a file; a test is named as pytest names it."""
    lines = stored().contexts_by_lineno(str(file.resolve()))
    names = {
        line: {name.partition("|")[0] for name in contexts} for line, contexts in lines.items()
    }
    return {line: tests - {""} for line, tests in names.items()}


def main() -> None:
    """Print one test per line, or one test function per line for a whole file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("place", help="FILE or FILE:LINE")
    parser.add_argument("--measure", action="store_true", help="run the quick suite first")
    asked = parser.parse_args()
    if asked.measure:
        STORE.unlink(missing_ok=True)
    name, _, line = asked.place.partition(":")
    lines = tests_of(Path(name))
    if line:
        print(*sorted(lines.get(int(line), ())), sep="\n")
        return
    rows: dict[str, set[str]] = defaultdict(set)
    for test in set().union(*lines.values()):
        rows[test.partition("[")[0]].add(test)
    for function in sorted(rows):
        print(f"{function}  ({len(rows[function])})")


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # as of ``head``
        main()
