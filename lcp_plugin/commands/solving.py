"""What `lcp-plugin solve` does between its command line and its last line."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ..core.certificates.row_residuals import is_at_bound
from ..core.communicator import ALONE, Communicator
from ..core.errors import InvalidOption, UnreadableFile
from ..core.lcp import LCP
from ..core.settings import Settings
from ..core.solving.result import Result
from .target import read_target
from .terminal import LINE, show_step

OWN_FLAGS = ("tolerance", "absolute_tolerance", "max_iterations", "max_seconds", "threads", "algorithm")
WORDS = {"none": None, "true": True, "false": False}


class OneProcess:
    """The parts of the command that differ where the rows lie on ranks."""

    communicator: Communicator = ALONE

    def ending_together(self) -> AbstractContextManager[None]:
        """Return a context in which no process waits for one that has failed."""
        return nullcontext()

    def check_outputs(self, target: str, plot: Path | None, out: Path | None) -> None:
        """Refuse before the run what could not be written after it."""
        if plot is not None:
            from ..evidence.drawing import check_format, require_matplotlib

            check_format(plot)
            require_matplotlib()
        if out is not None and out.suffix != ".npz":
            raise InvalidOption(f"--out writes a .npz file, got {out.name!r}")
        for path in filter(None, (plot, out)):
            require_place(path.absolute().parent, path)
            if path.is_dir():
                raise UnreadableFile(f"cannot write {path}: it is a folder")
            refuse_the_problem_itself(target, path)

    def read(self, target: str, size: int | None) -> tuple[LCP, Any]:
        """Return the problem, and the scene where it is of one."""
        return read_target(target, "lcp-plugin solve", size)

    def beyond(self) -> tuple[dict[str, Any], list[str]]:
        """Return what else --json prints and a person reads."""
        return {}, []

    def save(self, result: Result, content: dict[str, Any], out: Path) -> list[Path]:
        """Write z, w and the status into an .npz file, whole or not at all; return what was written."""
        from ..doors.files.files import write_whole

        status = np.array(result.status.name)
        write_whole({out: lambda file: np.savez_compressed(file, z=result.z, w=result.w, status=status)})
        return [out]


def run(
    here: OneProcess, target: str, size: int | None, algorithm: Any, options: dict[str, Any], settings: dict[str, Any],
    plot: Path | None, grid: tuple[int, ...] | None, out: Path | None, *, as_json: bool,
) -> bool:
    """Solve, print and save; return whether it is solved, the same on every rank."""
    from ..core.policy.choice import policy_for

    with here.ending_together():
        Settings(**settings)  # a wrong one is seen before anything is built
        chosen = policy_for(algorithm, options, on_ranks=not here.communicator.is_alone).chosen
        here.communicator.from_first(lambda: here.check_outputs(target, plot, out))
        problem, scene = here.read(target, size)
        pictured = scene if grid is None else on_grid(problem, target, scene, grid)
        results = _solve_all(problem, scene, {**settings, "algorithm": chosen, "record": plot is not None})
        more, lines = here.beyond()
        content, story = _content(results) | more, _story(results, scene, lines)
        typer.echo(json.dumps(content, indent=2) if as_json else story)
        saved = [] if out is None else here.save(results[-1], content, out)
        if plot is not None:
            from ..evidence.pictures import draw

            draw(results[-1], plot, pictured, results)
            saved.insert(0, plot)
        if saved:
            typer.echo(f"saved {', '.join(map(str, saved))}", err=as_json)
    return results[-1].is_solved


def on_grid(problem: LCP, target: str, scene: Any, grid: tuple[int, ...]) -> Any:
    """Return the scene that a picture of a file's problem on a grid is drawn from."""
    from ..evidence.plots import checked_shape, labels_of
    from ..gallery import Scene

    if scene is not None:
        raise InvalidOption("--grid is for a file; a scene knows its grid, leave it out")
    shape = checked_shape(grid, problem.n)
    return Scene(problem=problem, name=target, is_declared=False, grid=shape, axis_labels=labels_of(grid))


def checked_grid(text: str | None, plot: Path | None) -> tuple[int, ...] | None:
    """Return the shape that --grid names, rows x columns, or raise InvalidOption."""
    if text is None:
        return None
    if plot is None:
        raise InvalidOption(f"--grid {text} is the grid of a picture; give --plot FILE as well")
    sizes = text.lower().replace("×", "x").split("x")
    if not all(size.strip().isdecimal() and int(size) for size in sizes):
        raise InvalidOption(f"--grid wants whole numbers, rows x columns, as --grid 500x500; got {text!r}")
    return tuple(int(size) for size in sizes)


def require_place(folder: Path, path: Path) -> None:
    """Raise UnreadableFile where the folder that shall hold the path is none."""
    if not folder.is_dir():
        raise UnreadableFile(f"cannot write {path}: the folder {path.parent} does not exist")


def refuse_the_problem_itself(target: str, path: Path) -> None:
    """Raise UnreadableFile where an answer would replace the problem."""
    if path.exists() and Path(target).exists() and path.samefile(target):
        raise UnreadableFile(f"cannot write {path}: it is the problem itself; choose another name")


def options(relaxation: str | None, pairs: list[str]) -> dict[str, Any]:
    """Return the options of the algorithm; values are read as numbers, true/false/none, or words."""
    options: dict[str, Any] = {}
    for pair in [*([] if relaxation is None else [f"relaxation={relaxation}"]), *pairs]:
        key, equals, text = pair.partition("=")
        if not equals or not key:
            raise InvalidOption(f"--option wants name=value, got {pair!r}")
        if key in OWN_FLAGS:
            raise InvalidOption(f"{key} is no option of an algorithm; write --{key.replace('_', '-')} {text}")
        if key in options:
            raise InvalidOption(f"the option {key} is given twice; once is enough")
        options[key] = _value(text)
    return options


def _value(text: str) -> Any:
    """Return a whole number as an int, which some options ask for, any other as a float, else a word's meaning."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return WORDS.get(text.lower(), text)


def _solve_all(problem: LCP, scene: Any, settings: dict[str, Any]) -> list[Result]:
    """Return the results of all steps of a march, warm-started; of one step otherwise. A failure ends it."""
    from ..core.solving.driver import solve

    settings["callback"] = show_step
    results = [solve(problem, z0=None if scene is None else scene.start, **settings)]
    while results[-1].is_solved and scene is not None and len(results) < scene.steps:
        problem = problem.with_q(scene.advance(results[-1].z))
        results.append(solve(problem, z0=results[-1].z, **settings))
    LINE.say("")
    return results


def _content(results: list[Result]) -> dict[str, Any]:
    """Return what --json prints: the last result, with the totals of a march."""
    content = results[-1].to_content()
    if len(results) > 1:
        content["march"] = {"steps": len(results), **_totals(results)}
    return content


def _totals(results: list[Result]) -> dict[str, Any]:
    return {name: sum(getattr(one, name) for one in results) for name in ("iterations", "seconds")}


def _story(results: list[Result], scene: Any, more: list[str]) -> str:
    """Return what a person wants to read after a run; all ranks call."""
    result = results[-1]
    problem = result.certificate.problem
    lines = ["" if scene is None else str(scene), str(problem), result.explain(), str(result.certificate)]
    at_bound = problem.communicator.total(float(np.count_nonzero(is_at_bound(problem, result.z))))
    lines.append(f"{'at a bound':<18} {at_bound:.0f} of {problem.n}")
    if scene is not None and scene.steps > 1:
        total = "{iterations} iterations, {seconds:.3g} s".format(**_totals(results))
        lines.insert(2, f"march: {len(results)} of {scene.steps} steps, {total}; the last step:")
    elif scene is not None and problem.n:
        for name, known in (("true error", scene.exact), ("from the continuum", scene.continuum)):
            if known is not None:
                distance = problem.communicator.largest(float(np.abs(result.z - known).max(initial=0.0)))
                lines.append(f"{name:<18} {distance:.3e}")
    return "\n".join(filter(None, [*lines, *more]))
