"""The worst rows of a point: residuals by hand in fractions, for every way to state a problem."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import (
    LCP,
    ConeProblem,
    FrictionalContact,
    InvalidOption,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    certify,
    complements,
    solve,
)
from lcp_plugin.proofs.mistakes import likely_mistake


def drawn(kind: str, seed: int) -> tuple[Any, Any, dict[str, Fraction]]:
    """Return a problem or model, a point of integers, and the violation of each row by hand, in fractions."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    M, q = rng.integers(-4, 5, (n, n)) * 1.0, rng.integers(-9, 10, n) * 1.0
    M[np.arange(n), np.arange(n)] = 9
    lower, upper = np.zeros(n), np.full(n, np.inf)
    z, exact = rng.integers(0, 4, n) * 1.0, [Fraction(0)] * n
    if kind == "program":
        h, x = rng.integers(-9, 10, n) * 1.0, z - 1.0
        rows = {f"row {i} of G": M[i] @ np.maximum(x, 0.0) - h[i] for i in range(n)}
        wrong = rows | {f"lower[{i}]": -x[i] for i in range(n)}
        return QuadraticProgram(np.eye(n), q, M, h, lower=0), x, wrong
    if kind in ("cone", "contact"):  # an axis of the cone, and (3, 4, 0) or a slack on the axis
        w = rng.integers(-3, 4) * np.array([1.0, 0.0, 0.0])
        z = np.array([float(rng.integers(2)), 0.0, 0.0])
        if kind == "contact":
            wrong = {"row 0": abs(w[0]) if z[0] else max(-w[0], 0.0)}
            return FrictionalContact(9 * np.eye(3), [w - 9 * z], [0.5]), z, wrong
        w = np.array([3.0, 4.0, 0.0]) if z[0] and seed % 2 else w
        size = np.hypot(*w[:2]) if z[0] else max(-w[0], 0.0)
        cone = ConeProblem(9 * np.eye(3), w - 9 * z, [("second_order", 3)])
        return cone, z, dict.fromkeys(("row 0", "row 1", "row 2"), size)
    if kind == "box":
        lower, upper = -rng.integers(0, 2, n) * 1.0, rng.integers(1, 4, n) * 1.0
        z = np.clip(z, lower, upper)
    curve = (kind == "nonlinear") * rng.integers(0, 3, n) * 1.0
    for i in range(n):
        terms = [Fraction(a) * Fraction(b) for a, b in zip(M[i].tolist(), z.tolist(), strict=True)]
        exact[i] = sum(terms, Fraction(q[i])) + Fraction(curve[i]) * Fraction(z[i]) ** 2
    names, zero = (f"row {i}" for i in range(n)), Fraction(0)
    ends = zip(names, exact, z > lower, z < upper, strict=True)
    wrong = {name: max(zero, w if up else zero, -w if down else zero) for name, w, up, down in ends}
    if kind == "nonlinear":
        return NonlinearProblem(lambda x: M @ x + q + curve * x**2, lower=np.zeros(n)), z, wrong
    if kind == "cvxpy":
        price = cp.Variable(n, nonneg=True, value=z)
        return cp.Problem(cp.Minimize(0), [complements(price, M @ price + q)]), None, wrong
    return LCP(M, q, lower=lower, upper=upper), z, wrong


KINDS = ["lcp", "box", "nonlinear", "cvxpy", "cone", "contact", "program"]


@pytest.mark.few(7)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(72))
def test_rows_are_those_that_fail_in_fractions(seed: int, kind: str) -> None:
    """The table has the rows that fail in exact sums, with their exact violation, the worst first."""
    problem, point, wrong = drawn(kind, seed)
    found = certify(problem, point)
    rows = found.worst(99)
    sizes = sorted(float(size) for size in wrong.values() if size > 0)
    assert sorted(row.violation for row in rows) == pytest.approx(sizes)
    if kind != "cvxpy":
        assert all(row.violation == pytest.approx(float(wrong[row.name])) for row in rows)
    assert [row.residual for row in rows] == sorted((row.residual for row in rows), reverse=True)
    assert kind == "program" or found.verdict == ("proved" if not rows else "disproved")


def test_every_class_names_its_worst_row() -> None:
    """Nonlinear, cone and convex problems, and models at the values of their variables."""
    power = NonlinearProblem(lambda x: x**3 - np.array([8.0, -1.0]), lower=[0, 0], names=["a", "b"])
    assert str(certify(power, [2, 1]).worst()).startswith("w[b] = 2 while z[b] = 1 > 0")
    assert certify(power, solve(power)).verdict == "proved"
    with pytest.raises(InvalidOption, match="count must be"):
        certify(power, [2, 1]).worst(0)
    with pytest.raises(InvalidProblem, match="b is nan"):
        certify(NonlinearProblem(lambda x: np.sqrt(x - 1), names=["a", "b"], lower=[0, 0]), [2, 0])
    cone = ConeProblem(np.eye(3), [0, -2, 0], [("second_order", 3)])
    assert certify(cone, [1, 1, 0]).verdict == "proved"
    assert "in a cone" in str(certify(cone, [1, 0.5, 0]).worst(1))
    program = QuadraticProgram(np.eye(2), [-2, -4], [[1, 1]], [2], names=[["cap"], ["x", "y"]])
    assert str(certify(program, [0.5, 1.6]).worst()) == "cap is violated: 2.1 > 2 (terms 2)"
    price = cp.Variable(2, name="price", nonneg=True, value=[1.0, 1.0])
    excess = np.array([[2.0, 1.0], [1.0, 2.0]]) @ price - np.array([3.0, 5.0])
    model = cp.Problem(cp.Minimize(0), [complements(price, excess)])
    assert "= -2 < 0 while price[1] = 1" in str(certify(model).worst(1))
    with pytest.raises(InvalidOption, match=r"certify\(problem, x\)"):
        certify(LCP([[1.0]], [1.0]))


def test_a_pyomo_model_is_measured_at_its_values() -> None:
    """The pair and its variable have Pyomo's names."""
    pyo = pytest.importorskip("pyomo.environ")
    mpec = pytest.importorskip("pyomo.mpec")
    m = pyo.ConcreteModel()
    m.x = pyo.Var(["coal", "steel"], within=pyo.NonNegativeReals, initialize=1.0)
    goal = {"coal": np.e, "steel": 2.0}
    m.market = mpec.Complementarity(
        ["coal", "steel"],
        rule=lambda m, i: mpec.complements(m.x[i] >= 0, pyo.exp(m.x[i]) >= goal[i]),
    )
    assert [row.name for row in certify(m).worst(5)] == ["market[steel]"]
    assert "market[steel] = 0.718282 while x[steel] = 1 > 0" in str(certify(m).worst(5))


def test_the_wrong_market_of_a_benchmark_stands_first() -> None:
    """Ten sectors that clear at prices and activities of 1, with one wrong entry in the table of flows."""
    rng = np.random.default_rng(0)
    flows = rng.uniform(1.0, 5.0, (10, 10))
    demand = rng.uniform(5.0, 9.0, 10)
    supply = flows.sum(axis=1) + demand
    wrong = flows.copy()
    wrong[6, 2] *= 1.5
    n = np.zeros((10, 10))
    M = np.block([[n, np.diag(supply) - wrong], [-(np.diag(supply) - flows).T, n]])
    q = np.concatenate([-demand, (np.diag(supply) - flows).T @ np.ones(10)])
    names = [*(f"market[{i}]" for i in range(10)), *(f"profit[{i}]" for i in range(10))]
    assert [row.name for row in certify(LCP(M, q, names=names), np.ones(20)).worst(5)] == [
        "market[6]"
    ]


def test_a_run_that_fails_ends_with_its_worst_rows() -> None:
    """A method that stalls, and a system without a root, name the rows."""
    names = ["a", "b", "c"]
    M = [[1, 4, 0], [0, 1, 4], [4, 0, 1]]
    said = solve(LCP(M, [-1, -1, -1], names=names), "psor").explain()
    assert "the worst rows:" in said
    assert said.splitlines()[-1].startswith("  w[c] = -1 < 0")
    said = solve(
        NonlinearProblem(lambda x: x**2 + 1, lower=-np.inf, names=["F"]), x0=[1.0]
    ).explain()
    assert said.splitlines()[-1].startswith("  F = 1, and must be 0")


@pytest.mark.parametrize(
    ("F", "line"),
    [
        (lambda x: [x[0] - 3, x[1] ** 2 - 4, x[1] ** 2 - 12], "and z[c] has no effect on it; see"),
        (
            lambda x: [x[0] + 1e13 * x[1], x[0] ** 2 + 1, x[2] - 1],
            "the coefficients of a differ by a factor of 1e+13",
        ),
        (
            lambda x: [x[0] / x[1] - 2, x[1] / x[0] - 2, x[2]],
            "the rows a, b are dependent at this point",
        ),
    ],
)
def test_the_mistake_of_a_model_that_fails_is_below_its_worst_rows(F: Any, line: str) -> None:
    """A missing term, two units in a row, and rows without a numeraire; a run that a limit ends blames nobody."""
    problem = NonlinearProblem(lambda x: np.array(F(x)), lower=-np.inf, names=["a", "b", "c"])
    result = solve(problem, x0=[1.0, 1.5, 1.0])
    assert not result.is_solved
    assert line in result.explain().splitlines()[-1]
    assert line not in solve(problem, x0=[1.0, 1.5, 1.0], max_iterations=1).explain()


def test_a_row_of_the_wrong_sign_is_named_where_no_solution_exists() -> None:
    """The capacity k − s₀ − s₁ of a mine, stated as s₀ + s₁ − k."""
    mines, towns = np.kron(np.eye(2), [1, 1]), np.kron([1, 1], np.eye(2))
    zero = np.zeros((2, 2))
    M = np.block(
        [[np.zeros((4, 4)), mines.T, -towns.T], [-mines, zero, zero], [towns, zero, np.eye(2) / 2]]
    )
    q = np.array([2.0, 4.0, 3.0, 1.0, 10.0, 12.0, -9.0, -11.0])
    M[4], q[4] = -M[4], -q[4]
    names = [f"row {k}" for k in range(8)]
    result = solve(LCP(M, q, names=names))
    assert result.status is Status.NO_SOLUTION
    assert "row 4] may be wrong" in result.explain().splitlines()[-1]


def test_a_negative_diagonal_entry_is_named_and_a_rounding_error_is_no_unit() -> None:
    """A market with the sign of its neighbors' rows reversed, and a row with a difference of decimals."""
    names = ["coal", "steel", "food"]
    reversed_row = LCP([[4, 1, 2], [-2, -7, 0], [1, 0, 8]], [-6, 1, 6], names=names)
    assert "the sign of w[steel] may be wrong: only its" in solve(reversed_row).explain()
    unit = "the coefficients of coal differ by a factor of 2e+16; see its units"
    for entry, line in ((1e-17, ""), (1e17, unit)):
        problem = LCP([[4, entry, 0], [1, 4, 0], [0, 1, 4]], [1, 1, 1], names=names)
        assert likely_mistake(problem, np.zeros(3), problem.q) == line


@pytest.mark.parametrize(
    ("row", "x", "lines"),
    [
        (
            [1, 1],
            [-5, 2],
            ["lower[0] is violated: -5 < 0", "row 0 of G is violated with x on its bounds: 2 > 1"],
        ),
        ([1, -1], [1, -5], ["lower[1] is violated: -5 < 0"]),
    ],
)
def test_rows_of_a_program_are_measured_with_x_on_its_bounds(
    row: Any, x: Any, lines: list[str]
) -> None:
    """The values in the text are those that the criterion compares."""
    program = QuadraticProgram(np.eye(2), [0, 0], [row], [1], lower=0)
    assert [one.text for one in certify(program, x).worst(5)] == lines
