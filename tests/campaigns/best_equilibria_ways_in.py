"""Small programs with complementarity constraints through every way in, beside an enumeration of all cases.

Run ``python tests/campaigns/best_equilibria_ways_in.py --cases 60 --seed 0``. Two to ten pairs, as in
``best_equilibria.py``, and two to four beside integer leaders whose products with the followers are in the objective,
which is then not convex. Each is solved from arrays with and without ``prove=True``, in cvxpy, in Pyomo and by
``lcp-plugin-ampl``. The truth is the least of all pieces, solved by HiGHS and Clarabel; integers are enumerated, too.
A way in is wrong where its status, its value or its bound contradicts the truth. Exit code 1 where one is.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import pyomo.environ as pe
import scipy.sparse as sp
from pyomo.mpec import Complementarity
from pyomo.mpec import complements as complementary

sys.path.insert(0, str(Path(__file__).parents[1]))
from sol_files import read_sol

import lcp_plugin.pyomo
from lcp_plugin import EquilibriumProgram, QuadraticProgram, Status, box, complements
from lcp_plugin.problems.equilibria.branch_and_bound import minimize_over_solutions

if __package__:
    from .best_equilibria import ACCURACY, INF, Generator, random_problem, truth
else:
    from best_equilibria import ACCURACY, INF, Generator, random_problem, truth

SECONDS = 10.0
EXCLUDED, FALLS = (Status.INFEASIBLE, Status.NO_SOLUTION), (Status.UNBOUNDED,)


class Said(NamedTuple):
    """What a way in says: value and bound of what is minimised; None where it says nothing."""

    status: Status
    value: float | None
    bound: float | None


# --- The problems ---


def with_integer_leaders(rng: Generator) -> EquilibriumProgram:
    """Return a small problem whose leaders are integers, and multiply followers in the objective."""
    while True:
        problem = random_problem(rng, most=4)
        leaders = problem.program.n - 2 * problem.pairs
        if 1 <= leaders <= 2:
            break
    P, program = sp.csr_array(problem.program.P).toarray(), problem.program
    lower, upper = np.array(program.lower), np.array(program.upper)
    lower[:leaders], upper[:leaders] = -2.0, 2.0
    P[:leaders, leaders:] = rng.integers(-2, 3, (leaders, program.n - leaders))
    P[leaders:, :leaders] = P[:leaders, leaders:].T
    wider = QuadraticProgram(P, program.c, program.G, program.h, program.A, program.b, lower, upper)
    return replace(problem, program=wider, integers=np.arange(leaders))


def least(problem: EquilibriumProgram) -> tuple[Status, float]:
    """Return the status and the value of the best of all pieces, integers enumerated."""
    if not problem.integers.size:
        known = truth(problem)
        return known.status, known.value
    program, whole = problem.program, problem.integers
    P, best = sp.csr_array(program.P).toarray(), INF
    ranges = [range(int(program.lower[j]), int(program.upper[j]) + 1) for j in whole]
    others = np.setdiff1d(np.arange(program.n), whole)
    for chosen in itertools.product(*ranges):
        lower, upper, x = np.array(program.lower), np.array(program.upper), np.zeros(program.n)
        lower[whole] = upper[whole] = x[whole] = chosen
        Q = np.zeros_like(P)
        Q[np.ix_(others, others)] = P[np.ix_(others, others)]
        slope = np.where(np.isin(np.arange(program.n), others), program.c + P @ x, 0.0)
        fixed = QuadraticProgram(Q, slope, program.G, program.h, program.A, program.b, lower, upper)
        known = truth(replace(problem, program=fixed, integers=(), offset=program.objective(x)))
        if known.status is Status.UNBOUNDED:
            return known.status, -INF
        best = min(best, known.value)
    return (Status.SOLVED if best < INF else Status.NO_SOLUTION), best


# --- The ways in ---


def from_arrays(problem: EquilibriumProgram, **options: Any) -> Said:
    """Return what the search says."""
    result = minimize_over_solutions(problem, max_seconds=SECONDS, **options)
    return Said(result.status, None if result.x is None else result.value, result.lower_bound)


def from_cvxpy(problem: EquilibriumProgram) -> Said:
    """Return what cvxpy says, given the same rows and pairs."""
    program, n = problem.program, problem.program.n
    x = cp.Variable(n, integer=(problem.integers,)) if problem.integers.size else cp.Variable(n)
    P = sp.csr_array(program.P)
    bent = 0.5 * cp.quad_form(x, cp.psd_wrap(P)) if problem.is_convex else 0.0
    if not problem.is_convex:
        entries = sp.coo_array(P)
        bent = 0.5 * cp.sum(
            [
                a * x[int(i)] * x[int(j)]
                for i, j, a in zip(*entries.coords, entries.data, strict=True)
            ]
        )
    rows: list[Any] = [program.G @ x <= program.h] if program.h.size else []
    rows += [program.A @ x == program.b] if program.b.size else []
    for ends, sign in ((program.lower, 1.0), (program.upper, -1.0)):
        own = np.flatnonzero(np.isfinite(ends))
        rows += [sign * x[own] >= sign * ends[own]] if own.size else []
    pairs = [complements(box(x[problem.first], problem.lower, problem.upper), x[problem.second])]
    stated = cp.Problem(cp.Minimize(bent + program.c @ x + problem.offset), [*rows, *pairs])
    stated.solve(method="LCP", max_seconds=SECONDS)
    result = stated.solver_stats.extra_stats
    return Said(
        result.status, None if result.x is None else float(stated.value), result.lower_bound
    )


def in_pyomo(problem: EquilibriumProgram) -> pe.ConcreteModel:
    """Return the same in Pyomo."""
    m, program, n = pe.ConcreteModel(), problem.program, problem.program.n
    ends = [
        [None if math.isinf(one) else float(one) for one in limits]
        for limits in (program.lower, program.upper)
    ]
    whole = set(problem.integers.tolist())
    m.x = pe.Var(
        range(n),
        bounds=lambda m, j: (ends[0][j], ends[1][j]),
        domain=lambda m, j: pe.Integers if j in whole else pe.Reals,
    )
    P = sp.coo_array(sp.csr_array(program.P))
    bent = sum(
        0.5 * a * m.x[int(i)] * m.x[int(j)] for i, j, a in zip(*P.coords, P.data, strict=True)
    )
    m.goal = pe.Objective(
        expr=bent + sum(float(c) * m.x[j] for j, c in enumerate(program.c)) + problem.offset
    )
    m.rows = pe.ConstraintList()
    for matrix, limit, is_equation in ((program.G, program.h, False), (program.A, program.b, True)):
        for row, right in zip(sp.csr_array(matrix).toarray(), limit, strict=True):
            left = sum(float(a) * m.x[j] for j, a in enumerate(row) if a)
            if row.any():
                m.rows.add(left == float(right) if is_equation else left <= float(right))
            elif right < 0.0 or (is_equation and right):
                m.rows.add(m.x[0] - m.x[0] >= 1.0)
    m.pairs = Complementarity(range(problem.pairs))
    for i, (z, w) in enumerate(zip(problem.first.tolist(), problem.second.tolist(), strict=True)):
        low, high = float(problem.lower[i]), float(problem.upper[i])
        if math.isinf(low) and math.isinf(high):
            m.rows.add(m.x[w] == 0.0)
        elif math.isinf(high):
            m.pairs[i] = complementary(m.x[z] >= low, m.x[w] >= 0)
        elif math.isinf(low):
            m.pairs[i] = complementary(m.x[z] <= high, m.x[w] <= 0)
        else:
            m.pairs[i] = complementary(pe.inequality(low, m.x[z], high), m.x[w])
    return m


def from_pyomo(problem: EquilibriumProgram) -> Said:
    """Return what Pyomo says."""
    m, solver = in_pyomo(problem), pe.SolverFactory("lcp_plugin")
    solver.solve(m, timelimit=SECONDS)
    found = solver.result
    return Said(
        found.status, None if found.x is None else float(pe.value(m.goal)), found.lower_bound
    )


def from_ampl(problem: EquilibriumProgram) -> Said:
    """Return what the executable writes: no bound, and a value at its x."""
    from lcp_plugin.commands.ampl import main
    from lcp_plugin.interfaces.nl import read_nl

    with tempfile.TemporaryDirectory() as folder:
        stub = Path(folder) / "m"
        lcp_plugin.pyomo.write_nl(in_pyomo(problem), stub.with_suffix(".nl"))
        main([str(stub), "-AMPL", f"max_seconds={SECONDS}"])
        found, model = read_sol(stub.with_suffix(".sol")), read_nl(stub.with_suffix(".nl"))
    codes = {0: Status.SOLVED, 200: Status.NO_SOLUTION, 300: Status.UNBOUNDED}
    values = None
    if found.values is not None:
        from lcp_plugin.interfaces.nl.checks import evaluated

        values = float(evaluated(model.content, np.asarray(found.values))[1][0])
    return Said(codes.get(found.code, Status.STALLED), values, None)


WAYS: dict[str, Callable[[EquilibriumProgram], Said]] = {
    "arrays": from_arrays,
    "arrays, prove": lambda problem: from_arrays(problem, prove=True),
    "cvxpy": from_cvxpy,
    "Pyomo": from_pyomo,
    "AMPL": from_ampl,
}


def ways_of(problem: EquilibriumProgram) -> list[str]:
    """Return the ways in that a problem has: without a proof where none is possible."""
    return [name for name in WAYS if name != "arrays, prove" or problem.is_provable]


# --- The judgement ---


def complaints(said: Said, status: Status, value: float) -> list[str]:
    """Return what the truth says against an answer."""
    found, allowed = [], ACCURACY * max(1.0, abs(value)) if math.isfinite(value) else 0.0
    agrees = {Status.NO_SOLUTION: EXCLUDED, Status.UNBOUNDED: FALLS}.get(status, (status,))
    if said.status in (Status.SOLVED, *EXCLUDED, *FALLS) and said.status not in agrees:
        found.append(f"says {said.status.name}, is {status.name}")
    if said.value is not None and said.value < value - 2.0 * allowed:
        found.append(f"value {said.value} below {value}")
    if (
        said.status is Status.SOLVED
        and said.value is not None
        and said.value > value + 2.0 * allowed
    ):
        found.append(f"value {said.value} above {value}")
    if said.bound is not None and said.bound > value + 2.0 * allowed:
        found.append(f"bound {said.bound} above {value}")
    return found


def drawn(seed: int, case: int) -> EquilibriumProgram:
    """Return a problem; every third has integer leaders."""
    rng = np.random.default_rng([59, seed, case])
    return with_integer_leaders(rng) if case % 3 == 2 else random_problem(rng, most=10)


def main() -> int:
    """Run the campaign, print the tallies, return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    kinds: Counter[str] = Counter()
    wrong = 0
    for case in range(asked.cases):
        problem = drawn(asked.seed, case)
        try:
            known = least(problem)
        except ArithmeticError as error:
            kinds[f"not judged: {error}"] += 1
            continue
        for name in ways_of(problem):
            said = WAYS[name](problem)
            found = complaints(said, *known)
            kinds[f"{name:14} is {known[0].name:12} says {said.status.name}"] += 1
            wrong += bool(found)
            if found:
                print(case, name, problem, *found, sep="; ", flush=True)
    for kind, count in sorted(kinds.items()):
        print(f"{count:6} {kind}")
    print(f"{wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
