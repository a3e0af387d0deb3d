"""Every claim about matrices at the ends of the doubles' range, against rational arithmetic.

Entries from 1e-300 to 1e300 and subnormal ones, products that overflow or underflow, cancellations, margins of one
unit in the last place. Judged are the verdicts of `analyze` with their proofs (every other case without the exact
arithmetic that settles small matrices, so that the margins alone must hold), convergence guarantees against every
linear piece of the iteration with the step sizes that it uses, and error bounds against the exact solution. A warning
is an error, and so is every exception that is no LCPError.

    python tests/campaigns/graded_matrices.py --cases 50000 --seed 0
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import combinations, product
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))

from error_bounds import points, violations
from exact import Exact, exact_solution, solve_fractions
from guarantees import FAMILIES, random_algorithm
from matrix_verdicts import Case, check, extreme

from lcp_plugin import LCP
from lcp_plugin.algorithms import Algorithm, create
from lcp_plugin.core.errors import LCPError
from lcp_plugin.core.matrix.iteration_facts import (
    MODULUS,
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    IterationFacts,
)
from lcp_plugin.proofs.bounds.error_bounds import error_bound
from lcp_plugin.proofs.guarantees import convergence_guarantee
from lcp_plugin.proofs.guarantees.convergence import numbers
from lcp_plugin.proofs.verdicts import analyze, verdicts

LARGEST_PIECES = 3  # rows up to which all linear pieces of an iteration are looked at
Matrix = list[list[Fraction]]


# --- Matrices ----------------------------------------------------------------------------------------------


def power(rng: np.random.Generator, reach: float, size: object = None) -> np.ndarray:
    """Return powers of ten with uniform exponents, or of two, which round nothing."""
    if rng.random() < 0.5:
        return np.exp2(np.rint(rng.uniform(-reach, reach, size) * np.log2(10.0)))
    return np.asarray(10.0 ** rng.uniform(-reach, reach, size))


def random_exponents(rng: np.random.Generator) -> np.ndarray:
    """Return a matrix whose entries have nothing to do with each other."""
    n = int(rng.integers(2, 6))
    reach = float(rng.choice([20.0, 160.0, 300.0]))
    M = (
        power(rng, reach, (n, n))
        * rng.choice([-1.0, 1.0], (n, n))
        * (rng.random((n, n)) < rng.choice([0.4, 0.8]))
    )
    if rng.random() < 0.8:
        M[np.diag_indices(n)] = power(rng, reach, n) if rng.random() < 0.5 else 1.0
    return M


def cycles(rng: np.random.Generator) -> np.ndarray:
    """Return a unit diagonal and cycles of entries of any size whose products are near 1."""
    n = int(rng.integers(2, 7))
    M = np.eye(n)
    for _ in range(int(rng.integers(1, 4))):
        rows = rng.permutation(n)[: int(rng.integers(2, n + 1))]
        exponents = rng.uniform(-250, 250, rows.size)
        exponents -= (
            exponents.mean() + rng.choice([0.0, 0.0, -1.0, 1.0, -40.0, 40.0]) * rng.random()
        )
        exponents = np.clip(np.rint(exponents * rng.choice([1.0, 3.0])), -1000, 1000)
        exponents[0] -= exponents.sum() if rng.random() < 0.5 else 0.0
        values = np.exp2(np.clip(exponents, -1074, 1023)) * rng.choice([-1.0, 1.0], rows.size)
        M[rows, np.roll(rows, 1)] = np.where(
            rng.random(rows.size) < 0.1, np.nextafter(values, np.inf), values
        )
    return M


def chain(rng: np.random.Generator) -> np.ndarray:
    """Return few entries of any size beside a diagonal of ones and a few others: products that leave the range."""
    n = int(rng.integers(3, 6))
    M = np.eye(n)
    where = rng.random((n, n)) < rng.uniform(0.2, 0.7)
    entries = 10.0 ** np.rint(rng.uniform(-260, 260, (n, n))) * rng.choice([-1.0, 1.0], (n, n))
    np.copyto(M, entries, where=where & ~np.eye(n, dtype=bool))
    if rng.random() < 0.4:
        i = int(rng.integers(n))
        M[i, i] = 10.0 ** np.rint(rng.uniform(-300, 300))
    return M


def favoured(rng: np.random.Generator) -> np.ndarray:
    """Return a unit diagonal and entries of any size, of opposite signs where both m_ij and m_ji are there.

    Pivots grow beyond the range then, and quotients by them underflow before a factor that is as large.
    """
    n = int(rng.integers(3, 7))
    M = np.eye(n)
    reach = float(rng.choice([100.0, 200.0, 300.0]))
    for i, j in combinations(range(n), 2):
        sizes = 10.0 ** np.rint(rng.uniform(-reach, reach, 2)) * (
            rng.random(2) < rng.choice([0.3, 0.6])
        )
        sign = rng.choice([-1.0, 1.0])
        M[i, j], M[j, i] = sign * sizes[0], -sign * sizes[1]
    return against(rng, M) if rng.random() < 0.7 else M


def against(rng: np.random.Generator, M: np.ndarray) -> np.ndarray:
    """Return M with a longer cycle whose product, of the other sign, is about that of a pair in it."""
    rows = rng.permutation(len(M))[: int(rng.integers(3, len(M) + 1))]
    following = np.roll(rows, -1)
    reach = float(rng.choice([100.0, 200.0]))
    sizes = np.rint(rng.uniform(-reach, reach, rows.size))
    sizes[0] = reach  # and the way back makes the pair
    back = np.rint(rng.uniform(-reach, reach))
    sizes[-1] += sizes[0] + back - sizes.sum() + np.rint(rng.uniform(-2.0, 2.0))
    if abs(sizes[-1]) > 300.0:
        return M
    values = 10.0**sizes * rng.choice([-1.0, 1.0], rows.size)
    values[-1] *= -np.sign(np.prod(np.sign(values))) * (-1.0) ** (rows.size - 1)
    M[rows, following] = values
    M[rows[1], rows[0]] = -np.sign(values[0]) * 10.0**back
    return M


def core(rng: np.random.Generator) -> np.ndarray:
    """Return a matrix of small integers that is often singular in some minor."""
    n = int(rng.integers(2, 6))
    M = rng.integers(-3, 4, (n, n)).astype(float)
    M[np.diag_indices(n)] = rng.integers(1, 7, n)
    if rng.random() < 0.4:
        M = -np.abs(M) + 2.0 * np.diag(np.diag(M))
    if rng.random() < 0.4:
        i, j = rng.permutation(n)[:2]
        M[i] = M[j] * rng.choice([-1.0, 1.0])
        M[i, i] = abs(M[i, i]) + (M[i, i] == 0.0)
    if rng.random() < 0.5:
        M = np.tril(M) + np.tril(M, -1).T
    return M


def one_ulp(rng: np.random.Generator) -> np.ndarray:
    """Return small integers with some entries a unit in the last place beside them, in any units."""
    M = core(rng)
    n = len(M)
    with np.errstate(all="ignore"):
        nudged = np.nextafter(M, rng.choice([-np.inf, np.inf], M.shape))
        M = np.where(rng.random(M.shape) < rng.choice([0.0, 0.2]), np.where(M == 0.0, M, nudged), M)
        reach = int(rng.choice([0, 20, 500, 520]))
        unit = np.exp2(rng.integers(-reach, reach + 1, n))
        other = unit if rng.random() < 0.6 else np.exp2(rng.integers(-reach, reach + 1, n))
        scaled = unit[:, None] * M * other
    return scaled if np.isfinite(scaled).all() else M


def dominant(rng: np.random.Generator) -> np.ndarray:
    """Return ⟨M⟩ with row sums of a unit or so in the last place, of either sign or zero, columns in any unit."""
    n = int(rng.integers(2, 6))
    B = (
        rng.random((n, n))
        * power(rng, float(rng.choice([1.0, 8.0, 100.0])), (n, n))
        * (rng.random((n, n)) < 0.7)
    )
    np.fill_diagonal(B, 0.0)
    with np.errstate(all="ignore"):
        d = B.sum(axis=1)
        for _ in range(int(rng.integers(0, 3))):
            d = np.nextafter(d, rng.choice([0.0, np.inf], n))
        d = np.where(d == 0.0, 1.0, d) * rng.choice([1.0, 1.0, 1.5, 4.0])
        M = np.diag(d) + B * rng.choice([-1.0, 1.0], (n, n))
        unit = power(rng, float(rng.choice([0.0, 100.0, 290.0])), n)
        M = M * unit if rng.random() < 0.5 else unit[:, None] * M / unit
    return M if np.isfinite(M).all() else np.eye(n)


def subnormal(rng: np.random.Generator) -> np.ndarray:
    """Return small multiples of the least doubles, some rows larger."""
    M = core(rng)
    M = np.ldexp(M, -1074 + rng.integers(0, 6))
    if rng.random() < 0.5:
        M = np.ldexp(M, rng.integers(0, int(rng.choice([60, 1100])), (len(M), 1)))
    return M


KINDS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "random exponents": random_exponents,
    "cycles": cycles,
    "chain": chain,
    "favoured": favoured,
    "one ulp": one_ulp,
    "dominant": dominant,
    "subnormal": subnormal,
    "extreme": extreme,
}


# --- Verdicts ----------------------------------------------------------------------------------------------


@contextmanager
def exact_arithmetic(is_allowed: bool) -> Iterator[None]:
    """Take the exact arithmetic for small matrices away where it is not allowed, as if they were larger."""
    limits = ((verdicts, "EXACT_SIZE"), (verdicts, "LARGEST_SIZE"))
    before = [getattr(module, name) for module, name in limits]
    for module, name in () if is_allowed else limits:
        setattr(module, name, 0)
    try:
        yield
    finally:
        for (module, name), value in zip(limits, before, strict=True):
            setattr(module, name, value)


def wrong_verdicts(
    rng: np.random.Generator, kind: str, M: np.ndarray, counts: Counter[tuple[str, str]]
) -> list[str]:
    """Judge all verdicts on M and their proofs, with and without the exact arithmetic."""
    is_bare = bool(rng.random() < 0.5)
    with exact_arithmetic(not is_bare):
        found = check(Case(f"{kind}{', bare' * is_bare}", M, None, 0.0), counts)
        str(analyze(M))
    return found


# --- Guarantees --------------------------------------------------------------------------------------------


def any_algorithm(rng: np.random.Generator, problem: LCP) -> Algorithm:
    """Return an algorithm of any family; every third a modulus method or a relaxation at the limit of its theorem."""
    if rng.random() > 0.35:
        return random_algorithm(rng, str(rng.choice(FAMILIES)), problem.n)
    sweep = str(rng.choice(["forward", "backward", "symmetric"]))
    alpha = float(np.round(rng.uniform(1.0, 2.0), int(rng.integers(1, 17))))
    kind = int(rng.integers(4))
    if kind == 0:
        omega = (alpha - 1.0) / alpha if alpha > 1.0 else 0.5
        omega = abs(omega) * (1.0 + float(rng.integers(-4, 5)) * 2.0**-52) + (omega == 0.0)
        return create(
            "maor", {"relaxation": alpha, "acceleration": alpha, "omega": omega, "sweep": sweep}
        )
    if kind == 1:
        return create(
            "psor", {"relaxation": float(2.0 - 2.0 ** rng.uniform(-52, -1)), "sweep": sweep}
        )
    if kind == 2:
        omega = float(np.exp2(rng.uniform(-60, 60)))
        return create(
            "maor",
            {"relaxation": min(alpha, 1.0), "acceleration": 0.5, "omega": omega, "sweep": sweep},
        )
    return create(
        "npaor",
        {
            "relaxation": float(np.exp2(rng.uniform(-60, 60))),
            "acceleration": float(np.exp2(rng.uniform(-60, 60))),
            "sweep": sweep,
            "scaling": rng.choice([None, "auto", "diagonal"]),
        },
    )


def exact(values: np.ndarray) -> list[Fraction]:
    return [Fraction(float(value)) for value in values]


def one_pass(
    facts: IterationFacts, problem: LCP, piece: tuple[bool, ...], backward: bool
) -> Matrix | None:
    """Return T with e⁺ = T e where the rows of the piece follow w and the others z; step sizes are those of a run.

    None where a step size is no positive double: such an iteration cannot run.
    """
    n = problem.n
    M = [exact(row) for row in problem.csr.toarray()]
    diagonal = problem.diagonal
    alpha, beta = numbers(facts)
    taken = [
        [M[i][j] if (j > i if backward else j < i) else Fraction(0) for j in range(n)]
        for i in range(n)
    ]
    identity = [[Fraction(i == j) for j in range(n)] for i in range(n)]
    if facts.family == MODULUS:
        inverse = 1.0 / (alpha * facts.omega + diagonal)
        omega, weight = exact(facts.omega), Fraction(beta)
        drive = [
            [
                2 * Fraction(alpha) * (M[i][j] if piece[j] else identity[i][j] * omega[i])
                for j in range(n)
            ]
            for i in range(n)
        ]
    elif facts.family == PROJECTED_RELAXATION:
        in_place = facts.relaxation == facts.acceleration
        inverse = alpha * (1.0 / diagonal) if in_place else alpha / diagonal
        weight = Fraction(1) if in_place else Fraction(beta / alpha)
        drive = M
    else:
        scaling = np.ones(n) if facts.scaling is None else facts.scaling
        inverse = 1.0 / (scaling * diagonal / alpha + scaling * diagonal + 2.0)
        weight, s = Fraction(beta / alpha), exact(scaling)
        taken = [[s[i] * entry for entry in row] for i, row in enumerate(taken)]
        drive = [
            [2 * (s[i] * M[i][j] if piece[i] else identity[i][j]) for j in range(n)]
            for i in range(n)
        ]
    if not (np.isfinite(inverse).all() and (inverse > 0.0).all()):
        return None
    P = [
        [weight * taken[i][j] + identity[i][j] / Fraction(float(inverse[i])) for j in range(n)]
        for i in range(n)
    ]
    N = [[P[i][j] - drive[i][j] for j in range(n)] for i in range(n)]
    if facts.family == PROJECTED_RELAXATION:
        P = [row if piece[i] else identity[i] for i, row in enumerate(P)]
        N = [row if piece[i] else [Fraction(0)] * n for i, row in enumerate(N)]
    columns = [solve_fractions(P, [N[i][j] for i in range(n)]) for j in range(n)]
    return [[columns[j][i] for j in range(n)] for i in range(n)]


def pieces(facts: IterationFacts, problem: LCP) -> Iterator[tuple[tuple[bool, ...], Matrix]]:
    """Yield the linear pieces of one iteration, the one without active rows last."""
    for piece in product([False, True], repeat=problem.n):
        passes = {"forward": (False,), "backward": (True,), "symmetric": (False, True)}[facts.sweep]
        found = [one_pass(facts, problem, piece, backward) for backward in passes]
        if None in found:
            return
        T = found[0]
        for other in found[1:]:
            T = times(other, T)
        yield piece, T


def times(A: Matrix, B: Matrix) -> Matrix:
    return [
        [sum(a * b for a, b in zip(row, column, strict=True)) for column in zip(*B, strict=True)]
        for row in A
    ]


def is_contracting(T: Matrix) -> bool:
    """Return whether the spectral radius is below 1: Schur and Cohn's test of the characteristic polynomial."""
    n = len(T)
    polynomial, power = [Fraction(1)], [[Fraction(i == j) for j in range(n)] for i in range(n)]
    for k in range(1, n + 1):
        power = times(T, power)
        polynomial.append(-sum(power[i][i] for i in range(n)) / k)
        power = [
            [entry + polynomial[-1] * (i == j) for j, entry in enumerate(row)]
            for i, row in enumerate(power)
        ]
    while len(polynomial) > 1:
        first, last = polynomial[0], polynomial[-1]
        if abs(last) >= abs(first):
            return False
        polynomial = [
            first * a - last * b for a, b in zip(polynomial, polynomial[::-1], strict=True)
        ][:-1]
    return True


def wrong_guarantees(
    rng: np.random.Generator, M: np.ndarray, counts: Counter[tuple[str, str]]
) -> list[str]:
    """Judge what is guaranteed of a random algorithm on M."""
    problem = LCP(M, -np.ones(len(M)))
    algorithm = any_algorithm(rng, problem)
    guarantee = convergence_guarantee(problem, algorithm)
    found = []
    try:
        facts = algorithm.facts(problem)
    except LCPError:
        facts = None
    counts["guarantee", guarantee.verdict] += 1
    is_judged = (
        facts is not None and facts.relaxation is not None and facts.family != PROJECTED_SPLITTING
    )
    if not is_judged or guarantee.verdict == "not covered" or problem.n > LARGEST_PIECES:
        return found
    counts["guarantee", "judged"] += 1
    with np.errstate(all="ignore"):
        all_pieces = list(pieces(facts, problem))
    for piece, T in all_pieces:
        if guarantee.rate is not None:
            v, rate = exact(guarantee.v), Fraction(guarantee.rate)
            grown = [sum(abs(entry) * w for entry, w in zip(row, v, strict=True)) for row in T]
            if any(g > rate * w for g, w in zip(grown, v, strict=True)):
                found.append(
                    f"{algorithm}: the rate {guarantee.rate} does not hold on the piece {piece}"
                )
        elif not is_contracting(T):
            found.append(
                f"{algorithm}: guaranteed by {guarantee.theorem}, but not on the piece {piece}"
            )
    return found


# --- Error bounds ------------------------------------------------------------------------------------------


def random_problem(rng: np.random.Generator, M: np.ndarray) -> LCP:
    """Return a problem with M; q and bounds in any unit."""
    n = len(M)
    reach = float(rng.choice([1.0, 20.0, 150.0, 290.0]))
    q = power(rng, reach, n) * rng.choice([-1.0, 0.0, 1.0, -1.0], n)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if rng.random() < 0.5:
        kind = rng.integers(0, 5, size=n)  # plain, below, boxed, free, fixed
        low, width = power(rng, reach, n) * rng.choice([-1.0, 1.0], n), power(rng, reach, n)
        lower = np.choose(kind, [lower, low, low, np.full(n, -np.inf), low])
        upper = np.choose(kind, [upper, upper, low + width, upper, low])
    return LCP(M, q, lower=lower, upper=upper)


def wrong_bounds(
    rng: np.random.Generator, M: np.ndarray, counts: Counter[tuple[str, str]]
) -> list[str]:
    """Judge the error bounds of some points of a problem with M, where M has any."""
    problem = random_problem(rng, M)
    try:
        error_bound(problem, problem.nearest_to_zero)
    except LCPError:
        counts["error bound", "refused"] += 1
        return []
    with np.errstate(all="ignore"):
        truth: Exact = exact_solution(problem)
        near = [
            (quality, z)
            for quality, z in points(rng, problem, clipped(truth))
            if np.isfinite(z).all()
        ]
    found = []
    for quality, z in near:
        bound = error_bound(problem, z, sharp=bool(rng.random() < 0.7))
        outside, misplaced = violations(problem, z, truth, bound)
        counts["error bound", "finite" if np.isfinite(bound.infinity) else "infinite"] += 1
        if outside or misplaced:
            found.append(
                f"error bound, {quality}: {outside} rows outside, {misplaced} classified wrongly"
            )
    return found


def clipped(truth: Exact) -> Exact:
    """Return the solution with what no double can hold cut off."""
    largest = Fraction(sys.float_info.max)
    return truth._replace(z=tuple(min(max(value, -largest), largest) for value in truth.z))


# --- The campaign ------------------------------------------------------------------------------------------


def run_case(seed: int, k: int, counts: Counter[tuple[str, str]]) -> list[str]:
    """Draw a matrix and judge everything claimed about it."""
    rng = np.random.default_rng([seed, k])
    kind = list(KINDS)[k % len(KINDS)]
    M = KINDS[kind](rng)
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for judge in (
            lambda: wrong_verdicts(rng, kind, M, counts),
            lambda: wrong_guarantees(rng, M, counts),
            lambda: wrong_bounds(rng, M, counts),
        ):
            try:
                found += judge()
            except Exception:  # whatever it is, it is what the campaign looks for
                found.append(f"{kind}: {traceback.format_exc(limit=-4)}")
    return [f"case {k}: {line}" for line in found]


def main() -> int:
    """Run the campaign; return 1 where anything is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    options = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    began, wrong = time.perf_counter(), []
    for k in range(options.first, options.first + options.cases):
        wrong += run_case(options.seed, k, counts)
    print(f"{options.cases} matrices, {time.perf_counter() - began:.0f} s, {len(wrong)} wrong")
    for name in sorted({name for name, _ in counts}):
        print(
            f"{name:<26}",
            *(f"{out} {count:<7}" for (of, out), count in sorted(counts.items()) if of == name),
        )
    print("\n".join(wrong[:40]))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
