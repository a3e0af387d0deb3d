"""A pair beside an objective means what it means without one: values, duals, refusals."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import ModelWarning, UnsupportedModel, box, complements

M, Q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])


def of_matrix(X: Any) -> Any:
    """Rows of a matrix of variables, of which all have one solution."""
    return 2 * X + np.arange(6).reshape(2, 3) - 2.5


def parts_of_a_matrix() -> Any:
    """The bounds of a part of a variable are those of its attributes."""
    X = cp.Variable((2, 3), nonneg=True)
    return X, [
        complements(X[:, 1:], of_matrix(X)[:, 1:]),
        complements(X[:, 0] >= 0, X[:, 0] - 1 >= 0),
    ]


def with_minus() -> Any:
    """The side −x of a variable with an upper bound has a lower one."""
    x = cp.Variable(2, bounds=[None, 1.0])
    return x, [complements(-x, Q - M @ x)]


def expression_first() -> Any:
    """The side that is a variable comes second."""
    x = cp.Variable(2)
    return x, [complements(M @ x + Q >= 0, x >= 0)]


def from_above() -> Any:
    """Both sides are at most zero."""
    x = cp.Variable(2, nonpos=True)
    return x, [complements(x, M @ x - Q <= 0)]


def boxes() -> Any:
    """Bounds on both sides, on one, on none."""
    x = cp.Variable(3)
    return x, [complements(box(x, [-1, -np.inf, -np.inf], [1, 0.5, np.inf]), 2 * x - [9, 8, 7])]


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    "model", [parts_of_a_matrix, with_minus, expression_first, from_above, boxes]
)
def test_a_pair_means_the_same_with_an_objective(model):
    """Where there is one solution both ways find it, with the duals of the pair and of the inequalities in it."""
    found = []
    for with_objective in (False, True):
        x, pairs = model()
        problem = cp.Problem(cp.Minimize(cp.sum(x) if with_objective else 0), pairs)
        problem.solve(method="LCP")
        assert problem.status == cp.OPTIMAL
        inner = [
            side.constraint
            for pair in pairs
            for side in (pair.first, pair.second)
            if side.constraint is not None
        ]
        found.append([x.value, *(constraint.dual_value for constraint in [*pairs, *inner])])
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)


def test_an_equality_opposite_an_inequality_is_refused():
    """It would leave the inequality without a partner."""
    x, y = cp.Variable(), cp.Variable()
    pairs = [complements(x >= 0, y - 3 == 0), complements(y, x + 2 == 0)]
    with pytest.raises(UnsupportedModel, match="pairs an equality with an inequality"):
        cp.Problem(cp.Minimize(cp.square(x) + y), pairs).solve(method="LCP")


@pytest.mark.parametrize(
    ("F", "z", "w"),
    [(lambda z: z - 3, 1.0, -2.0), (lambda z: 3 - z, 0.0, 3.0), (lambda z: 2 * z - 1, 0.5, 0.0)],
)
@pytest.mark.parametrize("beside", ["nothing", "a pair and a row", "an objective"])
def test_an_equality_opposite_bounds_is_a_pair_between_them(F, z, w, beside):
    """As PATH takes it: 0 ≤ z ≤ 1 with F == 0 is F ≥ 0 at 0, F ≤ 0 at 1 and 0 between; a warning says so."""
    x, y = cp.Variable(2, bounds=[0, 1]), cp.Variable(nonneg=True)
    pair = complements(x, F(x) == 0)
    more = [complements(y, y - 1), y <= x[0] + 5] if beside == "a pair and a row" else []
    objective = cp.sum_squares(x) if beside == "an objective" else 0
    problem = cp.Problem(cp.Minimize(objective), [pair, *more])
    with pytest.warns(ModelWarning, match="at a bound it need not hold") as caught:
        problem.solve(method="LCP")
    assert problem.status == cp.OPTIMAL
    assert len(caught) == 1
    assert pair.violation() < 1e-7
    np.testing.assert_allclose([x.value, pair.dual_value], [[z, z], [w, w]], atol=1e-7)


def test_variables_that_pairs_alone_name_have_values():
    """On either side, and of an equation."""
    x, y, z = cp.Variable(), cp.Variable(), cp.Variable(2)
    pairs = [complements(x >= 0, y - 1 >= 0), complements(box(z[0], 1, 2), z[1])]
    problem = cp.Problem(cp.Minimize(cp.square(y)), pairs)
    problem.solve(method="LCP")
    assert problem.value == pytest.approx(1.0)
    assert all(pair.value() for pair in pairs)
    u, t = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    lone = cp.Problem(cp.Minimize(cp.square(y)), [complements(u, t)])
    lone.solve(method="LCP")
    assert min(u.value, t.value) == 0.0


@pytest.mark.parametrize("is_first", [True, False])
def test_a_free_variable_opposite_an_expression_means_an_equation(is_first):
    """complements(x, y − 1) with x free says y = 1 in either order, as without an objective, and warns of it."""
    x, y = cp.Variable(), cp.Variable()
    pair = complements(x, y - 1) if is_first else complements(y - 1, x)
    with pytest.warns(ModelWarning, match="has no bounds"):
        cp.Problem(cp.Minimize((x - 2) ** 2 + y**2), [pair]).solve(method="LCP")
    assert (x.value, y.value) == pytest.approx((2.0, 1.0), abs=1e-8)


def test_a_pair_of_any_sides_has_a_violation():
    """Of boxes of expressions, and of variables with other bounds than the pair states, which have none otherwise."""
    x, y = cp.Variable(2, bounds=[-3, 3]), cp.Variable(2)
    pairs = [complements(box(x + y, -1, 1), x - y + 3), complements(x[0] >= 0, x[1] + 2 >= 0)]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - 1) + cp.sum_squares(y)), pairs)
    problem.solve(method="LCP")
    assert problem.status == cp.OPTIMAL
    assert max(pair.violation() for pair in pairs) <= 1e-7
    x.value = x.value + np.array([0.0, 0.25])
    assert pairs[0].violation() >= 0.2


@pytest.mark.parametrize("beside", [False, True])
def test_an_equality_that_says_nothing_is_taken_beside_no_objective(beside):
    """A free z with 0*z == 0 may have any value, alone and beside a pair that needs it."""
    z, x = cp.Variable(2), cp.Variable(2)
    more = [complements(x >= 0, x + z - 1 >= 0)] if beside else []
    problem = cp.Problem(cp.Minimize(0), [complements(z, 0 * z == 0), *more])
    problem.solve(method="LCP")
    assert problem.status == cp.OPTIMAL
    assert np.isfinite(z.value).all()
