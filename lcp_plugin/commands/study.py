"""What `lcp-plugin study` does: a study file and options become one call of `study`, and its views are saved."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from ..core.errors import InvalidOption, UnreadableFile, did_you_mean
from ..core.representation import in_words
from ..evidence.drawing import FORMATS, require_matplotlib
from ..evidence.exporting import TABLES
from ..evidence.results import VIEWS, Study
from ..evidence.study import study
from .target import is_own_problem, lcp_of_file, load, own_algorithm, scene_text
from .terminal import PartsLine, console, table

KEYS: dict[str, tuple[type, ...]] = {
    "problems": (list, str, dict),
    "methods": (list, dict),
    "sizes": (list,),
    "repeats": (int,),
    "tolerance": (int, float),
    "max_seconds": (int, float),
    "max_work": (int, float),
    "error_bound": (bool,),
    "out": (str,),
    "save": (list, str),
}
OUT = "study.csv"
SHOWN = "iterations"
NO_ANSWER = ("REFUSED", "ERROR")


def run(targets: Sequence[str], given: Mapping[str, Any]) -> bool:
    """Measure problems and study files, print and save; return whether nothing is missing and nothing raised."""
    wishes: dict[str, Any] = {}
    for file in (target for target in targets if target.endswith(".toml")):
        wishes |= _of_file(Path(file))
    wishes |= {key: value for key, value in given.items() if value}
    if problems := [target for target in targets if not target.endswith(".toml")]:
        wishes["problems"] = problems
    if not wishes.get("problems"):
        raise InvalidOption(
            "a study needs a problem: name one, or a study file (.toml) with problems = [...]"
        )
    views = _checked_views(wishes.pop("save", []))
    out = Path(wishes.pop("out", OUT))
    keeps_curves = any(view.startswith("curves") for view, _ in views)
    methods = wishes.pop("methods", None)
    found = study(
        _problems(wishes.pop("problems")),
        _methods(methods),
        wishes.pop("sizes", None),
        out=out,
        curves=keeps_curves,
        progress=PartsLine("study"),
        **wishes,
    )
    _print(found)
    for view, path in views:
        if found.rows:
            found.save(view, path)
            typer.echo(f"saved {path}: {view}")
    again = f", {found.found} of them from a former run" if found.found else ""
    missing = len(found.missing)
    rest = (
        f"; interrupted, {missing} missing: the same command goes on from here" if missing else ""
    )
    typer.echo(f"{out}: {in_words(len(found.rows), 'row')}{again}{rest}")
    return not found.missing and all(row.curve.status != "ERROR" for row in found.rows)


def sizes_of(texts: Sequence[str]) -> list[int]:
    """Return the sizes that stand behind --size, separated by commas or not.

    Raises
    ------
    InvalidOption
        Where one is no whole number.
    """
    try:
        return [int(size) for text in texts for size in text.split(",")]
    except ValueError:
        wrong = ", ".join(map(repr, texts))
        raise InvalidOption(
            f"--size must be whole numbers, as --size 50,100, got {wrong}"
        ) from None


def _of_file(file: Path) -> dict[str, Any]:
    """Return what a study file says; raise where it cannot be read, or has an unknown word."""
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableFile(f"cannot read {file}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UnreadableFile(f"{file} is no TOML: {error}") from None
    for key, value in content.items():
        if key not in KEYS:
            raise InvalidOption(f"{file}: unknown key {key!r}{did_you_mean(key, KEYS)}")
        if not isinstance(value, KEYS[key]) or (isinstance(value, bool) and bool not in KEYS[key]):
            kinds = " or ".join(kind.__name__ for kind in KEYS[key])
            raise InvalidOption(f"{file}: {key} must be {kinds}, got {value!r}")
    return content


def _problems(given: Any) -> dict[str, Any]:
    """Return the problems by their labels, those of files and modules loaded."""
    if not isinstance(given, Mapping):
        listed = [str(text) for text in ([given] if isinstance(given, str) else given)]
        given = {text.partition(":")[2] if is_own_problem(text) else text: text for text in listed}
    return {label: _problem(str(text)) for label, text in given.items()}


def _problem(text: str) -> Any:
    if is_own_problem(text):
        return load(text)
    return scene_text(text) or lcp_of_file(text, "lcp-plugin study")


def _methods(given: Any) -> Any:
    """Return what `contestants` takes: of a table, each label with its name and its options."""
    if given is None:
        return None
    if not isinstance(given, Mapping):
        return [_method(one, {}) if isinstance(one, str) else _method(*one) for one in given]
    made = {}
    for label, one in given.items():
        options = dict(one) if isinstance(one, Mapping) else {"algorithm": one}
        if "algorithm" not in options:
            raise InvalidOption(
                f'method {label!r} needs an algorithm: write {label} = {{ algorithm = "psor" }}'
            )
        made[label] = _method(options.pop("algorithm"), options)
    return made


def _method(name: str, options: dict[str, Any]) -> Any:
    chosen, rest = own_algorithm(name, options)
    return (chosen, rest) if isinstance(chosen, str) else chosen


def _checked_views(given: str | Sequence[str]) -> list[tuple[str, Path]]:
    """Return (view, path) of each VIEW=FILE, refused before anything runs where it could not be written after it."""
    views = []
    for text in [given] if isinstance(given, str) else given:
        view, equals, name = str(text).partition("=")
        path = Path(name)
        if not equals or not name or view not in VIEWS:
            hint = "" if view in VIEWS else did_you_mean(view, VIEWS)
            raise InvalidOption(f"--save wants VIEW=FILE, as work=work.pdf, got {text!r}{hint}")
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
        for row in found.rows
        if row.curve.status in NO_ANSWER
    }
    for line in said:
        terminal.print(line)
