"""Make an environment for each set of versions and run the tests of the host's interfaces in it.

    python .ci/run_on_cvxpy_versions.py [--python PYTHON] [--if-possible] [--suite] [VERSION …] [-- pytest's options]

A VERSION is ``oldest`` (``oldest_versions.txt``), ``newest`` (from the package index), or a version of cvxpy. Without
arguments: oldest, the newest of cvxpy 1.8 and 1.9, newest. PYTHON is an executable, a version like 3.13, or ``newest``:
the newest Python, or the newest of that version, that is found on PATH or in pyenv's folder. ``--suite`` runs the whole
ordinary suite. Prints a line per version; the exit code is 1 if one fails. With ``--if-possible``, a Python that is not
found and a package index that is not reached are skipped with a line.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

VERSIONS = ("oldest", "1.8.*", "1.9.*", "newest")
FOLDERS = ("modeling", "interfaces", "commands")
FILES = (
    "test_conversions",
    "test_cross_validation",
    "test_certify",
    "test_best_equilibrium",
    "test_best_equilibrium_meaning",
)
SUITE = ("report", "manual", "qpsolvers", "pyomo", "global", "fclib")
SUITE_PACKAGES = ("quantecon", "scikit-fem", "hatchling")
SHOW = """import cvxpy, numba, numpy, platform, scipy
print(platform.python_version(), *(module.__version__ for module in (numpy, scipy, numba, cvxpy)))"""
ROOT = Path(__file__).parent.parent
OLDEST = Path(__file__).with_name("oldest_versions.txt")


def newest_python(wanted: str = "3") -> str | None:
    """Return the newest Python of this version that starts, of PATH and of pyenv's folder; None if there is none."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    found = {sys.executable, *(str(file) for file in pyenv.glob("3.*/bin/python3"))}
    found |= {path for minor in range(11, 30) if (path := shutil.which(f"python3.{minor}"))}
    versions = {}
    for python in found:
        told = subprocess.run([python, "--version"], capture_output=True, text=True, check=False)
        number = told.stdout.strip().removeprefix("Python ")
        if re.fullmatch(r"3\.\d+\.\d+", number) and f"{number}.".startswith(f"{wanted}."):
            versions[tuple(map(int, number.split(".")))] = python
    return versions[max(versions)] if versions else None


def run_on(version: str, python: str, *, suite: bool, may_skip: bool, options: list[str]) -> bool:
    """Return whether the tests pass with these versions, in an environment of its own."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([python, "-m", "venv", folder], check=True)
        own = str(Path(folder, "bin", "python"))
        chosen = {"oldest": ["-c", str(OLDEST)], "newest": []}.get(version, [f"cvxpy=={version}"])
        extras = ",".join(SUITE if suite else ("qpsolvers", "pyomo", "global", "fclib", "report"))
        test = ["pytest", "pytest-xdist", "hypothesis", "mpmath", "click>=8.2"]
        wanted = [f"{ROOT}[{extras}]", *test, *(SUITE_PACKAGES if suite else ())]
        install = [own, "-m", "pip", "install", "-q", *chosen, *wanted]
        installed = subprocess.run(install, stderr=subprocess.PIPE, text=True, check=False)
        if installed.returncode:
            print(f"{version}: pip failed: {installed.stderr[-2000:]}", flush=True)
            is_unreached = "from versions: none" in installed.stderr
            if is_unreached and may_skip:
                print(f"{version}: skipped, because the package index is not reached", flush=True)
            return is_unreached and may_skip
        names = [str(next((ROOT / "tests").rglob(f"{name}.py"))) for name in FILES]
        tests = (
            [str(ROOT / "tests")]
            if suite
            else [*(str(ROOT / "tests" / name) for name in FOLDERS), *names]
        )
        # Outside of the source tree, so that the installed package is tested; old versions may warn of newer Pythons.
        command = [
            own,
            "-m",
            "pytest",
            "-q",
            "-n",
            "2",
            "-p",
            "no:cacheprovider",
            "-W",
            "default",
            *options,
            *tests,
        ]
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        environment["NUMBA_CACHE_DIR"] = str(Path(folder, "compiled"))
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        found = subprocess.run([own, "-c", SHOW], capture_output=True, text=True, check=True)
    last = (done.stdout.strip().splitlines() or [done.stderr])[-1]
    print(
        f"{version}: Python, numpy, scipy, numba, cvxpy {found.stdout.strip()}: {last}", flush=True
    )
    if done.returncode:
        print(done.stdout[-8000:], flush=True)
    return done.returncode == 0


def main() -> int:
    """Run the tests with each set of versions; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", default=sys.executable, help="an executable, 3.13, or newest")
    parser.add_argument("--if-possible", action="store_true", help="skip without Python or index")
    parser.add_argument("--suite", action="store_true", help="the whole ordinary suite")
    parser.add_argument("versions", nargs="*", default=VERSIONS, metavar="VERSION")
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    given, options = parser.parse_args(words[:cut]), words[cut + 1 :]
    python = given.python
    if python == "newest" or re.fullmatch(r"3\.\d+", python):
        python = newest_python("3" if python == "newest" else python)
    if python is None:
        print(f"{' '.join(given.versions)}: skipped, because Python {given.python} is not found")
        return 0 if given.if_possible else 1
    outcomes = [
        run_on(version, python, suite=given.suite, may_skip=given.if_possible, options=options)
        for version in given.versions
    ]
    return 0 if all(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
