"""Compute the parts of a report one by one, keep each on disk as soon as it is there, and stop cleanly on Ctrl-C."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import Any

from ..exporting import write_text
from .section import Collected, Part

PACKAGES = ("lcp_plugin", "numpy", "scipy", "numba", "pyamg", "cvxpy", "osqp", "clarabel", "scs", "matplotlib")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Progress = Callable[[int, int, str], object]


def collect(parts: Sequence[Part], folder: Path, progress: Progress | None = None) -> Collected:
    """Return the contents of all parts, those from a former run of the same program and machine read from `folder`.

    Parameters
    ----------
    parts : sequence of Part
    folder : Path
        Is created; holds one JSON file a part, written whole or not at all.
    progress : callable, optional
        Called as ``progress(done, total, label)``.

    Notes
    -----
    On Ctrl-C the part under way is given up, and what is there is returned; a second one changes nothing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    say = progress or (lambda done, total, label: None)
    collected, program = Collected(), fingerprint()
    files_of = {part: folder / f"{part.kind}-{_key(part, program)}.json" for part in parts}
    with _Interruption() as interruption:
        for done, part in enumerate(parts):
            label = f"{part.kind} {part.name}"
            if not interruption.is_wanted:
                say(done, len(parts), label)
            content = _read(files_of[part])
            if content is not None:
                collected.found += 1
            elif not interruption.is_wanted:
                content = _computed(part, interruption, partial(_detail, say, done, len(parts), label))
                if content is not None:
                    write_text(files_of[part], json.dumps(content, ensure_ascii=False, allow_nan=False))
            if content is None:
                collected.missing.append(label)
            else:
                collected.contents[part.kind, part.name] = content
    return collected


def _detail(say: Progress, done: int, total: int, label: str, text: str) -> None:
    say(done, total, f"{label}: {text}")


def _computed(part: Part, interruption: _Interruption, say: Callable[[str], object]) -> dict[str, Any] | None:
    try:
        interruption.may_raise = True
        content = part.compute(say)
    except KeyboardInterrupt:
        interruption.is_wanted = True
        return None
    finally:
        interruption.may_raise = False
    # A solver may swallow Ctrl-C and return what it has; that is no measurement.
    return None if interruption.is_wanted else content


def _read(path: Path) -> dict[str, Any] | None:
    with contextlib.suppress(OSError, ValueError):
        content = json.loads(path.read_text(encoding="utf-8"))
        return content if isinstance(content, dict) else None
    return None


def _key(part: Part, program: str) -> str:
    return hashlib.sha256(f"{part.settings}{program}".encode()).hexdigest()[:16]


def machine() -> dict[str, str]:
    """Return what is measured on, by name, in the order in which it is shown: no name of a computer or a user."""
    from ... import __version__

    facts = {
        "measured": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.release()}",
        "Python": platform.python_version(),
        "threads": ", ".join(f"{name}={os.environ[name]}" for name in THREADS if name in os.environ) or "not limited",
    }
    for name in PACKAGES:
        try:
            facts[name] = __version__ if name == "lcp_plugin" else version(name)
        except PackageNotFoundError:
            continue
    return facts


def _processor() -> str:
    cpu = Path("/proc/cpuinfo")
    if cpu.exists():
        for line in cpu.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def fingerprint() -> str:
    """Return a hash of the package's own source, processor and versions: parts of others are computed again."""
    facts = {name: fact for name, fact in machine().items() if name != "measured"}
    digest = hashlib.sha256(json.dumps(facts).encode())
    for path in sorted(_sources(files(__package__.partition(".")[0])), key=str):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _sources(folder: Any) -> Iterator[Any]:
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _sources(entry)
        elif entry.name.endswith(".py"):
            yield entry


class _Interruption:
    """While this is open, Ctrl-C is remembered even where a solver swallows the exception.

    It raises only where something is computed: what is being written is written.
    """

    def __init__(self) -> None:
        self.is_wanted = self.may_raise = False
        self._former: Any = None

    def __enter__(self) -> _Interruption:
        if threading.current_thread() is threading.main_thread():
            self._former = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        if self._former is not None:
            signal.signal(signal.SIGINT, self._former)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.is_wanted = True
        if self.may_raise:
            raise KeyboardInterrupt
