"""What `lcp-plugin solve --backend petsc` does: rank 0 speaks for all, and all ranks end alike."""

from __future__ import annotations

import io
import json
import os
import secrets
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import typer

from ..checks import FloatVector
from ..errors import InvalidOption, LCPError, UnreadableFile, did_you_mean
from ..problem.lcp import LCP
from ..settings import Settings
from ..solving import driver as solving
from ..solving.result import Result
from .target import require_file, scene_text
from .terminal import RunLine

BACKENDS = ("serial", "petsc")
LARGE_FOR_EACH_RANK = 100_000
FILES = ("z.npy", "w.npy", "status.json")
PIECE = 2**24  # values a write: a count of bytes beyond 2³¹ is more than some MPI libraries take
FEW_RANKS = 8
SPEAKER = "lcp-plugin"
T = TypeVar("T")


@dataclass(frozen=True)
class _Read:
    """A problem and what its source knows: a name, a start, and how far an own z is from what reference."""

    problem: LCP
    name: str = ""
    start: FloatVector | None = None
    distance: Callable[[FloatVector], float] | None = None
    reference: str = "from the continuum"


def check_backend(backend: str) -> None:
    """Raise InvalidOption for a backend that does not exist."""
    if backend not in BACKENDS:
        raise InvalidOption(f"--backend {backend!r} is not offered{did_you_mean(backend, BACKENDS)}")


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


def solve(
    target: str, size: int | None, algorithm: str, options: dict[str, Any], settings: dict[str, Any],
    plot: Path | None, out: Path | None, *, as_json: bool,
) -> bool:
    """Solve on all ranks, print and save; return whether it is solved, the same on every rank.

    Raises
    ------
    LCPError
        On every rank.
    """
    if plot is not None:
        raise InvalidOption(
            "--plot is not offered with --backend petsc, as no rank holds the whole z; save with --out FOLDER and plot "
            "np.load('FOLDER/z.npy')"
        )
    try:
        from .. import distributed  # noqa: F401 - first: it says what is missing
        from ..peers.ranks.collective import as_mpi
        from ..peers.ranks.failures import ends_together
        from ..policy.choice import policy_for
    except (ImportError, RuntimeError) as error:  # mpi4py without an MPI library
        raise InvalidOption(
            f"--backend petsc needs mpi4py and petsc4py ({error}); install them with pip install 'lcp_plugin[petsc]'"
        ) from error
    comm = as_mpi(None)
    with ends_together(comm, speaker=SPEAKER):
        Settings(**settings, record=False)  # each rank sees a wrong one for itself, before anything is built
        settings = {**settings, "algorithm": policy_for(algorithm, options, on_ranks=True).chosen}
        _by_first(comm, lambda: _check_folder(target, out))
        read = _read(comm, target, size)
        _by_first(comm, lambda: _check_room(read.problem.n, out))
        with RunLine() as progress:
            callback = progress if comm.rank == 0 else None
            result = solving.solve(read.problem, z0=read.start, callback=callback, **settings)
        content, story = _told(read, result)
        typer.echo(json.dumps(content, indent=2) if as_json else story)
        if out is not None:
            _save(comm, result, content, out)
            typer.echo(f"saved {', '.join(str(out / name) for name in FILES)}", err=as_json)
    return bool(result.is_solved)


# --- what is solved -------------------------------------------------------------------------------------------


def _read(comm: Any, target: str, size: int | None) -> _Read:
    from ..evidence import gallery
    from ..evidence.gallery import on_ranks as scenes

    text = scene_text(target, size)
    if text is None:
        kind = _by_first(comm, lambda: _kind(target))
        if kind == "parts":
            return _Read(LCP.load(target, comm))
        whole = LCP.load(target)
        _note_whole(comm, whole.n, "this file is read")
        return _Read(LCP.from_problem(whole, comm))
    by_rows = scenes.by_rows(text)
    if by_rows is not None:
        name, parameters = by_rows
        problem = scenes.build(name, comm, parameters)
        label = ", ".join(f"{key}={value!r}" for key, value in parameters.items())
        return _Read(
            problem, f"Scene({name}: {label})",
            distance=lambda z: scenes.continuum_error(problem, z, name, **parameters),
        )
    scene = gallery.parse(text)
    if scene.steps > 1:
        raise InvalidOption(f"{scene.name} is a march in time, which --backend petsc does not offer; leave it out")
    _note_whole(comm, scene.n, f"{scene.name} is built")
    problem = LCP.from_problem(scene.problem, comm)
    own = slice(problem.first, problem.last)
    reference, name = (scene.continuum, "from the continuum") if scene.exact is None else (scene.exact, "true error")
    return _Read(
        problem, str(scene), start=None if scene.start is None else scene.start[own],
        distance=None if reference is None else lambda z: float(np.abs(z - reference[own]).max(initial=0.0)),
        reference=name,
    )


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


def _told(read: _Read, result: Result) -> tuple[dict[str, Any], str]:
    """Return what --json prints and what a person reads; all ranks call."""
    from ..peers.ranks.collective import gathered

    problem, z = read.problem, result.z
    distance = 0.0 if read.distance is None else read.distance(z)
    is_at_bound = (z <= problem.lower) | (z >= problem.upper)
    table = gathered(problem.peers.comm, float(np.count_nonzero(is_at_bound)), distance, _peak_memory())
    peaks = [int(peak) for peak in table[:, 2]]
    at_bound = f"{'at a bound':<18} {int(table[:, 0].sum())} of {problem.n}"
    lines = [read.name, repr(problem), result.explain(), str(result.certificate), at_bound]
    if read.distance is not None:
        lines.append(f"{read.reference:<18} {table[:, 1].max():.3e}")
    lines.append(f"{'peak memory':<18} {_in_words(peaks)}")
    content = {**result.to_content(), "ranks": problem.peers.size, "peak_memory_bytes": peaks}
    return content, "\n".join(filter(None, lines))


def _peak_memory() -> int:
    """Return the most bytes this process has held at once; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _in_words(peaks: list[int]) -> str:
    megabytes = [round(peak / 1e6) for peak in peaks]
    each = ", ".join(map(str, megabytes))
    if len(peaks) > FEW_RANKS:
        each = f"{min(megabytes)} to {max(megabytes)}"
    return f"{each} MB a rank" if len(peaks) == 1 else f"{each} MB a rank, {sum(megabytes)} MB in all"


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
    if out.exists() and Path(target).exists() and out.samefile(target):
        raise UnreadableFile(f"cannot write {out}: it is the problem itself; choose another name")
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


def _save(comm: Any, result: Result, content: dict[str, Any], out: Path) -> None:
    """Write z, w and the status into a folder: under other names first, which rank 0 changes at the end."""
    token, is_new = _by_first(comm, lambda: _make_folder(out))
    temporary = {name: out / f".{token}-{name}" for name in FILES}
    try:
        for name, own in (("z.npy", result.z), ("w.npy", result.w)):
            _write_array(comm, temporary[name], own, result.certificate.problem)
        _by_first(comm, lambda: temporary["status.json"].write_text(json.dumps(content, indent=2), encoding="utf-8"))
        _by_first(comm, lambda: [temporary[name].replace(out / name) for name in FILES] and None)
    finally:
        if comm.rank == 0:
            for path in temporary.values():
                path.unlink(missing_ok=True)
            if is_new and not any(out.iterdir()):
                out.rmdir()


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


def _by_first(comm: Any, attempt: Callable[[], T]) -> T:
    """Return what `attempt` gives on rank 0, on every rank; raise its error on every rank."""
    outcome: Any = None
    failure: Exception | None = None
    if comm.rank == 0:
        try:
            outcome = attempt()
        except LCPError as error:
            failure = error
        except OSError as error:
            failure = UnreadableFile(f"cannot write {error.filename}: {error.strerror}; choose another place")
    outcome, failure = comm.bcast((outcome, failure))
    if failure is not None:
        raise failure
    result: T = outcome
    return result
