"""Models in .nl files by chance, answered by lcp-plugin-ampl in this process, each answer held against the model.

Run as ``python tests/campaigns/nl_models.py --cases 5000 --seed 0``; ``--processes 200`` calls the executable itself in
that many. Looked at is of each model that there is no traceback, a .sol and a code of AMPL's table, that read_nl says
the same, that what is called solved meets bounds, rows and complementarities evaluated by Python's own functions, and,
of linear models, whether HiGHS finds a better point in one of the pieces, or one where infeasible is said.

Exit code 1 where anything is wrong; ``--show`` prints it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from random_nl_models import drawn_words, judged, random_model
from sol_files import read_sol

from lcp_plugin.interfaces.nl import write_nl


def by_process(stub: Path, words: list[str]) -> str:
    """Return the code by which the executable, in a process of its own, answers the file, or what is wrong."""
    answer = stub.with_suffix(".sol")
    answer.unlink(missing_ok=True)
    code = "from lcp_plugin.commands.ampl import run; run()"
    call = [sys.executable, "-c", code, str(stub), "-AMPL", "max_seconds=5", *words]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    if done.returncode or "Traceback" in done.stderr or not answer.exists():
        return f"PROCESS ENDED WITH {done.returncode}: {done.stderr[-500:]}"
    return f"{read_sol(answer).code} by a process"


def main() -> int:
    """Run the campaign and print what was found."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=0)
    parser.add_argument("--show", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("error")
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        stub = Path(folder) / "m"
        for case in range(options.cases):
            rng = np.random.default_rng([options.seed, case])
            content, words = random_model(rng), drawn_words(rng)
            said = judged(content, words, stub)
            if said[:2].isupper() and options.show:
                print(f"case {case} {words}: {said}", flush=True)
            found[said if not said[:2].isupper() else " ".join(said.split()[:3])] += 1
        for case in range(options.processes):
            rng = np.random.default_rng([options.seed, case])
            write_nl(random_model(rng), stub.with_suffix(".nl"))
            found[
                by_process(stub, [word for word in drawn_words(rng) if "max_seconds" not in word])
            ] += 1
    for said, count in found.most_common():
        print(f"{count:>8} {said}")
    return int(any(said[:2].isupper() for said in found))


if __name__ == "__main__":
    sys.exit(main())
