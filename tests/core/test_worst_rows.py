"""The worst rows of a point: residuals by hand in fractions, for every way to state a problem."""

from __future__ import annotations

import pickle
from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from campaigns import certified_points

from lcp_plugin import (
    LCP,
    ConeProblem,
    FrictionalContact,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    certify,
    complements,
    friction_cone,
    solve,
)
from lcp_plugin.solving.explanation import likely_mistake


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
    names = (f"row {i}" for i in range(n))
    d = 9 + 2 * curve * z
    ends = zip(names, exact, (d * (z - upper)).tolist(), (d * (z - lower)).tolist(), strict=True)
    wrong = {name: abs(max(above, min(below, w))) for name, w, above, below in ends}
    if kind == "nonlinear":
        return NonlinearProblem(lambda x: M @ x + q + curve * x**2, lower=np.zeros(n)), z, wrong
    if kind == "cvxpy":
        price = cp.Variable(n, nonneg=True, value=z)
        return cp.Problem(cp.Minimize(0), [complements(price, M @ price + q)]), None, wrong
    return LCP(M, q, lower=lower, upper=upper), z, wrong


KINDS = ["lcp", "box", "nonlinear", "cvxpy", "cone", "contact", "program"]


@pytest.mark.quick(11)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(72))
def test_rows_are_those_that_fail_in_fractions(seed, kind):
    """The table has the rows that fail in exact sums, with their exact violation, the worst first."""
    problem, point, wrong = drawn(kind, seed)
    found = certify(problem, point)
    rows = [row for row in found.worst(99) if " to the gap" not in row.text]
    sizes = sorted(float(size) for size in wrong.values() if size > 0)
    assert sorted(row.violation for row in rows) == pytest.approx(sizes)
    if kind != "cvxpy":
        assert all(row.violation == pytest.approx(float(wrong[row.name])) for row in rows)
    assert [row.residual for row in rows] == sorted((row.residual for row in rows), reverse=True)
    assert kind == "program" or found.verdict == ("proved" if not rows else "disproved")


def test_every_class_names_its_worst_row():
    """Nonlinear, cone and convex problems, and models at the values of their variables."""
    power = NonlinearProblem(lambda x: x**3 - np.array([8.0, -1.0]), lower=[0, 0], names=["a", "b"])
    assert str(certify(power, [2, 1]).worst()).startswith("w[b] = 2 while z[b] = 1 > 0")
    assert certify(power, solve(power)).verdict == "proved"
    with pytest.raises(InvalidProblem, match="b is nan"):
        certify(NonlinearProblem(lambda x: np.sqrt(x - 1), names=["a", "b"], lower=[0, 0]), [2, 0])
    cone = ConeProblem(np.eye(3), [0, -2, 0], [("second_order", 3)])
    assert certify(cone, [1, 1, 0]).verdict == "proved"
    assert "in a cone" in str(certify(cone, [1, 0.5, 0]).worst(1))
    program = QuadraticProgram(np.eye(2), [-2, -4], [[1, 1]], [2], names=[["cap"], ["x", "y"]])
    assert str(certify(program, [0.5, 1.6]).worst(1)) == "cap is violated: 2.1 > 2 (terms 2)"
    price = cp.Variable(2, name="price", nonneg=True, value=[1.0, 1.0])
    excess = np.array([[2.0, 1.0], [1.0, 2.0]]) @ price - np.array([3.0, 5.0])
    model = cp.Problem(cp.Minimize(0), [complements(price, excess)])
    assert "= -2 < 0 while price[1] = 1" in str(certify(model).worst(1))
    y = cp.Variable(2, name="y", value=[1.0, 1.0])
    price.value = [0.0, 0.0]
    rows = [y == 2 * price + 1, complements(price >= 0, y - 3 >= 0)]
    assert str(certify(cp.Problem(cp.Minimize(0), rows)).worst(1)).startswith("y + ")


def test_a_run_that_fails_ends_with_its_worst_rows():
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


@pytest.mark.quick(1)
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
def test_the_mistake_of_a_model_that_fails_is_below_its_worst_rows(F, line):
    """A missing term, two units in a row, and rows without a numeraire; a run that a limit ends blames nobody."""
    problem = NonlinearProblem(lambda x: np.array(F(x)), lower=-np.inf, names=["a", "b", "c"])
    result = solve(problem, x0=[1.0, 1.5, 1.0])
    assert not result.is_solved
    assert line in result.explain().splitlines()[-1]
    assert line not in solve(problem, x0=[1.0, 1.5, 1.0], max_iterations=1).explain()


def test_a_row_of_the_wrong_sign_is_named_where_no_solution_exists():
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


def test_a_negative_diagonal_entry_is_named_and_a_rounding_error_is_no_unit():
    """A market with the sign of its neighbors' rows reversed, and a row with a difference of decimals."""
    names = ["coal", "steel", "food"]
    reversed_row = LCP([[4, 1, 2], [-2, -7, 0], [1, 0, 8]], [-6, 1, 6], names=names)
    assert "the sign of w[steel] may be wrong: only its" in solve(reversed_row).explain()
    unit = "the coefficients of coal differ by a factor of 2e+16; see its units"
    for entry, line in ((1e-17, ""), (1e17, unit)):
        problem = LCP([[4, entry, 0], [1, 4, 0], [0, 1, 4]], [1, 1, 1], names=names)
        assert likely_mistake(problem, np.zeros(3), problem.q) == line
    # with a positive diagonal
    alone = LCP([[1, 1, 1], [1, 1, 2], [1, -2, 1]], [1, 1, 1], names=names)
    assert likely_mistake(alone, np.zeros(3), alone.q) == ""


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
def test_rows_of_a_program_are_measured_with_x_on_its_bounds(row, x, lines):
    """The values in the text are those that the criterion compares."""
    program = QuadraticProgram(np.eye(2), [0, 0], [row], [1], lower=0)
    assert [one.text for one in certify(program, x).worst(len(lines))] == lines


@pytest.mark.parametrize(
    "make", [LCP, lambda M, q: NonlinearProblem(lambda x: M @ x + q, lower=[0, 0])]
)
def test_a_point_outside_its_bounds_is_disproved_and_the_bound_is_named(make):
    """−50 next to 10⁷ is named, and −1, within the tolerance, is not."""
    M, q = np.array([[1.0, 0.5], [0.5, 1.0]]), np.array([1e7, -1e7])
    found = certify(make(M, q), [-50, 1e7 + 25])
    assert found.verdict == "disproved"
    assert found.reason == "z[0] = -50 is beyond its bound 0" == found.worst()[0].text
    assert certify(make(M, q), [-1, 1e7 + 0.5]).verdict == "proved"
    assert certify(make(M, q), [0, 2e7]).reason == "relative residual 1, tolerance 1e-06"
    with pytest.raises(InvalidProblem, match="x must be finite"):
        certify(make(M, q), [0, np.nan])


def test_the_text_of_a_row_has_its_exact_sum():
    """a·2³⁴a − 2³⁴ − 2⁸ = 2⁻²⁰ for a = 1 + 2⁻²⁷, and double precision gives 0."""
    a = 1.0 + 2.0**-27
    problem = LCP([[a, -1], [0, 1]], [0, -1], lower=-np.inf)
    rows = certify(problem, [a * 2.0**34, 2.0**34 + 2.0**8], tolerance=1e-8).worst()
    assert [row.text for row in rows if row.name == "row 0"] == [
        f"row 0 = {2.0**-20:.6g}, and must be 0"
    ]


def test_a_row_that_fails_next_to_its_terms_is_the_reason():
    """z[1] = 0.5 is small next to 10⁹, and its row is 0.5 next to 1; a pickled certification has the same rows."""
    found = certify(LCP([[1, 0], [1e-9, 1]], [-1e9, -1]), [1e9, 0.5])
    text = "row 1 = 0.5 while z[1] = 0.5 > 0"
    assert (found.verdict, found.reason) == ("disproved", text)
    assert [row.text for row in pickle.loads(pickle.dumps(found)).worst()] == [text]


def in_cvxpy(kind: str) -> tuple[cp.Problem, cp.Variable, float, str]:
    """Return a model at a solution, a variable, a value that no solution has, and the row that fails."""
    x, y = cp.Variable(nonneg=True, name="x"), cp.Variable(name="y")
    if kind == "definition":
        model = [complements(x >= 0, y - 4 >= 0), y == 2 * x]
        x.value, y.value = 2.0, 4.0
        return cp.Problem(cp.Minimize(0), model), y, 100.0, "y = 100, and its equation gives 4"
    if kind == "smooth":
        model = [complements(x >= 0, y - 4 >= 0), y == cp.square(x)]
        x.value, y.value = 2.0, 4.0
        return cp.Problem(cp.Minimize(0), model), y, 100.0, "= 96, and must be 0"
    if kind == "bound":
        y = cp.Variable(name="y", nonneg=True)
        x.value, y.value = 0.0, 1.0
        model = [complements(x >= 0, x + 3 >= 0), y == 2 * x + 1 - cp.Constant(0)]
        return cp.Problem(cp.Minimize(0), model), x, -2.0, "x = -2 is beyond its bound 0"
    r, u = cp.Variable(3, name="r"), cp.Variable(3, name="u")
    r.value, u.value = [0.5, -0.25, 0.0], [0.0, 0.25, 0.0]
    model = [complements(friction_cone(r, 0.5), u), u == 2 * r + np.array([-1.0, 0.75, 0.0])]
    return cp.Problem(cp.Minimize(0), model), u, 1.0, "u[0] = 1, and its equation gives 0"


@pytest.mark.parametrize("kind", ["definition", "smooth", "bound", "friction"])
def test_certify_measures_the_values_of_a_cvxpy_model_in_all_its_conditions(kind):
    """Defined variables keep their values; a wrong value names its equation or bound."""
    model, variable, value, line = in_cvxpy(kind)
    assert certify(model).verdict == "proved"
    variable.save_value(np.full(variable.shape, value))
    found = certify(model)
    assert found.verdict == "disproved"
    assert line in str(found.worst())
    variable.save_value(np.full(variable.shape, np.nan))
    with pytest.raises(InvalidProblem, match="must be finite"):
        certify(model)


def test_a_slack_that_is_rounding_is_at_its_bound():
    """3 · (.2/3) − .3 + .1 is 2.8e-17 in double precision, and its row is 3.1."""
    a = cp.Variable(2, name="a", value=[0.2 / 3.0, 0.1])
    pair = complements(3 * a[0] - 0.3 + a[1] >= 0, a[1] + 3 >= 0)
    found = certify(cp.Problem(cp.Minimize(0), [pair, a[1] == 0.1]))
    assert float(3 * a.value[0] - 0.3 + a.value[1]) != 0.0
    assert found.verdict == "proved"


def in_pyomo(kind: str) -> tuple[Any, str, dict[str, Any]]:
    """Return a Pyomo model at values that solve it except for x or y, the row that fails, and options."""
    pyo, mpec = pytest.importorskip("pyomo.environ"), pytest.importorskip("pyomo.mpec")
    m, pair = pyo.ConcreteModel(), mpec.complements
    m.x, m.y = pyo.Var(initialize=2.0), pyo.Var(initialize=4.0)
    if kind == "bound":
        m.c = mpec.Complementarity(expr=pair(m.x >= 0, m.x + 1 >= 0))
        m.x.value = -5.0
        return m, "x = -5 is beyond its bound 0", {}
    if kind == "definition":
        m.e = pyo.Constraint(expr=m.y == 2 * m.x)
        m.c = mpec.Complementarity(expr=pair(m.x >= 0, m.y - 4 >= 0))
        m.y.value = 100.0
        return m, "y = 100, and its equation gives 4", {}
    if kind == "side condition":
        m.s = pyo.Constraint(expr=m.x <= 1)
        m.c = mpec.Complementarity(expr=pair(m.x >= 0, m.x - 2 >= 0))
        return m, "s = 2 is beyond its bound 1", {}
    if kind == "fixed by its bounds":
        m.y.setlb(4.0)
        m.y.setub(4.0)
        m.c = mpec.Complementarity(expr=pair(m.x >= 0, m.x + m.y - 7 >= 0))
        m.y.set_value(5.0, skip_validation=True)
        return m, "y = 5 is beyond its bound 4", {}
    if kind == "fixed in a program":
        m.y.setlb(4.0)
        m.y.setub(4.0)
        m.y.set_value(5.0, skip_validation=True)
        m.o = pyo.Objective(expr=(m.x - 2) ** 2 + m.y)
        return m, "y = 5 is beyond its bound 4", {}
    if kind == "square":
        m.x.setlb(0.0)
        m.mk = pyo.Constraint(expr=m.x - 1 >= 0)
        return m, "mk = 1 while x = 2 > 0", {"pairs": "match"}
    m.z = pyo.Var(range(100), initialize=0.5)
    m.sum = pyo.Expression(expr=sum((i + 1) * m.z[i] for i in range(100)))
    m.c = mpec.Complementarity(
        range(100), rule=lambda m, i: pair(m.z[i] >= 0, m.sum - 2525 + m.z[i] - 0.5 >= 0)
    )
    m.z[3].value = 0.75
    return m, "c[3] = 1.25 while z[3] = 0.75 > 0", {}


@pytest.mark.parametrize(
    "kind",
    [
        "bound",
        "definition",
        "side condition",
        "fixed by its bounds",
        "fixed in a program",
        "square",
        "shared expression",
    ],
)
def test_certify_measures_the_values_of_a_pyomo_model_in_all_its_conditions(kind):
    """No value is moved into its bounds or replaced by its definition, and side conditions count."""
    model, line, options = in_pyomo(kind)
    found = certify(model, **options)
    assert found.verdict == "disproved"
    assert line in str(found.worst(9))


def test_a_pyomo_model_without_values_or_conditions_is_refused():
    """A variable without a value has no point, and inequalities without pairs have no solution to measure."""
    pyo, mpec = pytest.importorskip("pyomo.environ"), pytest.importorskip("pyomo.mpec")
    m = pyo.ConcreteModel()
    m.x = pyo.Var()
    m.c = mpec.Complementarity(expr=mpec.complements(m.x >= 0, m.x + 1 >= 0))
    with pytest.raises(InvalidProblem, match="x has no value"):
        certify(m)
    with pytest.raises(InvalidProblem, match='pairs="match"'):
        certify(in_pyomo("square")[0])


def test_a_wrong_jacobian_does_not_prove_a_point():
    """F(2, 2) = (1, 0) is large next to F(0) = (−1, −2), and small next to 10¹⁴ of the jacobian."""
    wrong = np.array([[1e14, 1e-3], [1e-3, 1.0]])
    problem = NonlinearProblem(lambda x: x - np.array([1.0, 2.0]), lambda x: wrong, lower=[0, 0])
    assert certify(problem, [2, 2]).verdict == "disproved"
    assert certify(problem, [1, 2]).verdict == "proved"


def test_a_defined_slack_at_rounding_level_is_no_violation():
    """The slack y = M x + q of a solution is 10⁻¹⁵, which rounding of the terms of its equation explains."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        A = rng.normal(size=(6, 6))
        x, y = cp.Variable(6), cp.Variable(6)
        model = [complements(x >= 0, y >= 0), y == (A @ A.T + np.eye(6)) @ x + rng.normal(size=6)]
        problem = cp.Problem(cp.Minimize(0), model)
        problem.solve(method="LCP")
        assert certify(problem).verdict == "proved"
        y.value = y.value + 1e-4
        found = certify(problem)
        assert found.verdict == "disproved"
        assert "and its equation gives" in str(found.worst())


@pytest.mark.quick(1)
@pytest.mark.parametrize("door", certified_points.DOORS)
def test_verdicts_on_points_of_integer_problems_are_right_in_fractions(door, draws):
    """No wrong point is proved and no exact solution is disproved: 10 000 points in the full suite."""
    if door == "pyomo":
        pytest.importorskip("pyomo.environ")
    count = 100 if door in certified_points.SLOW else 280
    found = [one for seed in draws(count, 14) for one in certified_points.faults(seed, door)]
    assert not found


def test_a_cone_run_that_ends_early_has_its_worst_rows():
    """A callback that ends the run at its start leaves rows of a dense problem over cones."""
    cone = ConeProblem(np.eye(3) + 0.5, [-3, -2, 1], [("second_order", 3)])
    result = solve(cone, callback=lambda sample, z: True)
    assert result.status is Status.INTERRUPTED
    assert "in a cone" in result.explain()


NEAR_BOUNDS = [  # M, q, lower, upper, z, verdict
    ([[1.0]], [1e16], 0.0, np.inf, [1.0], "proved"),
    ([[1e-30]], [1.0], 0.0, np.inf, [1e10], "proved"),
    ([[1.0]], [1e4], 0.0, np.inf, [1.0], "disproved"),
    ([[1.0, 1e-17], [1e-17, 1e-17]], [-1.0, 1.0], 0.0, np.inf, [1.0, 50.0], "disproved"),
    ([[1e-17]], [1.0], -10.0, 10.0, [5.0], "disproved"),
    ([[1.0]], [-1e16], 0.0, 1.0, [1.0], "proved"),
    ([[1e-12]], [-1.0], 0.0, 1e-4, [1e-4], "proved"),
    ([[1.0]], [-5.0], 1.0, 1.0 + 2.0**-50, [1.0 + 2.0**-50], "proved"),
]


@pytest.mark.parametrize(("M", "q", "lower", "upper", "z", "verdict"), NEAR_BOUNDS)
def test_certify_measures_the_distance_from_a_bound_in_the_unit_of_the_row(
    M, q, lower, upper, z, verdict
):
    """1 next to |q|/d = 10¹⁶ is at the bound 0, and next to 10⁴ it is not; units of z and w change nothing."""
    assert certify(LCP(M, q, lower=lower, upper=upper), z).verdict == verdict
