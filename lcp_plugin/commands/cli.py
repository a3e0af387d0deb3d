"""lcp-plugin: solve, check or certify a problem, tell what its matrix is, measure methods, list what there is."""

from __future__ import annotations

import json as json_module
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from .. import __version__
from ..core.errors import InvalidOption, UnreadableFile, did_you_mean
from .app import EXIT_BAD_INPUT, AlgorithmName, AnyTarget, Target, app, command
from .target import algorithm_names, scene_names

__all__ = ["app", "run"]


def run() -> None:
    """Entry point of the command; called as AMPL calls a solver, it is ``lcp-plugin-ampl``."""
    if "-AMPL" in sys.argv:
        from .ampl import run as run_for_ampl

        run_for_ampl()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(
                errors="replace"
            )  # a terminal without Unicode shows '?', not a traceback
    if "petsc" in sys.argv or "--backend=petsc" in sys.argv:  # before typer complains once a rank
        from .distributed import on_all_ranks

        with on_all_ranks():
            app()
    else:
        app()


def _print_json(content: dict[str, Any]) -> None:
    typer.echo(json_module.dumps(content, indent=2))


@app.callback(invoke_without_command=True)
def main(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", "-v", help="Print the version.")] = False,
) -> None:
    """Linear complementarity problems: find z with lower ≤ z ≤ upper and w = M z + q complementary."""
    if version:
        typer.echo(f"lcp-plugin {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:  # "lcp-plugin --" has an argument, but no command
        typer.echo(context.get_help())
        raise typer.Exit(EXIT_BAD_INPUT)


@command(
    "solve",
    "0 solved, 1 ran but not solved, 2 bad input",
    "solve obstacle_2d:size=200 --plot out.png",
    "solve problem.npz -a psor --relaxation 1.5 --out answer.npz",
    "solve folder_with_M_and_q/ --json",
    "solve program.qps --out answer.npz",
    "solve model.nl",
    "solve own.npz --plot out.png --grid 500x500",
    "solve obstacle-2d --size 500 --backend petsc --out answer",
)
def solve(
    target: AnyTarget,
    algorithm: AlgorithmName = "auto",
    relaxation: Annotated[
        str | None, typer.Option(help="Relaxation of the algorithm: a number, or auto for psor.")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", "-o", help="Any option of the algorithm: name=value."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="SOLVED means a residual of at most this; by default 1e-8, of a program 1e-9."
        ),
    ] = None,
    absolute_tolerance: Annotated[
        float, typer.Option(help="A residual in the unit of z that is small enough in any case.")
    ] = 0.0,
    tolerance_on: Annotated[
        str, typer.Option(help="residual, or error: SOLVED then means a proved relative error.")
    ] = "residual",
    error_bound: Annotated[
        bool, typer.Option("--error-bound", help="Bound the error of the answer.")
    ] = False,
    max_iterations: Annotated[int | None, typer.Option(help="Limit of iterations.")] = None,
    max_seconds: Annotated[float | None, typer.Option(help="Limit of wall-clock seconds.")] = None,
    prove_infeasibility: Annotated[
        bool, typer.Option(help="Look for a proof where there is no solution.")
    ] = True,
    threads: Annotated[
        int | None,
        typer.Option(help="How many threads it may use, all by default; BLAS's: OMP_NUM_THREADS."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Save a picture (.png, .pdf, .svg).")] = None,
    grid: Annotated[
        str | None,
        typer.Option(help="Of a file's unknowns, for the picture: rows x columns, as 500x500."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Save z and w, or x and its multipliers: an .npz file; with petsc a folder."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    size: Annotated[
        int | None, typer.Option(help="Size of a scene, as name:size=… says it.")
    ] = None,
    backend: Annotated[
        str, typer.Option(help="serial, or petsc: the rows spread over the ranks of mpiexec.")
    ] = "serial",
) -> bool:
    """Solve a problem of any kind, from a file or a scene; print status, residuals and counts, and x of a program."""
    from . import distributed, solving
    from .target import own_algorithm

    kinds = {"serial": solving.OneProcess, "petsc": distributed.OnRanks}
    if backend not in kinds:
        raise InvalidOption(f"--backend {backend!r} is not offered{did_you_mean(backend, kinds)}")
    settings: dict[str, Any] = dict(
        tolerance_on=tolerance_on,
        error_bound=error_bound,
        max_iterations=max_iterations,
        max_seconds=max_seconds,
        absolute_tolerance=absolute_tolerance,
        prove_infeasibility=prove_infeasibility,
        threads=threads,
        **({} if tolerance is None else {"tolerance": tolerance}),
    )
    chosen, options = own_algorithm(algorithm, solving.options(relaxation, option or []))
    picture = solving.Picture.asked(plot, grid)
    if solving.is_model(target):
        return solving.run_model(
            target, size, backend, chosen, options, settings, picture, out, as_json=json
        )
    return solving.run(
        kinds[backend](), target, size, chosen, options, settings, picture, out, as_json=json
    )


@command(
    "check",
    "0 both agree, 1 they do not or nothing can be compared (the reason is printed), 2 bad input",
    "check obstacle_2d:size=30",
    "check problem.npz --reference clarabel",
)
def check(
    target: Target,
    algorithm: AlgorithmName = "auto",
    reference: Annotated[
        str, typer.Option(help="The convex solver to compare with, or auto.")
    ] = "auto",
    max_seconds: Annotated[
        float, typer.Option(help="Limit of wall-clock seconds of each side.")
    ] = 60.0,
) -> bool:
    """Compare our answer with that of a convex solver that shares no code with it."""
    from ..evidence.cross_check import cross_validate
    from .target import own_algorithm, read_target

    chosen, _ = own_algorithm(algorithm, {})
    problem, _ = read_target(target, "lcp-plugin check")
    outcome = cross_validate(
        problem, reference=reference, algorithm=chosen, max_seconds=max_seconds
    )
    typer.echo(str(outcome))
    return outcome.agrees


@command(
    "certify",
    "0 every answer is proved, 1 one is unproved, disproved or missing, 2 bad input",
    "certify problem.npz --solver CLARABEL,OSQP",
    "certify problem.qps --out x.npz",
)
def certify(
    file: Annotated[
        str,
        typer.Argument(
            help="A convex program, quadratic or linear: .npz or .mat (P, q, A, l, u; or P, c, G, h, A, b, lower, "
            "upper; or quadprog's H, f, …), .qps, .mps or .nl."
        ),
    ],
    solver: Annotated[
        list[str],
        typer.Option(
            help="cvxpy's name of a solver, again for another, or commas between; LCP is ours."
        ),
    ] = ["LCP"],  # noqa: B006 - typer copies it
    tolerance: Annotated[
        float | None, typer.Option(help="What is to be proved; by default 1e-6, or else 1e-3.")
    ] = None,
    max_seconds: Annotated[
        float, typer.Option(help="Limit of wall-clock seconds of each proof.")
    ] = 60.0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Save x and its multipliers, of the first answer proved best: an .npz file."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
) -> bool:
    """Solve a quadratic program by any solvers, and tell what is proved of their answers."""
    from ..evidence.convex_solvers import HEAD, JudgedAnswer, judged_answers
    from ..interfaces.program_files import load_program
    from .solving import OneProcess

    names = list(
        dict.fromkeys(name.strip() for name in ",".join(solver).split(",") if name.strip())
    )
    if not names:
        raise InvalidOption("--solver wants at least one name, as --solver CLARABEL,OSQP")
    OneProcess().check_outputs(file, None, out)
    program, offset, *_ = load_program(file)
    answers: list[JudgedAnswer] = []
    for answer in judged_answers(program, names, tolerance=tolerance, max_seconds=max_seconds):
        if not json:
            typer.echo(str(answer) if answers else f"{file}: {program}\n{HEAD}\n{answer}")
        answers.append(answer)
    if json:
        _print_json(
            {"file": file, "offset": offset, "answers": [answer.to_content() for answer in answers]}
        )
    best = min(
        (answer for answer in answers if answer.is_proved_point),
        key=lambda one: one.tolerance,
        default=None,
    )
    if out is not None and best is not None:
        best.save(out)
        typer.echo(f"saved {out}: x of {best.solver}", err=json)
    elif out is not None:
        typer.echo(f"{out} is not written: no x is proved", err=json)
    elif best is not None and not json:
        typer.echo(
            f"x of {best.solver}: lcp-plugin certify {file} --solver {best.solver} --out x.npz"
        )
    return all(
        answer.certification is not None and answer.certification.verdict == "proved"
        for answer in answers
    )


@command("analyze", "0 done, 2 bad input", "analyze paper_example_1", "analyze problem.npz --json")
def analyze(
    target: Target,
    json: Annotated[bool, typer.Option("--json", help="Print both tables as JSON.")] = False,
) -> None:
    """Tell what kind of matrix it is, with evidence, and which algorithms are proved to converge on it."""
    from .tables import analysis, analysis_content
    from .target import read_target

    problem, _ = read_target(target, "lcp-plugin analyze")
    if json:
        _print_json(analysis_content(problem))
    else:
        typer.echo(analysis(problem))


@command(
    "tables",
    "0 every iteration count is the paper's, 1 one differs",
    "tables",
    "tables --out tables.tex",
)
def tables(
    out: Annotated[
        Path | None, typer.Option(help="Save them as well: .tex (booktabs, siunitx), .md or .csv.")
    ] = None,
) -> bool:
    """Compute the paper's Tables 1 and 2 again, each figure beside the printed one."""
    from .tables import print_paper_tables

    return print_paper_tables(out)


@command(
    "study",
    "0 complete, 1 interrupted or a method raised (the same command goes on), 2 bad input",
    "study half_active -a npsor -a psor --size 100 --size 400 --size 900 --save work=work.pdf",
    "study own.py:family -a own.py:Mine -o relaxation=1.5 --size 100",
    "study study.toml",
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
        list[str] | None,
        typer.Option("--problem", "-p", help="A problem as above.", autocompletion=scene_names),
    ] = None,
    algorithm: Annotated[
        list[str] | None,
        typer.Option(
            "--algorithm",
            "-a",
            help="A name that `lcp-plugin list` shows, or file.py:Class.",
            autocompletion=algorithm_names,
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", "-o", help="Of the only algorithm given: name=value."),
    ] = None,
    size: Annotated[
        list[str] | None, typer.Option(help="Sizes of the families: 50,100, or once for each.")
    ] = None,
    repeats: Annotated[
        int | None, typer.Option(help="Runs behind each median of seconds; by default 3.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="SOLVED means a residual of at most this: 1e-8.")
    ] = None,
    max_seconds: Annotated[
        float | None, typer.Option(help="Limit of wall-clock seconds of a run: 20.")
    ] = None,
    max_work: Annotated[float | None, typer.Option(help="Limit of passes over M of a run.")] = None,
    error_bound: Annotated[
        bool,
        typer.Option("--error-bound", help="Bound the error where the exact answer is not known."),
    ] = False,
    out: Annotated[str | None, typer.Option(help="The file of raw results: study.csv.")] = None,
    save: Annotated[
        list[str] | None,
        typer.Option(
            help="VIEW=FILE: iterations, work, seconds, residual, error, radius, results, profile, "
            "profile-seconds, curves, curves-work or curves-seconds, as .tex, .md, .csv, .pdf, .svg or .png."
        ),
    ] = None,
) -> bool:
    """Measure methods on families of problems, resumably, into one CSV; save tables and figures of it."""
    from . import solving
    from . import study as measured

    methods: Any = algorithm
    if option:
        if len(algorithm or []) != 1:
            raise InvalidOption(
                "--option is for one --algorithm; with several write a study file, [methods]"
            )
        methods = [((algorithm or [])[0], solving.options(None, option))]
    return measured.run(
        [*(targets or []), *(problem or [])],
        {
            "methods": methods,
            "sizes": measured.sizes_of(size or []),
            "repeats": repeats,
            "tolerance": tolerance,
            "max_seconds": max_seconds,
            "max_work": max_work,
            "error_bound": error_bound,
            "out": out,
            "save": save,
        },
    )


@command(
    "report",
    "0 complete, 1 interrupted (the page holds what there is), 2 bad input",
    "report --out report --quick",
    "report half_active:n=2500 own.npz --out mine",
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
    """Write one page on error against time; after Ctrl-C of what there is."""
    from ..evidence.drawing import require_matplotlib
    from ..evidence.report.page import collect, plan, require_jinja, write_report
    from ..gallery import Scene
    from .target import lcp_of_file, own_scene, scene_text
    from .terminal import PartsLine

    def scene_of_file(path: str) -> Scene:
        problem = lcp_of_file(path, "lcp-plugin report")
        return Scene(
            problem=problem,
            name=path,
            description=f"your own problem, {problem}",
            is_declared=False,
        )

    require_matplotlib()
    require_jinja()
    if out.exists() and not out.is_dir():
        raise UnreadableFile(f"cannot write {out}: it is a file; --out names a folder")
    began = time.perf_counter()
    parts = plan(
        [own_scene(one) or scene_text(one) or scene_of_file(one) for one in scenes or []],
        quick=quick,
    )
    out.mkdir(parents=True, exist_ok=True)
    collected = collect(parts, None, PartsLine())
    page = write_report(collected, out, is_quick=quick)
    took = f"{time.perf_counter() - began:.0f} s"
    if collected.is_complete:
        typer.echo(f"{page}: {len(parts)} parts, {took}")
    else:
        kept = f"{len(parts) - len(collected.missing)} of {len(parts)} parts"
        typer.echo(f"interrupted after {took}: {page} holds {kept}")
    return collected.is_complete


@command("list", "0 done", "list")
def list_everything() -> None:
    """List kinds of problems with the ways that take them, algorithms and engines with what they need, scenes."""
    from .target import print_everything

    print_everything()


@command("warm-up", "0 done", "warm-up")
def warm_up() -> None:
    """Compile every kernel now, so that no later run has to; say where the compiled code lies."""
    from .compiling import compile_everything

    typer.echo(compile_everything())


if __name__ == "__main__":
    run()
