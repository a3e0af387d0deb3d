"""Campaign of uncoupled components in units 10^±12 apart: SOLVED must hold in every component.

Two to six problems with known solutions, or without a solution, are scaled arbitrarily and permuted together, dense
and sparse. One case in 250 consists of two grids. The cases are solved by auto and all methods, cold and from
starts that solve some components, with both error measures, with records and callbacks, in batches, in marches,
from files and through cvxpy. Rational arithmetic checks these statements:

- SOLVED: every component is within the tolerance of its reference (euclidean: the entire problem, absolutely). The
  residuals of certificates are at least the exact residuals, and the worst component is named.
- Infeasible: the proof verifies, and no known solution is within the tolerance.
- PRECISION_LIMIT: every row is at its rounding floor, or the inconsistency is at the rounding level of the largest
  number in q.
- Two calls have the same bits, and no data are modified.
- auto solves 99.5 % of the cases with a solution within a hundredth of the tolerance.

Ranks are left to tests/distributed, because they need mpi4py.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from collection.truth import ExactData
from oracles.exact_components import references_of_rows, relative_residual

from lcp_plugin import LCP, Status, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem

from .small_lcps import KINDS, planted_point, positive_definite, random_bounds

Generator = np.random.Generator
Vector = np.ndarray
TOLERANCE = 1e-8
PROVED = (Status.INFEASIBLE, Status.NO_SOLUTION)
MOST_STEPS = 3000  # of a named method
ALL_METHODS_EVERY, GRIDS_EVERY = 20, 250


SOLVABLE, UNSOLVABLE, UNDECIDED = "solvable", "without solution", "limited by its data"


@dataclass(frozen=True, eq=False)
class Component:
    """A small problem with its solution, or None."""

    M: Vector
    q: Vector
    lower: Vector
    upper: Vector
    z: Vector | None


@dataclass(frozen=True, eq=False)
class Case:
    """Problems put together, and what is known of them."""

    problem: LCP
    labels: Vector
    z: Vector  # NaN in components without solution

    @cached_property
    def data(self) -> ExactData:
        return ExactData(self.problem)

    @cached_property
    def at_zero(self) -> list[Fraction]:
        return self.data.residual(self.data.nearest)

    def relative(self, z: Any) -> Any:
        """The largest ‖r_P(z)‖/‖r_P(z°)‖, exactly."""
        return relative_residual(self.data.residual(z), self.at_zero, self.data.components)

    @cached_property
    def kind(self) -> str:
        if np.isnan(self.z).any():
            return UNSOLVABLE
        return (
            SOLVABLE if self.relative(self.z.tolist()) <= Fraction(TOLERANCE) / 100 else UNDECIDED
        )


# --- Components -----------------------------------------------------------------------------------------------------


def whole(rng: Generator, *shape: int, size: int = 3) -> Vector:
    return rng.integers(-size, size + 1, shape).astype(float)


def dominant(n: int, rng: Generator) -> Vector:
    """An H₊-matrix."""
    M = whole(rng, n, n) * (rng.random((n, n)) < 0.5)
    np.fill_diagonal(M, 0.0)
    return M + np.diag(abs(M).sum(axis=1) + rng.integers(1, 4, n))


def triangular(n: int, rng: Generator) -> Vector:
    order = rng.permutation(n)
    return (np.tril(whole(rng, n, n), -1) + np.diag(rng.integers(1, 4, n)))[np.ix_(order, order)]


def chain(n: int, rng: Generator) -> Vector:
    return 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def cycle(n: int, rng: Generator) -> Vector:
    """Return a P-matrix for odd n, on which active-set iterations cycle."""
    n += 1 - n % 2
    return np.eye(n) + float(rng.integers(1, 4)) * np.roll(np.eye(n), -1, axis=0) * (n > 1)


def single(n: int, rng: Generator) -> Vector:
    return np.eye(1)


def nothing(n: int, rng: Generator) -> Vector:
    """A row without entries: its w is q."""
    return np.zeros((1, 1))


FAMILIES: tuple[Callable[[int, Generator], Vector], ...] = (
    *(KINDS[name] for name in ("PSD", "PSD singular", "PSD nonsymmetric", "program")),
    *(dominant, triangular, chain, cycle, single, nothing),
)


def planted(M: Vector, rng: Generator) -> Component:
    """Return rows with all types of bounds, and z at bounds, between bounds, and degenerate."""
    lower, upper = np.zeros(len(M)), np.full(len(M), np.inf)
    if rng.random() < 0.5:
        lower, upper = random_bounds(len(M), rng)
    z, w = planted_point(lower, upper, rng)
    return Component(M, w - M @ z, lower, upper, z)


def contradictory(rng: Generator) -> Component:
    """Return a row ≤ 0 with q < 0, or a row that conflicts with a fixed row."""
    if rng.random() < 0.5:
        M, q = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([1.0, -1.0])
        return Component(M, q, np.zeros(2), np.full(2, np.inf), None)
    n = int(rng.integers(1, 4))
    M, q = positive_definite(n, rng), whole(rng, n)
    M[-1], q[-1] = -abs(M[-1]), -float(rng.integers(1, 4))
    return Component(M, q, np.zeros(n), np.full(n, np.inf), None)


def at_zero(n: int, rng: Generator) -> Component:
    """z° is the answer."""
    M = dominant(n, rng)
    lower = rng.integers(0, 3, n) + 0.0 if rng.random() < 0.5 else np.zeros(n)
    return Component(M, rng.integers(0, 3, n) - M @ lower, lower, np.full(n, np.inf), lower)


def random_component(rng: Generator) -> Component:
    n, draw = int(rng.integers(1, 11)), rng.random()
    if draw < 0.04:
        return contradictory(rng)
    if draw < 0.12:
        return at_zero(n, rng)
    if draw < 0.15:  # a box as narrow as rounding of its q
        width = np.array([2.0 ** -int(rng.integers(30, 70))])
        return Component(np.eye(1), np.array([-1.0]), np.zeros(1), width, None)
    return planted(FAMILIES[int(rng.integers(len(FAMILIES)))](n, rng), rng)


def grid(rng: Generator) -> Component:
    """Return a five-point grid, with a known z > 0 in a third of the rows."""
    side = int(rng.integers(28, 36))
    T = 2.0 * np.eye(side) - np.eye(side, k=1) - np.eye(side, k=-1)
    M = np.kron(T, np.eye(side)) + np.kron(np.eye(side), T)
    z = rng.integers(1, 5, side * side) * (rng.random(side * side) < 0.3)
    return Component(
        M, (z == 0.0) * 1.0 - M @ z, np.zeros(len(M)), np.full(len(M), np.inf), z + 0.0
    )


def powers(rng: Generator, size: int, count: int) -> Vector:
    """Units: powers of two, of ten, or none."""
    kind = rng.choice(["two", "ten", "one"], p=[0.45, 0.35, 0.2])
    exponents = rng.integers(-size, size + 1, count)
    return (
        np.ones(count)
        if kind == "one"
        else 2.0 ** (3.3 * exponents).round()
        if kind == "two"
        else 10.0**exponents
    )


def rescaled(component: Component, unit: float, rng: Generator) -> Component:
    n = len(component.q)
    rows = powers(rng, 6, n) if rng.random() < 0.3 else np.full(n, powers(rng, 12, 1)[0])
    columns = 2.0 ** rng.integers(-8, 9, n) if rng.random() < 0.2 else np.ones(n)
    size = unit * columns
    if component.z is None and np.isfinite(component.upper).all():  # the box: z is at its upper end
        component = Component(
            component.M, component.q, component.lower, component.upper, component.upper
        )
    return Component(
        rows[:, None] * component.M / columns,
        rows * unit * component.q,
        size * component.lower,
        size * component.upper,
        None if component.z is None else size * component.z,
    )


def joined(components: list[Component], rng: Generator, *, is_dense: bool) -> Case:
    """The components as one problem, in any order."""
    count = sum(len(component.q) for component in components)
    order = rng.permutation(count)
    M = sp.block_diag([sp.csr_array(component.M) for component in components], format="csr")[order][
        :, order
    ]
    M.eliminate_zeros()
    q, lower, upper = (
        np.concatenate([getattr(component, name) for component in components])[order]
        for name in ("q", "lower", "upper")
    )
    labels = np.repeat(np.arange(len(components)), [len(component.q) for component in components])[
        order
    ]
    z = np.concatenate(
        [np.full(len(one.q), np.nan) if one.z is None else one.z for one in components]
    )[order]
    M = M.toarray() if is_dense else sp.csr_array(M)
    return Case(LCP(M, q, lower=lower, upper=upper), labels, z)


def random_case(rng: Generator, number: int) -> Case:
    if number % GRIDS_EVERY == GRIDS_EVERY - 1:
        components, is_dense = [grid(rng), grid(rng)], False
    else:
        components, is_dense = (
            [random_component(rng) for _ in range(int(rng.integers(2, 7)))],
            bool(rng.random() < 0.6),
        )
    units = np.concatenate([powers(rng, 12, 1) for _ in components]) * powers(rng, 12, 1)[0] ** (
        rng.random() < 0.2
    )
    scaled = [
        rescaled(component, unit, rng) for component, unit in zip(components, units, strict=True)
    ]
    return joined(scaled, rng, is_dense=is_dense)


def right_in_some(case: Case, rng: Generator) -> Vector:
    """A start that is the answer in some components, near it in others, and anything in the rest."""
    size = np.array(
        [
            np.nanmax(np.abs(np.r_[case.z[case.labels == k], 0.0]))
            for k in range(case.labels.max() + 1)
        ]
    )
    noise = rng.choice([0.0, 1e-9, 1e-3, 1.0, 1e6], size.size)
    if rng.random() < 0.2:
        size[:] = size.max()
    z = np.nan_to_num(case.z) + (noise * size)[case.labels] * rng.normal(size=case.z.size)
    return np.asarray(z)


# --- Checks --------------------------------------------------------------------------------------------------------


def complaints(case: Case, result: Any) -> Iterator[str]:
    """Yield the errors of a result that stops on the residual."""
    z, status, certificate = result.z.tolist(), result.status, result.certificate
    if np.isfinite(result.z).all():
        residual = case.relative(z)
        if status is Status.SOLVED and residual > Fraction(TOLERANCE):
            yield f"SOLVED with {float(residual):.3e}"
        if (
            residual > Fraction(certificate.relative_residual)
            if certificate.relative_residual < np.inf
            else False
        ):
            yield f"certificate of {certificate.relative_residual:.3e}, exactly {float(residual):.3e}"
        yield from misnamed(case, z, certificate, residual)
    elif status is Status.SOLVED:
        yield "SOLVED without numbers"
    if status in PROVED:
        yield from infeasible(case, result)
    if status is Status.PRECISION_LIMIT:
        is_rounding = result.infeasibility is not None and result.infeasibility.is_rounding
        if not is_rounding and not case.data.is_at_rounding_level(z):
            yield "PRECISION_LIMIT above the rounding floor"


def misnamed(case: Case, z: Any, certificate: Any, residual: Any) -> Iterator[str]:
    """Yield an error if the certificate does not name the worst component."""
    if not 1e-6 < residual < 1e6:
        return
    worst, labels = certificate.worst_index, case.data.components
    residuals, references = case.data.residual(z), references_of_rows(case.at_zero, labels)
    own = max(r for r, label in zip(residuals, labels, strict=True) if label == labels[worst])
    acting = np.broadcast_to(certificate.references[1], len(labels))[worst]  # of rows that act at z
    if own < residual * min(references[worst], Fraction(float(acting))) * Fraction(999, 1000):
        yield f"the worst component is not that of row {worst}"


def infeasible(case: Case, result: Any) -> Iterator[str]:
    proof = result.infeasibility
    if not (proof.verify() and proof.margin > TOLERANCE):
        yield f"{result.status.name} without a proof that counts"
    if np.isnan(case.z).any():
        return
    z = case.z.tolist()
    least = case.relative(z)
    if least <= TOLERANCE:
        yield f"{result.status.name}, but planted is one with {float(least):.3e}"


def told(prefix: str, found: Iterator[str]) -> list[str]:
    return [f"{prefix}: {text}" for text in found]


def bits(result: Any) -> tuple[bytes, Status, int]:
    return result.z.tobytes(), result.status, result.iterations


def frozen(problem: LCP) -> list[bytes]:
    return [
        vector.tobytes() for vector in (problem.csr.data, problem.q, problem.lower, problem.upper)
    ]


# --- Interfaces ---------------------------------------------------------------------------------------------------

Asked = Callable[[Case, Generator], list[str]]


def named(case: Case, rng: Generator, name: str) -> list[str]:
    """A method cold and warm."""
    bad = []
    for start in (None, right_in_some(case, rng)):
        try:
            result = solve(
                case.problem, name, z0=start, max_iterations=None if name == "auto" else MOST_STEPS
            )
        except (UnsuitableMatrix, UnsuitableProblem):
            continue
        bad += told(f"{name}, {'cold' if start is None else 'warm'}", complaints(case, result))
    return bad


def recorded(case: Case, rng: Generator) -> list[str]:
    """The points that a callback sees are the caller's, and the last of a solved run is an answer."""
    seen: list[Vector] = []
    result = solve(case.problem, record=True, callback=lambda sample, z: seen.append(z.copy()),
                   z0=right_in_some(case, rng) if rng.random() < 0.5 else None)  # fmt: skip
    bad = told("recorded", complaints(case, result))
    if result.status is Status.SOLVED and case.relative(seen[-1].tolist()) > Fraction(TOLERANCE):
        bad.append("recorded: the last point that was shown does not solve the problem")
    if result.status is Status.SOLVED and not result.history[-1].residual <= TOLERANCE:
        bad.append("recorded: the last sample is above the tolerance")
    return bad


def through_cvxpy(case: Case, rng: Generator) -> list[str]:
    """Solve a cvxpy model with one pair per component: "optimal" must hold in every component."""
    import cvxpy as cp

    from lcp_plugin import box, complements

    problem, pairs, xs = case.problem, [], []
    M = problem.csr.toarray()
    for k in range(case.labels.max() + 1):
        rows = np.flatnonzero(case.labels == k)
        x = cp.Variable(rows.size)
        F = M[np.ix_(rows, rows)] @ x + problem.q[rows]
        pairs.append(complements(box(x, problem.lower[rows], problem.upper[rows]), F))
        xs.append((rows, x))
    model = cp.Problem(cp.Minimize(0), pairs)
    z = np.full(problem.n, np.nan)
    try:
        model.solve(method="LCP")
    except cp.SolverError:
        return []
    if model.status != "optimal":
        return ["cvxpy: infeasible"] * (model.status == "infeasible" and case.kind == SOLVABLE)
    for rows, x in xs:
        z[rows] = x.value
    residual = case.relative(z.tolist()) if np.isfinite(z).all() else np.inf
    is_within = residual <= Fraction(TOLERANCE) * Fraction(1001, 1000)
    return [] if is_within else [f"cvxpy: optimal with {float(residual):.3e}"]


ASKED: tuple[Asked, ...] = (recorded, through_cvxpy)


def by_auto(case: Case) -> tuple[list[str], str]:
    """Return errors of two calls of auto, and the status."""
    first, second = solve(case.problem), solve(case.problem)
    bad = told("auto", complaints(case, first))
    bad += ["auto again: other bits"] * (bits(first) != bits(second))
    return bad, first.status.name


def judge(seed: int, number: int) -> tuple[list[str], str, str]:
    """Return the errors of a case, its class, and the status of auto."""
    rng = np.random.default_rng([seed, number])
    case = random_case(rng, number)
    before, kind, status = frozen(case.problem), "", ""
    try:
        kind = case.kind
        bad, status = by_auto(case)
        is_small = case.problem.n < 200
        names = ["auto", *REGISTRY] if is_small and number % ALL_METHODS_EVERY == 0 else ["auto"]
        if len(names) == 1 and is_small:
            names.append(list(REGISTRY)[number % len(REGISTRY)])
        for name in names:
            bad += named(case, rng, name)
        if is_small:
            bad += ASKED[number // len(REGISTRY) % len(ASKED)](case, rng)
    except Exception:  # any exception is a finding
        bad = [traceback.format_exc().strip()]
    if frozen(case.problem) != before:
        bad.append("the data are modified")
    return bad, kind, status
