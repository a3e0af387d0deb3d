"""Studies and error against time: an honest clock, rows that can be had again, and views that are functions of rows."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import cvxpy  # noqa: F401 - sets warning filters where it is loaded
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg
from inputs import membranes
from legends import hides_nothing
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, InvalidOption, error_against_time, error_bound, gallery, solve, study
from lcp_plugin.algorithms import Algorithm, Step, paper_options
from lcp_plugin.core.matrix import Matrix, fact
from lcp_plugin.evidence.measurement import Measurement
from lcp_plugin.evidence.study import Study

NAP = 0.06


@fact
def nap_about(matrix: Matrix, seconds: float) -> None:
    """Sleep once a matrix, as a costly analysis of it would."""
    time.sleep(seconds)


@dataclass(frozen=True, kw_only=True)
class Richardson(Algorithm):
    """z⁺ = mid(lower, upper, z − w/10), with naps; it may give up or raise in its fourth step."""

    name = "richardson"
    nap: float = 0.0
    nap_about_matrix: float = 0.0
    ends: str = ""

    def iterates(self, problem: LCP, z0: Any) -> Iterator[Step]:
        time.sleep(self.nap)
        nap_about(problem.matrix, self.nap_about_matrix)
        z = z0
        for k in range(100_000):
            if k == 3 and self.ends == "Ctrl-C":
                raise KeyboardInterrupt
            if k == 3 and self.ends == "error":
                raise IndexError("out of bounds")
            yield Step(z)
            z = (z - 0.1 * problem.slack(z)).clip(problem.lower, problem.upper)


def chain(n: int) -> tuple[Any, Any]:
    """A tridiagonal family."""
    M = sp.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    return M, np.sin(0.3 * np.arange(n)) - 0.2


def even(n: int) -> LCP:
    """A family that refuses some sizes."""
    if n % 2:
        raise ValueError(f"n must be even, got {n}")
    return LCP(*chain(n))


def scene(n: int = 100) -> Any:
    return gallery.build("half_active", n=n)


def made(*rows: tuple[str, int, str, float]) -> Study:
    """A study by hand: problem, n, method, work; negative if it was not solved."""
    return Study(
        tuple(
            Measurement(
                problem,
                n,
                n,
                5 * n,
                method,
                "other",
                "SOLVED" if work > 0 else "STALLED",
                "residual",
                1e-8,
                np.array([(0.0,) * 7, (round(abs(work)), abs(work), abs(work), 1, 1, 1e-9, 1e-9)]),
            )
            for problem, n, method, work in rows
        )
    )


def measured(target: Any, *methods: Any, **options: Any) -> Measurement:
    return error_against_time(target, [*methods], **{"repeats": 1, **options}).rows[0]


# --- The clock ------------------------------------------------------------------------------------------------


def test_sleep_in_set_up_shows():
    """An algorithm that sleeps before its first iterate shows it at its first point, and in every later one."""
    seconds = measured(scene(), Richardson(nap=NAP), repeats=2).column("seconds")
    assert min(seconds) >= seconds[0] >= NAP


def test_ctrl_c_ends_a_study_with_what_there_is():
    """Rows before Ctrl-C are kept; the handler of SIGINT is never touched."""
    before = signal.getsignal(signal.SIGINT)
    methods = {"pgs": "pgs", "stopped": Richardson(ends="Ctrl-C"), "psor": "psor"}
    found = study(scene(), methods, repeats=1)
    assert [row.method for row in found.rows] == ["pgs"]
    assert not found.is_complete
    assert "interrupted" in str(found)
    assert signal.getsignal(signal.SIGINT) is before


# --- The rows -------------------------------------------------------------------------------------------------


def test_reruns_agree_in_everything_but_seconds():
    """Iterations, work, errors, residuals and statuses of all default methods are the same in two calls."""
    first, second = (error_against_time(scene(), repeats=repeats) for repeats in (1, 2))
    for a, b in zip(first.rows, second.rows, strict=True):
        assert (a.method, a.status, a.error_kind) == (b.method, b.status, b.error_kind)
        for name in ("iteration", "work", "error", "residual"):
            np.testing.assert_array_equal(a.column(name), b.column(name))


def test_a_row_is_the_run_that_solve_makes():
    """The last point has the iterations, work, residual and true error of the last iterate of `solve`."""
    known = scene(64)
    found = study({"half": known, "own": LCP(*chain(9))}, ["psor", Richardson()], repeats=2)
    problems = [known.problem, known.problem, LCP(*chain(9)), LCP(*chain(9))]
    for row, problem in zip(found.rows, problems, strict=True):
        result = solve(problem, "psor" if row.method == "psor" else Richardson(), polish=False)
        assert (row.iterations, row.work, row.status) == (result.iterations, result.work, "SOLVED")
        assert row.last("residual") == result.certificate.relative_residual
    last = solve(known.problem, "psor", polish=False).z
    assert found.rows[0].error == np.abs(last - known.exact).max()
    assert found.rows[0].column("error")[0] == np.abs(known.exact).max()  # z° = 0


def test_iterates_and_their_polish_are_two_rows():
    """A method of small steps ends at its last iterate; the polish that `solve` adds is a row with one point."""
    problem = LCP(*chain(60))
    found = study(problem, {"mine": Richardson()}, repeats=1)
    iterates, polish = found.rows
    last, polished = (solve(problem, Richardson(), polish=one) for one in (False, True))
    assert (last.is_polished, polished.is_polished) == (False, True)
    assert iterates.last("residual") == last.residual > 1e-10 > polished.residual
    assert (polish.method, polish.family) == ("mine, polished", "polish")
    assert [len(polish.points), polish.last("residual")] == [1, polished.residual]


def test_the_stopping_rule_of_the_paper_ends_runs_where_its_tables_do():
    """Table 2 of the paper, n = 100 and 900; the last point is the first iterate with Res < 1e-5, without a polish."""
    printed = {"npgs": (18, 21), "npsor": (12, 13), "mgs": (24, 26), "msor": (14, 14)}
    relaxations = {"npsor": 1.7, "msor": 0.88}
    methods = {name: (name, paper_options(name, relaxations.get(name))) for name in printed}
    found = study("paper_example_2", methods, [100, 900], stopping="paper", repeats=1)
    for name, counts in printed.items():
        assert [row.iterations for row in found.rows if row.method == name] == [*counts]
    assert {row.status for row in found.rows} == {"SOLVED"}
    own = study({"own": LCP(*chain(60))}, {"mine": Richardson()}, stopping="paper", tolerance=0.1)
    (row,) = own.rows
    problem, z, count = LCP(*chain(60)), np.zeros(60), 0
    while np.linalg.norm(np.minimum(z, problem.slack(z))) >= 0.1:
        z, count = (z - 0.1 * problem.slack(z)).clip(0.0), count + 1
    assert (row.iterations, row.last("iteration")) == (count, count)
    assert own.plot("work") is not None
    few = study(
        problem, Richardson(), stopping="paper", tolerance=1e-9, max_seconds=1e-9, repeats=1
    )
    assert few.rows[0].status == "MAX_SECONDS"


def test_a_study_without_polishes_has_rows_of_iterates_only():
    """With polish=False no method has a second row."""
    found = study(LCP(*chain(60)), {"mine": Richardson()}, repeats=1, polish=False)
    assert [row.method for row in found.rows] == ["mine"]


def test_the_error_is_the_true_one_then_a_bound_then_the_residual():
    """The error is the true one if z* is known, a bound that is never too small for H₊, else the residual."""
    bumps = gallery.build("obstacle_2d", size=12)
    exact = solve(bumps.problem, "multigrid", tolerance=1e-13).z
    row = measured(bumps, "npsor")
    assert row.error_kind == "rigorous bound"
    found = {}
    solve(
        bumps.problem,
        "npsor",
        callback=lambda s, z: bool(found.update({s.iteration: float(abs(z - exact).max())})),
    )
    bounds = dict(zip(row.column("iteration")[:-1], row.column("error")[:-1], strict=True))
    assert all(bound >= found[int(k)] - 1e-12 for k, bound in bounds.items())
    assert bounds[5.0] < (1.0 + 1e-9) * found[5]
    assert measured(scene(), "pgs").error_kind == "true error"


def convection(size: int) -> LCP:
    """Convection–diffusion on a size × size grid, no constraint active; ⟨M⟩⁻¹ is millions of times as large as M⁻¹."""
    o, eye = np.ones(size - 1), sp.eye_array(size)
    along = sp.diags_array([-1.4 * o, 4.0 * np.ones(size), -0.6 * o], offsets=[-1, 0, 1])
    across = sp.diags_array([-o, -o], offsets=[-1, 1])
    return LCP(sp.csr_array(sp.kron(eye, along) + sp.kron(across, eye)), -np.ones(size * size))


@pytest.mark.parametrize("size", [5, 50])
def test_the_bound_is_the_sharp_one(size):
    """The bound of a SOLVED convection–diffusion problem is the error itself, 1e8 times below the plain bound."""
    problem = convection(size)
    z = solve(problem, "psor").z
    error = float(np.max(np.abs(z - scipy.sparse.linalg.spsolve(problem.csr.tocsc(), -problem.q))))
    row = measured(problem, "psor")
    assert row.error_kind == "rigorous bound"
    assert row.error == pytest.approx(error, rel=1e-3)
    assert error_bound(problem, z, sharp=False).infinity > 1e8 * error


def test_a_plain_problem_is_examined():
    """An LCP without declared facts gets a bound if M allows one, else the residual."""
    assert measured(LCP([[4, -1], [-1, 4]], [-3, 5]), "pgs").error_kind == "rigorous bound"
    assert measured(LCP([[1, 4], [4, 1]], [-3, 5]), "npsor").error_kind == "residual"


def test_refusals_and_errors_are_rows_with_their_reason():
    """A refused size, a refused matrix, a method that raises: each is a row, and the others are measured."""
    found = study([even, "half_active"], ["psor"], [4, 5], repeats=1)
    assert [(row.n, row.status) for row in found.rows] == [(4, "SOLVED"), (0, "REFUSED")] * 2
    assert "ValueError: n must be even, got 5" in found.rows[1].note
    assert "n must be a perfect square, got 5" in found.rows[3].note
    raising = {"mine": Richardson(ends="error"), "psor": "psor"}
    found = study(chain, raising, [9], repeats=1)
    assert [row.status for row in found.rows] == ["ERROR", "SOLVED"]
    assert found.rows[0].note == "IndexError: out of bounds"
    refused = study(LCP([[0.0, 1.0], [-1.0, 0.0]], [1.0, 1.0]), ["psor"], repeats=1)
    assert "psor needs a positive diagonal" in str(refused)
    assert "nan" not in str(refused)


# --- References -----------------------------------------------------------------------------------------------


def test_references_are_rows_of_symmetric_problems():
    """A convex solver of cvxpy is one point; it is left out, with the reason, if M is not symmetric."""
    found = error_against_time(scene(), ["pgs"], ("CLARABEL", "OSQP"), repeats=1)
    clarabel = found.row("CLARABEL")
    assert (clarabel.family, clarabel.status, len(clarabel.points)) == ("reference", "OPTIMAL", 1)
    assert 0.0 < clarabel.error < 1e-2  # half of the active rows are degenerate
    assert clarabel.seconds > 0.0
    windy = membranes.build("convection_diffusion", size=4)
    found = error_against_time(windy, ["pgs"], ("CLARABEL",), repeats=1)
    assert [row.method for row in found.rows] == ["pgs"]
    assert any("no convex solver, M[" in note for note in found.notes)


# --- Views ----------------------------------------------------------------------------------------------------


def test_tables_tell_how_a_run_ended_without_a_result():
    """A cell holds the value of a solved run, else its status in words."""
    (table,) = made(("p", 4, "a", 7.0), ("p", 4, "b", -7.0)).table("iterations")
    assert [list(row) for row in table.rows] == [["a", 7], ["b", "stalled"]]
    assert table.to_markdown().splitlines()[2:] == ["| a | 7 |", "| b | stalled |"]
    assert str(table).startswith("p: iterations\n\n| method | n = 4 |")


def test_plot_names_every_curve_and_its_axis(tmp_path):
    """The axes are logarithmic and say which error they show; the legend names each curve and covers no axes."""
    found = error_against_time(scene(), repeats=1)
    figure = found.plot(against="work")
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert "true error" in axes.get_ylabel()
    names = {text.get_text() for text in figure.legends[0].get_texts()}
    assert names == {row.method for row in found.rows}
    assert len([row for row in found.rows if row.is_curve]) == 12
    assert hides_nothing(figure)
    assert axes.get_position().height > 0.4
    found.save(tmp_path / "curves.svg", against="work")
    assert (tmp_path / "curves.svg").stat().st_size > 1000


def test_a_figure_without_data_is_refused_in_words(tmp_path):
    """Without a point there is no file with empty axes; a problem without one says so in its panel."""
    drawn, other = made(("p", 4, "a", 7.0), ("q", 4, "a", 7.0)).rows
    nothing = replace(other, points=other.points[:0])
    with pytest.raises(InvalidOption, match="no run has a result to draw"):
        Study((nothing,)).save(tmp_path / "v.png", "work")
    assert not (tmp_path / "v.png").exists()
    first, second = Study((nothing, drawn)).plot("work").axes
    assert [text.get_text() for text in first.texts] == ["no result: print() lists the reasons"]
    assert all("no result" not in text.get_text() for text in second.texts)


# --- What cannot be used --------------------------------------------------------------------------------------


@refusals(r"""
study(5, ["psor"]) → InvalidOption: problems must be problems
study(QuadraticProgram(np.eye(2), [1.0, 1.0]), ["psor"]) → InvalidOption: QuadraticProgram
study(chain, ["psr"], [4]) → UnknownAlgorithm: did you mean 'psor'
study(chain, 5, [4]) → InvalidOption: methods must be names .* got 5
study(chain, [3], [4]) → InvalidOption: a method is a name, Algorithm or
study(chain, ["psor"], [0]) → InvalidOption: each of sizes must be an integer ≥ 1
study(chain, ["psor"], [4], tolerance=-1.0) → InvalidOption: tolerance must be
study(chain, ["psor"], [4], stopping="Res") → InvalidOption: stopping must be one of criterion, paper
study(chain, ["psor"], [4], references=["OSQPP"]) → InvalidOption: cvxpy has no solver 'OSQPP'
found.table("wrk") → InvalidOption: value must be one of iterations, work
found.plot(against="time") → InvalidOption: against must be one of seconds
found.save("r.txt") → InvalidOption: must end in .png, .pdf, .svg
found.row("b") → InvalidOption: no row of 'b'
error_against_time(np.eye(2)) → InvalidOption: needs an LCP, got ndarray
""")
def test_arguments_are_refused_before_anything_runs(call, words):
    """A misspelt name, view, axis or ending, another kind of problem: one line says what to write."""
    assert_refused(call, words, {**globals(), "found": made(("p", 4, "a", 7.0))})
