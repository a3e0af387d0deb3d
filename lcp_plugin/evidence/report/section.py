"""What a part of the report is, one object that computes and draws, and the page that they make.

All of them lie in this folder. The page is index.html, which needs no other file; beside it lie CSV and JSON.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module, resources
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, ClassVar

from ...core.errors import LCPError
from ...gallery.scene import Scene
from ..collecting import Collected, Compute, Part, Say, collect, machine
from ..drawing import COLOURS, svg
from ..exporting import finite_content, write_text

__all__ = [
    "Collected", "Compute", "Part", "ReportEffort", "Say", "Section", "collect", "plan", "sections", "write_report",
]

PAGE_WIDTH = 4.7  # inches, of a figure on the page


@dataclass(frozen=True)
class ReportEffort:
    """How much a report spends: repeats, entries of M a run may touch, and the seconds of a run and a reference."""

    repeats: int
    entries: float
    run_seconds: float
    reference_seconds: float
    is_quick: bool


FULL = ReportEffort(repeats=3, entries=5e8, run_seconds=30.0, reference_seconds=20.0, is_quick=False)
QUICK = ReportEffort(repeats=3, entries=1e8, run_seconds=5.0, reference_seconds=3.0, is_quick=True)


class Section:
    """A part of the report. A class below it, in a file of this folder, is all that a new one needs.

    Attributes
    ----------
    kind : str
        Of the parts that it reads: without any of them it is not on the page. "" for none.
    place : int
        Sections stand and are computed in this order.
    title, short : str
        The heading, and what leads there from the head of the page.
    anchor : str
        The name by which the page is linked to; by default that of the module.
    template : str
        What jinja makes the section's body of; by default the file beside the module, with the name of the anchor.
    """

    kind: ClassVar[str] = ""
    place: ClassVar[int]
    title: ClassVar[str]
    short: ClassVar[str]
    anchor: ClassVar[str]
    template: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        cls.anchor = vars(cls).get("anchor", cls.__module__.rpartition(".")[2])

    def markup(self) -> str:
        """Return the template."""
        return self.template or resources.files(__package__).joinpath(f"{self.anchor}.html").read_text("utf-8")

    def work(self, effort: ReportEffort) -> Mapping[str, Compute]:
        """Return what the whole report has to compute, by name."""
        return {}

    def parts(self, scenes: Mapping[str, str | Scene], effort: ReportEffort) -> Iterable[Part]:
        """Return what is to be computed one by one, for the scenes asked for or, without any, the whole report."""
        work = {} if scenes else self.work(effort)
        return [Part(self.kind, name, compute, effort) for name, compute in work.items()]

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return what the template shows, figures included; nothing where the section is not to be on the page."""
        return {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return the CSV files that lie beside the page, text by name."""
        return {}


def sections() -> list[Section]:
    """Return all sections in their order."""
    for module in iter_modules(import_module(__package__).__path__, f"{__package__}."):
        import_module(module.name)
    return sorted((kind() for kind in Section.__subclasses__()), key=lambda section: section.place)


def sections_of(collected: Collected) -> list[Section]:
    """Return those that have something to show, in their order."""
    return [section for section in sections() if not section.kind or collected.of(section.kind)]


def plan(scenes: Sequence[str | Scene] = (), *, quick: bool = False) -> list[Part]:
    """Return the parts of a report.

    Parameters
    ----------
    scenes : sequence of str and Scene
        As on a command line, ``name:key=value``, or with a problem of one's own; by default the report's own choice.
    quick : bool
        Small sizes and few repeats: to see what it looks like.

    Raises
    ------
    InvalidOption
        Where a scene does not exist.
    """
    chosen = {scene if isinstance(scene, str) else scene.name: scene for scene in scenes}
    effort = QUICK if quick else FULL
    return [part for section in sections() for part in section.parts(chosen, effort)]


# --- What sections share --------------------------------------------------------------------------------------


def figure(drawn: Any, name: str, description: str) -> Any:
    """Return a matplotlib figure as the template takes it."""
    from markupsafe import Markup

    return Markup(svg(drawn, name, description))


def brief(value: float | None) -> str:
    """Return two digits of a number, a dash where there is none."""
    return "–" if value is None or math.isnan(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e+")


def count(value: float) -> str:
    """Return a number of passes."""
    return f"{value:.0f}" if value < 1e5 else brief(value)


def seconds(value: float) -> str:
    """Return a time with its unit, three digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value / 1e-6:.2g} µs"


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
    facts, every = machine(), sections_of(collected)
    page = _template(resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8")).render(
        machine=facts, sections=list(filter(None, (_shown(section, collected) for section in every))),
        missing=collected.missing, is_quick=is_quick,
    )
    content = {
        "machine": facts, "missing": collected.missing,
        "parts": [{"kind": kind, "name": name} | part for (kind, name), part in collected.contents.items()],
    }
    for section in every:
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
