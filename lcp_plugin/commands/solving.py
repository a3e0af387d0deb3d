"""Read the problem of a command; solve it, print the result, save it; compile every kernel.

A target is a file, or the name of a test problem.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import typer

import lcp_plugin

from .. import gallery
from ..algorithms import REGISTRY, made
from ..api import solve
from ..core.deadline import compilation
from ..core.errors import LONG_LIST, InvalidOption, LCPError, UnreadableFile, did_you_mean
from ..core.files import write_whole
from ..core.lcp import LCP
from ..core.problem_classes import refusal
from ..core.settings import OF_SOLVE, parse_options
from ..evidence.drawing import check_format, draw, require_matplotlib
from ..interfaces.nl.model import read_nl
from ..interfaces.program_files import MPS, load_problem, load_program
from ..problems.cones.data import ConeProblem
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.cones.methods import CONE_METHODS

if TYPE_CHECKING:
    from ..core.checks import Vector
    from ..solving.result import Sample

#: Numbers of results, residuals first; each class of result has some of them.
RESULT_NUMBERS = (
    "relative_residual natural_residual euclidean_residual bound_violation complementarity term_residual "
    "primal_residual duality_gap optimality objective lower_bound gap programs work tolerance "
    "absolute_tolerance setup_seconds seconds"
)
UPDATE_SECONDS = 0.1  # between two updates of the line of progress


class Source(NamedTuple):
    """A problem and the facts that its source supplies.

    Attributes
    ----------
    problem : LCP, or a problem of another class
        An ``NLModel`` of an .nl file.
    test_problem : a test problem of the gallery, or None
    names : sequence of str or None
        Names of the variables.
    """

    problem: Any
    test_problem: Any = None
    names: Any = None


def read_target(target: str) -> Source:
    """Return the problem of a file or a test problem.

    Raises
    ------
    LCPError
        If there is none.
    """
    target = target.strip()
    name, _, settings = target.partition(":")
    name = name.strip().replace("-", "_")
    if name in gallery.names():
        scene = gallery.parse(f"{name}:{settings}")
        return Source(scene.problem, scene)
    path = Path(target)
    if not (set(target) & set("/\\.") or path.exists()):
        hint = did_you_mean(name, gallery.names(), is_listed=True)
        raise InvalidOption(f"{target!r} is neither a file nor a test problem{hint}")
    if path.suffix.lower() in MPS:
        program = load_program(target)
        return Source(program, names=program.names.unknowns)
    if path.suffix.lower() == ".nl":
        model = read_nl(target)
        return Source(model, names=model.names())
    return Source(load_problem(target))


def read_lcp(target: str, way: str) -> Source:
    """Return the LCP of a file or a test problem, or raise InvalidOption for another class of problem."""
    source = read_target(target)
    problem = getattr(source.problem, "problem", source.problem)  # of an .nl file
    if not isinstance(problem, LCP):
        raise InvalidOption(f"{target}: {refusal(way, problem)}")
    return source._replace(problem=problem)


def solve_target(
    target: str,
    algorithm: str,
    options: dict[str, Any],
    settings: dict[str, Any],
    plot: Path | None,
    out: Path | None,
    *,
    as_json: bool,
) -> bool:
    """Solve, print and save; return whether the problem is solved."""
    check_outputs(target, plot, out)
    source = read_target(target)
    if isinstance(source.problem, LCP):
        settings = settings | {"record": plot is not None}
    if hasattr(source.problem, "content"):  # an .nl file
        solution = source.problem.solve(algorithm, **options, **settings)
        answer, x, lines = solution.result, solution.x, [solution.message]
        arrays = {} if x is None else {"x": x, "duals": solution.duals}
        objective = solution.objective
    else:
        answer = _watched(source, algorithm, options, settings)
        x, lines = answer.x, _certificate_lines(source, answer)
        arrays = _arrays(answer)
        objective = answer.objective
    if as_json:
        content = json_content(answer)
        if objective is not None:
            content["objective"] = objective
        missing = (k for k, v in content.items() if isinstance(v, float) and not np.isfinite(v))
        finite = content | dict.fromkeys(missing)
        typer.echo(json.dumps(finite, indent=2, allow_nan=False))
    else:
        heading = source.test_problem or f"{target}:"
        model = source.problem
        shown = [] if source.test_problem else _values(source, answer, x)
        typer.echo("\n".join([f"{heading}", f"{model}", answer.explain(), *lines, *shown]))
    if out is not None:
        names = {} if source.names is None else {"names": np.array(source.names, dtype=np.str_)}
        arrays |= names | {"status": np.array(answer.status.name)}
        write_whole({out: lambda file: np.savez_compressed(file, **arrays)})
    if plot is not None:
        draw(answer, plot, source.test_problem)
    if saved := [*filter(None, (plot, out))]:
        typer.echo(f"saved {', '.join(map(str, saved))}", err=as_json)
    return bool(answer.is_solved)


def json_content(answer: Any) -> dict[str, Any]:
    """Return status, residuals and counts of a result, without vectors."""
    owners = [answer, getattr(answer, "certificate", None)]
    owners += [] if answer.has_no_solution else [getattr(answer, "solution", None)]
    named = ((name, owner) for owner in owners for name in RESULT_NUMBERS.split())
    numbers = {name: getattr(owner, name) for name, owner in named if hasattr(owner, name)}
    return {
        "status": answer.status.name,
        "advice": answer.advice,
        "algorithm": answer.algorithm,
        "n": None if answer.x is None else len(answer.x),
        "iterations": answer.iterations,
        **{k: value for k, value in numbers.items() if not (value is None or callable(value))},
    }


def _watched(source: Source, method: str, options: dict[str, Any], settings: dict[str, Any]) -> Any:
    """Return the result of the problem from the start of its test problem, with progress on a terminal."""
    problem, scene = source.problem, source.test_problem
    start = {} if scene is None or scene.start is None else {"z0": scene.start}
    chosen: Any = method
    if isinstance(problem, ConeProblem | FrictionalContact) and method in CONE_METHODS:
        chosen, options = made(CONE_METHODS[method], method, options), {}
    options = options | settings
    with progress_on_terminal() as show:
        if show is not None and isinstance(problem, LCP):
            options |= {"callback": show}
        return solve(problem, chosen, **start, **options)


@contextmanager
def progress_on_terminal() -> Iterator[Callable[[Sample, Vector], bool] | None]:
    """Show the progress of a run on a terminal, and yield the callback that does it; None without a terminal."""
    if not (sys.stderr and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console

    with Console(stderr=True).status("") as line:
        last = -UPDATE_SECONDS

        def show(sample: Sample, z: Vector) -> bool:
            nonlocal last
            if sample.seconds >= last + UPDATE_SECONDS:
                last = sample.seconds
                words = f"{sample.label}: iteration {sample.iteration}, {sample.seconds:.1f} s"
                line.update(f"{words} (Ctrl-C stops and keeps the best)")
            return False

        yield show


def _certificate_lines(source: Source, answer: Any) -> list[str]:
    """Return lines with the residuals of an LCP, and the errors against a known solution."""
    scene = source.test_problem
    lines = str(answer.certificate).splitlines() if isinstance(source.problem, LCP) else []
    if scene is None:
        return lines
    for name, known in (
        ("true error", scene.exact),
        ("difference from the exact solution without grid", scene.continuum),
    ):
        if known is not None:
            lines.append(f"{name:<18} {np.abs(answer.z - known).max(initial=0.0):.3e}")
    return lines


def _arrays(answer: object) -> dict[str, Any]:
    """Return the vectors of an answer: z and w, or x and the multipliers of a program."""
    has_slack = hasattr(answer, "certificate") and not hasattr(answer, "duals")
    names = ("z", "w") if has_slack else ("x",)
    arrays = {name: getattr(answer, name) for name in names} | dict(getattr(answer, "duals", {}))
    return {name: array for name, array in arrays.items() if array is not None}


def _values(source: Source, answer: Any, x: Vector) -> list[str]:
    """Return the first values by their names."""
    if x is None or answer.has_no_solution:
        return []
    letter = "z" if isinstance(source.problem, LCP) else "x"
    names = source.names or [f"{letter}[{k}]" for k in range(len(x))]
    width, more = max(map(len, names[:LONG_LIST]), default=0), len(x) - LONG_LIST
    values = zip(names[:LONG_LIST], x[:LONG_LIST], strict=True)
    lines = [f"{name:<{width}}  {value:.9g}" for name, value in values]
    return lines + ([f"and {more} more values; --out saves them"] if more > 0 else [])


# --- Options --------------------------------------------------------------------------------------------------


def parsed_options(pairs: list[str]) -> dict[str, Any]:
    """Return the options of the algorithm."""
    options = parse_options(pairs)
    for key in options.keys() & {"problem", "algorithm", *OF_SOLVE}:
        raise InvalidOption(f"{key} is not an option of an algorithm; see lcp-plugin solve --help")
    return options


def check_outputs(target: str, plot: Path | None, out: Path | None = None) -> None:
    """Raise an error before the run if an output could not be written after it."""
    if plot is not None:
        check_format(plot)
        require_matplotlib()
    if out is not None and out.suffix != ".npz":
        raise InvalidOption(f"--out writes an .npz file, got {out.name!r}")
    for path in filter(None, (plot, out)):
        if not path.absolute().parent.is_dir():
            raise UnreadableFile(f"cannot write {path}: the folder {path.parent} does not exist")
        if path.is_dir():
            raise UnreadableFile(f"cannot write {path}: it is a folder")
        if path.exists() and Path(target).exists() and path.samefile(target):
            raise UnreadableFile(f"cannot write {path}: it is the problem; choose another name")


# --- Compilation ---------------------------------------------------------------------------------------------


def compile_everything() -> str:
    """Compile what is not in the cache yet; return a line with the seconds."""
    sparse = gallery.build("obstacle_2d", size=20).problem
    dense = LCP(sparse.csr[:9, :9].toarray(), sparse.q[:9], lower=-1.0, upper=1.0)
    for name, problem, record in product(REGISTRY, (sparse, dense), (False, True)):
        with suppress(LCPError):  # not every algorithm takes every matrix
            solve(problem, name, record=record, max_iterations=20)
    for problem in (sparse, dense):
        lcp_plugin.error_bound(problem, solve(problem).z)
    march = lcp_plugin.march(sparse, np.zeros((2, sparse.n)), algorithm="banded")
    steps = lcp_plugin.derivative(march)
    steps.vjp(np.ones(sparse.n))
    steps.jvp(dz0=np.ones(sparse.n))
    contact = FrictionalContact(2.0 * np.eye(6), [[-1.0, 3.0, 4.0], [-1.0, 0.1, 0.2]], 0.5)
    for name in ("auto", *CONE_METHODS):
        lcp_plugin.derivative(solve(contact, name)).vjp(np.ones(6))
    batch_derivative = lcp_plugin.derivative(lcp_plugin.solve_batch([dense]))
    batch_derivative.vjp(np.ones((1, 9)))
    batch_derivative.jvp(dq=np.ones(9))
    # an exact search enumerates all pieces
    no_solution = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0])
    lcp_plugin.solve_batch([no_solution, no_solution], prove_infeasibility=False)
    for problem in (no_solution, LCP.from_game([[2, 0], [0, 1]], [[1, 0], [0, 2]])):
        solve(problem)
    convex = lcp_plugin.QuadraticProgram(np.eye(2), np.ones(2), [[1.0, 1.0]], [-3.0])
    for instance in (dense, convex):
        lcp_plugin.prepare(instance).solve()
    for batch in ([dense] * 64, [contact, contact], [convex]):  # 64: for the compiled loop
        lcp_plugin.solve_batch(batch)
    lcp_plugin.solve_batch(lcp_plugin.BoundedLeastSquares(dense.M, dense.q), np.ones((64, dense.n)))
    program = LCP.from_qp(np.eye(2), np.ones(2), A=[[1.0, 1.0]], b=[1.0])
    program.origin.recover(solve(program))
    return f"kernels compiled in {compilation().seconds:.1f} s"
