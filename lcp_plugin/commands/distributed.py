"""What `lcp-plugin solve --backend petsc` does its own way: rank 0 speaks for all, all ranks end alike."""

from __future__ import annotations

import io
import json
import os
import secrets
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import typer

from ..checks import FloatVector
from ..errors import InvalidOption, LCPError, UnreadableFile
from ..problem.lcp import LCP
from ..solving.result import Result
from .solving import OneProcess, Task, refuse_the_problem_itself
from .target import require_file, scene_text

LARGE_FOR_EACH_RANK = 100_000
FILES = ("z.npy", "w.npy", "status.json")
PIECE = 2**24  # values a write: a count of bytes beyond 2³¹ is more than some MPI libraries take
FEW_RANKS = 8
SPEAKER = "lcp-plugin"
T = TypeVar("T")


@contextmanager
def on_all_ranks() -> Iterator[None]:
    """Run a whole command: only rank 0 is heard, and whatever ends one rank ends all."""
    try:
        from mpi4py import MPI

        from ..peers.ranks.failures import ends_together
    except (ImportError, RuntimeError, LCPError):  # `solve` says what is missing
        yield
        return
    if MPI.COMM_WORLD.rank > 0:
        sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - until the process ends
    signal.signal(signal.SIGTERM, _say_terminated)
    with ends_together(speaker=SPEAKER):
        yield


class Ranks(OneProcess):
    """Every rank of the job, which all call in the same order."""

    on_ranks = True

    def __init__(self) -> None:
        from ..peers.ranks.collective import as_mpi, from_first

        self.comm = as_mpi(None)
        self.once = lambda attempt: from_first(self.comm, attempt)

    def ending_together(self) -> AbstractContextManager[None]:
        """Return a context in which the first failure ends all ranks."""
        from ..peers.ranks.failures import ends_together

        return ends_together(self.comm, speaker=SPEAKER)

    def check_outputs(self, target: str, plot: Path | None, out: Path | None) -> None:
        """Refuse a picture, and a folder that cannot be written."""
        if plot is not None:
            raise InvalidOption(
                "--plot is not offered with --backend petsc, as no rank holds the whole z; save with --out FOLDER and "
                "plot np.load('FOLDER/z.npy')"
            )
        _check_folder(target, out)

    def read(self, target: str, size: int | None, out: Path | None) -> Task:
        """Return the own part of what is to be solved, if the disk has room for the answer."""
        task = _read(self.comm, target, size)
        self.once(lambda: _check_room(task.problem.n, out))
        return task

    def beyond(self) -> tuple[dict[str, Any], list[str]]:
        """Return the number of ranks and their peaks of memory."""
        from ..peers.ranks.collective import gathered

        peaks = [int(peak) for peak in gathered(self.comm, peak_memory())[:, 0]]
        return {"ranks": self.comm.size, "peak_memory_bytes": peaks}, [f"{'peak memory':<18} {_in_words(peaks)}"]

    def save(self, result: Result, content: dict[str, Any], out: Path) -> list[Path]:
        """Write z, w and the status into a folder: under other names first, which rank 0 changes at the end."""
        token, is_new = self.once(lambda: _make_folder(out))
        temporary = {name: out / f".{token}-{name}" for name in FILES}
        try:
            for name, own in (("z.npy", result.z), ("w.npy", result.w)):
                _write_array(self.comm, temporary[name], own, result.certificate.problem)
            self.once(lambda: temporary["status.json"].write_text(json.dumps(content, indent=2), encoding="utf-8"))
            self.once(lambda: [temporary[name].replace(out / name) for name in FILES] and None)
        finally:
            if self.comm.rank == 0:
                for path in temporary.values():
                    path.unlink(missing_ok=True)
                if is_new and not any(out.iterdir()):
                    out.rmdir()
        return [out / name for name in FILES]


# --- what is solved -------------------------------------------------------------------------------------------


def _read(comm: Any, target: str, size: int | None) -> Task:
    from ..evidence import gallery
    from ..evidence.gallery import on_ranks as scenes
    from ..peers.ranks.collective import from_first

    text = scene_text(target, size)
    if text is None:
        if from_first(comm, lambda: _kind(target)) == "parts":
            return Task(LCP.load(target, comm))
        whole = LCP.load(target)
        _note_whole(comm, whole.n, "this file is read")
        return Task(LCP.from_problem(whole, comm))
    by_rows = scenes.by_rows(text)
    if by_rows is not None:
        name, parameters = by_rows
        problem = scenes.build(name, comm, parameters)
        label = ", ".join(f"{key}={value!r}" for key, value in parameters.items())
        return Task(
            problem, f"Scene({name}: {label})",
            references={"from the continuum": lambda z: scenes.continuum_error(problem, z, name, **parameters)},
        )
    scene = gallery.parse(text)
    if scene.steps > 1:
        raise InvalidOption(f"{scene.name} is a march in time, which --backend petsc does not offer; leave it out")
    _note_whole(comm, scene.n, f"{scene.name} is built")
    return Task.of_scene(LCP.from_problem(scene.problem, comm), scene)


def _kind(target: str) -> str:
    """Return "whole" for what `LCP.load` reads, "parts" for what each rank reads a part of."""
    require_file(target)
    path = Path(target)
    is_matrix_market = target.endswith("M.mtx") or (path / "M.mtx").exists() or Path(f"{target}M.mtx").exists()
    if path.suffix.lower() == ".npz" or is_matrix_market or not path.exists():
        return "whole"
    return "parts"


def _note_whole(comm: Any, n: int, what: str) -> None:
    if comm.size > 1 and n > LARGE_FOR_EACH_RANK:
        typer.echo(f"note: {what} whole on each of the {comm.size} ranks, then cut", err=True)


# --- what is told ---------------------------------------------------------------------------------------------


def _in_words(peaks: list[int]) -> str:
    megabytes = [round(peak / 1e6) for peak in peaks]
    each = ", ".join(map(str, megabytes))
    if len(peaks) > FEW_RANKS:
        each = f"{min(megabytes)} to {max(megabytes)}"
    return f"{each} MB a rank" if len(peaks) == 1 else f"{each} MB a rank, {sum(megabytes)} MB in all"


def peak_memory() -> int:
    """Return the most bytes this process has held at once; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _say_terminated(number: int, _: Any) -> None:
    """Say so on every rank that hears it: rank 0 may wait in a common call for one that has gone already."""
    stream = sys.__stderr__ or sys.stderr
    stream.write(f"{SPEAKER}: ended from outside (Ctrl-C in mpiexec, or the batch system); nothing was saved\n")
    stream.flush()
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


# --- what is saved --------------------------------------------------------------------------------------------


def _check_folder(target: str, out: Path | None) -> None:
    """Refuse before the run what could not be written after it."""
    if out is None:
        return
    if out.suffix in (".npz", ".npy"):
        raise InvalidOption(f"with --backend petsc, --out names a folder for {', '.join(FILES)}; got {out.name!r}")
    place = out if out.exists() else out.absolute().parent
    if not place.is_dir():
        fault = "it is a file" if out.exists() else f"the folder {out.parent} does not exist"
        raise UnreadableFile(f"cannot write {out}: {fault}")
    refuse_the_problem_itself(target, out)
    if not os.access(place, os.W_OK | os.X_OK):
        raise UnreadableFile(f"cannot write {out}: no permission to write into {place}; choose another place")
    for name in FILES:
        if (out / name).is_dir():
            raise UnreadableFile(f"cannot write {out / name}: it is a folder")


def _check_room(n: int, out: Path | None) -> None:
    if out is None:
        return
    free = shutil.disk_usage(out if out.exists() else out.absolute().parent).free
    if (needed := 16 * n) > free:
        raise UnreadableFile(f"cannot write {out}: z and w need {needed:.3g} bytes and {free:.3g} are free there")


def _make_folder(out: Path) -> tuple[str, bool]:
    is_new = not out.exists()
    out.mkdir(exist_ok=True)
    return secrets.token_hex(6), is_new


def _write_array(comm: Any, path: Path, own: FloatVector, problem: Any) -> None:
    """Write the parts of all ranks into one .npy file by MPI-IO."""
    from mpi4py import MPI

    from ..peers.ranks.collective import together

    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (problem.n,)})
    begin = len(header.getvalue()) + 8 * problem.first
    values = np.ascontiguousarray(own, dtype="<f8")

    def attempt(action: Callable[[], T]) -> T:
        def plainly() -> T:
            try:
                return action()
            except MPI.Exception as error:
                raise UnreadableFile(f"cannot write {path}: {error.Get_error_string()}") from error

        return together(comm, plainly)

    def write(file: Any) -> None:
        pieces = [(begin + 8 * k, values[k : k + PIECE].view(np.uint8)) for k in range(0, values.size, PIECE)]
        if comm.rank == 0:
            pieces.insert(0, (0, np.frombuffer(header.getvalue(), np.uint8)))
        for offset, piece in pieces:
            status = MPI.Status()
            file.Write_at(offset, piece, status)
            if status.Get_count(MPI.BYTE) != piece.size:
                raise UnreadableFile(f"cannot write {path}: only a part was written; is the disk full?")

    file = attempt(lambda: MPI.File.Open(comm, str(path), MPI.MODE_CREATE | MPI.MODE_EXCL | MPI.MODE_WRONLY))
    try:
        attempt(lambda: write(file))
    finally:
        file.Close()
