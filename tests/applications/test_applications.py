"""The work and the errors of applications are not worse than in the stored table."""

from __future__ import annotations

import re

import pytest

from . import entries
from .table import UNITS, Case, all_runs, path_of, read, regressions, written


def worse(*, full: bool, name: str, everything: bool = False) -> list[str]:
    """Measure one application, or its rows in the table; return worse rows, with advice."""
    table = read(path_of(full=full).read_text(encoding="utf-8"))
    entry, new = entries()[name], {}
    for arguments in entry.full if full else entry.small:
        case = Case(name, arguments)
        of_table = [(key.method, key.units) for key in table if key.problem == case.name]
        # large ones take long to no end
        new.update(case.measure(all_runs(full=False) if everything else of_table))
    old = {key: row for key, row in table.items() if key.problem.partition(" ")[0] == name}
    assert {key.problem for key in new} == {key.problem for key in old}, rewriting(full, name)
    lines = regressions(old, new)
    return [*lines, rewriting(full, name)] if lines else []


def rewriting(full: bool, name: str) -> str:
    call = f"python tests/applications {name}{' --full' * full}"
    return f"to write the table anew, and to say why: {call}; if only this processor differs: --keep-worse"


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", entries())
def test_small_applications_cost_no_more_than_the_table_says(name, pytestconfig):
    """Status, counted work and error of auto in all units and of the best named methods.

    The full suite also runs named methods on scaled problems: no further result may be falsely SOLVED.
    """
    everything = bool(pytestconfig.getoption("--full"))
    assert not (lines := worse(full=False, name=name, everything=everything)), "\n".join(lines)


@pytest.mark.full
@pytest.mark.parametrize("name", entries())
def test_large_applications_cost_no_more_than_the_table_says(name):
    """The same of the large sizes."""
    assert not (lines := worse(full=True, name=name)), "\n".join(lines)


@pytest.mark.parametrize("full", [False, True])
def test_every_application_has_its_rows(full):
    """Both tables have auto's rows of each case and scaling, and survive a round trip."""
    text = path_of(full=full).read_text(encoding="utf-8")
    table = read(text)
    assert written(table) == text
    names = [
        Case.name_of(name, arguments)
        for name, entry in entries().items()
        for arguments in (entry.full if full else entry.small)
    ]
    assert [key.problem for key in table if key[1:] == ("auto", "own")] == names
    assert len([key for key in table if key.method == "auto"]) == len(UNITS) * len(names)
    assert {key.problem for key in table} == set(names)
    assert len(entries()) >= 40


@pytest.mark.parametrize("name", entries())
def test_every_application_has_a_source(name):
    """The docstring describes the application and cites its source."""
    assert re.search(r"; .*\(\d{4}\)|Kumar, Deepmala, Das", entries()[name].build.__doc__ or "")
