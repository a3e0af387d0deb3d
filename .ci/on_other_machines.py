"""Run the tests as on processors that this machine is not: with other kernels of BLAS, numpy, numba and PIQP.

    python .ci/on_other_machines.py [--only NAME] … [--numeric | --part] [pytest's arguments]

Without arguments: the ordinary suite in each setting, with ``-n 2``. ``--numeric`` names the folders of tests that
compute, ``--part`` the tests that kernels have changed before; all other arguments go to pytest.
Prints a line per setting; the exit code is 1 if one fails.

The settings follow x86-64 processors. OpenBLAS, numpy and PIQP choose among compiled kernels when they are loaded, and
numba compiles for the processor that it finds. So sums have another order, and PIQP may take another step. On other
processors, ``emulated`` and ``two threads`` have less effect, and the settings of OpenBLAS have none.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from numpy._core import _multiarray_umath

ROOT = Path(__file__).parent.parent
NUMERIC = (
    "applications",
    "core",
    "engines",
    "methods",
    "problems",
    "proofs",
    "published",
    "systems",
)
PART = (
    "applications",
    "core/test_criterion.py",
    "methods/multigrid",
    "methods/small",
    "methods/test_interior_point.py",
    "problems/cones/test_cone_criterion.py",
    "problems/contact",
    "problems/programs/test_convex_programs.py",
    "problems/programs/test_stopping_test_of_programs.py",
)
PLAIN_PIQP = """import sys, types

chosen = types.ModuleType("piqp.instruction_set")
chosen.avx2 = chosen.avx512f = False
sys.modules["piqp.instruction_set"] = chosen
"""  # a sitecustomize.py: Python runs it first
Environment = dict[str, str]


def baseline_numpy() -> Environment:
    """Return the variables with which numpy uses no loops beyond its baseline."""
    present = _multiarray_umath.__cpu_features__
    names = [name for name in _multiarray_umath.__cpu_dispatch__ if present.get(name)]
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(names)} if names else {}


def settings(folder: Path) -> Iterator[tuple[str, Environment]]:
    """Yield the settings, each with its name and variables; files that they need are written to the folder."""
    folder.joinpath("sitecustomize.py").write_text(PLAIN_PIQP, encoding="utf-8")
    numba = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(folder / "compiled")}
    piqp = {
        "PYTHONPATH": os.pathsep.join(
            [str(folder), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
        )
    }
    for name in ("Haswell", "Sandybridge", "Prescott"):
        yield name, {"OPENBLAS_CORETYPE": name}
    yield "baseline", {"OPENBLAS_CORETYPE": "Nehalem", **baseline_numpy()}
    yield "generic", numba
    yield "plain PIQP", piqp
    everything = {"OPENBLAS_CORETYPE": "Prescott", **baseline_numpy(), **numba, **piqp}
    yield "emulated", everything
    yield "two threads", everything | {"OMP_NUM_THREADS": "2"}


def main() -> int:
    """Run the settings; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", action="append", metavar="NAME", help="this setting, more than once"
    )
    parser.add_argument("--numeric", action="store_true", help="the folders of tests that compute")
    parser.add_argument(
        "--part", action="store_true", help="tests that kernels have changed before"
    )
    given, rest = parser.parse_known_args()
    names = NUMERIC * given.numeric + PART * given.part
    folders = [str(ROOT / "tests" / name) for name in names]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        "2",
        "-p",
        "no:cacheprovider",
        *rest,
        *folders,
    ]
    is_green = True
    with tempfile.TemporaryDirectory() as passing:
        known = dict(settings(Path(passing)))
        if unknown := set(given.only or ()) - set(known):
            parser.error(f"unknown settings {sorted(unknown)}; choose from {', '.join(known)}")
        for name in given.only or known:
            began = time.perf_counter()
            done = subprocess.run(
                command,
                cwd=ROOT,
                env=os.environ | known[name],
                capture_output=True,
                text=True,
                check=False,
            )
            lines = done.stdout.strip().splitlines() or [done.stderr]
            print(f"{name}: {lines[-1]} ({time.perf_counter() - began:.0f} s)", flush=True)
            if done.returncode:
                is_green = False
                print(done.stdout[-8000:], done.stderr[-2000:], flush=True)
    return 0 if is_green else 1


if __name__ == "__main__":
    sys.exit(main())
