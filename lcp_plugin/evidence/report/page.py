"""Compute the parts of a report one by one and write the page: what is there is kept on disk, and Ctrl-C stops it.

The page is index.html, without any other file; the same figures lie beside it as CSV and JSON.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import Any

from ...errors import LCPError
from ..drawing import COLOURS
from ..exporting import finite_content, write_text
from .section import Collected, Part, Section, brief, claims, sections_of

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
                content = _computed(part, interruption, partial(_say_more, say, done, len(parts), label))
                if content is not None:
                    write_text(files_of[part], json.dumps(content, ensure_ascii=False, allow_nan=False))
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
    for path in sorted(Path(__file__).parents[2].rglob("*.py")):
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


# --- The page --------------------------------------------------------------------------------------------------


def write_report(collected: Collected, folder: Path, *, is_quick: bool) -> Path:
    """Write the page and the tables into the folder; return the path of the page.

    Parameters
    ----------
    collected : Collected
        What there is; the page says what is missing.
    folder : Path
        Where ``index.html``, ``report.json`` and the CSV files go.
    is_quick : bool
        Whether the problems are the small ones, which the page says.

    Raises
    ------
    LCPError
        Where jinja2 or matplotlib is not installed.
    """
    facts, said, every = machine(), claims(collected), sections_of(collected)
    page = _template(files(__package__).joinpath("page.html").read_text(encoding="utf-8")).render(
        claims=said, machine=facts, sections=list(filter(None, (_shown(section, collected) for section in every))),
        missing=collected.missing, is_quick=is_quick,
    )
    content = {
        "machine": facts, "summary": [asdict(claim) for claim in said], "missing": collected.missing,
        "parts": [{"kind": kind, "name": name} | part for (kind, name), part in collected.contents.items()],
    }
    for section in every:
        content |= section.content(collected)
        for name, text in section.files(collected).items():
            write_text(folder / name, text)
    write_text(folder / "report.json", json.dumps(finite_content(content), ensure_ascii=False, indent=1))
    write_text(folder / "index.html", page)
    return folder / "index.html"


def _shown(section: Section, collected: Collected) -> dict[str, Any] | None:
    """Return heading and body of a section, None where it has nothing to show."""
    from markupsafe import Markup

    drawn = section.draw(collected)
    body = Markup(_template(section.markup()).render(drawn).strip()) if drawn else ""
    return {"anchor": section.anchor, "title": section.title, "short": section.short, "body": body} if body else None


def require_jinja() -> Any:
    """Return jinja2, or say how to install it."""
    try:
        import jinja2
    except ImportError as error:
        raise LCPError("the report needs jinja2; install it with: pip install 'lcp_plugin[report]'") from error
    return jinja2


def _template(text: str) -> Any:
    jinja2 = require_jinja()
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text, {"number": brief, "colours": COLOURS})
