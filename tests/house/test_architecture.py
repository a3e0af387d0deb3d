"""The house of the manual is the import graph: files import from lower floors only; the import is light.

``python tests/house/test_architecture.py`` prints the numbers of the house.
"""

from __future__ import annotations

import ast
import re
import runpy
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import lcp_plugin
from lcp_plugin import algorithms
from lcp_plugin.algorithms import REGISTRY, algorithm_class
from lcp_plugin.core.kernels import floats
from lcp_plugin.core.problem_classes import DOORS

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "lcp_plugin"
PAGE = (ROOT / "examples" / "manual" / "developing.md").read_text(encoding="utf-8")
HEAVY = (
    *("numba", "pyamg", "cvxpy", "matplotlib", "hypothesis", "rich", "typer", "jinja2", "torch"),
    *("jax", "casadi", "pyomo", "qpsolvers", "quantecon", "h5py"),
)
LAZY = 16  # imports of package files inside functions, which are for weight
# lines with vars(…) or __dict__: what they write, a reader does not find by its name
MOST_WRITES = 10
LARGE = 150  # lines of code, without docstrings, that a reader holds together
LARGE_CLASSES = {
    *("Statement", "Model", "RowData", "EquilibriumProgram", "AgentProgram", "FreeSystem"),
    *("BranchAndBound", "LCPRun", "ProgramRun", "_Model", "ConeRun", "_Reader", "ExactSimplex"),
    *("QuadraticProgram", "LemkePath", "JosephyNewton"),
}
LONG = 45  # lines of code of a function
REASONS = {
    "minimum_degree": "a kernel: the quotient graph lives in arrays that each step of the order changes",
    "follow_paths": "a kernel: a call per pivot costs more than the pivots of a small problem",
    "bound_residuals": "a kernel: the criterion of many problems in one pass over each row",
    "_update_rows": "a kernel: residual, sweep and products in one pass over the rows",
    "cross_validate": "the reasons for agree, mismatch and not comparable, in their order",
    "regression_of": "the conditions under which a program states a regression, in their order",
    "certify": "one verb for all classes and models, each with its refusal",
    "_next_vertex": "a kernel: one step of many paths, traced as one expression",
}
# names that play one role in several files: the reader who knows one knows all
ROLES = {
    **dict.fromkeys(("solve", "analyze", "solve_lcp", "solve_stack"), "a verb, its command, JAX's"),
    **dict.fromkeys(("main", "run"), "the start of a command"),
    **dict.fromkeys(("certify_model", "solve_model"), "of models of cvxpy, of Pyomo"),
    **dict.fromkeys(("lcp_layer", "qp_layer", "contact_layer"), "of JAX, of PyTorch"),
    **dict.fromkeys(("criterion_at", "verdict_at", "first_point", "planned"), "of a problem class"),
    "ADVICE": "texts of the statuses of a problem class",
}
MOST_OF_ANY = 600  # signatures that say ": Any": a class or a protocol says more
MOST_CONSTANTS = 215  # numbers with a name: a reader has to carry each from file to file


def module_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(file): file for file in sorted(PACKAGE.rglob("*.py"))}


@cache
def parsed(file: Path) -> ast.Module:
    """Return the syntax tree of a file, which several tests walk."""
    return ast.parse(file.read_text(encoding="utf-8"))


def floors() -> list[list[str]]:
    """Return the rooms of each floor in the picture, the highest floor first."""
    picture = re.search(r"```text\n(.*?)```", PAGE, re.S)
    assert picture
    return [re.findall(r"\w+", line) for line in picture[1].splitlines()]


def room_of(module: str) -> str:
    """Return the room of a file; the package's own file, which has the version, is below all."""
    return module.split(".")[1] if "." in module else ""


def imports_of(file: Path) -> Iterator[tuple[str, bool]]:
    """Yield the package's modules that a file imports, for type checkers too, and whether in a function."""
    package = ["lcp_plugin", *file.relative_to(PACKAGE).parts[:-1]]
    waiting: list[tuple[ast.AST, bool]] = [(parsed(file), False)]
    while waiting:
        node, is_inside = waiting.pop()
        is_inside |= isinstance(node, ast.FunctionDef)
        waiting += [(child, is_inside) for child in ast.iter_child_nodes(node)]
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            prefix = ".".join([*base, node.module] if node.module else base)
            names = [f"{prefix}.{alias.name}" for alias in node.names]
            yield from {(name if name in FILES else prefix, is_inside) for name in names}


@cache
def imports() -> tuple[tuple[str, str, bool], ...]:
    """Return (importing module, imported module, whether inside a function)."""
    return tuple(
        (module, target, is_inside)
        for module, file in FILES.items()
        for target, is_inside in imports_of(file)
        if target in FILES and target != module
    )


def upward() -> list[tuple[str, str]]:
    """Return the imports from a higher floor, or from another room of the same floor."""
    level = {room: -k for k, rooms in enumerate(floors()) for room in rooms}
    # all may import the version, the top fills a table
    below, above = (level | {"": -99}, level | {"": 1})
    return [
        (one, other)
        for one, other, _ in imports()
        if room_of(one) != room_of(other) and below[room_of(other)] >= above[room_of(one)]
    ]


def circles() -> list[list[str]]:
    """Return the files of each circle of imports, inside functions and for type checkers included."""
    place = {module: k for k, module in enumerate(FILES)}
    pairs = np.array([(place[one], place[other]) for one, other, _ in imports()]).T
    graph = csr_array((np.ones(pairs.shape[1]), pairs), shape=(len(place), len(place)))
    labels = connected_components(graph, connection="strong")[1]
    found = [np.flatnonzero(labels == k) for k in np.flatnonzero(np.bincount(labels) > 1)]
    return [[[*FILES][k] for k in one] for one in found]


def constants() -> Iterator[tuple[Path, ast.Assign, str, float]]:
    """Yield the numeric constants of all modules: file, statement, name, value."""
    for file in FILES.values():
        for node in parsed(file).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                try:
                    value = eval(ast.unparse(node.value), {"__builtins__": {}}, vars(floats))
                except Exception:
                    continue
                if isinstance(value, (int, float)) and not isinstance(value, bool):
                    yield file, node, node.targets[0].id, float(value)


def values_of_constants() -> dict[str, set[float]]:
    """Return the values of the numeric constants of all modules, by name."""
    found: dict[str, set[float]] = defaultdict(set)
    for _, _, name, value in constants():
        found[name].add(value)
    return found


def definitions() -> Iterator[tuple[str, str]]:
    """Yield (name, text) of the functions, classes, constants and aliases that modules define at their top level."""
    for node in (node for file in FILES.values() for node in parsed(file).body):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, f"{node.lineno} {ast.unparse(node)}"
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                is_several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                pairs = (
                    zip(target.elts, node.value.elts, strict=True)
                    if is_several
                    else [(target, node.value)]
                )
                yield from ((ast.unparse(one), ast.unparse(value)) for one, value in pairs)


def names_with_two_meanings() -> list[str]:
    """Return the names that modules define with different texts, except roles, ``__all__`` and the like."""
    texts: dict[str, set[str]] = defaultdict(set)
    for name, text in definitions():
        texts[name].add(text)
    twice = [name for name, found in texts.items() if len(found) > 1]
    return sorted(name for name in twice if name not in ROLES and not name.startswith("__"))


def test_a_name_means_one_thing():
    """A name, public or private, is defined with one text in all modules, or has one role in them."""
    assert names_with_two_meanings() == []


def test_a_number_has_one_name_and_one_value():
    """No name of a numeric constant has two values, and there are few such names."""
    found = values_of_constants()
    assert [name for name, values in found.items() if len(values) > 1] == []
    assert len(found) <= MOST_CONSTANTS


def test_a_number_with_a_name_has_a_reason():
    """A comment beside or above each numeric constant, or a text below it, says why it has this value."""
    for file, node, name, _ in constants():
        lines = file.read_text(encoding="utf-8").splitlines()
        around = lines[node.lineno - 2 : node.end_lineno + 1]
        assert "#" in "".join(around[:-1]) or around[-1].startswith('"""'), (file, name)


def test_no_import_leads_up():
    """A file imports from its own room and from lower floors, also inside functions and for type checkers."""
    assert upward() == []


def test_no_files_import_each_other():
    """Files have an order in which each imports only earlier ones, also inside functions and for type checkers."""
    assert circles() == []


def test_editors_and_python_have_the_same_public_names():
    """The stub, which editors read, and the table, from which names load, have the same names with one home each."""
    lines = PACKAGE.joinpath("__init__.pyi").read_text(encoding="utf-8").splitlines()
    stub = {
        words[-1]: words[1][1:] or words[-1] for words in map(str.split, lines) if "as" in words
    }
    assert stub == {name: home for name, home in lcp_plugin._HOME.items() if name != "LCP"}


def doors() -> tuple[set[tuple[str, str]], set[str]]:
    """Return (class, name) of each Door, and the verbs that are looked up for models of other packages."""
    found, verbs = set(), set()
    for node in (node for file in FILES.values() for node in ast.walk(parsed(file))):
        if isinstance(node, ast.ClassDef):
            lines = [one for one in ast.walk(node) if isinstance(one, ast.Assign)]
            names = [ast.unparse(one).split("=")[0] for one in lines if "Door(" in ast.unparse(one)]
            found |= {(node.name, name) for one in names for name in re.findall(r"\w+", one)}
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "foreign_function":
            verbs.add(node.args[0].value)
    return found, verbs


def test_each_door_is_read():
    """DOORS has the doors of classes and verbs that are looked up for models, and no key that is never looked up."""
    found, verbs = doors()
    assert {key for key in DOORS if key[1] not in verbs} == found


def lines_with(words):
    """Return the lines of all files that match a regular expression."""
    lines = "\n".join(file.read_text(encoding="utf-8") for file in FILES.values()).splitlines()
    return [line for line in lines if re.search(words, line)]


def test_frozen_objects_are_written_by_their_constructors():
    """Data of an object are written by its class, and few lines read or write all of them at once."""
    assert lines_with(r"object\.__setattr__\(|setattr\(result") == []
    assert len(lines_with(r"\bvars\(|\b__dict__\b")) <= MOST_WRITES


def test_one_file_reads_the_time():
    """Clocks and limits are in core/deadline: no other file reads the time."""
    words = re.compile(r"perf_counter|monotonic\(|time\.time\(")
    assert [f.name for f in FILES.values() if words.search(f.read_text("utf-8"))] == ["deadline.py"]


def sizes_of(kind):
    """Return (lines of code, syntax node) of the large classes or functions, the largest first."""
    count, sizes = runpy.run_path(str(ROOT / ".ci" / "count.py"))["count"], []
    for file in FILES.values():
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        for node in parsed(file).body:
            if isinstance(node, kind) and node.end_lineno - node.lineno > 40:
                sizes.append((count("".join(lines[node.lineno - 1 : node.end_lineno]))[0], node))
    return sorted(sizes, key=lambda one: one[0], reverse=True)


def test_large_classes_and_functions_do_not_become_more():
    """Each class of more than 150 lines of code is listed, its docstring has a reason; long functions have reasons."""
    large = {node.name: node for size, node in sizes_of(ast.ClassDef) if size > LARGE}
    assert large.keys() - LARGE_CLASSES == set()
    reason = "It is one class because"
    assert [name for name in large if reason not in (ast.get_docstring(large[name]) or "")] == []
    long = {node.name for size, node in sizes_of(ast.FunctionDef) if size > LONG}
    assert long - REASONS.keys() == set()


def test_few_signatures_say_any():
    """Few annotations are Any: most name a class, an alias of arrays or matrices, or a protocol."""
    assert sum(len(re.findall(r": Any\b", line)) for line in lines_with(": Any")) <= MOST_OF_ANY


def test_few_imports_are_inside_functions():
    """Imports of package files inside functions are few: they are for weight, not for order."""
    assert sum(is_inside for _, _, is_inside in imports()) <= LAZY


def test_the_package_offers_a_file_nothing_but_the_version():
    """Inside the package only the version is imported from the package itself."""
    rooms = {room_of(module) for module in FILES}
    names = set()
    for file in FILES.values():
        depth = len(file.relative_to(PACKAGE).parts)
        for node in ast.walk(parsed(file)):
            if isinstance(node, ast.ImportFrom) and node.module is None and node.level == depth:
                names |= {alias.name for alias in node.names}
    assert names - rooms == {"__version__"}


def test_the_picture_and_its_table_have_every_room_once():
    """The picture of the floors and the table below it name every room once."""
    rooms = sorted({room_of(module) for module in FILES} - {"", "__main__"})
    rows = PAGE.split("| room | contents |")[1].split("\n\n")[0].splitlines()[2:]
    assert sorted(room for floor in floors() for room in floor if room != "__main__") == rooms
    assert (
        sorted(room for row in rows for room in re.findall(r"`(\w+)`", row.split("|")[1])) == rooms
    )


@pytest.mark.parametrize(
    "use",
    [
        "p = lcp_plugin.LCP([[2, 1], [1, 2]], [-1, 1]); lcp_plugin.Certificate.of(p, [0.5, 0])",
        "lcp_plugin.solve(lcp_plugin.LCP([[2, 1], [1, 2]], [-1, 1])).require_solved()",
    ],
    ids=["certificate", "solve"],
)
def test_import_and_use_load_nothing_heavy(use):
    """``import lcp_plugin``, and to certify or solve a small problem, loads none of the heavy packages."""
    loaded = f"[m for m in {HEAVY!r} if m in sys.modules]"
    code = f"import sys, lcp_plugin\nassert not {loaded}\n{use}\nprint({loaded})"
    from tools.processes import printed_by  # pytest adds the folder of tests to the path

    assert printed_by(code) == "[]"


@pytest.mark.parametrize("name", REGISTRY)
def test_classes_are_had_where_readme_says(name):
    """``from lcp_plugin.algorithms import NPSOR`` gives the registered class."""
    kind = algorithm_class(name)
    assert getattr(algorithms, kind.__name__) is kind
    assert kind.name == name
    with pytest.raises(AttributeError, match=f"no attribute '{kind.__name__}s'"):
        getattr(algorithms, f"{kind.__name__}s")


def table_rows() -> dict[str, list[str]]:
    """The manual's table of algorithms: name → cells."""
    text = (ROOT / "examples" / "manual" / "algorithms.md").read_text(encoding="utf-8")
    lines = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| `")]
    return {cells[0].strip().strip("`"): [cell.strip() for cell in cells[1:]] for cells in lines}


def test_the_table_of_algorithms_is_the_registry():
    """Each row of the manual's table of algorithms agrees with its class."""
    from dataclasses import fields

    rows = table_rows()
    assert set(rows) == set(REGISTRY)
    for name, cells in rows.items():
        kind = algorithm_class(name)
        written = {option.strip() for option in cells[-1].split(",") if option.strip()}
        own = {field.name for field in fields(kind)}
        assert written == own, name
        assert cells[2:4] == [kind.needs, kind.solves], name
        assert all((kind.__doc__, kind.needs, kind.solves, kind.cost, kind.reference))


def print_numbers() -> None:
    """Print the numbers of the house."""
    values = values_of_constants()
    print(f"files: {len(FILES)}")
    print(f"largest circle of files: {max(map(len, circles()), default=1)}")
    print(f"upward imports: {len(upward())}")
    print(f"package imports inside functions: {sum(inside for _, _, inside in imports())}")
    print(f"numeric module constants: {sum(map(len, values.values()))}")
    twice = {name: found for name, found in values.items() if len(found) > 1}
    print(f"names with several values: {len(twice)}", *sorted(twice))
    print("names with two meanings:", *names_with_two_meanings())
    texts = [file.read_text(encoding="utf-8") for file in FILES.values()]
    for words in (r"\bvars\(", r"\b__dict__\b", r": Any\b"):
        print(f"{words}: {sum(len(re.findall(words, text)) for text in texts)}")
    for kind in (ast.ClassDef, ast.FunctionDef):
        largest = (f"{node.name} {size}" for size, node in sizes_of(kind)[:10])
        print(f"largest of type {kind.__name__}, in lines of code:", *largest)


if __name__ == "__main__":
    print_numbers()
