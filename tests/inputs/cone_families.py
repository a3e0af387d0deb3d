"""Problems over cones whose answer is planted, and the exact residual of an answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from mpmath import mp, mpf

from lcp_plugin import ConeProblem, FrictionalContact
from lcp_plugin.problems.cones.factors import cone_stack_of

from .contact_families import delassus

OPEN, STICKS, SLIDES, ON_THE_EDGE, GRAZES = range(5)


def planted_contacts(
    count: int,
    bodies: int,
    ratio: float,
    rng: np.random.Generator,
    *,
    definite: bool = False,
    most: float = 2.0,
) -> tuple[FrictionalContact, Any, Any]:
    """Contacts with impulses and velocities that answer them: open, sticking, sliding, on the edge of two cases."""
    W, _ = delassus(count, bodies, ratio, rng)
    if definite:
        W = W + np.diag(np.repeat(np.diag(W).reshape(count, 3).mean(axis=1), 3)) * rng.uniform(
            0.1, 1.0
        )
    mu = rng.uniform(0.0, most, count) * (rng.random(count) < 0.9)
    size = 1.0 / np.sqrt(np.diag(W).reshape(count, 3).mean(axis=1))
    r, u = np.zeros((2, count, 3))
    for c, case in enumerate(rng.integers(0, 5, count)):
        way = rng.standard_normal(2)
        way /= np.linalg.norm(way)
        if case == OPEN:
            u[c] = [rng.uniform(0.0, 1.0), *rng.standard_normal(2)]
        elif case == GRAZES:  # r = 0 and u_N = 0
            u[c, 1:] = rng.standard_normal(2)
        else:
            r[c, 0] = rng.uniform(0.1, 2.0)
            share = {STICKS: rng.uniform(0.0, 0.95), SLIDES: 1.0, ON_THE_EDGE: 1.0}[int(case)]
            r[c, 1:] = -share * mu[c] * r[c, 0] * way
            u[c, 1:] = way * rng.uniform(0.01, 1.0) if case == SLIDES or mu[c] == 0.0 else 0.0
        r[c] *= size[c]
        u[c] /= size[c]
    return FrictionalContact(W, u.ravel() - W @ r.ravel(), mu), r.ravel(), u.ravel()


def planted_cones(blocks: int, rng: np.random.Generator) -> tuple[ConeProblem, Any]:
    """A convex problem over free rows, half-lines, boxes and second-order cones, with its answer."""
    cones: list[Any] = []
    z, w = [np.empty(0)], [np.empty(0)]
    for _ in range(blocks):
        kind = str(rng.choice(["free", "nonnegative", "box", "second_order"]))
        rows = int(rng.integers(1, 6))
        at, values = rng.integers(0, 3, rows), rng.uniform(0.1, 2.0, rows)
        if kind == "free":
            cones.append((kind, rows))
            z.append(rng.standard_normal(rows))
            w.append(np.zeros(rows))
        elif kind == "nonnegative":
            cones.append((kind, rows))
            z.append(np.where(at == 0, values, 0.0))
            w.append(np.where(at == 1, values, 0.0))
        elif kind == "box":
            cones.append((kind, -np.ones(rows), 2.0))
            z.append(
                np.choose(
                    at, [np.full(rows, -1.0), rng.uniform(-0.9, 1.9, rows), np.full(rows, 2.0)]
                )
            )
            w.append(np.choose(at, [values, np.zeros(rows), -values]))
        else:
            rows += 1
            cones.append((kind, rows))
            way = rng.standard_normal(rows - 1)
            way /= np.linalg.norm(way)
            inner = np.array([1.0, *(rng.uniform(0.0, 0.9) * way)])
            edge, across = np.array([1.0, *way]), np.array([1.0, *-way])
            one, other = [
                (inner, 0 * inner),
                (0 * inner, inner),
                (edge, across),
                (edge, 0 * edge),
                (0 * edge, edge),
            ][int(rng.integers(5))]
            z.append(one * rng.uniform(0.1, 2.0))
            w.append(other * rng.uniform(0.1, 2.0))
    x, y = np.concatenate(z), np.concatenate(w)
    B = rng.standard_normal((x.size, x.size + 2))
    M = B @ B.T / x.size
    return ConeProblem(M, y - M @ x, cones), x


def exact_relative_residual(problem: Any, z: Any) -> Any:
    """‖R(z)‖ relative to that at the point nearest to 0, of the worst component, with 60 digits."""
    mp.dps = 60
    here, there = (exact_residuals(problem, point) for point in (z, problem.nearest_to_zero))
    entries, of_row = problem.rows.csr.tocoo(), problem.block_of_row
    is_there = entries.data != 0.0
    where = of_row[entries.row[is_there]], of_row[entries.col[is_there]]
    graph = sp.coo_array((np.ones(where[0].size), where), shape=(problem.slope.size,) * 2)
    labels, worst = sp.csgraph.connected_components(graph, directed=False)[1], mpf(0)
    for component in set(labels.tolist()):
        own = np.flatnonzero(labels == component)
        top, reference = (max(size[k] for k in own) for size in (here, there))
        if top > 0:
            worst = max(worst, top / reference if reference > 0 else mpf("inf"))
    return worst


def exact_residuals(problem: Any, z: Any) -> list[Any]:
    """‖R_k(z)‖ of each block, with 60 digits; of a contact the larger residual of its two laws."""
    mp.dps = 60
    scale = cone_stack_of(problem).d[0]
    M = problem.rows.csr
    w = [mpf(q) for q in problem.q.tolist()]
    for i in range(problem.n):
        for p in range(M.indptr[i], M.indptr[i + 1]):
            w[i] += mpf(float(M.data[p])) * mpf(float(z[M.indices[p]]))
    sizes = []
    for k in range(scale.size):
        first = problem.starts[k]
        end = problem.starts[k + 1]
        d = mpf(scale[k])
        mu = mpf(problem.slope[k])
        own, at = w[first:end], [mpf(float(v)) for v in z[first:end]]
        if end - first == 1:
            low, high = (mpf(float(bound[first])) for bound in (problem.lower, problem.upper))
            sizes.append(abs(at[0] - min(max(at[0] - own[0] / d, low), high)))
            continue
        if problem.has_friction:  # two laws: Signorini's of the normal row, Coulomb's of the others
            radius, ways = mu * at[0], [a - b / d for a, b in zip(at[1:], own[1:], strict=True)]
            share = min(mpf(1), radius / mp.norm(ways)) if any(ways) else mpf(1)
            of_friction = mp.norm([a - share * b for a, b in zip(at[1:], ways, strict=True)])
            sizes.append(max(abs(min(at[0], own[0] / d)), of_friction))
            continue
        x = [a - b / d for a, b in zip(at, own, strict=True)]
        tangent = mp.norm(x[1:])
        if tangent > mu * x[0]:
            if mu * tangent <= -x[0]:
                x = [mpf(0)] * len(x)
            else:
                axis = (x[0] + mu * tangent) / (1 + mu * mu)
                x = [axis, *(mu * axis * v / tangent for v in x[1:])]
        sizes.append(mp.norm([a - b for a, b in zip(at, x, strict=True)]))
    return sizes


def cancelled_diagonals(rng: np.random.Generator) -> ConeProblem:
    """Second-order cones over an M of one decimal that is not monotone, the diagonals of its blocks adding up to 0."""
    rows, blocks = int(rng.integers(2, 4)), int(rng.integers(1, 4))
    M = np.round(rng.uniform(-1.0, 1.0, (rows * blocks, rows * blocks)), 1)
    for first in range(0, rows * blocks, rows):
        end = first + rows
        left = rng.choice([0.0, 2.0**-54, 2.0**-40, 1e-9, -1e-12, 1e-5])
        M[end - 1, end - 1] += left - np.trace(M[first:end, first:end])
    return ConeProblem(
        M, np.round(rng.uniform(-1.5, 1.5, rows * blocks), 1), [("second_order", rows)] * blocks
    )


def violation(problem: Any, z: Any) -> float:
    """How far z is outside K beside ‖z_k‖, w outside K* beside its terms, and z_k · w_k beside both, with 50 digits."""
    mp.dps = 50
    M, worst = problem.rows.csr.toarray(), mpf(0)
    z, q = [mpf(float(value)) for value in z], [mpf(float(value)) for value in problem.q]
    products = [[mpf(float(M[i, j])) * z[j] for j in range(problem.n)] for i in range(problem.n)]
    for k, mu in enumerate(problem.slope):
        own = slice(problem.starts[k], problem.starts[k + 1])
        at, w = z[own], [a + sum(row) for a, row in zip(q[own], products[own], strict=True)]
        if problem.has_friction:
            w[0] += mpf(float(mu)) * mp.norm(w[1:])
        terms = mp.norm(
            [abs(a) + sum(map(abs, row)) for a, row in zip(q[own], products[own], strict=True)]
        )
        outside = (
            [mp.norm(at[1:]) - mu * at[0], mu * mp.norm(w[1:]) - w[0]]
            if len(at) > 1
            else [-at[0], -w[0]]
        )
        size = mp.norm(at)
        for wrong, beside in zip(
            [*outside, abs(mp.fdot(at, w))], (size, terms, size * terms), strict=True
        ):
            worst = max(worst, wrong / beside) if wrong > 0 and beside > 0 else worst
    return float(worst)


def tower(masses: Any, corners: Any) -> tuple[FrictionalContact, Any]:
    """Boxes on one another in the plane for 10 ms of gravity, contacts at these corners; and what each face carries."""
    masses, pull = np.asarray(masses, float), 0.0981
    rows = np.zeros((len(masses), len(corners), 2, 3 * len(masses)))
    for i in range(len(masses)):
        for c, x in enumerate(corners):
            rows[i, c, :, 3 * i : 3 * i + 3] = [0.0, 1.0, x], [1.0, 0.0, 0.5]
            if i:
                rows[i, c, :, 3 * i - 3 : 3 * i] = [0.0, -1.0, -x], [-1.0, 0.0, 0.5]
    rows = rows.reshape(-1, 2, 3 * len(masses))
    inertia = np.diag(np.ravel([[mass, mass, mass / 6.0] for mass in masses]))
    problem = FrictionalContact(
        (inertia, rows[:, 0], rows[:, 1:]), np.tile([0.0, -pull, 0.0], len(masses)), 0.5
    )
    return problem, pull * np.cumsum(masses[::-1])[::-1]
