"""Random leaders and published models: ours beside Pyomo's product form by SCIP and big-M by HiGHS.

Run ``python tests/campaigns/best_equilibria_beside_others.py``; ``--quick`` runs a part, ``--ours`` no rival. Sixty
random leaders over followers that solve convex programs (bilevel linear and convex, tolls, Stackelberg, taxes, yes or
no in a network; 10 to 100 pairs) and twenty published models of MacMPEC are Pyomo models, so that all solvers read the
same. Others are ``mpec.simple_nonlinear``, pairs as products, by SCIP, and ``mpec.simple_disjunction`` with
``gdp.bigm``, M = 10⁴, by HiGHS where the objective is linear. A search has 5 s; seconds that
are printed are the processor's.

Every point, a rival's too, is held against the followers' own program, solved for its leader's values by Clarabel, and
``*`` marks what that excludes. Up to 14 pairs all pieces are solved (convex ones by HiGHS and Clarabel, others by SCIP,
which sees no pair there). Wrong are: a point of ours that is none, a bound above the pieces' or any rival's point that
is one, an optimal value that is worse than one of these. Exit code 1 where anything is.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import pyomo.environ as pe
import pyscipopt
import scipy.sparse as sp
from pyomo.mpec import Complementarity, complements

import lcp_plugin.pyomo  # noqa: F401 - registers the solver
from lcp_plugin import EquilibriumProgram, QuadraticProgram
from lcp_plugin.modeling.best_equilibrium import stated_program

sys.path.insert(0, str(Path(__file__).parents[1]))
from best_equilibria import Pieces
from macmpec import COLLECTION

SECONDS = 5.0
ALLOWED = 2e-6  # of max(1, |value|): values that agree; what followers lose, and what a row or a pair misses
BIG = 1e4
MOST_PAIRS, MOST_PIECES = 14, 5000  # that are enumerated
PUBLISHED = (
    "bard1",
    "bard2",
    "gauvin",
    "ex9_1_1",
    "ex9_1_2",
    "ex9_1_4",
    "ex9_1_6",
    "ex9_1_9",
    "ex9_2_1",
    "ex9_2_2",
    "ex9_2_4",
    "ex9_2_6",
    "ex9_2_9",
    "flp2",
    "nash1",
    "jr1",
    "kth3",
    "scholtes5",
    "sl1",
    "qpec1",
)


# --- Leaders ---


@dataclass
class Leader:
    """Minimise ½ vᵀQ v + dᵀv, v = (x, y), over x in a box, where y is least of the followers' program.

    That is ½ yᵀP y + (c + C x)ᵀy over y ≥ 0, G y ≤ h + H x, A y = b.
    """

    Q: Any
    d: Any
    box: tuple[float, float]
    P: Any
    c: Any
    C: Any
    G: Any = None
    h: Any = None
    H: Any = None
    A: Any = None
    b: Any = None
    is_whole: bool = False

    def __post_init__(self) -> None:
        n, m = self.C.shape
        if self.G is None:
            self.G, self.h, self.H = np.zeros((0, n)), np.zeros(0), np.zeros((0, m))
        if self.A is None:
            self.A, self.b = np.zeros((0, n)), np.zeros(0)

    def stated(self) -> EquilibriumProgram:
        """The optimality conditions: unknowns x, y, the multipliers of rows, and the other sides of pairs."""
        (n, m), k, rows = self.C.shape, self.h.size, self.b.size
        nothing = np.zeros((k, k))
        A = np.block(
            [
                [self.C, self.P, self.G.T, self.A.T, -np.eye(n), np.zeros((n, k))],
                [self.H, -self.G, nothing, np.zeros((k, rows)), np.zeros((k, n)), -np.eye(k)],
                [np.zeros((rows, m)), self.A, np.zeros((rows, k + rows + n + k))],
            ]
        )
        width, other = A.shape[1], m + n + k + rows
        Q, d = np.zeros((width, width)), np.zeros(width)
        Q[: m + n, : m + n], d[: m + n] = self.Q, self.d
        lower, upper = np.zeros(width), np.full(width, np.inf)
        lower[:m], upper[:m] = self.box
        lower[m + n + k : other] = -np.inf
        first = np.arange(m, m + n + k)
        program = QuadraticProgram(
            Q, d, A=A, b=np.concatenate([-self.c, -self.h, self.b]), lower=lower, upper=upper
        )
        whole = np.arange(m) if self.is_whole else np.zeros(0, dtype=int)
        return EquilibriumProgram(program, first, other + np.arange(n + k), integers=whole)

    def missed(self, v: np.ndarray) -> float:
        """What followers lose at their part of v beside their best answer, and what they miss of their rows."""
        x, y = v[: self.C.shape[1]], v[self.C.shape[1] : sum(self.C.shape)]
        cost, limit = self.c + self.C @ x, self.h + self.H @ x
        best = cp.Variable(y.size, nonneg=True)
        rows = [self.G @ best <= limit] * bool(limit.size) + [self.A @ best == self.b] * bool(
            self.b.size
        )
        goal = 0.5 * cp.quad_form(best, cp.psd_wrap(self.P)) + cost @ best
        least = cp.Problem(cp.Minimize(goal), rows).solve(solver=cp.CLARABEL)
        lost = (0.5 * y @ self.P @ y + cost @ y - least) / max(1.0, abs(least))
        beside = [
            -y,
            self.G @ y - limit,
            np.abs(self.A @ y - self.b),
            self.box[0] - x,
            x - self.box[1],
        ]
        return max(lost, *(float(one.max(initial=0.0)) / (1.0 + np.abs(v).max()) for one in beside))


def leader(kind: str, pairs: int, seed: int) -> Leader:
    """Return a random leader with so many pairs."""
    rng = np.random.default_rng([59, seed, pairs])
    return KINDS[kind](rng, pairs)


def linear(rng: Any, k: int) -> Leader:
    """Followers with a definite matrix of six entries a row, and prices on everything."""
    m = max(2, k // 10)
    square = rng.standard_normal((k, k)) * (rng.random((k, k)) < min(1.0, 6.0 / k))
    return Leader(
        np.zeros((m + k, m + k)),
        rng.standard_normal(m + k),
        (-1.0, 1.0),
        square @ square.T + np.eye(k),
        rng.standard_normal(k),
        rng.standard_normal((k, m)),
    )


def convex(rng: Any, k: int) -> Leader:
    """The same, and the leader wants x = 0, y = ½."""
    found = linear(rng, k)
    found.Q = 2.0 * np.eye(found.d.size)
    found.d[-k:] -= 1.0
    return found


def tolls(rng: Any, pairs: int) -> Leader:
    """Tolls on one of five parallel roads, and travel times a + b · flow: the operator's income toll · flow."""
    roads, groups = 5, pairs // 5
    k = roads * groups
    C, A = np.zeros((k, groups)), np.kron(np.eye(groups), np.ones(roads))
    C[::roads] = np.eye(groups)
    Q = np.block([[np.zeros((groups, groups)), -C.T], [-C, np.zeros((k, k))]])
    return Leader(
        Q,
        np.zeros(groups + k),
        (0.0, 10.0),
        np.diag(rng.uniform(0.2, 1, k)),
        rng.uniform(1, 3, k),
        C,
        A=A,
        b=rng.uniform(4, 8, groups),
    )


def stackelberg(rng: Any, pairs: int) -> Leader:
    """An output in each market before five Cournot followers with capacities, price less two times quantity."""
    firms, markets = 5, pairs // 10
    k, start = firms * markets, rng.uniform(20, 40)
    share = np.kron(np.eye(markets), np.ones((firms, 1)))
    Q = np.block([[2.0 * np.eye(markets), share.T], [share, np.zeros((k, k))]])
    d = np.concatenate([np.full(markets, 2.0 - start), np.zeros(k)])
    return Leader(
        Q,
        d,
        (0.0, 40.0),
        share @ share.T + np.eye(k),
        rng.uniform(1, 6, k) - start,
        share,
        np.eye(k),
        rng.uniform(2, 6, k),
        np.zeros((k, markets)),
    )


def taxes(rng: Any, k: int) -> Leader:
    """A tax on each of some goods that firms make with different emissions: welfare less squared emissions."""
    goods = max(2, k // 5)
    own = np.zeros((k, goods))
    own[np.arange(k), np.arange(k) % goods] = 1.0
    half = rng.uniform(0, 1, (goods, goods)) * (rng.random((goods, goods)) < 2.0 / goods)
    P = own @ (half @ half.T + np.eye(goods)) @ own.T + np.diag(rng.uniform(0.2, 1, k))
    c, emits = rng.uniform(1, 8, k) - 12.0, rng.uniform(0, 1, k)
    Q = np.zeros((goods + k, goods + k))
    Q[goods:, goods:] = P + 0.5 * np.outer(emits, emits)
    return Leader(Q, np.concatenate([np.zeros(goods), c]), (0.0, 10.0), P, c, own)


def network(rng: Any, pairs: int) -> Leader:
    """Yes or no to wider roads of a random network: length of all ways and price, drivers take the quickest ways."""
    roads = pairs // 2
    nodes, built = max(3, roads // 3), max(1, roads // 5)
    ends = np.array([rng.choice(nodes, 2, replace=False) for _ in range(roads)])
    incidence = np.zeros((nodes, roads + 1))
    incidence[ends[:, 0], range(roads)], incidence[ends[:, 1], range(roads)] = -1.0, 1.0
    incidence[0, roads], incidence[-1, roads] = -1.0, 1.0  # one way is always there, and long
    length, demand = np.append(rng.uniform(1, 4, roads), 20.0), np.zeros(nodes)
    demand[0], demand[-1] = -6.0, 6.0
    wider = np.zeros((roads, built))
    wider[rng.choice(roads, built, replace=False), range(built)] = 2.0
    return Leader(
        np.zeros((built + roads + 1,) * 2),
        np.concatenate([rng.uniform(1, 5, built), length]),
        (0.0, 1.0),
        np.diag(np.append(rng.uniform(0.1, 1, roads), 0.1)),
        length,
        np.zeros((roads + 1, built)),
        np.eye(roads, roads + 1),
        rng.uniform(1, 3, roads),
        wider,
        incidence[1:],
        demand[1:],
        is_whole=True,
    )


KINDS: dict[str, Callable[[Any, int], Leader]] = {
    one.__name__: one for one in (linear, convex, tolls, stackelberg, taxes, network)
}


class Case(NamedTuple):
    """A model, which lists of its unknowns are (x, y), and what is known of it."""

    stated: EquilibriumProgram
    leader: Leader | None
    optimum: float = np.nan


def pyomo_model(stated: EquilibriumProgram) -> pe.ConcreteModel:
    """Return the model as Pyomo's, slacks put into the pairs."""
    program, m = stated.program, pe.ConcreteModel()
    ends = [
        [None if np.isinf(end) else float(end) for end in side]
        for side in (program.lower, program.upper)
    ]
    whole = set(stated.integers.tolist())
    m.x = pe.Var(
        range(program.n),
        bounds=lambda m, j: (ends[0][j], ends[1][j]),
        domain=lambda m, j: pe.Integers if j in whole else pe.Reals,
    )

    def row(matrix: Any, k: int) -> Any:
        start, stop = matrix.indptr[k : k + 2]
        return sum(
            a * m.x[j]
            for j, a in zip(
                matrix.indices[start:stop].tolist(), matrix.data[start:stop].tolist(), strict=True
            )
        )

    G, A, P = (sp.csr_array(one) for one in (program.G, program.A, program.P))
    m.rows = pe.ConstraintList()
    for k in range(program.h.size):
        m.rows.add(row(G, k) <= float(program.h[k]))
    for k in range(program.b.size):
        m.rows.add(row(A, k) == float(program.b[k]))
    if np.isfinite(stated.upper).any():
        raise ValueError("a box, which the rivals' forms do not take")
    z, w = stated.first.tolist(), stated.second.tolist()
    m.pair = Complementarity(
        range(len(z)),
        rule=lambda m, i: complements(m.x[z[i]] - float(stated.lower[i]) >= 0, m.x[w[i]] >= 0),
    )
    linear = sum(float(a) * m.x[j] for j, a in enumerate(program.c) if a)
    m.goal = pe.Objective(
        expr=linear
        + sum(0.5 * m.x[k] * row(P, k) for k in range(program.n) if P[[k]].nnz)
        + stated.offset
    )
    return m


# --- The solvers ---


class Answer(NamedTuple):
    """Whether it is called optimal, the point, the bound, and whose that is or what went wrong."""

    is_done: bool
    x: np.ndarray | None
    bound: float
    note: str


def ours(model: Any) -> Answer:
    """By SCIP, pairs as special ordered sets, and solved again."""
    solver = pe.SolverFactory("lcp_plugin")
    results = solver.solve(model, options={"max_seconds": SECONDS})
    done = results.solver.termination_condition == pe.TerminationCondition.optimal
    x = (
        None
        if solver.result.x is None
        else np.array([pe.value(model.x[j], exception=False) for j in model.x])
    )
    return Answer(done, x, solver.result.lower_bound, str(solver.result.bound_by))


def of_products(model: Any) -> Answer:
    """SCIP's own reading of an .nl file in which pairs are products."""
    pe.TransformationFactory("mpec.simple_nonlinear").apply_to(model)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "m.nl")
        model.write(str(path), io_options={"symbolic_solver_labels": True})
        scip = pyscipopt.Model()
        scip.hideOutput()
        scip.readProblem(str(path))
    scip.setParams({"limits/time": SECONDS, "limits/gap": 1e-6})
    scip.optimize()
    x = None
    if scip.getNSols():
        values = {one.name: scip.getVal(one) for one in scip.getVars()}
        x = np.array([values.get(f"x[{j}]", 0.0) for j in model.x])
    return Answer(scip.getStatus() in ("optimal", "gaplimit"), x, scip.getDualbound(), "SCIP")


def big_m(model: Any) -> Answer:
    """HiGHS, each pair with a binary."""
    pe.TransformationFactory("mpec.simple_disjunction").apply_to(model)
    pe.TransformationFactory("gdp.bigm").apply_to(model, bigM=BIG)
    solver = pe.SolverFactory("appsi_highs")
    results = solver.solve(model, options={"time_limit": SECONDS}, load_solutions=False)
    if results.solver.termination_condition != pe.TerminationCondition.optimal:
        return Answer(False, None, -math.inf, "")
    model.solutions.load_from(results)
    x = np.array([pe.value(model.x[j], exception=False) or 0.0 for j in model.x])
    return Answer(True, x, pe.value(model.goal), "HiGHS")


SOLVERS = {"ours": ours, "products, SCIP": of_products, "big-M, HiGHS": big_m}


# --- The judgement ---


def is_point(case: Case, x: np.ndarray) -> bool:
    """Whether followers' own program, or the rows and pairs of a published model, agree."""
    if case.leader is not None:
        whole = x[case.stated.integers]
        return case.leader.missed(x) <= ALLOWED and bool(
            (np.abs(whole - np.rint(whole)) <= ALLOWED).all()
        )
    return case.stated.excess(x) <= ALLOWED * (1.0 + np.abs(x).max())


def least_of_pieces(problem: EquilibriumProgram) -> float | None:
    """Return the least of all pieces, each solved; None where there are too many."""
    pieces, best = Pieces(problem), math.inf
    for count, cases in enumerate(pieces.not_empty([])):
        if count >= MOST_PIECES:
            return None
        if problem.has_convex_objective and not problem.integers.size:
            x = pieces.least(cases)
            best = min(best, -math.inf if x is None else problem.objective(x))
        else:
            best = min(best, least_of_piece(problem, *pieces.bounds(cases)))
    return best


def least_of_piece(problem: EquilibriumProgram, lower: np.ndarray, upper: np.ndarray) -> float:
    """Return what SCIP finds where bounds say which case each pair has."""
    program, scip, whole = problem.program, pyscipopt.Model(), set(problem.integers.tolist())
    scip.hideOutput()
    x = [
        scip.addVar(
            lb=None if np.isinf(low) else low,
            ub=None if np.isinf(high) else high,
            vtype="I" if j in whole else "C",
        )
        for j, (low, high) in enumerate(zip(lower, upper, strict=True))
    ]
    for matrix, limits, is_equation in (
        (program.G, program.h, False),
        (program.A, program.b, True),
    ):
        for row, limit in zip(sp.csr_array(matrix).toarray(), limits, strict=True):
            total = pyscipopt.quicksum(float(row[j]) * x[j] for j in np.flatnonzero(row))
            scip.addCons(total == limit if is_equation else total <= limit)
    height, P = scip.addVar(lb=None), sp.coo_array(program.P)
    scip.addCons(
        pyscipopt.quicksum(
            0.5 * a * x[i] * x[j] for i, j, a in zip(P.row, P.col, P.data, strict=True)
        )
        + pyscipopt.quicksum(float(a) * one for a, one in zip(program.c, x, strict=True))
        <= height
    )
    scip.setObjective(height)
    scip.setParams({"limits/gap": 1e-8, "numerics/feastol": 1e-8})
    scip.optimize()
    return scip.getDualbound() + problem.offset if scip.getNSols() else math.inf


def wrongs(case: Case, found: dict[str, Answer], truth: float | None) -> list[str]:
    """What is wrong with our answer."""
    mine, said = found["ours"], []
    known = {} if truth is None else {"pieces": truth}
    if np.isfinite(case.optimum):
        known["published"] = case.optimum
    for name, one in found.items():
        if name != "ours" and one.x is not None and is_point(case, one.x):
            known[name] = case.stated.objective(one.x)
    if mine.x is not None and not is_point(case, mine.x):
        said.append("no equilibrium")
    value = math.inf if mine.x is None else case.stated.objective(mine.x)
    allowed = (
        2.0 * ALLOWED * max(1.0, *(abs(one) for one in known.values() if np.isfinite(one)))
        if known
        else 0.0
    )
    for name, one in known.items():
        if mine.bound > one + allowed:
            said.append(f"bound {mine.bound:.9g} above {name}'s {one:.9g}")
        if mine.is_done and value > one + allowed:
            said.append(f"value above {name}'s {one:.9g}")
        if value > one + allowed and not mine.is_done:
            said.append(f"(open, {name} better: {one:.9g})")
    if truth is not None and value < truth - allowed:
        said.append(f"value below all pieces' {truth:.9g}")
    return said


def cases(quick: bool) -> dict[str, Callable[[], Case]]:
    """Return what makes each case, by its name."""
    found: dict[str, Callable[[], Case]] = {}
    for name in PUBLISHED:

        def published(name: str = name) -> Case:
            problem = COLLECTION[name].state()
            sign = 1.0 if isinstance(problem.objective, cp.Minimize) else -1.0
            return Case(stated_program(problem)[0], None, sign * COLLECTION[name].optimum)

        found[name] = published
    sizes = (10, 20, 30) if quick else (10, 20, 30, 50, 100)
    for kind, pairs, seed in itertools.product(KINDS, sizes, range(1 if quick else 2)):

        def random(kind: str = kind, pairs: int = pairs, seed: int = seed) -> Case:
            made = leader(kind, pairs, seed)
            return Case(made.stated(), made)

        found[f"{kind} {pairs} {seed}"] = random
    return found


def main() -> int:
    """Run the campaign, print a line a model and the sums, return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--ours", action="store_true")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    solvers = {"ours": ours} if given.ours else SOLVERS
    for kind in KINDS:  # compiles, or loads
        ours(pyomo_model(leader(kind, 10, 9).stated()))
    counts: dict[str, dict[str, float]] = {name: defaultdict(float) for name in solvers}
    wrong = enumerated = total = 0
    print(f"{'':18}", *(f"{name:>27}" for name in solvers), flush=True)
    for name, make in cases(given.quick).items():
        if given.only not in name:
            continue
        case, found, line = make(), dict[str, Answer](), [f"{name:18}"]
        total += 1
        for solver, run in solvers.items():
            model, begin, own = pyomo_model(case.stated), time.process_time(), counts[solver]
            try:
                answer = run(model)
            except Exception as error:  # a rival's refusal
                answer = Answer(False, None, -math.inf, type(error).__name__)
            seconds = time.process_time() - begin
            found[solver] = answer
            holds = answer.x is not None and is_point(case, answer.x)
            own["seconds"] += seconds
            own["solved"] += answer.is_done and holds
            own["no equilibrium"] += answer.x is not None and not holds
            value = np.nan if answer.x is None else case.stated.objective(answer.x)
            marks = ("" if holds or answer.x is None else "*") + ("" if answer.is_done else " open")
            line.append(f"{value:13.7g}{marks:6} {answer.note[:6]:6} {seconds:5.1f}s")
        truth = least_of_pieces(case.stated) if case.stated.pairs <= MOST_PAIRS else None
        enumerated += truth is not None
        said = wrongs(case, found, truth)
        wrong += any(not one.startswith("(") for one in said)
        print(*line, "; ".join(said), flush=True)
    for solver, own in counts.items():
        print(
            f"{solver:15} {own['solved']:.0f} of {total} solved, {own['seconds']:.1f} s, "
            f"{own['no equilibrium']:.0f} points are no equilibria"
        )
    print(f"{wrong} wrong, {enumerated} held against all their pieces")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
