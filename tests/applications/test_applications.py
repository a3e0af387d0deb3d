"""The work and the errors of applications are not worse than in the stored table."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from . import entries
from .references import NoReference, active_sets, checked
from .table import (
    UNITS,
    Case,
    Key,
    Measured,
    all_runs,
    differences,
    path_of,
    read,
    regressions,
    written,
)


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
    return f"to write the table anew, and to say why: python tests/applications {name}{' --full' * full}"


@pytest.mark.parametrize("name", entries())
def test_small_applications_cost_no_more_than_the_table_says(
    name: str, pytestconfig: pytest.Config
) -> None:
    """Status, counted work and error of auto in all units and of the best named methods.

    The full suite also runs named methods on scaled problems: no further result may be falsely SOLVED.
    """
    everything = bool(pytestconfig.getoption("--full"))
    assert not (lines := worse(full=False, name=name, everything=everything)), "\n".join(lines)


@pytest.mark.full
@pytest.mark.parametrize("name", entries())
def test_large_applications_cost_no_more_than_the_table_says(name: str) -> None:
    """The same of the large sizes."""
    assert not (lines := worse(full=True, name=name)), "\n".join(lines)


@pytest.mark.parametrize("full", [False, True])
def test_every_application_has_its_rows(full: bool) -> None:
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
def test_every_application_has_a_source(name: str) -> None:
    """The docstring describes the application and cites its source."""
    assert re.search(r"; .*\(\d{4}\)|Kumar, Deepmala, Das", entries()[name].build.__doc__ or "")


KEY = Key("obstacle_2d side=30", "auto", "own")
BEFORE = Measured(900, "SOLVED", 100.0, 1e-9)


def test_rounding_and_improvements_are_no_regressions() -> None:
    """Errors below 1e-12 are rounding, as are five passes more; what was false or unsolved may end so at more cost."""
    few = replace(BEFORE, work=13.0)
    assert regressions({KEY: few}, {KEY: replace(few, work=15.2)}) == []
    false, stalled = replace(BEFORE, error=0.5), replace(BEFORE, status="STALLED", work=50.0)
    for before, after in (
        (replace(BEFORE, error=1e-16), replace(BEFORE, error=9e-12)), (false, stalled), (stalled, BEFORE),
        (stalled, replace(stalled, work=500.0)),
    ):  # fmt: skip
        assert regressions({KEY: before}, {KEY: after}) == []
        assert list(differences({KEY: before}, {KEY: after})) != []
    assert regressions({KEY: stalled}, {KEY: false}) != []


def test_units_are_exact() -> None:
    """A scaled problem is equivalent: w at the scaled z is scaled exactly."""
    case = Case("circuit", {"n": 30})
    for units in UNITS[1:]:
        problem, c = case.in_units(units)
        assert np.count_nonzero(c) in {"one": [1], "rows": [0]}.get(units, range(20, 31))
        z = np.ldexp(np.arange(30.0), -c)
        moved = np.log2(problem.slack(z) / case.in_units("own")[0].slack(np.arange(30.0)))
        np.testing.assert_array_equal(moved, np.round(moved))


def test_references_are_checked() -> None:
    """A wrong reference raises NoReference; active sets find one from any start, if it exists."""
    M = sp.csr_array(np.array([[2.0, -1.0], [-1.0, 2.0]]))
    problem = (M, np.array([-1.0, 5.0]), np.zeros(2), np.full(2, np.inf))
    np.testing.assert_array_equal(active_sets(problem, [np.array([0.0, 9.0])]), [0.5, 0.0])
    with pytest.raises(NoReference, match="of a row's terms"):
        checked(problem, np.array([0.5, 1e-9]))
    with pytest.raises(NoReference):
        active_sets(
            (sp.csr_array(-np.eye(1)), np.array([-1.0]), np.zeros(1), np.full(1, np.inf)), []
        )
