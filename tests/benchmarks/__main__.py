"""Run a benchmark: ``python tests/benchmarks NAME [--quick]``; without a name they are listed.

Libraries compute on one thread each unless the environment says otherwise. What some compare with is installed by
``pip install -r tests/benchmarks/requirements.txt``.
"""

from __future__ import annotations

import argparse
import inspect
import os
import sys
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before numpy is loaded
sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from benchmarks import BENCHMARKS, load  # noqa: E402


def main() -> int:
    """Print the lines of a benchmark as they come; return the exit code: 2 for bad input."""
    parser = argparse.ArgumentParser(
        "python tests/benchmarks", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "name",
        nargs="?",
        choices=BENCHMARKS,
        help="which benchmark; without a name they are listed",
    )
    parser.add_argument("files", nargs="*", help="for public: the JSON file that is written")
    parser.add_argument(
        "--quick", action="store_true", help="small sizes: to see that it runs, not for figures"
    )
    given = parser.parse_args()
    if given.name is None:
        print("\n".join(f"{name:<16} {purpose}" for name, purpose in BENCHMARKS.items()))
        return 0
    run = load(given.name)
    options = {"files": given.files} if given.files else {}
    if options and "files" not in inspect.signature(run).parameters:
        parser.error(f"{given.name} takes no files; leave out {given.files[0]}")
    for line in run(quick=given.quick, **options):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
