"""The best of all solutions through Pyomo and .nl files."""

import numpy as np
import pyomo.environ as pe
import pytest
from pyomo.mpec import Complementarity, complements

import lcp_plugin.pyomo  # noqa: F401 - registers the solver
from lcp_plugin import InvalidOption, UnsupportedModel
from lcp_plugin.interfaces.nl import read_nl


def bard() -> pe.ConcreteModel:
    """Return bard1, whose best value is 17 (J. F. Bard, European Journal of Operational Research 68 (1993))."""
    m = pe.ConcreteModel()
    m.x, m.y = pe.Var(within=pe.NonNegativeReals), pe.Var(within=pe.NonNegativeReals)
    m.l = pe.Var([1, 2, 3], within=pe.NonNegativeReals)
    m.cost = pe.Objective(expr=(m.x - 5) ** 2 + (2 * m.y + 1) ** 2)
    m.slope = pe.Constraint(expr=2 * (m.y - 1) - 1.5 * m.x + m.l[1] - 0.5 * m.l[2] + m.l[3] == 0)
    slacks = {1: 3 * m.x - m.y - 3, 2: -m.x + 0.5 * m.y + 4, 3: -m.x - m.y + 7}
    m.pair = Complementarity([1, 2, 3], rule=lambda m, i: complements(m.l[i] >= 0, slacks[i] >= 0))
    return m


def test_pyomo_finds_the_published_optimum():
    """An objective beside complementarities is minimized over all of their solutions."""
    m = bard()
    solver = pe.SolverFactory("lcp_plugin")
    for prove in (True, False):
        pe.assert_optimal_termination(solver.solve(m, options={"prove": prove}))
        assert (m.x.value, m.y.value) == pytest.approx((1.0, 0.0), abs=1e-7)
        assert pe.value(m.cost) == pytest.approx(17.0, abs=1e-6)
        assert solver.result.verify()
        assert solver.result.bound_by == "proof"


def test_a_file_and_its_maximum(tmp_path):
    """The file that Pyomo writes after mpec.nl gives the same; −f maximized has minus the value."""
    for sense in (pe.minimize, pe.maximize):
        m = bard()
        m.cost.set_value(m.cost.expr if sense == pe.minimize else -m.cost.expr)
        m.cost.sense = sense
        pe.TransformationFactory("mpec.nl").apply_to(m)
        m.write(str(tmp_path / "m.nl"))
        answer = read_nl(tmp_path / "m.nl").solve()
        assert answer.is_solved
        assert answer.objective == pytest.approx(17.0 if sense == pe.minimize else -17.0, abs=1e-6)


def test_bounds_beside_a_pair_are_plain_ones():
    """A bound of a variable that its pair does not state, and an inequality, hold without a partner."""
    m = pe.ConcreteModel()
    m.x, m.y = pe.Var(bounds=(0, 1.5)), pe.Var(bounds=(0, None))
    m.cost = pe.Objective(expr=(m.x - 3) ** 2 + m.y)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y - m.x + 1 >= 0))
    m.least = pe.Constraint(expr=m.y >= 0.2)
    pe.assert_optimal_termination(pe.SolverFactory("lcp_plugin").solve(m))
    assert (m.x.value, m.y.value) == pytest.approx((1.5, 0.5), abs=1e-7)


def test_what_is_not_convex_is_found():
    """A convex objective maximized over a polygon is largest in a corner; a smooth pair excludes what it should."""
    m = bard()
    m.cost.sense = pe.maximize
    solver = pe.SolverFactory("lcp_plugin")
    pe.assert_optimal_termination(solver.solve(m))
    assert pe.value(m.cost) == pytest.approx((24 / 7 - 5) ** 2 + (57 / 7) ** 2, abs=1e-6)
    assert (solver.result.bound_by, solver.result.proof) == ("SCIP", None)
    assert "bound by SCIP, in floating point" in solver.result.explain()
    m = bard()
    # x = 1.5 or y = log 2
    m.bent = Complementarity(expr=complements(pe.exp(m.y) - 2 >= 0, m.x - 1.5 >= 0))
    pe.assert_optimal_termination(solver.solve(m))
    assert min(abs(m.x.value - 1.5), abs(pe.exp(m.y.value) - 2)) <= 1e-7
    assert solver.result.problem.excess(solver.result.x) <= 1e-7


def test_a_yes_or_no_beside_pairs():
    """With x ≥ 2 b, b earns 3 b x: worth it, b is one, exactly; without pairs an integer is refused in words."""
    m = bard()
    m.b = pe.Var(within=pe.Binary)
    m.needs = pe.Constraint(expr=m.x >= 2 * m.b)
    m.cost.set_value(m.cost.expr - 3 * m.b * m.x)
    solver = pe.SolverFactory("lcp_plugin")
    pe.assert_optimal_termination(solver.solve(m))
    assert (m.b.value, pe.value(m.cost)) == (1.0, pytest.approx(10.0, abs=1e-6))
    m.pair.deactivate()
    with pytest.raises(
        UnsupportedModel,
        match="b is an integer variable; integer variables are supported only in models with complementarities",
    ):
        solver.solve(m)


def test_what_is_not_taken_is_named():
    """Proofs of what is not convex, and options of other runs, in words."""
    solver = pe.SolverFactory("lcp_plugin")
    m = bard()
    m.cost.sense = pe.maximize
    with pytest.raises(UnsupportedModel, match="not convex"):
        solver.solve(m, options={"prove": True})
    m = bard()
    m.bent = pe.Constraint(expr=pe.exp(m.y) >= 1)
    with pytest.raises(UnsupportedModel, match=r"prove=True needs affine rows.*leave it out"):
        solver.solve(m, options={"prove": True})
    with pytest.raises(InvalidOption, match="tolerance must be less than 1, got 1: it is relative"):
        solver.solve(bard(), options={"tolerance": 1})
    with pytest.raises(InvalidOption, match="takes no algorithm"):
        solver.solve(bard(), options={"algorithm": "psor"})
    with pytest.raises(InvalidOption, match="max_nodes must be a number ≥ 0, got -1"):
        solver.solve(bard(), options={"max_nodes": -1})


def test_an_infeasible_best_has_a_proof():
    """Where no piece has a point the condition is infeasible, and every leaf of the tree is proved so."""
    m = bard()
    m.never = pe.Constraint(expr=m.x + m.y >= 20)
    solver = pe.SolverFactory("lcp_plugin")
    assert solver.solve(m).solver.termination_condition == pe.TerminationCondition.infeasible
    assert solver.result.verify()
    assert np.isinf(solver.result.lower_bound)


@pytest.mark.parametrize(
    ("fixed", "falls", "wanted"), [(0, 1, 1.0), (1, -1, -1.0), (0, -1, -np.inf), (-1, 1, np.inf)]
)
def test_a_pair_of_a_fixed_variable_holds(fixed, falls, wanted):
    """Fixed x at its bound leaves y ≥ 1, above it y = 1, below it nothing."""
    m = pe.ConcreteModel()
    m.x, m.y, m.t = pe.Var(), pe.Var(), pe.Var(bounds=(0, 5))
    m.x.fix(fixed)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y - 1 >= 0))
    m.cost = pe.Objective(expr=m.t + falls * m.y)
    condition = pe.SolverFactory("lcp_plugin").solve(m).solver.termination_condition
    expected = {
        np.inf: pe.TerminationCondition.infeasible,
        -np.inf: pe.TerminationCondition.unbounded,
    }
    assert condition == expected.get(wanted, pe.TerminationCondition.optimal)
    if np.isfinite(wanted):
        assert pe.value(m.cost) == pytest.approx(wanted, abs=1e-7)
