"""The application that commands register in: arguments they share, and how failures are reported."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from ..core.errors import LCPError

EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2


def scene_names(incomplete: str) -> list[str]:
    """Return the scenes that begin so; the shell completes files."""
    from .. import gallery

    return [name for name in gallery.names() if name.startswith(incomplete)]


def algorithm_names(incomplete: str) -> list[str]:
    """Return the algorithms that begin so."""
    from ..algorithms import REGISTRY
    from ..engines import ENGINES

    return [name for name in ("auto", *REGISTRY, *ENGINES) if name.startswith(incomplete)]


def _ending(exit_codes: str, *examples: str) -> str:
    """Return the text below a help page."""
    lines = [f"  lcp-plugin {words}" for words in examples]
    return "\n".join(["Examples:", *lines, "", f"Exit codes: {exit_codes}."])


app = typer.Typer(
    help="Linear complementarity problems: find z with lower ≤ z ≤ upper and w = M z + q complementary.",
    epilog=_ending(
        "0 done, 1 ran but not solved (or: solutions differ or cannot be compared), 2 bad input (reported on stderr). "
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
        help="A file, a folder with M.mtx and q.mtx, or a test problem: name:key=value,…. A file is an .npz or .mat "
        "with M, q (an LCP), with P, q, A, l, u or the like (a program), with A, b (least squares), with W, q, mu "
        "(contacts with friction), an .nl, .qps, .mps, .lp, or an .h5 of fclib.",
        autocompletion=scene_names,
    ),
]
AlgorithmName = Annotated[
    str,
    typer.Option(
        "--algorithm",
        "-a",
        help="A name that `lcp-plugin list` shows, or auto.",
        autocompletion=algorithm_names,
    ),
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
                _drop_output()
                raise typer.Exit(EXIT_UNSOLVED) from None
            except OSError as error:
                _drop_output()
                message = (
                    f"cannot write {error.filename or 'the output'}: {error.strerror or error}"
                )
            typer.echo(f"lcp-plugin: {message}", err=True)
            raise typer.Exit(EXIT_BAD_INPUT)

        app.command(name, epilog=_ending(exit_codes, *examples))(wrapped)
        return body

    return registered


def _drop_output() -> None:
    """Discard the output that stdout could not write: Python would try again at its end, and exit with 120."""
    with suppress(OSError), Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
