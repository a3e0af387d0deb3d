"""Published complementarity models written in Pyomo, each with its published answer.

Data are those of the sources named in each docstring; nothing of this package stands in a Pyomo model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyomo.environ as pe
import scipy.sparse as sp
from inputs.nonlinear_models import NASH_5_SOLUTION
from pyomo.mpec import Complementarity, ComplementarityList, complements


@dataclass
class Published:
    """A model, its variables, and what was published."""

    model: Any
    variables: Sequence[Any]
    answers: Sequence[Any] = field(default=())  # of the leading variables; any of them will do
    digits: float = 1e-4


MODELS: dict[str, Callable[[], Published]] = {}


def published(build: Callable[[], Published]) -> Callable[[], Published]:
    MODELS[build.__name__] = build
    return build


def each(*containers: Any) -> list[Any]:
    return [variable for container in containers for variable in container.values()]


def affine(M: Any, q: Any, x: Any) -> list[Any]:
    """The rows of M x + q as Pyomo's expressions."""
    M = sp.csr_array(M)
    return [
        sum(float(M.data[k]) * x[int(M.indices[k])] for k in range(M.indptr[i], M.indptr[i + 1]))
        + float(q[i])
        for i in range(M.shape[0])
    ]


@published
def munson1a() -> Published:
    """Pyomo's examples/mpec/munson1a.py, after T. Munson's model for AMPL."""
    m = pe.ConcreteModel()
    m.x1, m.x2, m.x3 = pe.Var(), pe.Var(), pe.Var()
    m.f1 = Complementarity(expr=complements(m.x1 >= 0, m.x1 + 2 * m.x2 + 3 * m.x3 >= 1))
    m.f2 = Complementarity(expr=complements(m.x2 >= 0, m.x2 - m.x3 >= -1))
    m.f3 = Complementarity(expr=complements(m.x3 >= 0, m.x1 + m.x2 >= -1))
    return of_munson(m, 1)


@published
def munson1c() -> Published:
    """Pyomo's examples/mpec/munson1c.py: the expressions negated."""
    m = pe.ConcreteModel()
    m.x1, m.x2, m.x3 = pe.Var(), pe.Var(), pe.Var()
    m.f1 = Complementarity(expr=complements(m.x1 >= 0, -m.x1 - 2 * m.x2 - 3 * m.x3 <= -1))
    m.f2 = Complementarity(expr=complements(m.x2 >= 0, -m.x2 + m.x3 <= 1))
    m.f3 = Complementarity(expr=complements(m.x3 >= 0, -m.x1 - m.x2 <= 1))
    return of_munson(m, 1)


def of_munson(m: Any, sign: float) -> Published:
    return Published(m, [m.x1, m.x2, m.x3], answers=[[sign, 0.0, 0.0]], digits=1e-9)


def oligopoly(
    cost: list[float], scale: float, beta: list[float], gamma: float, *answers: list[float]
) -> Published:
    firms = range(len(cost))
    m = pe.ConcreteModel()
    m.q = pe.Var(firms, within=pe.NonNegativeReals, initialize=1.0)
    m.total = pe.Expression(expr=sum(m.q[i] for i in firms))
    m.price = pe.Expression(expr=(5000.0 / m.total) ** (1.0 / gamma))
    m.cost = pe.Block(firms)
    for i in firms:
        m.cost[i].marginal = pe.Expression(expr=cost[i] + (m.q[i] / scale) ** (1.0 / beta[i]))
    m.best = Complementarity(
        firms,
        rule=lambda m, i: complements(
            m.q[i] >= 0, m.cost[i].marginal - m.price + m.q[i] * m.price / (gamma * m.total) >= 0
        ),
    )
    return Published(m, each(m.q), answers)


@published
def oligomcp() -> Published:
    """F. H. Murphy, H. D. Sherali, A. L. Soyster, Math. Programming 24 (1982) 92–106: five firms."""
    return oligopoly([10, 8, 6, 4, 2], 5.0, [1.2, 1.1, 1.0, 0.9, 0.8], 1.1, NASH_5_SOLUTION)


@published
def cournot_with_a_capacity() -> Published:
    """Murphy, Sherali and Soyster's five firms, the largest held to 30: the others' first-order conditions hold."""
    case = oligopoly([10, 8, 6, 4, 2], 5.0, [1.2, 1.1, 1.0, 0.9, 0.8], 1.1)
    m = case.model
    m.best[2].deactivate()
    m.limit = pe.Param(initialize=30.0, mutable=True)
    m.held = Complementarity(
        expr=complements(pe.inequality(0, m.q[2], m.limit), m.best[2]._args[1].args[1])
    )
    return Published(m, case.variables)


def by_rows(
    rows: Callable[[Any, Any], list[Any]],
    n: int,
    lower: Any = 0.0,
    upper: Any = np.inf,
    start: Any = 0.0,
    **given: Any,
) -> Published:
    """A problem by one formula a row."""
    lower, upper, start = (
        np.broadcast_to(np.asarray(value, dtype=float), n) for value in (lower, upper, start)
    )
    m = pe.ConcreteModel()
    m.x = pe.Var(range(n), initialize=lambda m, i: start[i])
    written = rows(m.x, pe)
    m.pairs, m.equations = ComplementarityList(), pe.ConstraintList()
    for i in range(n):
        if np.isfinite(lower[i]) and np.isfinite(upper[i]):
            m.pairs.add(complements(written[i], pe.inequality(lower[i], m.x[i], upper[i])))
        elif np.isfinite(lower[i]):
            m.pairs.add(complements(written[i] >= 0, m.x[i] >= lower[i]))
        elif np.isfinite(upper[i]):
            m.pairs.add(complements(written[i] <= 0, m.x[i] <= upper[i]))
        else:
            m.equations.add(written[i] == 0)
    return Published(m, each(m.x), **given)


@published
def hock_schittkowski_71() -> Published:
    """M. C. Bartholomew-Biggs (1976); Hock and Schittkowski's 71: its equation has a free multiplier, x two bounds."""

    def rows(x: Any, _: Any) -> list[Any]:
        y, z = x[4], x[5]  # of the product and of the sphere
        total = x[0] + x[1] + x[2]
        product = [x[1] * x[2] * x[3], x[0] * x[2] * x[3], x[0] * x[1] * x[3], x[0] * x[1] * x[2]]
        slopes = [x[3] * (total + x[0]), x[0] * x[3], x[0] * x[3] + 1, x[0] * total]
        return [
            *(slopes[j] - y * product[j] - 2 * z * x[j] for j in range(4)),
            x[0] * product[0] - 25,
            x[0] ** 2 + x[1] ** 2 + x[2] ** 2 + x[3] ** 2 - 40,
        ]

    lower, upper = [1, 1, 1, 1, 0, -np.inf], [5, 5, 5, 5, np.inf, np.inf]
    answer = [1, 4.7429994, 3.8211503, 1.3794082]
    return by_rows(rows, 6, lower, upper, [1, 5, 5, 1, 0.5, -0.1], answers=[answer], digits=1e-6)


@published
def river_basin() -> Published:
    """J. B. Krawczyk, S. Uryasev, Environ. Model. Assess. 5 (2000) 63–73: three polluters of a river."""
    cost, slope, emission = (0.10, 0.12, 0.15), (0.01, 0.05, 0.01), (0.50, 0.25, 0.75)
    decay = ((6.5, 5.0, 5.5), (4.583, 6.25, 3.75))

    def rows(x: Any, _: Any) -> list[Any]:
        total = x[0] + x[1] + x[2]
        best = [
            cost[j]
            + 2 * slope[j] * x[j]
            - 3.0
            + 0.01 * (total + x[j])
            + sum(x[3 + k] * decay[k][j] * emission[j] for k in range(2))
            for j in range(3)
        ]
        return best + [
            100 - sum(decay[k][j] * emission[j] * x[j] for j in range(3)) for k in range(2)
        ]

    return by_rows(rows, 5, start=1.0, answers=[[21.145, 16.028, 2.726]], digits=1e-3)


@published
def braess() -> Published:
    """D. Braess, Unternehmensforschung 12 (1968) 258–268: with the fourth road everybody needs 92 instead of 83."""
    m = pe.ConcreteModel()
    m.road = pe.Set(initialize=["ac", "ab", "cd", "bd", "bc"])
    m.path = pe.Set(initialize=["ab bd", "ac cd", "ab bc cd"])
    m.flow, m.use, m.time = pe.Var(m.path, initialize=1.0), pe.Var(m.road), pe.Var(initialize=50.0)
    m.sum = pe.Constraint(
        m.road, rule=lambda m, r: m.use[r] == sum(m.flow[p] for p in m.path if r in p.split())
    )
    fixed = {"ab": 0, "cd": 0, "ac": 50, "bd": 50, "bc": 10}
    rise = {"ab": 10, "cd": 10, "ac": 1, "bd": 1, "bc": 1}
    m.wardrop = Complementarity(
        m.path,
        rule=lambda m, p: complements(
            sum(fixed[r] + rise[r] * m.use[r] for r in p.split()) >= m.time, m.flow[p] >= 0
        ),
    )
    m.demand = pe.Constraint(expr=sum(m.flow[p] for p in m.path) == 6)
    return Published(m, [*each(m.flow), m.time], answers=[[2, 2, 2, 92]], digits=1e-8)


@published
def signorini() -> Published:
    """A. Signorini (1933), a loaded rod before a wall: u = 0.8 x − x²/2, and the wall presses by 0.2."""
    n = 20
    M = n * sp.diags_array(
        [-np.ones(n - 1), np.append(2 * np.ones(n - 1), 1), -np.ones(n - 1)], offsets=[-1, 0, 1]
    )
    q = -np.append(np.ones(n - 1), 0.5) / n
    x = np.arange(1, n + 1) / n
    m = pe.ConcreteModel()
    m.u = pe.Var(range(n))
    rows = affine(M, q, m.u)
    m.inside = pe.Constraint(range(n - 1), rule=lambda m, i: rows[i] == 0)
    m.wall = Complementarity(expr=complements(m.u[n - 1] <= 0.3, -rows[n - 1] >= 0))
    return Published(m, each(m.u), answers=[0.8 * x - x**2 / 2], digits=1e-9)
