"""A study: one table of raw results that survives interruptions and mistakes, and its views."""

from __future__ import annotations

import csv
import math
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from legends import hides_nothing

import lcp_plugin.evidence.study as module
from lcp_plugin import (
    LCP,
    InvalidOption,
    QuadraticProgram,
    UnknownAlgorithm,
    UnreadableFile,
    gallery,
    solve,
)
from lcp_plugin.algorithms import Algorithm, Step
from lcp_plugin.evidence import collecting, paper_tables
from lcp_plugin.evidence.contestants import contestants
from lcp_plugin.evidence.curves import Curve, Point
from lcp_plugin.evidence.exporting import Table, save_tables
from lcp_plugin.evidence.results import COLUMNS, VIEWS, Row, Study
from lcp_plugin.evidence.stability import HIDDEN, OUTCOMES, WRONG, Atlas, Cell, stability_atlas
from lcp_plugin.evidence.study import study


def chain(n: int) -> tuple[Any, Any]:
    """A tridiagonal family."""
    M = sp.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    return M, np.sin(0.3 * np.arange(n)) - 0.2


def even(n: int) -> LCP:
    """A family that refuses some sizes."""
    if n % 2:
        raise ValueError(f"n must be even, got {n}")
    return LCP(*chain(n))


@dataclass(frozen=True)
class Damped(Algorithm):
    """Damped projected Jacobi, or one that raises."""

    name = "damped"
    omega: float = 0.7
    fails: bool = False

    def iterates(self, problem: LCP, z0: Any) -> Iterator[Step]:
        z = z0
        while True:
            yield Step(z)
            if self.fails:
                z = z[problem.n + 1]
            z = np.clip(
                z - self.omega * problem.slack(z) / problem.diagonal, problem.lower, problem.upper
            )


def made(*rows: tuple[str, int, str, float]) -> Study:
    """A study by hand: problem, n, method, work; negative where it was not solved."""
    return Study(
        tuple(
            Row(
                problem,
                n,
                n,
                5 * n,
                "residual",
                1e-8,
                1,
                Curve(
                    method,
                    "other",
                    "SOLVED" if work > 0 else "STALLED",
                    (
                        Point(0, 0.0, 0.0),
                        Point(round(abs(work)), abs(work), abs(work), 1.0, 1.0, 1e-9, 1e-9),
                    ),
                ),
            )
            for problem, n, method, work in rows
        )
    )


# --- The table of raw results ---------------------------------------------------------------------------------


def test_a_row_is_the_run_that_solve_makes() -> None:
    """Iterations, work, residual and true error of a row are those of solve; families, scenes and problems mix."""
    known = gallery.build("half_active", n=64)
    found = study({"half": known, "own": LCP(*chain(9))}, ["psor", Damped(omega=0.5)], repeats=2)
    for row, problem in zip(
        found.rows, [known.problem, known.problem, LCP(*chain(9)), LCP(*chain(9))], strict=True
    ):
        algorithm = "psor" if row.curve.label == "psor" else Damped(omega=0.5)
        result = solve(problem, algorithm, z0=known.start if problem is known.problem else None)
        assert (row.curve.iterations, row.curve.work, row.curve.status) == (
            result.iterations,
            result.work,
            "SOLVED",
        )
        assert row.curve.last.residual == result.certificate.relative_residual
        assert row.curve.last.seconds_low <= row.curve.seconds <= row.curve.last.seconds_high
    assert (
        found.rows[0].value("error") == np.abs(solve(known.problem, "psor").z - known.exact).max()
    )
    assert found.rows[2].value("error") is None  # nobody asked for a bound
    assert [row.curve.label for row in found.rows[:2]] == ["psor", "damped omega=0.5"]


def test_sizes_go_to_families_and_to_scenes_by_their_own_name() -> None:
    """A function gets the size, a scene its n or its size; n of each row is that of the problem."""
    found = study([chain, "half_active", "obstacle_2d"], ["psor"], [4, 9], repeats=1)
    assert [(row.problem, row.size, row.n) for row in found.rows] == [
        ("chain", 4, 4),
        ("chain", 9, 9),
        ("half_active", 4, 4),
        ("half_active", 9, 9),
        ("obstacle_2d", 4, 16),
        ("obstacle_2d", 9, 81),
    ]


def test_problems_of_one_name_are_told_apart() -> None:
    """Two scenes of one kind, two functions without a name: none takes the other's place."""
    scenes = [gallery.build("half_active", n=n) for n in (4, 9)]
    assert [row.n for row in study(scenes, ["psor"], repeats=1).rows] == [4, 9]
    families = [lambda n: chain(n), lambda n: chain(n + 1)]
    assert [row.n for row in study(families, ["psor"], [4], repeats=1).rows] == [4, 5]


@pytest.mark.parametrize("asked", [False, True])
def test_a_bound_is_measured_where_it_is_asked_for(
    asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without error_bound nobody computes one; with it the error of an unknown answer is a proved bound."""
    import lcp_plugin.proofs.bounds.error_bounds as bounds

    calls: list[Any] = []
    compute = bounds.error_bound
    monkeypatch.setattr(
        bounds, "error_bound", lambda *given, **how: calls.append(0) or compute(*given, **how)
    )
    found = study(chain, ["psor"], [30], repeats=1, error_bound=asked)
    assert bool(calls) is asked
    assert found.rows[0].error_kind == ("rigorous bound" if asked else "residual")
    assert (found.rows[0].value("error") is not None) is asked


def test_the_file_is_one_plain_table_with_machine_and_versions(tmp_path: Path) -> None:
    """The CSV has a line a row with every digit, read back to the same rows; each says where it was measured."""
    found = study(
        chain, ["psor", "newton"], [30, 60], repeats=1, out=tmp_path / "r.csv", curves=True
    )
    with (tmp_path / "r.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert tuple(lines[0]) == COLUMNS
    assert [repr(Row.from_content(line)) for line in lines] == [
        *map(repr, found.rows)
    ]  # no NaN is equal to itself
    for word in ("processor", "cores", "threads", "Python", "numpy", "lcp_plugin"):
        assert word in lines[0]["machine"]
    assert len(found.rows[0].curve.points) > 5


# --- Interrupted, resumed, and what changes -------------------------------------------------------------------


def test_an_interrupted_study_keeps_its_rows_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After Ctrl-C the file holds what is there; the same call measures the rest only, and then nothing."""
    out, measured = tmp_path / "r.csv", module._Plan.measured

    def stops(self: Any, label: str, size: Any, one: Any, say: Any) -> dict[str, Any]:
        if (size, one.label) == (60, "psor"):
            os.kill(os.getpid(), signal.SIGINT)
        return measured(self, label, size, one, say)

    with monkeypatch.context() as patch:
        patch.setattr(module._Plan, "measured", stops)
        first = study(chain, ["npsor", "psor"], [30, 60], repeats=1, out=out)
    assert [(row.size, row.curve.label) for row in first.rows] == [
        (30, "npsor"),
        (30, "psor"),
        (60, "npsor"),
    ]
    assert first.missing == ("chain size 60, psor",)
    second = study(chain, ["npsor", "psor"], [30, 60], repeats=1, out=out)
    assert (second.found, second.missing, second.rows[:3]) == (3, (), first.rows)
    assert study(chain, ["npsor", "psor"], [30, 60], repeats=1, out=out).found == 4


def test_what_has_changed_is_measured_again_and_nothing_else(tmp_path: Path) -> None:
    """Another problem, option, tolerance or number of repeats changes its rows; others are kept in the file."""
    out = tmp_path / "r.csv"
    study({"p": LCP(*chain(9))}, ["psor", "pgs"], repeats=1, out=out)
    assert study({"p": LCP(*chain(9))}, ["psor"], repeats=1, out=out).found == 1
    assert study({"p": LCP(*chain(8))}, ["psor"], repeats=1, out=out).found == 0
    assert (
        study({"p": LCP(*chain(8))}, [("psor", {"relaxation": 1.1})], repeats=1, out=out).found == 0
    )
    assert study({"p": LCP(*chain(8))}, ["psor"], repeats=2, out=out).found == 0
    assert study({"p": LCP(*chain(8))}, ["psor"], repeats=2, tolerance=1e-6, out=out).found == 0
    assert study({"p": LCP(*chain(9))}, ["pgs"], repeats=1, out=out).found == 1


def test_rows_of_another_machine_are_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seconds belong to a processor and its versions."""
    study(chain, ["psor"], [9], repeats=1, out=tmp_path / "r.csv")
    monkeypatch.setattr(collecting, "machine", lambda: {"processor": "another"})
    assert study(chain, ["psor"], [9], repeats=1, out=tmp_path / "r.csv").found == 0


def test_a_method_that_raises_is_a_row_and_the_others_are_measured(tmp_path: Path) -> None:
    """The row says ERROR with the line of the mistake; mended, it alone is measured again."""
    out = tmp_path / "r.csv"
    found = study(chain, {"mine": Damped(fails=True), "psor": "psor"}, [9], repeats=1, out=out)
    assert [row.curve.status for row in found.rows] == ["ERROR", "SOLVED"]
    assert "test_study.py, line " in found.rows[0].curve.note
    assert "in iterates: IndexError" in found.rows[0].curve.note
    again = study(chain, {"mine": Damped(), "psor": "psor"}, [9], repeats=1, out=out)
    assert ([row.curve.status for row in again.rows], again.found) == (["SOLVED", "SOLVED"], 1)


def test_a_size_or_a_matrix_that_is_refused_is_a_row_with_the_reason() -> None:
    """A family may refuse a size, a scene's parameter its range, an algorithm a matrix: REFUSED, and why."""
    found = study([even, "half_active"], ["psor"], [4, 5], repeats=1)
    assert [(row.n, row.curve.status) for row in found.rows] == [
        (4, "SOLVED"),
        (0, "REFUSED"),
        (4, "SOLVED"),
        (0, "REFUSED"),
    ]
    assert "ValueError: n must be even, got 5" in found.rows[1].curve.note
    assert "a perfect square" in found.rows[3].curve.note
    refused = study(LCP([[0.0, 1.0], [-1.0, 0.0]], [1.0, 1.0]), ["psor"], repeats=1).rows[0]
    assert (refused.n, refused.curve.status) == (2, "REFUSED")
    assert "positive diagonal" in refused.curve.note


@pytest.mark.parametrize(
    ("arguments", "options", "error", "words"),
    [
        ((5, ["psor"]), {}, InvalidOption, "problems must be a list"),
        (([], ["psor"]), {}, InvalidOption, "problems must be a list"),
        ((["half_activ"], ["psor"]), {}, InvalidOption, "did you mean 'half_active'"),
        (
            (QuadraticProgram(np.eye(2), [1.0, 1.0]), ["psor"]),
            {},
            InvalidOption,
            r"LCP.from_qp\(program\.P",
        ),
        ((chain, ["psr"], [4]), {}, UnknownAlgorithm, "did you mean 'psor'"),
        ((chain, ["psor"], [0]), {}, InvalidOption, "sizes must be whole numbers ≥ 1"),
        ((chain, ["psor"], "4"), {}, InvalidOption, "sizes must be whole numbers ≥ 1"),
        ((chain, ["psor"], [4]), {"repeats": 0}, InvalidOption, "repeats must be a whole number"),
        ((chain, ["psor"], [4]), {"max_work": 0}, InvalidOption, "max_work must be a number > 0"),
        ((chain, ["psor"], [4]), {"tolerance": -1.0}, InvalidOption, "tolerance must be"),
        ((chain, ["psor"], [4]), {"max_seconds": "1"}, InvalidOption, "max_seconds must be"),
        ((chain, ["psor"], [4]), {"progress": 5}, InvalidOption, "progress must be a callable"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_runs(
    arguments: Any, options: dict[str, Any], error: type[Exception], words: str
) -> None:
    """A misspelt name, another kind of problem, a size of 0: one line says what to write."""
    with pytest.raises(error, match=words):
        study(*arguments, **options)


def test_a_file_of_something_else_is_not_overwritten(tmp_path: Path) -> None:
    """A CSV that is no file of results is refused, and left alone."""
    (tmp_path / "r.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(UnreadableFile, match="holds no results of a study"):
        study(chain, ["psor"], [4], out=tmp_path / "r.csv")
    assert (tmp_path / "r.csv").read_text(encoding="utf-8") == "a,b\n1,2\n"


# --- Views: tables --------------------------------------------------------------------------------------------


def test_exponents_are_fitted_where_there_is_a_power() -> None:
    """3 n^1.5 has exponent 1.5; what is no power, or too few sizes, has none."""
    powers = [("p", n, "a", 3.0 * n**1.5) for n in (100, 400, 1600)]
    jumps = [("p", n, "b", work) for n, work in ((100, 10.0), (400, 500.0), (1600, 20.0))]
    few = [("q", n, "a", float(n)) for n in (100, 400)]
    found = made(*powers, *jumps, *few)
    assert found.exponent("p", "a") == pytest.approx(1.5, abs=1e-12)
    assert math.isnan(found.exponent("p", "b"))
    assert math.isnan(found.exponent("q", "a"))
    (p, q) = found.table("work")
    assert (p.columns[-1], p.rows[0][-1], q.columns[-1]) == ("exponent", 1.5, "n = 400")


def test_tables_say_how_a_run_ended_that_gave_no_answer() -> None:
    """A cell holds the value of a solved run, else its status in words."""
    (table,) = made(("p", 4, "a", 7.0), ("p", 4, "b", -7.0)).table("iterations")
    assert [list(row) for row in table.rows] == [["a", 7], ["b", "stalled"]]
    assert table.to_markdown().splitlines()[2:] == ["| a | 7 |", "| b | stalled |"]


def test_profile_is_that_of_dolan_and_more() -> None:
    """The share of problems that a method solves within a multiple of the best, by its definition."""
    found = made(("p", 4, "a", 10.0), ("p", 4, "b", 20.0), ("q", 4, "a", -5.0), ("q", 4, "b", 30.0))
    (table,) = found.table("profile")
    assert [list(row) for row in table.rows] == [
        ["a", 0.5, 0.5, 0.5, 0.5],
        ["b", 0.5, 1.0, 1.0, 1.0],
    ]


TABLE = Table(
    "a_b, δ = 4",
    ("method", "the n", "Res"),
    [("p&q", 100, 1.5e-6), ("p&q", 20_000, 2.5e-7), ("r", None, -3.0)],
)


def test_numbers_are_shown_with_three_digits_and_kept_with_all(tmp_path: Path) -> None:
    """Markdown shows a column alike, with a dash for nothing; CSV keeps every digit."""
    assert TABLE.to_markdown().splitlines()[2:] == [
        "| p&q | 100 | 1.5e-6 |",
        "| p&q | 20000 | 2.5e-7 |",
        "| r | – | -3.0e0 |",
    ]
    assert TABLE.to_csv().splitlines()[1] == "p&q,100,1.5e-06"
    with pytest.raises(InvalidOption, match=r"a table must end in .tex, .md, .csv, got 't.txt'"):
        save_tables([TABLE], tmp_path / "t.txt")


def test_latex_is_escaped_and_aligned() -> None:
    """Booktabs rules, siunitx columns wide enough for their numbers, texts in braces, signs of TeX escaped."""
    text = TABLE.to_latex()
    assert r"\begin{tabular}{l S[table-format=5] S[table-format=-1.1e-1]}" in text
    assert r"\caption{a\_b, $\delta$ = 4}" in text
    assert r"p\&q & 100 & 1.5e-6 \\" in text
    assert r"{--}" in text
    for rule in ("toprule", "midrule", "bottomrule"):
        assert f"\\{rule}" in text


def compiled(path: Path) -> str:
    """The log of pdflatex for a document that holds the tables and nothing else."""
    packages = r"\documentclass{article}\usepackage{booktabs,siunitx}"
    document = rf"{packages}\begin{{document}}\input{{{path.name}}}\end{{document}}"
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-jobname=alone", document]
    done = subprocess.run(command, cwd=path.parent, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-800:]
    return (path.parent / "alone.log").read_text(encoding="latin-1")


@pytest.mark.full
@pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="no pdflatex: apt-get install texlive-science"
)
def test_the_paper_s_tables_compile_without_a_warning(tmp_path: Path) -> None:
    """Both tables, and those of a study, are set by pdflatex; its log warns of nothing and no box is too wide."""
    cells = list(paper_tables.cells())
    save_tables(
        [paper_tables.paper_table(cells, example) for example in (1, 2)], tmp_path / "paper.tex"
    )
    powers = [(p, n, "a_b", 3.0 * n**0.5) for p in "pq" for n in (100, 400, 900, 1600)]
    made(*powers, ("p", 100, "c", -1.0)).save("work", tmp_path / "study.tex")
    for name in ("paper", "study"):
        log = compiled(tmp_path / f"{name}.tex").replace("infwarerr", "")
        assert not [line for line in log.splitlines() if "Warning" in line or "full \\hbox" in line]


# --- Views: pictures ------------------------------------------------------------------------------------------


@pytest.mark.full
def test_pictures_are_as_wide_as_a_column_or_a_page() -> None:
    """One problem makes 3.5 inches, several 7.1; names with their exponents stand below each panel."""
    pytest.importorskip("matplotlib")
    powers = [
        (p, n, m, k * n**0.5)
        for p in "pq"
        for n in (100, 400, 1600)
        for m, k in (("a", 1.0), ("b", 9.0))
    ]
    one, two = (
        made(*[row for row in powers if row[0] in which]).plot("work") for which in ("p", "pq")
    )
    assert (one.get_size_inches()[0], two.get_size_inches()[0]) == (3.5, 7.1)
    for figure in (one, two):
        assert hides_nothing(figure)
        for part in figure.subfigs:
            assert [text.get_text() for text in part.legends[0].get_texts()] == [
                "a  $n^{0.50}$",
                "b  $n^{0.50}$",
            ]
    assert [axes.get_title("left") for axes in two.axes] == ["p", "q"]
    assert two.axes[0].get_ylabel() == "work [passes over M]"
    assert two.axes[1].get_xlabel() == "unknowns n"


@pytest.mark.full
@pytest.mark.parametrize("view", [view for view in VIEWS if view != "results"])
def test_every_view_is_a_picture(view: str, tmp_path: Path) -> None:
    """Each view that is one is drawn and saved as PDF, SVG and PNG."""
    pytest.importorskip("matplotlib")
    found = study(
        [chain, "half_active"], ["npsor", "psor", Damped()], [16, 64, 256], repeats=1, curves=True
    )
    for ending in ("pdf", "svg", "png"):
        found.save(view, tmp_path / f"v.{ending}")
        assert (tmp_path / f"v.{ending}").stat().st_size > 2000


def test_a_figure_without_data_is_refused_in_words(tmp_path: Path) -> None:
    """Where no run gave an answer there is no file with empty axes; a problem without one says so in its panel."""
    pytest.importorskip("matplotlib")
    failed = made(("p", 4, "a", -7.0))
    for view in ("work", "profile"):
        with pytest.raises(InvalidOption, match="nothing to draw: no run gave an answer"):
            failed.save(view, tmp_path / "v.png")
        assert not (tmp_path / "v.png").exists()
    figure = made(("p", 4, "a", -7.0), ("q", 4, "a", 7.0)).plot("work")
    assert [text.get_text() for text in figure.axes[0].texts] == ["no answer: print() says why"]
    assert not figure.axes[1].texts


def test_a_file_of_measurements_says_what_it_can_be(tmp_path: Path) -> None:
    """One verb saves: the ending says what; another ending, and what is for a picture alone, are refused in words."""
    report = made(("p", 4, "a", 7.0)).reports()[0]
    with pytest.raises(
        InvalidOption, match=r"must end in .png, .pdf, .svg, .csv, .json, got 'r.txt'"
    ):
        report.save(tmp_path / "r.txt")
    with pytest.raises(InvalidOption, match=r"against is for a picture .*got 'r.csv'"):
        report.save(tmp_path / "r.csv", against="work")


def test_a_class_in_place_of_an_object_is_told() -> None:
    """study([Mine]) says to write Mine(); a table prints as one."""
    with pytest.raises(InvalidOption, match=r"got the class Damped; write Damped\(\)"):
        study("half_active", [Damped], [16])
    assert str(made(("p", 4, "a", 7.0)).table()[0]).startswith(
        "p: iterations\n\n| method | n = 4 |"
    )


def test_a_missing_exponent_is_told() -> None:
    """A table says why a method has no exponent: too few solved sizes, or no power; one that has is a number."""
    powers = [("p", n, "a", n**0.5) for n in (4, 64, 256)]
    jumps = [("p", n, "b", y) for n, y in ((4, 1.0), (64, 90.0), (256, 2.0))]
    few = [("p", n, "c", y) for n, y in ((4, 2.0), (64, 8.0), (256, -9.0))]
    rows = made(*powers, *jumps, *few).table("work")[0].rows
    assert [row[-1] for row in rows] == [0.5, "no power", "needs 3 solved sizes"]


def test_why_there_is_no_answer_is_printed() -> None:
    """A method that refuses, and a family called without sizes, say why in print(study), without a NaN."""

    def family(n: int) -> LCP:
        return LCP(*chain(n))

    told = str(
        study(
            {"own": LCP([[0.0, 1.0], [-1.0, 0.0]], [-1.0, 1.0]), "family": family},
            ["psor"],
            repeats=1,
        )
    )
    assert "nan" not in told
    assert "psor needs a positive diagonal, but M[0, 0] = 0.0" in told
    assert "family needs a size (sizes=[100], --size 100)" in told


def test_a_view_that_does_not_exist_is_refused() -> None:
    """A misspelt view is guessed; curves that were not kept are asked for; results are no picture."""
    pytest.importorskip("matplotlib")
    found = made(("p", 4, "a", 7.0))
    for call, words in (
        (lambda: found.table("wrk"), "unknown view 'wrk'; did you mean 'work'"),
        (lambda: found.plot("curves"), r"kept no curves; write study\(…, curves=True\)"),
        (lambda: found.plot("results"), "results are a table"),
        (lambda: found.table("curves"), "curves are a picture"),
    ):
        with pytest.raises(InvalidOption, match=words):
            call()


# --- Maps of stability ----------------------------------------------------------------------------------------


def test_a_map_tells_wrong_from_hidden_from_honest() -> None:
    """A lie, or an error that condition × residual does not explain, is wrong; explained it is hidden; else honest."""

    def cell(
        status: str, error: float, condition: float, *, told: bool = True, family: str = "ranges"
    ) -> Cell:
        lost = max(0.0, math.log10(error / (condition * 1e-9))) if error else 0.0
        return Cell(
            "psor", "contrast 1e8", family, condition, status, error, 1e-9, None, lost, told
        )

    assert cell("SOLVED", 1e-7, 10.0).outcome == "right"
    assert cell("SOLVED", 0.1, 1e9).outcome == HIDDEN
    assert cell("SOLVED", 0.1, 10.0).outcome == WRONG
    assert cell("SOLVED", 0.1, 1e9, family="proved ranges").outcome == WRONG
    assert cell("SOLVED", 0.0, 10.0, told=False).outcome == WRONG
    assert cell("ERROR", 0.0, 10.0, told=False).outcome == "raised an error"
    assert cell("STALLED", 0.5, 10.0).outcome == "says that it failed"
    assert cell("REFUSED", 0.0, 10.0).outcome == "refused"


@pytest.mark.full
def test_nothing_is_wrong_but_solved_and_a_proved_error_hides_nothing(tmp_path: Path) -> None:
    """Over all ranges no method is wrong; SOLVED by a proved error is right everywhere it is said."""
    pytest.importorskip("matplotlib")
    atlas = stability_atlas(
        ["auto", "npsor", "psor", "newton"], ["ranges", "proved ranges"], quick=True
    )
    outcomes = {
        family: {cell.outcome for cell in atlas.cells if cell.family == family}
        for family in ("ranges", "proved ranges")
    }
    assert WRONG not in outcomes["ranges"]
    assert outcomes["proved ranges"] == {"right", "says that it failed"}
    assert not atlas.lies
    for family in outcomes:
        figure = atlas.plot(family=family)
        atlas.save(tmp_path / "map.png", family=family)
        assert [axes.get_title("left") for axes in figure.axes] == [
            "auto",
            "npsor",
            "psor",
            "newton",
        ]
        assert len(figure.legends[0].get_texts()) == len(OUTCOMES)


def test_a_method_of_one_s_own_has_its_map() -> None:
    """The atlas takes objects beside names, and tells from each other one that raises and one that gives up."""
    atlas = stability_atlas([Damped(), Damped(fails=True), "psor"], ["far starts"], quick=True)
    found = {
        name: {cell.outcome for cell in atlas.cells if cell.algorithm == name}
        for name in ("damped", "damped fails=True", "psor")
    }
    assert found == {
        "damped": {"right", "says that it failed"},
        "damped fails=True": {"raised an error"},
        "psor": {"right"},
    }


def test_an_atlas_without_ranges_has_no_map() -> None:
    """What is missing is named."""
    with pytest.raises(InvalidOption, match="this atlas has no 'ranges'"):
        Atlas(()).plot()


def test_two_methods_of_one_name_are_refused() -> None:
    """An own method that is called as one of ours takes nobody's place; the same method twice is one."""
    with pytest.raises(InvalidOption, match="two methods are called 'psor'"):
        contestants([*contestants({"psor": "pgs"}), "psor"])
    assert [one.label for one in contestants(["psor", "psor"])] == ["psor"]
