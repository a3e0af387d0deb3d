"""Measure applications and rewrite their table: ``python tests/applications [NAMES] [--full] [--against COMMIT]``."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before numpy is loaded
sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from applications import entries  # noqa: E402
from applications.table import all_runs, cases, differences, path_of, read, worse_of, written  # noqa: E402


def main() -> int:
    """Print what changed; return the exit code: 2 for bad input."""
    parser = argparse.ArgumentParser(
        "python tests/applications", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("names", nargs="*", help="which applications; all without a name")
    parser.add_argument(
        "--full", action="store_true", help="the large sizes, in a table of their own"
    )
    parser.add_argument(
        "--against", metavar="COMMIT", help="compare the table with a commit's; nothing is measured"
    )
    parser.add_argument("--dry-run", action="store_true", help="leave the table as it is")
    parser.add_argument(
        "--keep-worse",
        action="store_true",
        help="a row is the worse one of this processor and of the table",
    )
    given = parser.parse_args()
    if unknown := set(given.names) - set(entries()):
        parser.error(f"unknown application {min(unknown)!r}; there are {', '.join(entries())}")
    file = path_of(full=given.full)
    old = read(file.read_text(encoding="utf-8")) if file.exists() else {}
    if given.against:
        shown = subprocess.run(
            ["git", "show", f"{given.against}:./{file.name}"],
            cwd=file.parent,
            capture_output=True,
            text=True,
        )
        if shown.returncode:
            parser.error(f"no table in {given.against}: {shown.stderr.strip()}")
        old, new = read(shown.stdout), old
    else:
        new = {}
        for case in cases(full=given.full, names=given.names):
            begin = time.perf_counter()
            new.update(case.measure(all_runs(full=given.full)))
            print(
                f"{case.name} (n = {case.n}): {time.perf_counter() - begin:.1f} s",
                file=sys.stderr,
                flush=True,
            )
        if given.keep_worse:
            new = worse_of({key: old[key] for key in old if key in new}, new)
        if given.names:  # the others stay as they are, in their places
            kept = {
                key: row
                for key, row in old.items()
                if key.problem.partition(" ")[0] not in given.names
            }
            both, order = {**kept, **new}, list(entries())
            new = dict(
                sorted(both.items(), key=lambda row: order.index(row[0].problem.partition(" ")[0]))
            )
        if not given.dry_run:
            file.write_text(written(new), encoding="utf-8")
    print("\n".join(differences(old, new)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
