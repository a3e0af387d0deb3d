"""Failures of SCIP in each interface: messages, and the effect of their advice."""

from __future__ import annotations

import gc
import os
import signal
import sys
import weakref
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import pyomo.environ as pe
import pytest
from pyomo.mpec import Complementarity
from pyomo.mpec import complements as complementary
from tools.nl_files import read_sol

import lcp_plugin.pyomo
from lcp_plugin import (
    EquilibriumProgram,
    InvalidOption,
    InvalidProblem,
    LCPError,
    QuadraticProgram,
    Status,
    UnsupportedModel,
    complements,
    solve,
)
from lcp_plugin.commands import ampl
from lcp_plugin.problems.equilibria import scip
from lcp_plugin.problems.equilibria.equilibrium_program import SmoothPart

FOUND_NONE = "SCIP, in floating point, reports infeasible, which could not be confirmed"


# --- Models: a toll on the first of two roads, 10 cars, costs 1 + f₀ + t and 5 + ½ f₁; 13.5 at t = 4.5, f₀ = 3 ---


class Toll:
    """The same model in cvxpy, with names."""

    def __init__(self, *, most: float | None = None) -> None:
        self.toll, self.flow = (
            cp.Variable(nonneg=True, name="toll"),
            cp.Variable(2, nonneg=True, name="flow"),
        )
        least = cp.Variable(name="least")
        costs = cp.hstack([1.0 + self.flow[0] + self.toll, 5.0 + 0.5 * self.flow[1]])
        self.rows = [complements(self.flow >= 0, costs - least >= 0), cp.sum(self.flow) == 10]
        self.rows += [] if most is None else [self.toll <= most, self.flow <= most]

    def solved(self, objective: Any = None, *more: Any, **options: Any) -> tuple[cp.Problem, Any]:
        """The problem and our result, of the largest income unless another objective is given."""
        income = self.toll * self.flow[0] if objective is None else objective
        problem = cp.Problem(cp.Maximize(income), [*self.rows, *more])
        problem.solve(method="LCP", **options)
        return problem, problem.solver_stats.extra_stats


def toll_in_pyomo() -> pe.ConcreteModel:
    """Return the toll problem in Pyomo."""
    m = pe.ConcreteModel()
    m.toll, m.least = pe.Var(within=pe.NonNegativeReals), pe.Var()
    m.flow = pe.Var([0, 1], within=pe.NonNegativeReals)
    m.income = pe.Objective(expr=m.toll * m.flow[0], sense=pe.maximize)
    m.cars = pe.Constraint(expr=m.flow[0] + m.flow[1] == 10)
    costs = {0: 1.0 + m.flow[0] + m.toll, 1: 5.0 + 0.5 * m.flow[1]}
    m.pair = Complementarity(
        [0, 1], rule=lambda m, i: complementary(m.flow[i] >= 0, costs[i] - m.least >= 0)
    )
    return m


def answered_by_ampl(m: pe.ConcreteModel, folder: Path, *words: str) -> Any:
    """Return the .sol of the executable."""
    lcp_plugin.pyomo.write_nl(m, folder / "m.nl")
    assert ampl.main([str(folder / "m"), "-AMPL", *words]) == 0
    return read_sol(folder / "m.sol")


def knapsack(seed: int = 0, n: int = 50) -> EquilibriumProgram:
    """Return a problem of many thousand nodes: 0 ≤ x ⟂ y ≥ 0, x + y = 1, four rows that weigh x."""
    weights = np.random.default_rng(seed).integers(1, 1000, (4, n)).astype(float)
    program = QuadraticProgram(
        None,
        np.append(-weights.sum(axis=0), np.zeros(n)),
        np.hstack([weights, np.zeros((4, n))]),
        weights.sum(axis=1) // 2,
        np.hstack([np.eye(n)] * 2),
        np.ones(n),
        lower=0,
    )
    return EquilibriumProgram(program, np.arange(n), np.arange(n, 2 * n))


def bilinear(**more: Any) -> EquilibriumProgram:
    """Return x₀ x₁ to be made small, x₀ + x₁ = 3, both at most 2, 0 ≤ x₀ ⟂ x₂ ≥ 0: 2, which SCIP finds alone."""
    P = np.zeros((3, 3))
    P[0, 1] = P[1, 0] = 1.0
    program = QuadraticProgram(P, np.zeros(3), A=[[1, 1, 0]], b=[3], lower=0, upper=2, **more)
    return EquilibriumProgram(program, [0], [2])


def test_more_nodes_than_scip_can_count_are_no_limit():
    """The bound is that of a run without a limit."""
    assert solve(bilinear(), max_nodes=10**30).value == pytest.approx(2.0)


FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "log1p": (np.log1p, 0.3), "log10": (np.log10, 0.3), "power 1.5": (lambda x: x**1.5, 0.3),
    "tan": (np.tan, 0.3), "sinh": (np.sinh, 0.3), "cosh": (np.cosh, 0.3), "tanh": (np.tanh, 0.3),
    "asinh": (np.arcsinh, 0.3), "acosh": (np.arccosh, 1.7), "atanh": (np.arctanh, 0.3),
    "quotient": (np.divide, 0.3, 1.7), "power of": (np.power, 0.3, 1.7), "log add exp": (np.logaddexp, 0.3, 1.7),
    "relative entropy": (lambda x, y: x * np.log(x / y), 0.3, 1.7),
}  # fmt: skip


def test_functions_that_scip_lacks_have_the_values_of_numpy():
    """They are written by exp, log, sqrt, sin and cos; numpy takes the place of SCIP."""
    model = SimpleNamespace(scip=np)
    for name, (function, *at) in FUNCTIONS.items():
        assert scip._Model._applied(model, name, *at) == pytest.approx(function(*at)), name


# --- No SCIP, and a SCIP that fails ---


@pytest.fixture(params=["absent", pytest.param("broken", marks=pytest.mark.full)])
def without_scip(request, monkeypatch):
    """Let pyscipopt be not installed, or not load."""
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    if request.param == "broken":
        monkeypatch.delitem(sys.modules, "pyscipopt")
        monkeypatch.setattr(sys, "meta_path", [_Broken(), *sys.meta_path])


class _Broken:
    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        if name == "pyscipopt":
            raise ImportError("libscip.so.10: cannot open shared object file")


@pytest.mark.full
def test_without_scip_every_way_in_tells_the_extra(without_scip, tmp_path):
    """Without SCIP a nonconvex leader gets no point, no bound, and advice in every interface."""
    solver = pe.SolverFactory("lcp_plugin")
    solver.solve(toll_in_pyomo())
    for result in (solve(bilinear()), Toll(most=20.0).solved()[1], solver.result):
        assert (result.status, result.bound_by, result.proof) == (Status.STALLED, None, None)
        assert result.x is None
        assert "pip install pyscipopt (or lcp_plugin[global])" in result.advice
        assert "derivative(problem)" in result.advice
    found = answered_by_ampl(toll_in_pyomo(), tmp_path)
    assert found.code == 500
    assert "pip install pyscipopt (or lcp_plugin[global])" in found.message


# --- Limits and Ctrl-C ---


@pytest.mark.full
def test_half_a_second_keeps_the_best_point():
    """The status is MAX_SECONDS, x an equilibrium, and no bound is above its value."""
    result = solve(knapsack(), max_seconds=0.5)
    assert result.status is Status.MAX_SECONDS
    assert result.x is not None
    assert result.problem.excess(result.x) <= 1e-7
    assert result.lower_bound <= result.value
    assert "next: raise max_seconds" in result.explain()


@pytest.mark.full
def test_ctrl_c_inside_scip_keeps_the_best_point_and_frees_it(monkeypatch):
    """INTERRUPTED with an equilibrium, no traceback; the handler is Python's again, SCIP's model is gone."""
    models, before = [], signal.getsignal(signal.SIGINT)

    class Watched(scip._Model):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            models.append(weakref.ref(self.model))

    def interrupt(search):
        if search.nodes == 20:  # some are our own
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(scip, "_Model", Watched)
    result = solve(knapsack(), callback=interrupt)
    assert (result.status, result.x is None) == (Status.INTERRUPTED, False)
    assert result.problem.excess(result.x) <= 1e-7
    assert result.lower_bound <= result.value
    assert "stopped by Ctrl-C" in result.explain()
    assert signal.getsignal(signal.SIGINT) is before
    gc.collect()
    assert models
    assert [model() for model in models] == [None] * len(models)
    assert solve(bilinear()).value == pytest.approx(2.0)


def test_what_a_callback_raises_inside_scip_reaches_the_caller():
    """SCIP, written in C, swallows it; the run around it does not."""

    def fails(search):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        solve(knapsack(), callback=fails)


# --- Infeasible, unbounded and invalid problems ---


def test_what_scip_finds_infeasible_is_no_proof(tmp_path):
    """Infeasible integers with pairs are reported by all interfaces, with the matching advice."""
    toll, half = Toll(), cp.Variable(integer=True)
    for more in (
        [2 * half == toll.toll, half >= 0.2, half <= 0.8],
        [toll.toll * toll.flow[0] >= 1000],
    ):
        problem, result = toll.solved(None, *more)
        assert (problem.status, result.status, result.proof) == (
            cp.settings.USER_LIMIT,
            Status.STALLED,
            None,
        )
        assert FOUND_NONE in result.advice
        assert "upper bound" not in result.advice
    m = toll_in_pyomo()
    m.half = pe.Var(within=pe.Integers, bounds=(0, 5))
    m.even = pe.Constraint(expr=2 * m.half == m.toll)
    m.between = pe.Constraint(expr=(0.2, m.half, 0.8))
    found = answered_by_ampl(m, tmp_path)
    assert (found.code, found.values) == (500, None)
    assert FOUND_NONE in found.message


@pytest.mark.full
def test_what_falls_for_ever_is_told_and_that_bounds_help(tmp_path):
    """Unbounded products and exponentials keep a finite point; an upper bound makes it optimal."""
    toll = Toll()
    problem, result = toll.solved(cp.square(toll.toll))
    assert (problem.status, result.status, result.bound_by) == (
        cp.settings.USER_LIMIT,
        Status.STALLED,
        None,
    )
    assert "reports unbounded, which could not be confirmed" in result.advice
    assert "bound the variables" in result.advice
    assert np.isfinite(result.x).all()
    bounded = Toll(most=20.0)
    problem, result = bounded.solved(cp.square(bounded.toll))
    assert (problem.status, problem.value) == (cp.OPTIMAL, pytest.approx(400.0))
    x, y = cp.Variable(name="x"), cp.Variable(integer=True)
    whole = cp.Problem(cp.Maximize(y), [complements(x >= 0, y - x >= 0)])
    whole.solve(method="LCP")
    assert "reports unbounded" in whole.solver_stats.extra_stats.advice
    assert np.isfinite(float(y.value))
    m = toll_in_pyomo()
    m.income.set_value(m.toll**2)
    found = answered_by_ampl(m, tmp_path)
    assert found.code == 500
    assert "bound the variables" in found.message


def test_nan_is_refused_in_words_by_every_way_in(tmp_path):
    """NaN in rows, objectives, pairs or starts raises errors in arrays, cvxpy and Pyomo."""
    nan = float("nan")
    with pytest.raises(InvalidProblem, match=r"finite|NaN|nan"):
        EquilibriumProgram.of_rows(QuadraticProgram(None, [1.0]), [0], [[nan]], [0.0])
    with pytest.raises(InvalidOption, match="x0"):
        solve(bilinear(), x0=[nan, 0, 0])
    toll = Toll()
    with pytest.raises(LCPError, match="must be finite"):
        toll.solved(nan * toll.toll * toll.flow[0])
    m = toll_in_pyomo()
    m.p = pe.Param(initialize=nan, mutable=True, within=pe.Any)
    m.r = pe.Constraint(expr=m.p * m.toll <= 1)
    with pytest.raises(InvalidProblem, match=r"must be finite.*'p'"):
        pe.SolverFactory("lcp_plugin").solve(m)


def test_functions_that_scip_does_not_know_have_names(tmp_path):
    """Pyomo and AMPL report atan in a row by name; a Python function has no terms."""
    m = toll_in_pyomo()
    m.row = pe.Constraint(expr=pe.atan(m.toll) <= 1)
    with pytest.raises(UnsupportedModel, match=r"SCIP knows no atan.*products, quotients"):
        pe.SolverFactory("lcp_plugin").solve(m)
    found = answered_by_ampl(m, tmp_path)
    assert (found.code, found.values) == (500, None)
    assert "SCIP knows no atan" in found.message

    class Map:
        def value(self, x):
            return np.array([x[0] ** 3])

        def jacobian(self, x):
            return np.array([[3 * x[0] ** 2, 0, 0]])

    problem = bilinear()
    smooth = EquilibriumProgram(
        problem.program, [0], [2], smooth=SmoothPart(Map(), np.zeros(0), np.zeros(0))
    )
    with pytest.raises(UnsupportedModel, match="a function of Python's has no terms"):
        solve(smooth)


def test_an_absolute_value_is_taken_from_cvxpy_and_refused_with_a_pair_elsewhere():
    """|t − 3| in an objective that is not convex; in a row of Pyomo the followed advice, t − 3 + 2 s, is solved."""
    toll = Toll()
    problem, _ = toll.solved(toll.toll * toll.flow[0] - 2 * cp.abs(toll.toll - 3))
    # f₀ = 6 − t/1.5 at an equilibrium with both roads used: t (6 − t/1.5) − 2 |t − 3| is largest at t = 3
    assert (problem.status, problem.value) == (cp.OPTIMAL, pytest.approx(12.0, abs=1e-5))
    m = toll_in_pyomo()
    m.row = pe.Constraint(expr=abs(m.toll - 3) <= 1)
    with pytest.raises(UnsupportedModel, match=r"row holds the operator abs.*x \+ 2 s"):
        pe.SolverFactory("lcp_plugin").solve(m)
    m.row.deactivate()
    m.s = pe.Var(within=pe.NonNegativeReals)
    m.size = Complementarity(expr=complementary(m.s >= 0, m.toll - 3 + m.s >= 0))
    m.within = pe.Constraint(expr=m.toll - 3 + 2 * m.s <= 1)
    pe.assert_optimal_termination(pe.SolverFactory("lcp_plugin").solve(m))
    assert pe.value(m.income) == pytest.approx(4 * (6 - 4 / 1.5), abs=1e-5)


# --- Whose bound it is, and how to ask for a proof ---


def test_a_proof_of_what_is_not_convex_is_refused_with_what_to_do():
    """A proof for a nonconvex cvxpy problem raises an error; otherwise the bound is SCIP's."""
    with pytest.raises(
        UnsupportedModel,
        match=r"an objective that is not convex; leave it out: the bound is SCIP's",
    ):
        Toll().solved(prove=True)
    _, result = Toll().solved()
    assert (result.status, result.bound_by, result.proof) == (Status.SOLVED, "SCIP", None)
    assert "bound by SCIP, in floating point" in result.explain()
    assert result.gap <= result.tolerance
    assert result.problem.excess(result.x) <= 1e-7
    assert not result.verify()


def test_a_point_does_not_hide_that_the_objective_falls_for_ever():
    """SCIP calls the bound of its first relaxation ∞ rather than −∞ there, and a point of value −13.5 optimal."""
    M, N = np.array([[6, 1, 1], [1, 3, -5], [1, -5, 18]]), np.array([[2, 0], [1, 2], [-2, 2]])
    lower, upper = [0, 0, -1, 0, -np.inf, 0, 0, 0], [np.inf, 3, *[np.inf] * 6]
    A, ray = np.hstack([-M, np.eye(3), -N]), np.array([0.0, 0, 10, 190, 40, 0, 90, 0])
    program = QuadraticProgram(
        None, [2, -2, 3, -3, 2, 1, 0, 0], A=A, b=[0, -1, 0], lower=lower, upper=upper
    )
    assert not (A @ ray).any()
    assert program.c @ ray < 0.0
    assert solve(EquilibriumProgram(program, [0, 1, 2], [3, 4, 5])).status is Status.UNBOUNDED


# --- Followers that are hard to solve do not delay the search ---


def hard_followers(seed: int, pairs: int = 42) -> EquilibriumProgram:
    """Return leaders x within [−1, 1]⁴ and followers z ⟂ M z + C x + q with a known solution."""
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((pairs, pairs))
    C = rng.standard_normal((pairs, 4))
    leaders = rng.uniform(-1.0, 1.0, 4)
    is_active = rng.random(pairs) < 0.5
    z, w = (rng.uniform(0.1, 2.0, pairs) * side for side in (~is_active, is_active))
    q, n = w - M @ z - C @ leaders, 4 + 2 * pairs
    program = QuadraticProgram(
        np.zeros((n, n)),
        np.concatenate([np.zeros(4), rng.uniform(0.0, 1.0, pairs), np.zeros(pairs)]),
        A=np.hstack([C, M, -np.eye(pairs)]),
        b=-q,
        lower=np.append(-np.ones(4), np.zeros(2 * pairs)),
        upper=np.append(np.ones(4), np.full(2 * pairs, np.inf)),
    )
    return EquilibriumProgram(program, 4 + np.arange(pairs), 4 + pairs + np.arange(pairs))


@pytest.mark.full
def test_followers_that_take_long_do_not_keep_scip_waiting():
    """A leader over 42 pairs, whose followers no method solves quickly: a point, and its proof, within the limit."""
    result = solve(hard_followers(0), max_seconds=20.0)
    assert result.status is Status.SOLVED
    assert result.value == pytest.approx(6.260972762935, rel=1e-6)


def test_a_coefficient_that_is_infinite_for_scip_is_a_failure_of_scip():
    """SCIP takes 1e20 as infinite; its error ends its search, and no exception reaches the caller."""
    program = QuadraticProgram(None, [1.0, 0.0], A=[[1e21, -1.0]], b=[1.0], lower=[0.0, -np.inf])
    found = scip.minimize(EquilibriumProgram(program, [0], [1]), tolerance=1e-6, max_nodes=100.0)
    assert found.status.startswith(scip.ERROR_WORD)
    assert found.x is None
