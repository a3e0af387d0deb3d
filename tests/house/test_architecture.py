"""The figures in the manual are the import graph; the import is light."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest
from picture import ARROWS, DRAWN, FOLDERS, STOREYS, above, explained, subpackage_of
from tools.processes import printed_by

from lcp_plugin import algorithms
from lcp_plugin.algorithms import REGISTRY, algorithm_class

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "lcp_plugin"
HEAVY = (
    "numba",
    "pyamg",
    "cvxpy",
    "matplotlib",
    "hypothesis",
    "rich",
    "typer",
    "jinja2",
    "torch",
    "jax",
    "pyomo",
    "qpsolvers",
    "quantecon",
    "h5py",
)
# which contain only a docstring
FOLDERS_ALONE = ("__init__", "__main__", "methods", "problems", "interfaces")
LEADS_ON = {  # imports inside a function from a layer above: importing file, target, reason
    "core.lcp": (
        {"contact", "files", "modeling", "program_files", "programs", "ranks", "reformulations"},
        "LCP.from_qp, from_game, …, load and save are looked for where LCP is",
    ),
    "core.solving.lcp_run": (
        {"finishing"},
        "small rows of a point are finished where a run measures it",
    ),
    "core.solving.result": (
        {"proofs", "evidence"},
        "explain() says what may mislead, guarantee what is proved; plot() of every answer",
    ),
    "problems.parametric.path": ({"evidence"}, "plot() of a path"),
    "problems.parametric.tracing": ({"modeling"}, "trace takes a cvxpy problem as well"),
    "problems.cones.data": ({"files"}, "save() of a problem over cones"),
    "problems.cones.frictional_contact": ({"files"}, "save() of many worlds with contact"),
    "problems.programs.certification": (
        {"modeling", "nl", "pyomo"},
        "certify takes a model as well",
    ),
    "problems.sensitivity": ({"modeling"}, "derivative takes a cvxpy problem as well"),
    "problems.equilibria.branch_and_bound": (
        {"scip"},
        "SCIP is asked where it is installed, in expressions",
    ),
    "proofs.guarantees": (
        {"auto", "direct"},
        "convergence_guarantee takes what solve takes, a name or auto",
    ),
    "interfaces.files": ({"nl"}, "LCP.load and save take an .nl file as well"),
    "interfaces.nl.writing": ({"pyomo"}, "write_nl takes a Pyomo model as well"),
}


def module_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = sorted(
    file
    for file in PACKAGE.rglob("*.py")
    if subpackage_of(file) not in (*FOLDERS_ALONE, "__init__")
)
MODULES = {module_of(file): file for file in FILES}


def imported_modules(file: Path) -> tuple[set[str], set[str]]:
    """Return the modules of this package that a file imports, at the top and inside functions."""
    package = ["lcp_plugin", *file.relative_to(PACKAGE).parts[:-1]]
    found: tuple[set[str], set[str]] = (set(), set())
    waiting: list[tuple[ast.AST, bool]] = [(ast.parse(file.read_text(encoding="utf-8")), False)]
    while waiting:
        node, is_inside = waiting.pop()
        if isinstance(node, ast.expr):
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            waiting += [(child, is_inside) for child in node.orelse]
            continue
        is_inside |= isinstance(node, ast.FunctionDef)
        waiting += [(child, is_inside) for child in ast.iter_child_nodes(node)]
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            prefix = ".".join([*base, node.module] if node.module else base)
            targets = [
                name if (name := f"{prefix}.{alias.name}") in MODULES else prefix
                for alias in node.names
            ]
        else:
            continue
        found[is_inside].update(
            {target for target in targets if target in MODULES} - {module_of(file)}
        )
    return found


@cache
def imports_of_all() -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Return the imports inside functions that lead on, and all others, which the figure shows, by module."""
    both = {module: imported_modules(file) for module, file in MODULES.items()}
    table = {one for one in MODULES if one.startswith("lcp_plugin.methods.")}
    led, shown = {}, {}
    for module, (plain, inside) in both.items():
        known = LEADS_ON.get(module.removeprefix("lcp_plugin."), (set(), ""))[0]
        led[module] = {target for target in inside if subpackage_of(MODULES[target]) in known}
        shown[module] = plain | inside - led[module]
    shown["lcp_plugin.algorithms"] |= table
    return led, shown


def assert_has_no_circle(imports: dict[str, set[str]]) -> None:
    waiting = dict(imports)
    while waiting:
        ready = {one for one, targets in waiting.items() if not targets & waiting.keys()}
        assert ready, f"in a circle: {sorted(waiting)}"
        waiting = {one: targets for one, targets in waiting.items() if one not in ready}


def test_arrows_stand_in_the_picture() -> None:
    """A file imports from its own subpackage, from the core, and from where the arrows lead, in functions too."""
    for module, file in MODULES.items():
        subpackage = subpackage_of(file)
        assert subpackage in ARROWS, (
            f"the picture in developing.md and the table below it lack {subpackage}"
        )
        for target in imports_of_all()[1][module]:
            allowed = {subpackage, "core", *ARROWS[subpackage]}
            assert subpackage_of(MODULES[target]) in allowed, f"{module} → {target}"


def test_every_arrow_is_needed() -> None:
    """The figure has no arrow without an import."""
    drawn = {(subpackage, target) for subpackage, targets in ARROWS.items() for target in targets}
    has = {
        (subpackage_of(MODULES[one]), subpackage_of(MODULES[other]))
        for one, targets in imports_of_all()[1].items()
        for other in targets
    }
    assert not drawn - has


def test_imports_that_lead_on_are_few_and_have_a_reason() -> None:
    """Every import inside a function from a layer above is listed with its reason."""
    led = {
        module.removeprefix("lcp_plugin."): {subpackage_of(MODULES[target]) for target in targets}
        for module, targets in imports_of_all()[0].items()
        if targets
    }
    assert led == {module: subpackages for module, (subpackages, _) in LEADS_ON.items()}
    assert all(why for _, why in LEADS_ON.values())


def test_no_subpackages_and_no_files_import_each_other() -> None:
    """Subpackages have an order in which each imports only earlier ones, as files have."""
    assert_has_no_circle(ARROWS)
    assert_has_no_circle(imports_of_all()[1])


def test_the_package_offers_a_file_nothing_but_the_version() -> None:
    """Inside the package only the version is imported from the package itself."""
    names: set[str] = set()
    for file in FILES:
        depth, text = len(file.relative_to(PACKAGE).parts), file.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if f"from {depth * '.'} import" in text else ():
            if isinstance(node, ast.ImportFrom) and node.module is None and node.level == depth:
                names |= {alias.name for alias in node.names}
    assert names - set(ARROWS) == {"__version__"}


def test_the_storeys_of_the_readme_hold() -> None:
    """Each subpackage is on one line of the figure of layers, and imports nothing from a line below."""
    storey = {name: k for k, names in enumerate(STOREYS) for name in names}
    for k, names in enumerate(
        STOREYS
    ):  # a folder stands for those subpackages inside it that no line names
        storey |= {name: k for name in names if not any(name in STOREYS[j] for j in range(k))}
    assert set(storey) == set(ARROWS)
    assert [
        (one, other)
        for one, targets in ARROWS.items()
        for other in targets
        if storey[other] > storey[one]
    ] == []


def test_picture_shows_every_subpackage() -> None:
    """The figure contains every subpackage once, at the path of its name."""
    assert set(ARROWS) == {subpackage_of(file) for file in FILES}
    assert all(folder.exists() for folder in FOLDERS.values())
    assert above("commands") == set()


def test_table_below_the_picture_explains_every_subpackage() -> None:
    """The table explains each name of the figure once."""
    assert sorted(explained()) == sorted(DRAWN)


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
    """``solve`` of a small problem loads none of the heavy packages."""
    code = (
        "import sys\nfrom lcp_plugin import LCP, solve\n"
        "solve(LCP([[2, 1], [1, 2]], [-1, 1])).require_solved()\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    assert printed_by(code) == "[]"


@pytest.mark.parametrize("name", REGISTRY)
def test_classes_are_had_where_readme_says(name: str) -> None:
    """``from lcp_plugin.algorithms import NPSOR`` gives the registered class."""
    kind = algorithm_class(name)
    assert getattr(algorithms, kind.__name__) is kind
    assert kind.name == name
    with pytest.raises(AttributeError, match=f"no attribute '{kind.__name__}s'"):
        getattr(algorithms, f"{kind.__name__}s")


@pytest.mark.full
def test_star_import_needs_no_hypothesis() -> None:
    """``from lcp_plugin import *`` works without extras; only the strategies require hypothesis."""
    code = (
        "import sys\nsys.modules['hypothesis'] = sys.modules['matplotlib'] = None\nfrom lcp_plugin import *\n"
        "print(solve(LCP([[2, 1], [1, 2]], [-1, 1])).status.name)\n"
        "import importlib, pydoc, lcp_plugin\n"
        "for ask in (lambda: lcp_plugin.strategies, lambda: importlib.import_module('lcp_plugin.strategies'),\n"
        "            lambda: pydoc.locate('lcp_plugin.strategies')):\n"
        "    try:\n        ask()\n    except Exception as error:\n        print(str(error).split('ImportError: ')[-1])"
    )
    solved, *errors = printed_by(code).splitlines()
    assert solved == "SOLVED"
    assert errors == 3 * [
        "lcp_plugin.strategies needs hypothesis; install it with: pip install hypothesis (or lcp_plugin[test])"
    ]


@pytest.mark.full
def test_layers_ask_for_their_frameworks() -> None:
    """The help of ``lcp_plugin.interfaces.learn`` needs no framework; layers name it."""
    code = (
        "import sys, importlib\nsys.modules['torch'] = sys.modules['jax'] = None\n"
        "import lcp_plugin.interfaces.learn\n"
        "for name in ('torch', 'jax'):\n"
        "    try:\n        importlib.import_module(f'lcp_plugin.interfaces.learn.{name}')\n"
        "    except ImportError as error:\n        print(error)"
    )
    needed = "lcp_plugin.interfaces.learn.{} needs {}; install it with: pip install {}"
    assert printed_by(code).splitlines() == [
        needed.format("torch", "PyTorch", "torch (or lcp_plugin[torch])"),
        needed.format("jax", "JAX", "jax (or lcp_plugin[jax])"),
    ]


def table_rows() -> dict[str, list[str]]:
    """The manual's table of algorithms: name → cells."""
    text = (ROOT / "examples" / "manual" / "algorithms.md").read_text(encoding="utf-8")
    lines = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| `")]
    return {cells[0].strip().strip("`"): [cell.strip() for cell in cells[1:]] for cells in lines}


def test_the_table_of_algorithms_is_the_registry() -> None:
    """Each row of the manual's table of algorithms agrees with its class."""
    from dataclasses import fields

    rows = table_rows()
    assert set(rows) == set(REGISTRY)
    for name, cells in rows.items():
        kind = algorithm_class(name)
        written = {option.strip() for option in cells[-1].split(",") if option.strip()}
        own = {field.name for field in fields(kind)}
        assert written == own, name
        assert cells[2:5] == [kind.needs, kind.solves, kind.cost], name
        assert all((kind.__doc__, kind.needs, kind.solves, kind.cost, kind.reference))
