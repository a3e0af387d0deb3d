"""Make an environment for each cvxpy version and run the modelling tests in it.

python tests/run_on_cvxpy_versions.py [VERSION …]

Without arguments: the newest of 1.8 and 1.9. Prints a line a version; the exit code is 1 if one fails.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import venv
from pathlib import Path

VERSIONS = ("1.8.*", "1.9.*")
FLOORS = {"1.8.0": ("numpy==2.0.0", "scipy==1.15.0", "numba==0.60.0")}
NAMES = (
    *(
        "extraction",
        "modeling",
        "modeling_derivatives",
        "qp_solver",
        "cvxpy_programs",
        "conversions",
    ),
    *(
        "cross_validation",
        "certify",
        "modeling_nonlinear",
        "best_equilibrium",
        "best_equilibrium_meaning",
    ),
)
TESTS = [f"test_{name}.py" for name in NAMES]
SHOW = "import cvxpy, scipy, numpy; print(cvxpy.__version__, scipy.__version__, numpy.__version__)"
ROOT = Path(__file__).parent.parent


def run_on(version: str) -> bool:
    """Return whether the modelling tests pass with this version, in an environment of its own."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(Path(folder, "bin", "python"))
        wanted = [
            f"cvxpy=={version}",
            *FLOORS.get(version, ()),
            "pytest",
            "pytest-xdist",
            "hypothesis",
            "mpmath",
            "pyscipopt",
            str(ROOT),
        ]
        subprocess.run([python, "-m", "pip", "install", "-q", *wanted], check=True)
        tests = [str(next((ROOT / "tests").rglob(name))) for name in TESTS]
        # Outside the source tree, so that the installed package is tested; its own deprecations are not our errors.
        command = [
            python,
            "-m",
            "pytest",
            "-q",
            "--full",
            "-n",
            "2",
            "-p",
            "no:cacheprovider",
            "-W",
            "default",
            *tests,
        ]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        found = subprocess.run([python, "-c", SHOW], capture_output=True, text=True, check=True)
    print(
        f"cvxpy, scipy, numpy {found.stdout.strip()}: {done.stdout.strip().splitlines()[-1]}",
        flush=True,
    )
    if done.returncode:
        print(done.stdout[-4000:])
    return done.returncode == 0


if __name__ == "__main__":
    outcomes = [run_on(version) for version in sys.argv[1:] or VERSIONS]
    sys.exit(0 if all(outcomes) else 1)
