"""Small problems of each class in `CLASSES`, solvable and not.

Each stated in every language.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    EquilibriumProgram,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    box,
    complements,
    friction_cone,
)

INF = np.inf
NO_ANSWER = (Status.STALLED, Status.MAX_ITERATIONS)


@dataclass(frozen=True, eq=False)
class Sample:
    """A problem, the statuses that it may end with, and x of a solution that is the only one.

    Attributes
    ----------
    in_cvxpy, in_pyomo : callable
        Return the problem in cvxpy; the model in Pyomo, and its variables in the order of x. None where that language
        has no place for it.
    program : tuple or None
        P, c, G, h, A, b, lower, upper where it is a program.
    """

    name: str
    kind: str
    problem: Any
    ends: tuple[Status, ...]
    x: Sequence[float] | None
    in_cvxpy: Callable[[], Any] | None
    in_pyomo: Callable[[], Any] | None
    program: tuple[Any, ...] | None = None

    @property
    def start(self) -> dict[str, Any]:
        """What solve needs besides."""
        return {"x0": np.ones(2)} if self.kind == "NonlinearProblem" else {}

    def __repr__(self) -> str:
        return self.name


def finite(bound: float) -> float | None:
    return float(bound) if np.isfinite(bound) else None


def pyomo_variables(model: Any, lower: Any, upper: Any) -> list[Any]:
    """Add variables with bounds."""
    import pyomo.environ as pe

    bounds = list(zip(map(finite, lower), map(finite, upper), strict=True))
    model.x = pe.Var(range(len(bounds)), bounds=lambda _, i: bounds[i], initialize=1.0)
    return [model.x[i] for i in range(len(bounds))]


def add_pyomo_pairs(
    model: Any, x: Sequence[Any], rows: Sequence[Any], lower: Any, upper: Any
) -> None:
    """Add x_i between its bounds ⟂ row i."""
    import pyomo.environ as pe
    from pyomo.mpec import ComplementarityList, complements

    model.pairs, model.equations = ComplementarityList(), pe.ConstraintList()
    for one, row, low, high in zip(x, rows, map(finite, lower), map(finite, upper), strict=True):
        if low is None and high is None:
            model.equations.add(row == 0)
        elif high is None:
            model.pairs.add(complements(one >= low, row >= 0))
        elif low is None:
            model.pairs.add(complements(one <= high, row <= 0))
        else:
            model.pairs.add(complements(row, pe.inequality(low, one, high)))


def lcp(
    name: str, M: Any, q: Any, ends: Any, x: Any = None, lower: Any = 0.0, upper: Any = INF
) -> Sample:
    problem = LCP(M, q, lower=lower, upper=upper)
    lower, upper = problem.lower, problem.upper

    def in_pyomo() -> Any:
        import pyomo.environ as pe

        model = pe.ConcreteModel()
        free = np.isinf(lower) & np.isinf(upper)
        z = pyomo_variables(model, np.where(free, -INF, lower), np.where(free, INF, upper))
        rows = [
            sum(float(m) * v for m, v in zip(row, z, strict=True)) + float(c)
            for row, c in zip(M, q, strict=True)
        ]
        add_pyomo_pairs(model, z, rows, lower, upper)
        return model, z

    return Sample(name, "LCP", problem, ends, x, problem.to_cvxpy, in_pyomo)


def hyperbola(x: Any) -> Any:
    """x₀² + x₁ − 3 ⟂ x₀, x₁ − 1 ⟂ x₁."""
    return np.array([x[0] ** 2 + x[1] - 3.0, x[1] - 1.0])


def hopeless(x: Any) -> Any:
    """x₀² + 1 = 0 for a free x₀."""
    return np.array([x[0] ** 2 + 1.0, x[1]])


def nonlinear(name: str, F: Any, lower: Any, ends: Any, x: Any = None) -> Sample:
    lower, upper = np.asarray(lower, float), np.full(2, INF)

    def in_cvxpy() -> Any:
        import cvxpy as cp

        x = [cp.Variable(value=1.0) for _ in range(2)]
        rows = (
            [cp.square(x[0]) + x[1] - 3, x[1] - 1]
            if F is hyperbola
            else [cp.square(x[0]) + 1, x[1]]
        )
        pairs = [
            row == 0 if np.isinf(low) else complements(one >= low, row >= 0)
            for one, row, low in zip(x, rows, lower, strict=True)
        ]
        if np.isinf(lower[0]):
            pairs[0] = complements(x[0], rows[0] == 0)
        return cp.Problem(cp.Minimize(0), pairs)

    def in_pyomo() -> Any:
        import pyomo.environ as pe

        model = pe.ConcreteModel()
        x = pyomo_variables(model, lower, upper)
        add_pyomo_pairs(model, x, list(F(x)), lower, upper)
        return model, x

    return Sample(
        name, "NonlinearProblem", NonlinearProblem(F, lower=lower), ends, x, in_cvxpy, in_pyomo
    )


def pyomo_program(data: Any) -> Any:
    import pyomo.environ as pe

    P, c, G, h, A, b, lower, upper = data
    model = pe.ConcreteModel()
    x = pyomo_variables(model, lower, upper)

    def row(values: Any) -> Any:
        return sum(float(value) * one for value, one in zip(values, x, strict=True))

    model.objective = pe.Objective(
        expr=sum(0.5 * float(P[i, j]) * x[i] * x[j] for i in range(len(x)) for j in range(len(x)))
        + row(c)
    )
    model.rows = pe.ConstraintList()
    for values, limit in zip(G, h, strict=True):
        model.rows.add(row(values) <= float(limit))
    for values, limit in zip(A, b, strict=True):
        model.rows.add(row(values) == float(limit))
    return model, x


def cvxpy_program(data: Any) -> Any:
    import cvxpy as cp

    P, c, G, h, A, b, lower, upper = data
    x = cp.Variable(len(c))
    kept = [G @ x <= h] * (len(h) > 0) + [A @ x == b] * (len(b) > 0)
    kept += [x[i] >= lower[i] for i in np.flatnonzero(np.isfinite(lower))]
    kept += [x[i] <= upper[i] for i in np.flatnonzero(np.isfinite(upper))]
    return cp.Problem(cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(P)) + c @ x), kept)


def full_data(P: Any, c: Any, G: Any = None, h: Any = (), A: Any = None, b: Any = (), lower: Any = -INF,
              upper: Any = INF) -> tuple[Any, ...]:  # fmt: skip
    n = len(c)
    P, G, A = (
        np.zeros((rows, n)) if one is None else np.asarray(one, float)
        for one, rows in ((P, n), (G, 0), (A, 0))
    )
    low, high = (np.broadcast_to(np.asarray(bound, float), n) for bound in (lower, upper))
    return P, np.asarray(c, float), G, np.asarray(h, float), A, np.asarray(b, float), low, high


def program(name: str, ends: Any, x: Any, P: Any, c: Any, **rest: Any) -> Sample:
    data = full_data(P, c, **rest)
    return Sample(
        name,
        "QuadraticProgram",
        QuadraticProgram(P, c, **rest),
        ends,
        x,
        lambda: cvxpy_program(data),
        lambda: pyomo_program(data),
        data,
    )


def least_squares(name: str, A: Any, b: Any, x: Any, **bounds: Any) -> Sample:
    A, b = np.asarray(A, float), np.asarray(b, float)
    # x ≥ 0: a penalty is linear
    rest = {name: bound for name, bound in bounds.items() if name != "l1"}
    data = full_data(A.T @ A, bounds.get("l1", 0.0) - A.T @ b, **{"lower": 0.0, **rest})
    return Sample(
        name,
        "BoundedLeastSquares",
        BoundedLeastSquares(A, b, **bounds),
        (Status.SOLVED,),
        x,
        lambda: cvxpy_program(data),
        lambda: pyomo_program(data),
        data,
    )


def equilibrium(name: str, ends: Any, x: Any, P: Any, c: Any, pair: int, row: Any, offset: float,
                **rest: Any) -> Sample:  # fmt: skip
    """An objective beside 0 ≤ x_pair ⟂ row·x + offset ≥ 0."""
    data = full_data(P, c, **rest)
    rest = {name: value for name, value in rest.items() if value is not None}
    lower = np.array(data[6])
    lower[pair] = 0.0
    stated = QuadraticProgram(P, c, **{**rest, "lower": lower})

    def in_cvxpy() -> Any:
        import cvxpy as cp

        plain = cvxpy_program(data)
        variable = plain.variables()[0]
        pairs = [complements(variable[pair] >= 0, np.asarray(row, float) @ variable + offset >= 0)]
        return cp.Problem(plain.objective, [*plain.constraints, *pairs])

    def in_pyomo() -> Any:
        model, x = pyomo_program((*data[:6], lower, data[7]))
        add_pyomo_pairs(model, [x[pair]], [sum(float(a) * one for a, one in zip(row, x, strict=True)) + offset],
                        [0.0], [INF])  # fmt: skip
        return model, x

    return Sample(
        name,
        "EquilibriumProgram",
        EquilibriumProgram.of_rows(stated, [pair], [row], [offset]),
        ends,
        x,
        in_cvxpy,
        in_pyomo,
    )


def on_cones(name: str, problem: Any, ends: Any, x: Any = None) -> Sample:
    def in_cvxpy() -> Any:
        import cvxpy as cp

        z = cp.Variable(problem.n)
        F = problem.rows.csr @ z + problem.q
        if isinstance(problem, FrictionalContact):
            return cp.Problem(cp.Minimize(0), [complements(friction_cone(z, problem.friction), F)])
        pairs = []
        for first, end in zip(problem.starts[:-1], problem.starts[1:], strict=True):
            own = slice(first, end)
            side = box(z[own], problem.lower[own], problem.upper[own])
            pairs.append(
                complements(
                    cp.SOC(z[first], z[first + 1 : end]) if end - first > 1 else side, F[own]
                )
            )
        return cp.Problem(cp.Minimize(0), pairs)

    return Sample(name, type(problem).__name__, problem, ends, x, in_cvxpy, None)


GOOD = (Status.SOLVED,)
BOX_AND_CONE = ConeProblem(
    np.diag([2.0, 1.0, 1.0]), [-1.0, 0.5, -1.0], [("box", 0.0, 0.25), ("second_order", 2)]
)
SAMPLES = [
    lcp("LCP", [[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0], GOOD, [2.5, 0.0]),
    lcp(
        "box",
        [[2.0, 1.0], [1.0, 2.0]],
        [-5.0, -5.0],
        GOOD,
        [1.0, 2.0],
        lower=-1.0,
        upper=[1.0, 9.0],
    ),
    lcp("free row", [[0.0, 1.0], [-1.0, 2.0]], [-1.0, -3.0], GOOD, [-1.0, 1.0], lower=[-INF, 0.0]),
    lcp("infeasible", [[-1.0, 0.0], [0.0, 1.0]], [-1.0, 1.0], (Status.INFEASIBLE,)),
    lcp("no solution", [[2.0, 2.0], [2.0, 0.0]], [1.0, -2.0], (Status.NO_SOLUTION,)),
    nonlinear("nonlinear", hyperbola, [0.0, 0.0], GOOD, [np.sqrt(2.0), 1.0]),
    nonlinear("nonlinear, hopeless", hopeless, [-INF, 0.0], NO_ANSWER),
    program(
        "QP", GOOD, [0.5, 1.5], [[2.0, 0.0], [0.0, 2.0]], [-2.0, -4.0], G=[[1.0, 1.0]], h=[2.0]
    ),
    program(
        "QP, infeasible",
        (Status.INFEASIBLE,),
        None,
        np.eye(2),
        [1.0, 1.0],
        G=[[1.0, 1.0]],
        h=[-1.0],
        lower=0.0,
    ),
    program("LP", GOOD, [2.0, 0.0], None, [-2.0, -1.0], G=[[1.0, 1.0]], h=[2.0], lower=0.0),
    program("LP, unbounded", (Status.UNBOUNDED,), None, None, [-1.0, 0.0], lower=0.0),
    least_squares(
        "least squares", [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [2.0, 1.0, -1.0], [1.5, 0.0]
    ),
    least_squares(
        "least squares in a box", [[1.0, 0.0], [0.0, 2.0]], [5.0, 1.0], [3.0, 0.5], upper=3.0
    ),
    least_squares("least squares, l1", [[1.0, 0.0], [0.0, 2.0]], [5.0, 0.25], [4.0, 0.0], l1=1.0),
    least_squares("least squares, rank deficient", [[1.0, 1.0], [2.0, 2.0]], [1.0, 2.0], None),
    equilibrium(
        "objective", GOOD, [0.5, 0.0], [[2.0, 0.0], [0.0, 0.0]], [-2.0, 1.0], 1, [-1.0, 1.0], 0.5
    ),
    equilibrium(
        "objective, infeasible",
        (Status.INFEASIBLE,),
        None,
        np.eye(2),
        [1.0, 1.0],
        1,
        [1.0, 1.0],
        0.0,
        G=[[1.0, 1.0]],
        h=[-1.0],
        lower=0.0,
    ),
    # 0 ≤ y ⟂ x ≥ 0 with x ≥ 1 and y ≥ 1.
    equilibrium(
        "objective, no solution",
        (Status.NO_SOLUTION, Status.INFEASIBLE),
        None,
        np.eye(2),
        [1.0, 1.0],
        1,
        [1.0, 0.0],
        0.0,
        A=[[0.0, 1.0]],
        b=[1.0],
        lower=[1.0, 0.0],
    ),
    on_cones(
        "cone", ConeProblem(np.eye(3), [0.0, -2.0, 0.0], [("second_order", 3)]), GOOD, [1.0, 1.0]
    ),
    on_cones("cone and box", BOX_AND_CONE, GOOD, [0.25, 0.25]),
    on_cones("friction", FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5), GOOD, [1.0, -0.3]),
    on_cones(
        "friction in the plane",
        FrictionalContact(np.eye(2), [[-1.0, 0.25]], 0.5),
        GOOD,
        [1.0, -0.25],
    ),
    equilibrium(
        "objective, unbounded", (Status.UNBOUNDED,), None, None, [-1.0, 0.0], 1, [0.0, 1.0], 0.0
    ),
]
