"""Compute parts one by one, and keep what is there after Ctrl-C: what a study and the report have in common."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from ..core.lcp import LCP

if TYPE_CHECKING:
    from .results import ResultsFile

Say = Callable[[str], object]
Compute = Callable[[Say], Any]
PACKAGES = (
    "lcp_plugin",
    "numpy",
    "scipy",
    "numba",
    "pyamg",
    "cvxpy",
    "osqp",
    "clarabel",
    "scs",
    "matplotlib",
)
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Progress = Callable[[int, int, str], object]


@dataclass(frozen=True)
class Part:
    """One piece of work: its kind, its name within the kind, how it is computed, and what stands for its own data."""

    kind: str
    name: str
    compute: Compute
    data: Callable[[], str] = str

    def key(self, program: str) -> str:
        """Return a hash of everything that the content depends on."""
        settings = json.dumps([self.kind, self.name, self.data()])
        return hashlib.sha256(f"{settings}{program}".encode()).hexdigest()[:16]


@dataclass
class Collected:
    """The contents of the rows of a study, or of the sections of a report.

    Attributes
    ----------
    contents : dict
        The content of each part by (kind, name), in the order of the plan.
    found : int
        How many of them were found in a file, from a former run.
    missing : list of str
        The names of parts that are not there yet.
    """

    contents: dict[tuple[str, str], Any] = field(default_factory=dict)
    found: int = 0
    missing: list[str] = field(default_factory=list)

    @property
    def is_complete(self) -> bool:
        """True where no part is missing."""
        return not self.missing

    def of(self, kind: str) -> dict[str, Any]:
        """Return the contents of one kind by their names."""
        return {
            name: content for (its_kind, name), content in self.contents.items() if its_kind == kind
        }


def collect(
    parts: Sequence[Part], file: ResultsFile | None, progress: Progress | None = None
) -> Collected:
    """Return the contents of all parts, those from a former run of the same program and machine read from the file.

    Parameters
    ----------
    parts : sequence of Part
    file : ResultsFile or None
        What keeps each part.
    progress : callable, optional
        Called as ``progress(done, total, label)``.

    Notes
    -----
    On Ctrl-C the part under way is given up, and what is there is returned; a second one changes nothing.
    """
    say = progress or (lambda done, total, label: None)
    collected = Collected()
    with _Interruption() as interruption:
        for done, part in enumerate(parts):
            label = f"{part.kind} {part.name}"
            if not interruption.is_wanted:
                say(done, len(parts), label)
            content = None if file is None else file.read(part)
            if content is not None:
                collected.found += 1
            elif not interruption.is_wanted:
                content = _computed(
                    part, interruption, partial(_say_more, say, done, len(parts), label)
                )
                if content is not None and file is not None:
                    file.write(part, content)
            if content is None:
                collected.missing.append(label)
            else:
                collected.contents[part.kind, part.name] = content
    return collected


def _say_more(say: Progress, done: int, total: int, label: str, text: str) -> None:
    say(done, total, f"{label}: {text}")


def _computed(part: Part, interruption: _Interruption, say: Callable[[str], object]) -> Any:
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


def data_of(problem: LCP) -> str:
    """Return a hash of a problem's data."""
    arrays = (
        problem.csr.indptr,
        problem.csr.indices,
        problem.csr.data,
        problem.q,
        problem.lower,
        problem.upper,
    )
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def machine() -> dict[str, str]:
    """Return what is measured on, by name, in the order in which it is shown: no name of a computer or a user."""
    from .. import __version__

    facts = {
        "measured": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.release()}",
        "Python": platform.python_version(),
        "threads": ", ".join(f"{name}={os.environ[name]}" for name in THREADS if name in os.environ)
        or "not limited",
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
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


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
