"""verbose=True prints a run while it goes on, and changes nothing about it."""

from __future__ import annotations

import io
import re
import sys

import numpy as np

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    NonlinearProblem,
    Result,
    gallery,
    prepare,
    solve,
)

LINE = re.compile(r" +(\d+) +[\d.]+ +\d\.\d\de[+-]\d\d +[\d.]+")


def printed_by(run: Result, printed: str) -> tuple[str, list[str], list[int], str]:
    """The header, the lines of stages, the iterations that have a line, and the end of what a run printed."""
    header, columns, *lines, end = printed.splitlines()
    assert columns.split() == ["iteration", "work", "relative", "residual", "seconds"]
    stages = [
        line for line in lines if not LINE.fullmatch(line) and not line.startswith("(compiling")
    ]
    return header, stages, [int(found[1]) for line in lines if (found := LINE.fullmatch(line))], end


def scene() -> LCP:
    """A problem whose facts nobody has asked for yet."""
    return gallery.obstacle_2d(size=20).problem


def test_a_run_is_printed_from_header_to_end(capsys):
    """A header with what is seen of M, each stage with its reason, few lines of iterations, and the end."""
    result = solve(scene(), verbose=True)
    header, stages, iterations, end = printed_by(result, capsys.readouterr().out)
    assert header.startswith(
        "LCP(n=400, nonzeros=1920, bounds 400 one-sided); M sparse, symmetric, a Z-matrix, "
    )
    assert stages == [f"{stage.name}: {stage.because}" for stage in result.stages]
    assert len(stages) == 2
    assert iterations == sorted(iterations)
    assert 5 < len(iterations) < result.iterations / 3
    assert end.startswith(
        f"SOLVED: relative residual {result.residual:.2e} after {result.iterations} iterations"
    )


def test_first_steps_are_printed_as_a_run_with_one_line(capsys):
    """A small problem takes its usual way: the header, the method with its reason, one line, the end."""
    problem = LCP([[2.0, -1.0], [-1.0, 2.0]], [-1.0, 3.0])
    contact = FrictionalContact(np.eye(3), [-1.0, 0.2, 0.0], 0.5)
    fit = BoundedLeastSquares([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [2.0, 1.0, -1.0])
    for one in (problem, contact, fit):
        result = solve(one, verbose=True, record=True)
        _, stages, iterations, end = printed_by(result, capsys.readouterr().out)
        assert iterations == [result.iterations]
        assert stages == [f"{stage.name}: {stage.because}" for stage in result.stages]
        assert end.startswith(f"SOLVED: {result.describe_accuracy()}; ")
        assert [*result.x] == [*solve(one).x]
    step = prepare(problem, record=True)
    first, last = step.solve(q=[-2.0, 3.0]).history
    assert (first.iteration, last.iteration, last.label) == (0, 1, "lemke")


def test_a_nonlinear_run_is_printed_by_its_newton_steps(capsys):
    """Each step has a line with its kind, its length, the worst row by name, and counts of F and F′."""
    problem = NonlinearProblem(
        lambda x: np.array([np.exp(x[0]) + x[1] - 3, x[1] - x[0] + 2]), names=["coal", "gas"]
    )
    solve(problem, x0=[0.0, 0.0])
    assert capsys.readouterr().out == ""
    result = solve(problem, x0=[0.0, 0.0], verbose=True)
    header, lines, _, end = printed_by(result, capsys.readouterr().out)
    assert header == "NonlinearProblem(n=2, differences)"
    assert lines[0].startswith("josephy_newton: each iteration replaces F by its tangent at x")
    assert len(lines) == result.iterations + 2
    F, slopes, _ = result.evaluations
    assert re.search(r"Newton, length 1; worst (coal|gas); F \d+, F′ \d+$", lines[2])
    assert lines[-1].endswith(f"F {F}, F′ {slopes}")
    assert "as measured on F" in end
    assert solve(NonlinearProblem(lambda x: x), x0=[], verbose=True).is_solved  # no worst row


def test_a_terminal_without_unicode_ends_no_run(monkeypatch):
    """A sign that the terminal does not know becomes a question mark."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    assert solve(LCP([[1.0]], [-1.0]), verbose=True).is_solved
    stream.seek(0)
    assert (
        stream.readline()
        == "LCP(n=1, nonzeros=1, bounds 0 ? z); M dense, symmetric, diagonal, a Z-matrix, "
        "with positive diagonal\n"
    )


def test_explain_says_why_a_stage_failed():
    """A spent budget, a residual that no longer falls, a method without a further step; none if it solves."""
    result = solve(scene())
    assert [stage.ending for stage in result.stages] == ["budget spent", ""]
    assert re.search(r"\n  npsor, 3 iterations, \d+% of the work, budget spent: ", result.explain())
    stalled = solve(LCP([[1, 4, 0], [0, 1, 4], [4, 0, 1]], [-1, -1, -1]), "psor")
    assert [stage.ending for stage in stalled.stages] == ["no progress"]
    infeasible = solve(LCP([[-1, 0], [0, -1]], [-1, -1]))
    assert infeasible.stages[0].ending == "steps ended"
    assert infeasible.stages[-1].ending == ""
