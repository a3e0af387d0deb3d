"""What `lcp-plugin certify` does: a program from a file, solvers, and a table of what is proved."""

from __future__ import annotations

import json

import typer

from ..conversions.program_files import load_program
from ..errors import InvalidOption
from ..evidence.convex_solvers import HEAD, JudgedAnswer, judged_answers


def run(path: str, solvers: str, tolerance: float | None, max_seconds: float | None, *, as_json: bool) -> bool:
    """Print one line a solver; return whether every answer is proved."""
    names = list(dict.fromkeys(name.strip() for name in solvers.split(",") if name.strip()))
    if not names:
        raise InvalidOption("--solver wants at least one name, as --solver CLARABEL,OSQP")
    program, offset = load_program(path)
    answers: list[JudgedAnswer] = []
    for answer in judged_answers(program, names, tolerance=tolerance, max_seconds=max_seconds):
        if not as_json:
            head = "" if answers else f"{path}: {program!r}\n{HEAD}\n"
            typer.echo(f"{head}{answer}")
        answers.append(answer)
    if as_json:
        content = [answer.to_content() for answer in answers]
        typer.echo(json.dumps({"file": path, "offset": offset, "answers": content}, indent=2))
    return all(answer.certification is not None and answer.certification.verdict == "proved" for answer in answers)
