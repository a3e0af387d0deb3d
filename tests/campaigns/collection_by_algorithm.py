"""The collection, one algorithm at a time: ``python tests/campaigns/collection_by_algorithm.py --algorithm lemke``.

Prints for each module of the collection how many of its entries are answered rightly, then those that are not; exit
code 1 on a false claim. Falling short is no violation here: no single algorithm is meant for all of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from collection import MODULES
from collection.judgement import false_claim, shortfall

from lcp_plugin import solve
from lcp_plugin.core.errors import LCPError


def main(algorithm: str, tolerance: float, seconds: float, quiet: bool) -> int:
    counts: Counter[tuple[str, str]] = Counter()
    remarks, failed = [], 0
    for module in MODULES:
        name = module.__name__.rpartition(".")[2]
        for entry in module.entries():
            began = time.perf_counter()
            verdict, remark = "right", ""
            try:
                result = solve(entry.problem, algorithm, tolerance=tolerance, max_seconds=seconds)
            except LCPError as error:
                verdict, remark = "refused", str(error)[:80]
            else:
                remark = false_claim(entry.problem, entry.truth, result, tolerance)
                if remark:
                    verdict, failed = "false", failed + 1
                elif remark := shortfall(entry.problem, entry.truth, result):
                    verdict = "short"
            spent = time.perf_counter() - began
            counts[name, verdict] += 1
            if remark or spent > 1.0:
                remarks.append(f"{name}.{entry.name} (n = {entry.problem.n}, {spent:.2f} s): {remark}")
    columns = ("right", "short", "refused", "false")
    print(f"{algorithm:<14}" + "".join(f"{column:>9}" for column in columns))
    for module in MODULES:
        name = module.__name__.rpartition(".")[2]
        print(f"{name:<14}" + "".join(f"{counts[name, column]:>9}" for column in columns))
    print(f"{'all':<14}" + "".join(f"{sum(n for (_, c), n in counts.items() if c == v):>9}" for v in columns))
    if not quiet:
        print("\n".join(remarks))
    return int(failed > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--algorithm", default="auto")
    parser.add_argument("--tolerance", type=float, default=1e-9)
    parser.add_argument("--seconds", type=float, default=10.0, help="limit of one run")
    parser.add_argument("--quiet", action="store_true", help="the table only")
    arguments = parser.parse_args()
    sys.exit(main(arguments.algorithm, arguments.tolerance, arguments.seconds, arguments.quiet))
