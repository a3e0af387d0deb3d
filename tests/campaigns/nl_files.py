"""Contents of .nl files by chance, written and read in all three forms, and files with damage done to them.

Run as ``python tests/campaigns/nl_files.py --cases 2000 --seed 0``. Exit code 1 where what is read is not bit for bit
what was written, where a damaged file is neither read nor refused with its line or byte, or where reading it takes more
memory than ten times the file beside what an empty one needs.

Of 18000 files (seeds 13 and 14, 3000 contents each in three forms) all were read bit for bit. Of the same files damaged
14627 were refused with their place and 3373 still valid, none otherwise. Before, seed 13 found a signalling NaN that
numpy warned of, and seed 7 bounds -0 and 0 that were written as an equation.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import traceback
import tracemalloc
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from binary_nl import write_form
from random_nl import difference, mutilated, random_content

from lcp_plugin.core.errors import UnreadableFile
from lcp_plugin.interfaces.nl import read_content

FORMS: tuple[dict[str, Any], ...] = ({}, {"binary": True}, {"binary": True, "big_endian": True})
PLACE = re.compile(r"(line \d+ \(.*\)|byte \d+): ", re.S)
EMPTY = 300_000  # bytes


def check(rng: Any, path: Path) -> list[str]:
    """Return what became of a content and of its damaged file in each form."""
    content, outcomes = random_content(rng, int(rng.choice([3, 6, 30, 100]))), []
    for form in FORMS:
        write_form(content, path, **form)
        outcomes.append("DIFFERENT" if difference(content, read_content(path)) else "same")
        path.write_bytes(mutilated(path.read_bytes(), rng))
        outcomes.append(outcome(path))
    return outcomes


def outcome(path: Path) -> str:
    """Return how reading a damaged file ends."""
    tracemalloc.start()
    try:
        read_content(path)
        said = "read"
    except UnreadableFile as error:
        said = "refused" if PLACE.search(str(error)) else f"NO PLACE: {error}"
    except Exception:
        said = f"CRASH: {traceback.format_exc(limit=-1)}"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return (
        said
        if peak <= 10 * path.stat().st_size + EMPTY
        else f"MEMORY: {peak} of {path.stat().st_size}"
    )


def main() -> int:
    """Run the campaign and print what was found."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("error")
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for case in range(options.cases):
            found.update(check(np.random.default_rng([options.seed, case]), Path(folder) / "m.nl"))
    for said, count in found.most_common():
        print(f"{count:>8} {said}")
    return int(not found.keys() <= {"same", "read", "refused"})


if __name__ == "__main__":
    sys.exit(main())
