"""What ``help()`` tells about a public name: each parameter with shape or unit, what comes back, what is raised."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from dataclasses import is_dataclass
from typing import Any

import pytest
from public_names import PUBLIC

from lcp_plugin.algorithms import REGISTRY, algorithm_class


def is_function(thing: Any) -> bool:
    return inspect.isfunction(thing) or inspect.ismethod(thing)


DESCRIBED = {
    name: thing for name, thing in PUBLIC.items() if inspect.isclass(thing) or is_function(thing)
}


def sections(thing: Any) -> dict[str, str]:
    """The parts of a numpydoc docstring by title; the summary has the empty title."""
    parts = re.split(r"^(\w+)\n-{3,}\n", inspect.getdoc(thing) or "", flags=re.M)
    return dict(zip(["", *parts[1::2]], parts[::2], strict=True))


def entries(thing: Any) -> dict[str, str]:
    """What is said about each parameter or attribute: ``a, b : type`` and the indented lines below it."""
    told = sections(thing)
    text = told.get("Parameters", "") + "\n" + told.get("Attributes", "")
    found = re.findall(r"^(\S.*)\n?((?:^[ ]+.*\n?|^\n)*)", text, re.M)
    return {
        name.strip(" *"): f"{head}\n{body}"
        for head, body in found
        for name in head.partition(" : ")[0].split(",")
    }


def parameters(thing: Any) -> dict[str, str]:
    """The parameters that a caller may give, with their annotations."""
    if inspect.isclass(thing) and not (is_dataclass(thing) or "__init__" in vars(thing)):
        return {}
    given = inspect.signature(inspect.unwrap(thing)).parameters
    return {
        name: str(p.annotation)
        for name, p in given.items()
        if name not in ("self", "cls") and name[0] != "_"
    }


def test_help_tells_what_goes_in_and_what_comes_out():
    """A summary; an entry for each parameter, with shape or unit where it has one; what is returned."""
    for name, thing in DESCRIBED.items():
        told, described = sections(thing), entries(thing)
        assert re.match(r"\S.*[.:,;\w]$", told[""].splitlines()[0]), name
        assert not re.search(r"\S +-{4,}", inspect.getdoc(thing) or ""), (
            f"{name}: a section's title in its text"
        )
        for parameter, annotation in parameters(thing).items():
            assert parameter in described, f"{name}: {parameter} is not described"
            if re.search("Vector|ArrayLike|NDArray", annotation):
                assert re.search(r"shape|length|As in", described[parameter]), (
                    f"{name}: {parameter}: which shape?"
                )
            if "seconds" in parameter:
                unit = re.search(r"[Ss]econd|units", described[parameter].partition("\n")[2])
                assert unit, f"{name}: {parameter}: which unit?"
        returns = is_function(thing) and inspect.signature(inspect.unwrap(thing)).return_annotation
        # the first line of a scene says what the scene is
        if returns and returns not in ("None", "Scene"):
            is_told = re.search(r"\b([Rr]eturn|Yield|Solve|Raise)", told[""]) or {
                "Returns",
                "Yields",
            } & set(told)
            assert is_told, f"{name}: what comes back?"


def test_help_tells_what_is_raised():
    """Every error that the function's own lines raise stands in its Raises section."""
    for name, described in DESCRIBED.items():
        if is_function(described):
            thing = inspect.unwrap(described)
            tree = ast.parse(textwrap.dedent(inspect.getsource(thing)))
            calls = [
                one.exc
                for one in ast.walk(tree)
                if isinstance(one, ast.Raise) and isinstance(one.exc, ast.Call)
            ]
            raised = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
            assert not {
                error for error in raised if error not in sections(thing).get("Raises", "")
            }, name


@pytest.mark.parametrize("name", REGISTRY)
def test_an_algorithm_names_its_source(name):
    """The class says where the method comes from, with a doi unless it is the paper that has none."""
    assert re.search(
        r"doi:10\.|More on projected type iteration method", algorithm_class(name).reference
    )
