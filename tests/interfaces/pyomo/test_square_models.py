"""Square Pyomo models without ``Complementarity``, as GAMS writes them, have the published solutions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyomo.environ as pe
import pytest
from inputs import nonlinear_models as models
from pyomo.common.collections import ComponentMap
from pyomo.mpec import Complementarity
from pyomo_checks import residual
from pyomo_models import MODELS
from tools.refusals import assert_refused, refusals

import lcp_plugin.pyomo
from lcp_plugin import LCPError
from lcp_plugin.interfaces.pyomo import pair_of_sides, sides_of

SOLVER = pe.SolverFactory(lcp_plugin.pyomo.NAME)


def solve(m: Any, pairs: Any) -> None:
    pe.assert_optimal_termination(SOLVER.solve(m, pairs=pairs, options={"tolerance": 1e-12}))


def without_pairs(m: Any) -> ComponentMap:
    """Replace the complementarities of a model by constraints and bounds, some negated, and return the pairs."""
    pairs, m.rows = ComponentMap(), pe.ConstraintList()
    for k, stated in enumerate([*m.component_data_objects(Complementarity, active=True)]):
        (lower, variable, upper), w = pair_of_sides(stated, sides_of(stated), lambda _: False)[1:]
        if np.isfinite(lower):
            variable.setlb(lower)
        if np.isfinite(upper):
            variable.setub(upper)
        form = w == 0
        if not np.isfinite([lower, upper]).all():
            form = (w >= 0 if k % 2 else -w <= 0) if np.isfinite(lower) else w <= 0
        pairs[m.rows.add(form)] = variable
        stated.deactivate()
    return pairs


@pytest.mark.quick(2)
@pytest.mark.parametrize("name", MODELS)
def test_stated_pairs_have_the_published_solution(name):
    """Constraints with ``pairs=ComponentMap`` satisfy the published complementarities."""
    case, original = MODELS[name](), MODELS[name]()
    solve(case.model, without_pairs(case.model))
    ours, theirs = (one.model.component_data_objects(pe.Var) for one in (case, original))
    for mine, variable in zip(ours, theirs, strict=True):
        variable.set_value(mine.value, skip_validation=True)
    x = np.array([variable.value for variable in case.variables])
    off = [np.abs(x[: len(one)] - one).max() / max(1.0, np.abs(one).max()) for one in case.answers]
    assert min(off, default=0.0) <= case.digits
    assert residual(original.model) < 1e-8 * (1 + np.abs(x).max())


def functions(F: Any, n: int, lower: Any = 0.0, start: Any = 1.0) -> Any:
    """Return the model F_i(x) ≥ 0, x_i ≥ lower, both over the indices i."""
    m, start = pe.ConcreteModel(), np.broadcast_to(start, n)
    m.x = pe.Var(range(n), bounds=(lower, None), initialize=lambda m, i: start[i])
    rows = F(np.array([*m.x.values()], dtype=object))
    m.row = pe.Constraint(range(n), rule=lambda m, i: rows[i] >= 0)
    return m


@pytest.mark.parametrize(
    ("F", "solutions"),
    [
        (models.kojima_shindo, [[1.5**0.5, 0, 0, 0.5], [1, 0, 3, 0]]),
        (models.josephy, [[1.5**0.5, 0, 0, 0.5]]),
        (models.billups, [[1 + 1.01**0.5]]),
        (models.NASH_5, [models.NASH_5_SOLUTION]),
        (models.NASH_10, [models.NASH_10_SOLUTION]),
    ],
)
def test_rows_over_the_index_set_of_their_variables_are_matched(F, solutions):
    """Published functions over one index set."""
    m = functions(F, len(solutions[0]))
    solve(m, "match")
    x = np.array([variable.value for variable in m.x.values()])
    assert min(np.abs(x - solution).max() for solution in solutions) < 1e-4


def test_transport_of_dantzig():
    """G. B. Dantzig, Linear Programming and Extensions (1963): 153.675, and the prices of the three markets."""
    m, plants, markets = pe.ConcreteModel(), [350, 600], [325, 300, 275]
    cost = 0.09 * np.array([[2.5, 1.7, 1.8], [2.5, 1.8, 1.4]])
    m.i, m.j = pe.RangeSet(0, 1), pe.RangeSet(0, 2)
    m.x = pe.Var(m.i, m.j, within=pe.NonNegativeReals)
    m.w, m.p = (pe.Var(one, within=pe.NonNegativeReals) for one in (m.i, m.j))
    m.profit = pe.Constraint(m.i, m.j, rule=lambda m, i, j: m.w[i] + cost[i, j] >= m.p[j])
    m.supply = pe.Constraint(m.i, rule=lambda m, i: plants[i] >= sum(m.x[i, :]))
    m.demand = pe.Constraint(m.j, rule=lambda m, j: sum(m.x[:, j]) >= markets[j])
    m.dual = pe.Suffix(direction=pe.Suffix.IMPORT)
    solve(m, "match")
    assert sum(cost[key] * x.value for key, x in m.x.items()) == pytest.approx(153.675)
    assert [p.value for p in m.p.values()] == pytest.approx([0.225, 0.153, 0.126])
    assert m.dual[m.supply[0]] == pytest.approx(350 - sum(x.value for x in m.x[0, :]))


def test_economy_of_scarf_and_hansen():
    """Six prices, eight activities, five incomes of which the first is fixed: goods, activities and agents are sets."""
    problem, start, excess = models.scarf()
    m = pe.ConcreteModel()
    parts = {"price": slice(0, 6), "level": slice(6, 14), "income": slice(14, 19)}
    for name, part in parts.items():
        m.add_component(
            name, pe.Var(range(len(start[part])), initialize=dict(enumerate(start[part])))
        )
    x = [one for name in parts for one in m.component(name).values()]
    for one, lower in zip(x, problem.lower, strict=True):
        one.setlb(None if np.isinf(lower) else lower)
    m.income[0].fix()
    rows = problem.F(np.array(x, dtype=object))
    m.market = pe.Constraint(range(6), rule=lambda m, i: rows[i] >= 0)
    m.profit = pe.Constraint(range(8), rule=lambda m, i: rows[6 + i] >= 0)
    m.budget = pe.Constraint(range(5), rule=lambda m, i: rows[14 + i] == 0)
    solve(m, "match")
    prices, supply = excess(np.array([one.value for one in x]))
    assert np.abs(np.minimum(prices, supply)).max() < 1e-6


def test_traffic_of_braess_has_equations_without_pairs():
    """Wardrop's rows belong to the flows by their indices, and the equations to variables without bounds."""
    m = MODELS["braess"]().model
    m.wardrop.deactivate()
    first = {path: pair._args for path, pair in m.wardrop.items()}
    for flow in m.flow.values():
        flow.setlb(0.0)
    m.row = pe.Constraint(m.path, rule=lambda m, path: first[path][0])
    solve(m, "match")
    assert [one.value for one in [*m.flow.values(), m.time]] == pytest.approx([2, 2, 2, 92])
    m.demand.deactivate()
    m.again = pe.Constraint(m.road, rule=lambda m, r: m.use[r] == 4)
    with pytest.raises(LCPError, match=r"structurally singular: constraint again.* would need"):
        solve(m, "match")


def test_a_row_without_its_variable_is_not_matched_by_the_pattern():
    """In "maximize x for x ≤ 3" the pattern would pair the limit with x, and accept x = 0."""
    m = pe.ConcreteModel()
    m.x, m.p = (pe.Var(within=pe.NonNegativeReals) for _ in range(2))
    m.limit, m.profit = pe.Constraint(expr=m.x <= 3), pe.Constraint(expr=m.p >= 1)
    with pytest.raises(LCPError, match="limit may belong to x, p; state which"):
        solve(m, "match")
    solve(m, {m.limit: m.p})
    assert (m.x.value, m.p.value) == pytest.approx((3, 1))


def test_a_market_that_is_missing_is_named():
    """A row is written for one of two prices."""
    m = two((0, None))
    m.row[1].deactivate()
    m.last.deactivate()
    m.more = pe.Constraint(expr=m.x[1] + m.y == 0)
    with pytest.raises(LCPError, match=r"x\[1\] has bounds, and no other constraint"):
        solve(m, "match")


def two(bounds: Any = (None, None)) -> Any:
    m = pe.ConcreteModel()
    m.x, m.y = pe.Var(range(2), bounds=bounds), pe.Var()
    m.row = pe.Constraint(range(2), rule=lambda m, i: m.x[i] + m.y == i)
    m.last = pe.Constraint(expr=m.y >= 0)
    return m


@refusals(r"""
solve(m, 'all') → pairs must be 'match' or {constraint: variable}
solve(m, {m.row[0]: m.y, m.row[1]: m.y}) → y is paired with row\[0\] and with row\[1\]
solve(m, ComponentMap([(m.row, m.x), (m.row[0], m.y)]))
    → row\[0\] is paired with x\[0\] and with y; a row has one variable
solve(m, ComponentMap([(m.y, m.last)])) → pairs has y in the place of a Constraint; state
solve(m, {'last': 'y'}) → pairs has 'last' in the place of a Constraint; state
solve(m, {m.last: None}) → pairs has None in the place of a Var; state
solve(m, {m.last: m.y}) → last cannot be the row of y
solve(m, {m.last: m.x}) → x has no index None for last
solve(m, 'match') → last has no partner with the same indices \(for an inequality, a variable with bounds\)
""")
def test_pairs_that_are_wrong_are_refused_by_name(call, words):
    """The message names the constraint and the variable."""
    m = two()
    assert_refused(call, words, {**globals(), "m": m, "ComponentMap": ComponentMap})
