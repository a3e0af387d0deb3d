"""The picture in the README is the import graph, and importing the package loads nothing heavy."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from fresh_process import printed_by
from picture import ARROWS, FOLDERS, LINES, above, explained, room_of

from lcp_plugin import algorithms
from lcp_plugin.algorithms import REGISTRY, algorithm_class
from lcp_plugin.core import registry
from lcp_plugin.core.errors import InvalidOption
from lcp_plugin.rooms import OFFERS

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "lcp_plugin"
FLOORS = 14
HEAVY = (
    "numba", "pyamg", "cvxpy", "matplotlib", "hypothesis", "rich", "typer", "jinja2", "torch", "jax", "pyomo",
    "qpsolvers", "quantecon", "cvxpylayers",
)
FRONT_DOORS = ("__init__", "__main__", "rooms", "algorithms", "methods", "problems", "doors")


def module_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = sorted(file for file in PACKAGE.rglob("*.py") if room_of(file) not in (*FRONT_DOORS, "__init__"))
MODULES = {module_of(file): file for file in FILES}


def imported_modules(file: Path) -> set[str]:
    """Modules of this package that a file imports, at the top or inside a function, but for types alone."""
    package = ["lcp_plugin", *file.relative_to(PACKAGE).parts[:-1]]
    found: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(file.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            prefix = ".".join([*base, node.module] if node.module else base)
            targets = [name if (name := f"{prefix}.{alias.name}") in MODULES else prefix for alias in node.names]
        else:
            continue
        found |= {target for target in targets if target in MODULES}
    return found - {module_of(file)}


IMPORTS = {module: imported_modules(file) for module, file in MODULES.items()}


def assert_has_no_circle(imports: dict[str, set[str]]) -> None:
    waiting = dict(imports)
    while waiting:
        ready = {one for one, targets in waiting.items() if not targets & waiting.keys()}
        assert ready, f"in a circle: {sorted(waiting)}"
        waiting = {one: targets for one, targets in waiting.items() if one not in ready}


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_arrows_stand_in_the_picture(file: Path) -> None:
    """A file imports from its own room, from the core, and from where the picture's arrows lead, in functions too."""
    room = room_of(file)
    assert room in ARROWS, f"README's picture and the table below it lack the room {room}"
    for target in IMPORTS[module_of(file)]:
        assert room_of(MODULES[target]) in {room, "core", *ARROWS[room]}, f"{module_of(file)} → {target}"


def test_every_arrow_is_needed() -> None:
    """The picture draws no arrow that no file has."""
    drawn = {(room, target) for room, targets in ARROWS.items() for target in targets}
    has = {(room_of(MODULES[one]), room_of(MODULES[other])) for one, targets in IMPORTS.items() for other in targets}
    assert not drawn - has


def test_no_rooms_and_no_files_import_each_other() -> None:
    """Rooms can be put in an order in which each imports only earlier ones, and so can files."""
    assert_has_no_circle(ARROWS)
    assert_has_no_circle(IMPORTS)


def test_the_core_imports_no_room() -> None:
    """What every solve needs knows nothing of what some need."""
    assert not ARROWS["core"]


def test_the_front_door_offers_a_file_nothing_but_the_version() -> None:
    """Inside the package nobody imports from the package itself but its version; the rest is asked of the registry."""
    asked: set[str] = set()
    for file in FILES:
        depth = len(file.relative_to(PACKAGE).parts)
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module is None and node.level == depth:
                asked |= {alias.name for alias in node.names}
    assert asked - set(ARROWS) == {"__version__"}


@pytest.mark.parametrize(
    ("what", "name"), [(what, name) for what in OFFERS for name in OFFERS[what] if what != "ranks"]
)
def test_what_a_room_offers_is_there(what: str, name: str) -> None:
    """Everything on the front door's list can be had, but what needs ranks."""
    assert registry.ask(what, name) is not None


def test_a_room_that_is_not_here_is_named() -> None:
    """What a room offers that this installation lacks is refused with the room's name, and offered to nobody."""
    registry.offer("picture", {"lost": "lost.pictures:plot"})
    assert "lost" not in registry.offered("picture")
    assert registry.ask_or_none("picture", "lost") is None
    with pytest.raises(InvalidOption, match=r"offered by lost\.pictures, which this installation of lcp_plugin"):
        registry.ask("picture", "lost")


def test_the_house_has_few_floors() -> None:
    """The picture has at most 14 lines."""
    assert len(LINES) <= FLOORS


def test_picture_shows_every_room() -> None:
    """The picture names every room of the package once, and nothing else; each lies where its name says."""
    assert set(ARROWS) == {room_of(file) for file in FILES}
    assert all(folder.exists() for folder in FOLDERS.values())
    assert above("commands") == set()


def test_table_below_the_picture_explains_every_room() -> None:
    """The table explains each room of the picture once."""
    assert sorted(explained()) == sorted(ARROWS)


def test_import_loads_nothing_heavy() -> None:
    """``import lcp_plugin`` and building, certifying and pickling a problem load no heavy package."""
    code = (
        "import sys, lcp_plugin\n"
        f"heavy = {HEAVY!r}\n"
        "assert not [m for m in heavy if m in sys.modules], 'import'\n"
        "p = lcp_plugin.LCP([[2, 1], [1, 2]], [-1, 1]); lcp_plugin.Certificate.of(p, [0.5, 0])\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    assert printed_by(code) == "[]"


def test_a_solve_loads_no_package_it_does_not_use() -> None:
    """``solve`` loads numba and none of the other heavy packages."""
    code = (
        "import sys\nfrom lcp_plugin import LCP, solve\n"
        "solve(LCP([[2, 1], [1, 2]], [-1, 1])).require_solved()\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    assert printed_by(code) == "['numba']"


def test_public_names_resolve() -> None:
    """Every name in ``__all__`` can be had, also after the submodules were imported."""
    import lcp_plugin.core.solving.driver

    for name in lcp_plugin.__all__:
        assert getattr(lcp_plugin, name) is not None
    assert callable(lcp_plugin.solve)
    with pytest.raises(AttributeError, match="no attribute 'sovle'"):
        lcp_plugin.sovle  # noqa: B018


@pytest.mark.parametrize("name", REGISTRY)
def test_classes_are_had_where_readme_says(name: str) -> None:
    """``from lcp_plugin.algorithms import NPSOR`` gives the registered class, so for all; a wrong name is refused."""
    kind = algorithm_class(name)
    assert getattr(algorithms, kind.__name__) is kind
    with pytest.raises(AttributeError, match=f"no attribute '{kind.__name__}s'"):
        getattr(algorithms, f"{kind.__name__}s")


@pytest.mark.full
def test_star_import_needs_no_hypothesis() -> None:
    """``from lcp_plugin import *`` works without the extras; the strategies alone ask for hypothesis, in words."""
    code = (
        "import sys\nsys.modules['hypothesis'] = sys.modules['matplotlib'] = None\nfrom lcp_plugin import *\n"
        "print(solve(LCP([[2, 1], [1, 2]], [-1, 1])).status.name)\n"
        "import importlib, pydoc, lcp_plugin\n"
        "for ask in (lambda: lcp_plugin.strategies, lambda: importlib.import_module('lcp_plugin.strategies'),\n"
        "            lambda: pydoc.locate('lcp_plugin.strategies')):\n"
        "    try:\n        ask()\n    except Exception as error:\n        print(str(error).split('ImportError: ')[-1])"
    )
    solved, *asked = printed_by(code).splitlines()
    assert solved == "SOLVED"
    assert asked == 3 * ["lcp_plugin.strategies needs hypothesis; install it with: pip install 'lcp_plugin[test]'"]


def test_layers_ask_for_their_frameworks() -> None:
    """The help of ``lcp_plugin.doors.learn`` needs none of them; each layer says in words what to install."""
    code = (
        "import sys, importlib\nsys.modules['torch'] = sys.modules['jax'] = None\n"
        "import lcp_plugin.doors.learn\n"
        "for name in ('torch', 'jax'):\n"
        "    try:\n        importlib.import_module(f'lcp_plugin.doors.learn.{name}')\n"
        "    except ImportError as error:\n        print(error)"
    )
    needed = "lcp_plugin.doors.learn.{} needs {}; install it with: pip install 'lcp_plugin[learn]'"
    assert printed_by(code).splitlines() == [needed.format("torch", "PyTorch"), needed.format("jax", "JAX")]


def table_rows() -> dict[str, list[str]]:
    """The README's algorithm table: name → cells."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").split("## The algorithms")[1].split("\n## ")[0]
    lines = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| `")]
    return {cells[0].strip().strip("`"): [cell.strip() for cell in cells[1:]] for cells in lines}


def test_readme_table_is_the_registry() -> None:
    """The README's algorithm table has one row a registered algorithm, in order, and says what the class says."""
    from dataclasses import fields

    rows = table_rows()
    assert list(rows) == list(REGISTRY)
    for name, cells in rows.items():
        kind = algorithm_class(name)
        written = {option.strip() for option in cells[-1].split(",") if option.strip()}
        own = {field.name for field in fields(kind)}
        assert written == own, name
        assert cells[1:4] == [kind.assumption, kind.converges_on, kind.cost], name
        assert all((kind.__doc__, kind.assumption, kind.converges_on, kind.cost, kind.reference))
