"""Algorithms of other packages: found by name through entry points, checked, and never in the way."""

from __future__ import annotations

import importlib.metadata
import itertools
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import lcp_plugin
from lcp_plugin import LCP, InvalidOption, UnknownAlgorithm, solve
from lcp_plugin.algorithms import (
    REGISTRY,
    Algorithm,
    Step,
    algorithm_class,
    class_from_outside,
    create,
    from_other_packages,
)
from lcp_plugin.commands.cli import app
from lcp_plugin.engines import ENGINES

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT.joinpath("examples", "add_an_algorithm.py").read_text(encoding="utf-8")
PROBLEM = LCP([[4, -1], [-1, 4]], [-3, 5])
Install = Callable[..., str]
COUNT = itertools.count()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a one-file package on a path of its own: install(text, name, attribute) → the module's name."""

    def installed(text: str, name: str, attribute: str = "Kind", package: str = "") -> str:
        module = f"installed_module_{next(COUNT)}"
        package = package or module.replace("_", "-")
        folder = tmp_path / package
        folder.mkdir()
        (folder / f"{module}.py").write_text(text, encoding="utf-8")
        info = folder / f"{package.replace('-', '_')}-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n", encoding="utf-8"
        )
        entry = f"[lcp_plugin.algorithms]\n{name} = {module}{':' if attribute else ''}{attribute}\n"
        (info / "entry_points.txt").write_text(entry, encoding="utf-8")
        monkeypatch.syspath_prepend(str(folder))
        return module

    class_from_outside.cache_clear()
    yield installed
    class_from_outside.cache_clear()


def test_an_installed_algorithm_is_found_by_name(install: Install) -> None:
    """The class of the example, installed as a package, works by its name as a built-in one does, options included."""
    install(EXAMPLE, "extragradient", "Extragradient")
    result = solve(PROBLEM, "extragradient", step=0.5)
    assert result.is_solved
    assert result.algorithm == "extragradient"
    assert np.allclose(result.z, [0.75, 0.0], atol=1e-7)
    assert create("extragradient", {"step": 0.5}) == algorithm_class("extragradient")(step=0.5)  # type: ignore[call-arg]
    with pytest.raises(
        InvalidOption, match=r"extragradient has no option 'stpe'; did you mean 'step'\?"
    ):
        solve(PROBLEM, "extragradient", stpe=0.5)


def test_the_command_runs_it(install: Install) -> None:
    """`solve -a` runs it, with its options."""
    install(EXAMPLE, "extragradient", "Extragradient")
    ran = CliRunner().invoke(
        app, ["solve", "half_active:n=4", "-a", "extragradient", "-o", "step=0.5"]
    )
    assert ran.exit_code == 0, ran.output


def test_an_option_without_default_is_asked_for(install: Install) -> None:
    """Where an algorithm has an option without default the error names it."""
    install(NEEDY, "needy", "Kind")
    with pytest.raises(
        InvalidOption, match=r"^needy needs a value for step, which has no default; give one$"
    ):
        solve(PROBLEM, "needy")
    assert solve(PROBLEM, "needy", step=0.5, max_iterations=1).algorithm == "needy"


def test_a_misspelt_name_is_guessed(install: Install) -> None:
    """did-you-mean knows the names that other packages offer, and loads none of them for that."""
    install("raise RuntimeError('loaded')", "extragradient")
    with pytest.raises(
        UnknownAlgorithm, match=r"unknown algorithm 'extragradiant'; did you mean 'extragradient'\?"
    ):
        solve(PROBLEM, "extragradiant")


def test_known_names_cost_no_look_at_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every registered name is found without a scan of the installed packages; only an unknown one asks for it."""

    class ScannedError(Exception):
        """Somebody looked."""

    def scan(**_: str) -> None:
        raise ScannedError

    monkeypatch.setattr(importlib.metadata, "entry_points", scan)
    for name in REGISTRY:
        assert create(name, {}).name == name
    with pytest.raises(ScannedError):
        algorithm_class("no_such_algorithm")


BASE = "from lcp_plugin.algorithms import Algorithm, Step\n"
WORKING = f"""{BASE}class Kind(Algorithm):
    name = '{{name}}'
    def iterates(self, problem, z0):
        yield Step(z0)
"""
NEEDY = WORKING.format(name="needy").replace(
    "class Kind", "@dataclass(frozen=True, kw_only=True)\nclass Kind"
)
NEEDY = f"from dataclasses import dataclass\n{NEEDY}    step: float\n"
BROKEN = [
    ("module missing", "", "Kind", r"cannot be loaded .*AttributeError.*repair or uninstall"),
    (
        "import fails",
        "import no_such_module_at_all",
        "Kind",
        r"cannot be loaded.*ModuleNotFoundError: No module named",
    ),
    (
        "module raises",
        "raise ValueError('half written')",
        "Kind",
        r"cannot be loaded.*ValueError: half written",
    ),
    ("syntax error", "def", "Kind", r"cannot be loaded.*SyntaxError"),
    (
        "a module",
        WORKING.format(name="offered"),
        "",
        r"is <module .*must read offered = \"module:Class\"",
    ),
    (
        "a function",
        "def Kind(): pass",
        "Kind",
        r"is <function Kind.*subclass of lcp_plugin.algorithms.Algorithm",
    ),
    (
        "another class",
        "class Kind: name = 'offered'",
        "Kind",
        r"is <class .*subclass of lcp_plugin",
    ),
    (
        "an object",
        WORKING.format(name="offered") + "kind = Kind()",
        "kind",
        r"must read offered = ",
    ),
    (
        "abstract",
        BASE + "class Kind(Algorithm):\n    name = 'offered'",
        "Kind",
        r"class Kind has no method iterates",
    ),
    (
        "other name",
        WORKING.format(name="mine"),
        "Kind",
        r"called 'offered', but Kind.name is 'mine'; .*be equal",
    ),
    (
        "no name",
        WORKING.replace("    name = '{name}'\n", ""),
        "Kind",
        r"Kind.name is None; they must be equal",
    ),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("text", "attribute", "message"), [case[1:] for case in BROKEN], ids=[c[0] for c in BROKEN]
)
def test_a_broken_entry_says_what_and_whose(
    text: str, attribute: str, message: str, install: Install
) -> None:
    """A broken or foreign entry raises UnknownAlgorithm with package, fault and remedy."""
    install(text, "offered", attribute, package="their-package")
    with pytest.raises(UnknownAlgorithm, match=rf"(?s)^package their-package 1\.2: .*{message}"):
        solve(PROBLEM, "offered")
    ran = CliRunner().invoke(app, ["solve", "half_active:n=4", "-a", "offered"])
    assert ran.exit_code == 2
    assert ran.stderr.startswith("lcp-plugin: package their-package 1.2: ")


@pytest.mark.parametrize("name", ["psor", "auto", "piqp"])
def test_a_name_of_ours_cannot_be_taken(name: str, install: Install) -> None:
    """A package that offers a built-in name changes nothing for it, and is named as refused."""
    install(WORKING.format(name=name), name, package="their-package")
    assert solve(PROBLEM.to_qp() if name in ENGINES else PROBLEM, name).is_solved
    assert algorithm_class("psor").__module__ == "lcp_plugin.core.splittings.projected_relaxation"
    refused = from_other_packages()[name]
    assert isinstance(refused, UnknownAlgorithm)
    assert f"package their-package 1.2: the name {name!r} belongs to lcp_plugin" in str(refused)


def test_two_packages_with_one_name_are_both_refused(install: Install) -> None:
    """Where two packages offer the same name nobody guesses: the error names both."""
    install(WORKING.format(name="offered"), "offered", package="first-package")
    install(WORKING.format(name="offered"), "offered", package="second-package")
    with pytest.raises(
        UnknownAlgorithm,
        match=r"package first-package 1.2 and package second-package 1.2.*uninstall",
    ):
        solve(PROBLEM, "offered")


def test_first_mistakes_of_an_author_are_named() -> None:
    """An algorithm that yields z itself, returns it, or has no name is refused in words."""

    class Bare(Algorithm):
        name = "bare"

        def iterates(self, problem: LCP, z0: Any) -> Any:
            yield z0

    class Returned(Bare):
        def iterates(self, problem: LCP, z0: Any) -> Any:
            return z0

    class Nameless(Algorithm):
        def iterates(self, problem: LCP, z0: Any) -> Any:
            yield Step(z0)

    problem = LCP([[2.0]], [-1.0])
    for algorithm, words in (
        (Bare(), r"bare\.iterates must yield Step\(z\), got ndarray; write `yield Step\(z\)`"),
        (Returned(), r"bare\.iterates must yield Step\(z\), got float64"),
        (Nameless(), 'Nameless has no name; write name = "…" in the class'),
    ):
        with pytest.raises(InvalidOption, match=words):
            solve(problem, algorithm)


def test_python_dash_m_is_the_command() -> None:
    """``python -m lcp_plugin`` is the command."""
    command = [sys.executable, "-m", "lcp_plugin", "--version"]
    version = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert version.stdout == f"lcp-plugin {lcp_plugin.__version__}\n"


def test_the_citation_names_this_version() -> None:
    """CITATION.cff gives the version and the licence of the package, and the paper it implements."""
    text = ROOT.joinpath("CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", text, re.M)[1] == lcp_plugin.__version__  # type: ignore[index]
    assert re.search(r"^cff-version: 1\.2\.0$", text, re.M)
    assert re.search(r"^license: Apache-2\.0$", text, re.M)
    assert "More on projected type iteration method" in text
