"""Write the page: index.html, without any other file; the same figures lie beside it as CSV and JSON."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from ...core.errors import LCPError
from ..collecting import Collected, collect, machine
from ..drawing import COLOURS
from ..exporting import finite_content, write_text
from .section import Section, brief, sections_of

__all__ = ["collect", "require_jinja", "write_report"]


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
    page = _template(files(__package__).joinpath("page.html").read_text(encoding="utf-8")).render(
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
