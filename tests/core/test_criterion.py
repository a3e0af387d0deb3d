"""The stopping criterion against constructed wrong points, enumeration in fractions, and exact results one ulp off."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from operator import mul
from typing import Any

import numpy as np
import pytest
from exact import exact_rows, solve_fractions

from lcp_plugin import LCP, Certificate, Status, gallery, solve, solve_batch
from lcp_plugin.core.errors import UnsuitableMatrix
from lcp_plugin.core.settings import Settings

METHODS = ("auto", "npsor", "psor", "newton", "lemke", "interior_point")
TINY = 2.0**-17
STACKED = np.array([[1e-8, -1e-8, 0], [-1e-8, 1 + 1e-8, -1], [0, -1, 1 + 1e-8]])
WEIGHTS = np.linalg.solve(STACKED, [0.04905, 0, 0])  # about 9.81e6, 4.905e6, 4.905e6
CONSTRUCTED: dict[str, tuple[Any, ...]] = {  # M, q, a wrong point, the right one or None, lower
    "the snapped point is measured": (
        [[1, 1], [0, 1]],
        [-(2.0**33), 64],
        [2.0**33, 64],
        [2.0**33, 0],
    ),
    "an idle row is no reference": (
        [[1, 2048, 0], [0, 1, 1], [0, 1, 1 + TINY]],
        [-1024, -2, -2 - TINY],
        [0, 1.5, 0.5],
        [0, 1, 1],
    ),
    "terms that cancel": (
        [[1, -1, 0], [-1, 1, 0], [1, 0, 1]],
        [-1, 0, -(2.0**27)],
        [2.0**20, 2.0**20, 2.0**27 - 2.0**20],
        None,
    ),
    "a row next to a large one": (
        [[1, 1, 0], [0, 1, -2], [0, 0, 1]],
        [-(2.0**46), 0, -1],
        [2.0**46 - 10, 10, 1],
        [2.0**46 - 2, 2, 1],
    ),
    "components": (np.eye(2), [-1e10, -0.5], [1e10, 0.6], [1e10, 0.5]),
    "a row of zeros": ([[1, 1], [0, 0]], [-1, -1e-9], [1, 0], None),
    "a tiny diagonal entry": ([[1, -2], [3, 1e-9]], [-3, -1], [1.672, 0], [3, 0]),
    "heavy on light": (STACKED, [-0.04905, 0, 0], [4.905e6, 0, 0], WEIGHTS),
    "a sign that is wrong for every z": ([[1e-9, 1], [-1, 0]], [-1, -1], [0, 1.1e16], None),
    "a sign next to 1e15": (
        [[1, 0, 2], [0, 1, 2], [-2, -2, 0]],
        [0, -1e15, -1],
        [0, 0, 0.5e15],
        None,
    ),
    "a row in small units": (
        [[1e6, 0, 0], [-2, -1, 0], [-1, 2, 1]],
        [-1e6, 1, -1e15],
        [1, 0, 1e15],
        None,
    ),
    "a chain to a row with q": (
        [[1, 0, 1, -1], [0, 1, 1, -1], [-1, -1, 0, 0], [1, 1, 0, 0]],
        [-1e19, 2, -2, 0],
        [-1, -1, 1e19, 0],
        None,
        [-1e10, -1, 0, 0],
    ),
    "rows that do not act": (
        [[0.1, 0, 0, 1], [0, 0.1, 0, 1e8], [0, 0, 0.1, 1e16], [-1, -1, -1, 0]],
        [-50, -50, -50, 1],
        [2, 0, 0, 49.8],
        [1, 0, 0, 49.9],
    ),
    "not moved to a bound": ([[1e-9, -1], [1, 1e-9]], [-1e-9, 0], [6, 5e-9], [1, 0]),
    "excused at 1e-8": ([[2e-6, 1], [-1, 1e-11]], [-1, -2e-11], [2e-12, 1], [0, 2]),
}


def constructed(name: str) -> tuple[LCP, Any, Any]:
    """Return the problem, a wrong point and the right one."""
    M, q, wrong, right, *lower = CONSTRUCTED[name]
    return LCP(np.array(M, float), q, lower=lower[0] if lower else 0.0), wrong, right


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CONSTRUCTED)
def test_a_run_from_a_wrong_point_ends_at_the_right_one(name: str, method: str) -> None:
    """No method calls a constructed wrong point SOLVED: the answer is right, or the status says that it is not."""
    problem, wrong, right = constructed(name)
    if method == "psor" and (problem.diagonal <= 0.0).any():
        with pytest.raises(UnsuitableMatrix):
            solve(problem, method)
        return
    for z0 in (wrong, None):
        result = solve(problem, method, z0=z0, max_iterations=20_000)
        if right is None:
            assert not result.is_solved
        elif result.is_solved:
            np.testing.assert_allclose(result.z, right, rtol=1e-4, atol=1e-3)
    if method == "auto":
        assert result.is_solved is (right is not None)


@pytest.mark.parametrize("name", CONSTRUCTED)
def test_a_certificate_and_a_batch_refuse_the_wrong_point(name: str) -> None:
    """The point itself fails one of the two tests, sparse or dense, and a batch does not end there."""
    problem, wrong, right = constructed(name)
    M, q, lower = problem.csr, problem.q, problem.lower
    for one in (problem, LCP(M, q, lower=lower)):
        assert not Certificate.of(one, wrong).meets(Settings())
        if right is not None:
            assert Certificate.of(one, right).meets(Settings())
    batch = solve_batch(M.toarray(), [q, q], lower=lower, z0=[np.maximum(lower, 0.0), wrong])
    for z, status in zip(batch.z, batch.status, strict=True):
        assert (status is Status.SOLVED) == (right is not None)
        if right is not None:
            np.testing.assert_allclose(z, right, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("power", [-300, -40, 0, 40, 300])
def test_a_row_of_zeros_is_infeasible_in_any_unit(power: int) -> None:
    """w₂ = −1e-9 for every z, also if M and q are multiplied by a power of two."""
    result = solve(LCP(np.ldexp([[1.0, 1.0], [0.0, 0.0]], power), np.ldexp([-1.0, -1e-9], power)))
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()


def solutions(M: Any, q: Any) -> list[list[Fraction]]:
    """Return the solutions of all nonsingular complementary bases, in fractions."""
    n, found, rows, offset = len(q), [], exact_rows(np.array(M)), [Fraction(float(x)) for x in q]
    for is_free in product((False, True), repeat=n):
        free = [i for i in range(n) if is_free[i]]
        part = solve_fractions(
            [[rows[i][j] for j in free] for i in free], [-offset[i] for i in free]
        )
        if part is None:
            continue
        z = [Fraction(0)] * n
        for i, value in zip(free, part, strict=True):
            z[i] = value
        w = [sum(map(mul, row, z)) + constant for row, constant in zip(rows, offset, strict=True)]
        if min(z) >= 0 and min(w) >= 0:
            found.append(z)
    return found


def drawn(rng: np.random.Generator) -> tuple[Any, Any]:
    """Return a problem of up to four rows: ties, near-parallel rows, odd diagonals, large integers."""
    n = int(rng.integers(1, 5))
    kind = rng.integers(6)
    M = rng.integers(-3, 4, (n, n)).astype(float)
    if kind == 1:
        M = M @ M.T + np.eye(n)
    elif kind == 2:
        M[-1] = M[0] * (1.0 + 2.0 ** -int(rng.integers(5, 20)))
        M[-1, -1] += 1.0
    elif kind == 3:
        M[np.diag_indices(n)] *= 2.0 ** -rng.integers(0, 50, n)
    elif kind == 4:
        M = M * rng.integers(1, 2**26, (n, n))
    q = rng.integers(-3, 4, n).astype(float) * 2.0 ** rng.integers(-10, 27, n)
    return M, q


def solves_exactly(M: Any, q: Any, z: Any) -> bool:
    """Return whether z ≥ 0, w = M z + q ≥ 0 and z_i w_i = 0 hold in rational arithmetic."""
    exact = [Fraction(value) for value in z.tolist()]
    w = [
        sum((Fraction(m) * x for m, x in zip(row, exact, strict=True)), Fraction(offset))
        for row, offset in zip(M.tolist(), q.tolist(), strict=True)
    ]
    return all(x >= 0 and y >= 0 and not x * y for x, y in zip(exact, w, strict=True))


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(20))
def test_no_wrong_point_is_solved(seed: int) -> None:
    """Of well-conditioned problems, a SOLVED z lies near an exact solution; none is SOLVED without one."""
    rng = np.random.default_rng([81, seed])
    for _ in range(100):
        M, q = drawn(rng)
        if abs(np.linalg.det(M)) == 0 or np.linalg.cond(M) > 1e4:
            continue
        result = solve(LCP(M, q))
        if result.is_solved and not solves_exactly(M, q, result.z):  # as one of a continuum does
            right = solutions(M, q)
            size = max(1.0, float(np.abs(result.z).max()))
            errors = [
                max(abs(float(a) - b) for a, b in zip(z, result.z, strict=True)) for z in right
            ]
            assert min(errors, default=np.inf) <= 1e-3 * size, (M, q, result.z)


ORDINARY = ("obstacle_1d", "obstacle_2d", "american_put", "random_h_plus", "random_spd")


@pytest.mark.parametrize("name", [name for name in ORDINARY if name in gallery.names()])
def test_a_right_result_passes_exactly_and_one_ulp_off(name: str) -> None:
    """The polished result of an ordinary problem passes, and so does each neighbor with random last bits."""
    problem = gallery.build(name).problem
    z = solve(problem, "newton", tolerance=1e-12).z
    rng, is_free = np.random.default_rng(0), (z > problem.lower) & (z < problem.upper)
    for k in range(20):
        ulps = rng.integers(-1, 2, z.size) * is_free * (k > 0)
        moved = z * (1.0 + ulps * 2.0**-52)
        assert Certificate.of(problem, moved).meets(Settings())


def test_a_stack_is_judged_as_its_problems() -> None:
    """Of 40 random problems each status in a batch is that of a solve by itself."""
    rng = np.random.default_rng(3)
    M, q = (
        rng.integers(-2, 4, (40, 4, 4)).astype(float),
        rng.integers(-3, 3, (40, 4)).astype(float),
    )
    batch = solve_batch(M, q)
    for k in range(40):
        assert solve(LCP(M[k], q[k])).status is batch.status[k]
