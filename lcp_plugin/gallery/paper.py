"""Problems with a solution chosen first: the paper's examples, one with active constraints, and a random H₊-matrix."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..core.lcp import LCP
from .scene import SYMMETRIC, Scene, require, scene_builder
from .stencil import stencil_matrix


@scene_builder
def paper_example_1(*, n: int = 100, delta: float = 4.0) -> Scene:
    """Five-point Laplacian plus delta I with z* = (1, 2, 1, 2, …), nothing active: Example 1 of the paper.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m²; the paper takes 100, 900, 2500, 3600, 6400, 10000.
    delta
        Shift of the diagonal, at least 0; the tables take 4. With 0 inner rows are not strictly dominant.

    Notes
    -----
    M = blocktridiag(−I, tridiag(−1, 4, −1), −I) + δI, q = −M z*, start (1, 0, 1, 0, …). The identity in
    the fourth block row is printed without its minus sign. As w* = 0 and z* > 0, the solution solves the
    linear system M z = −q.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    return _paper_scene(n, delta, below=-1.0, above=-1.0)


@scene_builder
def paper_example_2(*, n: int = 100, delta: float = 4.0) -> Scene:
    """Nonsymmetric five-point matrix plus delta I with z* = (1, 2, 1, 2, …): Example 2 of the paper.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m²; the paper takes 100, 900, 2500, 3600, 6400, 10000.
    delta
        Shift of the diagonal, at least 0; the tables take 4.

    Notes
    -----
    M = blocktridiag(−1.5 I, tridiag(−1.5, 4, −0.5), −0.5 I) + δI, q = −M z*, start (1, 0, 1, 0, …). The
    diagonal block is printed as tridiag(−1, 4, −1); the tables were computed with the block given here.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.
    """
    return _paper_scene(n, delta, below=-1.5, above=-0.5)


def _paper_scene(n: int, delta: float, below: float, above: float) -> Scene:
    side = _side(n)
    M = stencil_matrix((side, side), 4.0 + delta, (below, below), (above, above))
    exact = np.resize([1.0, 2.0], n)
    return Scene(
        problem=LCP(M, -(M @ exact)),
        exact=exact,
        start=np.resize([1.0, 0.0], n),
        is_symmetric=below == above,
        is_h_plus=True,
        grid=(side, side),
        axis_labels=("row", "column"),
    )


@scene_builder
def half_active(
    *, n: int = 10_000, delta: float = 4.0, block: int = 5, degenerate: bool = True
) -> Scene:
    """Five-point Laplacian plus delta I, constraints active on every other block of a checkerboard.

    Parameters
    ----------
    n
        Number of unknowns, a perfect square m².
    delta
        Shift of the diagonal, at least 0; q is exact in floating point if it is an integer.
    block
        Side of the checkerboard's blocks in nodes. The share is exactly one half if 2·block divides m.
    degenerate
        Whether the first corner of each active block has z* = w* = 0; otherwise z* + w* > 0 throughout.

    Notes
    -----
    The answer comes first: on free blocks z* = 1, 2, 1, 2, … and w* = 0, on active ones the other way round;
    then q = w* − M z*. The paper's own examples have no active constraint and so do not test
    complementarity: an iteration for the linear system alone would solve them.
    """
    side = _side(n)
    M = stencil_matrix((side, side), 4.0 + delta, (-1.0, -1.0), (-1.0, -1.0))
    row, column = np.divmod(np.arange(n), side)
    is_active = (row // block + column // block) % 2 == 1
    values = np.resize([1.0, 2.0], n)
    exact = np.where(is_active, 0.0, values)
    slack = np.where(is_active, values, 0.0)
    if degenerate:
        slack[(row % block == 0) & (column % block == 0)] = 0.0
    return Scene(
        problem=LCP(M, slack - M @ exact),
        exact=exact,
        grid=(side, side),
        axis_labels=("row", "column"),
        **SYMMETRIC,
    )


def _side(n: int) -> int:
    """Return √n, or raise InvalidOption."""
    side = math.isqrt(n)
    require(side**2 == n, f"n must be a perfect square, got {n}")
    return side


# --- A random matrix --------------------------------------------------------------------------------------


LARGEST_ENTRY = 9


@scene_builder
def random_h_plus(
    *,
    n: int = 2000,
    entries_per_row: int = 5,
    row_scale: int = 20,
    column_scale: int = 10,
    active_share: float = 0.5,
    seed: int = 0,
) -> Scene:
    """Random sparse H+-matrix, rows and columns wildly scaled, with a planted answer exact to the last bit.

    Parameters
    ----------
    n
        Number of unknowns, at least 2.
    entries_per_row
        Off-diagonal entries drawn per row; those that fall on the same place are added.
    row_scale, column_scale
        Rows and columns are multiplied by powers of two with random exponents from −scale to scale.
    active_share
        Share of components with z* = 0, in [0, 1], rounded to whole components. One in ten of them is
        degenerate: w* = 0 too.
    seed
        Seed of the generator that draws all data.

    Notes
    -----
    M = R A C with A an integer matrix of strictly dominant rows and R, C diagonal powers of two. Thus
    ⟨M⟩ C⁻¹1 > 0 and M is H+, though usually neither rows nor columns of M are dominant. z* = C⁻¹ẑ, w* = R ŵ
    with small integers ẑ, ŵ, and q = w* − M z* = R (ŵ − A ẑ): integers far below 2⁵³ times powers of two, so
    that no rounding happens anywhere and z* is the exact solution for the stored data.
    """
    require(n > 1, f"n must be an integer ≥ 2, got {n}")
    require(0.0 <= active_share <= 1.0, f"active_share must lie in [0, 1], got {active_share}")
    require(max(row_scale, column_scale) <= 100, "row_scale and column_scale must be at most 100")
    generator = np.random.default_rng(seed)
    A = _random_dominant(generator, n, entries_per_row)
    z, w = _random_answer(generator, n, active_share)
    row_power = np.exp2(generator.integers(-row_scale, row_scale + 1, size=n))
    column_power = np.exp2(generator.integers(-column_scale, column_scale + 1, size=n))

    q = row_power * (w - A @ z)
    A.data *= np.repeat(row_power, np.diff(A.indptr)) * column_power[A.indices]
    return Scene(problem=LCP(A, q), exact=z / column_power, is_h_plus=True)


def _random_dominant(generator: Any, n: int, entries_per_row: int) -> sp.csr_array:
    """Return an integer matrix whose diagonal exceeds the row sum of the absolute other entries by 1 … 9."""
    count = n * entries_per_row
    rows = np.repeat(np.arange(n), entries_per_row)
    # A step of 1 … n − 1 around the circle never lands on the diagonal.
    columns = (rows + generator.integers(1, n, size=count)) % n
    signs, sizes = generator.choice([-1.0, 1.0], count), generator.integers(1, 10, count)
    others = sp.csr_array((signs * sizes, (rows, columns)), shape=(n, n))
    row_sums: FloatVector = np.asarray(abs(others).sum(axis=1), dtype=np.float64)
    diagonal = row_sums + generator.integers(1, LARGEST_ENTRY + 1, size=n)
    matrix = (others + sp.diags_array(diagonal)).tocsr()
    matrix.eliminate_zeros()
    return matrix


def _random_answer(generator: Any, n: int, active_share: float) -> tuple[FloatVector, FloatVector]:
    """Return complementary integer vectors ẑ, ŵ; a tenth of the zeros of ẑ are zeros of ŵ."""
    order = generator.permutation(n)
    active = order[: round(active_share * n)]
    z = generator.integers(1, LARGEST_ENTRY + 1, size=n).astype(np.float64)
    w = np.zeros(n)
    w[active] = z[active]
    z[active] = 0.0
    w[active[: len(active) // 10]] = 0.0
    return z, w
