"""Random Pyomo models with a known solution: read back, solved, loaded, and checked by Pyomo.

A model first draws x* and the value w* of every row there, and then computes the constants. It mixes all four types
of pairs (lower, upper, both bounds, none), sides in either order and of either sign, and pairs of two expressions.
It also contains equations, inequalities, fixed variables, mutable parameters, defined variables, and indexed and
nested blocks. The campaign checks for each model

- whether the solution is optimal and satisfies every pair, equation and inequality in Pyomo. It may differ from x*,
  which some nonlinear terms allow. An additional inequality may then fail, with a message.
- whether the model is unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyomo.environ as pe
from pyomo.core.expr import EqualityExpression
from pyomo.core.expr.relational_expr import RelationalExpression
from pyomo.mpec import Complementarity, ComplementarityList, complements

import lcp_plugin.pyomo  # noqa: F401 - it registers the solver

NEAR = 1e-7  # ‖x − x*‖∞ relative to 1 + ‖x*‖∞
HOLDS = 1e-7  # the residual in Pyomo
# If the points of the bounds nearest to 0 are the solution, a relative residual compares rounding errors.
OPTIONS = {"tolerance": 1e-12, "absolute_tolerance": 1e-13}
KINDS = ("lower", "upper", "both", "none")
SMOOTH = (
    lambda e: pe.exp(0.3 * e),
    lambda e: pe.log(e**2 + 1.5),
    lambda e: pe.sqrt(e**2 + 1),
    pe.sin,
    pe.cos,
    pe.tanh,
    pe.atan,
    lambda e: e**2,
    lambda e: e**3,
    lambda e: 1 / (e**2 + 2),
    lambda e: (e**2 + 1) ** 1.5,
    lambda e: pe.sinh(0.2 * e),
    lambda e: pe.log10(e**2 + 2),
    lambda e: 2.0 ** (0.2 * e),
    pe.asinh,
)


@dataclass
class Planted:
    """A model whose answer is known."""

    model: Any
    answer: list[tuple[Any, float]] = field(default_factory=list)


def planted(rng: np.random.Generator) -> Planted:
    """Return a random model, M x + smooth terms + constants, M dominant; x* is mostly unique."""
    n = int(rng.integers(1, 9))
    m = pe.ConcreteModel()
    case = Planted(m)
    is_nonlinear, has_blocks = rng.random() < 0.7, rng.random() < 0.3
    m.b = pe.Block([1, 2])
    home = m.b[2] if has_blocks else m
    home.x, home.extra = pe.Var(range(n)), pe.Var(range(n))
    x = home.x
    spot = np.round(rng.normal(size=n), 2)
    M = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5)
    M[np.diag_indices(n)] = np.abs(M).sum(axis=1) + 1.0 + rng.random(n)
    m.price = pe.Param(range(n), mutable=True, initialize={i: float(spot[i]) for i in range(n)})
    home.shared = pe.Expression(
        range(n),
        rule=lambda b, i: SMOOTH[int(rng.integers(len(SMOOTH)))](
            x[i] + 0.5 * x[int(rng.integers(n))] - float(rng.normal())
        ),
    )
    kinds: list[str] = []
    home.list = ComplementarityList()
    home.pairs, home.equations = Complementarity(pe.Any), pe.Constraint(pe.Any)
    for i in range(n):
        x[i].set_value(
            float(spot[i] + 0.3 * rng.normal()) if rng.random() < 0.8 else None,
            skip_validation=True,
        )
        row = sum(float(M[i, j]) * x[j] for j in range(n) if M[i, j]) + float(rng.normal())
        if is_nonlinear and rng.random() < 0.7:
            row = row + 0.05 * home.shared[int(rng.integers(n))] * (
                1.0 if rng.random() < 0.7 else home.shared[i]
            )
        kind = KINDS[int(rng.integers(4))]
        kinds.append(kind)
        state(rng, case, home, i, row, kind, float(spot[i]), value_at(row, x, spot))
    for i in range(n):
        case.answer.append((x[i], float(spot[i])))
    can_be_fixed = [
        i for i in range(n) if kinds[i] != "none" and ("extra", i) not in home.equations
    ]
    if (
        n > 1 and can_be_fixed and rng.random() < 0.2
    ):  # the pair of such a variable has no complementary variable
        k = int(rng.choice(can_be_fixed))
        x[k].fix(float(spot[k]), skip_validation=True)
    if rng.random() < 0.2:
        margin = float(rng.random())
        m.beside = pe.Constraint(
            expr=sum(x[i] ** 2 for i in range(n)) <= float(spot @ spot) + margin
        )
    if rng.random() < 0.15:
        m.idle = pe.Constraint(expr=x[0] * 1e3 >= 1e9)
        m.idle.deactivate()
    return case


def value_at(row: Any, x: Any, spot: np.ndarray) -> float:
    before = [x[i].value for i in x]
    for i in x:
        x[i].set_value(float(spot[i]), skip_validation=True)
    found = float(pe.value(row))
    for i in x:
        x[i].set_value(before[i], skip_validation=True)
    return found


def state(
    rng: np.random.Generator,
    case: Planted,
    home: Any,
    i: int,
    row: Any,
    kind: str,
    spot: float,
    there: float,
) -> None:
    """Add pair or equation i with x_i = spot; the constant makes the pair valid."""
    m, variable = case.model, home.x[i]
    place = int(
        rng.choice({"lower": (-1, 0), "upper": (0, 1), "both": (-1, 0, 1), "none": (0,)}[kind])
    )
    slack = float(rng.random() * (rng.random() < 0.8))
    w = -place * slack
    row = row - (there - w)  # its value at x*
    distance = float(rng.random()) + 0.1
    lower = spot if place < 0 else spot - distance
    upper = spot if place > 0 else spot + distance
    if kind == "none":
        form = row == 0 if rng.random() < 0.5 else variable * 0.5 == 0.5 * variable - row
        if rng.random() < 0.3:
            home.pairs.add(i, complements(variable, row == 0))
        else:
            home.equations.add(i, form)
        return
    low, high = (lower, upper) if rng.random() < 0.5 or place == 0 else ("param", "param")
    if low == "param":
        low, high = (m.price[i] if place < 0 else lower), (m.price[i] if place > 0 else upper)
    body: Any = variable
    if rng.random() < 0.15:  # a pair of two expressions, with a new unknown for the expression of x
        body = home.extra[i] + 2 * variable
        home.equations.add(("extra", i), home.extra[i] + variable == 0)
        case.answer.append((home.extra[i], -spot))
    if kind == "both":
        sides = [pe.inequality(low, body, high), row]
    elif kind == "lower":
        sides = [body >= low, row >= 0 if rng.random() < 0.7 else -row <= 0]
    else:
        sides = [body <= high, row <= 0 if rng.random() < 0.7 else -row >= 0]
    if rng.random() < 0.2 and body is variable:
        variable.setlb(lower if kind != "upper" else None)
        variable.setub(upper if kind != "lower" else None)
    if rng.random() < 0.5:
        sides.reverse()
    if rng.random() < 0.3:
        home.list.add(complements(*sides))
    else:
        home.pairs.add(i, complements(*sides))


def residual(model: Any, with_inequalities: bool = True) -> float:
    """The largest violation of all that is active in the model, by Pyomo's own expressions."""
    worst = 0.0
    for condition in model.component_data_objects(Complementarity, active=True):
        worst = max(worst, pair_residual(*(pe_side(side) for side in condition._args)))
    for row in model.component_data_objects(pe.Constraint, active=True):
        if row.equality or with_inequalities:
            body = pe.value(row.body)
            below = pe.value(row.lower) - body if row.lower is not None else 0.0
            above = body - pe.value(row.upper) if row.upper is not None else 0.0
            worst = max(worst, below, above)
    return worst


def pe_side(side: Any) -> tuple[float, float, float]:
    """(lower, body, upper) of a side by its arguments alone."""
    if not isinstance(side, RelationalExpression):
        return -math.inf, pe.value(side, exception=False), math.inf
    numbers = [pe.value(argument) for argument in side.args]
    if len(numbers) == 3:
        return numbers[0], numbers[1], numbers[2]
    if isinstance(side, EqualityExpression):
        return 0.0, numbers[1] - numbers[0], 0.0
    return 0.0, numbers[1] - numbers[0], math.inf


def pair_residual(first: tuple[float, float, float], second: tuple[float, float, float]) -> float:
    for side in (first, second):
        if side[0] == side[2]:
            return abs(side[1] - side[0])
    if math.isinf(first[0]) and math.isinf(first[2]):
        first, second = second, first
    if math.isfinite(second[0]):  # two slacks
        return abs(min(first[1] - first[0], second[1] - second[0]))
    return abs(first[1] - min(max(first[1] - second[1], first[0]), first[2]))


def picture(model: Any) -> list[Any]:
    """Return the state of a model that a solve must not change."""
    components = [
        (block.name, sorted(block.component_map()))
        for block in model.block_data_objects(active=None)
    ]
    return [
        components,
        [(v.name, v.lb, v.ub, v.fixed) for v in model.component_data_objects(pe.Var)],
        [
            (c.name, c.active, str(c._args), hidden(c._args))
            for c in model.component_data_objects(Complementarity)
        ],
    ]


def hidden(expressions: Any) -> list[Any]:
    """Return the number of arguments of each node, because sums share longer lists of arguments."""
    return [[len(e._args_), hidden(e.args)] for e in expressions if hasattr(e, "_args_")]


def faults_of(case: Planted) -> Iterator[str]:
    """Yield the faults of a model."""
    model = case.model
    before = picture(model)
    results = pe.SolverFactory("lcp_plugin").solve(model, options=OPTIONS)
    size = 1.0 + max(abs(number) for _, number in case.answer)
    is_another = max(abs(variable.value - number) for variable, number in case.answer) > NEAR * size
    is_optimal = pe.check_optimal_termination(results)
    if not is_optimal and not (is_another and "beside does not hold" in results.solver.message):
        yield f"{results.solver.termination_condition}: {results.solver.message}"
    elif not (off := residual(model, is_optimal)) <= HOLDS:
        yield f"residual in Pyomo {off:.1e}"
    if picture(model) != before:
        yield "the model has changed"
