"""What `lcp-plugin study` does: a study file and options become one call of `study`, and its views are saved."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption, UnreadableFile, did_you_mean
from ..evidence.contestants import contestants
from ..evidence.drawing import FORMATS, require_matplotlib
from ..evidence.exporting import TABLES
from ..evidence.own_code import is_own
from ..evidence.study import VIEWS, Study, label_of, study
from .target import lcp_of_file, scene_text
from .terminal import PartsLine, console, table

KEYS = {
    "problems": (list, str, dict), "methods": (list, str, dict), "sizes": list, "repeats": int, "tolerance": (int, float),
    "max_seconds": (int, float), "max_work": (int, float), "error_bound": bool, "out": str, "save": (list, str),
}
OUT = "study.csv"
SHOWN = "iterations"
NO_ANSWER = ("REFUSED", "ERROR")


def run(targets: Sequence[str], given: Mapping[str, Any]) -> bool:
    """Measure, print and save; return whether nothing is missing and nothing raised. A target is a problem, or a study file."""
    wishes: dict[str, Any] = {}
    for file in (target for target in targets if target.endswith(".toml")):
        wishes |= _of_file(Path(file))
    wishes |= {key: value for key, value in given.items() if value}
    if problems := [target for target in targets if not target.endswith(".toml")]:
        wishes["problems"] = problems
    if not wishes.get("problems"):
        raise InvalidOption("a study needs a problem: name one, or a study file (.toml) with problems = [...]")
    views = _checked_views(wishes.pop("save", []))
    out = Path(wishes.pop("out", OUT))
    keeps_curves = any(view.startswith("curves") for view, _ in views)
    methods = wishes.pop("methods", None)
    found = study(
        _problems(wishes.pop("problems")), _methods(methods), wishes.pop("sizes", None), out=out, curves=keeps_curves,
        progress=PartsLine("study"), **wishes,
    )
    _print(found)
    for view, path in views:
        if found.rows:
            found.save(view, path)
            typer.echo(f"saved {path}: {view}")
    again = f", {found.found} of them from a former run" if found.found else ""
    rest = "" if not found.missing else f"; interrupted, {len(found.missing)} missing: the same command goes on from here"
    typer.echo(f"{out}: {len(found.rows)} rows{again}{rest}")
    return not found.missing and all(row.curve.status != "ERROR" for row in found.rows)


def _of_file(file: Path) -> dict[str, Any]:
    """Return what a study file says; raise where it cannot be read, or has a word that nobody knows."""
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableFile(f"cannot read {file}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UnreadableFile(f"{file} is no TOML: {error}") from None
    for key, value in content.items():
        if key not in KEYS:
            raise InvalidOption(f"{file}: unknown key {key!r}{did_you_mean(key, KEYS)}")
        if not isinstance(value, KEYS[key]) or (isinstance(value, bool) and KEYS[key] is not bool):
            kinds = KEYS[key] if isinstance(KEYS[key], tuple) else (KEYS[key],)
            raise InvalidOption(f"{file}: {key} must be {' or '.join(kind.__name__ for kind in kinds)}, got {value!r}")
    return content


def _problems(given: Any) -> dict[str, Any]:
    """Return the problems by their labels, those of files loaded."""
    named = given if isinstance(given, Mapping) else {label_of(text): text for text in ([given] if isinstance(given, str) else given)}
    return {
        label: text if is_own(str(text)) or scene_text(str(text)) else lcp_of_file(str(text), "lcp-plugin study")
        for label, text in named.items()
    }


def _methods(given: Any) -> Any:
    """Return what `contestants` takes: of a table, each label with its name and its options."""
    if not isinstance(given, Mapping):
        return given
    made = {}
    for label, one in given.items():
        options = dict(one) if isinstance(one, Mapping) else {"algorithm": one}
        if "algorithm" not in options:
            raise InvalidOption(f'method {label!r} needs an algorithm: write {label} = {{ algorithm = "psor" }}')
        made[label] = (options.pop("algorithm"), options)
    contestants(made)
    return made


def _checked_views(given: str | Sequence[str]) -> list[tuple[str, Path]]:
    """Return (view, path) of each VIEW=FILE, refused before anything runs where it could not be written after it."""
    views = []
    for text in [given] if isinstance(given, str) else given:
        view, equals, name = str(text).partition("=")
        path = Path(name)
        if not equals or not name or view not in VIEWS:
            hint = did_you_mean(view, VIEWS)
            raise InvalidOption(f"--save wants VIEW=FILE, as work=work.pdf, got {text!r}{'' if view in VIEWS else hint}")
        is_picture = path.suffix in FORMATS
        if not is_picture and path.suffix not in TABLES:
            raise InvalidOption(f"{name!r} must end in {', '.join([*TABLES, *FORMATS])}")
        if not path.absolute().parent.is_dir():
            raise UnreadableFile(f"cannot write {path}: the folder {path.parent} does not exist")
        if is_picture:
            require_matplotlib()
        if (view == "results") == is_picture and view == "results":
            raise InvalidOption(f"results are a table: {name!r} must end in {', '.join(TABLES)}")
        if view.startswith("curves") and not is_picture:
            raise InvalidOption(f"curves are a picture: {name!r} must end in {', '.join(FORMATS)}")
        views.append((view, path))
    return views


def _print(found: Study) -> None:
    terminal = console(120)
    for one in found.table(SHOWN) if found.rows else []:
        terminal.print(table(one.title, one.columns, one.texts(), is_of_numbers=True))
    said = {
        f"{row.curve.status} {'on' if row.n == 0 else f'{row.curve.label} on'} {row.problem}"
        f"{'' if row.size is None else f' of size {row.size}'}: {row.curve.note}": None
        for row in found.rows if row.curve.status in NO_ANSWER
    }
    for line in said:
        terminal.print(line)
