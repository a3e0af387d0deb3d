"""lcp-plugin: solve a file or a scene, list what there is, compute the paper's tables, run a benchmark."""

from __future__ import annotations

import functools
import json as json_module
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import typer

from . import __version__
from .errors import InvalidOption, LCPError, UnreadableFile, did_you_mean
from .problem import LCP, FloatVector
from .result import Result
from .terminal import RunLine

EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2
OWN_FLAGS = ("tolerance", "measure", "max_iterations", "max_seconds", "algorithm")

app = typer.Typer(
    help="Linear complementarity problems: find z with lower ≤ z ≤ upper and w = M z + q complementary.",
    epilog="Exit codes: 0 done, 1 ran but not solved or a figure differs, 2 bad input.",
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
F = TypeVar("F", bound=Callable[..., Any])


def _scene_names(incomplete: str) -> list[str]:
    from .evidence import gallery

    return [name for name in gallery.names() if name.startswith(incomplete)]  # none of them: the shell tries files


def _algorithm_names(incomplete: str) -> list[str]:
    from .algorithms import REGISTRY

    return [name for name in ("auto", *REGISTRY) if name.startswith(incomplete)]


def _benchmark_names(incomplete: str) -> list[str]:
    from .evidence.benchmarks import BENCHMARKS

    return [name for name in BENCHMARKS if name.startswith(incomplete)]


Target = Annotated[
    str,
    typer.Argument(
        help="A file (.npz), a folder with M.mtx and q.mtx, or a scene: name:key=value,…", autocompletion=_scene_names
    ),
]
AlgorithmName = Annotated[
    str,
    typer.Option(
        "--algorithm", "-a", help="A name that `lcp-plugin list` shows, or auto.", autocompletion=_algorithm_names
    ),
]


def run() -> None:
    """Entry point of the command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal without Unicode shows '?', not a traceback
    app()


def _speaks_plainly(command: F) -> F:
    """Turn every expected failure into one line on stderr and exit code 2."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        except LCPError as error:
            message = str(error)
        except MemoryError as error:
            message = f"not enough memory ({error}); choose a smaller problem"
        except BrokenPipeError:
            sys.stderr.close()  # the reader has gone; nothing is left to tell
            raise typer.Exit(EXIT_UNSOLVED) from None
        except OSError as error:
            message = f"cannot write {error.filename or 'the output'}: {error.strerror or error}"
        typer.echo(f"lcp-plugin: {message}", err=True)
        raise typer.Exit(EXIT_BAD_INPUT)

    return wrapped  # type: ignore[return-value]


@app.callback(invoke_without_command=True)
def main(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Linear complementarity problems: find z with lower ≤ z ≤ upper and w = M z + q complementary."""
    if version:
        typer.echo(f"lcp-plugin {__version__}")
        raise typer.Exit


@app.command(
    epilog="Examples:  lcp-plugin solve obstacle_2d:size=200 --plot out.png   ·   "
    "lcp-plugin solve problem.npz -a psor --relaxation 1.5   ·   lcp-plugin solve folder_with_M_and_q/ --json"
)
@_speaks_plainly
def solve(
    target: Target,
    algorithm: AlgorithmName = "auto",
    relaxation: Annotated[
        str | None, typer.Option(help="Relaxation of the algorithm: a number, or auto for psor.")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-o", help="Any option of the algorithm: name=value.")
    ] = None,
    tolerance: Annotated[float, typer.Option(help="SOLVED means a residual of at most this.")] = 1e-8,
    tolerance_on: Annotated[
        str, typer.Option(help="residual, or error: SOLVED then means a proved relative error.")
    ] = "residual",
    error_bound: Annotated[bool, typer.Option("--error-bound", help="Bound the error of the answer.")] = False,
    measure: Annotated[str, typer.Option(help="relative, or euclidean (the paper's Res).")] = "relative",
    max_iterations: Annotated[int | None, typer.Option(help="Limit of iterations.")] = None,
    max_seconds: Annotated[float | None, typer.Option(help="Limit of wall-clock seconds.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Save a picture (.png, .pdf, .svg).")] = None,
    out: Annotated[Path | None, typer.Option(help="Save z and w (.npz).")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Solve a file or a scene; print status, residuals and counts."""
    _check_outputs(target, plot, out)
    problem, scene = _read_target(target)
    settings = dict(
        algorithm=_chosen(algorithm, _options(relaxation, option or [])), tolerance=tolerance,
        tolerance_on=tolerance_on, error_bound=error_bound, measure=measure, max_iterations=max_iterations,
        max_seconds=max_seconds, record=plot is not None,
    )
    with RunLine() as progress:
        results = _solve_all(problem, scene, settings, progress)
    result = results[-1]
    typer.echo(_json(results) if json else _story(results, scene))
    if out is not None:
        _save_answer(result, out)
    if plot is not None:
        from .evidence.pictures import draw

        draw(result, plot, scene, results)
    for path in filter(None, (plot, out)):
        typer.echo(f"saved {path}", err=json)
    if not result.is_solved:
        raise typer.Exit(EXIT_UNSOLVED)


@app.command(
    epilog="Examples:  lcp-plugin check obstacle_2d:size=30   ·   lcp-plugin check problem.npz --reference clarabel   ·"
    "   Exit code 0: both agree.  1: they do not, or nothing can be compared; the reason is printed."
)
@_speaks_plainly
def check(
    target: Target,
    algorithm: AlgorithmName = "auto",
    reference: Annotated[str, typer.Option(help="The convex solver to compare with, or auto.")] = "auto",
    max_seconds: Annotated[float, typer.Option(help="Limit of wall-clock seconds of each side.")] = 60.0,
) -> None:
    """Compare our answer with that of a convex solver that shares no code with it."""
    from .evidence.cross_check import cross_validate

    problem, _ = _read_target(target)
    outcome = cross_validate(problem, reference=reference, algorithm=algorithm, max_seconds=max_seconds)
    typer.echo(str(outcome))
    if not outcome.agrees:
        raise typer.Exit(EXIT_UNSOLVED)


@app.command(epilog="Examples:  lcp-plugin analyze paper_example_1   ·   lcp-plugin analyze problem.npz --json")
@_speaks_plainly
def analyze(
    target: Target,
    json: Annotated[bool, typer.Option("--json", help="Print both tables as JSON.")] = False,
) -> None:
    """Tell what kind of matrix it is, with evidence, and which algorithms are proved to converge on it."""
    from .analysis_command import content, story

    problem, _ = _read_target(target)
    typer.echo(json_module.dumps(content(problem), indent=2) if json else story(problem))


@app.command("list")
@_speaks_plainly
def list_everything() -> None:
    """List the algorithms with what they need, and the scenes with their parameters."""
    from rich.console import Console
    from rich.table import Table

    from .algorithms import REGISTRY, algorithm_class, from_other_packages
    from .evidence.gallery import describe

    algorithms = Table(title="Algorithms", title_justify="left", show_lines=False)
    for heading in ("name", "needs", "proved to converge on", "an iteration costs", "source"):
        algorithms.add_column(heading)
    foreign = from_other_packages()
    for name, kind in [*((name, algorithm_class(name)) for name in REGISTRY), *foreign.items()]:
        if not isinstance(kind, LCPError):
            facts = (getattr(kind, fact, "–") for fact in ("assumption", "converges_on", "cost", "reference"))
            algorithms.add_row(name, *facts)
    scenes = Table(title="Scenes", title_justify="left")
    for heading in ("name", "what", "parameters"):
        scenes.add_column(heading)
    for name, summary, parameters in describe():
        scenes.add_row(name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(algorithms)
    for error in (one for one in foreign.values() if isinstance(one, LCPError)):
        console.print(f"left out: {error}\n", markup=False, highlight=False)
    console.print(scenes)


@app.command()
@_speaks_plainly
def tables() -> None:
    """Compute the paper's Tables 1 and 2 again; exit code 1 if an iteration count differs."""
    from rich.console import Console
    from rich.table import Table

    from .evidence.paper_tables import cells

    computed = list(cells())
    console = Console(width=None if sys.stdout.isatty() else 120)
    for example in (1, 2):
        table = Table(title=f"Table {example}: Example {example}, δ = 4", title_justify="left")
        for heading in ("algorithm", "n", "paper IT", "IT", "paper Res", "Res", "paper CPU", "CPU", "IT", "Res"):
            table.add_column(heading, justify="left" if heading == "algorithm" else "right")
        for cell in (cell for cell in computed if cell.example == example):
            table.add_row(
                f"{cell.algorithm} {cell.relaxation or ''}", str(cell.n),
                str(cell.paper_iterations), str(cell.iterations),
                f"{cell.paper_residual:.1e}", f"{cell.residual:.2e}",
                f"{cell.paper_seconds:.4f}", f"{cell.seconds:.4f}",
                "yes" if cell.same_iterations else "NO", "yes" if cell.same_residual else "no",
            )
        console.print(table)
    equal = sum(cell.same_iterations for cell in computed)
    equal_residual = sum(cell.same_residual for cell in computed)
    console.print(f"IT equal in {equal} of {len(computed)} cells, Res to the printed digits in {equal_residual}.")
    if equal < len(computed):
        raise typer.Exit(EXIT_UNSOLVED)


@app.command(epilog="Examples:  lcp-plugin bench   ·   lcp-plugin bench sweeps --quick")
@_speaks_plainly
def bench(
    name: Annotated[
        str | None,
        typer.Argument(help="Which benchmark; without a name they are listed.", autocompletion=_benchmark_names),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small sizes: to see that it runs, not for figures.")] = False,
) -> None:
    """Run a benchmark: ratios measured in one run on this machine."""
    from .evidence.benchmarks import BENCHMARKS, load

    if name is None:
        for known, purpose in BENCHMARKS.items():
            typer.echo(f"{known:<16} {purpose}")
        return
    if name not in BENCHMARKS:
        raise InvalidOption(f"unknown benchmark {name!r}{did_you_mean(name, BENCHMARKS)}")
    for line in load(name)(quick=quick):
        typer.echo(line)


@app.command(
    epilog="Examples:  lcp-plugin report --out report --quick   ·   lcp-plugin report half_active:n=2500 --out mine"
)
@_speaks_plainly
def report(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(help="Scenes, name:key=value,…; by default the usual choice.", autocompletion=_scene_names),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for index.html, CSV and JSON; made where it is missing.")
    ] = Path("report"),
    quick: Annotated[bool, typer.Option("--quick", help="Small problems: about a minute.")] = False,
) -> None:
    """Write one page on error against time, stability and the paper's tables; Ctrl-C and go on later."""
    from .report_command import make

    is_complete, story = make(scenes or [], out, quick=quick)
    typer.echo(story)
    if not is_complete:
        raise typer.Exit(EXIT_UNSOLVED)


@app.command("warm-up")
@_speaks_plainly
def warm_up() -> None:
    """Compile every kernel now, so that no later run has to; say where the compiled code lies."""
    from .warm_up_command import warm_up as compile_everything

    typer.echo(compile_everything())


def _check_outputs(target: str, plot: Path | None, out: Path | None) -> None:
    """Refuse before the run what could not be written after it."""
    if plot is not None:
        from .evidence.drawing import check_format, require_matplotlib

        check_format(plot)
        require_matplotlib()
    if out is not None and out.suffix != ".npz":
        raise InvalidOption(f"--out writes a .npz file, got {out.name!r}")
    for path in filter(None, (plot, out)):
        if not path.absolute().parent.is_dir():
            raise UnreadableFile(f"cannot write {path}: the folder {path.parent} does not exist")
        if path.is_dir():
            raise UnreadableFile(f"cannot write {path}: it is a folder")
        if path.exists() and Path(target).exists() and path.samefile(target):
            raise UnreadableFile(f"cannot write {path}: it is the problem itself; choose another name")


def _read_target(target: str) -> tuple[LCP, Any]:
    """Return (problem, None) of a file or (problem, scene) of a scene's name."""
    from .evidence import gallery

    name = target.partition(":")[0]
    if name in gallery.names():
        scene = gallery.parse(target)
        return scene.problem, scene
    looks_like_a_path = "/" in target or "\\" in target or "." in target
    if looks_like_a_path or Path(target).exists() or Path(f"{target}M.mtx").exists():
        return LCP.load(target), None
    raise InvalidOption(f"{target!r} is neither a file nor a scene{did_you_mean(name, gallery.names())}")


def _options(relaxation: str | None, pairs: list[str]) -> dict[str, Any]:
    """Return the options of the algorithm; values are read as numbers, true/false/none, or words."""
    words = {"none": None, "true": True, "false": False}
    options: dict[str, Any] = {}
    if relaxation is not None:
        pairs = [f"relaxation={relaxation}", *pairs]
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key:
            raise InvalidOption(f"--option wants name=value, got {pair!r}")
        if key in OWN_FLAGS:
            raise InvalidOption(f"{key} is no option of an algorithm; write --{key.replace('_', '-')} {text}")
        if key in options:
            raise InvalidOption(f"the option {key} is given twice; once is enough")
        try:
            options[key] = float(text)
        except ValueError:
            options[key] = words.get(text.lower(), text)
    return options


def _chosen(algorithm: str, options: dict[str, Any]) -> Any:
    """Return the algorithm with its options, or "auto"."""
    from .algorithms import create
    from .choice import policy_for

    if algorithm == "auto":
        return policy_for(algorithm, options).name
    return create(algorithm, options)


def _solve_all(problem: LCP, scene: Any, settings: dict[str, Any], progress: RunLine) -> list[Result]:
    """Return the results of all steps of a march, warm-started; of one step otherwise. A failure ends it."""
    from .driver import solve as solve_problem

    results: list[Result] = []
    start = scene.start if scene is not None else None
    for step in range(scene.steps if scene is not None else 1):
        if step:
            start = results[-1].z
            problem = problem.with_q(scene.advance(start))
        results.append(solve_problem(problem, z0=start, callback=progress, **settings))
        if not results[-1].is_solved:
            break
    return results


def _save_answer(result: Result, path: Path) -> None:
    from .problem_files import write_whole

    status = np.array(result.status.name)
    write_whole({path: lambda file: np.savez_compressed(file, z=result.z, w=result.w, status=status)})


def _json(results: list[Result]) -> str:
    """Return the last result as JSON, with the totals of a march."""
    content = results[-1].to_content()
    if len(results) > 1:
        content["march"] = {
            "steps": len(results),
            "iterations": sum(result.iterations for result in results),
            "seconds": sum(result.seconds for result in results),
        }
    return json_module.dumps(content, indent=2)


def _story(results: list[Result], scene: Any) -> str:
    """Return what a person wants to read after a run."""
    result = results[-1]
    problem = result.certificate.problem
    lines = [str(scene) if scene is not None else "", f"{problem!r}", result.explain(), str(result.certificate)]
    if len(results) > 1 or (scene is not None and scene.steps > 1):
        total = sum(one.iterations for one in results)
        seconds = sum(one.seconds for one in results)
        count = f"{len(results)} of {scene.steps} steps, {total} iterations, {seconds:.3g} s"
        lines.insert(2, f"march: {count}; the last step:")
    at_bound = np.count_nonzero((result.z <= problem.lower) | (result.z >= problem.upper))
    lines.append(f"{'at a bound':<18} {at_bound} of {problem.n}")
    if scene is not None and scene.steps == 1:
        for reference, name in ((scene.exact, "true error"), (scene.continuum, "from the continuum")):
            if reference is not None and problem.n:
                lines.append(f"{name:<18} {_distance(result.z, reference):.3e}")
    return "\n".join(filter(None, lines))


def _distance(z: FloatVector, reference: FloatVector) -> float:
    return float(np.max(np.abs(z - reference)))


if __name__ == "__main__":
    run()
