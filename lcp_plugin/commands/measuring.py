"""lcp-plugin tables, study and report: what measures, beside the paper, on families of problems, and on scenes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.errors import InvalidOption, UnreadableFile
from .app import command
from .target import algorithm_names, scene_names


@command("tables", "0 every iteration count is the paper's, 1 one differs", "tables", "tables --out tables.tex")
def tables(
    out: Annotated[Path | None, typer.Option(help="Save them as well: .tex (booktabs, siunitx), .md or .csv.")] = None,
) -> bool:
    """Compute the paper's Tables 1 and 2 again, each figure beside the printed one."""
    from .tables import print_paper_tables

    return print_paper_tables(out)


@command(
    "study",
    "0 complete, 1 interrupted or a method raised (the same command goes on), 2 bad input",
    "study half_active -a npsor -a psor --size 100 --size 400 --size 900 --save work=work.pdf",
    "study own.py:family -a own.py:Mine -o relaxation=1.5 --size 100", "study study.toml",
)
def study(
    targets: Annotated[
        list[str] | None,
        typer.Argument(
            help="Problems: scenes, files, or file.py:function, which is given the size; or a study file, .toml, with "
            "problems, methods, sizes, repeats, tolerance, max_seconds, max_work, error_bound, out, save; what stands "
            "here and below goes before it.",
            autocompletion=scene_names,
        ),
    ] = None,
    problem: Annotated[
        list[str] | None, typer.Option("--problem", "-p", help="A problem as above.", autocompletion=scene_names)
    ] = None,
    algorithm: Annotated[
        list[str] | None,
        typer.Option("--algorithm", "-a", help="A name that `lcp-plugin list` shows, or file.py:Class.",
                     autocompletion=algorithm_names),
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-o", help="Of the only algorithm given: name=value.")
    ] = None,
    size: Annotated[list[int] | None, typer.Option(help="Sizes of the families; give it once for each.")] = None,
    repeats: Annotated[int | None, typer.Option(help="Runs behind each median of seconds; by default 3.")] = None,
    tolerance: Annotated[float | None, typer.Option(help="SOLVED means a residual of at most this: 1e-8.")] = None,
    max_seconds: Annotated[float | None, typer.Option(help="Limit of wall-clock seconds of a run: 20.")] = None,
    max_work: Annotated[float | None, typer.Option(help="Limit of passes over M of a run.")] = None,
    error_bound: Annotated[
        bool, typer.Option("--error-bound", help="Bound the error where the exact answer is not known.")
    ] = False,
    out: Annotated[str | None, typer.Option(help="The file of raw results: study.csv.")] = None,
    save: Annotated[
        list[str] | None,
        typer.Option(help="VIEW=FILE: iterations, work, seconds, residual, error, results, profile, profile-seconds, "
                     "curves or curves-work, as .tex, .md, .csv, .pdf, .svg or .png."),
    ] = None,
) -> bool:
    """Measure methods on families of problems, resumably, into one CSV; save tables and figures of it."""
    from . import solving
    from . import study as measured

    methods: Any = algorithm
    if option:
        if len(algorithm or []) != 1:
            raise InvalidOption("--option is for one --algorithm; with several write a study file, [methods]")
        methods = [((algorithm or [])[0], solving.options(None, option))]
    return measured.run([*(targets or []), *(problem or [])], {
        "methods": methods, "sizes": size, "repeats": repeats, "tolerance": tolerance,
        "max_seconds": max_seconds, "max_work": max_work, "error_bound": error_bound, "out": out, "save": save,
    })


@command(
    "report",
    "0 complete, 1 interrupted (the same command goes on), 2 bad input",
    "report --out report --quick", "report half_active:n=2500 own.npz --out mine",
)
def report(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(
            help="Scenes, name:key=value,…, or files and folders of LCPs; by default the usual choice.",
            autocompletion=scene_names,
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for index.html, CSV and JSON; made where it is missing.")
    ] = Path("report"),
    quick: Annotated[bool, typer.Option("--quick", help="Small problems: about a minute.")] = False,
) -> bool:
    """Write one page on error against time and stability; Ctrl-C and go on later."""
    from ..evidence.drawing import require_matplotlib
    from ..evidence.report.section import collect, plan, require_jinja, write_report
    from ..gallery import Scene
    from .target import lcp_of_file, own_scene, scene_text
    from .terminal import PartsLine

    def scene_of_file(path: str) -> Scene:
        problem = lcp_of_file(path, "lcp-plugin report")
        return Scene(problem=problem, name=path, description=f"your own problem, {problem}", is_declared=False)

    require_matplotlib()
    require_jinja()
    if out.exists() and not out.is_dir():
        raise UnreadableFile(f"cannot write {out}: it is a file; --out names a folder")
    began = time.perf_counter()
    parts = plan([own_scene(one) or scene_text(one) or scene_of_file(one) for one in scenes or []], quick=quick)
    collected = collect(parts, out / "parts", PartsLine())
    kept = f"{len(parts) - len(collected.missing)} of {len(parts)} parts"
    try:
        page = write_report(collected, out, is_quick=quick)
    except KeyboardInterrupt:
        typer.echo(f"interrupted while the page was written: {kept} are kept; the same command goes on from here")
        return False
    took = f"{time.perf_counter() - began:.0f} s"
    if collected.is_complete:
        again = f", {collected.found} of {len(parts)} parts found from a former run" if collected.found else ""
        typer.echo(f"{page}: {len(parts)} parts, {took}{again}")
    else:
        typer.echo(f"interrupted after {took}: {page} holds {kept}; the same command goes on from here")
    return collected.is_complete
