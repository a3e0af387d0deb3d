"""lcp-plugin-ampl: reads stub.nl and writes stub.sol, the way AMPL, Pyomo and JuMP call a solver.

Nothing is imported before it is needed: a modelling language calls this once a solve, and asks for the version often.
"""

from __future__ import annotations

import os
import platform
import re
import sys
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..core.errors import InvalidOption, LCPError, UnknownAlgorithm, did_you_mean

if TYPE_CHECKING:
    from ..interfaces.nl.content import NLContent

NAME = "lcp-plugin-ampl"
VARIABLE = "lcp_plugin_options"
EXIT_UNSOLVED, EXIT_BAD_INPUT, EXIT_INTERRUPTED = 1, 2, 130
FAILURE, INTERRUPTED = 500, 402
WRITE, SHOW_VALUES, SHOW_DUALS, NO_MESSAGE = 1, 2, 4, 8  # bits of wantsol

OF_SOLVE = {
    "absolute_tolerance": (
        float,
        "residual in the unit of the variables that is small enough in any case (0) *",
    ),
    "algorithm": (str, "a name that lcp-plugin list shows (auto) *"),
    "max_iterations": (int, "limit of iterations (100000), or of nodes (none)"),
    "max_seconds": (float, "limit of wall-clock seconds (none)"),
    "prove": (
        int,
        "1 asks for a proof of the gap, of an objective beside complementarities alone (0)",
    ),
    "threads": (int, "how many threads it may use (all)"),
    "tolerance": (float, "solved means a residual of at most this (1e-8), or such a gap (1e-6)"),
}
OF_COMMAND = {
    "outlev": (int, "1 prints the run (0)"),
    "timing": (int, "1 adds the seconds of reading, solving and writing to the message (0)"),
    "version": (int, "1 adds the version line to the output (0)"),
    "wantsol": (
        int,
        "without -AMPL, the sum of: 1 write .sol, 2 print values, 4 print duals, 8 no message (0)",
    ),
}
KEYWORDS: dict[str, tuple[Any, str]] = dict(sorted((OF_SOLVE | OF_COMMAND).items()))
MARK = "* not where an objective stands beside complementarities, whose nodes and gap are SCIP's or our own"
OPTIONS = {
    "--": "end of options",
    "-=": "show the keywords of assignments",
    "-?": "show usage",
    "-o FILE": "write .sol to FILE",
    "-s": "write .sol (without -AMPL)",
    "-v": "just show the version",
}
ASSIGNMENT = re.compile(r"\s*([^\s=]+)(?:\s*=\s*|\s+|$)(\"[^\"]*\"|'[^']*'|[^\s=]*)")


@dataclass
class Call:
    """What the command line and the environment ask for."""

    stub: str = ""
    is_ampl: bool = False
    out: str = ""
    asked: dict[str, Any] = field(default_factory=dict)

    def of_command(self, name: str) -> int:
        """Return the value of a keyword that the solver does not know."""
        return int(self.asked.get(name, 0))

    @property
    def settings(self) -> dict[str, Any]:
        """What the solver is called with."""
        own = {
            name: value
            for name, value in self.asked.items()
            if name in OF_SOLVE and name != "prove"
        }
        own |= {"prove": True} if self.of_command("prove") else {}
        return own | ({"verbose": True} if self.of_command("outlev") else {})

    @property
    def writes(self) -> bool:
        """Whether there is to be a .sol file."""
        return self.is_ampl or bool(self.out) or bool(self.of_command("wantsol") & WRITE)


def run() -> None:
    """Entry point of the command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(
                errors="replace"
            )  # a terminal without Unicode shows '?', not a traceback
    sys.exit(main(sys.argv[1:], os.environ.get(VARIABLE, "")))


def main(words: list[str], environment: str = "") -> int:
    """Do what the words say and return the exit code; failures are one line on stderr.

    Parameters
    ----------
    words : list of str
        Of the command line.
    environment : str
        Assignments that those of the command line replace.
    """
    try:
        if (information := _information(words)) is not None:
            print(information)
            return 0
        return _solve(_call(words, environment))
    except LCPError as error:
        message = str(error)
    except MemoryError as error:
        message = f"not enough memory ({error})"
    except KeyboardInterrupt:
        print(f"{NAME}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader has gone; nothing is left to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_UNSOLVED
    print(f"{NAME}: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT


def _information(words: list[str]) -> str | None:
    """Return what a call asks for instead of a solution, or None."""
    first = next(
        (word for word in words if word in ("-=", "-?", "-h", "--help", "-v", "--version")), ""
    )
    if first == "-=":
        width = max(map(len, KEYWORDS)) + 2
        return "\n".join(
            [*(f"{name:<{width}}{what}" for name, (_, what) in KEYWORDS.items()), MARK]
        )
    if first in ("-v", "--version"):
        return _version()
    if first or not words:
        options = "\n".join(f"\t{name:<9}{{{what}}}" for name, what in OPTIONS.items())
        return (
            f"usage: {NAME} [options] stub [-AMPL] [<assignment> ...]\n\n"
            "Solves complementarity problems and convex quadratic programs in stub.nl, and finds the best solution of\n"
            "the former where both are given. Assignments are key=value, on the command line or in the environment\n"
            f"variable {VARIABLE}.\n\nOptions:\n{options}"
        )
    return None


def _version() -> str:
    return f"lcp_plugin {__version__} ({platform.system()} {platform.machine()})"


def _call(words: list[str], environment: str) -> Call:
    """Return what the words ask for: options, the stub, -AMPL, assignments."""
    call = Call()
    rest = list(words)
    wants_sol = False
    while rest and rest[0].startswith("-") and rest[0] != "-AMPL":
        option = rest.pop(0)
        if option == "--":
            break
        if option == "-s":
            wants_sol = True
        elif option == "-o" and rest:
            call.out = rest.pop(0)
        elif option != "-e":  # echoing, which never happens here
            raise InvalidOption(
                f"{option} is no option{did_you_mean(option, [name.split()[0] for name in OPTIONS])}"
            )
    if not rest or "=" in rest[0] or rest[0] == "-AMPL":
        raise InvalidOption(f"no stub is given; call {NAME} stub -AMPL, where stub.nl is the model")
    call.stub = rest.pop(0)
    call.is_ampl = bool(rest) and rest[0].startswith("-AMPL")
    call.asked = _assigned(environment, f" in {VARIABLE}") | _assigned(
        " ".join(rest[call.is_ampl :]), ""
    )
    call.asked["wantsol"] = call.of_command("wantsol") | (WRITE if wants_sol else 0)
    return call


def _assigned(text: str, where: str) -> dict[str, Any]:
    """Return the values of keywords, written as key=value or key value."""
    asked: dict[str, Any] = {}
    text, position = text.strip(), 0
    while position < len(text):
        match = ASSIGNMENT.match(text, position)
        if match is None:
            raise InvalidOption(f"key=value is needed, got {text[position:]!r}{where}")
        name, value, position = match[1].lower(), match[2].strip("\"'"), match.end()
        if name not in KEYWORDS:
            raise InvalidOption(f"unknown keyword {name!r}{where}{did_you_mean(name, KEYWORDS)}")
        kind, what = KEYWORDS[name]
        try:
            asked[name] = kind(value) if value else {"version": 1}[name]
        except (KeyError, ValueError):
            needed = {float: "a number", int: "a whole number", str: "a name"}[kind]
            raise InvalidOption(
                f"{name} needs {needed}, got {value!r}{where}; it is: {what}"
            ) from None
    return asked


def _solve(call: Call) -> int:
    """Solve the stub, and write, print or both."""
    from ..core.settings import Settings

    of_run = {
        name: value for name, value in call.settings.items() if name not in ("algorithm", "prove")
    }
    Settings(**of_run)  # before anything is read
    from ..interfaces.nl.reading import read_content, source_of

    began = time.perf_counter()
    content = read_content(call.stub)
    read = time.perf_counter() - began
    message, x, y, code = _answer(content, call)
    if call.of_command("timing"):
        message += (
            f"\nreading {read:.2f} s, model and solution {time.perf_counter() - began - read:.2f} s"
        )
    if call.of_command("version"):
        print(_version())
    if call.writes:
        from ..interfaces.nl.solution import write_sol

        target = Path(call.out) if call.out else source_of(call.stub).with_suffix(".sol")
        write_sol(
            target,
            message,
            x,
            y,
            content.options,
            code,
            tolerance=content.tolerance,
            sizes=(content.row_lower.size, content.lower.size),
        )
    if not call.is_ampl:
        _print(content, call.of_command("wantsol"), message, x, y)
    if sys.stdout is not None:  # it may not be open
        sys.stdout.flush()
    return EXIT_UNSOLVED if code and not call.writes else 0


def _answer(content: NLContent, call: Call) -> tuple[str, Any, Any, int]:
    """Return message, values, duals and code; a model that is refused is answered by its refusal."""
    from ..interfaces.nl.model import model_of

    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("default", UserWarning)
            answer = model_of(content).solve(**call.settings)
    except (LCPError, MemoryError) as error:
        if isinstance(error, (InvalidOption, UnknownAlgorithm)) and not call.writes:
            raise  # of the caller, not of the model
        return f"lcp_plugin {__version__}: failure: {error}", None, None, FAILURE
    except KeyboardInterrupt:
        return (
            f"lcp_plugin {__version__}: interrupted before there was an answer",
            None,
            None,
            INTERRUPTED,
        )
    proof = answer.result.proof
    has_words = proof is not None and proof is not answer.result  # which proves itself
    advice = [] if answer.is_solved else [str(proof) if has_words else answer.result.advice]
    message = "\n".join([answer.message, *advice, *(f"warning: {one.message}" for one in warned)])
    return message, answer.x, answer.duals, answer.code


def _print(content: NLContent, wantsol: int, message: str, x: Any, y: Any) -> None:
    """Print for a person what AMPL would otherwise show."""
    if not wantsol & NO_MESSAGE:
        print(message)
    for bit, values, names, letter, what in (
        (SHOW_VALUES, x, content.names, "x", "value"),
        (SHOW_DUALS, y, content.row_names, "c", "dual value"),
    ):
        if wantsol & bit and values is not None:
            labels = names or [f"{letter}{k}" for k in range(len(values))]
            width = max([8, *map(len, labels)]) + 2
            print(f"\n{'':<{width}}{what}")
            print(
                "\n".join(
                    f"{label:<{width}}{value:.10g}"
                    for label, value in zip(labels, values, strict=True)
                )
            )
