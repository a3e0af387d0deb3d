"""What `lcp-plugin solve` does between its command line and its last line."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import typer

from ..algorithms import made
from ..core.certificates.row_residuals import is_at_bound
from ..core.errors import InvalidOption, UnreadableFile
from ..core.lcp import LCP
from ..core.settings import Settings, Status
from ..core.solving.result import Result
from ..engines import ENGINES, engine_class
from ..interfaces.program_files import kind_in, load_least_squares, load_problem, load_program
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.cones.methods import METHODS
from ..problems.programs.program import QuadraticProgram
from .target import read_target
from .terminal import LINE, fitted, show_search, show_step

OWN_FLAGS = (
    "tolerance",
    "absolute_tolerance",
    "max_iterations",
    "max_seconds",
    "threads",
    "algorithm",
)
WORDS = {"none": None, "true": True, "false": False}
SHOWN = 20  # variables that are printed
ON_CONES = ("ConeProblem", "FrictionalContact")
T = TypeVar("T")


class OneProcess:
    """The parts of the command that differ where the rows lie on ranks."""

    is_distributed = False

    def from_first(self, attempt: Callable[[], T]) -> T:
        """Return what `attempt` gives on the first process."""
        return attempt()

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
        return save_arrays(out, result.status, {"z": result.z, "w": result.w})


@dataclass(frozen=True, eq=False)
class Picture:
    """What --plot saves: all unknowns, on a grid of these rows and columns where one is given."""

    path: Path | None = None
    grid: tuple[int, ...] | None = None

    @classmethod
    def asked(cls, path: Path | None, grid: str | None) -> Picture:
        """Return what the options ask for, or raise InvalidOption."""
        if grid is not None and path is None:
            raise InvalidOption(f"--grid {grid} is for a picture; give --plot FILE as well")
        return cls(path, None if grid is None else checked_grid(grid))

    def check(self, problem: LCP, scene: Any) -> None:
        """Raise where there is no such grid."""
        if self.grid is None:
            return
        from ..evidence.plots import checked_shape

        if scene is not None:
            raise InvalidOption("--grid is for a file; a scene knows its grid, leave it out")
        checked_shape(self.grid, problem.n)

    def save(self, answer: Any, scene: Any = None, march: Sequence[Any] = ()) -> None:
        """Write the picture of an answer: of a scene what it is about, with all steps of a march."""
        assert self.path is not None
        if scene is not None:
            from ..evidence.pictures import draw

            draw(answer, self.path, scene, march)
        else:
            from ..evidence.plots import save_plot

            save_plot(answer, self.path, self.grid)


def run(
    here: OneProcess,
    target: str,
    size: int | None,
    algorithm: Any,
    options: dict[str, Any],
    settings: dict[str, Any],
    picture: Picture,
    out: Path | None,
    *,
    as_json: bool,
) -> bool:
    """Solve, print and save; return whether it is solved, the same on every rank."""
    from ..auto import policy_for

    with here.ending_together():
        Settings(**settings)  # a wrong one is seen before anything is built
        chosen = policy_for(algorithm, options, on_ranks=here.is_distributed).chosen
        plot = picture.path
        here.from_first(lambda: here.check_outputs(target, plot, out))
        problem, scene = here.read(target, size)
        picture.check(problem, scene)
        results = _solve_all(
            problem, scene, {**settings, "algorithm": chosen, "record": plot is not None}
        )
        more, lines = here.beyond()
        content, story = _content(results) | more, _story(results, scene, lines)

        def saved() -> list[Path]:
            files = [] if out is None else here.save(results[-1], content, out)
            if plot is not None:
                picture.save(results[-1], scene, results)
            return files

        _tell(content, story, as_json, plot, saved)
    return results[-1].is_solved


def _tell(
    content: dict[str, Any],
    story: str,
    as_json: bool,
    plot: Path | None,
    saved: Callable[[], list[Path]],
) -> None:
    """Print the answer, save it and its picture, and say where they are."""
    typer.echo(json.dumps(content, indent=2) if as_json else fitted(story))
    if files := [*([] if plot is None else [plot]), *saved()]:
        typer.echo(f"saved {', '.join(map(str, files))}", err=as_json)


def save_arrays(out: Path, status: Status, arrays: dict[str, Any]) -> list[Path]:
    """Write arrays and the status into an .npz file, whole or not at all; return what was written."""
    from ..interfaces.files.files import write_whole

    write_whole(
        {out: lambda file: np.savez_compressed(file, status=np.array(status.name), **arrays)}
    )
    return [out]


def checked_grid(text: str) -> tuple[int, ...]:
    """Return the shape that --grid names, rows x columns, or raise InvalidOption."""
    sizes = text.lower().replace("×", "x").split("x")
    if not all(size.strip().isdecimal() and int(size) for size in sizes):
        raise InvalidOption(
            f"--grid wants whole numbers, rows x columns, as --grid 500x500; got {text!r}"
        )
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
            raise InvalidOption(
                f"{key} is no option of an algorithm; write --{key.replace('_', '-')} {text}"
            )
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
    from ..api import solve

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
    lines = [
        "" if scene is None else str(scene),
        str(problem),
        result.explain(),
        str(result.certificate),
    ]
    at_bound = problem.matrix.count_of(is_at_bound(problem, result.z))
    lines.append(f"{'at a bound':<18} {at_bound} of {problem.n}")
    if scene is not None and scene.steps > 1:
        total = "{iterations} iterations, {seconds:.3g} s".format(**_totals(results))
        lines.insert(2, f"march: {len(results)} of {scene.steps} steps, {total}; the last step:")
    elif scene is not None and problem.n:
        for name, known in (("true error", scene.exact), ("from the continuum", scene.continuum)):
            if known is not None:
                distance = problem.matrix.largest_of(np.abs(result.z - known))
                lines.append(f"{name:<18} {distance:.3e}")
    return "\n".join(filter(None, [*lines, *more]))


# --- Files that state another problem than an LCP, or state it in AMPL's terms ------------------------------------


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
    """Return whether the target is a file whose answer is not printed as that of an LCP."""
    path = target.strip()
    return Path(path).suffix.lower() == ".nl" or kind_in(path) is not LCP


def run_model(
    target: str,
    size: int | None,
    backend: str,
    algorithm: Any,
    options: dict[str, Any],
    settings: dict[str, Any],
    picture: Picture,
    out: Path | None,
    *,
    as_json: bool,
) -> bool:
    """Solve, print and save; return whether it is solved."""
    from ..auto import policy_for

    for name, is_given, whose in (
        ("--size", size is not None, "a scene"),
        ("--backend", backend != "serial", "LCPs"),
    ):
        if is_given:
            raise InvalidOption(f"{name} is for {whose}, not for this file; leave it out")
    Settings(**settings)
    plain = {one.name: one.default for one in fields(Settings)}
    asked = {
        name: value
        for name, value in settings.items()
        if value != plain[name] or name == "tolerance"
    }
    asked |= {name: options.pop(name) for name in ("prove",) if name in options}  # of a search
    is_on_cones = (
        kind_in(target.strip()).__name__ in ON_CONES
    )  # whose algorithms have names of their own
    chosen: Any
    if isinstance(algorithm, str) and algorithm in ENGINES:
        chosen = engine_class(algorithm)(**options)
    elif is_on_cones and options and algorithm in METHODS:
        chosen = made(METHODS[algorithm], algorithm, options)
    else:
        chosen = algorithm if is_on_cones and not options else policy_for(algorithm, options).chosen
    OneProcess().check_outputs(target, picture.path, out)
    find = _in_nl if Path(target.strip()).suffix.lower() == ".nl" else _in_arrays
    found = find(target.strip(), chosen, asked)
    LINE.say("")
    content = {
        "status": found.status.name,
        **found.more,
        "model": found.model,
        "run": found.result.to_content(),
    }

    def saved() -> list[Path]:
        if picture.path is not None:
            picture.save(found.result)
        return [] if out is None else save_arrays(out, found.status, found.vectors)

    _tell(content, _model_story(target, found), as_json, picture.path, saved)
    return found.status is Status.SOLVED


def _in_nl(target: str, chosen: Any, asked: dict[str, Any]) -> ModelAnswer:
    """Return the answer to AMPL's file."""
    from ..interfaces.nl import read_nl
    from ..problems.equilibria.equilibrium_program import EquilibriumProgram

    model = read_nl(target)
    show = show_search if isinstance(model.problem, EquilibriumProgram) else show_step
    answer = model.solve(chosen, callback=show if LINE.is_there else None, **asked)
    vectors: dict[str, Any] = {} if answer.x is None else {"x": answer.x, "duals": answer.duals}
    vectors["names"] = np.array(model.names(), dtype=np.str_)
    if model.content.row_names is not None:
        vectors["row_names"] = np.array(model.content.row_names, dtype=np.str_)
    more = {"code": answer.code, "message": answer.message, "objective": answer.objective}
    return ModelAnswer(
        repr(model), answer.status, (answer.message,), model.names(), vectors, answer.result, more
    )


def _in_arrays(target: str, chosen: Any, asked: dict[str, Any]) -> ModelAnswer:
    """Return the answer to a program, or to a least squares problem."""
    from ..api import solve

    problem: Any
    if kind_in(target) is QuadraticProgram:
        problem, constant, sign, names = load_program(target)
        seen = {"callback": show_step} if LINE.is_there else {}
        answer: Any = solve(problem, chosen, **asked, **seen)
        rows = {} if problem.ranges is None else {"y": answer.solution.row_multipliers}
        vectors = (
            answer.duals
            | rows
            | ({} if names is None else {"names": np.array(names, dtype=np.str_)})
        )
    elif kind_in(target).__name__ in ON_CONES:
        problem, constant, sign, names = load_problem(target), 0.0, 1.0, None
        if isinstance(problem, FrictionalContact):
            names = [
                f"r[{k // problem.dimension}, {k % problem.dimension}]" for k in range(problem.n)
            ]
        answer = solve(problem, chosen, **asked)
        vectors = {"z": answer.z, "w": answer.w}
    else:
        problem, constant, sign, names = load_least_squares(target), 0.0, 1.0, None
        answer = solve(problem, chosen, **asked)
        vectors = {"active_mask": answer.active_mask}
    objective = None if answer.objective is None else sign * (answer.objective + constant) + 0.0
    return ModelAnswer(
        str(problem),
        answer.status,
        ()
        if objective in (None, answer.objective)
        else (f"objective {objective:.9g}, as the file states it",),
        [f"x[{k}]" for k in range(answer.x.size)] if names is None else names,
        {"x": answer.x} | vectors,
        answer,
        {"objective": objective},
    )


def _model_story(target: str, found: ModelAnswer) -> str:
    """Return what a person wants to read after a run."""
    lines = [f"{target}: {found.model}", *found.message, found.result.explain()]
    if found.result.has_no_solution or "x" not in found.vectors:
        return "\n".join(lines)
    width, left = max(map(len, found.names[:SHOWN]), default=0), len(found.names) - SHOWN
    values = zip(found.names[:SHOWN], found.vectors["x"][:SHOWN], strict=True)
    lines += [f"{name:<{width}}  {value:.9g}" for name, value in values]
    return "\n".join(lines + ([f"and {left} more variables; --out saves them"] if left > 0 else []))
