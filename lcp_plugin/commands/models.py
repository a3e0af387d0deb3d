"""What `lcp-plugin solve model.nl` does: AMPL's files state complementarities, equations or programs."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from ..errors import InvalidOption
from ..settings import Settings
from .solving import OneProcess
from .terminal import LINE, show_search, show_step

if TYPE_CHECKING:
    from ..modeling.nl import NLAnswer, NLModel

SHOWN = 20  # variables that a person is told at once


def is_model(target: str) -> bool:
    """Return whether the target is the name of an ``.nl`` file."""
    return Path(target.strip()).suffix.lower() == ".nl"


def run(
    target: str, size: int | None, backend: str, algorithm: str, options: dict[str, Any], settings: dict[str, Any],
    plot: Path | None, out: Path | None, *, as_json: bool,
) -> bool:
    """Solve, print and save; return whether it is solved."""
    from ..conversions.equilibrium_program import EquilibriumProgram
    from ..modeling.nl import read_nl
    from ..policy.choice import policy_for

    others = {"--size": size is not None, "--plot": plot is not None, "--backend": backend != "serial"}
    for name, is_given in others.items():
        if is_given:
            raise InvalidOption(f"{name} is not for models from .nl files; leave it out")
    Settings(**settings)
    plain = {one.name: one.default for one in fields(Settings)}
    asked = {name: value for name, value in settings.items() if value != plain[name]}
    chosen = policy_for(algorithm, options).chosen
    OneProcess().check_outputs(target, None, out)
    model = read_nl(target)
    show = show_search if isinstance(model.problem, EquilibriumProgram) else show_step
    answer = model.solve(chosen, callback=None if as_json else show, **asked)
    LINE.say("")
    typer.echo(json.dumps(_content(model, answer), indent=2) if as_json else _story(target, model, answer))
    if out is not None:
        _save(model, answer, out)
        typer.echo(f"saved {out}", err=as_json)
    return answer.is_solved


def _content(model: NLModel, answer: NLAnswer) -> dict[str, Any]:
    """Return what --json prints."""
    own = {"status": answer.status.name, "code": answer.code, "message": answer.message, "objective": answer.objective}
    return own | {"model": repr(model), "run": answer.result.to_content()}


def _story(target: str, model: NLModel, answer: NLAnswer) -> str:
    """Return what a person wants to read after a run."""
    names = model.names()
    width = max(map(len, names[:SHOWN]), default=0)
    has_more = answer.x is not None and len(names) > SHOWN
    found = [] if answer.x is None else answer.x[:SHOWN].tolist()
    values = [f"{name:<{width}}  {value:.9g}" for name, value in zip(names, found, strict=False)]
    more = [f"and {len(names) - SHOWN} more variables; --out saves them"] if has_more else []
    return "\n".join([f"{target}: {model!r}", answer.message, answer.result.explain(), *values, *more])


def _save(model: NLModel, answer: NLAnswer, out: Path) -> None:
    """Write x and duals, where there are any, with their names into an .npz file."""
    from ..problem.files import write_whole

    content: dict[str, Any] = {"names": np.array(model.names(), dtype=np.str_)}
    if answer.x is not None:
        content |= {"x": answer.x, "duals": answer.duals}
    if model.content.row_names is not None:
        content["row_names"] = np.array(model.content.row_names, dtype=np.str_)
    status = np.array(answer.status.name)
    write_whole({out: lambda file: np.savez_compressed(file, status=status, **content)})
