"""lcp-plugin-ampl: reads stub.nl and writes stub.sol, the way AMPL, Pyomo and JuMP call a solver.

A modeling language requests the version often, so nothing is imported before it is needed.
"""

from __future__ import annotations

import os
import platform
import re
import shlex
import sys
import warnings
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..core.deadline import Clock
from ..core.errors import InvalidOption, LCPError, did_you_mean
from ..core.settings import Settings, parse_options, whole_number

if TYPE_CHECKING:
    from ..interfaces.nl.reading import NLContent

TOOL = "lcp-plugin-ampl"
OPTIONS_VARIABLE = "lcp_plugin_options"
EXIT_BAD_INPUT, EXIT_INTERRUPTED = 2, 130  # a wrong file or option, as in typer; Ctrl-C
FAILURE, INTERRUPTED = 500, 402
KEYWORDS = {
    "absolute_tolerance": "residual that is small enough, in the unit of the variables (0) *",
    "algorithm": "a name that lcp-plugin list shows (auto) *",
    "max_iterations": "limit of iterations (100000), or of nodes (none)",
    "max_seconds": "limit of wall-clock seconds (none)",
    "outlev": "1 prints the run (0)",
    "prove": "1 requests a proof of the gap, if an objective comes with complementarity conditions (0)",
    "threads": "number of threads (all)",
    "timing": "1 adds the seconds of the solve to the message (0)",
    "tolerance": "solved means a residual of at most this (1e-8), or such a gap (1e-6)",
    "version": "prints the version",
    "wantsol": "without -AMPL: 8 prints no message; stub.sol is always written, and 2 and 4 are ignored (1)",
}
LEVELS = ("outlev", "prove", "timing", "version", "wantsol")
MARK = "* not for an objective next to complementarities, whose nodes and gap are SCIP's or our own"
USAGE = f"""usage: {TOOL} stub [-AMPL] [<keyword>=<value> or <keyword> <value> ...]

Reads the model stub.nl and writes stub.sol; without -AMPL the message is printed as well. Assignments are on the
command line or in the environment variable {OPTIONS_VARIABLE}. -v prints the version, -= the keywords. Values of the
variables: lcp-plugin solve stub.nl"""


def run() -> None:
    """Entry point of the command."""
    replace_unknown_letters()
    sys.exit(main(sys.argv[1:], os.environ.get(OPTIONS_VARIABLE, "")))


def replace_unknown_letters() -> None:
    """Print '?' for letters that a terminal without Unicode does not have."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def drop_output() -> None:
    """Discard the output that stdout could not write: Python would try again at its end, and exit with 120."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(words: list[str], environment: str = "") -> int:
    """Run the requested command and return the exit code; failures are one line on stderr.

    Parameters
    ----------
    words : list of str
        Arguments of the command line.
    environment : str
        Assignments; assignments on the command line replace them.
    """
    try:
        if (information := _information(words)) is not None:
            print(information)
            return 0
        return _solve_stub(words, environment)
    except LCPError as error:
        message = str(error)
    except MemoryError as error:
        message = f"not enough memory ({error})"
    except KeyboardInterrupt:
        print(f"{TOOL}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of the message has gone
        drop_output()
        return 0
    print(f"{TOOL}: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT


def _information(words: list[str]) -> str | None:
    """Return the text that a call requests instead of a solution, or None."""
    if "-=" in words:
        width = max(map(len, KEYWORDS)) + 2
        return "\n".join([*(f"{key:<{width}}{what}" for key, what in KEYWORDS.items()), MARK])
    if {"-v", "--version"} & {*words}:
        return f"lcp_plugin {__version__} ({platform.system()} {platform.machine()})"
    return USAGE if not words or {"-?", "-h", "--help"} & {*words} else None


def assigned(text: str) -> dict[str, Any]:
    """Return the values of keywords, written as key=value or, as modeling systems also send them, as key value."""
    try:
        words = shlex.split(re.sub(r"\s*=\s*", "=", text))
    except ValueError as error:
        raise InvalidOption(f"{error} in {text!r}; close it") from error
    assignments: list[str] = []
    for word in words:
        if assignments and "=" not in assignments[-1] + word:
            assignments[-1] += f"={word}"
        else:
            assignments.append("version=1" if word == "version" else word)
    values = parse_options(assignments)
    for name in values.keys() - KEYWORDS.keys():
        raise InvalidOption(f"unknown keyword {name!r}{did_you_mean(name, KEYWORDS)}")
    return values


def _solve_stub(words: list[str], environment: str) -> int:
    """Solve the stub and write the .sol file."""
    stub, *arguments = words
    if stub.startswith("-") or "=" in stub:
        raise InvalidOption(f"no stub is given; call {TOOL} stub -AMPL, where stub.nl is the model")
    is_ampl = bool(arguments) and arguments[0] == "-AMPL"
    settings = assigned(environment) | assigned(" ".join(arguments[is_ampl:]))
    levels = {k: whole_number(settings.pop(k, 0), k, 0, f", {KEYWORDS[k]}") for k in LEVELS}
    switches = {"verbose": levels["outlev"], "prove": levels["prove"]}
    settings |= {name: True for name, level in switches.items() if level}
    if levels["version"]:
        print(_information(["-v"]))
    Settings(**{key: settings[key] for key in settings.keys() - {"algorithm", "prove"}})
    from ..interfaces.nl.reading import read_content, source_of
    from ..interfaces.nl.writing import write_sol

    content = read_content(stub)
    clock = Clock()
    message, x, y, code = _answer(content, settings)
    if levels["timing"]:
        message += f"\n{clock.read():.3g} s"
    write_sol(source_of(stub).with_suffix(".sol"), content, message, x, y, code)
    if not (is_ampl or levels["wantsol"] & 8):
        print(message)
    return 0


def _answer(content: NLContent, settings: dict[str, Any]) -> tuple[str, Any, Any, int]:
    """Return message, values, duals and code; for a rejected model the message is the error's text."""
    from ..interfaces.nl.model import model_of

    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("default", UserWarning)
            answer = model_of(content).solve(**settings)
    except (LCPError, MemoryError) as error:
        return f"lcp_plugin {__version__}: failure: {error}", None, None, FAILURE
    except KeyboardInterrupt:
        return f"lcp_plugin {__version__}: interrupted, without an answer", None, None, INTERRUPTED
    proof = answer.result.proof
    has_words = proof is not None and proof is not answer.result  # which proves itself
    advice = [] if answer.is_solved else [str(proof) if has_words else answer.result.advice]
    advice += [f"warning: {warning.message}" for warning in warned]
    return "\n".join([answer.message, *advice]), answer.x, answer.duals, answer.code
