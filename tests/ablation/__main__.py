"""Leave out one mechanism after the other and write the losses into ablation.md: ``python tests/ablation [NAME …]``.

Without a name, the mechanisms that the page does not have yet are measured.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before numpy is loaded
sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from ablation.measuring import measured, meetings, row_of, rows_of_page, write  # noqa: E402
from ablation.mechanisms import NAMES  # noqa: E402


def main() -> int:
    """Measure the named mechanisms; return the exit code."""
    parser = argparse.ArgumentParser("python tests/ablation")
    parser.add_argument("names", nargs="*", help="which mechanisms; default: those not measured")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the processor for each")
    given = parser.parse_args()
    if unknown := set(given.names) - {*NAMES}:
        parser.error(f"unknown mechanism {min(unknown)!r}; there are {', '.join(NAMES)}")
    names = given.names or [name for name in NAMES if name not in rows_of_page()]
    for name, met in meetings(names).items():
        row = row_of(name, measured(name, met, given.seconds))
        write({name: row})
        print(row, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
