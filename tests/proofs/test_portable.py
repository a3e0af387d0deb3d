"""Proofs as files: examples/check_proof.py accepts each kind and no file with a changed digit; exact solutions."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_plugin import (
    LCP,
    InvalidOption,
    QuadraticProgram,
    Status,
    UnreadableFile,
    UnsuitableProblem,
    check_proof,
    exact,
    solve,
)
from lcp_plugin.proofs import checker

SCRIPT = Path(__file__).parents[2] / "examples" / "check_proof.py"
CYCLE = np.array([0.1, 0.2, -0.3])  # whose sum is 3e-17: P d = 0 only to rounding
PROBLEMS: dict[str, Callable[[], Any]] = {
    "Farkas": lambda: LCP([[0.0, 1.0], [-1.0, 0.0]], [-1.0, -1.0]),
    "Farkas, upper bounds": lambda: LCP(
        [[-1.0, 2.0], [0.5, 0.1]], [-3.0, 1.0], upper=[np.inf, 1.0]
    ),
    "Farkas, free": lambda: LCP([[0.0, 1.0], [1.0, 0.0]], [-1.0, 1.0], lower=[-np.inf, 2.0]),
    "exhaustion": lambda: LCP(
        [[0, 1, 0.3], [1, 0, 0.2], [-0.4, -0.1, -1]], [-1, 1, 0.2], upper=[np.inf, np.inf, np.inf]
    ),
    "exhaustion, a fixed unknown": lambda: LCP(
        [[0, 1, 0.3, 0.1], [1, 0, 0.2, 0.0], [-0.4, -0.1, -1, 0.1], [1, 0, 1, 1]],
        [-1, 1, 0.2, 0.0],
        lower=[0, 0, 0, 0.25],
        upper=[np.inf, np.inf, np.inf, 0.25],
    ),
    "program": lambda: QuadraticProgram(None, [1, 1], [[1, 1], [0, -1]], [10, -7], lower=[4, 0]),
    "program with equations": lambda: QuadraticProgram(
        None, [1, 1], A=[[1, 1], [1, 1]], b=[1.0, 1.3], G=[[1, 0]], h=[np.inf]
    ),
    "ray": lambda: QuadraticProgram([[1, 0], [0, 0.0]], [1, -1], lower=[0, 0], upper=[3, np.inf]),
    "ray of a linear program": lambda: QuadraticProgram(
        None, [-1, -1], G=[[1, -1]], h=[1.5], A=[[1, -1]], b=[0.25]
    ),
    "ray to rounding": lambda: QuadraticProgram(np.outer(CYCLE, CYCLE), [-1.0, -1.0, -1.0]),
}
WITHOUT_SOLUTION = pytest.mark.parametrize("name", PROBLEMS)


def saved(name: str, folder: Path) -> tuple[Any, Path]:
    """Return the problem of that name, and the file with the proof that it has no solution."""
    problem, path = PROBLEMS[name](), folder / "p.json"
    solve(problem).proof.save(path)
    return problem, path


def said(path: Path) -> str:
    """Return the words of the script, which reads the file without this package."""
    with path.open() as file:
        run = subprocess.run(
            [sys.executable, "-I", SCRIPT], stdin=file, capture_output=True, text=True, check=True
        )
    return run.stdout.strip()


def with_other_digits(text: str, digits: str = "0123456789") -> Iterator[str]:
    """Yield the text with each digit changed, one at a time."""
    for k, character in enumerate(text):
        if character in digits and text[k + 1 : k + 2] != "x":
            yield text[:k] + digits[(digits.index(character) + 1) % len(digits)] + text[k + 1 :]


@WITHOUT_SOLUTION
def test_a_proof_file_is_accepted_for_its_problem_only(name, tmp_path):
    """The file proves its statement, with and without this package, and is refused for other data."""
    problem, path = saved(name, tmp_path)
    assert said(path).startswith("yes")
    assert ("radius" in said(path)) == (name == "ray to rounding")
    assert check_proof(path)
    assert check_proof(path, problem)
    other = {"q": problem.q * 2} if isinstance(problem, LCP) else {"lower": problem.lower - 1}
    vectors = {key: getattr(problem, key) for key in ("lower", "upper")} | other
    if isinstance(problem, LCP):
        assert not check_proof(path, LCP(problem.M, **vectors))


@WITHOUT_SOLUTION
def test_a_proof_file_with_a_changed_digit_is_refused(name, tmp_path):
    """Every single digit counts, those of the data and of the checksum included."""
    text = saved(name, tmp_path)[1].read_text()
    for k, forged in enumerate(with_other_digits(text)):
        assert not checker.is_proved(forged), (k, forged)


@WITHOUT_SOLUTION
def test_a_forged_proof_with_its_own_checksum_is_refused(name, tmp_path):
    """Multipliers with the other sign, a missing multiplier and a missing branch prove nothing."""
    path = saved(name, tmp_path)[1]
    content = json.loads(path.read_text())

    def is_accepted(**changed: Any) -> bool:
        left_out = {"checksum", *(key for key, value in changed.items() if value is None)}
        head = json.dumps({k: v for k, v in {**content, **changed}.items() if k not in left_out})
        return checker.is_proved(f'{head[:-1]}, "checksum": {checker.checksum(head[:-1])}}}')

    def turned(value: dict[str, str]) -> dict[str, str]:
        number = value["0x"]
        return {"0x": number[1:] if number[0] == "-" else f"-{number}"}

    assert is_accepted()
    for key in {"y", "direction"} & content.keys():
        entries, is_list = content[key], key == "y"
        other = [[i, turned(v)] for i, v in entries] if is_list else [*map(turned, entries)]
        assert not is_accepted(**{key: other})
        assert not is_accepted(**{key: [] if is_list else [{"0x": "0"} for _ in entries]})
    if "tree" in content:
        branches = content["tree"]["branches"]
        for left_out in branches:
            kept = {piece: node for piece, node in branches.items() if piece != left_out}
            assert not is_accepted(tree={**content["tree"], "branches": kept})
    if "M" in content:  # a ray along any direction, of an objective of the forger's
        with pytest.raises(KeyError):
            is_accepted(y=None, tree=None, P=[], c=[], point=[], direction=[])
    if "M" not in content:  # a tree over rows without pairs
        assert not is_accepted(tree={"row": 0, "branches": {}}, y=None, point=None)


def test_the_script_is_the_checker_of_the_package():
    """The script has at most 80 lines, imports json and fractions only, and is the file of the package."""
    text = SCRIPT.read_text(encoding="utf-8")
    assert text == Path(checker.__file__).read_text(encoding="utf-8")
    imports = [line for line in text.splitlines() if line.startswith(("import ", "from "))]
    assert imports == ["import json", "from fractions import Fraction"]
    assert len(text.splitlines()) <= 80


def test_a_file_that_is_no_proof_is_refused_with_a_reason(tmp_path):
    """A missing file and a file of other content raise UnreadableFile; the script says no, without a traceback."""
    with pytest.raises(UnreadableFile, match="no such file"):
        check_proof(tmp_path / "none.json")
    for k, text in enumerate(["", "{}", "[]", "[1, 2]", "z = 1", '{"M": 1, "checksum": two}']):
        path = tmp_path / f"{k}.json"
        path.write_text(text)
        with pytest.raises(UnreadableFile, match="proof file of lcp_plugin"):
            check_proof(path)
        assert said(path).startswith("no")


@given(st.data())
def test_an_exact_solution_is_the_known_one(data):
    """The known z = a / 7 is recovered in fractions, although M, q and the result are doubles."""
    n = data.draw(st.integers(1, 6))
    whole = st.integers(-5, 5)
    rows = np.array(
        data.draw(st.lists(st.lists(whole, min_size=n, max_size=n), min_size=n, max_size=n))
    )
    M = rows @ rows.T + 7 * np.eye(n)
    z = [Fraction(abs(v), 7) for v in data.draw(st.lists(whole, min_size=n, max_size=n))]
    w = [Fraction(0) if v else Fraction(data.draw(st.integers(0, 5)), 7) for v in z]
    q = [
        7 * (b - sum(Fraction(a) * v for a, v in zip(row, z, strict=True)))
        for row, b in zip(M, w, strict=True)
    ]
    solution = exact(solve(LCP(7 * M, [float(v) for v in q])))
    assert solution.z == tuple(z)
    assert solution.verify()


def test_an_exact_solution_is_saved_and_checked(tmp_path):
    """The file of z is accepted; another z, and z for other data, are not."""
    problem = LCP([[0.1, 0.3], [0.2, 0.7]], [-0.1, -0.3], upper=[np.inf, 0.25])
    solution = exact(solve(problem))
    path = tmp_path / "z.json"
    solution.save(path)
    assert said(path) == "yes"
    assert check_proof(path, problem)
    assert not check_proof(path, LCP(problem.M, [-0.1, -0.4], upper=problem.upper))
    text = path.read_text().rpartition(', "checksum"')[0]
    for forged in with_other_digits(text.partition('"z"')[2], "0123456789abcdef"):
        head = text.partition('"z"')[0] + '"z"' + forged
        try:
            is_proved = checker.is_proved(f'{head}, "checksum": {checker.checksum(head)}}}')
        except (json.JSONDecodeError, ZeroDivisionError):
            continue
        assert not is_proved


def test_the_vertex_of_a_linear_program_is_exact():
    """The linear program max x + y, 3 x + y ≤ 1, x + 3 y ≤ 1 has its maximizer at (1/4, 1/4), multipliers 1/4."""
    result = solve(QuadraticProgram(None, [-1, -1], [[3, 1], [1, 3]], [1, 1], lower=0))
    assert exact(result).z == (Fraction(1, 4),) * 4


def test_an_exact_solution_of_doubles_has_hundreds_of_digits():
    """The solution of twenty equations and bounds in doubles is reconstructed from residues, and verified."""
    rng = np.random.default_rng(0)
    B, q = rng.normal(size=(20, 20)), rng.normal(size=20)
    solution = exact(solve(LCP(B @ B.T + np.eye(20), q)))
    assert solution.verify()
    assert max(value.denominator for value in solution.z) > 2**500


@pytest.mark.parametrize(
    ("result", "reason"),
    [
        (lambda: solve(LCP([[1.0, 1.0], [1.0, 1.0]], [-0.1, -0.3]), max_iterations=0), "status"),
        (lambda: solve(LCP(2 * np.eye(61), -np.ones(61))), "more than 60 unknowns"),
        (  # both equations hold to rounding only
            lambda: solve(LCP([[1, 1], [1, 1]], [-0.1, -0.1 - 2**-55], lower=-np.inf)),
            "singular",
        ),
        (lambda: solve(LCP([[33554393.0]], [-1.0])), "singular .perhaps only modulo 33554393"),
    ],
)
def test_a_solution_that_is_not_exact_has_a_reason(result, reason, tmp_path):
    """Z is None, the reason says why, and nothing is saved."""
    solution = exact(result())
    assert solution.z is None
    assert not solution.verify()
    with pytest.raises(UnsuitableProblem, match=reason):
        solution.save(tmp_path / "z.json")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("argument", [None, LCP([[1.0]], [1.0]), [1.0], "z"])
def test_exact_refuses_what_is_no_result(argument):
    with pytest.raises(UnsuitableProblem, match=r"write exact\(solve\(problem\)\)"):
        exact(argument)


def test_the_statuses_of_the_table():
    """The table has a problem of each status that is proved."""
    assert {solve(make()).status for make in PROBLEMS.values()} == {
        Status.INFEASIBLE,
        Status.NO_SOLUTION,
        Status.UNBOUNDED,
    }


FORGED: dict[str, tuple[LCP, str]] = {
    "a split at a row that does not exist": (
        LCP([[1.0]], [-1.0]),
        '"tree": {"row": 999, "branches": {}}',
    ),
    "a split at a bound": (
        LCP([[1.0]], [-0.5], upper=1.0),
        '"tree": {"row": 1, "branches": {"zero": {"y": [[0, 1]]}, "lower": {"y": [[0, 1]]}}}',
    ),
    "a negative radius": (LCP([[1.0]], [-1.0]), '"y": [[0, 1]], "radius": {"0x": "-5"}'),
    "an underflow": (LCP([[1e-100]], [-1.0]), '"y": [[0, 1e-300]], "radius": null'),
    "not a number": (LCP([[1.0]], [-1.0]), '"y": [[0, NaN]], "radius": null'),
    "other data next to the true ones": (
        LCP([[1.0]], [-1.0]),
        '"point": [0], "rows": [], "signs": [], "y": [], "radius": null',
    ),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_proof_about_the_true_data_is_refused(name, tmp_path):
    """Each problem has a solution, so that no file with its data and a right checksum is a proof."""
    problem, proof = FORGED[name]
    assert solve(problem).is_solved
    ours = exact(solve(problem))
    ours.save(tmp_path / "true.json")
    data = (tmp_path / "true.json").read_text().partition(', "z"')[0]
    head = f"{data}, {proof}"
    forged = tmp_path / "p.json"
    forged.write_text(f'{head}, "checksum": {checker.checksum(head)}}}\n')
    with suppress(UnreadableFile):  # a number that is none
        assert not check_proof(forged, problem)
    assert said(forged).startswith("no")


def test_an_exact_solution_of_a_program_is_accepted_for_the_program(tmp_path):
    """The file states the optimality conditions of the program; another class is refused with its name."""
    program = QuadraticProgram(2 * np.eye(2), [-2.0, -4.0], G=[[1.0, 1.0]], h=[2.0])
    path = tmp_path / "p.json"
    exact(solve(program)).save(path)
    assert check_proof(path, program)
    assert not check_proof(path, QuadraticProgram(2 * np.eye(2), [-2.0, -4.0], [[1.0, 1.0]], [3.0]))
    with pytest.raises(InvalidOption, match="got str"):
        check_proof(path, "text")
