"""Convection and diffusion on a square, in own and in other units: how often SOLVED is false.

Five-point differences of −Δu + b·∇u + c u on 12² to 40² nodes, cell Péclet numbers from .1 to 1000, upwind or central,
b constant, a shear or a vortex, coefficients of one size or jumping by up to 10³. The answer is planted: z and w ≥ 0
complementary, q = w − M z. Units, powers of two: own; one unknown × 2^±12 (or 2^±20); a few; all by 2^±20, rows too;
rows alone. Eight methods, one drawn for each problem. SOLVED is false where the residual in the planted units exceeds
1e-5 of that at 0 and the error exceeds 1e-3. A right answer must pass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, Certificate, LCPError, solve
from lcp_plugin.core.settings import Settings

METHODS = ("auto", "npsor", "psor", "newton", "multigrid", "interior_point", "lemke", "banded")
LARGEST = {"lemke": 200, "banded": 600}  # unknowns
UNITS = ("own", "one", "one far", "few", "all", "rows")


def flow(rng: np.random.Generator, m: int) -> sp.csr_array:
    """Differences on m² nodes; entries that neither scheme makes an M-matrix are allowed."""
    peclet, is_upwind = 10.0 ** rng.uniform(-1.0, 3.0), rng.random() < 0.5
    kind = rng.integers(3)
    y, x = np.divmod(np.arange(m * m), m) / np.array([[m - 1.0]]) - 0.5
    speed = [np.stack([np.full(m * m, np.cos(1.0)), np.full(m * m, np.sin(1.0))]), np.stack([2.0 * y, 0.0 * x]),
             np.stack([2.0 * y, -2.0 * x])][kind]  # fmt: skip
    spread = 10.0 ** (rng.integers(0, 2, m * m) * rng.uniform(0.0, 3.0))
    size = np.arange(m * m).reshape(m, m)
    M = sp.lil_array((m * m, m * m))
    diagonal = np.full(m * m, 10.0 ** rng.uniform(-3.0, 0.0))
    for axis, (here, there) in enumerate(((size[:, :-1], size[:, 1:]), (size[:-1], size[1:]))):
        i, j = here.ravel(), there.ravel()
        k, v = (
            2.0 / (1.0 / spread[i] + 1.0 / spread[j]),
            peclet * 0.5 * (speed[axis][i] + speed[axis][j]),
        )
        to_right, to_left = (
            (k + np.maximum(v, 0.0), k + np.maximum(-v, 0.0))
            if is_upwind
            else (k + v / 2, k - v / 2)
        )
        M[j, i], M[i, j] = -to_right, -to_left
        np.add.at(diagonal, j, to_right)
        np.add.at(diagonal, i, to_left)
    edge = (x == -0.5) | (x == 0.5) | (y == -0.5) | (y == 0.5)
    M.setdiag(np.abs(diagonal) + edge * spread)
    return sp.csr_array(M)


def exponents(rng: np.random.Generator, units: str, n: int) -> tuple[Any, Any]:
    """Of rows and of unknowns."""
    r, c = np.zeros((2, n), int)
    if units.startswith("one"):
        c[rng.integers(n)] = rng.choice([-1, 1]) * (20 if units == "one far" else 12)
    elif units == "few":
        c[rng.integers(n, size=5)] = rng.integers(-20, 21, 5)
    elif units == "all":
        r, c = rng.integers(-20, 21, (2, n))
    elif units == "rows":
        r = rng.integers(-20, 21, n)
    return r, c


def judged(rng: np.random.Generator) -> list[str]:
    """Return what is false of one problem."""
    method, units = str(rng.choice(METHODS)), str(rng.choice(UNITS))
    m = (
        int(rng.integers(12, 41))
        if method not in LARGEST
        else int(rng.integers(6, int(LARGEST[method] ** 0.5)))
    )
    M = flow(rng, m)
    n = m * m
    z = np.maximum(rng.normal(size=n), 0.0)
    w = np.where((z > 0.0) | (rng.random(n) < 0.2), 0.0, np.abs(rng.normal(size=n)))
    q, (r, c) = w - M @ z, exponents(rng, units, n)
    rows = np.repeat(np.arange(n), np.diff(M.indptr))
    problem = LCP(
        sp.csr_array((np.ldexp(M.data, r[rows] + c[M.indices]), M.indices, M.indptr)),
        np.ldexp(q, r),
    )
    planted = Certificate.of(problem, np.ldexp(z, -c))
    found = []
    if not planted.meets(Settings(tolerance=1e-8)) and not planted.is_at_rounding_level:
        found.append(f"right refused: {units}")
    try:
        result = solve(problem, method, max_iterations=2000, max_seconds=20.0)
    except LCPError:
        return found
    x, d = np.ldexp(result.z, c), np.abs(M.diagonal())
    residual = np.abs(np.minimum(x, (M @ x + q) / d)).max() / np.abs(np.minimum(q / d, 0.0)).max()
    error = np.abs(x - z).max() / z.max()
    if result.is_solved and residual > 1e-5 and error > 1e-3:
        found.append(
            f"FALSE: {method}, {units}, n = {n}: residual {residual:.0e}, error {error:.0e}"
        )
    return found
