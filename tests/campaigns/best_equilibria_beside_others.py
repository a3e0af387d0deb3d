"""Random leaders and published models: ours beside Pyomo's product form by SCIP and big-M by HiGHS.

Run ``python tests/campaigns/best_equilibria_beside_others.py``; ``--quick`` runs a part. Sixty random leaders (bilevel
linear and convex, toll setting, Stackelberg, 10 to 100 pairs) and twenty published models of MacMPEC are Pyomo models,
so that all solvers read the same. Others are ``mpec.simple_nonlinear``, pairs as products, by SCIP, and
``mpec.simple_disjunction`` with ``gdp.bigm``, M = 10⁴, by HiGHS where everything is linear or the objective convex.
A value of ours, called optimal, that is worse than what SCIP proves of the products is wrong. Exit code 1 where one is.
Points of ours are measured on the model before they are called optimal; a search has 5 s.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections import defaultdict
from typing import Any

import numpy as np
import pyomo.environ as pe
import scipy.sparse as sp
from macmpec import COLLECTION
from pyomo.mpec import Complementarity, complements

import lcp_plugin.pyomo  # noqa: F401 - registers the solver
from lcp_plugin.modeling.best_equilibrium import stated_program

SECONDS = 5.0
ROOM = 1e-5  # of max(1, |value|): values that agree, and what a pair may miss
BIG = 1e4
PUBLISHED = (
    "bard1", "bard2", "gauvin", "ex9_1_1", "ex9_1_2", "ex9_1_4", "ex9_1_6", "ex9_1_9", "ex9_2_1", "ex9_2_2", "ex9_2_4",
    "ex9_2_6", "ex9_2_9", "flp2", "nash1", "jr1", "kth3", "scholtes5", "sl1", "qpec1",
)


# --- Random leaders ---


def leader(kind: str, pairs: int, seed: int) -> pe.ConcreteModel:
    """Return a random leader with so many pairs."""
    rng = np.random.default_rng([59, seed, pairs])
    return {"linear": bilevel, "convex": bilevel, "tolls": tolls, "stackelberg": stackelberg}[kind](rng, kind, pairs)


def bilevel(rng: Any, kind: str, pairs: int) -> pe.ConcreteModel:
    """A leader in a box whose followers solve 0 ≤ y ⟂ M y + N x + q ≥ 0, M definite."""
    m, k, leaders = pe.ConcreteModel(), pairs, max(2, pairs // 10)
    square = rng.standard_normal((k, k)) * (rng.random((k, k)) < min(1.0, 6.0 / k))
    M, N, q = square @ square.T + np.eye(k), rng.standard_normal((k, leaders)), rng.standard_normal(k)
    m.x, m.y = pe.Var(range(leaders), bounds=(-1, 1)), pe.Var(range(k), within=pe.NonNegativeReals)
    w = [sum(M[i, j] * m.y[j] for j in range(k) if M[i, j]) + sum(N[i, j] * m.x[j] for j in range(leaders)) + q[i]
         for i in range(k)]
    m.pair = Complementarity(range(k), rule=lambda m, i: complements(m.y[i] >= 0, w[i] >= 0))
    c, goal = rng.standard_normal(leaders + k), 0.0
    goal = sum(c[j] * m.x[j] for j in range(leaders)) + sum(c[leaders + i] * m.y[i] for i in range(k))
    if kind == "convex":
        goal += sum(m.x[j] ** 2 for j in range(leaders)) + sum((m.y[i] - 0.5) ** 2 for i in range(k))
    m.goal = pe.Objective(expr=goal)
    return m


def tolls(rng: Any, kind: str, pairs: int) -> pe.ConcreteModel:
    """Tolls on some of parallel roads with rising travel times: the operator's income, toll × flow."""
    m, k = pe.ConcreteModel(), pairs
    roads, groups = 5, max(1, k // 5)
    k = roads * groups
    a, b, demand = rng.uniform(1, 3, k), rng.uniform(0.2, 1, k), rng.uniform(4, 8, groups)
    tolled = [i for i in range(k) if i % roads == 0]
    m.toll, m.flow = pe.Var(tolled, bounds=(0, 10)), pe.Var(range(k), within=pe.NonNegativeReals)
    m.time = pe.Var(range(groups))
    m.meets = pe.Constraint(range(groups), rule=lambda m, g: sum(
        m.flow[i] for i in range(g * roads, (g + 1) * roads)) == demand[g])
    cost = [a[i] + b[i] * m.flow[i] + (m.toll[i] if i in tolled else 0) - m.time[i // roads] for i in range(k)]
    m.pair = Complementarity(range(k), rule=lambda m, i: complements(m.flow[i] >= 0, cost[i] >= 0))
    m.goal = pe.Objective(expr=sum(m.toll[i] * m.flow[i] for i in tolled), sense=pe.maximize)
    return m


def stackelberg(rng: Any, kind: str, pairs: int) -> pe.ConcreteModel:
    """A leader's output in each market before followers with capacities: price × quantity."""
    m, markets = pe.ConcreteModel(), max(1, pairs // 10)
    firms = 5
    m.lead, m.y = pe.Var(range(markets), bounds=(0, 40)), pe.Var(range(markets), range(firms), bounds=(0, None))
    m.cap = pe.Var(range(markets), range(firms), bounds=(0, None))
    cost, limit, start = rng.uniform(1, 6, (markets, firms)), rng.uniform(2, 6, (markets, firms)), rng.uniform(20, 40)
    price = [start - m.lead[g] - sum(m.y[g, f] for f in range(firms)) for g in range(markets)]
    both = list(itertools.product(range(markets), range(firms)))
    m.best = Complementarity(both, rule=lambda m, g, f: complements(
        m.y[g, f] >= 0, cost[g, f] + m.cap[g, f] - price[g] + m.y[g, f] >= 0))
    m.room = Complementarity(both, rule=lambda m, g, f: complements(m.cap[g, f] >= 0, limit[g, f] - m.y[g, f] >= 0))
    m.goal = pe.Objective(expr=sum((price[g] - 2.0) * m.lead[g] for g in range(markets)), sense=pe.maximize)
    return m


# --- Published models ---


def of_collection(name: str) -> pe.ConcreteModel:
    """Return a published model as Pyomo's, variables and rows as they are compiled."""
    stated = stated_program(COLLECTION[name].state()).program
    program, m = stated.program, pe.ConcreteModel()
    ends = [[None if np.isinf(end) else float(end) for end in side] for side in (program.lower, program.upper)]
    m.x = pe.Var(range(program.n), bounds=lambda m, j: (ends[0][j], ends[1][j]))

    def row(matrix: Any, k: int) -> Any:
        start, stop = matrix.indptr[k : k + 2]
        return sum(a * m.x[j] for j, a in zip(matrix.indices[start:stop].tolist(), matrix.data[start:stop].tolist(),
                                              strict=True))

    G, A, P = (sp.csr_array(one) for one in (program.G, program.A, program.P))
    m.rows = pe.ConstraintList()
    for k in range(program.h.size):
        m.rows.add(row(G, k) <= float(program.h[k]))
    for k in range(program.b.size):
        m.rows.add(row(A, k) == float(program.b[k]))
    lower, upper = stated.lower, stated.upper
    if np.isfinite(upper).any():
        raise ValueError(f"{name} has boxes, which the rivals' forms do not take")
    z, w = stated.first.tolist(), stated.second.tolist()
    m.pair = Complementarity(
        range(len(z)), rule=lambda m, i: complements(m.x[z[i]] - float(lower[i]) >= 0, m.x[w[i]] >= 0)
    )
    linear = sum(float(a) * m.x[j] for j, a in enumerate(program.c) if a)
    m.goal = pe.Objective(expr=linear + sum(0.5 * m.x[k] * row(P, k) for k in range(program.n) if P[[k]].nnz)
                          + stated.offset)
    return m


# --- The solvers ---


def ours(model: Any) -> tuple[bool, float, float, str]:
    solver = pe.SolverFactory("lcp_plugin")
    results = solver.solve(model, options={"max_seconds": SECONDS})
    done = results.solver.termination_condition == pe.TerminationCondition.optimal
    bound = solver.result.lower_bound * (1.0 if model.goal.sense == pe.minimize else -1.0)
    value = np.nan if solver.result.x is None else pe.value(model.goal)
    return done, value, bound, str(solver.result.bound_by)


def of_products(model: Any) -> tuple[bool, float, float, str]:
    """SCIP's own reading of an .nl file in which pairs are products."""
    import tempfile
    from pathlib import Path

    import pyscipopt

    pe.TransformationFactory("mpec.simple_nonlinear").apply_to(model)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "m.nl")
        model.write(str(path), io_options={"symbolic_solver_labels": True})
        scip = pyscipopt.Model()
        scip.hideOutput()
        scip.readProblem(str(path))
        scip.setParams({"limits/time": SECONDS, "limits/gap": 1e-6})
        scip.optimize()
        value = scip.getObjVal() if scip.getNSols() else np.nan
        return scip.getStatus() in ("optimal", "gaplimit"), value, scip.getDualbound(), "SCIP"


def big_m(model: Any) -> tuple[bool, float, float, str]:
    pe.TransformationFactory("mpec.simple_disjunction").apply_to(model)
    pe.TransformationFactory("gdp.bigm").apply_to(model, bigM=BIG)
    solver = pe.SolverFactory("appsi_highs")
    results = solver.solve(model, options={"time_limit": SECONDS}, load_solutions=False)
    if results.solver.termination_condition != pe.TerminationCondition.optimal:
        return False, np.nan, np.nan, ""
    model.solutions.load_from(results)
    return True, pe.value(model.goal), pe.value(model.goal), "HiGHS"


SOLVERS = {"ours": ours, "products, SCIP": of_products, "big-M, HiGHS": big_m}


def main() -> int:
    """Run the campaign, print a line a model and the sums, return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    models: dict[str, Any] = {name: lambda name=name: of_collection(name) for name in PUBLISHED}
    kinds = ("linear", "convex", "tolls", "stackelberg")
    sizes = (10, 20, 30) if quick else (10, 20, 30, 50, 100)
    for kind, pairs, seed in itertools.product(kinds, sizes, range(1 if quick else 3)):
        models[f"{kind} {pairs} {seed}"] = lambda kind=kind, pairs=pairs, seed=seed: leader(kind, pairs, seed)
    solved, seconds, wrong = defaultdict(int), defaultdict(float), 0
    for name, make in models.items():
        found = {}
        for solver, run in SOLVERS.items():
            model, begin = make(), time.perf_counter()
            try:
                found[solver] = run(model)
            except Exception as error:  # a rival's refusal
                found[solver] = False, np.nan, np.nan, type(error).__name__
            seconds[solver] += time.perf_counter() - begin
            solved[solver] += found[solver][0]
        sense = 1.0 if make().goal.sense == pe.minimize else -1.0
        done, value = found["ours"][:2]
        room = ROOM * max(1.0, abs(value))
        rival_done, rival = found["products, SCIP"][:2]
        is_wrong = done and rival_done and sense * (value - rival) > room
        wrong += is_wrong
        print(f"{name:18}", *(f"{one[1]:14.7g}{'' if one[0] else ' open'} {one[3]:10}" for one in found.values()),
              "WRONG" if is_wrong else "", flush=True)
    for solver in SOLVERS:
        print(f"{solver:15} {solved[solver]} of {len(models)} solved, {seconds[solver]:.1f} s")
    print(f"{wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
