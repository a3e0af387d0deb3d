"""Where go-to-definition ends, from each public name; ``python tests/house/definitions.py`` prints what it misses.

jedi is what editors ask. A name counts where it leads to the ``def`` or ``class`` line that writes it, or, of a module,
to its file.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import jedi

import lcp_plugin
from lcp_plugin.algorithms import REGISTRY, algorithm_class

ROOT = Path(__file__).parents[2]
FROM_AUTO = (
    "SmallDenseSolver",
    "Banded",
    "Multigrid",
    "Newton",
    "FeasibilityCheck",
    "NPSOR",
    "PSOR",
    "PGS",
)
PROJECT = jedi.Project(ROOT)


def places(
    code: str, line: int, column: int, path: Path | None = None
) -> set[tuple[Path | None, int | None]]:
    """File and line of each definition of what stands there."""
    script = jedi.Script(code, path=path or ROOT / "somebody.py", project=PROJECT)
    return {(one.module_path, one.line) for one in script.goto(line, column, follow_imports=True)}


def is_written_at(name: str, thing: Any, file: Path | None, line: int | None) -> bool:
    """Whether a class, function, module or constant is written there."""
    if file is None or line is None:
        return False
    if isinstance(thing, ModuleType):
        return str(file) == thing.__file__
    is_constant = not (inspect.isclass(thing) or inspect.isroutine(thing))
    written = Path(
        str(inspect.getsourcefile(type(thing) if is_constant else inspect.unwrap(thing)))
    )
    text = file.read_text(encoding="utf-8").splitlines()[line - 1].strip()
    return (
        file == written
        and re.match(rf"{name}\b" if is_constant else rf"(def|class) {name}\b", text) is not None
    )


def missed() -> list[str]:
    """The public names, and the algorithms' classes, from which it does not lead there."""
    names = {
        name: ("lcp_plugin", getattr(lcp_plugin, name))
        for name in lcp_plugin.__dir__()
        if name[0] != "_"
    }
    names |= {
        kind.__name__: ("lcp_plugin.algorithms", kind) for kind in map(algorithm_class, REGISTRY)
    }
    found = []
    for name, (module, thing) in names.items():
        code = f"from {module} import {name}\n{name}\n"
        if not any(is_written_at(name, thing, *place) for place in places(code, 2, 0)):
            found.append(name)
    return found


def leads_from(file: Path, text: str, name: str) -> bool:
    """Whether the name in the first line of a file that holds the text leads to a class or function so called."""
    code = file.read_text(encoding="utf-8")
    lines = enumerate(code.splitlines(), 1)
    row, line = next((k, line) for k, line in lines if re.search(rf"\b{re.escape(text)}", line))
    ends = places(code, row, line.index(name), file)
    return any(
        one is not None
        and at is not None
        and re.match(rf"(def|class) {name}\b", one.read_text(encoding="utf-8").splitlines()[at - 1])
        is not None
        for one, at in ends
    )


def missed_from_auto() -> list[str]:
    """What `auto` may try next and cannot be reached: from `solve` to `solve_lcp`, and from the names in its file."""
    package = ROOT / "lcp_plugin"
    found = (
        [] if leads_from(package / "api.py", "return solve_lcp(", "solve_lcp") else ["solve_lcp"]
    )
    return found + [
        name for name in FROM_AUTO if not leads_from(package / "auto.py", f"{name}(", name)
    ]


if __name__ == "__main__":
    count, lost, lost_in_auto = (
        len(lcp_plugin.__dir__()) - 1 + len(REGISTRY),
        missed(),
        missed_from_auto(),
    )
    print(f"{count - len(lost)} of {count} public names lead to where they are written", *lost)
    of_auto = len(FROM_AUTO) + 1
    print(
        f"{of_auto - len(lost_in_auto)} of {of_auto} from solve to what auto may try", *lost_in_auto
    )
