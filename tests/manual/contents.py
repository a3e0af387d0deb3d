"""What the manual holds: pages in Markdown, subjects, pages of names and of help, and where each name is found."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from public_names import ELSEWHERE

import lcp_plugin
from lcp_plugin.algorithms import REGISTRY, algorithm_class

EXAMPLES = Path(__file__).parents[2] / "examples"
TRADES = (  # in examples/manual: the problem, its code and picture, what was checked and the time, on one screen
    "options",
    "contact",
    "equilibria",
    "obstacle",
    "data",
    "control",
    "games",
    "which_algorithm",
)
GUIDES = (
    "first_model",
    *TRADES,
    "what_is_proved",
    "layers",
    "many_machines",
)  # in the order in which they are read
TO_LOOK_UP = (
    "solved",
    "algorithms",
    "promises",
    "speed",
    "limits",
    "architecture",
)  # tables, in examples/manual
SUBJECTS = {  # subject: what it is about, and the subpackages whose names and pages it shows; the longest match counts
    "solve": (
        "Solve: problems, methods, what comes back",
        "core algorithms api auto methods problems",
    ),
    "model": (
        "Model: in cvxpy, as a program, a game, an equation",
        "modeling problems.programs problems.reformulations",
    ),
    "prove": (
        "Prove: a matrix, a method, an error, an answer",
        "proofs core.certificates methods.search problems.programs.certification problems.programs.certification",
    ),
    "batch": (
        "Batch: many problems at once",
        "problems.batches problems.march problems.programs.stacked_programs",
    ),
    "differentiate": (
        "Differentiate: how the answer changes",
        "interfaces.learn problems.sensitivity",
    ),
    "measure": ("Measure: scenes, pictures, tests of solvers", "gallery evidence strategies"),
    "interfaces": (
        "Interfaces: other languages, files, machines",
        "interfaces pyomo ranks commands",
    ),
}
TOGETHER = ("core.errors",)  # a subpackage whose names stand on one page


def subject_of(subpackage: str) -> str:
    """Return the subject that shows a subpackage's names."""
    fits = [
        (len(own), subject)
        for subject, (_, subpackages) in SUBJECTS.items()
        for own in subpackages.split()
        if f"{subpackage}.".startswith(f"{own}.")
    ]
    if not fits:
        raise LookupError(
            f"no subject of the manual shows lcp_plugin.{subpackage}: add it to SUBJECTS in {__file__}"
        )
    return max(fits)[1]


def is_function(thing: Any) -> bool:
    """Whether it is a function or method, and no property."""
    return inspect.isfunction(thing) or inspect.ismethod(thing)


def is_member(thing: Any) -> bool:
    """Whether it is a method or a property."""
    return is_function(thing) or isinstance(thing, (property, cached_property))


def members_of(thing: Any) -> dict[str, Any]:
    """Return the public methods and properties of a class with a docstring, inherited ones of ours too."""
    if not inspect.isclass(thing):
        return {}
    ours = [base for base in reversed(thing.__mro__) if base.__module__.startswith("lcp_plugin")]
    found = {name: getattr(thing, name) for base in ours for name in vars(base) if name[0] != "_"}
    told = {
        name: member
        for name, member in found.items()
        if is_member(member) and inspect.getdoc(member)
    }
    return dict(
        sorted(told.items(), key=lambda item: is_function(item[1]))
    )  # what it is, then what it does


@dataclass
class Page:
    """A page of one name, or of a module with the names that stand there."""

    name: str  # as one writes it after "lcp_plugin."
    subpackage: str
    thing: Any
    entries: dict[str, Any] = field(default_factory=dict)

    @property
    def address(self) -> str:
        """The file; Derivative and derivative are two on every system."""
        return f"{'class.' if inspect.isclass(self.thing) else ''}{self.name}.html"

    @property
    def is_help(self) -> bool:
        """Whether it is a module's help, and not a function or class."""
        return inspect.ismodule(self.thing)

    @property
    def purpose(self) -> str:
        """What help(lcp_plugin) says of a help page; "" of another page."""
        found = re.search(rf'help\("lcp_plugin\.{self.name}"\)``: (.*)', lcp_plugin.__doc__ or "")
        return found[1] if found and self.is_help else ""

    def anchors(self) -> Iterator[tuple[str, str]]:
        """Yield each name that is told here, and its address."""
        yield self.name, self.address
        yield f"lcp_plugin.{self.name}", self.address
        home = f"lcp_plugin.{self.subpackage}"
        yield home if self.is_help else f"{home}.{self.name}", self.address
        things = self.entries or {self.name: self.thing}
        for name, thing in things.items():
            if self.entries:
                yield from (
                    (f"{start}{name}", f"{self.address}#{name}") for start in ("", f"{home}.")
                )
                yield f"{self.name}.{name}", f"{self.address}#{name}"
            for member in members_of(thing):
                for start in ("", "lcp_plugin."):
                    yield f"{start}{name}.{member}", f"{self.address}#{name}.{member}"


def help_page(subpackage: str, entries: dict[str, Any], name: str = "") -> Page:
    """Return the page of a module."""
    return Page(name or subpackage, subpackage, import_module(f"lcp_plugin.{subpackage}"), entries)


def pages() -> list[Page]:
    """Return every page but those of examples and subjects: first what is a help page, then the names."""
    homes = lcp_plugin._HOME
    subpackages = {
        name: {} for name in re.findall(r'help\("lcp_plugin\.([\w.]+)"\)', lcp_plugin.__doc__ or "")
    }
    for subpackage, names in ELSEWHERE.items():
        module = import_module(f"lcp_plugin.{subpackage}")
        subpackages.setdefault(subpackage, {}).update(
            {name: getattr(module, name) for name in names.split()}
        )
    subpackages["algorithms"] |= {
        algorithm_class(name).__name__: algorithm_class(name) for name in REGISTRY
    }
    alone, names = [], {}
    for name, home in homes.items():
        thing = getattr(lcp_plugin, name)
        if inspect.ismodule(thing):
            subpackages.setdefault(home, {}).update(
                {each: getattr(thing, each) for each in thing.__all__}
            )
            names[home] = name
        elif home in TOGETHER:
            subpackages.setdefault(home, {})[name] = thing
        else:
            alone.append(Page(name, home, thing))
    found = [
        help_page(home, entries, names.get(home, "")) for home, entries in subpackages.items()
    ] + alone
    return found + further(found)


def further(found: list[Page]) -> list[Page]:
    """Return the pages that others name as help("lcp_plugin.…"), in turn."""
    told = " ".join(inspect.getdoc(thing) or "" for page in found for thing in told_on(page))
    subpackages = dict.fromkeys(re.findall(r'help\("lcp_plugin\.([\w.]+)"\)', told))
    there = {page.subpackage for page in found if page.is_help}
    new = [help_page(subpackage, {}) for subpackage in subpackages if subpackage not in there]
    return new + further(found + new) if new else []


def told_on(page: Page) -> Iterator[Any]:
    """Yield everything whose docstring stands on a page."""
    yield page.thing
    for thing in page.entries.values() or [page.thing]:
        yield thing
        yield from members_of(thing).values()


@dataclass
class Guide:
    """A page that leads through a subject, with code that a test runs and what it prints."""

    name: str

    @cached_property
    def source(self) -> str:
        """The file, in Markdown."""
        return (EXAMPLES / "manual" / f"{self.name}.md").read_text(encoding="utf-8")

    @property
    def address(self) -> str:
        """The file that is written."""
        return f"guide.{self.name}.html"

    @property
    def title(self) -> str:
        """The first line."""
        return self.source.partition("\n")[0].removeprefix("# ")

    @property
    def body(self) -> str:
        """What stands below the title, its links leading to pages of the site."""
        text = re.sub(
            r"\]\(\.\./pictures/(\w+\.png)\)", r"](examples/\1)", self.source.partition("\n")[2]
        )
        text = re.sub(r"\]\(\.\./(\w+)\.py\)", r"](examples/\1.html)", text)
        return re.sub(r"\]\((\w+)\.md(#[\w-]+)?\)", r"](guide.\1.html)", text)

    @property
    def picture(self) -> str:
        """The first picture's file; a guide without one is none."""
        return re.findall(r"^!\[.*\]\((\S+)\)$", self.body, re.M)[0]


def guides() -> list[Guide]:
    """Return the guides in their order."""
    return [Guide(name) for name in GUIDES]


def to_look_up() -> list[Guide]:
    """Return the pages of tables in their order."""
    return [Guide(name) for name in TO_LOOK_UP]


@dataclass
class Example:
    """A script with its story, and what its table says of it."""

    name: str
    shows: str
    compared: str

    @cached_property
    def source(self) -> str:
        """The file as it is."""
        return (EXAMPLES / f"{self.name}.py").read_text(encoding="utf-8")

    @property
    def address(self) -> str:
        """The file, in a folder beside the picture."""
        return f"examples/{self.name}.html"

    def uses(self, name: str) -> bool:
        """Whether the script imports a public name from lcp_plugin itself."""
        imports = re.findall(r"^from lcp_plugin import (.+)$", self.source, re.M)
        return any(name in line.split(", ") for line in imports)


def examples() -> list[Example]:
    """Return the examples in the order of their table."""
    table = EXAMPLES.joinpath("README.md").read_text(encoding="utf-8")
    return [
        Example(*row) for row in re.findall(r"^\| `(\w+)\.py` \| (.*?) \| (.*?) \|$", table, re.M)
    ]
