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
from economies import OWNED, WANTED, by_goods, technique
from nonlinear_models import NASH_5_SOLUTION, NASH_10_SOLUTION
from pyomo.mpec import Complementarity, ComplementarityList, complements


@dataclass
class Published:
    """A model, its variables, and what was published."""

    model: Any
    variables: Sequence[Any]
    answers: Sequence[Any] = field(default=())  # of the leading variables; any of them will do
    digits: float = 1e-4
    first: int = 0  # where the answers begin among the variables


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


def linear(M: Any, q: Any, lower: Any = 0.0, upper: Any = np.inf, **given: Any) -> Published:
    """A linear complementarity problem, every pair as what its bounds ask for."""
    n = len(q)
    lower, upper = np.broadcast_to(lower, n), np.broadcast_to(upper, n)
    m = pe.ConcreteModel()
    m.x = pe.Var(range(n))
    rows = affine(M, q, m.x)

    def pair(m: Any, i: int) -> Any:
        if np.isfinite(lower[i]) and np.isfinite(upper[i]):
            return complements(pe.inequality(lower[i], m.x[i], upper[i]), rows[i])
        if np.isfinite(upper[i]):
            return complements(m.x[i] <= upper[i], rows[i] <= 0)
        return complements(m.x[i] >= lower[i], rows[i] >= 0)

    m.pairs = Complementarity(range(n), rule=pair)
    return Published(m, each(m.x), **given)


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
def munson1b() -> Published:
    """Pyomo's examples/mpec/munson1b.py: the variables negated."""
    m = pe.ConcreteModel()
    m.x1, m.x2, m.x3 = pe.Var(), pe.Var(), pe.Var()
    m.f1 = Complementarity(expr=complements(m.x1 <= 0, -m.x1 - 2 * m.x2 - 3 * m.x3 >= 1))
    m.f2 = Complementarity(expr=complements(m.x2 <= 0, -m.x2 + m.x3 >= -1))
    m.f3 = Complementarity(expr=complements(m.x3 <= 0, -m.x1 - m.x2 >= -1))
    return of_munson(m, -1)


@published
def munson1c() -> Published:
    """Pyomo's examples/mpec/munson1c.py: the expressions negated."""
    m = pe.ConcreteModel()
    m.x1, m.x2, m.x3 = pe.Var(), pe.Var(), pe.Var()
    m.f1 = Complementarity(expr=complements(m.x1 >= 0, -m.x1 - 2 * m.x2 - 3 * m.x3 <= -1))
    m.f2 = Complementarity(expr=complements(m.x2 >= 0, -m.x2 + m.x3 <= 1))
    m.f3 = Complementarity(expr=complements(m.x3 >= 0, -m.x1 - m.x2 <= 1))
    return of_munson(m, 1)


@published
def munson1d() -> Published:
    """Pyomo's examples/mpec/munson1d.py: both negated."""
    m = pe.ConcreteModel()
    m.x1, m.x2, m.x3 = pe.Var(), pe.Var(), pe.Var()
    m.f1 = Complementarity(expr=complements(m.x1 <= 0, m.x1 + 2 * m.x2 + 3 * m.x3 <= -1))
    m.f2 = Complementarity(expr=complements(m.x2 <= 0, m.x2 - m.x3 <= 1))
    m.f3 = Complementarity(expr=complements(m.x3 <= 0, m.x1 + m.x2 <= 1))
    return of_munson(m, -1)


def of_munson(m: Any, sign: float) -> Published:
    return Published(m, [m.x1, m.x2, m.x3], answers=[[sign, 0.0, 0.0]], digits=1e-9)


def polynomial(name: str) -> Any:
    """The figures of Josephy's problem and of Kojima and Shindo's, which differ in three."""
    third, ninth, last = (3, 3, -1) if name == "josephy" else (10, 9, -9)
    m = pe.ConcreteModel()
    m.x = pe.Var(pe.RangeSet(4), within=pe.NonNegativeReals, initialize=1.0)
    x = m.x
    m.square = pe.Expression([1, 2], rule=lambda m, j: m.x[j] ** 2)  # written as defined variables
    s = m.square
    rows = {
        1: 3 * s[1] + 2 * x[1] * x[2] + 2 * s[2] + x[3] + 3 * x[4] - 6,
        2: 2 * s[1] + x[1] + s[2] + third * x[3] + 2 * x[4] - 2,
        3: 3 * s[1] + x[1] * x[2] + 2 * s[2] + 2 * x[3] + ninth * x[4] + last,
        4: s[1] + 3 * s[2] + 2 * x[3] + 3 * x[4] - 3,
    }
    m.f = Complementarity(pe.RangeSet(4), rule=lambda m, j: complements(m.x[j] >= 0, rows[j] >= 0))
    return m


@published
def kojshin() -> Published:
    """M. Kojima, S. Shindo, J. Oper. Res. Soc. Japan 29 (1986) 352–374; Pyomo's model library, mcplib."""
    m = polynomial("kojshin")
    answers = [[np.sqrt(1.5), 0, 0, 0.5], [1, 0, 3, 0]]
    return Published(m, each(m.x), answers, 1e-7)


@published
def josephys() -> Published:
    """N. H. Josephy, MRC report 1965, Wisconsin 1979; Pyomo's model library, mcplib."""
    m = polynomial("josephy")
    return Published(m, each(m.x), [[np.sqrt(1.5), 0, 0, 0.5]], 1e-7)


@published
def billups_thesis() -> Published:
    """S. C. Billups, PhD thesis, Wisconsin 1995; Pyomo's model library, mcplib."""
    m = pe.ConcreteModel()
    m.x = pe.Var(initialize=0.0)
    m.c = Complementarity(expr=((m.x - 1.0) * (m.x - 1.0) - 1.01 >= 0, m.x >= 0))
    return Published(m, [m.x], [[1 + np.sqrt(1.01)]], 1e-8)


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
            m.q[i] >= 0,
            m.cost[i].marginal - m.price + m.q[i] * m.price / (gamma * m.total) >= 0,
        ),
    )
    return Published(m, each(m.q), answers)


@published
def oligomcp() -> Published:
    """F. H. Murphy, H. D. Sherali, A. L. Soyster, Math. Programming 24 (1982) 92–106: five firms."""
    return oligopoly([10, 8, 6, 4, 2], 5.0, [1.2, 1.1, 1.0, 0.9, 0.8], 1.1, NASH_5_SOLUTION)


@published
def nash() -> Published:
    """P. T. Harker, Math. Programming 41 (1988) 29–59: ten firms; Pyomo's model library, mcplib."""
    return oligopoly(
        [5, 3, 8, 5, 1, 3, 7, 4, 6, 3],
        0.1,
        [1.2, 1.0, 0.9, 0.6, 1.5, 1.0, 0.7, 1.1, 0.95, 0.75],
        1.2,
        NASH_10_SOLUTION,
    )


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


@published
def mathiesens() -> Published:
    """L. Mathiesen, Math. Programming 37 (1987) 1–18: a market; every (λ, 0, 0, 0), 0 ≤ λ ≤ 3, solves."""
    m = pe.ConcreteModel()
    m.y, m.p = pe.Var(initialize=1.0), pe.Var([1, 2, 3], initialize=1.0)
    m.profit = Complementarity(expr=complements(m.y >= 0, -m.p[1] + m.p[2] + m.p[3] >= 0))
    m.one = Complementarity(
        expr=complements(m.p[1] >= 0, m.y - (4.5 * m.p[2] + 2.7 * m.p[3]) / (m.p[1] + 1) >= 0)
    )
    m.two = Complementarity(
        expr=complements(m.p[2] >= 0, 5 - m.y - (0.5 * m.p[2] + 0.3 * m.p[3]) / (m.p[2] + 1) >= 0)
    )
    m.three = Complementarity(expr=complements(m.p[3] >= 0, 3 - m.y >= 0))
    return Published(m, [m.y, *each(m.p)])


@published
def hansen() -> Published:
    """H. Scarf, T. Hansen, Computation of Economic Equilibria (1973): 14 goods, 26 activities; GAMS' hansmcp."""
    A, owned, wanted = technique(), by_goods(OWNED), by_goods(WANTED)
    share = wanted / wanted.sum(axis=0)
    floor = np.where(share.max(axis=1) > 0, 1e-5, 0.0)
    m = pe.ConcreteModel()
    m.p = pe.Var(range(14), bounds=lambda m, g: (floor[g], None), initialize=1.0)
    m.y = pe.Var(range(26), within=pe.NonNegativeReals, initialize=1.0)
    m.i = pe.Var(range(4), initialize=1.0)
    m.p[0].fix(1.0)

    def left(m: Any, g: int) -> Any:
        bought = sum(share[g, h] * m.i[h] / m.p[g] for h in range(4) if share[g, h])
        return sum(A[g, s] * m.y[s] for s in range(26) if A[g, s]) + owned[g].sum() - bought

    m.market = Complementarity(
        range(14), rule=lambda m, g: complements(m.p[g] >= floor[g], left(m, g) >= 0)
    )
    m.profit = Complementarity(
        range(26),
        rule=lambda m, s: complements(
            m.y[s] >= 0, -sum(A[g, s] * m.p[g] for g in range(14) if A[g, s]) >= 0
        ),
    )
    m.income = pe.Constraint(
        range(4), rule=lambda m, h: m.i[h] == sum(owned[g, h] * m.p[g] for g in range(14))
    )

    return Published(m, [*each(m.p)[1:], *each(m.y, m.i)])


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
def chemical_equilibrium() -> Published:
    """W. B. White, S. M. Johnson, G. B. Dantzig, J. Chem. Phys. 28 (1958) 751–755: hydrazine and oxygen at 3500 K."""
    c = [-6.089, -17.164, -34.054, -5.914, -24.721, -14.986, -24.100, -10.708, -26.662, -22.179]
    atoms = [
        [1, 2, 2, 0, 0, 1, 0, 0, 0, 1],
        [0, 0, 0, 1, 2, 1, 1, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 1, 1, 2, 1],
    ]

    def rows(x: Any, functions: Any) -> list[Any]:
        total = sum(x[j] for j in range(10))
        potentials = [
            c[j] + functions.log(x[j] / total) - sum(atoms[k][j] * x[10 + k] for k in range(3))
            for j in range(10)
        ]
        return potentials + [
            sum(atoms[k][j] * x[j] for j in range(10)) - (2, 1, 1)[k] for k in range(3)
        ]

    lower = np.append(np.full(10, 1e-6), np.full(3, -np.inf))
    answer = [
        0.0406681,
        0.1477304,
        0.7831534,
        0.0014142,
        0.4852466,
        0.0006932,
        0.0273993,
        0.0179473,
        0.0373144,
    ]
    start = np.append(np.full(10, 0.1), np.full(3, -10.0))
    return by_rows(rows, 13, lower, np.inf, start, answers=[answer], digits=2e-4)


@published
def harker_game() -> Published:
    """P. T. Harker, Eur. J. Oper. Res. 54 (1991) 81–94: two players share a constraint; with one multiplier (5, 9)."""
    return by_rows(
        lambda x, _: [
            2 * x[0] + 8 / 3 * x[1] - 34 + x[2],
            2 * x[1] + 1.25 * x[0] - 24.25 + x[2],
            15 - x[0] - x[1],
        ],
        3,
        0.0,
        [10, 10, np.inf],
        1.0,
        answers=[[5, 9]],
        digits=1e-8,
    )


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
def scarf_1960() -> Published:
    """H. Scarf, Int. Econ. Rev. 1 (1960) 157–172: three goods whose prices tâtonnement never finds; all equal."""

    def rows(p: Any, _: Any) -> list[Any]:
        bought = [
            p[i] / (p[i] + p[(i + 1) % 3]) + p[(i + 2) % 3] / (p[(i + 2) % 3] + p[i])
            for i in range(3)
        ]
        return [1 - bought[0], 1 - bought[1], p[0] + p[1] + p[2] - 1]

    return by_rows(rows, 3, -np.inf, start=[0.5, 0.3, 0.2], answers=[[1 / 3] * 3], digits=1e-8)


@published
def shoven_whalley() -> Published:
    """J. B. Shoven, J. Whalley, J. Econ. Lit. 22 (1984) 1007–1051: two goods, factors and consumers, before taxes."""
    scale, capital, substitution = (1.5, 2.0), (0.4, 0.3), (2.0, 0.5)
    taste, elasticity, owned = ((0.5, 0.5), (0.3, 0.7)), (1.5, 0.75), ((25.0, 0.0), (0.0, 60.0))

    def rows(x: Any, _: Any) -> list[Any]:
        price, output, rent = (x[0], x[1]), (x[2], x[3]), x[4]  # the wage is 1
        unit, made_by = [], []
        for g in range(2):
            d, s = capital[g], substitution[g]
            index = (d**s * rent ** (1 - s) + (1 - d) ** s) ** (1 / (1 - s))
            unit.append(index / scale[g])
            made_by.append(d**s * (index / rent) ** s / scale[g])
        bought = [0, 0]
        for h in range(2):
            income = rent * owned[h][0] + owned[h][1]
            spread = sum(taste[h][g] * price[g] ** (1 - elasticity[h]) for g in range(2))
            for g in range(2):
                bought[g] = bought[g] + taste[h][g] * income / (price[g] ** elasticity[h] * spread)
        used = sum(made_by[g] * output[g] for g in range(2))
        return [
            output[0] - bought[0],
            output[1] - bought[1],
            unit[0] - price[0],
            unit[1] - price[1],
            25 - used,
        ]

    answer = [1.399, 1.093, 24.942, 54.378, 1.373]
    return by_rows(
        rows, 5, [1e-3, 1e-3, 0, 0, 1e-3], start=[1, 1, 20, 50, 1], answers=[answer], digits=1e-3
    )


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
    fixed, rise = (
        {"ab": 0, "cd": 0, "ac": 50, "bd": 50, "bc": 10},
        {"ab": 10, "cd": 10, "ac": 1, "bd": 1, "bc": 1},
    )
    m.wardrop = Complementarity(
        m.path,
        rule=lambda m, p: complements(
            sum(fixed[r] + rise[r] * m.use[r] for r in p.split()) >= m.time,
            m.flow[p] >= 0,
        ),
    )
    m.demand = pe.Constraint(expr=sum(m.flow[p] for p in m.path) == 6)
    return Published(m, [*each(m.flow), m.time], answers=[[2, 2, 2, 92]], digits=1e-8)


@published
def pigou() -> Published:
    """A. C. Pigou, The Economics of Welfare (1920); T. Roughgarden, É. Tardos, J. ACM 49 (2002) 236–259."""
    return by_rows(
        lambda x, _: [1 - x[2], x[1] ** 4 - x[2], x[0] + x[1] - 1],
        3,
        [0, 0, -np.inf],
        start=0.5,
        answers=[[0, 1, 1]],
        digits=1e-3,  # the derivative of the first road's use vanishes there
    )


def on_grid(size: int) -> tuple[Any, np.ndarray, np.ndarray]:
    """The five-point −h² Δ on size² interior points of the unit square, and these."""
    second = sp.diags_array(
        [-np.ones(size - 1), 2 * np.ones(size), -np.ones(size - 1)], offsets=[-1, 0, 1]
    )
    x, y = (part.ravel() for part in np.meshgrid(*2 * (np.arange(1, size + 1) / (size + 1),)))
    return (
        sp.csr_array(sp.kron(sp.eye_array(size), second) + sp.kron(second, sp.eye_array(size))),
        x,
        y,
    )


@published
def bratu_under_a_ceiling() -> Published:
    """G. Bratu, Bull. Soc. Math. France 42 (1914) 113–142: −Δu = 6 eᵘ below a ceiling."""
    size, h2 = 8, 1 / 81
    A = on_grid(size)[0]
    m = pe.ConcreteModel()
    m.u = pe.Var(range(size * size), initialize=0.0)
    m.top = pe.Param(initialize=0.4, mutable=True)
    rows = affine(A, np.zeros(size * size), m.u)
    m.pairs = Complementarity(
        range(size * size),
        rule=lambda m, i: complements(
            m.u[i] <= m.top,
            rows[i] <= 6 * h2 * pe.exp(m.u[i]),
        ),
    )
    return Published(m, each(m.u))


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


@published
def lubrication() -> Published:
    """M. M. Kostreva, Int. J. Numer. Methods Fluids 4 (1984) 377–397: elastic cylinders under oil; Pyomo's mcplib."""
    n, begin, end, alpha, speed = 30, -3.0, 2.0, 2.832, 6.057
    dx = (end - begin) / n
    weight = [0.5 if i in (0, n) else 1.0 for i in range(n + 1)]

    def rows(x: Any, functions: Any) -> list[Any]:
        k, p = x[0], [0.0, *(x[i] for i in range(1, n + 1)), 0.0]

        def gap(t: float) -> Any:
            bent = sum(
                weight[s]
                * (s - t)
                * dx
                * np.log(abs(s - t) * dx)
                * (p[s + 1] - (p[s - 1] if s else 0.0))
                for s in range(n + 1)
            )
            return (begin + t * dx) ** 2 + k + 1 + bent / np.pi

        def flow(i: int) -> Any:  # from i to i + 1
            return (
                gap(i + 0.5) ** 3
                * (p[i + 1] - p[i])
                / functions.exp(alpha * (p[i] + p[i + 1]) / 2)
                / dx**2
            )

        gaps, flows = [gap(i + 0.5) for i in range(n + 1)], [flow(i) for i in range(n + 1)]
        reynolds = [
            speed / dx * (gaps[i] - gaps[i - 1]) - (flows[i] - flows[i - 1])
            for i in range(1, n + 1)
        ]
        return [1 - 2 * dx / np.pi * sum(weight[i] * p[i] for i in range(1, n + 1)), *reynolds]

    start = [1.6, *(max(0.0, 1 - abs((begin + 1 + i * dx) / 2)) for i in range(1, n + 1))]
    return by_rows(rows, n + 1, np.append(-np.inf, np.zeros(n)), start=start)


@published
def von_thunen() -> Published:
    """A general equilibrium of J. H. von Thünen's rings (Mackinnon, Samuelson), four crops: GAMS' vonthmcp."""
    rings, crops = range(12), range(4)
    distance = [5.0 * (2 * r + 1) for r in rings]
    area = [2 * 3.1415 * d for d in distance]
    phi, beta, carry = (1.0, 2.0, 3.0, 4.0), (0.9, 0.7, 0.5, 0.3), (0.015, 0.006, 0.004, 0.01)
    worker, owner, porter, labour, carts = (
        (0.2, 0.3, 0.1, 0.3),
        (0.3, 0.3, 0.2, 0.2),
        (0.6, 0.2, 0.1, 0.1),
        30.0,
        20.0,
    )

    def rows(x: Any, _: Any) -> list[Any]:
        cost, made = ([[x[base + 4 * r + c] for c in crops] for r in rings] for base in (0, 48))
        idle, rent = ([x[base + r] for r in rings] for base in (96, 108))
        carrier, price = x[120], [x[121 + c] for c in crops]
        unit = [
            phi[c] * cost[r][c]
            - (1 / beta[c]) ** beta[c] * (rent[r] / (1 - beta[c])) ** (1 - beta[c])
            for r in rings
            for c in crops
        ]
        profit = [
            cost[r][c] + carry[c] * distance[r] * carrier - price[c] for r in rings for c in crops
        ]
        land = [
            area[r]
            - idle[r]
            - sum(made[r][c] * (1 - beta[c]) * cost[r][c] for c in crops) / rent[r]
            for r in rings
        ]
        carried = carts - sum(carry[c] * distance[r] * made[r][c] for r in rings for c in crops)
        rents = sum(rent[r] * (area[r] - idle[r]) for r in rings)
        goods = [
            price[c] * sum(made[r][c] for r in rings)
            - porter[c] * carts * carrier
            - worker[c] * labour
            - owner[c] * rents
            for c in crops
        ]
        return [*unit, *profit, *(rent[r] - 0.0001 for r in rings), *land, carried, *goods]

    lower = np.concatenate(
        [np.zeros(48), np.zeros(48), np.zeros(12), np.full(12, 0.001), [0.0], np.full(4, 0.1)]
    )
    start = np.where(np.arange(125) // 12 == 8, 0.0, 1.0)
    return by_rows(rows, 125, lower, start=start)


@published
def pies() -> Published:
    """W. W. Hogan, Comput. Oper. Res. 2 (1975) 251–270, as N. H. Josephy stated it (1979); Pyomo's mcplib."""
    goods, capacity = ("C", "L", "H"), {"Capital": 35000.0, "Steel": 12000.0}
    coal, oil = [(300, 300, 400), (200, 300, 600)], [(1100, 1200), (1300, 1100)]
    output, refining = [{"L": 0.6, "H": 0.4}, {"L": 0.5, "H": 0.5}], (6.5, 5.0)
    base, usual = {"C": 1000.0, "L": 1200.0, "H": 1000.0}, {"C": 12.0, "L": 16.0, "H": 12.0}
    cross = {"C": (-0.75, 0.1, 0.2), "L": (0.1, -0.5, 0.2), "H": (0.2, 0.1, -0.5)}
    coal_use = {"Capital": [(1, 5, 10), (1, 5, 6)], "Steel": [(1, 2, 3), (1, 4, 5)]}
    oil_use = {"Capital": [(0, 10), (0, 15)], "Steel": [(0, 4), (0, 2)]}
    coal_cost, oil_cost = [(5, 6, 8), (4, 5, 7)], [(1, 1.5), (1.25, 1.5)]
    coal_way, crude_way, product_way = (
        [(1, 2.5), (0.75, 2.75)],
        [(2, 3), (4, 2)],
        [(1, 1.2), (1, 1.5)],
    )
    two, three = range(2), range(3)

    def rows(x: Any, _: Any) -> list[Any]:
        at = iter(range(42))
        c = [[x[next(at)] for _ in three] for _ in two]
        o, ct, ot, lt, ht = ([[x[next(at)] for _ in two] for _ in two] for _ in range(5))
        p = {g: [x[next(at)] for _ in two] for g in goods}
        mu, cv, ov, lv, hv = ([x[next(at)] for _ in two] for _ in range(5))
        shadow = dict(zip(capacity, mu, strict=True))
        arrivals = {"C": ct, "L": lt, "H": ht}
        used = {
            s: sum(c[r][t] * coal_use[s][r][t] for r in two for t in three)
            + sum(o[r][t] * oil_use[s][r][t] for r in two for t in two)
            for s in capacity
        }

        def demand(g: str, u: int) -> Any:
            total = base[g]
            for other, power in zip(goods, cross[g], strict=True):
                total = total * (p[other][u] / usual[other]) ** power
            return total

        return [
            *(
                coal_cost[r][t] - cv[r] + sum(coal_use[s][r][t] * shadow[s] for s in capacity)
                for r in two
                for t in three
            ),
            *(
                oil_cost[r][t] - ov[r] + sum(oil_use[s][r][t] * shadow[s] for s in capacity)
                for r in two
                for t in two
            ),
            *(coal_way[r][u] + cv[r] - p["C"][u] for r in two for u in two),
            *(
                crude_way[r][f]
                + refining[f]
                + ov[r]
                - output[f]["L"] * lv[f]
                - output[f]["H"] * hv[f]
                for r in two
                for f in two
            ),
            *(product_way[f][u] + lv[f] - p["L"][u] for f in two for u in two),
            *(product_way[f][u] + hv[f] - p["H"][u] for f in two for u in two),
            *(sum(arrivals[g][r][u] for r in two) - demand(g, u) for g in goods for u in two),
            *(capacity[s] - used[s] for s in capacity),
            *(sum(c[r]) - sum(ct[r]) for r in two),
            *(sum(o[r]) - sum(ot[r]) for r in two),
            *(sum(ot[r][f] for r in two) * output[f]["L"] - sum(lt[f]) for f in two),
            *(sum(ot[r][f] for r in two) * output[f]["H"] - sum(ht[f]) for f in two),
        ]

    lower = np.concatenate([np.zeros(26), np.full(6, 0.1), np.zeros(2), np.full(8, -np.inf)])
    upper = np.concatenate([np.ravel(coal), np.ravel(oil), np.full(32, np.inf)])
    start = np.concatenate(
        [
            np.ravel(coal),
            [1100, 1000, 1300, 1000, 0, 828, 1016, 84, 2075, 0, 0, 2358, 22, 1223, 1179, 0],
            [0, 830, 998, 180],
            [11.7, 13.7, 15.8, 16, 11.9, 12.4],
            np.ones(10),
        ]
    )
    return by_rows(rows, 42, lower, upper, start)


ANALGESICS = """
0 .5 0 0 .4 | .4 0 .032 0 .1328 | 0 .5 0 0 .4 | .325 0 0 .15 .1275 | .325 0 0 0 .0975 | .324 0 0 .1 .1172
.421 0 .032 .075 .1541 | .5 0 0 .1 .17 | 0 .5 0 0 .4 | .25 .25 .065 0 .301 | 0 .5 0 0 .4 | 0 .5 0 0 .4
0 .325 0 0 .26 | .227 .194 0 .075 .2383
"""  # a brand each: its four ingredients and its cost
SUBJECTS = """
0 .0835 0 .0331 15.13539 -4.42859 3.86546 | 0 .543 .0075 .0204 4.62777 -2.04758 1 | 0 .4889 .0055 0 2.21225 -1.82057 1
.479 .0568 0 .0725 0 -3.22572 4.07059 | .3202 0 .0013 0 0 -2.13139 2.95369 | 0 .1395 0 0 10.58941 -2.75795 1.52444
0 .4805 0 0 5.0178 -1.97219 1 | .0649 .3759 .0022 0 3.51912 -2.79767 3.03524 | 0 .3834 0 0 9.10098 -3.17282 3.06484
.3431 .0908 0 .0695 0 -2.22797 2.60511 | .0484 .3229 .0351 0 10.53417 -5.16751 7.67621
.2696 .0741 .0005 .111 0 -4.40669 7.52461 | .4348 .0276 .0013 .0605 0 -3.08085 5.39522
.2634 0 .0022 0 0 -3.46886 5.77346
.3163 .0581 0 0 0 -2.66754 3.28809 | .0859 .0488 0 .1355 7.46487 -4.11384 4.94403
.3197 .032 .0424 .063 .64571 -1.83466 2.07788 | .1872 .7724 0 .0186 4.8654 -3.56241 1
.4398 .0235 .023 .0765 .53507 -2.31347 3.91686 | 0 .196 0 .0604 5.31825 -2.28169 1.98819
.0242 .5938 .0016 .0002 6.86056 -4.38702 5.20269 | .0016 .5157 .0399 .0079 5.69439 -1.85474 1
.2584 .0761 .0024 .0065 0 -2.75502 4.7539 | 0 .5171 0 0 5.98602 -2.61935 2.34962
.1094 .1291 0 .0934 14.47467 -2.65956 1 | .0153 .2855 0 0 13.5548 -2.95081 1
.1851 .0874 .0322 .0903 13.01291 -2.50123 1
.1289 .262 .1226 0 22.7317 -3.65221 1.96784 | .0472 .2513 .0059 0 5.13727 -2.87451 3.41328
.2752 .0199 .0003 .0224 .07553 -2.78712 5.10606
"""  # a subject each: the four it prefers, the weight of these, a constant, the weight of the price


@published
def choi() -> Published:
    """S. C. Choi, W. S. DeSarbo, P. T. Harker, Management Sci. 36 (1990) 175–199: 14 analgesics; Pyomo's mcplib."""
    brands, subjects = (
        np.array(
            [row.split() for row in table.replace("\n", "|").split("|") if row.strip()], dtype=float
        )
        for table in (ANALGESICS, SUBJECTS)
    )
    cost, slope = brands[:, 4], -3.0 * subjects[:, 6]
    distance = ((subjects[:, None, :4] - brands[None, :, :4]) ** 2).sum(axis=2)
    constant = -3.0 * (subjects[:, 4:5] * distance + subjects[:, 5:6])
    lower, upper = cost.copy(), np.full(14, np.inf)
    lower[7] = upper[7] = 0.199  # the market leader's price is given
    m = pe.ConcreteModel()
    m.I, m.J = pe.RangeSet(0, 29), pe.RangeSet(0, 13)
    m.p = pe.Var(m.J, initialize=lambda m, j: cost[j] + 0.01)
    m.pull = pe.Expression(
        m.I, m.J, rule=lambda m, i, j: pe.exp(slope[i] * m.p[j] + constant[i, j])
    )
    m.all = pe.Expression(m.I, rule=lambda m, i: 1 + sum(m.pull[i, j] for j in m.J))

    def marginal(m: Any, j: int) -> Any:
        share = {i: m.pull[i, j] / m.all[i] for i in m.I}
        return (
            -sum(share[i] * (1 + (m.p[j] - cost[j]) * slope[i] * (1 - share[i])) for i in m.I) / 30
        )

    m.profit = Complementarity(
        m.J,
        rule=lambda m, j: complements(
            pe.inequality(lower[j], m.p[j], upper[j])
            if np.isfinite(upper[j])
            else lower[j] <= m.p[j],
            marginal(m, j) if np.isfinite(upper[j]) else marginal(m, j) >= 0,
        ),
    )

    return Published(m, each(m.p))
