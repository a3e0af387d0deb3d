"""lcp-plugin: read a problem, call one function of the package, print its report; failures are one line and code 2."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

try:
    import typer
except ImportError as error:
    raise ImportError("the command needs typer; install it with: pip install typer rich") from error

import lcp_plugin

from .. import __version__
from ..core.errors import LCPError
from . import ampl

__all__ = ["app", "run"]

EXIT_UNSOLVED = 1  # exit code of a run without a solution


def _ending(exit_codes: str, *examples: str) -> str:
    """Return the text below a help page."""
    lines = [f"  lcp-plugin {words}" for words in examples]
    return "\n".join(["Examples:", *lines, "", f"Exit codes: {exit_codes}."])


app = typer.Typer(
    help="Linear complementarity problems: find z with lower ≤ z ≤ upper and w = M z + q complementary.",
    epilog=_ending(
        "0 done, 1 ran but not solved, 2 bad input (reported on stderr). "
        "Ctrl-C ends solve and compare with the results so far (1), the others as the shell expects (130)",
        "solve obstacle_2d --plot obstacle.png",
        "solve --help",
        "list",
    ),
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
F = TypeVar("F", bound=Callable[..., Any])

Target = Annotated[
    str,
    typer.Argument(
        help="A file, or a test problem: name:key=value,…. A file is an .npz "
        "with M, q (an LCP), with P, q, A, l, u or the like (a program), with A, b (least squares), with W, q, mu "
        "(contacts with friction), an .nl, .qps, .mps, .lp, .mtx (M, with q.mtx next to it), or an .h5 of fclib."
    ),
]
AlgorithmName = Annotated[
    str, typer.Option("--algorithm", "-a", help="A name that `lcp-plugin list` shows, or auto.")
]


def command(name: str, exit_codes: str, *examples: str) -> Callable[[F], F]:
    """Register a command: False means exit code 1, and every expected failure is one line on stderr and code 2."""

    def registered(body: F) -> F:
        @functools.wraps(body)
        def wrapped(*args: Any, **kwargs: Any) -> None:
            try:
                is_done = body(*args, **kwargs) is not False
                sys.stdout.flush()  # a reader that has gone, or a full disk, is still reported here
                if not is_done:
                    raise typer.Exit(EXIT_UNSOLVED)
                return
            except LCPError as error:
                message = str(error)
            except MemoryError as error:
                message = f"not enough memory ({error}); choose a smaller problem"
            except BrokenPipeError:
                ampl.drop_output()
                raise typer.Exit(EXIT_UNSOLVED) from None
            except OSError as error:
                ampl.drop_output()
                message = f"cannot write {error.filename or 'output'}: {error.strerror or error}"
            typer.echo(f"lcp-plugin: {message}", err=True)
            raise typer.Exit(ampl.EXIT_BAD_INPUT)

        app.command(name, epilog=_ending(exit_codes, *examples))(wrapped)
        return body

    return registered


# --- The commands ---------------------------------------------------------------------------------------------


def run() -> None:
    """Entry point of the command; called as AMPL calls a solver, it is ``lcp-plugin-ampl``."""
    if "-AMPL" in sys.argv:
        ampl.run()
    ampl.replace_unknown_letters()
    app()


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
        raise typer.Exit(ampl.EXIT_BAD_INPUT)


Tolerance = Annotated[
    float | None,
    typer.Option(help="Relative tolerance: 1e-8 by default; 1e-6 (gap) for a program."),
]
MaxSeconds = Annotated[float | None, typer.Option(help="Limit of wall-clock seconds.")]


@command(
    "solve",
    "0 solved, 1 ran but not solved, 2 bad input",
    "solve obstacle_2d:size=200 --plot out.png",
    "solve problem.npz -a psor -o relaxation=1.5 --out answer.npz",
    "solve problem.nl --json",
    "solve program.qps --out answer.npz",
    "solve model.nl",
)
def solve(
    target: Target,
    algorithm: AlgorithmName = "auto",
    option: Annotated[
        list[str] | None,
        typer.Option("--option", "-o", help="An option of the algorithm: name=value."),
    ] = None,
    tolerance: Tolerance = None,
    absolute_tolerance: Annotated[
        float | None, typer.Option(help="A residual in the unit of z that is small enough.")
    ] = None,
    max_iterations: Annotated[int | None, typer.Option(help="Limit of iterations.")] = None,
    max_seconds: MaxSeconds = None,
    prove_infeasibility: Annotated[
        bool | None, typer.Option(help="Search for a proof that no solution exists.")
    ] = None,
    threads: Annotated[
        int | None, typer.Option(help="Number of threads; BLAS's: OMP_NUM_THREADS.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Save a picture (.png, .pdf, .svg).")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Save z and w, or x and its multipliers: an .npz file.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> bool:
    """Solve a problem of any class; print status, residuals and counts, and the first values."""
    from . import solving

    settings = _given(
        tolerance=tolerance,
        absolute_tolerance=absolute_tolerance,
        max_iterations=max_iterations,
        max_seconds=max_seconds,
        prove_infeasibility=prove_infeasibility,
        threads=threads,
    )
    options = solving.parsed_options(option or [])
    return solving.solve_target(target, algorithm, options, settings, plot, out, as_json=json)


@command("analyze", "0 done, 2 bad input", "analyze paper_example_1")
def analyze(target: Target) -> None:
    """Print facts about a problem and the plan of auto; of an LCP also which algorithms are proved to converge."""
    from .reports import analysis
    from .solving import read_target

    problem = read_target(target).problem
    typer.echo(analysis(getattr(problem, "problem", problem)))  # of an .nl file


@command(
    "compare",
    "0 complete, 1 interrupted, 2 bad input",
    "compare obstacle_2d -a npsor -a psor -a multigrid --plot curves.pdf",
    "compare problem.npz --reference CLARABEL",
)
def compare(
    target: Target,
    algorithm: Annotated[
        list[str] | None,
        typer.Option(
            "--algorithm", "-a", help="A name that `lcp-plugin list` shows; again for another."
        ),
    ] = None,
    reference: Annotated[
        list[str] | None, typer.Option(help="A convex solver of cvxpy; again for another.")
    ] = None,
    repeats: Annotated[int, typer.Option(help="Runs per median of seconds.")] = 3,
    tolerance: Tolerance = None,
    max_seconds: MaxSeconds = None,
    plot: Annotated[Path | None, typer.Option(help="Save the curves (.png, .pdf, .svg).")] = None,
) -> bool:
    """Measure error against run time of several algorithms on one problem."""
    from .solving import check_outputs, read_lcp

    check_outputs(target, plot)
    source = read_lcp(target, "lcp-plugin compare")
    options = _given(tolerance=tolerance, max_seconds=max_seconds, repeats=repeats)
    problem = source.test_problem or source.problem
    study = lcp_plugin.error_against_time(problem, algorithm, reference or (), **options)
    typer.echo(study.explain())
    if plot is not None:
        study.save(plot)
        typer.echo(f"saved {plot}")
    return study.is_complete


@command("list", "0 done", "list")
def list_names() -> None:
    """List algorithms and external solvers with their requirements, and test problems."""
    from .reports import print_names

    print_names()


@command("warm-up", "0 done", "warm-up")
def warm_up() -> None:
    """Compile every kernel now, so that later runs start at once; print the time it took."""
    from .solving import compile_everything

    typer.echo(compile_everything())


def _given(**settings: Any) -> dict[str, Any]:
    """Return the settings that are not None."""
    return {name: value for name, value in settings.items() if value is not None}


if __name__ == "__main__":
    run()
