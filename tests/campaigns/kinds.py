"""The kinds of the campaign (tests/campaign.py): one function each, which draws a problem and yields findings."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from collection.judgement import false_claim, shortfall
from oracles.exact import Exact, bound_violations
from oracles.exact_criterion import failures
from oracles.relations import EXACT, bits, scaled
from oracles.truth import SOLVABLE, ExactData, decide

from lcp_plugin import (
    LCP,
    InvalidProblem,
    Status,
    UnsuitableMatrix,
    UnsuitableProblem,
    all_solutions,
    certify,
    error_bound,
    solve,
)
from lcp_plugin.algorithms import REGISTRY, algorithm_class
from lcp_plugin.core.algorithm import SWEEPS

from . import convex_programs, guarantees, least_squares, search, small_lcps

Generator = np.random.Generator

SOLVED, BOUND, VERDICT, CLAIM, CRASH, MODIFIED = VIOLATIONS = (
    "false SOLVED",
    "bound",
    "verdict",
    "false claim",
    "crash",
    "modified",
)
NEAR, OPEN = TOLD = "near", "open"
TOLERANCE = 1e-9
OUTLIERS = ("program", "linear")
DERIVATIVES = (
    "h_plus", "definite", "p_matrix", "nonsymmetric", "ill_conditioned", "scaled", "chain", "nearly_degenerate",
)  # fmt: skip
ALGORITHMS = (*REGISTRY,)


class Finding(NamedTuple):
    """Fault and message."""

    what: str
    text: str


Found = Iterator[Finding]


# --- One case of each class
# -----------------------------------------------------------------------------------------


def delivered(problem: LCP, rng: Generator) -> LCP:
    """The same problem as a caller may state it: dense, or sparse of any format and index width."""
    dense = problem.csr.toarray()
    form = rng.choice(["C", "F", "csr", "csc", "coo", "wide"])
    if form in ("C", "F"):
        M: Any = np.array(dense, order=form)
    else:
        M = sp.coo_array(dense).asformat("csr" if form == "wide" else str(form))
    if form == "wide":
        M.indices, M.indptr = M.indices.astype(np.int64), M.indptr.astype(np.int64)
    return LCP(M, problem.q.copy(), lower=problem.lower.copy(), upper=problem.upper.copy())


def is_within(problem: LCP, z: np.ndarray, tolerance: float) -> bool:
    """Return whether z satisfies the definition of SOLVED exactly.

    Such a z may exist for a problem without a solution, if its rows differ in size by more than the tolerance.
    """
    return not ExactData(problem).is_lie(z.tolist(), tolerance)


def violated(problem: LCP, z: np.ndarray, exact: tuple[Fraction, ...], bound: Any) -> bool:
    """Return whether a bound of the error of z fails, or a row is classified wrongly."""
    solution = Exact(exact, tuple(ExactData(problem).slack(exact)))
    return bound_violations(z, solution, bound) != 0


def claims(problem: LCP, truth: str, algorithms: tuple[str, ...]) -> Found:
    """Yield false statuses of each algorithm on a problem whose solvability is known."""
    for name in algorithms:
        try:
            result = solve(problem, name, tolerance=TOLERANCE)
        except (UnsuitableMatrix, UnsuitableProblem) as error:
            if name == "auto":
                yield Finding(CRASH, f"auto refuses: {error}")
            continue
        complaint = false_claim(problem, truth, result, TOLERANCE)
        if complaint == "false SOLVED" and is_within(problem, result.z, TOLERANCE):
            yield Finding(NEAR, f"{name}: {truth}, but not within the tolerance")
        elif complaint:
            what = SOLVED if "SOLVED" in complaint or "lie" in complaint else CLAIM
            yield Finding(what, f"{name}: {complaint}")
        elif name == "auto" and (text := shortfall(problem, truth, result)):
            yield Finding(OPEN, f"auto: {text}")


def small(rng: Generator, kind: str) -> Found:
    """Up to six unknowns, the truth by exact search; auto and two other algorithms."""
    problem = small_lcps.random_problem(kind, rng)
    others = rng.choice(ALGORITHMS, 2, replace=False)
    yield from claims(delivered(problem, rng), decide(problem).verdict, ("auto", *map(str, others)))


def extreme(rng: Generator, kind: str) -> Found:
    """Numbers of any exponent: claims of the methods that eliminate, pivot and search; all solutions, exactly."""
    problem = small_lcps.extreme_problem(kind, rng)
    truth = decide(problem).verdict
    yield from claims(delivered(problem, rng), truth, ("auto", "lemke", "newton", "interior_point"))
    found = all_solutions(problem)
    if bool(found) != (truth == SOLVABLE):
        yield Finding(CLAIM, f"{len(found)} solutions, but {truth}")
    data, largest = ExactData(problem), Fraction(sys.float_info.max)
    for solution in found:
        if not data.is_solution(solution.exact_z):
            yield Finding(CLAIM, f"{solution} is none")
        try:
            is_as_told = bool(np.isfinite(solution.z).all())
        except UnsuitableProblem:
            is_as_told = max(map(abs, solution.exact_z)) > largest
        if not is_as_told:
            yield Finding(CLAIM, f"{solution} in doubles")


def odd(rng: Generator, kind: str) -> Found:
    """Check claims on integers with one or two outliers; SOLVED also means that every row holds in fractions."""
    M, q, lower, upper, words = module("outliers").odd_lcp(rng)
    problem = LCP(M, q, lower=lower, upper=upper)
    yield from claims(problem, decide(problem).verdict, (kind,))
    result = solve(problem, kind)
    if result.is_solved and (lines := failures(problem, result.z)):
        yield Finding(SOLVED, f"{words}: {lines}")


def related(rng: Generator, kind: str) -> Found:
    """Check a small problem and an equivalent one: their solvability agrees."""
    problem = small_lcps.random_problem(
        str(rng.choice([k for k in small_lcps.KINDS if k != "doubles"])), rng
    )
    truth = decide(problem).verdict
    changed, back = EXACT[kind](problem, rng)
    yield from claims(changed, truth, ("auto", str(rng.choice(ALGORITHMS))))
    if truth == SOLVABLE:
        exact = decide(changed).z
        if exact is None:
            yield Finding(CLAIM, "the relation does not hold")
            return
        z = np.array([float(value) for value in exact])
        if [Fraction(value) for value in z] == list(exact) and not ExactData(problem).is_solution(
            back(z)
        ):
            yield Finding(CLAIM, "the way back of the relation does not hold")


def random_options(name: str, rng: Generator) -> dict[str, Any]:
    """Return random options of a named algorithm, also outside of the ranges of its theorems."""
    offered = {
        "sweep": lambda: str(rng.choice([*SWEEPS])),
        "scaling": lambda: rng.choice([None, "auto", "diagonal"]),
        "scaling_factor": lambda: float(rng.uniform(0.1, 3.0)),
        "relaxation": lambda: float(rng.uniform(0.05, 1.95)),
        "acceleration": lambda: float(rng.uniform(-0.5, 1.9)),
        "omega": lambda: float(rng.uniform(0.1, 5.0)),
        "splitting": lambda: str(rng.choice(["diagonal", "tridiagonal", "lower"])),
        "coarsest": lambda: int(rng.integers(1, 9)),
        "max_pivots": lambda: int(rng.integers(1, 30)),
    }
    known = (
        []
        if name == "auto"
        else [each for each in algorithm_class(name).__dataclass_fields__ if each in offered]
    )
    options = {option: offered[option]() for option in known if rng.random() < 0.5}
    return options | ({"scaling": "diagonal"} if "scaling_factor" in options else {})


def optional(rng: Generator, name: str) -> Found:
    """Check claims and error bounds for random options, starts, tolerances and scalings."""
    kind = str(rng.choice([k for k in small_lcps.KINDS if k != "badly scaled"]))
    problem = small_lcps.random_problem(kind, rng)
    if rng.random() < 0.5:  # scale each w and z; a bound of 1e20 or more is none
        spread = int(rng.choice([3, 30, 250]))
        problem = scaled(problem, np.exp2(rng.integers(-spread, spread + 1, problem.n)), np.exp2(np.full(
            problem.n, rng.integers(-spread, spread + 1)))).problem  # fmt: skip
    truth = decide(problem).verdict
    tolerance = float(rng.choice([0.0, 1e-15, 1e-12, 1e-6, 1e-2]))
    options: dict[str, Any] = {
        "tolerance": tolerance,
        "z0": None
        if rng.random() < 0.5
        else rng.normal(size=problem.n) * 10.0 ** rng.integers(-9, 10),
        "max_iterations": int(rng.choice([0, 3, 50, 1000])),
        "record": bool(rng.random() < 0.3),
        "callback": (lambda sample, z: sample.iteration >= 20) if rng.random() < 0.2 else None,
    }
    start = bits(options["z0"])
    try:
        result = solve(problem, name, **options, **random_options(name, rng))
    except (UnsuitableMatrix, UnsuitableProblem):
        if name == "auto":
            yield Finding(CRASH, "auto refuses")
        return
    if bits(options["z0"]) != start:
        yield Finding(MODIFIED, "z0")
    if result.status.name == "SOLVED" and problem.n and not is_within(problem, result.z, tolerance):
        yield Finding(SOLVED, f"{truth}, {options}")
    elif result.status.name == "SOLVED" and truth != SOLVABLE:
        yield Finding(NEAR, f"{truth}, but not within the tolerance, {options}")
    elif complaint := false_claim(problem, truth, result, tolerance):
        yield Finding(CLAIM, f"{complaint}, {options}")
    if problem.n and result.error_bound is not None:
        exact = decide(problem).z  # the only solution: a bound is a proof of that
        if exact is None:
            yield Finding(BOUND, "a bound where there is no solution")
        elif violated(problem, result.z, exact, result.error_bound):
            yield Finding(BOUND, f"{options}")


def planted(rng: Generator, kind: str) -> Found:
    """Check auto and another algorithm on seven to twelve unknowns with a known solution."""
    n = int(rng.integers(7, 13))
    M = small_lcps.KINDS[kind](n, rng)
    lower, upper = (
        small_lcps.random_bounds(n, rng)
        if rng.random() < 0.5
        else (np.zeros(n), np.full(n, np.inf))
    )
    problem = LCP(M, small_lcps.planted_offset(M, lower, upper, rng), lower=lower, upper=upper)
    yield from claims(problem, SOLVABLE, ("auto", str(rng.choice(ALGORITHMS))))


def large(rng: Generator, kind: str) -> Found:
    """Check claims and error bounds on sparse H₊-matrices of 13 to 400 rows, solution unique."""
    n = int(rng.integers(13, 401))
    B = sp.random_array((n, n), density=min(1.0, rng.uniform(1.0, 6.0) / n), rng=rng, format="csr")
    B.data = rng.integers(-4, 5, B.nnz).astype(float)
    if kind == "symmetric":
        B = sp.csr_array(B + B.T)
    B.setdiag(0.0)
    d = abs(B) @ np.ones(n) + rng.integers(1, 3)
    rows = np.exp2(rng.integers(-8, 9, n)) if kind == "scaled" else np.ones(n)
    M = sp.csr_array(sp.diags_array(rows) @ sp.csr_array(B + sp.diags_array(d)))
    lower, upper = (
        small_lcps.random_bounds(n, rng)
        if rng.random() < 0.5
        else (np.zeros(n), np.full(n, np.inf))
    )
    z = np.clip(rng.integers(-3, 4, n).astype(float), lower, upper)
    w = rows * rng.integers(0, 4, n) * ((z == lower) * 1.0 - ((z == upper) & (lower < upper)))
    problem = LCP(M, w - M @ z, lower=lower, upper=upper)
    yield from claims(problem, SOLVABLE, ("auto", str(rng.choice(ALGORITHMS))))
    for near in (
        solve(problem, tolerance=float(rng.choice([1e-2, 1e-9]))).z,
        z + rng.normal(size=n) * 1e-3,
    ):
        bound = error_bound(problem, near, sharp=bool(rng.random() < 0.5))
        if violated(problem, near, tuple(map(Fraction, z.tolist())), bound):
            yield Finding(BOUND, f"of {n} rows, or a row is classified wrongly")


def searched(rng: Generator, kind: str) -> Found:
    """Check all solutions, feasibility and proofs of a problem against enumeration."""
    with np.errstate(all="ignore"):  # inner functions leave NumPy's state to public ones
        found = [*search.violations(search.random_problem(rng, 3))]
    yield from (Finding(CLAIM, line) for line in found)


def guaranteed(rng: Generator, kind: str) -> Found:
    """Check a guarantee against an actual run."""
    with np.errstate(all="ignore"):  # an iteration without its run
        found = guarantees.run_case(rng).violations
    yield from (Finding(CLAIM, line) for line in found)


def programs(rng: Generator, kind: str) -> Found:
    """Check a convex program with a known solution by its optimality conditions."""
    case, value = convex_programs.planted(kind, rng, 12)
    wrong, left = convex_programs.judged(kind, case, value)
    yield from (Finding(CLAIM, f"{case}: {text}") for text in wrong)
    yield from (Finding(OPEN, f"{case}: {text}") for text in left)


# --- Kinds of other modules, imported when they run ---------------------------------------------


def module(name: str) -> Any:
    return import_module(f"campaigns.{name}")


def outlier(rng: Generator, kind: str) -> Found:
    """Small problems with one or two odd numbers."""
    judge = module("outliers")
    outcome = judge.run(kind, int(rng.integers(2**31)), 0)
    if outcome.what == judge.FALSE:
        yield Finding(CLAIM, outcome.text)
    elif outcome.what != judge.RIGHT:
        yield Finding(OPEN, outcome.text)


def game(rng: Generator, kind: str) -> Found:
    """Bimatrix games with ties, all equilibria in rational arithmetic; of shifted payoffs, one equilibrium."""
    judge = module("games")
    A, B = judge.game(rng, float(rng.choice(judge.ODD)) if kind == "odd" else None)
    if kind == "shifted":
        A, B = judge.shifted(A, B, rng)
    texts = (judge.missed(A, B), "" if kind == "shifted" else judge.wrong_equilibria(A, B))
    for text in filter(None, texts):
        what = OPEN if text in {f"solve: {status.name}" for status in Status} else CLAIM
        yield Finding(what, f"{text}, A = {A.tolist()}, B = {B.tolist()}")


def path(rng: Generator, kind: str) -> Found:
    """Solution paths next to single solves."""
    status, wrong, apart = module("paths").examined(rng, 40, 5)
    if wrong or apart:
        yield Finding(CLAIM, f"{wrong} points wrong, {apart} pieces apart")
    elif status != "SOLVED":
        yield Finding(OPEN, status)


def rescaled_program(rng: Generator, kind: str) -> Found:
    """The same program in euros and in millions."""
    judge = module("scaled_programs")
    for text in judge.one(str(rng.choice(judge.FAMILIES)), int(rng.integers(2**31))):
        yield Finding(CLAIM, text)


def derivative(rng: Generator, kind: str) -> Found:
    """Derivatives against rational arithmetic."""
    judge = module("derivatives")
    for text in judge.faults(kind, str(rng.choice(judge.KINDS)), 8, rng):
        yield Finding(CLAIM, text)


def least_cost(rng: Generator, kind: str) -> Found:
    """Bounded least squares, the minimum in rational arithmetic."""
    judge = least_squares
    case = judge.draw(kind, rng)
    given = {"weights": case.weights, "ridge": case.ridge, "tolerance": judge.TOLERANCE}
    try:
        result = least_squares.bounded_least_squares(
            case.A, case.b, case.lower, case.upper, **given
        )
    except InvalidProblem as error:  # squares that are no doubles
        yield Finding(OPEN, str(error))
        return
    if not result.is_solved:
        yield Finding(OPEN, result.status.name)
    elif judge.complaint(case, judge.Exact(case), result.x) == "FALSE":
        yield Finding(SOLVED, f"cost {result.cost}")


def equilibrium(rng: Generator, kind: str) -> Found:
    """Programs with complementarity constraints, the truth by all pieces."""
    judge = module("best_equilibria")
    problem = judge.random_problem(rng, 8)
    try:
        truth = judge.truth(problem)
    except ArithmeticError:  # the pieces are too near to each other
        return
    result = solve(problem, max_seconds=60.0, prove=True)
    for text in (*judge.complaints(result, truth), *judge.undetected(result)):
        yield Finding(CLAIM, text)


def cone(rng: Generator, kind: str) -> Found:
    """Check problems over cones by all their modes."""
    found = module("cones").check(int(rng.integers(10**6)), max_seconds=1.0)
    yield from (Finding(SOLVED, text) for text in found if text.endswith("false"))


def curved(rng: Generator, kind: str) -> Found:
    """Check nonlinear problems with the solutions of an LCP."""
    for what, text in module("small_nonlinear").attacks(rng, 1, kind):
        if what == "false":
            yield Finding(SOLVED, text)


def transport(rng: Generator, kind: str) -> Found:
    """Check transports in which huge costs forbid pairs."""
    judge, seed = module("forbidding_costs"), int(rng.integers(10**6))
    if (drawn := judge.draw(seed)) is not None:
        program, known = drawn
        result = solve(program)
        is_claimed = result.is_solved or certify(program, result).verdict == "proved"
        if is_claimed and judge.is_wrong(result.objective or 0.0, known):
            yield Finding(SOLVED, f"case {seed}: {result.objective}, not {known}")


def agents(rng: Generator, kind: str) -> Found:
    """Check markets of agents, and bilevel programs."""
    one = range(k := int(rng.integers(10**6)), k + 1)
    cases = (one, range(0)) if kind == "market" else (range(0), one)
    yield from (Finding(CLAIM, text) for text in module("agents").faults(*cases))


def right_point(rng: Generator, kind: str) -> Found:
    """Check that right points with ordinary data are not refused."""
    yield from (Finding(CLAIM, text) for text in module("refusals").refused(rng, kind))


def mixed_units(rng: Generator, kind: str) -> Found:
    """Check integer problems in units of 2^±60."""
    found = module("refusals").false_in_units(rng)
    yield from (Finding(SOLVED, text) for text in found if text != "SOLVED")


Case = Callable[[Generator, Any], Found]

# name: case, kinds, how often one of the kinds comes in a round
ROUND: dict[str, tuple[Case, tuple[Any, ...], int]] = {
    "small": (small, tuple(small_lcps.KINDS), 54),
    "extreme": (extreme, tuple(small_lcps.EXTREMES), 12),
    "odd": (odd, ("auto", "lemke", "newton", "interior_point"), 11),
    "related": (related, tuple(EXACT), 45),
    "optional": (optional, ("auto", *REGISTRY), 57),
    "planted": (planted, tuple(small_lcps.KINDS), 18),
    "large": (large, ("plain", "symmetric", "scaled"), 6),
    "search": (searched, ("any",), 6),
    "guarantee": (guaranteed, ("any",), 10),
    "program": (programs, tuple(convex_programs.FAMILIES), 38),
    "outlier": (outlier, OUTLIERS, 22),
    "game": (game, ("integers", "odd", "shifted"), 9),
    "path": (path, ("any",), 4),
    "units": (rescaled_program, ("any",), 6),
    "derivative": (derivative, DERIVATIVES, 10),
    "least_squares": (least_cost, (*least_squares.KINDS, least_squares.ODD), 16),
    "equilibrium": (equilibrium, ("any",), 2),
    "cone": (cone, ("any",), 10),
    "curved": (curved, ("affine", "bent rows", "weighted rows", "bent unknowns"), 8),
    "transport": (transport, ("any",), 4),
    "agents": (agents, ("market", "bilevel"), 2),
    "right point": (right_point, ("dense", "sparse", "stack", "cones", "nonlinear", "program"), 12),
    "mixed units": (mixed_units, ("any",), 12),
}


def order_of_a_round() -> list[tuple[str, Any]]:
    """Return every class as often as its share requires, in a mixed order."""
    kinds = [
        (name, kinds[k % len(kinds)])
        for name, (_, kinds, share) in ROUND.items()
        for k in range(share)
    ]
    return [kinds[k] for k in np.random.default_rng(0).permutation(len(kinds))]


SCHEDULE = order_of_a_round()
