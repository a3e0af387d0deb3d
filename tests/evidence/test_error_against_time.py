"""Error against time: an honest clock, curves that can be had again, and nothing that a scene does not need."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg
from fresh_process import printed_by
from legends import hides_nothing

from lcp_plugin import LCP, InvalidOption, UnknownAlgorithm, gallery, solve
from lcp_plugin.algorithms import Algorithm, Step
from lcp_plugin.core.matrix.matrix import Matrix, fact
from lcp_plugin.evidence import error_against_time as module
from lcp_plugin.evidence.contestants import contestants
from lcp_plugin.evidence.curves import Curve, Point, Report, performance_profile
from lcp_plugin.evidence.drawing import styles
from lcp_plugin.evidence.error_against_time import error_against_time
from lcp_plugin.evidence.pictures import draw
from lcp_plugin.proofs.bounds.error_bounds import error_bound

NAP = 0.06


@fact
def nap_about(matrix: Matrix, seconds: float) -> None:
    """Sleep once a matrix, as a costly analysis of it would."""
    time.sleep(seconds)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Richardson(Algorithm):
    """z⁺ = mid(lower, upper, z − w/10), with naps."""

    name = "richardson"
    nap: float = 0.0
    nap_about_matrix: float = 0.0
    gives_up: bool = False

    def iterates(self, problem: LCP, z0: Any) -> Any:
        """Yield z₀, z₁, …."""
        time.sleep(self.nap)
        nap_about(problem.matrix, self.nap_about_matrix)
        z = z0
        for k in range(100_000):
            if self.gives_up and k == 3:
                raise KeyboardInterrupt
            yield Step(z)
            z = (z - 0.1 * problem.slack(z)).clip(problem.lower, problem.upper)


def scene(n: int = 100) -> Any:
    return gallery.build("half_active", n=n)


def without_seconds(report: Report) -> list[Any]:
    """Everything that must be the same in every run."""
    curves = [
        (
            curve.label,
            curve.status,
            [(p.iteration, p.work, p.error, p.residual) for p in curve.points],
        )
        for curve in report.curves
    ]
    return [curves, report.error_kind, report.active_share, report.left_out]


# --- The clock ------------------------------------------------------------------------------------------------


def test_sleep_in_set_up_shows() -> None:
    """An algorithm that sleeps before its first iterate shows it at its first point, and in every later one."""
    curve = error_against_time(scene(), {"sleepy": Richardson(nap=NAP)}, repeats=2).curves[0]
    assert curve.points[0].iteration == 0
    assert min(point.seconds for point in curve.points) >= curve.setup_seconds >= NAP


def test_slow_error_measurement_does_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measuring the error may take as long as it likes: the curve's seconds do not hold it."""
    calls = []

    def slow_distance(z: Any, exact: Any) -> float:
        calls.append(0)
        time.sleep(NAP)
        return float(np.max(np.abs(z - exact)))

    monkeypatch.setattr(module, "distance", slow_distance)
    curve = error_against_time(scene(), ["pgs"], repeats=1).curves[0]
    assert len(calls) >= 10
    assert curve.seconds < 0.25 * NAP * len(calls)


def test_what_is_computed_about_the_matrix_is_paid_in_every_run() -> None:
    """Nothing that one run keeps with the problem makes the set-up of the next one look cheaper."""
    curve = error_against_time(
        scene(), {"once": Richardson(nap_about_matrix=NAP)}, repeats=3
    ).curves[0]
    assert curve.points[0].seconds_low >= NAP


def test_seconds_rise_and_lie_between_their_quartiles() -> None:
    """Along a curve iterations and work rise; each median lies between its quartiles."""
    report = error_against_time(scene(), ["npsor", "psor"], repeats=3)
    for curve in report.curves:
        assert all(p.seconds_low <= p.seconds <= p.seconds_high for p in curve.points)
        for before, after in itertools.pairwise(curve.points):
            assert before.iteration < after.iteration
            assert before.work <= after.work


def test_interruption_ends_a_measurement() -> None:
    """Ctrl-C, after which solve() keeps the best iterate, ends a measurement instead of becoming a curve."""
    with pytest.raises(KeyboardInterrupt):
        error_against_time(scene(), {"stopped": Richardson(gives_up=True)}, repeats=1)


# --- The curves -----------------------------------------------------------------------------------------------


def test_reruns_agree_in_everything_but_seconds() -> None:
    """Iterations, work, errors, residuals and statuses of all default algorithms are the same in two calls."""
    first, second = (error_against_time(scene(), repeats=repeats) for repeats in (1, 2))
    assert without_seconds(first) == without_seconds(second)
    assert [len(curve.points) for curve in first.curves] == [
        len(curve.points) for curve in second.curves
    ]


def test_curve_is_the_run_that_solve_makes() -> None:
    """The last point has the iterations, work and residual that solve() reports, and the true error of its z."""
    problem = scene()
    curve = error_against_time(problem, ["npsor"], repeats=1).curves[0]
    result = solve(problem.problem, "npsor")
    last = curve.points[-1]
    assert (last.iteration, last.work) == (result.iterations, result.work)
    assert last.residual == result.certificate.relative_residual
    assert last.error == np.max(np.abs(result.z - problem.exact))
    assert curve.points[0].error == np.max(np.abs(problem.exact))  # z° = 0


def test_points_are_geometric() -> None:
    """Thousands of iterations give some dozen points."""
    curve = error_against_time(gallery.build("obstacle_2d", size=30), ["gfp"], repeats=1).curves[0]
    assert curve.iterations > 500
    assert len(curve.points) < 80


def test_limit_of_work_ends_a_run_and_is_named() -> None:
    """A run that reaches max_work says MAX_WORK, not INTERRUPTED."""
    curve = error_against_time(
        gallery.build("obstacle_2d", size=30), ["gfp"], repeats=2, max_work=50
    ).curves[0]
    assert curve.status == "MAX_WORK"
    assert 50 <= curve.work <= 52


def test_axis_is_the_true_error_then_a_bound_then_the_residual() -> None:
    """The error is the true one where z* is known, a bound that is never too small for H₊, else the residual."""
    bumps = gallery.build("obstacle_bumps", size=12)
    exact = solve(bumps.problem, "multigrid", tolerance=1e-13).z
    report = error_against_time(bumps, ["npsor"], repeats=1)
    assert report.error_kind == "rigorous bound"
    found: dict[int, float] = {}

    def record(sample: Any, z: Any) -> None:
        found[sample.iteration] = float(np.max(np.abs(z - exact)))

    solve(bumps.problem, "npsor", callback=record)
    assert all(
        point.error >= found[point.iteration] - 1e-12 for point in report.curves[0].points[:-1]
    )
    plain = error_bound(bumps.problem, _iterate(bumps, 5), sharp=False).infinity
    assert report.curves[0].points[5].error < min(0.2 * plain, (1.0 + 1e-9) * found[5])
    assert error_against_time(scene(), ["pgs"], repeats=1).error_kind == "true error"
    other = error_against_time(gallery.build("rotated_anisotropy", size=8), ["pgs"], repeats=1)
    assert other.error_kind == "residual"
    assert dict(other.left_out)["rigorous bound"] == "M is not declared to be an H₊-matrix"


def convection(size: int) -> LCP:
    """Convection–diffusion on a size × size grid, no constraint active; ⟨M⟩⁻¹ is millions of times as large as M⁻¹."""
    o, eye = np.ones(size - 1), sp.eye_array(size)
    along = sp.diags_array([-1.4 * o, 4.0 * np.ones(size), -0.6 * o], offsets=[-1, 0, 1])
    across = sp.diags_array([-o, -o], offsets=[-1, 1])
    return LCP(sp.csr_array(sp.kron(eye, along) + sp.kron(across, eye)), -np.ones(size * size))


@pytest.mark.parametrize("size", [5, 50])
def test_the_bound_that_is_drawn_is_the_sharp_one(size: int) -> None:
    """Of a SOLVED convection–diffusion problem the error drawn is what it is, not what the plain bound makes of it."""
    problem = convection(size)
    z = solve(problem, "psor").z
    error = float(np.max(np.abs(z - scipy.sparse.linalg.spsolve(problem.csr.tocsc(), -problem.q))))
    report = error_against_time(problem, ["psor"], repeats=1)
    assert report.error_kind == "rigorous bound"
    assert report.curves[0].points[-1].error == pytest.approx(error, rel=1e-3)
    assert error_bound(problem, z, sharp=False).infinity > 1e8 * error
    if size == 5:
        assert "rigorous bound 2.9e-09" in str(report)


@pytest.mark.full
def test_iterative_solves_go_on_as_long_as_they_gain() -> None:
    """Where the free rows are solved by Krylov steps, a plain bound 1e13 times the error still becomes a sharp one."""
    problem = convection(250)
    z = solve(problem, "multigrid").z
    error = float(np.max(np.abs(z - scipy.sparse.linalg.spsolve(problem.csr.tocsc(), -problem.q))))
    assert error_bound(problem, z).infinity == pytest.approx(error, rel=0.01)


def test_where_a_bound_says_nothing_the_residual_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rigorous bound as large as z itself is left out, and the report says so."""
    monkeypatch.setattr("lcp_plugin.proofs.bounds.error_bounds.STEPS", 0)
    report = error_against_time(convection(50), ["psor"], repeats=1)
    assert report.error_kind == "residual"
    assert report.curves[0].points[-1].error <= 1e-8
    assert "which says nothing" in dict(report.left_out)["rigorous bound"]


def _iterate(problem: Any, count: int) -> Any:
    found = []
    solve(
        problem.problem,
        "npsor",
        callback=lambda sample, z: bool(found.append(z.copy()) or sample.iteration == count),
    )
    return found[count]


def test_plain_problem_is_examined() -> None:
    """Of an LCP without a scene it is found out whether M allows a bound; where it does not the residual is shown."""
    assert (
        error_against_time(LCP([[4, -1], [-1, 4]], [-3, 5]), ["pgs"], repeats=1).error_kind
        == "rigorous bound"
    )
    assert (
        error_against_time(LCP([[1, 4], [4, 1]], [-3, 5]), ["npsor"], repeats=1).error_kind
        == "residual"
    )


# --- What is left out -----------------------------------------------------------------------------------------


def test_algorithms_that_refuse_are_left_out_with_their_reason() -> None:
    """Who cannot run on a problem has no curve but a line that says why."""
    report = error_against_time(
        gallery.build("relay_control", n=4), ["mgs", "npsor"], repeats=1, max_work=50
    )
    assert [curve.label for curve in report.curves] == ["npsor"]
    assert "upper" in dict(report.left_out)["mgs"]


LAZY = """
import sys
from lcp_plugin import gallery
from lcp_plugin.evidence.error_against_time import error_against_time
error_against_time(gallery.parse({scene!r}), ["pgs"], ("osqp",), repeats=1, max_work=100)
print([name for name in {names!r} if name in sys.modules])
"""


@pytest.mark.full
@pytest.mark.parametrize(
    ("text", "absent"),
    [
        ("random_h_plus:n=20", ("cvxpy", "lcp_plugin.proofs.bounds.error_bounds")),
        ("optimal_stopping:size=4", ("cvxpy",)),
        ("relay_control:n=4", ("cvxpy", "lcp_plugin.proofs.bounds.error_bounds", "pyamg")),
    ],
)
def test_what_is_left_out_is_not_imported(text: str, absent: tuple[str, ...]) -> None:
    """No convex solver where M is not symmetric, no bound where z* is known or M not H₊, no picture unless drawn."""
    code = LAZY.format(scene=text, names=[*absent, "matplotlib", "jinja2"])
    assert printed_by(code) == "[]"


def test_references_that_are_left_out_are_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where M is not symmetric no formulation is even looked for; one without a limit is kept to small n."""
    from lcp_plugin.evidence import qp_reference

    monkeypatch.setattr(
        qp_reference.Formulation, "of", lambda problem: pytest.fail("computed for nothing")
    )
    report = error_against_time(
        gallery.build("optimal_stopping", size=4), ["pgs"], ("osqp",), repeats=1
    )
    assert "not symmetric" in dict(report.left_out)["quadratic programs"]
    monkeypatch.undo()
    report = error_against_time(scene(225), ["pgs"], ("daqp", "clarabel"), repeats=1)
    assert "200" in dict(report.left_out)["daqp"]
    assert [reference.label for reference in report.references] == ["clarabel"]
    assert report.references[0].error < 1e-8


# --- Telling --------------------------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("ending", [".pdf", ".svg", ".png"])
def test_a_figure_for_a_journal_has_no_type_3_font(ending: str, tmp_path: Path) -> None:
    """PDF holds TrueType fonts, as journals ask for; nobody's own settings of matplotlib change, nor matter."""
    import matplotlib as mpl

    report = error_against_time(scene(), ["pgs"], repeats=1)
    with mpl.rc_context({"pdf.fonttype": 3}):
        before = dict(mpl.rcParams)
        report.save(tmp_path / f"curves{ending}")
        draw(solve(scene().problem, record=True), tmp_path / f"answer{ending}", scene())
        assert dict(mpl.rcParams) == before
    for name in ("curves", "answer"):
        content = (tmp_path / f"{name}{ending}").read_bytes()
        assert b"/Type3" not in content
        assert (b"/TrueType" in content or b"/CIDFontType2" in content) == (ending == ".pdf")


@pytest.mark.parametrize(
    ("algorithms", "labels"),
    [
        ([("npsor", {"relaxation": 1.5}), "auto"], ["npsor relaxation=1.5", "auto"]),
        (("npsor", {"relaxation": 1.5}), ["npsor relaxation=1.5"]),
        ([("auto", {})], ["auto"]),
        ({"mine": ("npsor", {"relaxation": 1.5}), 2: "psor"}, ["mine", "2"]),
    ],
)
def test_options_may_stand_beside_a_name(algorithms: Any, labels: list[str]) -> None:
    """A name with its options is an algorithm, alone, in a list, and under a label."""
    report = error_against_time(scene(), algorithms, repeats=1)
    assert [curve.label for curve in report.curves] == labels


def test_csv_and_json_hold_every_digit(tmp_path: Path) -> None:
    """The CSV has one line a point with all digits, and so has JSON."""
    report = error_against_time(scene(), ["pgs", "gfp"], ("clarabel",), repeats=1)
    report.save(tmp_path / "curves.csv")
    report.save(tmp_path / "curves.json")
    rows = list(csv.DictReader(io.StringIO(report.to_csv())))
    assert (tmp_path / "curves.csv").read_text(encoding="utf-8") == report.to_csv()
    assert len(rows) == sum(len(curve.points) for curve in report.curves) + 1
    errors = [float(row["error"]) for row in rows if row["algorithm"] == "gfp"]
    assert errors == [point.error for point in report.curves[1].points]
    assert (tmp_path / "curves.json").read_text(encoding="utf-8") == report.to_json()
    assert json.loads(report.to_json())["curves"][1]["points"][-1][5] == report.curves[1].last.error
    assert "pgs" in str(report)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("against", ["seconds", "work"])
def test_plot_names_every_curve_and_its_axis(against: str, tmp_path: Path) -> None:
    """The picture has log–log axes, says which error it shows, and names each curve in its family's colour."""
    report = error_against_time(scene(), repeats=1)
    figure = report.plot(against=against)
    report.save(tmp_path / "curves.svg", against=against)
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert "true error" in axes.get_ylabel()
    assert names_in(figure) == {curve.label for curve in report.curves}
    assert axes.get_title("left")
    assert (tmp_path / "curves.svg").stat().st_size > 1000


def names_in(figure: Any) -> set[str]:
    """The names beside the lines, and those of every legend."""
    legends = [legend for one in (figure, *figure.subfigs) for legend in one.legends]
    beside = [text.get_text() for axes in figure.axes for text in axes.texts]
    return {*beside, *(text.get_text() for legend in legends for text in legend.get_texts())}


@pytest.mark.full
def test_names_stand_where_they_hide_nothing() -> None:
    """Two curves, or twelve, have their names below the axes, and the axes keep most of the figure."""
    few = error_against_time(
        gallery.build("obstacle_2d", size=12), ["npgs", "psor"], repeats=1
    ).plot()
    assert names_in(few) == {"npgs", "psor"}
    many = error_against_time(scene(), repeats=1).plot()
    assert len(names_in(many)) == 12
    for figure in (few, many):
        assert hides_nothing(figure)
        assert figure.axes[0].get_position().height > 0.4


def test_no_two_curves_look_alike_in_grey() -> None:
    """In the report's comparison dashes and marker together belong to one curve: it can be read in grey."""
    entrants = contestants(None)
    looks = [
        (look["marker"], str(look["linestyle"]))
        for look in styles([one.family for one in entrants])
    ]
    assert len(set(looks)) == len(entrants)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("spread_of_seconds", [1.5, 4.0, 30.0, 1e5])
def test_axis_of_a_plot_can_be_read(spread_of_seconds: float) -> None:
    """However few decades the curves span, at least two numbers stand at the axis; no name reaches beyond it."""
    curves = tuple(
        Curve(label, "modulus (M)", "MAX_WORK", (Point(0, 1, first, first, first, 1.0, 1.0),
                                                 Point(9, 9, last, last, last, 1e-5, 1e-5)))
        for label, first, last in (("NPSOR paper", 2e-3, 2e-3 * spread_of_seconds), ("a", 2e-3, 3e-3))
    )  # fmt: skip
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = Report("t", "", 1, 1, "residual", 1e-8, 1, 0.5, curves).plot()
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    low, high = axes.get_xlim()
    numbers = [
        tick.label1.get_text()
        for minor in (False, True)
        for tick in (axes.xaxis.get_minor_ticks() if minor else axes.xaxis.get_major_ticks())
        if low <= tick.get_loc() <= high and tick.label1.get_text()
    ]
    assert 2 <= len(numbers) <= 9
    frame = figure.bbox
    assert all(
        frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
        for box in (
            text.get_window_extent() for text in axes.texts if text.get_text() != "tolerance"
        )
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"repeats": 0}, "repeats must be a whole number ≥ 1, got 0"),
        ({"repeats": True}, "repeats must be"),
        (
            {"references": "osqp"},
            r"references must be a list of names, got the word 'osqp'; write \['osqp'\]",
        ),
        ({"references": ("osqpp",)}, "unknown reference 'osqpp'; did you mean 'osqp'"),
        ({"references": 5}, "references must be a list of names, got 5"),
        ({"max_work": "10"}, "max_work must be a number > 0, got '10'"),
        ({"max_work": math.nan}, "max_work must be a number > 0, got nan"),
        ({"max_work": 0}, "max_work must be a number > 0, got 0"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, Any], words: str) -> None:
    """What cannot be used is named before anything runs."""
    with pytest.raises(InvalidOption, match=words):
        error_against_time(scene(), ["pgs"], **arguments)


def test_bad_targets_and_names_are_refused() -> None:
    """Neither a matrix nor a misspelt algorithm is taken; a plot has two axes to choose from."""
    with pytest.raises(InvalidOption, match=r"needs an LCP, got ndarray.*may also be a scene"):
        error_against_time(np.eye(2))  # type: ignore[arg-type]
    with pytest.raises(UnknownAlgorithm, match="did you mean 'psor'"):
        error_against_time(scene(), ["psr"])
    with pytest.raises(InvalidOption, match=r'algorithms must be names .* got 5; write \["psor"\]'):
        error_against_time(scene(), 5)
    with pytest.raises(InvalidOption, match="against must be"):
        error_against_time(scene(), ["pgs"], repeats=1).plot(against="time")


# --- Who takes part -------------------------------------------------------------------------------------------


def test_comparison_holds_the_promise() -> None:
    """The paper's methods stand with its settings and with ours, beside modulus, fixed point and relaxation."""
    labels = {one.label for one in contestants(None)}
    assert labels >= {
        "NPGS",
        "NPSOR",
        "NPAOR",
        "NPGS paper",
        "NPSOR paper",
        "MGS paper",
        "MSOR paper",
        "GFP",
        "PGS",
        "PSOR",
    }
    report = error_against_time(gallery.build("relay_control", n=4), max_work=50)
    assert {"MGS paper", "MSOR paper"} <= {what for what, _ in report.left_out}


def test_labels_show_options_that_differ() -> None:
    """A contestant without a label of its own is named after its changed options."""
    labels = [one.label for one in contestants(["npsor", "auto", solve_options(relaxation=1.2)])]
    assert labels == ["npsor", "auto", "npsor relaxation=1.2"]


def solve_options(**options: Any) -> Algorithm:
    from lcp_plugin.algorithms import create

    return create("npsor", options)


# --- Performance profile --------------------------------------------------------------------------------------


def report_of(title: str, **works: float) -> Report:
    """A report made by hand: the work of each algorithm; negative where it was not solved."""
    curves = tuple(
        Curve(
            label,
            "other",
            "SOLVED" if work > 0 else "STALLED",
            (Point(1, abs(work), 1.0, 1.0, 1.0, 0.1, 0.1),),
        )
        for label, work in works.items()
    )
    return Report(title, "", 1, 1, "residual", 1e-8, 1, 0.5, curves)


def test_profile_of_a_worked_example() -> None:
    """Ratios to the best of each problem; who fails or is left out counts as infinitely slow."""
    made = {"p": {"a": 10, "b": 20}, "q": {"a": 30, "b": -5}, "r": {"b": 7}, "s": {"a": -1}}
    profile = performance_profile([report_of(title, **works) for title, works in made.items()])
    assert profile.problems == ("p", "q", "r")
    assert profile.ratios == ((1.0, 1.0, math.inf), (2.0, math.inf, 1.0))
    assert profile.share("a") == pytest.approx(2 / 3)
    assert profile.share("b", 2.0) == pytest.approx(2 / 3)
    assert profile.share("b", math.inf) == pytest.approx(2 / 3)
    assert len(profile.to_csv().splitlines()) == 7
    assert json.loads(profile.to_json())["ratios"][0][2] is None
    assert names_in(profile.plot()) == {"a ✕", "b ✕"}


def test_profile_refuses_what_it_cannot_use() -> None:
    """A profile needs a report, and a cost that it knows."""
    with pytest.raises(InvalidOption, match="at least one report"):
        performance_profile([])
    with pytest.raises(InvalidOption, match="by must be"):
        performance_profile([report_of("p", a=1)], by="money")
    with pytest.raises(InvalidOption, match=r"got one Report; write \[report\]"):
        performance_profile(report_of("p", a=1))  # type: ignore[arg-type]
    with pytest.raises(InvalidOption, match="no algorithm 'psor' in this profile; it has a"):
        performance_profile([report_of("p", a=1)]).share("psor")


def test_profile_of_a_problem_that_needs_no_work() -> None:
    """Where the start is the answer, no pass counts as one, and no ratio explodes."""
    assert performance_profile([report_of("p", a=1e-300, b=3)]).ratios == ((1.0,), (3.0,))
