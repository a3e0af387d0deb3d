"""Convex programs as test sets have them: graded, redundant, degenerate, structured, of 5 to 2000 unknowns.

The solutions come first: x and its multipliers are chosen, and then c, h and b are computed from them. Two families of
duals are the exception, and are checked only by their optimality conditions. Each program is solved by
``solve_program`` and by ``solve(lcp_from_qp(program))`` with ``recover``. The campaign counts

- unsolved: programs with a minimum that are not called optimal, and other programs without a proof.
- wrong: programs called optimal although the objective is off by more than 1e-6 · (1 + |value|), or the conditions,
  measured here, fail, or the program is infeasible or unbounded. Also solvable programs that are disproved.
- at odds: programs SOLVED as a complementarity problem and not optimal as a program, or vice versa.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, QuadraticProgram, solve

TOLERANCE = 1e-6
STATES, INPUTS = 4, 2  # of a system that is controlled
STRUCTURES = (
    "sparse",
    "dense",
    "staircase",
    "block-angular",
    "network",
    "transport",
    "group sums",
    "chain",
)
INF = np.inf


@dataclass
class Recipe:
    """Parameters of a family; numbers are probabilities, or decimal exponents of sizes."""

    structures: tuple[str, ...] = ("sparse", "dense", "staircase", "block-angular")
    linear: float = 0.4  # chance of an LP
    rank: float = 0.5  # of P, at most, relative to n
    curvature: float = 0.0  # decimal exponent of P
    rows: float = 0.0  # decimal exponents, as large as ±
    columns: float = 0.0
    redundant: float = 0.0  # equalities that are sums of others, relative to the independent ones
    digits: int = 16  # of their right-hand sides
    free: float = 0.2  # chance of a column without bounds
    tight: float = 0.5  # chance that a row, or a bound, is met
    strict: float = 0.9  # chance that what is met has a multiplier
    far: float = 0.0  # chance of a bound of 1e9
    objective: float = 0.0  # decimal exponent of the objective, as large as ±
    fixed: bool = False  # as many equations as unknowns
    ranges: float = 0.2  # chance of a second limit
    largest: int = 2000
    spoilt: str = ""  # "infeasible" or "unbounded"
    integers: bool = False
    wide: float = 0.0  # decimal exponents of x and of the multipliers
    ridge: float = 0.0  # multiple of the identity in P
    condition: float = 0.0  # decimal exponent of P's condition number


FAMILIES: dict[str, Recipe] = {
    "plain": Recipe(),
    "linear": Recipe(linear=1.0),
    "graded rows": Recipe(rows=6.0),
    "graded columns": Recipe(columns=6.0),
    "graded rows, columns": Recipe(rows=6.0, columns=6.0),
    "graded a little": Recipe(rows=4.0, columns=3.0, linear=0.2),
    "redundant": Recipe(redundant=0.5),
    "redundant, rounded": Recipe(redundant=0.5, digits=10),
    "free columns": Recipe(free=0.8, linear=0.5),
    "degenerate": Recipe(tight=0.9, strict=0.3),
    "degenerate, integer": Recipe(tight=0.95, strict=0.3, integers=True, linear=0.6),
    "staircase": Recipe(structures=("staircase",), free=0.3, columns=1.0),
    "block-angular": Recipe(structures=("block-angular",)),
    "network": Recipe(structures=("network",), integers=True, linear=0.7, free=0.0),
    "transport": Recipe(structures=("transport",), integers=True, linear=0.7, free=0.0),
    "group sums": Recipe(structures=("group sums",), free=0.0),
    "chain": Recipe(structures=("chain",), linear=0.0, free=1.0),
    "huge bounds": Recipe(far=0.5),
    "objective scaled": Recipe(objective=8.0),
    "tiny P": Recipe(curvature=-7.0, linear=0.0),
    "large P": Recipe(curvature=7.0, linear=0.0),
    "low rank": Recipe(rank=0.05, linear=0.0, structures=("dense", "sparse")),
    "fixed by equations": Recipe(fixed=True, free=0.5),
    "wide answers": Recipe(wide=4.0),
    "Netlib-like": Recipe(
        rows=2.0,
        columns=2.0,
        redundant=0.2,
        digits=12,
        free=0.1,
        tight=0.8,
        strict=0.5,
        far=0.1,
        linear=0.5,
        wide=2.0,
        structures=("staircase", "block-angular", "sparse"),
        ranges=0.3,
    ),
    "everything": Recipe(
        structures=STRUCTURES,
        rows=3.0,
        columns=3.0,
        redundant=0.3,
        digits=11,
        tight=0.8,
        strict=0.5,
        far=0.2,
        objective=3.0,
        wide=2.0,
    ),
    "infeasible": Recipe(spoilt="infeasible", integers=True, structures=STRUCTURES, largest=300),
    "infeasible, graded": Recipe(
        spoilt="infeasible", integers=True, rows=4.0, columns=3.0, largest=300
    ),
    "unbounded": Recipe(spoilt="unbounded", integers=True, structures=STRUCTURES, largest=300),
    "unbounded, graded": Recipe(
        spoilt="unbounded", integers=True, rows=4.0, columns=3.0, largest=300
    ),
    "strictly convex": Recipe(linear=0.0, ridge=0.1),
    "condition 1e8": Recipe(linear=0.0, condition=8.0, structures=("sparse", "dense"), largest=200),
    "condition 1e10": Recipe(
        linear=0.0, condition=10.0, structures=("sparse", "dense"), largest=200
    ),
    "no bounds": Recipe(free=1.0),
    "stable control": Recipe(structures=("stable control",), linear=0.0),
    "unstable control": Recipe(structures=("unstable control",), linear=0.0, largest=200),
    "SVM dual": Recipe(largest=200),
    "portfolio dual": Recipe(largest=200),
}
SOLVABLE = tuple(family for family, recipe in FAMILIES.items() if not recipe.spoilt)


def planted(
    family: str, rng: np.random.Generator, largest: int = 2000
) -> tuple[QuadraticProgram, float]:
    """Return a program of the family and its minimum, NaN if it has none or if it is unknown."""
    recipe = FAMILIES[family]
    most = min(largest, recipe.largest)
    n = int(np.rint(5.0 * (most / 5.0) ** rng.random()))
    if family in DUALS:
        return DUALS[family](n, rng), np.nan
    A, G, P = constraints_and_curvature(recipe, n, rng)
    n = P.shape[0]
    if recipe.redundant and A.shape[0]:
        sums = sp.random_array(
            (int(np.ceil(recipe.redundant * A.shape[0])), A.shape[0]),
            density=min(1.0, 3.0 / A.shape[0]),
            rng=rng,
        )
        A = sp.csr_array(sp.vstack([A, sums @ A]))
    wide = 10.0 ** rng.uniform(-recipe.wide / 2.0, recipe.wide / 2.0, n)
    x = rng.integers(-3, 4, n).astype(float) if recipe.integers else rng.standard_normal(n) * wide
    is_free, met, below = (
        rng.random(n) < chance for chance in (recipe.free, recipe.tight / 2.0, 0.5)
    )
    lower, upper = bounds(recipe, x, met, below, rng)
    lower[is_free], upper[is_free], met[is_free] = -INF, INF, False
    mu = np.where(met & (rng.random(n) < recipe.strict), rng.uniform(0.1, 2.0, n), 0.0) * wide[::-1]
    tight = rng.random(G.shape[0]) < recipe.tight / 2.0
    y = np.where(
        tight & (rng.random(tight.size) < recipe.strict), rng.uniform(0.1, 2.0, tight.size), 0.0
    )
    y *= 10.0 ** rng.uniform(-recipe.wide / 2.0, recipe.wide / 2.0, y.size)
    v = rng.standard_normal(A.shape[0])
    h = G @ x + np.where(tight, 0.0, rng.uniform(0.1, 2.0, tight.size) * (0.1 + abs(G) @ abs(x)))
    b = A @ x
    if recipe.digits < 16:
        b = np.array([float(f"%.{recipe.digits - 1}e" % value) for value in b])
    c = np.where(below, mu, -mu) - P @ x - G.T @ y - A.T @ v
    value = 0.5 * x @ (P @ x) + c @ x
    return finished(recipe, (P, c, G, h, A, b, lower, upper), float(value), rng)


def case(family: str, seed: int, k: int, largest: int = 2000) -> tuple[QuadraticProgram, float]:
    """Return case k of a campaign with that seed."""
    return planted(family, np.random.default_rng([seed, k, list(FAMILIES).index(family)]), largest)


def bounds(
    recipe: Recipe, x: Any, met: Any, below: Any, rng: np.random.Generator
) -> tuple[Any, Any]:
    """Return bounds: active at x if `met`, on the side of `below`; else distant or infinite."""
    n = x.size
    away = rng.integers(1, 4, n) if recipe.integers else rng.uniform(0.1, 3.0, n) * (1.0 + abs(x))
    away = np.where(rng.random(n) < recipe.far, 1e9, np.where(rng.random(n) < 0.5, INF, away))
    near = np.where(met, 0.0, away)
    other = np.where(rng.random(n) < 0.3, away, INF)
    return x - np.where(below, near, other), x + np.where(below, other, near)


def constraints_and_curvature(
    recipe: Recipe, n: int, rng: np.random.Generator
) -> tuple[Any, Any, Any]:
    """Return A, G and P in about n unknowns."""
    structure = recipe.structures[int(rng.integers(len(recipe.structures)))]
    if recipe.fixed:
        n = min(n, 600)
        A = entries(n, n, rng, recipe.integers, structure == "dense")
        G = entries(n // 3, n, rng, recipe.integers)
    elif structure in ("sparse", "dense"):
        n = min(n, 300) if structure == "dense" else n
        p, m = int(rng.integers(0, n // 2 + 1)), int(rng.integers(1, n + 1))
        A, G = (entries(k, n, rng, recipe.integers, structure == "dense") for k in (p, m))
    else:
        A, G = STRUCTURED[structure](n, rng, recipe.integers)
    n = G.shape[1]
    return A, G, curvature(recipe, n, rng, structure)


def entries(
    rows: int, n: int, rng: np.random.Generator, integers: bool, dense: bool = False
) -> sp.csr_array:
    """Return rows with a few entries each, or full ones."""
    density = 1.0 if dense else min(1.0, rng.uniform(1.5, 5.0) / n)
    found = sp.random_array((rows, n), density=density, rng=rng, format="csr")
    size = rng.standard_normal(found.nnz)
    found.data = (
        np.where(size < 0.0, -1.0, 1.0) * rng.integers(1, 4, found.nnz) if integers else size
    )
    return sp.csr_array(found)


def staircase(n: int, rng: np.random.Generator, integers: bool) -> tuple[Any, Any]:
    """Periods, each tied to the one before."""
    width = max(2, int(rng.integers(2, 21)))
    periods = max(2, n // width)
    height = max(1, width // 2)
    here = sp.block_diag(
        [entries(height, width, rng, integers) for _ in range(periods)], format="csr"
    )
    before = sp.block_diag(
        [entries(height, width, rng, integers) for _ in range(periods - 1)], format="csr"
    )
    shifted = sp.vstack(
        [
            sp.csr_array((height, width * periods)),
            sp.hstack([before, sp.csr_array((height * (periods - 1), width))]),
        ]
    )
    return sp.csr_array(here + shifted), entries(max(1, n // 3), width * periods, rng, integers)


def block_angular(n: int, rng: np.random.Generator, integers: bool) -> tuple[Any, Any]:
    """Blocks of their own and a few rows over all of them."""
    width = max(2, int(rng.integers(2, 31)))
    blocks = max(1, n // width)
    own = sp.block_diag(
        [entries(max(1, width // 2), width, rng, integers) for _ in range(blocks)], format="csr"
    )
    shared = sp.random_array(
        (int(rng.integers(1, 8)), width * blocks), density=0.3, rng=rng, format="csr"
    )
    if integers:
        shared.data = np.ones(shared.nnz)
    return own, sp.csr_array(shared)


def network(n: int, rng: np.random.Generator, integers: bool) -> tuple[Any, Any]:
    """Return the node balances of flows along n arcs, with one redundant equality."""
    nodes = max(3, n // int(rng.integers(2, 6)))
    tail, head = rng.integers(0, nodes, (2, n))
    head = np.where(head == tail, (head + 1) % nodes, head)
    arcs = np.arange(n)
    A = sp.csr_array(
        (np.repeat([1.0, -1.0], n), (np.r_[tail, head], np.r_[arcs, arcs])), shape=(nodes, n)
    )
    return A, sp.csr_array((0, n))


def transport(n: int, rng: np.random.Generator, integers: bool) -> tuple[Any, Any]:
    """Return sums of rows and of columns of a transport plan between all sources and targets."""
    sources = max(2, int(rng.integers(2, max(3, int(np.sqrt(n)) + 1))))
    targets = max(2, n // sources)
    ones = np.ones((1, targets))
    A = sp.vstack(
        [
            sp.kron(sp.eye_array(sources), ones),
            sp.kron(np.ones((1, sources)), sp.eye_array(targets)),
        ]
    )
    return sp.csr_array(A), sp.csr_array((0, sources * targets))


def group_sums(n: int, rng: np.random.Generator, integers: bool) -> tuple[Any, Any]:
    """Return sums of groups, the sum of all groups, and inequalities for subsets."""
    group = np.sort(rng.integers(0, max(2, n // 8), n))
    A = sp.csr_array((np.ones(n), (group, np.arange(n))), shape=(group.max() + 1, n))
    A = sp.csr_array(A[np.flatnonzero(np.diff(A.indptr))])
    return sp.csr_array(sp.vstack([A, np.ones((1, n))])), entries(max(1, n // 4), n, rng, True)


def chain(n: int, rng: np.random.Generator, integers: bool) -> tuple[Any, Any]:
    """Second differences of n points, of one sign."""
    n = max(n, 5)
    return sp.csr_array((0, n)), sp.csr_array(
        sp.diags_array([-1.0, 2.0, -1.0], offsets=[0, 1, 2], shape=(n - 2, n))
    )


def control(n: int, rng: np.random.Generator, radius: float) -> tuple[Any, Any]:
    """Steps of a linear system of that spectral radius; unknowns are its states, then its inputs."""
    steps = max(2, n // (STATES + INPUTS))
    move, push = rng.normal(size=(STATES, STATES)), rng.normal(size=(STATES, INPUTS))
    move *= radius / np.abs(np.linalg.eigvals(move)).max()
    here, before = sp.eye_array(steps), sp.eye_array(steps, k=-1)
    A = sp.hstack(
        [
            sp.kron(here, sp.eye_array(STATES)) - sp.kron(before, sp.csr_array(move)),
            -sp.kron(here, sp.csr_array(push)),
        ]
    )
    return sp.csr_array(A), sp.csr_array((0, A.shape[1]))


STRUCTURED = {
    "staircase": staircase,
    "block-angular": block_angular,
    "network": network,
    "transport": transport,
    "group sums": group_sums,
    "chain": chain,
    "stable control": lambda n, rng, integers: control(n, rng, 0.95),
    "unstable control": lambda n, rng, integers: control(n, rng, 1.5),
}


def support_vectors(n: int, rng: np.random.Generator) -> QuadraticProgram:
    """Return the dual of a support vector machine."""
    label = rng.choice([-1.0, 1.0], n)
    label[:2] = 1.0, -1.0
    points = label[:, None] * (rng.normal(size=(n, 3)) + label[:, None])
    most = 10.0 ** rng.uniform(-2, 2)
    return QuadraticProgram(
        points @ points.T, -np.ones(n), A=label[None, :], b=[0.0], lower=0.0, upper=most
    )


def portfolio(n: int, rng: np.random.Generator) -> QuadraticProgram:
    """Return max ν − ½ vᵀΣ⁻¹v, v = μ + ν 1 + λ, λ ≥ 0, the dual of min ½ xᵀΣ x − μᵀx, x ≥ 0, Σ x = 1."""
    factors = rng.normal(size=(n, 3))
    inverse = np.linalg.inv(factors @ factors.T + np.diag(rng.uniform(0.01, 1.0, n)))
    E, mean = np.column_stack([np.eye(n), np.ones(n)]), rng.normal(size=n)
    P = E.T @ inverse @ E
    c = E.T @ inverse @ mean - np.append(np.zeros(n), 1.0)
    return QuadraticProgram((P + P.T) / 2, c, lower=np.append(np.zeros(n), -INF))


DUALS = {"SVM dual": support_vectors, "portfolio dual": portfolio}


def curvature(recipe: Recipe, n: int, rng: np.random.Generator, structure: str) -> Any:
    """Return P: 0, diagonal, or of some rank."""
    if rng.random() < recipe.linear:
        return sp.csr_array((n, n))
    if structure == "chain":
        return sp.csr_array(sp.eye_array(n))
    if recipe.condition:
        Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
        P = Q * np.logspace(0.0, -recipe.condition, n) @ Q.T
        return (P + P.T) / 2
    kind = rng.random()
    if kind < 0.3:
        P = sp.diags_array(np.where(rng.random(n) < 0.7, rng.uniform(0.1, 2.0, n), 0.0)).tocsr()
    else:
        rank = max(1, int(rng.integers(1, max(2, int(recipe.rank * n) + 1))))
        factor = entries(
            n,
            rank,
            rng,
            recipe.integers,
            dense=structure == "dense" or (recipe.rank < 0.1 and n <= 300),
        )
        P = sp.csr_array(factor @ factor.T)
        P = sp.csr_array((P + P.T) * 0.5)
    P = P * 10.0**recipe.curvature
    return sp.csr_array(P + recipe.ridge * sp.eye_array(n)) if recipe.ridge else P


def finished(
    recipe: Recipe, data: tuple[Any, ...], value: float, rng: np.random.Generator
) -> tuple[QuadraticProgram, float]:
    """Return the scaled program, possibly made infeasible or unbounded, and its value."""
    P, c, G, h, A, b, lower, upper = data
    n = c.size
    if recipe.spoilt == "infeasible":
        weights = rng.integers(1, 3, G.shape[0] + A.shape[0]) * (
            rng.random(G.shape[0] + A.shape[0]) < 0.3
        )
        rows = sp.vstack([G, A])
        where = np.isfinite(lower) & np.isfinite(upper)
        total, most = weights @ rows, float(weights @ np.r_[h, b])
        if rng.random() < 0.3 and where.any():  # a row that the bounds do not allow
            total = np.where(where, rng.integers(-2, 3, n), 0.0)
            most = float(np.maximum(total[where] * lower[where], total[where] * upper[where]).sum())
        size = np.abs(total).max(initial=0.0)
        G = sp.vstack([G, -sp.csr_array(total[None, :])])
        h = np.append(h, -most - 10.0 ** rng.uniform(-3, 1) * (1.0 + size + abs(most)))
    if recipe.spoilt == "unbounded":
        P = sp.block_diag([P, sp.csr_array((2, 2))])
        c = np.append(c, [-1.0, 0.5])
        lower = np.append(lower, [0.0, 0.0])
        upper = np.append(upper, [INF] * 2)
        G, A = (sp.hstack([rows, rows[:, [0]], -rows[:, [0]]]) for rows in (G, A))
        n += 2
    rows, equations, columns = (
        10.0 ** rng.uniform(-size, size, count)
        for size, count in (
            (recipe.rows, G.shape[0]),
            (recipe.rows, A.shape[0]),
            (recipe.columns, n),
        )
    )
    if recipe.spoilt:  # sums of rounded rows may be feasible at large norm
        rows, equations, columns = (
            np.exp2(np.rint(np.log2(sizes))) for sizes in (rows, equations, columns)
        )
    C, objective = sp.diags_array(columns), 10.0 ** rng.uniform(-recipe.objective, recipe.objective)
    P, c = sp.csr_array(C @ P @ C) * objective, columns * c * objective
    G, h = sp.diags_array(rows) @ G @ C, rows * h
    A, b = sp.diags_array(equations) @ A @ C, equations * b
    lower, upper = lower / columns, upper / columns
    value = np.nan if recipe.spoilt else value * objective
    with_range = (rng.random(h.size) < recipe.ranges) & (h < INF)
    if not with_range.any() or recipe.spoilt:
        return QuadraticProgram((P + P.T) * 0.5, c, G, h, A, b, lower, upper), value
    low = np.where(with_range, h - 10.0 * (1.0 + np.abs(h)), -INF)
    x_low = h - rows * 1e3 * (1.0 + np.abs(h) / rows)
    low = np.where(with_range, np.minimum(low, x_low), -INF)
    program = QuadraticProgram.from_ranges(
        (P + P.T) * 0.5,
        c,
        sp.vstack([G, A]),
        np.concatenate([low, b]),
        np.concatenate([h, b]),
        lower,
        upper,
    )
    return program, value


def holds(program: QuadraticProgram, answer: Any) -> bool:
    """Return whether the conditions, measured here and row by row, hold to 1e-5."""
    x, y, v = answer.x, answer.inequality, answer.equality
    errors = []
    for matrix, limit, is_equal in ((program.G, program.h, False), (program.A, program.b, True)):
        rows = sp.csr_array(matrix)
        over = rows @ x - limit
        size = 1.0 + abs(rows) @ np.abs(x) + np.where(np.isfinite(limit), np.abs(limit), 0.0)
        errors.append(
            np.where(np.isfinite(limit), np.abs(over) if is_equal else np.maximum(over, 0.0), 0.0)
            / size
        )
    errors += [
        np.maximum(side, 0.0) / (1.0 + np.abs(x)) for side in (program.lower - x, x - program.upper)
    ]
    terms = program.P @ x, program.c, program.G.T @ y, program.A.T @ v, -answer.lower, answer.upper
    size = (
        abs(program.P) @ np.abs(x)
        + np.abs(program.c)
        + abs(program.G).T @ np.abs(y)
        + abs(program.A).T @ np.abs(v)
    )
    errors.append(np.abs(sum(terms)) / (1.0 + size))
    errors += [np.maximum(-part, 0.0) for part in (y, answer.lower, answer.upper)]
    return all(error.max(initial=0.0) <= 10.0 * TOLERANCE for error in errors)


def said(
    program: QuadraticProgram, answer: Any, status: str, value: float, spoilt: str
) -> tuple[bool, bool]:
    """Return whether the status decides the program, and whether it is wrong."""
    if spoilt:
        return status == spoilt.upper(), status in (
            "SOLVED",
            "INFEASIBLE",
            "UNBOUNDED",
        ) and status != spoilt.upper()
    if status in ("INFEASIBLE", "UNBOUNDED"):
        return False, True
    off = not (np.isnan(value) or abs(answer.objective - value) <= TOLERANCE * (1.0 + abs(value)))
    return status == "SOLVED", status == "SOLVED" and (off or not holds(program, answer))


def judged(family: str, program: QuadraticProgram, value: float) -> tuple[list[str], list[str]]:
    """Return wrong results for one program, as a program and as an LCP, and unsolved ones."""
    wrong, left, spoilt = list[str](), list[str](), FAMILIES[family].spoilt
    for way in ("QP", "LCP"):
        fresh = afresh(program)
        if way == "QP":
            result = solve(fresh, max_seconds=60.0)
            answer = result.solution
        else:
            problem = LCP.from_qp(fresh)
            result = solve(problem, max_seconds=60.0)
            answer = problem.origin.recover(result).solution
        status = result.status.name
        if way == "LCP" and spoilt and result.has_no_solution:  # its status has no UNBOUNDED
            status = spoilt.upper()
        is_settled, is_wrong = said(program, answer, status, value, spoilt)
        is_odd = way == "LCP" and result.is_solved != answer.is_optimal()
        text = (
            f"{way}: {status}, objective {answer.objective:.8g} of {value:.8g}, residual "
            f"{answer.primal_residual:.0e}, gap {answer.duality_gap:.0e}, {result.iterations} steps"
        )
        if is_wrong:
            wrong.append(text)
        elif is_odd or not (
            is_settled or (spoilt and status not in ("SOLVED", "INFEASIBLE", "UNBOUNDED"))
        ):
            left.append(text)
    return wrong, left


def afresh(program: QuadraticProgram) -> QuadraticProgram:
    """Return the program with empty caches."""
    names = ("P", "c", "G", "h", "A", "b", "lower", "upper")
    made = QuadraticProgram(**{name: getattr(program, name) for name in names})
    made.__dict__["ranges"] = program.ranges
    return made
