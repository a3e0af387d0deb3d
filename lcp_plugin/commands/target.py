"""What a command works on: a file, a folder or a scene; and what there is of algorithms and scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..core.errors import InvalidOption, LCPError, did_you_mean
from ..core.kinds import refusal
from ..core.lcp import LCP


def read_target(target: str, way: str, size: int | None = None) -> tuple[LCP, Any]:
    """Return (problem, None) of a file or (problem, scene) of a scene's name; of another kind what to write instead."""
    from .. import gallery

    if (own := own_scene(target, size)) is not None:
        return own.problem, own
    if (text := scene_text(target, size)) is None:
        return lcp_of_file(target, way), None
    scene = gallery.parse(text)
    return scene.problem, scene


def own_scene(target: str, size: int | None = None) -> Any:
    """Return what ``file.py:function`` or ``module:function`` builds, None where the target has another form.

    Raises
    ------
    InvalidOption
        Where there is no such function, or it has a mistake, with its line.
    """
    from .own_names import scene_of

    return scene_of(target, size) if is_own_problem(target) else None


def is_own_problem(target: str) -> bool:
    """Return whether the target is written ``file.py:function`` or ``module:function``, and no scene."""
    from .. import gallery
    from .own_names import is_own

    return is_own(target) and target.partition(":")[0].strip().replace("-", "_") not in gallery.names()


def own_algorithm(name: str, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the algorithm and its options as `solve` takes them, of ``file.py:Class`` an object that has them."""
    from .own_names import algorithm_of, is_own

    return (algorithm_of(name, options), {}) if is_own(name) else (name, options)


def lcp_of_file(path: str, way: str) -> LCP:
    """Return the LCP of a file; raise InvalidOption in the words of the table of kinds where it states another."""
    from ..doors.files.program_files import load_problem

    problem = load_problem(path)
    if not isinstance(problem, LCP):
        raise InvalidOption(f"{path}: {refusal(way, problem)}")
    return problem


def scene_text(target: str, size: int | None = None) -> str | None:
    """Return what `gallery.parse` reads, name:key=value,…, or None where the target is or looks like a path.

    The name may be written with dashes; a size given beside the target becomes the scene's.

    Raises
    ------
    InvalidOption
        Where the target is neither, or the size is given twice, or beside a file.
    """
    from .. import gallery

    name, _, settings = target.strip().partition(":")
    name = name.strip().replace("-", "_")
    if name not in gallery.names():
        if not (set(target) & set("/\\.") or Path(target).exists() or Path(f"{target}M.mtx").exists()):
            raise InvalidOption(f"{target!r} is neither a file nor a scene{did_you_mean(name, gallery.names())}")
        if size is not None:
            raise InvalidOption(f"--size {size} is for a scene, but {target!r} is none; leave it out")
        return None
    given = [setting for setting in settings.split(",") if setting.strip()]
    if size is not None:
        if any(setting.partition("=")[0].strip() == "size" for setting in given):
            raise InvalidOption(f"the size is given twice, in {target!r} and as --size {size}; once is enough")
        given.append(f"size={size}")
    return f"{name}:{','.join(given)}" if given else name


def scene_names(incomplete: str) -> list[str]:
    """Return the scenes that begin so."""
    from .. import gallery

    return [name for name in gallery.names() if name.startswith(incomplete)]  # none of them: the shell tries files


def algorithm_names(incomplete: str) -> list[str]:
    """Return the algorithms that begin so, those of other packages too."""
    from ..core.algorithms import REGISTRY
    from ..doors.packages import from_other_packages

    return [name for name in ("auto", *REGISTRY, *from_other_packages()) if name.startswith(incomplete)]


def print_everything() -> None:
    """Print kinds of problems by the ways that take them, algorithms with needs and sources, scenes with parameters."""
    from ..core.algorithms import REGISTRY, Algorithm, algorithm_class
    from ..core.kinds import WAYS
    from ..core.kinds import kinds as kinds_of_problems
    from ..doors.packages import from_other_packages
    from ..gallery import describe
    from .terminal import console, table

    foreign = from_other_packages()
    offers = {**{name: algorithm_class(name) for name in REGISTRY}, **foreign}
    kinds = {name: kind for name, kind in offers.items() if not isinstance(kind, LCPError)}
    references = dict.fromkeys(kind.reference for kind in kinds.values() if kind.reference != Algorithm.reference)
    sources = {reference: f"[{k}]" for k, reference in enumerate(references, start=1)}
    headings = ("name", "needs", "proved to converge on", "an iteration costs", "source")
    algorithms = [
        (name, kind.assumption, kind.converges_on, kind.cost, sources.get(kind.reference, kind.reference))
        for name, kind in kinds.items()
    ]
    scenes = [
        (name, summary, ", ".join(f"{key}={value}" for key, value in parameters.items()))
        for name, summary, parameters in describe()
    ]
    terminal = console(160)
    ways = [(way, *("✓" if way in kind.ways else "–" for kind in kinds_of_problems())) for way in WAYS]
    words = ("", *(kind.word for kind in kinds_of_problems()))
    terminal.print(table("Kinds of problems, and what takes each", words, ways, pad_edge=False))
    terminal.print()
    terminal.print(table("Algorithms", headings, algorithms, pad_edge=False))
    for reference, source in sources.items():
        terminal.print(f"{source} {reference}")
    for error in (one for one in foreign.values() if isinstance(one, LCPError)):
        terminal.print(f"left out: {error}")
    terminal.print()
    terminal.print(table("Scenes", ("name", "what", "parameters"), scenes, pad_edge=False))
