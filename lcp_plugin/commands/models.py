"""What `lcp-plugin solve` does with a file that states another problem than an LCP, or states it in AMPL's terms."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ..core.errors import InvalidOption
from ..core.lcp import LCP
from ..core.settings import Settings, Status
from ..doors.files.program_files import kind_in, load_least_squares, load_program
from ..problems.programs.program import QuadraticProgram
from .solving import OneProcess
from .terminal import LINE, show_search, show_step

SHOWN = 20  # variables that a person is told at once


@dataclass(frozen=True, eq=False)
class ModelAnswer:
    """An answer in the terms of the file.

    Attributes
    ----------
    model : str
        What the file states, in a line.
    status : Status
    message : tuple of str
        What is said of the answer in the file's terms.
    names : sequence of str
        Of the variables.
    vectors : dict
        What is saved; x, if there is one.
    result : Answer
        What `solve` has returned.
    more : dict
        What --json prints beside it.
    """

    model: str
    status: Status
    message: tuple[str, ...]
    names: Sequence[str]
    vectors: dict[str, Any]
    result: Any
    more: dict[str, Any]


def is_model(target: str) -> bool:
    """Return whether the target is a file whose answer is not told as that of an LCP."""
    path = target.strip()
    return Path(path).suffix.lower() == ".nl" or kind_in(path) is not LCP


def run(
    target: str, size: int | None, backend: str, algorithm: Any, options: dict[str, Any], settings: dict[str, Any],
    plot: Path | None, grid: tuple[int, ...] | None, out: Path | None, *, as_json: bool,
) -> bool:
    """Solve, print and save; return whether it is solved."""
    from ..core.policy.choice import policy_for

    for name, is_given, whose in (("--size", size is not None, "a scene"), ("--backend", backend != "serial", "LCPs")):
        if is_given:
            raise InvalidOption(f"{name} is for {whose}, not for this file; leave it out")
    Settings(**settings)
    plain = {one.name: one.default for one in fields(Settings)}
    asked = {name: value for name, value in settings.items() if value != plain[name] or name == "tolerance"}
    chosen = policy_for(algorithm, options).chosen
    OneProcess().check_outputs(target, plot, out)
    find = _in_nl if Path(target.strip()).suffix.lower() == ".nl" else _in_arrays
    found = find(target.strip(), chosen, asked)
    LINE.say("")
    content = {"status": found.status.name, **found.more, "model": found.model, "run": found.result.to_content()}
    typer.echo(json.dumps(content, indent=2) if as_json else _story(target, found))
    saved: list[Path] = []
    if plot is not None:
        from ..evidence.plots import save_plot

        save_plot(found.result, plot, grid)
        saved.append(plot)
    if out is not None:
        _save(found, out)
        saved.append(out)
    if saved:
        typer.echo(f"saved {', '.join(map(str, saved))}", err=as_json)
    return found.status is Status.SOLVED


def _in_nl(target: str, chosen: Any, asked: dict[str, Any]) -> ModelAnswer:
    """Return the answer to AMPL's file."""
    from ..doors.nl import read_nl
    from ..problems.equilibria.equilibrium_program import EquilibriumProgram

    model = read_nl(target)
    show = show_search if isinstance(model.problem, EquilibriumProgram) else show_step
    answer = model.solve(chosen, callback=show if LINE.is_there else None, **asked)
    vectors: dict[str, Any] = {} if answer.x is None else {"x": answer.x, "duals": answer.duals}
    vectors["names"] = np.array(model.names(), dtype=np.str_)
    if model.content.row_names is not None:
        vectors["row_names"] = np.array(model.content.row_names, dtype=np.str_)
    more = {"code": answer.code, "message": answer.message, "objective": answer.objective}
    return ModelAnswer(repr(model), answer.status, (answer.message,), model.names(), vectors, answer.result, more)


def _in_arrays(target: str, chosen: Any, asked: dict[str, Any]) -> ModelAnswer:
    """Return the answer to a program, or to a least squares problem."""
    from ..core.solving.driver import solve

    problem: Any
    if kind_in(target) is QuadraticProgram:
        problem, constant, sign, names = load_program(target)
        seen = {"callback": show_step} if LINE.is_there else {}
        answer: Any = solve(problem, chosen, **asked, **seen)
        rows = {} if problem.ranges is None else {"y": answer.solution.row_multipliers}
        vectors = answer.duals | rows | ({} if names is None else {"names": np.array(names, dtype=np.str_)})
    else:
        problem, constant, sign, names = load_least_squares(target), 0.0, 1.0, None
        answer = solve(problem, chosen, **asked)
        vectors = {"active_mask": answer.active_mask}
    objective = None if answer.objective is None else sign * (answer.objective + constant) + 0.0
    return ModelAnswer(
        str(problem), answer.status,
        () if objective in (None, answer.objective) else (f"objective {objective:.9g}, as the file states it",),
        [f"x[{k}]" for k in range(answer.x.size)] if names is None else names,
        {"x": answer.x} | vectors, answer, {"objective": objective},
    )


def _story(target: str, found: ModelAnswer) -> str:
    """Return what a person wants to read after a run."""
    lines = [f"{target}: {found.model}", *found.message, found.result.explain()]
    if found.result.is_refuted or "x" not in found.vectors:
        return "\n".join(lines)
    width, left = max(map(len, found.names[:SHOWN]), default=0), len(found.names) - SHOWN
    values = zip(found.names[:SHOWN], found.vectors["x"][:SHOWN], strict=True)
    lines += [f"{name:<{width}}  {value:.9g}" for name, value in values]
    return "\n".join(lines + ([f"and {left} more variables; --out saves them"] if left > 0 else []))


def _save(found: ModelAnswer, out: Path) -> None:
    """Write x, the multipliers and the status into an .npz file, with the names of the variables where it has some."""
    from ..doors.files.files import write_whole

    status = np.array(found.status.name)
    write_whole({out: lambda file: np.savez_compressed(file, status=status, **found.vectors)})
