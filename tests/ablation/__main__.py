"""Leave out one mechanism after the other, and write what that loses: ``python tests/ablation [NAME …] [--pairs]``.

A process each; what ``ablation.csv`` has already is not measured again, but where it is named.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before numpy is loaded
sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from ablation.mechanisms import HEAVIEST, NAMES  # noqa: E402
from ablation.table import columns, lost, read, write, write_page  # noqa: E402

PATIENCE = 5.0  # times its limit, in wall-clock time: after that a process is ended


def main() -> int:
    """Measure what is asked for; return the exit code."""
    parser = argparse.ArgumentParser(
        "python tests/ablation", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "names", nargs="*", help="which mechanisms; those not measured yet without a name"
    )
    parser.add_argument(
        "--pairs", action="store_true", help="two of the dozen heaviest at once instead"
    )
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of the processor for one, about"
    )
    parser.add_argument(
        "--met", metavar="FILE", help=argparse.SUPPRESS
    )  # of a process of its own: what meets what
    given = parser.parse_args()
    known = {*NAMES, *(" + ".join(pair) for pair in combinations(HEAVIEST, 2))}
    if unknown := set(given.names) - known:
        parser.error(f"unknown mechanism {min(unknown)!r}; there are {', '.join(NAMES)}")
    if given.met:
        return _alone(given.names, Path(given.met), given.seconds)
    every = [" + ".join(pair) for pair in combinations(HEAVIEST, 2)] if given.pairs else [*NAMES]
    rows = read()
    if wanted := given.names or [
        name for name in every if name not in {row["mechanism"] for row in rows}
    ]:
        with TemporaryDirectory() as folder:
            file = Path(folder) / "met.json"
            subprocess.run([*_command(wanted), "--met", str(file)], check=True)
            for name in wanted:
                rows = [row for row in rows if row["mechanism"] != name] + _measured(
                    name, file, given.seconds
                )
                write(rows)
    write_page(rows)
    return 0


def _command(names: list[str]) -> list[str]:
    return [sys.executable, str(Path(__file__).parent), *names]


def _measured(name: str, file: Path, seconds: float) -> list[dict[str, str]]:
    """Return the rows that a process of its own prints; those before it was ended, where it did not end."""
    try:
        text = subprocess.run(
            [*_command([name]), "--met", str(file), "--seconds", str(seconds)],
            stdout=subprocess.PIPE,
            text=True,
            timeout=PATIENCE * seconds,
            check=False,
        ).stdout
    except subprocess.TimeoutExpired as error:
        text = (error.stdout or b"").decode()
        print(f"{name}: ended after {PATIENCE * seconds:.0f} s", file=sys.stderr)
    rows = [
        dict(zip(columns(), cells, strict=True))
        for cells in csv.reader(text.splitlines())
        if len(cells) == len(columns()) and cells[0] == name
    ]
    loss = "; ".join(lost(rows)) or "nothing" if rows else "what nobody has measured"
    print(name, "loses", loss, file=sys.stderr, flush=True)
    return rows


def _alone(names: list[str], file: Path, seconds: float) -> int:
    """Write what meets what, or print the rows of one for which that is written."""
    from ablation.measuring import measured, meetings

    if not file.exists():
        file.write_text(
            json.dumps(
                meetings([*dict.fromkeys(part for name in names for part in name.split(" + "))])
            )
        )
        return 0
    met = json.loads(file.read_text())
    writer = csv.writer(sys.stdout, lineterminator="\n")
    for tally in measured(
        names[0], [one for part in names[0].split(" + ") for one in met[part]], seconds
    ):
        writer.writerow(tally.cells())
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
