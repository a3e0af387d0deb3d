"""Models written in plain Pyomo reach the solver, and are not modified except for the solution."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyomo.environ as pe
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.gdp import Disjunct, Disjunction
from pyomo.mpec import Complementarity, ComplementarityList, complements
from pyomo.mpec.tests.test_complementarity import CCTests as _PyomosForms
from pyomo_checks import picture, residual
from pyomo_models import MODELS
from tools.processes import printed_by
from tools.refusals import assert_refused, refusals

import lcp_plugin.pyomo
from lcp_plugin import LCPError
from lcp_plugin.interfaces.nl import read_nl
from lcp_plugin.pyomo import write_nl

SOLVER = pe.SolverFactory("lcp_plugin")


@pytest.mark.quick(2)
@pytest.mark.parametrize("name", MODELS)
def test_published_models_are_solved_as_published(name):
    """The solution of each model is optimal, satisfies Pyomo's expressions, and is published."""
    case = MODELS[name]()
    results = SOLVER.solve(case.model, options={"tolerance": 1e-12})
    pe.assert_optimal_termination(results)
    x = np.array([variable.value for variable in case.variables])
    assert residual(case.model) < 1e-8 * (1 + np.abs(x).max())
    parts = [(x[: len(answer)], np.asarray(answer, dtype=float)) for answer in case.answers]
    off = [np.abs(part - answer).max() / max(1.0, np.abs(answer).max()) for part, answer in parts]
    assert min(off, default=0.0) <= case.digits


def model(build: Callable[[Any], None]) -> Any:
    m = pe.ConcreteModel()
    m.x = pe.Var()
    build(m)
    return m


def pair(m: Any, first: Any, second: Any, name: str = "c") -> None:
    m.add_component(name, Complementarity(expr=complements(first, second)))


def made(*pairs: Any, cost: Any = (), x: Any = (None, None), **rows: Any) -> Callable[[Any], None]:
    """Return a function that adds a variable y, pairs c, d …, rows and objectives to a model."""

    def build(m: Any) -> None:
        m.y = pe.Var()
        m.x.setlb(x[0])
        m.x.setub(x[1])
        for name, one in zip("cd", pairs, strict=False):
            pair(m, *one(m), name)
        for name, row in rows.items():
            m.add_component(name, pe.Constraint(expr=row(m)))
        for k, expression in enumerate(cost):
            m.add_component(f"cost{k}", pe.Objective(expr=expression(m)))

    return build


def least(value: float) -> Any:
    """Return 0 ≤ x ⟂ x − value ≥ 0."""
    return lambda m: (m.x >= 0, m.x - value >= 0)


def numeraire(m: Any) -> None:
    m.p = pe.Var([0, 1], initialize=1.0)
    m.p[0].fix(1.0)
    m.wanted = pe.Expression([0, 1], rule=lambda m, i: 0.5 * (m.p[0] + m.p[1]) / m.p[i])
    m.market = Complementarity(
        [0, 1], rule=lambda m, i: complements(m.p[i] >= 0, 1 - m.wanted[i] >= 0)
    )
    pair(m, m.x >= 0, m.x - m.p[1] >= 0)


def constant_row(m: Any) -> None:
    m.push = pe.Param(initialize=3.0, mutable=True)
    pair(m, m.x >= 1, m.push >= 0)


def deactivated(m: Any) -> None:
    pair(m, m.x >= 0, m.x - 9 >= 0)
    pair(m, m.x >= 0, m.x - 2 >= 0, "d")
    m.e = pe.Constraint(expr=m.x == 77)
    m.c.deactivate()
    m.e.deactivate()


def nested(m: Any) -> None:
    m.b = pe.Block([1, 2])
    m.b[2].inner = pe.Block()
    m.b[2].inner.c = ComplementarityList(rule=(complements(m.x >= i, m.x - 4 >= 0) for i in (1,)))
    m.b[1].y = pe.Var([3, 4])
    m.b[1].c = Complementarity(
        [3, 4], rule=lambda b, i: complements(b.y[i] <= i, b.y[i] - m.x <= 0)
    )


def references(m: Any) -> None:
    m.b = pe.Block([1, 2])
    m.b[1].y, m.b[2].y = pe.Var(), pe.Var()
    for i in m.b:
        m.b[i].c = Complementarity(expr=complements(m.b[i].y >= 0, m.b[i].y - i >= 0))
    m.all_pairs, m.all_y = pe.Reference(m.b[:].c), pe.Reference(m.b[:].y)
    m.e = pe.Constraint(expr=m.x == sum(m.all_y[i] for i in m.all_y))
    m.all_equations = pe.Reference(m.e)


def discretised(m: Any) -> None:
    m.t = ContinuousSet(bounds=(0, 2))
    m.y, m.push = pe.Var(m.t), pe.Var(m.t)
    m.slope = DerivativeVar(m.y, wrt=m.t)
    m.fall = pe.Constraint(
        m.t, rule=lambda m, t: m.slope[t] == m.push[t] - 1 if t > 0 else pe.Constraint.Skip
    )
    m.begin = pe.Constraint(expr=m.y[0] == 1.0)
    pe.TransformationFactory("dae.collocation").apply_to(m, nfe=4, ncp=2)
    later = [t for t in m.t if t > 0]
    m.floor = Complementarity(later, rule=lambda m, t: complements(m.y[t] >= 0, m.push[t] >= 0))
    m.e = pe.Constraint(expr=m.x == m.y[0.5] + m.y[2])


STATED: dict[str, tuple[Callable[[Any], None], float]] = {
    "a range": (made(lambda m: (pe.inequality(0, m.x, 5), m.x - 7)), 5.0),
    "a range of an expression": (
        made(lambda m: (m.x - 7, pe.inequality(0, m.x + m.y, 5)), e=lambda m: m.y == 1),
        4.0,
    ),
    "a range of a variable beside another": (
        made(lambda m: (pe.inequality(0, m.x, 5), m.y), e=lambda m: m.y + 2 == m.x),
        2.0,
    ),
    "a slack": (made(lambda m: (m.x >= 0, m.y >= 0), e=lambda m: m.y == 2 * m.x - 3), 1.5),
    "wide bounds of its own": (made(least(7), x=(-1, 100)), 7.0),
    "a constant row": (constant_row, 1.0),
    "an equation as a pair": (
        made(lambda m: (m.x >= 0, m.x - m.y >= 0), lambda m: (m.y, m.y == 4)),
        4.0,
    ),
    "an inequality that holds": (made(least(2), beside=lambda m: m.x**2 <= 5), 2.0),
    "without pairs": (made(e=lambda m: pe.exp(m.x) == 5), np.log(5)),
    "a price that is fixed": (numeraire, 1.0),
    "components that are deactivated": (deactivated, 2.0),
    "blocks in blocks": (nested, 4.0),
    "references": (references, 3.0),
    "a discretised derivative": (discretised, 0.5),
}


@pytest.mark.parametrize("name", STATED)
def test_what_may_be_stated(name):
    """Every form of a pair has the right solution, even if Pyomo's transformation fails."""
    build, value = STATED[name]
    m = model(build)
    before = picture(m)
    pe.assert_optimal_termination(SOLVER.solve(m))
    assert m.x.value == pytest.approx(value, abs=1e-7)
    assert residual(m) < 1e-6
    assert picture(m) == before


OF_ITS_OWN = {  # the model, its bound, and the row there
    "upper": (made(least(7), x=(None, 5)), 5.0, -2.0),
    "smooth": (
        made(lambda m: (pe.exp(m.x) - 50 >= 0, m.x >= 0), x=(None, 2)),
        2.0,
        np.exp(2.0) - 50.0,
    ),
}


@pytest.mark.parametrize("name", OF_ITS_OWN)
def test_bounds_of_a_variable_belong_to_its_pair(name, tmp_path):
    """Bounds of a variable belong to its pair, as in PATH and AMPL."""
    build, bound, row = OF_ITS_OWN[name]
    m = model(build)
    m.dual = pe.Suffix(direction=pe.Suffix.IMPORT)
    results = SOLVER.solve(m)
    pe.assert_optimal_termination(results)
    assert m.x.value == pytest.approx(bound, abs=1e-9)
    assert m.dual[m.c] == pytest.approx(row)
    write_nl(m, tmp_path / "m.nl")
    again = read_nl(tmp_path / "m.nl").solve()
    assert (again.is_solved, again.x.tolist()) == (True, pytest.approx([bound]))


@pytest.mark.parametrize(
    ("inside", "outside"), [("x", "n"), ("n", "x")], ids=["linear", "before a continuous one"]
)
def test_an_integer_of_a_nonlinear_term_stays_one_in_a_file(inside, outside, tmp_path):
    """SCIP reads n as an integer, 2, if a nonlinear term of the objective holds it, and the row holds x or n."""
    scip = pytest.importorskip("pyscipopt")
    m = pe.ConcreteModel()
    m.x = pe.Var(bounds=(0, None), initialize=1)
    m.n = pe.Var(domain=pe.Integers, bounds=(0, 5), initialize=1)
    m.c = pe.Constraint(expr=getattr(m, inside) ** 2 + getattr(m, outside) >= 2.5)
    m.o = pe.Objective(expr=(m.n - 1.4) ** 2 + m.x)
    write_nl(m, tmp_path / "m.nl")
    read = scip.Model()
    read.hideOutput()
    read.readProblem(str(tmp_path / "m.nl"))
    read.optimize()
    (n,) = (one for one in read.getVars() if one.name == "n")
    assert (n.vtype(), read.getVal(n)) == ("INTEGER", pytest.approx(2.0))


def test_a_file_is_written_without_a_solve(tmp_path):
    """model.write raises ValueError for pairs; write_nl writes pairs and other rows, with names."""
    m = MODELS["oligomcp"]().model
    with pytest.raises(ValueError, match="Complementarity"):
        m.write(str(tmp_path / "theirs.nl"))
    write_nl(m, tmp_path / "m.nl")
    assert "q[0]" in (tmp_path / "m.col").read_text(encoding="utf-8")
    SOLVER.solve(m)
    assert read_nl(tmp_path / "m.nl").solve().x == pytest.approx(
        [m.q[i].value for i in m.q], rel=1e-6
    )
    m.beside = pe.Constraint(expr=m.q[0] <= 1e6)
    write_nl(m, tmp_path / "m.nl")
    assert read_nl(tmp_path / "m.nl").side_conditions.names() == ["beside"]


@pytest.mark.parametrize("size", [1e-10, 1e-3, 1.0, 1e10])
def test_what_holds_only_in_part_is_not_optimal_in_any_unit(size):
    """A violated inequality, or pair of a fixed variable, is not optimal at any scale."""
    m = model(lambda m: pair(m, m.x >= 0, m.x - 5 >= 0))
    m.beside = pe.Constraint(expr=size * m.x <= size)
    results = SOLVER.solve(m)
    told = results.solver.status.value, results.solver.termination_condition.value
    assert told == ("warning", "infeasible")
    assert "beside does not hold, off by" in results.solver.message
    with pytest.raises(RuntimeError):
        pe.assert_optimal_termination(results)
    m.beside.set_value(size * m.x - size * 5 <= 0)
    pe.assert_optimal_termination(SOLVER.solve(m))
    m.p = pe.Var(initialize=1.0)
    m.p.fix()
    pair(m, m.p >= 0, size * (m.x - m.p) >= 0, "d")
    assert "d does not hold" in SOLVER.solve(m).solver.message


def disjunction(m: Any) -> None:
    m.x.setlb(-9)
    m.one, m.two = Disjunct(), Disjunct()
    m.one.c = Complementarity(expr=complements(m.x >= 0, m.x >= 2))
    m.either = Disjunction(expr=[m.one, m.two])


def derivative(m: Any) -> None:
    m.t = ContinuousSet(bounds=(0, 2))
    m.y = pe.Var(m.t)
    m.slope = DerivativeVar(m.y, wrt=m.t)
    pair(m, m.x >= 0, m.x >= 2)


def test_an_abstract_model_is_told_apart():
    """A model without data raises an error with advice."""
    abstract = pe.AbstractModel()
    abstract.x = pe.Var()
    with pytest.raises(LCPError, match=r"solve model.create_instance\(…\)"):
        SOLVER.solve(abstract)
    with pytest.raises(LCPError, match="a Pyomo model or block is needed, got ScalarVar"):
        SOLVER.solve(simple().x)


def no_variable(m: Any) -> None:
    m.x.fix(1.0)
    m.e = pe.Constraint(expr=m.x <= 2)


def attempt(build: Callable[[Any], None]) -> None:
    """Solve a model, which stays as it is; the message suggests no LCP, which would omit constraints and pairs."""
    m = model(build)
    before = picture(m)
    with pytest.raises(LCPError) as caught:
        SOLVER.solve(m)
    assert "LCP(" not in str(caught.value)
    assert picture(m) == before
    raise caught.value


@refusals(r"""
attempt(made(lambda m: (m.x >= 0, m.x + m.y - 2 >= 0)))
    → the model has 0 equations and 1 unknown without a complementarity \(y\)
attempt(made(lambda m: (m.x >= 0, pe.atan(m.x) - 1 >= 0), cost=(lambda m: m.x**2,))) → SCIP knows no atan
attempt(made(lambda m: (m.x >= 0, abs(m.x) - 2 >= 0))) → abs\(x\) is x \+ 2 s with s >= 0 complements x \+ s >= 0
attempt(made(lambda m: (m.x >= 0, m.x))) → c has 1 finite bound on its two sides together, and needs two
attempt(made(lambda m: (pe.inequality(0, m.x, m.y), m.x))) → the bound y of c varies; state the difference
attempt(made(lambda m: (m.x > 0, m.x >= 2))) → a side of c is strict, 0  <  x; write <= or >=
attempt(made(lambda m: (m.x >= 0, m.x == 2))) → write complements\(x >= 0, F >= 0\)
attempt(made(least(2), lambda m: (m.x >= 0, m.x >= 3)))
    → the unknown for d: its pair holds no variable, or one that another pair holds
attempt(made(least(2), e=lambda m: 3 * m.x == 6))
    → an equation fixes x, which has a pair: set both bounds of x to 2 in that pair, and drop
attempt(disjunction) → Disjunct is not taken; the model has one, two; apply gdp\.bigm or gdp\.hull
attempt(derivative) → DerivativeVar is not taken; the model has slope; discretise it, TransformationFactory\(
attempt(no_variable) → no active constraint, objective or pair has a free variable
attempt(made(e=lambda m: m.x + m.y <= 2, cost=(lambda m: m.x * m.y - m.x,)))
    → convex: the smallest eigenvalue of P is -1
""")
def test_what_is_not_taken_is_refused_by_name(call, words):
    """The message names the component and the remedy; the model is unchanged."""
    assert_refused(call, words, globals())


class PyomosOwn(_PyomosForms):  # type: ignore[misc]
    """Pyomo's models of every form of a complementarity, each given to the solver."""

    def _test(self, name: str, model: Any) -> None:
        before = picture(model)
        try:
            self.outcome = SOLVER.solve(model).solver.termination_condition.value
        except LCPError as error:
            self.outcome = str(error)
        assert self.outcome != "optimal" or residual(model) < 1e-8
        assert picture(model) == before


OPEN = "it needs as many equations as such unknowns; give these a pair or an equation"
FORMS = {
    **dict.fromkeys(("t1a", "t1b", "t1c", "t2a", "t2b", "t3a", "t3b", "t11", "t12"), OPEN),
    **dict.fromkeys(("t4a", "t4b", "t4c", "t4d", "t9", "cov2", "cov4", "cov8", "cov9"), "optimal"),
    **dict.fromkeys(("t10", "t13", "list1", "list2", "list3", "list4", "list5"), "infeasible"),
}


@pytest.mark.parametrize("form", FORMS)
def test_pyomos_own_models_of_each_form(form):
    """Equations are solved or proved infeasible; unknowns without an equation raise an error."""
    case = PyomosOwn()
    getattr(case, f"test_{form}")()
    assert case.outcome.endswith(FORMS[form])


def simple() -> Any:
    return model(lambda m: pair(m, m.x >= 0, pe.exp(m.x) - 2 >= 0))


@refusals(r"""
SOLVER.solve(simple(), timelimt=1) → lcp_plugin takes no keyword 'timelimt' in Pyomo; did you mean 'timelimit'\?
SOLVER.solve(simple(), options={'tol': 1e-9}) → takes no tol
""")
def test_wrong_options_are_refused_in_words(call, words):
    """A mistyped keyword, option or algorithm raises an error that suggests the nearest name."""
    assert_refused(call, words, globals())


def test_options_of_the_solver_stay_and_those_of_a_solve_do_not():
    """``solver.options`` hold for every solve; ``options=`` for one."""
    solver = pe.SolverFactory("lcp_plugin", options={"max_iterations": 0})
    m = simple()
    assert solver.solve(m).solver.termination_condition.value == "maxIterations"
    pe.assert_optimal_termination(solver.solve(m, options={"max_iterations": 50}))
    m.x.set_value(0.0)
    assert solver.solve(m).solver.termination_condition.value == "maxIterations"
    del solver.options["max_iterations"]
    assert solver.solve(m, timelimit=0.0).solver.termination_condition.value == "maxTimeLimit"


def test_a_changed_parameter_needs_another_solve_only_and_begins_at_the_last_answer():
    """Mutable parameters may change in rows and bounds; a second solve of the same begins at its answer."""
    m = pe.ConcreteModel()
    m.a, m.floor = pe.Param(mutable=True, initialize=2.0), pe.Param(mutable=True, initialize=0.0)
    m.x = pe.Var(range(5), initialize=9.0)
    m.row = pe.Expression(range(5), rule=lambda m, i: pe.exp(m.x[i]) + i * m.x[i])
    m.c = Complementarity(
        range(5), rule=lambda m, i: complements(m.x[i] >= m.floor, m.row[i] >= m.a)
    )
    SOLVER.solve(m)
    first = SOLVER.result
    SOLVER.solve(m)
    assert SOLVER.result.iterations < first.iterations
    m.a, m.floor = 0.5, -0.25
    pe.assert_optimal_termination(SOLVER.solve(m))
    assert [m.x[i].value for i in (0, 1)] == pytest.approx([-0.25, -0.25])
    assert residual(m) < 1e-8


def test_suffixes_get_the_row_of_each_pair():
    """``dual`` of a pair and ``rc`` of its variable are the row; stale values are removed."""
    m = pe.ConcreteModel()
    m.x = pe.Var([1, 2], initialize=1.0)
    m.low = Complementarity(expr=complements(m.x[1] >= 0, m.x[1] + m.x[2] + 1 >= 0))
    m.high = Complementarity(expr=complements(m.x[2] <= 1, m.x[2] - 5 <= 0))
    m.dual, m.rc = pe.Suffix(direction=pe.Suffix.IMPORT), pe.Suffix(direction=pe.Suffix.IMPORT)
    m.dual[m.x[1]] = 77.0
    SOLVER.solve(m)
    assert (m.dual[m.low], m.dual[m.high], m.rc[m.x[1]], m.rc[m.x[2]]) == pytest.approx(
        (2.0, -4.0, 2.0, -4.0)
    )
    assert m.x[1] not in m.dual


def program() -> Any:
    m = pe.ConcreteModel()
    m.x = pe.Var([1, 2], within=pe.NonNegativeReals)
    m.o = pe.Objective(expr=(m.x[1] - 3) ** 2 + m.x[2] ** 2 + m.x[2])
    m.limit = pe.Constraint(expr=m.x[1] + m.x[2] <= 2)
    m.dual, m.rc = pe.Suffix(direction=pe.Suffix.IMPORT), pe.Suffix(direction=pe.Suffix.IMPORT)
    return m


@pytest.mark.parametrize("sense", [pe.minimize, pe.maximize])
def test_convex_programs_have_pyomos_multipliers(sense):
    """``dual`` is the derivative of the objective by a right-hand side, ``rc`` by a bound."""
    m = program()
    sign = 1.0 if sense == pe.minimize else -1.0
    m.o.set_value(sign * m.o.expr)
    m.o.sense = sense
    results = SOLVER.solve(m)
    pe.assert_optimal_termination(results)
    assert [m.x[1].value, m.x[2].value] == pytest.approx([2.0, 0.0], abs=1e-8)
    assert sign * m.dual[m.limit] == pytest.approx(-2.0)
    assert (sign * m.rc[m.x[2]], m.rc[m.x[1]]) == pytest.approx((3.0, 0.0), abs=1e-8)
    assert results.problem.upper_bound == pytest.approx(sign)
    assert (results.problem.sense == pe.maximize) == (sense == pe.maximize)


def test_a_row_of_fixed_variables_that_does_not_hold_makes_a_program_infeasible():
    """A violated row of fixed variables makes a program infeasible; rounding errors do not."""
    m = model(lambda m: None)
    m.y = pe.Var([1, 2])
    m.y[1].fix(0.1)
    m.y[2].fix(0.2)
    m.row = pe.Constraint(expr=m.y[1] + m.y[2] == 0.3)
    m.low = pe.Constraint(expr=m.x >= 2)
    m.o = pe.Objective(expr=m.x)
    pe.assert_optimal_termination(SOLVER.solve(m))
    m.y[2].fix(0.3)
    assert SOLVER.solve(m).solver.termination_condition.value == "infeasible"
    m.low.deactivate()
    assert SOLVER.solve(m).solver.termination_condition.value == "infeasible"


def test_a_model_without_solution_has_a_proof_and_loads_nothing():
    """Infeasible and unbounded are proved, and the variables keep their values."""
    m = model(lambda m: pair(m, m.x >= 0, -m.x - 3 >= 0))
    m.x.set_value(0.5)
    results = SOLVER.solve(m)
    assert results.solver.termination_condition.value == "infeasible"
    assert m.x.value == 0.5
    assert SOLVER.result.infeasibility.verify()
    m = program()
    m.o.set_value(-m.x[1])
    m.limit.deactivate()
    m.rest = pe.Constraint(expr=m.x[1] >= m.x[2])
    assert SOLVER.solve(m).solver.termination_condition.value == "unbounded"


def test_tee_prints_the_run_and_keepfiles_keeps_the_file(capsys, tmp_path, monkeypatch):
    """tee=True prints the run; keepfiles=True leaves an .nl file that states the same model by itself."""
    monkeypatch.chdir(tmp_path)
    m = MODELS["oligomcp"]().model
    SOLVER.solve(m)
    assert capsys.readouterr().out == ""
    assert not list(tmp_path.iterdir())
    SOLVER.solve(m, tee=True, keepfiles=True, symbolic_solver_labels=True)
    out = capsys.readouterr().out
    assert "residual" in out
    (file,) = tmp_path.glob("*/*.nl")
    assert str(file) in out
    assert "q[0]" in file.with_suffix(".col").read_text(encoding="utf-8")
    assert read_nl(file).solve().x == pytest.approx([m.q[i].value for i in m.q], rel=1e-6)


def test_a_run_that_is_stopped_says_so_and_loads_its_best_point():
    """A callback that ends the run, as Ctrl-C does: userInterrupt, aborted."""
    m = simple()
    results = SOLVER.solve(m, options={"callback": lambda sample, _: sample.iteration >= 1})
    assert (results.solver.termination_condition.value, results.solver.status.value) == (
        "userInterrupt",
        "aborted",
    )
    assert m.x.value is not None


def test_a_model_that_pyomo_transformed_before_is_solved_too():
    """After ``mpec.nl`` the rows carry their partners, and what was added is loaded like the rest."""
    m = MODELS["munson1c"]().model
    pe.TransformationFactory("mpec.nl").apply_to(m)
    pe.assert_optimal_termination(SOLVER.solve(m))
    assert [m.x1.value, m.x2.value, m.x3.value] == pytest.approx([1, 0, 0], abs=1e-8)


def test_the_name_with_a_hyphen_is_the_same_solver():
    """SolverFactory("lcp-plugin") is not an executable of that name."""
    m = simple()
    pe.assert_optimal_termination(pe.SolverFactory("lcp-plugin").solve(m))
    assert m.x.value == pytest.approx(np.log(2))


COMMANDS_MODEL = """
import pyomo.environ as pe
from pyomo.mpec import Complementarity, complements

model = pe.ConcreteModel()
model.x = pe.Var([1, 2], within=pe.NonNegativeReals)
model.pair = Complementarity(expr=complements(model.x[1] >= 0, 2 * model.x[1] + model.x[2] >= 5))
model.other = Complementarity(expr=complements(model.x[2] >= 0, model.x[1] + 2 * model.x[2] >= -1))
"""


@pytest.mark.full
def test_pyomos_command_solves_and_writes_the_answer(tmp_path):
    """``pyomo solve --solver=lcp_plugin``, with the options of Pyomo's own tests; the file holds the values."""
    (tmp_path / "model.py").write_text(COMMANDS_MODEL)
    options = [
        "--symbolic-solver-labels",
        "--file-determinism=2",
        "--solver-options=tolerance=1e-10 threads=1",
    ]
    wanted = ["solve", "--solver=lcp_plugin", "--results-format=json", *options, "model.py"]
    printed = printed_by(
        f"import os; os.chdir({str(tmp_path)!r})\nimport lcp_plugin.pyomo  # as its entry point does\n"
        f"from pyomo.scripting.pyomo_main import main\nprint('ended with', main({wanted!r}).errorcode)"
    )
    assert "ended with 0" in printed
    (solution,) = json.loads((tmp_path / "results.json").read_text())["Solution"][1:]
    assert solution["Variable"]["x[1]"]["Value"] == pytest.approx(2.5, abs=1e-9)


def test_pyomos_command_finds_the_solver_by_its_entry_point():
    """Pyomo imports the entry points of pyomo.command before it reads its arguments."""
    source = Path(__file__).parents[3] / "pyproject.toml"
    project = tomllib.loads(source.read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["pyomo.command"] == {"lcp_plugin": lcp_plugin.pyomo.__name__}


def test_another_solution_of_the_pairs_is_found_if_an_inequality_asks_for_it():
    """0 ≤ x ⟂ 1 − x ≥ 0 has the solutions 0 and 1, of which x ≥ 1/2 and x ≤ 1/2 leave one each."""
    for wanted in (1.0, 0.0):
        m = model(lambda m: pair(m, m.x >= 0, 1 - m.x >= 0))
        m.row = pe.Constraint(expr=(m.x >= 0.5) if wanted else (m.x <= 0.5))
        pe.assert_optimal_termination(SOLVER.solve(m))
        assert m.x.value == pytest.approx(wanted, abs=1e-8)


def test_a_variable_of_an_inequality_alone_gives_way_to_it():
    """The pairs hold for any z and t; values are found that satisfy the inequalities as well."""
    m = pe.ConcreteModel()
    m.x, m.z, m.t = pe.Var(initialize=7), pe.Var(), pe.Var(bounds=(None, 4), initialize=3)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.x >= 1))
    m.below, m.sum = pe.Constraint(expr=m.z >= 2), pe.Constraint(expr=m.x + m.t + m.z <= 5)
    pe.assert_optimal_termination(SOLVER.solve(m))
    np.testing.assert_allclose([m.x.value, max(m.z.value, 2.0)], [1.0, m.z.value], atol=1e-6)
    assert m.t.value + m.z.value <= 4.0 + 1e-6
    m.below.deactivate()
    m.above = pe.Constraint(expr=m.t >= m.x + 4)
    assert "above does not hold" in SOLVER.solve(m).solver.message
    m.above.set_value(m.t**2 + m.z**2 <= m.x)
    pe.assert_optimal_termination(SOLVER.solve(m))


def test_a_variable_with_equal_bounds_is_a_number():
    """A variable with equal bounds is a number in pairs; an equation for it is one too many."""
    m = pe.ConcreteModel()
    m.x, m.y = pe.Var(), pe.Var(bounds=(3, 3))
    m.pair = Complementarity(expr=complements(m.x >= 0, m.x - m.y >= 0))
    pe.assert_optimal_termination(SOLVER.solve(m))
    assert (m.x.value, m.y.value) == pytest.approx((3.0, 3.0))
    m.equation = pe.Constraint(expr=m.y == m.x)
    with pytest.raises(LCPError, match="1 equation and 0 unknowns without a complementarity"):
        SOLVER.solve(m)
