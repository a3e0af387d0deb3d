"""The application that commands register in, and what they share: arguments, and how failures are reported."""

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
from .target import algorithm_names, scene_names
from .terminal import LINE

EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2


def _ending(exit_codes: str, *examples: str) -> str:
    """Return what stands below a help page."""
    return "\n".join(
        [
            "Examples:",
            *(f"  lcp-plugin {words}" for words in examples),
            "",
            f"Exit codes: {exit_codes}.",
        ]
    )


app = typer.Typer(
    help="Linear complementarity problems: find z with lower ≤ z ≤ upper and w = M z + q complementary.",
    epilog=_ending(
        "0 done, 1 ran but not solved (or: answers differ or cannot be compared, a count differs, interrupted), "
        "2 bad input (reported on stderr). "
        "Ctrl-C ends solve and report with what there is so far (1), the others as the shell expects (130)",
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
        help="A file (.npz or .mat with M and q, .nl), a folder with M.mtx and q.mtx, a scene: name:key=value,…, or "
        "file.py:function.",
        autocompletion=scene_names,
    ),
]
AnyTarget = Annotated[
    str,
    typer.Argument(
        help="A file, a folder with M.mtx and q.mtx, a scene: name:key=value,…, or file.py:function. A file is an .npz "
        "or .mat with M, q (an LCP), with P, q, A, l, u or the like (a program: `certify --help`), with A, b "
        "(least squares), with W, q, mu (contacts with friction), an .nl, .qps, .mps, or an .h5 of fclib.",
        autocompletion=scene_names,
    ),
]
AlgorithmName = Annotated[
    str,
    typer.Option(
        "--algorithm",
        "-a",
        help="A name that `lcp-plugin list` shows, auto, or file.py:Class.",
        autocompletion=algorithm_names,
    ),
]


def command(name: str, exit_codes: str, *examples: str) -> Callable[[F], F]:
    """Register a command: False means exit code 1, and every expected failure is one line on stderr and code 2."""

    def registered(body: F) -> F:
        @functools.wraps(body)
        def wrapped(*args: Any, **kwargs: Any) -> None:
            try:
                with LINE:
                    is_done = body(*args, **kwargs) is not False
                sys.stdout.flush()  # here a reader that has gone, or a full disk, can still be reported
                if not is_done:
                    raise typer.Exit(EXIT_UNSOLVED)
                return
            except LCPError as error:
                message = str(error)
            except MemoryError as error:
                message = f"not enough memory ({error}); choose a smaller problem"
            except BrokenPipeError:  # the reader has gone; nothing is left to tell
                _drop_output()
                raise typer.Exit(EXIT_UNSOLVED) from None
            except OSError as error:
                _drop_output()
                message = (
                    f"cannot write {error.filename or 'the output'}: {error.strerror or error}"
                )
            except typer.Exit:
                raise
            except Exception as error:
                from ..evidence.contestants import error_line, own_frame

                if own_frame(error) is None:  # a mistake of ours
                    raise
                message = error_line(error)
            typer.echo(f"lcp-plugin: {message}", err=True)
            raise typer.Exit(EXIT_BAD_INPUT)

        app.command(name, epilog=_ending(exit_codes, *examples))(wrapped)
        return body

    return registered


def _drop_output() -> None:
    """Let go of what stdout could not write: Python would try once more at its end, and exit with 120."""
    with suppress(OSError), Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
