"""lcp-plugin-ampl: the convention by which AMPL, Pyomo and JuMP call a solver."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from binary_nl import write_form
from tools.nl_files import content_of, read_sol

from lcp_plugin.commands import ampl, cli
from lcp_plugin.interfaces.nl import write_nl
from lcp_plugin.interfaces.nl.reading import NLContent

Z, W = np.array([1.5, 0.0, 2.0]), np.array([0.0, 0.25, 0.0])
M = np.array([[4.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 4.0]])


SOLVABLE = content_of(M, W - M @ Z, options=(5, 0, 1, 0, 7, 2021), names=["a", "bb", "ccc"])
STIFF = content_of(2.0 * np.eye(50) - np.eye(50, k=1) - np.eye(50, k=-1), np.full(50, -1.0))
NO_PAIRS = dict(partners=np.array([-1]), partner_bounds=np.array([0]))


@pytest.mark.parametrize("ending", ["", ".nl"])
@pytest.mark.parametrize("binary", [False, True])
def test_a_stub_is_answered_by_a_sol_file(tmp_path, capsys, ending, binary):
    """Stub -AMPL writes values, multipliers, the head's options and code 0, prints nothing and exits with 0."""
    write_form(SOLVABLE, tmp_path / "m.nl", binary=binary)
    assert ampl.main([str(tmp_path / f"m{ending}"), "-AMPL"]) == 0
    found = read_sol(tmp_path / "m.sol")
    assert (found.code, found.options) == (0, (5, 0, 1, 0, 7, 2021))
    assert found.values == pytest.approx(Z, abs=1e-7)
    assert found.duals == pytest.approx(W, abs=1e-7)
    assert found.message.startswith("lcp_plugin") and "solved; residual" in found.message  # noqa: PT018
    assert capsys.readouterr() == ("", "")


INFEASIBLE = content_of([[-1.0]], [-1.0])
UNBOUNDED = content_of([[1.0]], [0.0], objective=[-1.0], row_lower=np.array([0.0]), **NO_PAIRS)
EMPTY = content_of(
    [[1.0]],
    [0.0],
    objective=[-1.0],
    row_lower=np.array([-4.0]),
    row_upper=np.array([-3.0]),
    **NO_PAIRS,
)
WHOLE = content_of(
    [[1.0]],
    [0.0],
    objective=[1.0],
    row_lower=np.array([0.5]),
    is_integer=np.array([True]),
    **NO_PAIRS,
)


@pytest.mark.parametrize(
    ("content", "words", "code", "message"),
    [
        (SOLVABLE, ["tolerance=1e-14"], 0, "solved"), (SOLVABLE, ["tolerance=0"], (0, 100), "residual"),
        (INFEASIBLE, [], 200, "infeasible"), (EMPTY, [], 200, "infeasible"), (UNBOUNDED, [], 300, "unbounded"),
        (STIFF, ["algorithm=psor", "max_iterations=2"], 400, "max_iterations"),
        (STIFF, ["algorithm=psor", "max_seconds=1e-9"], 401, "max_seconds"),
        (WHOLE, [], 500, "variable 0 is an integer"), (SOLVABLE, ["algorithm=psr"], 500, "did you mean 'psor'"),
    ],
    ids=["solved", "at 0", "no signs", "empty", "unbounded", "iterations", "seconds", "integer", "algorithm"],
)  # fmt: skip
def test_codes_say_how_it_ended(tmp_path, content, words, code, message):
    """AMPL's ranges: 0 solved, 100 less precisely, 200 infeasible, 300 unbounded, 400 limit, 500 failure."""
    write_nl(content, tmp_path / "m.nl")
    assert ampl.main([str(tmp_path / "m"), "-AMPL", *words]) == 0
    found = read_sol(tmp_path / "m.sol")
    assert found.code in np.atleast_1d(code)
    assert message in found.message.lower()


def best(objective: Any, least: float = -np.inf, **changes: Any) -> NLContent:
    """The least objective of 0 ≤ x ⟂ x + y − 1 ≥ 0, y ≥ 0, x ≥ least."""
    one = content_of([[1.0, 1.0], [1.0, 0.0]], [-1.0, 0.0], objective=objective, partners=np.array([0, -1]),
                     row_lower=np.array([-np.inf, least]))  # fmt: skip
    return replace(one, **changes)


CONCAVE = [[("o", 16, 1), ("o", 5, 2), ("v", 1, 0), ("n", 2.0, 0)]]  # -(y^2)
EXPONENTIAL, UNKNOWN = [[("o", 44, 1), ("v", 1, 0)]], [[("o", 49, 1), ("v", 1, 0)]]
KNAPSACK = np.random.default_rng(0).integers(1, 1000, (4, 40)).astype(float)


def hard() -> NLContent:
    """A knapsack: 0 ≤ x ⟂ y ≥ 0 and x + y = 1, four rows that weigh x, the most of Σ weight · x; thousands of nodes."""
    rows = np.vstack(
        [np.eye(40, 80, 40), np.hstack([np.eye(40)] * 2), np.hstack([KNAPSACK, np.zeros((4, 40))])]
    )
    return content_of(
        rows,
        np.zeros(84),
        lower=np.zeros(80),
        upper=np.full(80, np.inf),
        partners=np.append(np.arange(40), np.full(44, -1)),
        partner_bounds=(np.arange(84) < 40).astype(int),
        row_lower=np.concatenate([np.full(40, -np.inf), np.ones(40), np.full(4, -np.inf)]),
        row_upper=np.concatenate([np.full(40, np.inf), np.ones(40), KNAPSACK.sum(axis=1) // 2]),
        start=np.zeros(80),
        has_start=np.zeros(80, dtype=bool),
        is_integer=np.zeros(80, dtype=bool),
        defined_linear=sp.csr_array((0, 80)),
        objective=np.append(-KNAPSACK.sum(axis=0), np.zeros(40)),
    )


@pytest.mark.parametrize(
    ("content", "words", "code", "message"),
    [
        (best([0.0, 1.0]), [], 0, "optimal; objective 0, none "),
        (best([0.0, 1.0], is_maximized=np.ones(1, dtype=bool)), [], 300, "unbounded; "),
        (best([0.0, -1.0]), [], 300, "the objective is unbounded"),
        (best([0.0, 1.0], upper=np.full(2, 0.25)), [], 200, "the linear constraints are inconsistent"),
        (best([0.0, 1.0], 2.0), [], 200, "every complementarity piece is infeasible"),
        (best([0.0, 1.0], objective_trees=CONCAVE, upper=np.ones(2)), [], 0, "bound by SCIP, in floating point"),
        (best([0.0, 1.0], objective_trees=EXPONENTIAL), [], 0, "optimal; objective 1, none "),
        (best([0.0, 1.0], names=["a", "b"], is_integer=np.array([False, True])), [], 0, "optimal; objective 0, none "),
        (best([0.0, 1.0], objective_trees=UNKNOWN), [], 500, "SCIP knows no atan"),
        (hard(), ["max_iterations=2"], 400, "node limit reached"),
        (hard(), ["max_seconds=1e-9"], 401, "time limit reached; "),
        (best([0.0, 1.0]), ["threads=1", "algorithm=auto", "tolerance=1e-9"], 0, "optimal"),
        (best([0.0, 1.0], objective_trees=CONCAVE, upper=np.ones(2)), ["prove=1"], 500, "not convex"),
        (best([0.0, 1.0]), ["algorithm=psor"], 500, "takes no algorithm for an EquilibriumProgram"),
        (best([0.0, 1.0]), ["absolute_tolerance=1"], 500, "takes no absolute_tolerance for an EquilibriumProgram"),
    ],
    ids=["optimal", "maximum", "unbounded", "infeasible", "no solution", "not convex", "nonlinear", "integer",
         "unknown", "nodes", "seconds", "harmless options", "proof", "algorithm", "absolute tolerance"],
)  # fmt: skip
def test_an_objective_beside_complementarities_is_answered(tmp_path, content, words, code, message):
    """Code and message of each end, values where there are any, and what does not fit is told in the .sol."""
    write_nl(content, tmp_path / "m.nl")
    assert ampl.main([str(tmp_path / "m"), "-AMPL", *words]) == 0
    found = read_sol(tmp_path / "m.sol")
    assert (found.code, message in found.message) == (code, True), found.message
    assert "inf" not in found.message.replace("infeasible", "")
    if code == 0:
        # y - y² is 0 at both
        ties = [[1.0, 0.0], [0.0, 1.0]] if content.objective_trees is CONCAVE else [[1.0, 0.0]]
        assert any(found.values == pytest.approx(best_one, abs=1e-6) for best_one in ties)
    elif code not in (400, 401):
        assert found.values is None


@pytest.mark.full
def test_ctrl_c_keeps_the_best_solution_of_a_search(tmp_path):
    """SIGINT to the executable while it searches: code 402, the best solution in the .sol, exit code 0."""
    write_nl(hard(), tmp_path / "m.nl")
    code = "from lcp_plugin.commands.ampl import run; run()"
    call = [sys.executable, "-u", "-c", code, str(tmp_path / "m"), "-AMPL", "outlev=1"]
    with subprocess.Popen(call, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.split()[0].isdigit() and int(line.split()[0]) > 3 and " inf " not in line:
                break
        process.send_signal(signal.SIGINT)
        process.stdout.read()
    found = read_sol(tmp_path / "m.sol")
    assert (process.returncode, found.code) == (0, 402)
    assert "interrupted; objective" in found.message
    assert found.values is not None
    assert np.minimum(found.values[:40], found.values[40:]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--"], "no stub"),
        (["nothing"], r"no such file: nothing\.nl"),
        (["m", "-AMPL", "tolrance=1e-9"], r"unknown keyword 'tolrance'; did you mean 'tolerance'\?"),
        (["m", "-AMPL", "tolerance=tiny"], "tolerance must be .*got 'tiny'"),
        (["-o"], "no stub is given"),
        (["m", "-AMPL", "max_iterations=1.5"], "max_iterations must be .*got 1.5"),
         (["m", "-AMPL", "timin=1"], "unknown keyword 'timin'"),
        (["m", "-AMPL", "timing=abc"], "timing must be an integer.*got 'abc'"),
        (["m", "-AMPL", "wantsol=-1"], "wantsol must be an integer.*got -1"),
         (["m", "-AMPL", "max_seconds"], "got 'max_seconds'"),
        (["m", "-AMPL", "=3"], "name=value, .* got '=3'"),
         (["damaged", "-AMPL"], r"line 3 \("),
    ],
)  # fmt: skip
def test_a_wrong_call_is_one_line_and_a_code(tmp_path, capsys, monkeypatch, words, message):
    """What the caller got wrong is one line on stderr, exit code 2, and no .sol."""
    monkeypatch.chdir(tmp_path)
    write_nl(SOLVABLE, "m.nl")
    Path("damaged.nl").write_bytes(b"g3 1 1 0\n 1 1\n")
    assert ampl.main(words) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(err)
    assert not list(tmp_path.rglob("*.sol"))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("tolerance=1e-3 outlev=1 algorithm='psor'", {"tolerance": 1e-3, "outlev": 1, "algorithm": "psor"}),
        ("max_seconds 5 version outlev 0", {"max_seconds": 5, "version": 1, "outlev": 0}),
        ("max_seconds = 5 version outlev= 0", {"max_seconds": 5, "version": 1, "outlev": 0}),
    ],
)  # fmt: skip
def test_assignments_may_have_quotes_and_a_blank_for_the_equals_sign(text, found):
    """key=value or key value, several in one word, as modeling systems also send it; `version` has no value."""
    assert ampl.assigned(text) == found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["wantsol=1"], r"\Alcp_plugin.*solved"),
        (["wantsol=9"], r"\A\Z"),
        (["-AMPL", "wantsol=1"], r"\A\Z"),
        (["timing=1"], r"solved.*\n[\d.e-]+ s\Z"),
        (["version"], r"\Alcp_plugin \d.*\nlcp_plugin.*solved"),
    ],
)
def test_the_keywords_that_every_solver_has_are_obeyed(tmp_path, capsys, words, message):
    """wantsol, timing and version: the .sol is written, and only the printed text differs."""
    write_nl(SOLVABLE, tmp_path / "m.nl")
    assert ampl.main([str(tmp_path / "m"), *words]) == 0
    out, err = capsys.readouterr()
    assert (read_sol(tmp_path / "m.sol").code, err) == (0, "")
    assert re.search(message, out.strip(), re.DOTALL)


def test_the_command_line_goes_before_the_environment(tmp_path, capsys):
    """Without -AMPL the message is printed as well; the .sol is written in any case."""
    write_nl(SOLVABLE, tmp_path / "m.nl")
    words = [str(tmp_path / "m"), "tolerance=1e-3", "algorithm=psor"]
    assert ampl.main(words, "tolerance=1e-9 threads=1") == 0
    assert "solved; residual" in capsys.readouterr().out
    assert read_sol(tmp_path / "m.sol").code == 0


def test_the_executable_prints_version_options_and_help(capsys):
    """-v, -= and -? end with 0; every keyword is listed."""
    for word, message in (
        ("-v", "lcp_plugin "),
        ("--version", "lcp_plugin "),
        ("-?", "usage: "),
        ("-=", "tolerance "),
    ):
        assert ampl.main([word]) == 0
        assert message in capsys.readouterr().out
    assert ampl.main(["-="]) == 0
    *keywords, mark = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in keywords] == sorted(ampl.KEYWORDS)
    assert mark.startswith("* not for an objective")


def test_an_interrupt_is_answered(tmp_path, monkeypatch):
    """Ctrl-C before there is an answer gives a .sol of code 402; while a file is read, exit code 130."""
    from lcp_plugin.interfaces.nl import model, reading

    def interrupted(_):
        os.kill(os.getpid(), signal.SIGINT)

    write_nl(SOLVABLE, tmp_path / "m.nl")
    monkeypatch.setattr(model, "model_of", interrupted)
    assert ampl.main([str(tmp_path / "m"), "-AMPL"]) == 0
    assert read_sol(tmp_path / "m.sol").code == 402
    monkeypatch.setattr(reading, "read_content", interrupted)
    assert ampl.main([str(tmp_path / "m"), "-AMPL"]) == 130


def test_the_other_command_answers_too_where_it_is_called_as_a_solver(tmp_path, monkeypatch):
    """`lcp-plugin stub -AMPL`, as Pyomo's SolverFactory("lcp-plugin") calls it without lcp_plugin.pyomo."""
    write_nl(SOLVABLE, tmp_path / "m.nl")
    monkeypatch.setattr(
        sys, "argv", ["lcp-plugin", str(tmp_path / "m.nl"), "-AMPL", "tolerance=1e-10"]
    )
    with pytest.raises(SystemExit) as ended:
        cli.run()
    assert (ended.value.code, read_sol(tmp_path / "m.sol").code) == (0, 0)


@pytest.mark.full
def test_pyomo_solves_through_the_executable(tmp_path, monkeypatch):
    """SolverFactory("asl:lcp-plugin-ampl") finds it on the path, hands options over and loads values."""
    pe = pytest.importorskip("pyomo.environ")
    from pyomo.mpec import Complementarity, complements

    command = tmp_path / "lcp-plugin-ampl"
    command.write_text(f"#!{sys.executable} -P\nfrom lcp_plugin.commands.ampl import run\nrun()\n")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert (
        subprocess.run([str(command), "-v"], capture_output=True, text=True, check=True).stdout[:10]
        == "lcp_plugin"
    )
    model = pe.ConcreteModel()
    model.x = pe.Var(range(3), bounds=(0, None))
    q = W - M @ Z
    model.c = Complementarity(range(3), rule=lambda model, i: complements(
        model.x[i] >= 0, sum(float(M[i, j]) * model.x[j] for j in range(3)) + float(q[i]) >= 0))  # fmt: skip
    found = pe.SolverFactory("asl:lcp-plugin-ampl").solve(model, options={"tolerance": 1e-10})
    assert str(found.solver.termination_condition) == "optimal"
    assert [model.x[i].value for i in range(3)] == pytest.approx(Z, abs=1e-8)
