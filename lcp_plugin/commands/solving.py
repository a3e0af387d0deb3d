"""What `lcp-plugin solve` does between its command line and its last line; and how every kernel is compiled once."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ..errors import InvalidOption, UnreadableFile
from ..problem.lcp import LCP
from ..solving.result import Result
from .target import read_target
from .terminal import RunLine

OWN_FLAGS = ("tolerance", "measure", "max_iterations", "max_seconds", "algorithm")


def run(
    target: str, size: int | None, settings: dict[str, Any], plot: Path | None, out: Path | None, *, as_json: bool
) -> bool:
    """Solve in this process, print and save; return whether it is solved."""
    check_outputs(target, plot, out)
    problem, scene = read_target(target, size)
    with RunLine() as progress:
        results = solve_all(problem, scene, settings, progress)
    result = results[-1]
    typer.echo(content(results) if as_json else story(results, scene))
    if out is not None:
        save_answer(result, out)
    if plot is not None:
        from ..evidence.pictures import draw

        draw(result, plot, scene, results)
    for path in filter(None, (plot, out)):
        typer.echo(f"saved {path}", err=as_json)
    return result.is_solved


def check_outputs(target: str, plot: Path | None, out: Path | None) -> None:
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


def chosen(algorithm: str, options: dict[str, Any]) -> Any:
    """Return the algorithm with its options, or "auto"."""
    from ..algorithms import create
    from ..policy.choice import policy_for

    if algorithm == "auto":
        return policy_for(algorithm, options).name
    return create(algorithm, options)


def solve_all(problem: LCP, scene: Any, settings: dict[str, Any], progress: RunLine) -> list[Result]:
    """Return the results of all steps of a march, warm-started; of one step otherwise. A failure ends it."""
    from ..solving.driver import solve as solve_problem

    results: list[Result] = []
    start = scene.start if scene is not None else None
    for step in range(scene.steps if scene is not None else 1):
        if step:
            start = results[-1].z
            problem = problem.with_q(scene.advance(start))
        results.append(solve_problem(problem, z0=start, callback=progress, **settings))
        if not results[-1].is_solved:
            break
    return results


def save_answer(result: Result, path: Path) -> None:
    """Write z, w and the status into an .npz file, whole or not at all."""
    from ..problem.files import write_whole

    status = np.array(result.status.name)
    write_whole({path: lambda file: np.savez_compressed(file, z=result.z, w=result.w, status=status)})


def content(results: list[Result]) -> str:
    """Return the last result as JSON, with the totals of a march."""
    told = results[-1].to_content()
    if len(results) > 1:
        told["march"] = {
            "steps": len(results),
            "iterations": sum(result.iterations for result in results),
            "seconds": sum(result.seconds for result in results),
        }
    return json.dumps(told, indent=2)


def story(results: list[Result], scene: Any) -> str:
    """Return what a person wants to read after a run."""
    result = results[-1]
    problem = result.certificate.problem
    lines = [str(scene) if scene is not None else "", f"{problem!r}", result.explain(), str(result.certificate)]
    if len(results) > 1 or (scene is not None and scene.steps > 1):
        total = sum(one.iterations for one in results)
        seconds = sum(one.seconds for one in results)
        count = f"{len(results)} of {scene.steps} steps, {total} iterations, {seconds:.3g} s"
        lines.insert(2, f"march: {count}; the last step:")
    at_bound = np.count_nonzero((result.z <= problem.lower) | (result.z >= problem.upper))
    lines.append(f"{'at a bound':<18} {at_bound} of {problem.n}")
    if scene is not None and scene.steps == 1:
        for reference, name in ((scene.exact, "true error"), (scene.continuum, "from the continuum")):
            if reference is not None and problem.n:
                lines.append(f"{name:<18} {np.max(np.abs(result.z - reference)):.3e}")
    return "\n".join(filter(None, lines))


def compile_everything() -> str:
    """Compile whatever is not in the cache yet; return a line that says where it lies and what it took."""
    from ..algorithms import REGISTRY, create
    from ..algorithms.rehearsal import rehearse
    from ..certificates.error_bounds import error_bound
    from ..evidence import gallery
    from ..kernels.compilation import cache_folder
    from ..solving.driver import solve

    began = time.perf_counter()
    scene = gallery.build("obstacle_2d", size=20)
    for name in REGISTRY:
        rehearse(create(name, {}), scene.problem)
    dense = LCP(scene.problem.csr[:9, :9].toarray(), scene.problem.q[:9], lower=-1.0, upper=1.0)
    for problem in (scene.problem, dense):
        for name in ("multigrid", "lemke", "newton", "auto"):
            error_bound(problem, solve(problem, name).z)
    return f"kernels compiled in {time.perf_counter() - began:.1f} s; they lie in {cache_folder()}"
