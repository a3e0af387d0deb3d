"""Every problem class through every interface: it works, or raises the table's error."""

from __future__ import annotations

import json
import pickle
import signal
import warnings
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from kinds_of_problems import SAMPLES, Sample
from tools.nl_files import content_of, read_sol
from tools.processes import lcp_plugin

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    Certificate,
    FrictionalContact,
    InvalidOption,
    LCPError,
    NonlinearProblem,
    NotConverged,
    QuadraticProgram,
    Status,
    UnsuitableMatrix,
    UnsuitableProblem,
    all_solutions,
    analyze,
    certify,
    complements,
    convergence_guarantee,
    cross_validate,
    derivative,
    error_against_time,
    error_bound,
    load_problem,
    march,
    prepare,
    solve,
    solve_batch,
    study,
    trace,
)
from lcp_plugin.commands import ampl
from lcp_plugin.commands.cli import app
from lcp_plugin.commands.solving import json_content
from lcp_plugin.core.problem_classes import class_of
from lcp_plugin.core.settings import OF_SOLVE
from lcp_plugin.interfaces.nl import read_nl, write_nl
from lcp_plugin.interfaces.qpsolvers import register_with_qpsolvers
from lcp_plugin.modeling._compat import CVXPY_STATUS
from lcp_plugin.problems.statement import STATUS_ELSEWHERE
from lcp_plugin.solving.dispatch import options_of
from lcp_plugin.solving.result import BaseResult

CLOSE = 1e-5
ON_CONES = ("ConeProblem", "FrictionalContact")
FUNCTIONS = (
    *(
        "solve",
        "solve_batch",
        "prepare",
        "march",
        "trace",
        "derivative",
        "certify",
        "Certificate.of",
    ),
    *("error_bound", "analyze", "all_solutions", "convergence_guarantee", "cross_validate"),
    *("error_against_time", "study"),
)
LANGUAGES = ("cvxpy", "Pyomo", "AMPL", "qpsolvers")
COMMANDS = tuple(f"lcp-plugin {name}" for name in ("solve", "analyze", "compare"))
WAYS = (*FUNCTIONS, "save", "pickle", *LANGUAGES, *COMMANDS)
OVER_CONES = (
    *("solve", "solve_batch", "march", "derivative", "certify", "save", "pickle", "cvxpy"),
    "lcp-plugin solve",
)
# The problem classes, in the order of README's table, and the interfaces that accept each.
KINDS = {
    "LCP": tuple(way for way in WAYS if way != "qpsolvers"),
    "NonlinearProblem": (
        *("solve", "solve_batch", "prepare", "march", "trace", "derivative", "certify", "pickle"),
        *("cvxpy", "Pyomo", "AMPL", "lcp-plugin solve"),
    ),
    "QuadraticProgram": (
        *("solve", "solve_batch", "prepare", "trace", "derivative", "certify", "pickle"),
        *LANGUAGES,
        "lcp-plugin solve",
    ),
    "EquilibriumProgram": (
        *("solve", "solve_batch", "certify", "pickle"),
        *("cvxpy", "Pyomo", "AMPL", "lcp-plugin solve"),
    ),
    "BoundedLeastSquares": (
        *("solve", "solve_batch", "prepare", "trace", "derivative", "certify", "pickle"),
        *LANGUAGES,
        "lcp-plugin solve",
    ),
    "ConeProblem": OVER_CONES,
    "FrictionalContact": ("prepare", *OVER_CONES),
}
KINDS = {kind: (*ways, "analyze", "lcp-plugin analyze") for kind, ways in KINDS.items()}


def confirm(answer: Any, sample: Sample) -> None:
    """Check all attributes of a result of its class, and that the solution is right."""
    assert isinstance(answer, BaseResult)
    assert answer.status in sample.ends, answer
    assert answer.is_solved == (answer.status is Status.SOLVED)
    assert answer.has_no_solution == (
        answer.status in (Status.INFEASIBLE, Status.NO_SOLUTION, Status.UNBOUNDED)
    )
    assert isinstance(answer.algorithm, str)
    assert answer.seconds >= 0.0
    assert answer.iterations >= 0
    assert len(answer.advice) > 10
    assert answer.status.name in repr(answer)
    assert "\n" not in repr(answer)
    assert str(answer) == answer.explain()
    assert answer.status.name in str(answer)
    content = json.loads(json.dumps(json_content(answer)))
    assert content["status"] == answer.status.name
    if answer.has_no_solution:
        assert answer.proof.verify()
    assert answer.proof is None or answer.has_no_solution or sample.kind == "EquilibriumProgram"
    if answer.is_solved:
        assert answer.require_solved() is answer
        if sample.x is not None:
            np.testing.assert_allclose(answer.x[:2], sample.x, atol=CLOSE)
        is_complementarity = sample.kind in ("LCP", "NonlinearProblem", *ON_CONES)
        assert (answer.objective is None) == is_complementarity
    else:
        with pytest.raises(NotConverged, match=answer.status.name):
            answer.require_solved()


def solved(sample: Sample, **options: Any) -> Any:
    return solve(sample.problem, **sample.start, **options)


# --- Interfaces that accept a class
# ---------------------------------------------------------------------------------


def by_solve(sample: Sample, folder: Path) -> None:
    confirm(solved(sample), sample)


def by_batch(sample: Sample, folder: Path) -> None:
    starts = {"z0": [*sample.start.values()] * 2} if sample.start else {}
    batches = [solve_batch([sample.problem, sample.problem], **starts)]
    if sample.kind == "QuadraticProgram":
        P, c, G, h, A, b, lower, upper = sample.program
        one = QuadraticProgram(P, c, G, h, A, b, lower=lower, upper=upper)
        batches.append(solve_batch(one, np.stack([c, c])))
    if sample.kind == "FrictionalContact":
        one = sample.problem
        instances = FrictionalContact.worlds(
            one.W, np.stack([one.b] * 2), one.friction, dimension=one.dimension
        )
        batches.append(solve_batch(instances))
        if batches[-1].all_solved:
            assert derivative(batches[-1]).vjp(np.ones(one.n)).q.shape == (2, one.n)
    for batch in batches:
        assert len(batch) == len(list(batch.status)) == 2
        assert batch.all_solved == batch.is_solved == (batch.status[0] is Status.SOLVED)
        assert f"2 {batch.status[0].name}" in repr(batch)
        assert batch.status[0].name in str(batch)
        for answer, status in zip(batch, batch.status, strict=True):
            assert answer.status is status
            confirm(answer, sample)


def by_prepare(sample: Sample, folder: Path) -> None:
    confirm(prepare(sample.problem).solve(**sample.start), sample)


def by_march(sample: Sample, folder: Path) -> None:
    forcing = np.zeros((3, sample.problem.n)) + sample.problem.q
    done = march(sample.problem, forcing, 0.0, z0=sample.start.get("x0"))
    confirm(done[0], sample)
    assert len(done) == (3 if done.all_solved else 1)
    assert done.status[-1].name in repr(done)
    assert "of 3 steps" in str(done)
    assert done.seconds > 0.0


def by_trace(sample: Sample, folder: Path) -> None:
    name = {"QuadraticProgram": "c", "BoundedLeastSquares": "b"}.get(sample.kind, "q")
    path = trace(sample.problem, {name: 0.0}, 0, 1)
    assert path.status in sample.ends
    assert path.status.name in repr(path)
    if path.is_solved and sample.x is not None:
        assert np.allclose(path.at(0.5).x, sample.x, atol=1e-6)


def by_derivative(sample: Sample, folder: Path) -> None:
    answer = solved(sample)
    if answer.is_solved:
        n = answer.x.size
        name = {"QuadraticProgram": "dc", "BoundedLeastSquares": "db"}.get(sample.kind, "dq")
        size = sample.problem.shape[0] if name == "db" else n
        found = derivative(answer)
        if name != "dq":
            found = found.one_sided()
        assert found.jvp(**{name: np.ones(size)}).shape == (n,)
    else:
        with pytest.raises(UnsuitableProblem, match=answer.status.name):
            derivative(answer)


def by_certify(sample: Sample, folder: Path) -> None:
    answer = solved(sample)
    if sample.kind in ("EquilibriumProgram", "BoundedLeastSquares"):
        if answer.is_solved:
            assert certify(sample.problem, answer.x).verdict == "proved"
    elif sample.kind != "QuadraticProgram":
        verdict = "proved" if answer.is_solved else "disproved"
        z = answer.certificate.z if answer.has_no_solution else answer.z
        assert certify(sample.problem, z).verdict == verdict
    elif answer.is_solved:
        for given in (answer.x, answer.solution, answer):
            assert certify(sample.problem, given).verdict == "proved"
    else:
        assert certify(sample.problem, claim=answer.status.name.lower()).verdict == "proved"


def by_certificate(sample: Sample, folder: Path) -> None:
    answer = solved(sample)
    certificate = Certificate.of(sample.problem, answer.z)
    assert answer.is_solved == (certificate.relative_residual <= 1e-8)


def by_bound(sample: Sample, folder: Path) -> None:
    try:
        bound = error_bound(sample.problem, solved(sample).z)
    except UnsuitableMatrix as error:
        assert "H₊-matrix" in str(error)  # noqa: PT017 - one of two ends
    else:
        assert sample.x is not None
        assert bound.infinity <= CLOSE


def by_analyze(sample: Sample, folder: Path) -> None:
    report = analyze(sample.problem)
    assert report.plan or not sample.problem.n
    assert repr(sample.problem) in str(report)


def by_all_solutions(sample: Sample, folder: Path) -> None:
    found = all_solutions(sample.problem)
    assert bool(found) == solved(sample).is_solved


def by_guarantee(sample: Sample, folder: Path) -> None:
    assert convergence_guarantee(sample.problem, "lemke").theorem


def by_cross_validation(sample: Sample, folder: Path) -> None:
    assert cross_validate(sample.problem).verdict in ("agree", "not comparable")


def by_curves(sample: Sample, folder: Path) -> None:
    assert error_against_time(sample.problem, ["lemke"], repeats=1).rows


def by_study(sample: Sample, folder: Path) -> None:
    assert [row.method for row in study(sample.problem, ["lemke"], repeats=1).rows] == ["lemke"]


def by_files(sample: Sample, folder: Path) -> None:
    sample.problem.save(folder / "p.npz")
    confirm(solve(load_problem(folder / "p.npz")), sample)


def by_pickle(sample: Sample, folder: Path) -> None:
    first = solved(sample)
    for duplicate in (deepcopy, lambda one: pickle.loads(pickle.dumps(one))):
        confirm(solve(duplicate(sample.problem), **sample.start), sample)
        confirm(duplicate(first), sample)
        assert str(duplicate(first)) == str(first)


def by_cvxpy(sample: Sample, folder: Path) -> None:
    problem = sample.in_cvxpy()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # cvxpy's, of an answer that may be inaccurate
        problem.solve(method="LCP")
    assert problem.status in {CVXPY_STATUS[status] for status in sample.ends}
    answer = problem.solver_stats.extra_stats
    assert isinstance(answer, BaseResult)
    assert answer.status in sample.ends
    if sample.x is not None:
        values = np.concatenate([np.ravel(one.value) for one in problem.variables()])
        np.testing.assert_allclose(values[: len(sample.x)], sample.x, atol=CLOSE)


def by_pyomo(sample: Sample, folder: Path) -> None:
    import pyomo.environ as pe

    import lcp_plugin.pyomo  # noqa: F401 - registers it

    model, x = sample.in_pyomo()
    found = pe.SolverFactory("lcp_plugin").solve(model, load_solutions=False)
    condition = str(found.solver.termination_condition)
    assert condition in {PYOMO_ENDS[status] for status in sample.ends}, found
    if sample.x is not None:
        model.solutions.load_from(found)
        np.testing.assert_allclose([pe.value(one) for one in x], sample.x, atol=CLOSE)


PYOMO_ENDS = {
    Status.SOLVED: "optimal",
    Status.INFEASIBLE: "infeasible",
    Status.NO_SOLUTION: "infeasible",
    Status.UNBOUNDED: "unbounded",
    Status.STALLED: "noSolution",
    Status.MAX_ITERATIONS: "maxIterations",
}


def nl_of(sample: Sample, folder: Path) -> Path:
    """Return the problem as an .nl file: an LCP by our writer, other classes by Pyomo's."""
    import pyomo.environ as pe

    if sample.kind == "LCP":
        problem = sample.problem
        sides = np.isfinite(problem.lower) + 2 * np.isfinite(problem.upper)
        rows = content_of(problem.csr.toarray(), list(problem.q), lower=problem.lower, upper=problem.upper,
                          partner_bounds=sides)  # fmt: skip
        write_nl(rows, folder / "m.nl")
        return folder / "m.nl"
    model, _ = sample.in_pyomo()
    pe.TransformationFactory("mpec.nl").apply_to(model)
    model.write(str(folder / "m.nl"), format="nl")
    return folder / "m.nl"


def by_ampl(sample: Sample, folder: Path) -> None:
    path = nl_of(sample, folder)
    assert ampl.main([str(path), "-AMPL"]) == 0
    found = read_sol(path.with_suffix(".sol"))
    assert found.code in {STATUS_ELSEWHERE[status][0] for status in sample.ends}, found.message
    assert found.message


def by_qpsolvers(sample: Sample, folder: Path) -> None:
    import qpsolvers

    register_with_qpsolvers()
    P, c, G, h, A, b, lower, upper = sample.program
    problem = qpsolvers.Problem(P, c, G, h, A, b, lower, upper)
    if Status.UNBOUNDED in sample.ends:
        with pytest.raises(qpsolvers.ProblemError, match="unbounded"):
            qpsolvers.solve_problem(problem, "lcp_plugin")
        return
    found = qpsolvers.solve_problem(problem, "lcp_plugin")
    assert found.extras["status"] in sample.ends
    assert found.found == (Status.SOLVED in sample.ends)
    if sample.x is not None:
        np.testing.assert_allclose(found.x, sample.x, atol=CLOSE)


def files_of(sample: Sample, folder: Path) -> list[Path]:
    """Return the problem in every file format that supports its class."""
    paths = [] if sample.in_pyomo is None else [nl_of(sample, folder)]
    if sample.kind in ("LCP", *ON_CONES):
        sample.problem.save(folder / "p.npz")
        paths.append(folder / "p.npz")
    elif sample.kind == "QuadraticProgram":
        names = ("P", "c", "G", "h", "A", "b", "lower", "upper")
        np.savez(folder / "p.npz", **dict(zip(names, sample.program, strict=True)))
        paths.append(folder / "p.npz")
    elif sample.kind == "BoundedLeastSquares":
        np.savez(folder / "p.npz", A=sample.problem.A, b=sample.problem.b, lower=sample.problem.lower,
                 upper=sample.problem.upper, l1=sample.problem.l1)  # fmt: skip
        paths.append(folder / "p.npz")
    return paths


def command(*words: Any) -> Any:
    return lcp_plugin(*map(str, words))


def by_command_solve(sample: Sample, folder: Path) -> None:
    for path in files_of(sample, folder):
        found = command("solve", path, "--json", "--out", folder / "out.npz")
        assert found.exit_code == (0 if Status.SOLVED in sample.ends else 1), found.output
        assert any(f'"{status.name}"' in found.output for status in sample.ends), found.output
        told = command("solve", path)
        assert any(status.name in told.output for status in sample.ends), told.output
        if sample.x is not None:
            with np.load(folder / "out.npz") as kept:
                x = kept["z" if "z" in kept else "x"]
            for value in sample.x:  # an .nl file has an order of its own, and variables of its own
                assert np.abs(x - value).min() <= CLOSE


def by_command_analyze(sample: Sample, folder: Path) -> None:
    for path in files_of(sample, folder):
        found = command("analyze", path)
        assert found.exit_code == 0, found.output


def by_command_compare(sample: Sample, folder: Path) -> None:
    sample.problem.save(folder / "p.npz")
    done = command("compare", folder / "p.npz", "-a", "lemke", "--repeats", "1")
    assert done.exit_code == 0, done.output
    assert "lemke" in done.output


TRIALS: dict[str, Callable[[Sample, Path], None]] = {
    "solve": by_solve,
    "solve_batch": by_batch,
    "prepare": by_prepare,
    "march": by_march,
    "trace": by_trace,
    "derivative": by_derivative,
    "certify": by_certify,
    "Certificate.of": by_certificate,
    "error_bound": by_bound,
    "analyze": by_analyze,
    "all_solutions": by_all_solutions,
    "convergence_guarantee": by_guarantee,
    "cross_validate": by_cross_validation,
    "error_against_time": by_curves,
    "study": by_study,
    "save": by_files,
    "pickle": by_pickle,
    "cvxpy": by_cvxpy,
    "Pyomo": by_pyomo,
    "AMPL": by_ampl,
    "qpsolvers": by_qpsolvers,
    "lcp-plugin solve": by_command_solve,
    "lcp-plugin analyze": by_command_analyze,
    "lcp-plugin compare": by_command_compare,
}
REFUSALS: dict[str, Callable[[Any, Any], Any]] = {
    "solve_batch": lambda p, _: solve_batch([p]),
    "prepare": lambda p, _: prepare(p),
    "march": lambda p, _: march(p, [[1.0, 1.0]]),
    "trace": lambda p, _: trace(p, {"q": 1}, 0, 1),
    "derivative": lambda _, answer: derivative(answer()),
    "certify": lambda p, answer: certify(p, answer().x),
    "Certificate.of": lambda p, _: Certificate.of(p, [1.0, 1.0]),
    "error_bound": lambda p, _: error_bound(p, [1.0, 1.0]),
    "all_solutions": lambda p, _: all_solutions(p),
    "convergence_guarantee": lambda p, _: convergence_guarantee(p),
    "cross_validate": lambda p, _: cross_validate(p),
    "error_against_time": lambda p, _: error_against_time(p),
    "study": lambda p, _: study(p, ["lemke"]),
}
CELLS = [pytest.param(sample, way, id=f"{sample} × {way}") for sample in SAMPLES for way in WAYS]


def test_every_kind_and_every_way_has_its_row():
    """A class without samples, or a way without a trial, is found here."""
    assert {sample.kind for sample in SAMPLES} == set(KINDS)
    assert TRIALS.keys() == set(WAYS)
    assert {f"lcp-plugin {one.name}" for one in app.registered_commands} >= set(COMMANDS)


def test_readme_shows_the_table_in_small():
    """README's rows are the classes, with a mark if all interfaces of a column accept the class."""
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    head, _, *rows = next(
        part for part in text.split("\n\n") if part.startswith("| class |")
    ).splitlines()
    columns = [cell.replace("`", "").split(", ") for cell in map(str.strip, head.split("|")[2:-1])]
    assert [row.split("`")[1].partition("(")[0] for row in rows] == [*KINDS]
    for row, (kind, taken) in zip(rows, KINDS.items(), strict=True):
        marks = [cell.strip() for cell in row.rsplit("|", len(columns) + 1)[1:-1]]
        assert marks == ["✓" * all(way in taken for way in ways) for ways in columns], kind


@pytest.mark.quick(3)
@pytest.mark.parametrize(("sample", "way"), CELLS)
def test_each_cell_works_or_is_refused_in_words(sample, way, tmp_path):
    """“INFEASIBLE, NO_SOLUTION and UNBOUNDED come with a proof”, as all results of a way that takes the kind are right.

    Any other way names the classes that it takes.
    """
    if way in KINDS[sample.kind]:
        TRIALS[way](sample, tmp_path)
    elif way in REFUSALS:
        with pytest.raises(LCPError, match=f"{way} .*got"):
            REFUSALS[way](sample.problem, lambda: solved(sample))
    elif way in COMMANDS:
        for path in files_of(sample, tmp_path):
            if sample.kind == "BoundedLeastSquares" and path.suffix == ".nl":
                continue  # where it is a program
            assert command(way.split()[1], path).exit_code == 2


def test_batches_of_contacts_work_or_are_refused_in_words(tmp_path):
    """A batch in arrays is solved, differentiated, pickled and saved; every other way names solve_batch."""
    batch = FrictionalContact.worlds(
        np.stack([np.eye(3)] * 2), [[-1.0, 3.0, 4.0], [-1.0, 0.3, 0.0]], 0.5
    )
    batch.save(tmp_path / "w.npz")
    for copy in (batch, pickle.loads(pickle.dumps(batch)), load_problem(tmp_path / "w.npz")):
        answers = solve_batch(copy).require_solved()
        assert str(answers) == answers.explain()
        np.testing.assert_allclose(answers.z, [[1.0, -0.3, -0.4], [1.0, -0.3, 0.0]], atol=CLOSE)
        assert derivative(answers).vjp(np.ones((2, 3))).M.shape == (2, 3, 3)
    answers = pickle.loads(pickle.dumps(solve_batch(batch)))
    assert answers[1].is_solved
    words = [*REFUSALS.keys() - {"solve_batch", "derivative", "certify", "study"}]
    for refuse in (lambda p, _: solve(p), *(REFUSALS[way] for way in words)):
        with pytest.raises(LCPError, match=r"got FrictionalContactBatch|M must hold"):
            refuse(batch, lambda: answers)  # type: ignore[no-untyped-call]
    with pytest.raises(LCPError, match="problems must be problems, functions or names"):
        study(batch, ["lemke"])
    for way in COMMANDS[:-1]:
        found = command(way.split()[1], tmp_path / "w.npz")
        assert found.exit_code == 2
        assert "FrictionalContact" in found.output, found.output


# --- Options of solve, Ctrl-C ----------------------------------------------------------------------------------------

WISHES: dict[str, Any] = {
    "tolerance": 1e-7,
    "max_iterations": 10_000,
    "max_seconds": 60.0,
    "absolute_tolerance": 1e-12,
    "record": True,
    "threads": 1,
    "verbose": True,
    "prove_infeasibility": False,
    "polish": False,
    "z0": np.ones(2),
    "x0": np.ones(2),
    "callback": lambda *given: None,
    "algorithm": "lemke",
    "max_nodes": 1000,
}
SOLVABLE = [sample for sample in SAMPLES if Status.SOLVED in sample.ends]


def test_every_option_of_solve_is_walked():
    """An option without a value to try is found here."""
    named = {"algorithm", "x0", "max_nodes", *OF_SOLVE}
    assert named == WISHES.keys()


@pytest.mark.quick(16)
@pytest.mark.parametrize("name", WISHES)
@pytest.mark.parametrize("sample", SOLVABLE, ids=repr)
def test_each_option_is_taken_or_refused_in_words(sample, name, capsys):
    """Each option has its documented effect; unsupported ones raise an error."""
    known, wish = options_of(sample.kind), WISHES[name]
    is_taken = name in OF_SOLVE or name == "algorithm" if "options" in known else name in known
    is_start_x = name == "z0" and "z0" not in known and "x0" in known
    is_taken = is_taken or is_start_x
    wish = "newton" if name == "algorithm" and sample.kind in ON_CONES else wish
    if name in ("z0", "x0") and is_taken:
        wish = solved(sample).z if name == "z0" and not is_start_x else solved(sample).x
    try:
        answer = solve(sample.problem, **{**sample.start, name: wish})
    except InvalidOption as error:
        assert not is_taken or sample.kind not in ("LCP",)
        assert name in str(error)  # noqa: PT017
        return
    assert is_taken
    confirm(answer, sample)
    if name == "record":
        assert answer.history
    assert bool(capsys.readouterr().out) == (name == "verbose")


@pytest.mark.parametrize("sample", SOLVABLE, ids=repr)
@pytest.mark.parametrize("how", ["a true value", "Ctrl-C"])
def test_a_callback_ends_the_run(sample, how):
    """A true return value, or Ctrl-C, ends the run with INTERRUPTED and the best point so far; a number is refused."""
    seen = []

    def callback(*given):
        seen.append(given)
        if how == "Ctrl-C":
            signal.raise_signal(signal.SIGINT)
        return how != "Ctrl-C"

    answer = solved(sample, callback=callback)
    is_settled = sample.kind == "EquilibriumProgram"  # by its root
    assert answer.status is (Status.SOLVED if is_settled else Status.INTERRUPTED)
    assert len(seen) == (not is_settled)
    assert answer.status.name in str(answer)
    with pytest.raises(InvalidOption, match="callback must be callable"):
        solved(sample, callback=5)


@pytest.mark.parametrize("limit", ["max_seconds", "max_iterations"])
@pytest.mark.parametrize("sample", SAMPLES, ids=repr)
def test_without_time_or_steps_the_start_is_returned(sample, limit):
    """No iteration is made: the status is that of the limit, or of a program that needs no step."""
    if limit not in options_of(sample.kind) and sample.kind == "EquilibriumProgram":
        return  # it counts nodes
    answer = solved(sample, **{limit: 0})
    assert answer.iterations == 0
    needs_step = sample.kind not in ("QuadraticProgram", "EquilibriumProgram")
    assert answer.status in (Status[limit.upper()], *(() if needs_step else sample.ends))
    if answer.x is None:  # a search has found no solution yet
        assert sample.kind == "EquilibriumProgram"
    else:
        assert answer.x.shape[0] >= 2


# --- Sequences of answers --------------------------------------------------------------------------------------------


def one_of_each_kind() -> list[Any]:
    """Return a problem of each class that solve_batch accepts."""
    return list({one.kind: one.problem for one in SOLVABLE}.values())


def test_time_ends_a_batch_of_several_kinds():
    """Each problem has a status, those that were not begun MAX_SECONDS without an iteration.

    Stacks of small problems over cones and of small LCPs come first.
    """
    problems = sorted(
        one_of_each_kind() * 500, key=lambda one: class_of(one) not in (*ON_CONES, "LCP")
    )  # type: ignore[union-attr]
    answers = solve_batch(problems, max_seconds=0.2)
    assert len(answers) == len(answers.status) == len(problems)
    assert answers[-1].iterations == 0
    assert answers.status[-1] is answers[-1].status is Status.MAX_SECONDS
    assert not answers.is_solved
    assert "MAX_SECONDS" in repr(answers)
    assert {answers[-k].status for k in (1, 2, 3, 4)} == {Status.MAX_SECONDS}


def test_ctrl_c_ends_a_batch_of_several_kinds(monkeypatch):
    """Solved problems are kept, stacks come first, the remaining are INTERRUPTED."""
    one, two, *_ = problems = one_of_each_kind()

    def interrupted(problem, **options):
        if problem is two:
            raise KeyboardInterrupt
        return solve(problem, **options)

    monkeypatch.setattr("lcp_plugin.problems.batches.batch_run.solve", interrupted)
    answers = solve_batch(problems)
    assert len(answers) == len(problems)
    is_done = [problem is one or class_of(problem) in (*ON_CONES, "LCP") for problem in problems]  # type: ignore[union-attr]
    assert [status.name for status in answers.status] == [
        "SOLVED" if done else "INTERRUPTED" for done in is_done
    ]


def test_a_batch_tells_what_is_wrong_with_a_problem():
    """The errors and the summary of a batch contain the reason for an invalid problem."""
    bent = QuadraticProgram([[-1.0]], [0.0])
    for answers in (solve_batch([one_of_each_kind()[0], bent]), solve_batch([[[np.nan]]], [[1.0]])):
        k = len(answers) - 1
        assert answers.status[k] is None
        assert str(answers.errors[k]) in answers.explain()
        with pytest.raises(NotConverged, match=r"no problem: .*(convex|finite|NaN)"):
            answers.require_solved()


@pytest.mark.parametrize("no", [
    solve_batch([]), solve_batch(np.eye(2), np.zeros((0, 2))), march(LCP(np.eye(2), [0, 0]), np.zeros((0, 2))),
    solve_batch(QuadraticProgram(np.eye(2), [0, 0]), np.zeros((0, 2))),
], ids=lambda answers: type(answers).__name__)  # fmt: skip
def test_a_sequence_of_no_answers(no):
    """A batch without problems is solved, and its summary is "none"."""
    assert len(no) == len(no.status) == 0
    assert no.is_solved
    assert no.require_solved() is no
    assert "none" in repr(no)
    assert "none" in no.explain()


def test_derivative_names_the_answer_that_it_takes():
    """The error of an unsupported batch says what to write instead; LCP results of a list are accepted."""
    answers = solve_batch(one_of_each_kind())
    with pytest.raises(InvalidOption, match=r"write \[derivative\(answer\) for answer in batch\]"):
        derivative(answers)
    assert derivative(answers[0]).jvp(dq=np.ones(2)).shape == (2,)


def start_in_python() -> Any:
    return solve(NonlinearProblem(lambda x: np.log(x) + 1.0), x0=[-1.0])


def start_in_cvxpy() -> Any:
    x = cp.Variable(value=[-1.0], shape=1)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, cp.log(x) + 1 >= 0)])
    problem.solve(method="LCP")
    return problem.solver_stats.extra_stats


def start_in_pyomo(through_a_file: Path | None = None) -> Any:
    pyo, mpec = pytest.importorskip("pyomo.environ"), pytest.importorskip("pyomo.mpec")
    pytest.importorskip("lcp_plugin.pyomo")
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-1.0)
    m.pair = mpec.Complementarity(expr=mpec.complements(m.x >= 0, pyo.log(m.x) + 1 >= 0))
    if through_a_file is not None:
        write_nl(m, through_a_file)
        return read_nl(through_a_file).solve().result
    solver = pyo.SolverFactory("lcp_plugin")
    solver.solve(m)
    return solver.result


def test_runs_begin_by_one_rule_whatever_the_language(tmp_path):
    """Each interface starts at 1 instead of x = −1, solves log x + 1 = 0, and reports the start."""
    for run_from_start in (
        start_in_python,
        start_in_cvxpy,
        start_in_pyomo,
        partial(start_in_pyomo, tmp_path / "m.nl"),
    ):
        result = run_from_start()
        assert result.is_solved
        assert float(result.x[0]) == pytest.approx(np.exp(-1.0))
        assert (
            "started at the point of the bounds nearest to 1: F or its derivative is not finite"
            in str(result)
        )


def test_a_start_is_z0_and_a_tolerance_relative_in_every_kind():
    """Every class accepts z0, equivalent to x0, and rejects a tolerance of 1 or more."""
    root = NonlinearProblem(lambda x: x**3 - 8.0, lower=[0.0])
    squares = BoundedLeastSquares(np.array([[2.0, 1.0], [1.0, 3.0]]), [1.0, -1.0])
    for problem, start in ((root, [1.0]), (squares, [0.5, 0.5])):
        assert np.array_equal(solve(problem, z0=start).x, solve(problem, x0=start).x)
    for problem, more in (
        (LCP([[2.0]], [-1.0]), {}),
        (QuadraticProgram([[2.0]], [-1.0]), {}),
        (root, {"z0": [1.0]}),
        (squares, {}),
    ):
        with pytest.raises(
            InvalidOption, match="tolerance must be less than 1, got 2: it is relative"
        ):
            solve(problem, tolerance=2, **more)
