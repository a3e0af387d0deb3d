"""Run the tests of the installed cvxpy and scipy with this package in the place of their solvers; nothing is fetched.

``python tests/peers`` runs all, ``python tests/peers NAME`` those whose names contain NAME. Printed is what fails and
why; the exit code is 1 where anything does.
"""

import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parents[1])
sys.path.insert(1, str(Path(__file__).parents[2]))

from peers.running import run  # noqa: E402

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        "python tests/peers", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("name", nargs="?", default="", help="a part of the names of tests")
    sys.exit(run(parser.parse_args().name))
