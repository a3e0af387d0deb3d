"""Run under mpiexec by test_hierarchy.py: compares the hierarchy on ranks with products of whole matrices."""

from __future__ import annotations

import json
import sys

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from lcp_plugin import LCP, gallery
from lcp_plugin.systems.hierarchy import vectors
from lcp_plugin.systems.hierarchy.grids import Grid, Hierarchy, Operator
from lcp_plugin.systems.hierarchy.levels import build_hierarchy
from lcp_plugin.systems.hierarchy.truncation import Truncation

COMM = MPI.COMM_WORLD


def one_way(n: int) -> LCP:
    """A chain whose rows meet only the neighbour before: the pattern is not symmetric."""
    M = sp.diags_array(
        [np.full(n - 1, -0.9), np.full(n, 2.0), np.full(n - 3, -0.3)], offsets=[-1, 0, 3]
    )
    return LCP(M.tocsr(), -np.ones(n))


PROBLEMS = {
    "obstacle_2d": lambda: gallery.build("obstacle_2d", size=23).problem,
    "obstacle_3d": lambda: gallery.build("obstacle_3d", size=9).problem,
    "wind": lambda: gallery.build("convection_diffusion", size=21, diffusion=1e-2).problem,
    "anisotropy": lambda: gallery.build("rotated_anisotropy", size=20).problem,
    "one way": lambda: one_way(150),
}


def whole(arrays: tuple[np.ndarray, ...], rows: int, columns: np.ndarray, width: int) -> np.ndarray:
    """The matrix of all ranks' own rows, dense."""
    indptr, indices, data = arrays
    end = int(indptr[rows])
    own = sp.csr_array(
        (data[:end], columns[indices[:end]], indptr[: rows + 1]), shape=(rows, width)
    )
    return np.concatenate(COMM.allgather(own.toarray()))


def numbers(grid: Grid) -> np.ndarray:
    """The global number of every local unknown."""
    layout = grid.communicator
    return np.concatenate([np.arange(layout.first, layout.last), grid.communicator.ghosts])


def everybody_s(own: np.ndarray) -> np.ndarray:
    return np.concatenate(COMM.allgather(own))


def matrices(hierarchy: Hierarchy) -> list[np.ndarray]:
    return [whole(g.matrix.arrays, g.n, numbers(g), g.communicator.n) for g in hierarchy.grids]


def prolongations(hierarchy: Hierarchy) -> list[np.ndarray]:
    return [
        whole(t.prolongation.arrays, g.n, numbers(c), c.communicator.n)
        for g, c, t in zip(hierarchy.grids, hierarchy.grids[1:], hierarchy.transfers, strict=False)
    ]


def restrictions(hierarchy: Hierarchy) -> list[np.ndarray]:
    return [
        whole(t.restriction.arrays, c.n, numbers(g), g.communicator.n)
        for g, c, t in zip(hierarchy.grids, hierarchy.grids[1:], hierarchy.transfers, strict=False)
    ]


def far(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).max(initial=0.0) / max(np.abs(other).max(initial=0.0), 1e-300))


def transfers_fit(hierarchy: Hierarchy, is_symmetric: bool) -> float:
    """R is Pᵀ, or Pᵀ D⁻¹ where M is not symmetric."""
    errors = [0.0]
    for P, R, M in zip(
        prolongations(hierarchy), restrictions(hierarchy), matrices(hierarchy), strict=False
    ):
        errors.append(far(R, P.T if is_symmetric else P.T / M.diagonal()))
    return max(errors)


def products_fit(hierarchy: Hierarchy) -> float:
    """Every coarser matrix is R M P."""
    M = matrices(hierarchy)
    pairs = zip(M, M[1:], prolongations(hierarchy), restrictions(hierarchy), strict=False)
    return max([0.0, *(far(coarse, R @ fine @ P) for fine, coarse, P, R in pairs)])


def truncation_fits(hierarchy: Hierarchy) -> float:
    """After any sequence of free sets every coarse matrix is the product with the truncated interpolation."""
    truncation, generator, worst = Truncation(hierarchy), np.random.default_rng(0), 0.0
    top = truncation.grids[0]
    layout = top.grid.communicator
    M, P, R = matrices(hierarchy), prolongations(hierarchy), restrictions(hierarchy)
    for share in (0.5, 0.02, 0.02, 0.0, 0.9, 0.3):
        flips = (generator.random(layout.n) < share)[layout.first : layout.last]
        top.free_changed[: flips.size] = flips
        top.is_free[: flips.size] ^= flips
        truncation.update()
        matrix, free = M[0], everybody_s(top.is_free[: flips.size])
        levels = zip(truncation.grids[1:], M, P, R, hierarchy.transfers, strict=False)
        for level, before, prolongation, restriction, transfer in levels:
            left = coupling(matrix * free) / diagonal_and_positive(matrix)
            is_held = left < vectors.HELD * coupling(before) / diagonal_and_positive(before)
            carried = free & ~(is_held & ~everybody_s(transfer.is_coarse))
            matrix = (restriction * carried) @ matrix @ (prolongation * carried[:, None])
            free = matrix.diagonal() > 1e-300
            grid = level.grid
            arrays = Operator(grid.matrix.indptr, grid.matrix.indices, level.values).arrays
            worst = max(
                worst, far(whole(arrays, grid.n, numbers(grid), grid.communicator.n), matrix)
            )
            worst = max(
                worst, float(not np.array_equal(everybody_s(level.is_free[: grid.n]), free))
            )
    return worst


def coupling(matrix: np.ndarray) -> np.ndarray:
    return -np.minimum(matrix, 0.0).sum(axis=1)


def diagonal_and_positive(matrix: np.ndarray) -> np.ndarray:
    return np.maximum(np.maximum(matrix, 0.0).sum(axis=1), 1e-300)


def cycle_is_symmetric(hierarchy: Hierarchy) -> float:
    """One V-cycle on the free set is a symmetric map that leaves the rest at 0."""
    truncation = Truncation(hierarchy)
    top = truncation.grids[0]
    layout, n = top.grid.communicator, top.grid.n
    generator = np.random.default_rng(1)
    fixed = (generator.random(layout.n) < 0.3)[layout.first : layout.last]
    top.is_free[:n] = ~fixed
    top.free_changed[:n] = fixed
    truncation.update()
    images, rights = [], []
    for _ in range(3):
        b = generator.standard_normal(layout.n)[layout.first : layout.last] * ~fixed
        top.b[:] = b
        truncation.correct(0)
        images.append(everybody_s(top.x[:n]))
        rights.append(everybody_s(b))
    table = np.array(rights) @ np.array(images).T
    moved = float(np.abs(np.array(images)[:, everybody_s(fixed)]).max())
    return max(far(table, table.T), moved)


def main() -> None:
    found = {}
    for name, make in PROBLEMS.items():
        matrix = LCP.from_problem(make(), COMM).matrix
        is_symmetric = name not in ("wind", "one way")
        hierarchy = build_hierarchy(matrix.csr_rows, 8, scales_rows=not is_symmetric, shared=matrix)
        found[name] = {
            "grids": float(len(hierarchy.grids)),
            "transfers": transfers_fit(hierarchy, is_symmetric),
            "products": products_fit(hierarchy),
            "truncation": truncation_fits(hierarchy),
            "cycle": cycle_is_symmetric(hierarchy) if is_symmetric else 0.0,
        }
    if COMM.rank == 0:
        sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
