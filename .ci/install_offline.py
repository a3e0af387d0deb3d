"""Build the wheel and the source archive, and install each without a network into fresh environments.

python .ci/install_offline.py [--keep FOLDER] [PYTHON …]

Without arguments: python3.11, python3.12 and python3.13. Needs ``build`` and ``twine``, and a network for the wheels of
the dependencies, which are fetched first; nothing is installed but from that folder. FOLDER/dist then holds what may be
uploaded. Prints a line an installation, of three Pythons in 4 minutes; the exit code is 1 if one fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
PYTHONS = ("python3.11", "python3.12", "python3.13")
USE = """
import pathlib, lcp_plugin
from lcp_plugin import gallery, solve
assert "site-packages" in lcp_plugin.__file__ and pathlib.Path(lcp_plugin.__file__).with_name("py.typed").exists()
solve(gallery.obstacle_2d(size=20).problem).require_solved()
"""


def run(*command: str | Path, cwd: Path = ROOT, **environment: str) -> str:
    """Return what a command printed; one that fails ends this script with what it printed."""
    environment = {**os.environ, "PYTHONPATH": "", **environment}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout[-4000:]}{done.stderr[-4000:]}")
    return done.stdout.strip()


def try_out(python: str, archive: Path, wheels: Path) -> None:
    """Install an archive into an environment of its own, ask it for its version, and solve with it."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        run(python, "-m", "venv", here / "venv")
        scripts = here / "venv" / "bin"
        run(
            scripts / "python",
            "-m",
            "pip",
            "install",
            "-q",
            "--no-index",
            "--find-links",
            wheels,
            archive,
        )
        installed = time.perf_counter() - began
        compiled = {"NUMBA_CACHE_DIR": str(here / "compiled")}
        version = run(scripts / "lcp-plugin", "--version", cwd=here)
        run(scripts / "lcp-plugin", "solve", "obstacle_2d:size=20", cwd=here, **compiled)
        run(scripts / "python", "-c", USE, cwd=here, **compiled)
    print(
        f"{python}, {archive.name}: {version}, installed in {installed:.0f} s, "
        f"tried in {time.perf_counter() - began - installed:.0f} s",
        flush=True,
    )


def main(pythons: list[str], folder: Path) -> None:
    """Build, check the metadata and the README as an index renders it, fetch, install."""
    dist, wheels = folder / "dist", folder / "wheels"
    run(sys.executable, "-m", "build", "--outdir", dist)
    archives = sorted(dist.iterdir())
    run(sys.executable, "-m", "twine", "check", "--strict", *archives)
    for python in pythons:
        run(
            python,
            "-m",
            "pip",
            "download",
            "-q",
            "-d",
            wheels,
            next(dist.glob("*.whl")),
            "hatchling",
        )
    for own in wheels.glob("lcp_plugin-*"):  # the archive given is what is installed
        own.unlink()
    for python in pythons:
        for archive in archives:
            try_out(python, archive, wheels)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="where archives and wheels stay"
    )
    parser.add_argument("pythons", nargs="*", default=PYTHONS, metavar="PYTHON")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as passing:
        main(list(given.pythons), (given.keep or Path(passing)).resolve())
