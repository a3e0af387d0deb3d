"""The problem that a command works on: of a file, of a folder, or a test problem by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import InvalidOption, did_you_mean
from ..core.lcp import LCP
from ..core.problem_classes import refusal


class Target(NamedTuple):
    """A problem and the facts that its source supplies.

    Attributes
    ----------
    problem : LCP, or a problem of another class
        An ``NLModel`` of an .nl file.
    scene : Scene or None
    sign : float
        The objective of a file is sign · the program's objective.
    names : sequence of str or None
        Names of the variables.
    """

    problem: Any
    scene: Any = None
    sign: float = 1.0
    names: Any = None


def read_target(target: str, size: int | None = None) -> Target:
    """Return the problem of a file or a test problem.

    Raises
    ------
    LCPError
        If there is none, or if the size is given twice, or for a file.
    """
    from .. import gallery
    from ..interfaces.program_files import MPS, load_problem, load_program

    target = target.strip()
    name, _, settings = target.partition(":")
    name = name.strip().replace("-", "_")
    if name in gallery.names():
        given = [setting for setting in settings.split(",") if setting.strip()]
        given += [] if size is None else [f"size={size}"]
        scene = gallery.parse(f"{name}:{','.join(given)}")
        return Target(scene.problem, scene)
    path = Path(target)
    if not (set(target) & set("/\\.") or path.exists() or Path(f"{target}M.mtx").exists()):
        hint = did_you_mean(name, gallery.names(), is_listed=True)
        raise InvalidOption(f"{target!r} is neither a file nor a test problem{hint}")
    if size is not None:
        raise InvalidOption(
            f"--size {size} is for a test problem, but {target!r} is not one; leave it out"
        )
    if path.suffix.lower() in MPS:
        program, sign, names = load_program(target)
        return Target(program, None, sign, names)
    if path.suffix.lower() == ".nl":
        from ..interfaces.nl import read_nl

        return Target(read_nl(target))
    return Target(load_problem(target))


def read_lcp(target: str, way: str, size: int | None = None) -> Target:
    """Return the LCP of a file or a test problem, or raise InvalidOption for another class of problem."""
    found = read_target(target, size)
    problem = getattr(found.problem, "problem", found.problem)  # of an .nl file
    if not isinstance(problem, LCP):
        raise InvalidOption(f"{target}: {refusal(way, problem)}")
    return found._replace(problem=problem)
