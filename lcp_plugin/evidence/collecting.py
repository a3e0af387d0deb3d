"""Compute parts one by one, keep each, and go on later: what a study and the report have in common."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from ..core.lcp import LCP
from .curves import Report
from .exporting import write_text

Say = Callable[[str], object]
Compute = Callable[[Say], dict[str, Any]]
PACKAGES = ("lcp_plugin", "numpy", "scipy", "numba", "pyamg", "cvxpy", "osqp", "clarabel", "scs", "matplotlib")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
Progress = Callable[[int, int, str], object]


@dataclass(frozen=True)
class Part:
    """One piece of work: its kind, its name within the kind, how it is computed, and what stands for its own data."""

    kind: str
    name: str
    compute: Compute
    effort: Any = None  # a dataclass of numbers
    data: str | Callable[[], str] = ""

    def key(self, program: str) -> str:
        """Return a hash of everything that the content depends on."""
        effort = None if self.effort is None else asdict(self.effort)
        data = self.data if isinstance(self.data, str) else self.data()
        settings = json.dumps([self.kind, self.name, effort, data])
        return hashlib.sha256(f"{settings}{program}".encode()).hexdigest()[:16]


@dataclass
class Collected:
    """The contents of the sections of a report.

    Attributes
    ----------
    contents : dict
        The content of each part by (kind, name), in the order of the plan.
    found : int
        How many of them were found on disk, from a former run.
    missing : list of str
        The names of parts that are not there yet.
    """

    contents: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    found: int = 0
    missing: list[str] = field(default_factory=list)

    @property
    def is_complete(self) -> bool:
        """True where no part is missing."""
        return not self.missing

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Return the contents of one kind."""
        return [content for (its_kind, _), content in self.contents.items() if its_kind == kind]

    def reports(self) -> list[Report]:
        """Return the curves of every scene."""
        return [Report.from_content(content["report"]) for content in self.of("scene")]


def collect(parts: Sequence[Part], store: Path | Store, progress: Progress | None = None) -> Collected:
    """Return the contents of all parts, those from a former run of the same program and machine read from the store.

    Parameters
    ----------
    parts : sequence of Part
    store : Path or Store
        What keeps each part; of a folder's path a `Folder`.
    progress : callable, optional
        Called as ``progress(done, total, label)``.

    Notes
    -----
    On Ctrl-C the part under way is given up, and what is there is returned; a second one changes nothing.
    """
    say = progress or (lambda done, total, label: None)
    collected, kept = Collected(), Folder(store) if isinstance(store, Path) else store
    with _Interruption() as interruption:
        for done, part in enumerate(parts):
            label = f"{part.kind} {part.name}"
            if not interruption.is_wanted:
                say(done, len(parts), label)
            content = kept.read(part)
            if content is not None:
                collected.found += 1
            elif not interruption.is_wanted:
                content = _computed(part, interruption, partial(_say_more, say, done, len(parts), label))
                if content is not None:
                    kept.write(part, content)
            if content is None:
                collected.missing.append(label)
            else:
                collected.contents[part.kind, part.name] = content
    return collected


def _say_more(say: Progress, done: int, total: int, label: str, text: str) -> None:
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


class Store(Protocol):
    """What keeps the contents of parts from one run to the next."""

    def read(self, part: Part) -> dict[str, Any] | None:
        """Return the content of a part, None where it is to be computed."""

    def write(self, part: Part, content: dict[str, Any]) -> None:
        """Keep the content, whole or not at all."""


class Folder:
    """A folder, created where it is missing, with one JSON file a part."""

    def __init__(self, path: Path) -> None:
        path.mkdir(parents=True, exist_ok=True)
        self.path, self.program = path, fingerprint()

    def _file(self, part: Part) -> Path:
        return self.path / f"{part.kind}-{part.key(self.program)}.json"

    def read(self, part: Part) -> dict[str, Any] | None:
        """Return what the file holds, None where there is none or it is spoilt."""
        with contextlib.suppress(OSError, ValueError):
            content = json.loads(self._file(part).read_text(encoding="utf-8"))
            return content if isinstance(content, dict) else None
        return None

    def write(self, part: Part, content: dict[str, Any]) -> None:
        """Write the file."""
        write_text(self._file(part), json.dumps(content, ensure_ascii=False, allow_nan=False))


def data_of(problem: LCP) -> str:
    """Return a hash of a problem's data."""
    arrays = (problem.csr.indptr, problem.csr.indices, problem.csr.data, problem.q, problem.lower, problem.upper)
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
