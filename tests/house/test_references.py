"""References in docstrings and on pages resolve, and install commands use the clone."""

from __future__ import annotations

import ast
import importlib
import re
from functools import cache

from test_architecture import PACKAGE, ROOT, parsed

SOURCES = sorted(PACKAGE.rglob("*.py"))
PAGES = sorted([ROOT / "README.md", *(ROOT / "examples").rglob("*.md")])
ROLE = re.compile(r":(?:func|class|meth|mod|attr):`~?([^`]+)`")
HELP = re.compile(r'help\(["“]?(lcp_plugin[\w.]*)["”]?\)|help\((\w+)\)')
NEEDS_EXTRA = ("lcp_plugin.pyomo", "lcp_plugin.strategies")


@cache
def defined_names() -> frozenset[str]:
    """Return every function, class, method (``Class.method``) and module name of the package."""
    names = {file.stem if file.stem != "__init__" else file.parent.name for file in SOURCES}
    for file in SOURCES:
        for node in ast.walk(parsed(file)):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                names.add(node.name)
            if isinstance(node, ast.ClassDef):
                names |= {f"{node.name}.{one.name}" for one in node.body if hasattr(one, "name")}
    return frozenset(names)


def resolve(target: str) -> object:
    """Import the longest module prefix of a dotted name, and return the attribute after it."""
    parts = target.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            if not target.startswith(str(error.name)):
                return f"{error.name} is not installed"
            continue
        except ImportError as error:  # of a module that needs an optional package
            if "install it with" not in str(error):
                raise
            return str(error)
        for name in parts[count:]:
            fields = getattr(found, "__dataclass_fields__", {})
            found = fields[name] if name in fields else getattr(found, name)
        return found
    raise AssertionError(target)


def roles() -> list[tuple[str, str]]:
    """Return (file, target) of every role in the package."""
    return sorted(
        {
            (file.relative_to(ROOT).as_posix(), target)
            for file in SOURCES
            for target in ROLE.findall(file.read_text(encoding="utf-8"))
        }
    )


def test_role_with_a_full_name_resolves():
    """A full name in a role is a module of the package, or an attribute of one."""
    for target in {name for _, name in roles() if "lcp_plugin" in name}:
        assert resolve(target) is not None, target


def test_role_with_a_short_name_is_defined_in_the_package():
    """A short name in a role is the name of a function, class, method or module of the package."""
    short = {(file, name.strip(".~()")) for file, name in roles() if "lcp_plugin" not in name}
    assert {pair for pair in short if pair[1] not in defined_names()} == set()


def test_every_help_command_opens_a_page():
    """The target of help("…"), in a docstring or on a page, is a module with a docstring or a public name."""
    import lcp_plugin

    for file in (*SOURCES, *PAGES):
        for module, name in HELP.findall(file.read_text(encoding="utf-8")):
            if module in ("lcp_plugin.NAME", *NEEDS_EXTRA):
                continue
            found = resolve(module) if module else getattr(lcp_plugin, name)
            assert getattr(found, "__doc__", None), f"{file.name}: {module or name}"


def test_install_commands_use_the_clone():
    """No file installs lcp_plugin from an index: the name is not uploaded yet, so that a stranger could own it.

    Messages name the extra of the installed package in parentheses.
    """
    files = [*SOURCES, *PAGES, *(ROOT / "examples").glob("*.py")]
    for file in files:
        for command in re.findall(r"pip install [^`\n(]+", file.read_text(encoding="utf-8")):
            assert not re.search(r"lcp[_-]plugin", command), f"{file.name}: {command}"


def test_extras_of_install_commands_exist():
    """Every extra that a message or a page installs is defined in pyproject.toml."""
    import tomllib

    project = tomllib.loads(ROOT.joinpath("pyproject.toml").read_text(encoding="utf-8"))["project"]
    for file in (*SOURCES, *PAGES):
        for extra in re.findall(r"'\.\[(\w+)\]'", file.read_text(encoding="utf-8")):
            assert extra in project["optional-dependencies"], f"{file.name}: {extra}"


def test_examples_import_public_modules_only():
    """Each import of a script or a page is of a module that CHANGELOG.md lists as public.

    The stability atlas is a campaign on the package itself, and developing.md a page for contributors.
    """
    text = (ROOT / "examples" / "manual" / "CHANGELOG.md").read_text(encoding="utf-8")
    public = re.findall(r"`(lcp_plugin[\w.]*)`", text.partition("Everything else may")[0])
    files = {*PAGES, *(ROOT / "examples").rglob("*.py")}
    for file in files - {file for file in files if file.stem in ("stability_atlas", "developing")}:
        for module, names in re.findall(
            r"^ *(?:from|import) (lcp_plugin[\w.]*)(?: import (.+))?", file.read_text("utf-8"), re.M
        ):
            assert module in public or f"{module}.{names.split()[0]}" in public, (
                f"{file.name}: {module}"
            )
