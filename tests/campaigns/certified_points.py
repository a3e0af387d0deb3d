"""Points of small integer complementarity problems for `certify`, in every door, verified in fractions.

The solution z*, w* comes first, then q = w* − M z*, so that z* is exact. Other points are z* moved by units in the last
place, by 10⁻³ or by integers; a moved point may be a solution as well, which the fractions decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from lcp_plugin import LCP, ConeProblem, NonlinearProblem, box, certify, complements

VISIBLE = Fraction(1, 1000)  # of the terms of a row: beyond all tolerances of certify
MOVES = ("none", "ulp", "small", "integer", "outside", "scaled")
SLOW = ("cvxpy", "cvxpy, defined", "pyomo")
DOORS = ("dense", "sparse", "nonlinear", "cones", "program", *SLOW)


@dataclass(frozen=True)
class Case:
    """M, q, bounds, and an exact solution; of a program P, c, G, h with z = (x, multipliers)."""

    M: Any
    q: Any
    lower: Any
    upper: Any
    z: Any
    program: tuple[Any, ...] = ()


def draw(rng: np.random.Generator, door: str) -> Case:
    """Return a problem of small integers and a solution."""
    n = int(rng.integers(1, 6))
    if door == "program":
        m, n = int(rng.integers(1, 4)), n + 1
        half, G = rng.integers(-2, 3, (n, n)), rng.choice([-2, -1, 1, 2], (m, n))
        P = half @ half.T
        M = np.block([[P, G.T], [-G, np.zeros((m, m))]]) * 1.0
        n += m
        kind = np.zeros(n, int)
    else:
        M = rng.integers(-3, 4, (n, n)) * (rng.random((n, n)) < rng.choice([0.5, 1.0])) * 1.0
        # 0 z ≥ lower, 1 box, 2 z ≤ upper, 3 free: Pyomo drops free unknowns that no row has
        kind = rng.integers(0, 4 - (door == "pyomo"), n) * int(rng.integers(0, 2))
    lower = np.where(kind < 2, rng.integers(-2, 3, n) * (kind == 1) * 1.0, -np.inf)
    upper = np.where(
        kind == 1,
        lower + rng.integers(int(door == "pyomo"), 4, n),
        np.where(kind == 2, 2.0, np.inf),
    )
    low = np.maximum(lower, np.minimum(upper, 0.0) - 3.0)
    high = np.minimum(upper, np.maximum(lower, 0.0) + 3.0)
    z = np.clip(np.round(rng.uniform(low - 2.0, high + 2.0)), lower, upper)
    size = rng.integers(0, 4, n) * (rng.random(n) < 0.8)
    w = np.where(z == lower, size, 0.0) - np.where(z == upper, size * (z != lower), 0.0)
    q = w - M @ z
    program = () if door != "program" else (M[:-m, :-m], q[:-m], M[:-m, -m:].T, q[-m:])
    return Case(M, q, lower, upper, z, program)


def move(rng: np.random.Generator, case: Case, how: str) -> Any:
    """Return another point."""
    z, n, some = case.z, case.z.size, rng.random(case.z.size) < 0.6
    if how == "ulp":
        away = np.where(rng.random(n) < 0.5, -np.inf, np.inf)
        return np.where(some & (z != 0.0), np.nextafter(z, away), z)
    if how == "small":
        return z + some * rng.choice([-1e-3, 1e-3], n)
    if how == "integer":
        return np.clip(z + some * rng.integers(-2, 3, n), case.lower, case.upper)
    if how == "outside":
        return z - some * rng.integers(0, 6, n)
    return z * 2.0**30 if how == "scaled" else z


def judge(case: Case, z: Any) -> str:
    """Return "right" for an exact solution, "wrong" for a visible violation, else "near"."""
    M, q = case.M.tolist(), case.q.tolist()
    at, is_right, is_wrong = [Fraction(x) for x in z.tolist()], True, False
    for i, row in enumerate(M):
        terms = [Fraction(a) * x for a, x in zip(row, at, strict=True)]
        w, size = sum(terms, Fraction(q[i])), sum(map(abs, terms), abs(Fraction(q[i])))
        lower, upper = case.lower[i], case.upper[i]
        beyond = max(
            Fraction(lower) - at[i] if np.isfinite(lower) else Fraction(0),
            at[i] - Fraction(upper) if np.isfinite(upper) else Fraction(0),
            Fraction(0),
        )
        violation = max(w if z[i] > lower else Fraction(0), -w if z[i] < upper else Fraction(0))
        is_right &= beyond == 0 and violation == 0
        near = min(
            (abs(at[i] - Fraction(end)) for end in (lower, upper) if np.isfinite(end)), default=None
        )
        is_at_bound = near is not None and near <= VISIBLE
        is_wrong |= beyond > VISIBLE or (violation > VISIBLE * size and not is_at_bound)
        sign_is_wrong = (
            near is not None
            and is_at_bound
            and (
                (w < -VISIBLE * size and abs(z[i] - lower) <= VISIBLE and z[i] < upper - VISIBLE)
                or (w > VISIBLE * size and abs(z[i] - upper) <= VISIBLE and z[i] > lower + VISIBLE)
            )
        )
        is_wrong |= bool(sign_is_wrong)
    return "right" if is_right else "wrong" if is_wrong else "near"


def solves_at_start(case: Case) -> bool:
    """Return whether the point of the bounds nearest to 0 solves some component: its rounding has no unit."""
    z = np.clip(0.0, case.lower, case.upper)
    w = case.M @ z + case.q
    step = np.minimum(np.maximum(w, z - case.upper), z - case.lower)
    count, labels = connected_components(case.M != 0.0, directed=False)
    return any(not step[labels == one].any() for one in range(count))


def verdict(case: Case, z: Any, door: str) -> str:
    """Return the verdict of `certify` on a point, through a door."""
    n, M, q = z.size, case.M, case.q
    ends = {"lower": case.lower, "upper": case.upper}
    if door == "dense":
        return certify(LCP(M, q, **ends), z).verdict
    if door == "sparse":
        return certify(LCP(csr_array(M), q, **ends), z).verdict
    if door == "nonlinear":
        return certify(NonlinearProblem(lambda x: M @ x + q, lambda x: M, **ends), z).verdict
    if door == "cones":
        return certify(ConeProblem(M, q, [("box", case.lower, case.upper)]), z).verdict
    if door == "program":
        P, c, G, h = case.program
        lower = np.zeros(len(c))
        return certify(LCP.from_qp(P, c, G, h, lower=lower), z).verdict
    if door == "pyomo":
        return certify(in_pyomo(case, z)).verdict
    x = cp.Variable(n)
    x.value = z
    if door == "cvxpy":
        return certify(
            cp.Problem(cp.Minimize(0), [complements(box(x, case.lower, case.upper), M @ x + q)])
        ).verdict
    y = cp.Variable(n)
    y.value = M @ z + q
    model = [complements(box(x, case.lower, case.upper), y), y == M @ x + q]
    return certify(cp.Problem(cp.Minimize(0), model)).verdict


def in_pyomo(case: Case, z: Any) -> Any:
    """Return the Pyomo model, with a variable for each row that an equation defines."""
    import pyomo.environ as pyo
    from pyomo.mpec import Complementarity
    from pyomo.mpec import complements as pair

    m, own = pyo.ConcreteModel(), range(z.size)
    m.x, m.y = pyo.Var(own), pyo.Var(own)
    M, q, w = case.M.tolist(), case.q.tolist(), (case.M @ z + case.q).tolist()
    for i in own:
        m.x[i].set_value(float(z[i]), skip_validation=True)
        m.y[i].set_value(w[i])
    m.e = pyo.Constraint(own, rule=lambda m, i: m.y[i] == sum(M[i][j] * m.x[j] for j in own) + q[i])
    lower = [None if np.isinf(end) else float(end) for end in case.lower]
    upper = [None if np.isinf(end) else float(end) for end in case.upper]

    def rule(m: Any, i: int) -> Any:
        if lower[i] is None and upper[i] is None:
            return pair(m.y[i] == 0, m.x[i])
        if upper[i] is None:
            return pair(m.x[i] >= lower[i], m.y[i] >= 0)
        if lower[i] is None:
            return pair(m.x[i] <= upper[i], m.y[i] <= 0)
        return pair(pyo.inequality(lower[i], m.x[i], upper[i]), m.y[i])

    m.c = Complementarity(own, rule=rule)
    return m


def faults(seed: int, door: str) -> list[str]:
    """Return the false verdicts on the points of a problem."""
    rng = np.random.default_rng([seed, DOORS.index(door)])
    case, found = draw(rng, door), []
    for how in MOVES:
        z = move(rng, case, how)
        kind, said = judge(case, z), verdict(case, z, door)
        if (kind, said) in {("right", "disproved"), ("wrong", "proved")}:
            found.append(f"{door} {seed}: {how}, {kind}, {said}")
        if how == "ulp" and said != "proved" and not solves_at_start(case):
            found.append(f"{door} {seed}: one ulp off, {said}")
    return found
