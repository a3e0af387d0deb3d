"""What `lcp-plugin solve` does between its command line and its last line."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import typer

from ..certificates.row_residuals import is_at_bound
from ..checks import FloatVector
from ..errors import InvalidOption, UnreadableFile
from ..problem.lcp import LCP
from ..settings import Settings
from ..solving.result import Result
from .target import read_target
from .terminal import RunLine

OWN_FLAGS = ("tolerance", "absolute_tolerance", "measure", "max_iterations", "max_seconds", "threads", "algorithm")
T = TypeVar("T")


@dataclass(frozen=True)
class Task:
    """A problem and what its source knows: a name, a start, a march, and how far an own z is from what is known."""

    problem: LCP
    name: str = ""
    start: FloatVector | None = None
    references: dict[str, Callable[[FloatVector], float]] = field(default_factory=dict)
    scene: Any = None

    @classmethod
    def of_scene(cls, problem: LCP, scene: Any) -> Task:
        """Return the task of a scene of which this process holds the problem's rows."""
        own = slice(problem.first, problem.last)
        known = {"true error": scene.exact, "from the continuum": scene.continuum}
        references: dict[str, Callable[[FloatVector], float]] = {
            name: partial(_distance, exact[own])
            for name, exact in known.items() if exact is not None and scene.steps == 1 and problem.n
        }
        return cls(problem, str(scene), None if scene.start is None else scene.start[own], references, scene)

    @property
    def steps(self) -> int:
        """Return how many problems follow one another."""
        return 1 if self.scene is None else int(self.scene.steps)


def _distance(exact: FloatVector, z: FloatVector) -> float:
    return float(np.abs(z - exact).max(initial=0.0))


class OneProcess:
    """The parts of the command that differ where the rows lie on ranks."""

    on_ranks = False
    once: Callable[[Callable[[], T]], T] = staticmethod(lambda attempt: attempt())

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
            if not path.absolute().parent.is_dir():
                raise UnreadableFile(f"cannot write {path}: the folder {path.parent} does not exist")
            if path.is_dir():
                raise UnreadableFile(f"cannot write {path}: it is a folder")
            refuse_the_problem_itself(target, path)

    def read(self, target: str, size: int | None, out: Path | None) -> Task:
        """Return what is to be solved."""
        problem, scene = read_target(target, size)
        return Task(problem) if scene is None else Task.of_scene(problem, scene)

    def beyond(self) -> tuple[dict[str, Any], list[str]]:
        """Return what else --json prints and a person reads."""
        return {}, []

    def save(self, result: Result, content: dict[str, Any], out: Path) -> list[Path]:
        """Write z, w and the status into an .npz file, whole or not at all; return what was written."""
        from ..problem.files import write_whole

        status = np.array(result.status.name)
        write_whole({out: lambda file: np.savez_compressed(file, z=result.z, w=result.w, status=status)})
        return [out]


def run(
    here: OneProcess, target: str, size: int | None, algorithm: str, options: dict[str, Any], settings: dict[str, Any],
    plot: Path | None, out: Path | None, *, as_json: bool,
) -> bool:
    """Solve, print and save; return whether it is solved, the same on every rank."""
    from ..policy.choice import policy_for

    with here.ending_together():
        Settings(**settings)  # a wrong one is seen before anything is built
        chosen = policy_for(algorithm, options, on_ranks=here.on_ranks).chosen
        here.once(lambda: here.check_outputs(target, plot, out))
        task = here.read(target, size, out)
        with RunLine() as progress:
            results = _solve_all(task, {**settings, "algorithm": chosen, "record": plot is not None}, progress)
        more, lines = here.beyond()
        content = _content(results) | more
        story = _story(results, task, lines)
        typer.echo(json.dumps(content, indent=2) if as_json else story)
        saved = [] if out is None else here.save(results[-1], content, out)
        if plot is not None:
            from ..evidence.pictures import draw

            draw(results[-1], plot, task.scene, results)
            saved.insert(0, plot)
        if saved:
            typer.echo(f"saved {', '.join(map(str, saved))}", err=as_json)
    return results[-1].is_solved


def refuse_the_problem_itself(target: str, path: Path) -> None:
    """Raise UnreadableFile where an answer would replace the problem."""
    if path.exists() and Path(target).exists() and path.samefile(target):
        raise UnreadableFile(f"cannot write {path}: it is the problem itself; choose another name")


def options(relaxation: str | None, pairs: list[str]) -> dict[str, Any]:
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
        options[key] = _number(text) if _number(text) is not None else words.get(text.lower(), text)
    return options


def _number(text: str) -> float | None:
    """Return a whole number as an int, which some options ask for, any other as a float, None for a word."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return None


def _solve_all(task: Task, settings: dict[str, Any], progress: RunLine) -> list[Result]:
    """Return the results of all steps of a march, warm-started; of one step otherwise. A failure ends it."""
    from ..solving.driver import solve

    problem, results = task.problem, [solve(task.problem, z0=task.start, callback=progress, **settings)]
    while results[-1].is_solved and len(results) < task.steps:
        problem = problem.with_q(task.scene.advance(results[-1].z))
        results.append(solve(problem, z0=results[-1].z, callback=progress, **settings))
    return results


def _content(results: list[Result]) -> dict[str, Any]:
    """Return what --json prints: the last result, with the totals of a march."""
    told = results[-1].to_content()
    if len(results) > 1:
        told["march"] = {
            "steps": len(results),
            "iterations": sum(result.iterations for result in results),
            "seconds": sum(result.seconds for result in results),
        }
    return told


def _story(results: list[Result], task: Task, more: list[str]) -> str:
    """Return what a person wants to read after a run; all ranks call."""
    result = results[-1]
    problem = result.certificate.problem
    lines = [task.name, f"{problem!r}", result.explain(), str(result.certificate)]
    if task.steps > 1:
        total = sum(one.iterations for one in results)
        seconds = sum(one.seconds for one in results)
        count = f"{len(results)} of {task.steps} steps, {total} iterations, {seconds:.3g} s"
        lines.insert(2, f"march: {count}; the last step:")
    at_bound = problem.peers.total(float(np.count_nonzero(is_at_bound(problem, result.z))))
    lines.append(f"{'at a bound':<18} {at_bound:.0f} of {problem.n}")
    for name, distance in task.references.items():
        lines.append(f"{name:<18} {problem.peers.largest(distance(result.z)):.3e}")
    return "\n".join(filter(None, [*lines, *more]))
