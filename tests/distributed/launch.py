"""Run python under mpiexec with a limit of seconds, and end every rank where it is exceeded."""

from __future__ import annotations

import functools
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
ROOT_MAY_RUN = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}


def missing() -> str:
    """What this machine lacks for several ranks; empty where it has everything."""
    modules = [name for name in ("mpi4py",) if find_spec(name) is None]
    return ", ".join([*modules, *([] if shutil.which("mpiexec") else ["mpiexec"])])


@functools.cache
def _launcher() -> tuple[str, ...]:
    mpiexec = shutil.which("mpiexec")
    if mpiexec is None:
        raise FileNotFoundError("mpiexec is not on the PATH")
    version = subprocess.run(
        [mpiexec, "--version"], capture_output=True, text=True, timeout=30, check=False
    ).stdout
    is_open_mpi = "Open MPI" in version or "OpenRTE" in version or "prte" in version
    return (mpiexec, *(["--oversubscribe"] if is_open_mpi else []))


def start(ranks: int, *arguments: str, python: str = sys.executable) -> subprocess.Popen[str]:
    """Start `python *arguments` on so many ranks and do not wait."""
    folders = (str(ROOT / folder) for folder in (".", "tests", "examples"))
    paths = [*folders, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, **ROOT_MAY_RUN, "PYTHONPATH": os.pathsep.join(paths)}
    for threads in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        environment.setdefault(threads, "1")
    return subprocess.Popen(
        [*_launcher(), "-n", str(ranks), python, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    )


def finish(job: subprocess.Popen[str], timeout: float) -> subprocess.CompletedProcess[str]:
    """Wait for the end; after the limit of seconds end all ranks and raise subprocess.TimeoutExpired."""
    try:
        out, err = job.communicate(timeout=timeout)
    except subprocess.TimeoutExpired as error:
        out, err = end(job)
        raise subprocess.TimeoutExpired(job.args, timeout, out, err) from error
    return subprocess.CompletedProcess(job.args, job.returncode, out, err)


def end(job: subprocess.Popen[str]) -> tuple[str, str]:
    """End mpiexec, which ends its ranks first; return what they had said."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if job.poll() is None:
            job.send_signal(number)
        try:
            return job.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            continue
    return "", ""


def run(ranks: int, *arguments: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Return the end of `python *arguments` on so many ranks."""
    return finish(start(ranks, *arguments), timeout)


def run_code(ranks: int, code: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Return the end of a piece of python on so many ranks."""
    return run(ranks, "-c", code, timeout=timeout)


def wait_for(job: subprocess.Popen[str], path: Path, seconds: float = 60.0) -> str:
    """Return the text of a file as soon as it has a whole line; end the job where it does not come."""
    until = time.monotonic() + seconds
    while time.monotonic() < until and job.poll() is None:
        if path.exists() and (text := path.read_text(encoding="utf-8")).endswith("\n"):
            return text
        time.sleep(0.02)
    raise TimeoutError(f"{path} did not appear; the job said {end(job)}")
