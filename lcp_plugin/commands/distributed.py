"""What `lcp-plugin solve --backend petsc` does its own way: rank 0 speaks for all, all ranks end alike."""

from __future__ import annotations

import io
import json
import os
import secrets
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, LCPError, UnreadableFile
from ..core.lcp import LCP
from ..core.solving.result import Result
from ..gallery.obstacle import sphere_layers
from ..gallery.scene import Scene, checked_values
from ..gallery.scene import build as build_whole
from .solving import OneProcess, T, refuse_the_problem_itself, require_place
from .target import scene_text

FILES = ("z.npy", "w.npy", "status.json")
BY_ROWS = {"obstacle_2d": partial(sphere_layers, 2), "obstacle_3d": partial(sphere_layers, 3)}
"""Scenes that each rank builds for its own rows; every other one is built whole, then cut."""
SPEAKER = "lcp-plugin"


@contextmanager
def on_all_ranks() -> Iterator[None]:
    """Run a whole command: only rank 0 prints, and whatever ends one rank ends all."""
    try:
        from mpi4py import MPI

        from ..ranks.petsc.collective import ends_together
    except (ImportError, RuntimeError, LCPError):  # `solve` says what is missing
        yield
        return
    if MPI.COMM_WORLD.rank > 0:
        sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - until the process ends
    signal.signal(signal.SIGTERM, _say_terminated)
    with ends_together(speaker=SPEAKER):
        yield


class OnRanks(OneProcess):
    """Every rank of the job, which all call in the same order."""

    is_distributed = True

    def __init__(self) -> None:
        from ..ranks.petsc.collective import Ranks

        self.ranks = Ranks(None)

    def from_first(self, attempt: Callable[[], T]) -> T:
        """Return on every rank what `attempt` gives on the first one."""
        return self.ranks.from_first(attempt)

    def ending_together(self) -> AbstractContextManager[None]:
        """Return a context in which the first failure ends all ranks."""
        from ..ranks.petsc.collective import ends_together

        return ends_together(self.ranks.comm, speaker=SPEAKER)

    def check_outputs(self, target: str, plot: Path | None, out: Path | None) -> None:
        """Refuse a picture, and a folder that cannot be written."""
        if plot is not None:
            raise InvalidOption(
                "--plot is not offered with --backend petsc, as no rank holds the whole z; save with --out FOLDER and "
                "plot np.load('FOLDER/z.npy')"
            )
        if out is None:
            return
        if out.suffix in (".npz", ".npy"):
            raise InvalidOption(
                f"with --backend petsc, --out names a folder for {', '.join(FILES)}; got {out.name!r}"
            )
        if out.exists() and not out.is_dir():
            raise UnreadableFile(f"cannot write {out}: it is a file")
        place = out if out.exists() else out.absolute().parent
        require_place(place, out)
        refuse_the_problem_itself(target, out)
        if not os.access(place, os.W_OK | os.X_OK):
            raise UnreadableFile(
                f"cannot write {out}: no permission to write into {place}; choose another place"
            )

    def read(self, target: str, size: int | None) -> tuple[LCP, Any]:
        """Return the own part of what is to be solved."""
        from .. import gallery

        text = scene_text(target, size)
        if text is None:
            path = Path(target)
            if self.ranks.from_first(lambda: path.is_dir() and not (path / "M.mtx").exists()):
                return LCP.load(target, self.ranks.comm), None
            whole = LCP.load(target)
            self._note_whole(whole.n, "this file is read")
            return LCP.from_problem(whole, self.ranks.comm), None
        name, parameters = gallery.read(text)
        scene = scene_on_ranks(name, self.ranks.comm, parameters)
        if scene.steps > 1:
            raise InvalidOption(
                f"{name} is a march in time, which --backend petsc does not offer; leave it out"
            )
        if name not in BY_ROWS:
            self._note_whole(scene.n, f"{name} is built")
        return scene.problem, scene

    def _note_whole(self, n: int, what: str) -> None:
        if self.ranks.size > 1 and n > 100_000:
            typer.echo(
                f"note: {what} whole on each of the {self.ranks.size} ranks, then cut", err=True
            )

    def beyond(self) -> tuple[dict[str, Any], list[str]]:
        """Return the number of ranks and their peaks of memory."""
        peaks = [int(peak) for peak in self.ranks.table(peak_memory())[:, 0]]
        megabytes = [round(peak / 1e6) for peak in peaks]
        each = (
            ", ".join(map(str, megabytes))
            if len(peaks) <= 8
            else f"{min(megabytes)} to {max(megabytes)}"
        )
        memory = f"{each} MB a rank" + (f", {sum(megabytes)} MB in all" if len(peaks) > 1 else "")
        return {"ranks": self.ranks.size, "peak_memory_bytes": peaks}, [
            f"{'peak memory':<18} {memory}"
        ]

    def save(self, result: Result, content: dict[str, Any], out: Path) -> list[Path]:
        """Write z, w and the status into a folder: under other names first, which rank 0 changes at the end."""
        problem = result.certificate.problem
        token, is_new = self.ranks.from_first(lambda: _make_folder(out, problem.n))
        temporary = {name: out / f".{token}-{name}" for name in FILES}

        def finish() -> None:
            temporary["status.json"].write_text(json.dumps(content, indent=2), encoding="utf-8")
            for name in FILES:
                temporary[name].replace(out / name)

        try:
            for name, own in (("z.npy", result.z), ("w.npy", result.w)):
                begin = self.ranks.from_first(partial(_begin_array, temporary[name], problem.n))
                self.ranks.together(
                    partial(_write_part, temporary[name], begin + 8 * problem.own_rows.start, own)
                )
            self.ranks.from_first(finish)
        finally:
            if self.ranks.rank == 0:
                for path in temporary.values():
                    path.unlink(missing_ok=True)
                if is_new and not any(out.iterdir()):
                    out.rmdir()
        return [out / name for name in FILES]


def scene_on_ranks(name: str, comm: Any, parameters: Mapping[str, Any]) -> Scene:
    """Return the scene with its problem's rows spread over the ranks, its vectors the own parts; all ranks call.

    Raises
    ------
    LCPError
        On every rank, as :func:`lcp_plugin.gallery.build`.
    """
    from ..ranks.petsc.collective import Ranks

    ranks = Ranks(comm)
    if name not in BY_ROWS:
        scene = ranks.together(lambda: build_whole(name, **parameters))
        problem = LCP.from_problem(scene.problem, comm)
        vectors = {"exact": scene.exact, "continuum": scene.continuum, "start": scene.start}
        own = problem.own_rows
        parts: dict[str, Any] = {
            fact: None if vector is None else vector[own] for fact, vector in vectors.items()
        }
        return replace(scene, problem=problem, **parts)
    values = ranks.together(lambda: checked_values(name, parameters))
    size = values["size"]
    begin, end = size * ranks.rank // ranks.size, size * (ranks.rank + 1) // ranks.size
    own_part = ranks.together(lambda: BY_ROWS[name](begin=begin, end=end, **values))
    problem = LCP.from_rows(comm, own_part.rows, own_part.q, own_part.lower)
    return Scene(problem=problem, name=name, parameters=values, continuum=own_part.continuum)


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
    stream.write(
        f"{SPEAKER}: ended from outside (Ctrl-C in mpiexec, or the batch system); nothing was saved\n"
    )
    stream.flush()
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def _make_folder(out: Path, n: int) -> tuple[str, bool]:
    """Make the folder if it is not there and the disk has space for z and w; return a word for new files in it."""
    is_new = not out.exists()
    free = shutil.disk_usage(out.absolute().parent if is_new else out).free
    if (needed := 16 * n) > free:
        raise UnreadableFile(
            f"cannot write {out}: z and w need {needed:.3g} bytes and {free:.3g} are free there"
        )
    out.mkdir(exist_ok=True)
    return secrets.token_hex(6), is_new


def _begin_array(path: Path, n: int) -> int:
    """Write the head of a .npy file of n numbers; return where the numbers begin."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (n,)}
    )
    path.write_bytes(header.getvalue())
    return len(header.getvalue())


def _write_part(path: Path, begin: int, own: FloatVector) -> None:
    """Write the own numbers into the file that all ranks see; beyond its end it grows."""
    try:
        with path.open("r+b") as file:
            file.seek(begin)
            file.write(np.ascontiguousarray(own, dtype="<f8").data)
    except OSError as error:
        raise UnreadableFile(f"cannot write {path}: {error.strerror or error}") from error
